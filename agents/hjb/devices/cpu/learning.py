"""Learn from remembered decisions: draw them, and compute the losses of f and J with their gradients."""

from __future__ import annotations

import math

from ecology.agents.hjb.devices.cpu.arithmetic import (
    FEW,
    HALF,
    LONGEST,
    ONE,
    TURN,
    TWO,
    ZERO,
    F,
    activate,
    deactivate,
    multiply,
    output,
    product_back,
    reshape,
    sum_rows,
)
from ecology.agents.hjb.devices.cpu.compiler import inlined, within
from ecology.agents.hjb.devices.cpu.encoding import drive, features
from ecology.agents.hjb.devices.cpu.first_order import activate_tangents, add_climb, deactivate_tangents, tangents
from ecology.agents.hjb.devices.cpu.networks import hidden_layer, inputs_of, layers


@within
def positions(count, capacity, uniform, late, recent, at):
    """Fill at (b,) with positions in the ring: the last `late` of them among the `recent` decisions."""
    kept = min(count, capacity)
    for r in range(len(at)):
        window = min(kept, recent) if r >= len(at) - late else kept
        back = min(int(uniform[r] * F(window)), window - 1)  # 0: the newest
        at[r] = (count - 1 - back) % capacity


@within
def lack(s, v, share):
    """Return a deviation of need v that is a `share` of the way from deprived to a little beyond sated."""
    bottom = max(s.deprived * s.scale[v], s.low[v])
    return bottom + share * (s.sated * s.scale[v] - bottom)


@inlined
def imagine(s, zeta, uniform, normal, m):
    """Redraw the needs of the first m states of zeta (b, D), place and rest kept; fatigues are scaled down.

    Half of them have one need deprived and the others near sated, half have all needs uniform
    between deprived and a little beyond sated.
    """
    parts = zeta.shape[1]
    for r in range(m):
        one = -1
        if r < m // 2 and len(s.deprivable):
            one = s.deprivable[min(int(uniform[m * parts + m + r] * F(len(s.deprivable))), len(s.deprivable) - 1)]
        calm = uniform[m * parts + r]
        for v in range(parts):
            if not s.need[v]:
                continue
            can = False
            for e in s.deprivable:
                can |= e == v
            drawn = lack(s, v, uniform[r * parts + v])
            if not can:
                drawn = zeta[r, v] * calm
            elif r < m // 2 and v != one:
                drawn = F(0.1) * s.scale[v] * normal[r, v]
            zeta[r, v] = min(max(drawn, s.low[v]), s.high[v])


@inlined
def redraw(s, zeta, uniform, m):
    """Redraw the deprivable needs of the first m states of zeta (b, D), as in half of `imagine`."""
    count = len(s.deprivable)
    for r in range(m):
        for k in range(count):
            v = s.deprivable[k]
            zeta[r, v] = min(lack(s, v, uniform[r * count + k]), s.high[v])


@within
def learn_f(s, own, sample, m, scratch, g):
    """Return L_f and fill its gradient g (P,): the squared error of the executed movement's predicted change.

    `sample` are zeta (b, D), the movement (b,), zeta after it, its duration and its excess (b,). The first m rows,
    whose needs are imagined, count for the spatial components alone. Of one or two rows, g must be zero before,
    and the gradients of w1 and w2 are left to `adam_across`: x, h1 and what comes back to them lie in `scratch`.
    `learn_j` does so too.
    """
    zeta, movement, after, duration, excess = sample
    rows, parts = zeta.shape
    width, k = s.width, len(s.plain) + 2 * len(s.angle) + own.cells
    inputs = inputs_of(s, own)
    _, _, w2, _, w3, b3 = layers(own.f, inputs, width)
    g1, gb1, g2, gb2, g3, gb3 = layers(g, inputs, width)
    h2 = hidden_layer(s, own, zeta, scratch)
    x, h1 = reshape(scratch.inputs, rows, k), reshape(scratch.second, rows, width)
    back1, back2 = reshape(scratch.third, rows, width), reshape(scratch.fourth, rows, width)
    known = 0
    for r in range(rows):
        known += movement[r] >= 0
    part = ONE / F(max(known, 1) * s.outputs)
    loss = ZERO
    if rows > FEW:
        g3[:] = ZERO
        gb3[:] = ZERO
    for r in range(rows):
        up, row = back2[r], h2[r]
        up[:] = ZERO
        if movement[r] < 0:
            continue
        for v in range(s.outputs):
            if r < m and not s.spatial[v]:
                continue
            target = min(duration[r], LONGEST) if v == parts else excess[r]
            if v < parts:
                target = after[r, v] - zeta[r, v]
            for p in s.angle:
                if p == v:
                    target -= TURN * F(math.floor(target / TURN + HALF))
            o = movement[r] * s.outputs + v
            weight, slot = w3[o], g3[o]
            error = output(row, weight, b3[o]) - target / s.unit[v]
            loss += error * error * part
            e = TWO * error * part
            gb3[o] += e
            for h in range(width):
                slot[h] += e * row[h]
                up[h] += e * weight[h]
        for h in range(width):
            up[h] = up[h] if row[h] > ZERO else ZERO
    product_back(back2, w2, back1)
    for r in range(rows):
        for h in range(width):
            back1[r, h] = back1[r, h] if h1[r, h] > ZERO else ZERO
    sum_rows(back1, gb1)
    sum_rows(back2, gb2)
    if rows > FEW:
        multiply(x.T, back1, g1[:k])
        multiply(h1.T, back2, g2)
    return loss


@within
def learn_j(s, own, sample, scratch, g):
    """Return L_J and fill its gradient g (Q,): the squared residual of the HJB equation, in drive units.

    `sample` are zeta (b, D), the movement (b,), J's target (b,), which is the right-hand side of the equation, and the
    pace (b, D). Where the score is first order and there is no min (Algorithm 1 as printed), the target lacks
    dJ/dzeta . f, which is added here along the pace and differentiated too.
    """
    zeta, movement, target, pace = sample
    b, width, inputs = len(zeta), s.width, inputs_of(s, own)
    k = len(s.plain) + 2 * len(s.angle) + own.cells
    printed = not (s.finite or s.minimum)
    rows = 2 * b if printed else b  # the states, and below them their tangents
    w1, b1, w2, b2, w3, b3 = layers(own.J, inputs, width)
    g1, gb1, g2, gb2, g3, gb3 = layers(g, inputs, width)
    x = reshape(scratch.inputs, rows, k)
    z1, h1 = reshape(scratch.first, rows, width), reshape(scratch.second, rows, width)
    z2, h2 = reshape(scratch.third, rows, width), reshape(scratch.fourth, rows, width)
    features(s, zeta, own.centres, x[:b])
    if printed:
        tangents(s, own, zeta, x[:b], pace, x[b:])
    multiply(x, w1[:k], z1)
    activate(z1, b1, h1, b)
    activate_tangents(z1, h1, b)
    multiply(h1, w2, z2)
    activate(z2, b2, h2, b)
    activate_tangents(z2, h2, b)
    known = 0
    for r in range(b):
        known += s.minimum or movement[r] >= 0
    loss, share = ZERO, ONE / F(max(known, 1))
    g3[:] = ZERO
    gb3[:] = ZERO
    for r in range(b):
        base = drive(s, zeta[r], scratch.mixed) if s.anchored else s.centre_j
        residual = base + s.spread_j * output(h2[r], w3[0], b3[0]) - target[r]
        if printed:
            residual = add_climb(s, zeta[r], pace[r], h2[b + r], w3[0], residual, scratch)
        weight = share * F(s.minimum or movement[r] >= 0)
        if s.weight_power:
            relative = s.weight_top / (s.weight_floor + drive(s, zeta[r], scratch.mixed))
            for _ in range(s.weight_power):
                weight *= relative
        loss += residual * residual * weight
        e = TWO * residual * weight * s.spread_j
        gb3[0] += e
        for q in range(r, rows, b):  # the state, and its tangent
            for h in range(width):
                g3[0, h] += e * h2[q, h]
                h2[q, h] = e * w3[0, h]  # from here on the gradient of the loss
            e /= s.log_gamma
    back1 = z2  # when z2 is no longer needed
    deactivate(z2, h2, b)
    deactivate_tangents(z2, h2, b)
    product_back(h2, w2, back1)
    deactivate(z1, back1, b)
    deactivate_tangents(z1, back1, b)
    sum_rows(back1[:b], gb1)
    sum_rows(h2[:b], gb2)
    if rows > FEW:
        multiply(x.T, back1, g1[:k])
        multiply(h1.T, h2, g2)
    return loss
