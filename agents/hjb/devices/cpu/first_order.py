"""The first-order form of the HJB equation, d + dJ/dzeta . f, which only Algorithm 1 as printed needs.

Its loss differentiates dJ/dzeta along f in the weights of J, so tangents run through the network beside the values.
"""

from __future__ import annotations

import numpy as np

from ecology.agents.hjb.devices.cpu.arithmetic import (
    FEW,
    LONGEST,
    ONE,
    TWO,
    ZERO,
    multiply,
    output,
    product_back,
    raise_to,
    reshape,
    sigmoid,
)
from ecology.agents.hjb.devices.cpu.compiler import inlined, within
from ecology.agents.hjb.devices.cpu.encoding import drive, features, part_of_bent_drive, slope_of_bent_drive
from ecology.agents.hjb.devices.cpu.networks import hidden_layer, inputs_of, layers


@within
def add_drive_slope(s, zeta, mixed, slope):
    """Add dd/dzeta at one zeta (D,) to slope (D,); `mixed` (D,) is room to work in."""
    drive(s, zeta, mixed)
    total = s.epsilon
    for v in range(len(mixed)):
        total += part_of_bent_drive(s, mixed[v], v) if s.bent else mixed[v] * mixed[v]
        slope[v] += s.felt[v]
    factor = s.exponent * raise_to(total, s.root - ONE)
    if s.bent:
        for v in range(len(mixed)):
            mixed[v] = slope_of_bent_drive(s, mixed[v], v)
    for e in range(len(s.mix_from)):
        slope[s.mix_from[e]] += factor * mixed[s.mix_to[e]] * s.mix_weight[e]


@within
def slopes(s, own, zeta, scratch):
    """Leave dJn/dzeta of zeta (b, D) in scratch.slope."""
    base, rows, width = len(s.plain) + 2 * len(s.angle), len(zeta), s.width
    k = base + own.cells
    w1, b1, w2, b2, w3, _ = layers(own.J, inputs_of(s, own), width)
    x = reshape(scratch.inputs, rows, k)
    features(s, zeta, own.centres, x)
    z1, h1 = reshape(scratch.first, rows, width), reshape(scratch.second, rows, width)
    z2, back = reshape(scratch.third, rows, width), reshape(scratch.fourth, rows, width)
    multiply(x, w1[:k], z1)
    for r in range(rows):
        for h in range(width):
            z1[r, h] += b1[h]
            h1[r, h] = z1[r, h] * sigmoid(z1[r, h])
    multiply(h1, w2, z2)
    for r in range(rows):
        for h in range(width):
            z = z2[r, h] + b2[h]
            g = sigmoid(z)
            z2[r, h] = s.spread_j * w3[0, h] * g * (ONE + z * (ONE - g))
    product_back(z2, w2, back)
    for r in range(rows):
        for h in range(width):
            z = z1[r, h]
            g = sigmoid(z)
            back[r, h] *= g * (ONE + z * (ONE - g))
    towards = reshape(scratch.inputs, 2 * rows, k)[rows:]
    product_back(back, w1[:k], towards)
    for r in range(rows):
        pull_back(s, own, zeta[r], x[r], towards[r], scratch.slope[r])
        if s.anchored:
            add_drive_slope(s, zeta[r], scratch.mixed, scratch.slope[r])


@inlined
def pull_back(s, own, zeta, x, towards, slope):
    """Fill slope (D,) with the derivative by zeta (D,), given the one `towards` its inputs x (k,)."""
    base = len(s.plain) + 2 * len(s.angle)
    slope[:] = ZERO
    at = 0
    for p in s.plain:
        slope[p] = towards[at] * s.inverse[p]
        at += 1
    for p in s.angle:
        slope[p] = x[at] * towards[at + len(s.angle)] - x[at + len(s.angle)] * towards[at]
        at += 1
    for c in range(len(x) - base):
        pull = towards[base + c] * x[base + c] * s.sharp
        slope[s.place[0]] += pull * (own.centres[0, c] - zeta[s.place[0]])
        slope[s.place[1]] += pull * (own.centres[1, c] - zeta[s.place[1]])


@inlined
def first_order_scores(s, own, zeta, open_, scratch, out):
    """Fill out (b, M) with d + dJ/dzeta . f of the open movements at zeta (b, D), infinity for the others."""
    rows, parts = zeta.shape
    slopes(s, own, zeta, scratch)
    second = hidden_layer(s, own, zeta, scratch)
    _, _, _, _, w3, b3 = layers(own.f, inputs_of(s, own), s.width)
    raw = reshape(scratch.outputs, rows, len(w3))
    if rows > FEW:
        product_back(second, w3, raw)
    ahead = scratch.ahead[0]
    for r in range(rows):
        for m in range(s.movements):
            out[r, m] = np.inf
            if not open_[r, m]:
                continue
            o = m * s.outputs
            if rows <= FEW:
                for v in range(o, o + s.outputs):
                    raw[r, v] = output(second[r], w3[v], ZERO)
            tau = (raw[r, o + parts] + b3[o + parts]) * s.unit[parts]
            tau = min(max(tau, s.dt), LONGEST)
            climb = ZERO
            for v in range(parts):
                rate = (raw[r, o + v] + b3[o + v]) * s.unit[v] / tau
                ahead[v] = zeta[r, v] + rate * s.dt
                climb += scratch.slope[r, v] * rate
            out[r, m] = drive(s, ahead, scratch.mixed) - climb / s.log_gamma


@inlined
def executed_pace(s, own, zeta, movement, scratch, pace):
    """Fill pace (b, D) with f, per unit of time, of the movement executed at each zeta (b, D)."""
    parts = zeta.shape[1]
    second = hidden_layer(s, own, zeta, scratch)
    _, _, _, _, w3, b3 = layers(own.f, inputs_of(s, own), s.width)
    for r in range(len(zeta)):
        o = max(movement[r], 0) * s.outputs
        tau = output(second[r], w3[o + parts], b3[o + parts]) * s.unit[parts]
        tau = min(max(tau, s.dt), LONGEST)
        for v in range(parts):
            pace[r, v] = output(second[r], w3[o + v], b3[o + v]) * s.unit[v] / tau


@inlined
def add_climb(s, zeta, pace, tangent, head, residual, scratch):
    """Return residual + dJn/dzeta . f / ln(gamma) at one zeta (D,) with f = pace (D,).

    `tangent` (H,) is that of J's last hidden layer along f, `head` (H,) the weights of its output.
    """
    residual += s.spread_j * output(tangent, head, ZERO) / s.log_gamma
    if s.anchored:
        slope = scratch.slope[0]
        slope[:] = ZERO
        add_drive_slope(s, zeta, scratch.mixed, slope)
        for v in range(len(zeta)):
            residual += slope[v] * pace[v] / s.log_gamma
    return residual


@inlined
def tangents(s, own, zeta, x, pace, tangent):
    """Fill tangent (b, k): how the inputs x change per unit of time when zeta changes at `pace` (b, D)."""
    base = len(s.plain) + 2 * len(s.angle)
    for r in range(len(x)):
        at = 0
        for p in s.plain:
            tangent[r, at] = pace[r, p] * s.inverse[p]
            at += 1
        for p in s.angle:
            tangent[r, at] = -x[r, at + len(s.angle)] * pace[r, p]
            tangent[r, at + len(s.angle)] = x[r, at] * pace[r, p]
            at += 1
        for c in range(x.shape[1] - base):
            gap_x, gap_y = own.centres[0, c] - zeta[r, s.place[0]], own.centres[1, c] - zeta[r, s.place[1]]
            nearing = gap_x * pace[r, s.place[0]] + gap_y * pace[r, s.place[1]]
            tangent[r, base + c] = x[r, base + c] * s.sharp * nearing


@within
def activate_tangents(z, out, b):
    """Fill the rows of out (2 b, H) below the first b with the tangents of silu(z), given those of z (2 b, H)."""
    for r in range(b, len(z)):
        for h in range(z.shape[1]):
            at = z[r - b, h]
            g = sigmoid(at)
            out[r, h] = z[r, h] * g * (ONE + at * (ONE - g))


@within
def deactivate_tangents(z, up, b):
    """Take the gradient `up` (2 b, H) of silu's tangents back to z and its tangents, after `deactivate`, in place."""
    for r in range(len(z) - b):
        for h in range(z.shape[1]):
            at = z[r, h]
            g = sigmoid(at)
            up[r, h] += up[b + r, h] * z[b + r, h] * g * (ONE - g) * (TWO + at * (ONE - TWO * g))
            up[b + r, h] *= g * (ONE + at * (ONE - g))
