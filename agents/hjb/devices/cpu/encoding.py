"""Encode a state: its drive and the inputs of the networks."""

from __future__ import annotations

import numpy as np

from ecology.agents.hjb.devices import records
from ecology.agents.hjb.devices.cpu.arithmetic import HALF, ONE, ZERO, F, exp32, raise_to
from ecology.agents.hjb.devices.cpu.compiler import within
from ecology.elementary import cosine_and_sine

SILENT = F(records.SILENT)


@within
def part_of_bent_drive(s, y, v):
    """Return |b y|^n, the part that the deviation y of component v has in a drive that is not the paper's."""
    size = y * s.above[v] if y > ZERO else -y
    return raise_to(size, s.power) if size > ZERO else ZERO


@within
def slope_of_bent_drive(s, y, v):
    """Return the slope of `part_of_bent_drive` along y, divided by n."""
    size = y * s.above[v] if y > ZERO else -y
    if size <= ZERO:
        return ZERO
    steep = raise_to(size, s.power - ONE)
    return steep * s.above[v] if y > ZERO else -steep


@within
def drive(s, zeta, mixed):
    """Return d(zeta) for one zeta (D,); `mixed` (D,) is room to work in."""
    mixed[:] = ZERO
    for e in range(len(s.mix_from)):
        mixed[s.mix_to[e]] += s.mix_weight[e] * zeta[s.mix_from[e]]
    total, felt = s.epsilon, ZERO
    for v in range(len(mixed)):
        total += part_of_bent_drive(s, mixed[v], v) if s.bent else mixed[v] * mixed[v]
        felt += s.felt[v] * zeta[v]
    return raise_to(total, s.root) + felt


@within
def features(s, zeta, centres, x):
    """Fill the network inputs x (b, k) of zeta (b, D): plain, cosine and sine, place cells."""
    base = len(s.plain) + 2 * len(s.angle)
    cells = x.shape[1] - base
    for r in range(len(x)):
        row = x[r]
        at = 0
        for p in s.plain:
            row[at] = (zeta[r, p] - s.centre[p]) * s.inverse[p]
            at += 1
        for p in s.angle:
            cosine, sine = cosine_and_sine(np.float64(zeta[r, p]))
            row[at], row[at + len(s.angle)] = F(cosine), F(sine)
            at += 1
        if cells:
            here_x, here_y, sharp = zeta[r, s.place[0]], zeta[r, s.place[1]], s.sharp * HALF
            bumps, centre_x, centre_y = row[base:], centres[0], centres[1]
            for c in range(cells):
                gap_x, gap_y = here_x - centre_x[c], here_y - centre_y[c]
                bumps[c] = exp32(max(-sharp * (gap_x * gap_x + gap_y * gap_y), SILENT))
