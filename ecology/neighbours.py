"""Who is near whom: a spatial index over the living and what is read off it; pure functions of arrays."""

from __future__ import annotations

from dataclasses import dataclass

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


def find(plane: Plane, position: Floats, alive: Bools, radius: float, last: Pairs | None = None) -> Pairs:
    """Return all pairs of living slots (N,) whose centres are at most `radius` apart.

    The cost grows with the pairs, not with N squared, as long as the radius is small in the arena. There are about as
    many as the `last` time.
    """
    room = 16 + (16 * len(alive) if last is None else len(last.who) * 9 // 8)
    return Pairs(*pairs_within(position, alive, plane.low, plane.size, plane.torus, radius, room))
