"""Who is near whom: a spatial index over the living and what is read off it; pure functions of arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ecology.kernels import pairs_within
from ecology.plane import Plane
from ecology.state import Bools, Floats, Ints


@dataclass(frozen=True)
class Pairs:
    """P directed pairs of living slots, by `who`, and for each the nearest first."""

    who: Ints  # (P,)
    other: Ints  # (P,)
    gap: Floats  # (P, 2) from who to other
    distance: Floats  # (P,) between the centres
    starts: Ints  # (N + 1,) first pair of every slot


def find(plane: Plane, position: Floats, alive: Bools, radius: float) -> Pairs:
    """Return all pairs of living slots (N,) whose centres are at most `radius` apart.

    The cost grows with the pairs, not with N squared, as long as the radius is small in the arena.
    """
    slots = np.flatnonzero(alive)
    who, other, gap, distance = pairs_within(position[slots], plane.low, plane.size, plane.torus, radius)
    if len(slots) < len(alive):
        who, other = slots[who], slots[other]
    return Pairs(who, other, gap, distance, np.searchsorted(who, np.arange(len(alive) + 1)))
