"""Score the open movements by the HJB equation over one whole movement, with optimism about unknown places."""

from __future__ import annotations

import numpy as np

from ecology.agents.hjb.devices.cpu.arithmetic import (
    FEW,
    HALF,
    LONGEST,
    ONE,
    ZERO,
    F,
    exp32,
    output,
    product_back,
    reshape,
)
from ecology.agents.hjb.devices.cpu.compiler import within
from ecology.agents.hjb.devices.cpu.encoding import drive
from ecology.agents.hjb.devices.cpu.first_order import first_order_scores
from ecology.agents.hjb.devices.cpu.networks import deviations, hidden_layer, inputs_of, layers


@within
def is_unknown(s, own, zeta):
    """Return whether zeta (D,) lies beyond the reach of all marks."""
    for k in range(own.marked):
        gap_x, gap_y = own.marks[0, k] - zeta[s.place[0]], own.marks[1, k] - zeta[s.place[1]]
        if gap_x * gap_x + gap_y * gap_y <= own.marks[2, k]:
            return False
    return True


@within
def add_optimism(s, own, zeta, values):
    """Lower the `values` (b,) of Jn at zeta (b, D) in unknown places, as long as marks are left to set."""
    if own.optimism[0] > ZERO and 0 < own.marked < own.marks.shape[1]:
        for r in range(len(zeta)):
            if is_unknown(s, own, zeta[r]):
                values[r] -= own.optimism[0] * values[r] + own.optimism[1]


@within
def scores(s, own, zeta, open_, scratch, out):
    """Fill out (b, M) with the HJB score of the open movements, drive units; infinity for the others.

    Over a whole movement, (1 - gamma^tau) (d + d') / 2 + gamma^tau Jn(zeta'). Where f predicts the drive on the way,
    it replaces the mean of both ends.
    """
    if not s.finite:
        first_order_scores(s, own, zeta, open_, scratch, out)
        return
    rows, parts = zeta.shape
    second = hidden_layer(s, own, zeta, scratch)
    _, _, _, _, w3, b3 = layers(own.f, inputs_of(s, own), s.width)
    raw = reshape(scratch.outputs, rows, len(w3))
    if rows > FEW:  # else only what is open, below
        product_back(second, w3, raw)
    count = 0
    for r in range(rows):
        d = drive(s, zeta[r], scratch.mixed)
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
            ahead = scratch.ahead[count]
            for v in range(parts):
                change = (raw[r, o + v] + b3[o + v]) * s.unit[v]
                ahead[v] = min(max(zeta[r, v] + change, s.low[v]), s.high[v])
            keep = exp32(max(tau * s.log_gamma, F(-80.0)))
            if s.costed:
                excess = (raw[r, o + parts + 1] + b3[o + parts + 1]) * s.unit[parts + 1]
                out[r, m] = (ONE - keep) * d + excess
            else:
                out[r, m] = (ONE - keep) * HALF * (d + drive(s, ahead, scratch.mixed))
            scratch.keep[count] = keep
            scratch.which[count] = r * s.movements + m
            count += 1
    if count:
        deviations(s, own, scratch.ahead[:count], scratch)
        add_optimism(s, own, scratch.ahead[:count], scratch.outputs)
        flat = out.ravel()
        for r in range(count):
            flat[scratch.which[r]] += scratch.keep[r] * scratch.outputs[r]


@within
def expected_score(s, score):
    """Return the mean score (M,) of an agent that explores with the share `explored`, and else takes the least."""
    least, total, weight = score[0], ZERO, ZERO
    for m in range(len(score)):
        least = min(least, score[m])
        if score[m] < np.inf:
            total += score[m] / s.length[m]
            weight += ONE / s.length[m]
    if weight == ZERO:
        return least
    return least + s.explored * (total / weight - least)
