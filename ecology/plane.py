"""The plane that bodies live in: with walls, or a torus."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ecology import elementary
from ecology.spec import Arena
from ecology.state import Floats


@dataclass(frozen=True)
class Plane:
    """The extent of an arena, and how one goes from here to there."""

    low: Floats  # (2,)
    size: Floats  # (2,)
    torus: bool

    @property
    def diagonal(self) -> float:
        """Return the farthest that two points can be from each other."""
        return float(elementary.hypot(*self.size)) / (2 if self.torus else 1)

    def gap(self, start: Floats, end: Floats) -> Floats:
        """Return the shortest way from start to end (..., 2), as a vector."""
        way = end - start
        return way - self.size * np.round(way / self.size) if self.torus else way

    def home(self, points: Floats) -> Floats:
        """Return points (..., 2) brought back in over the seam of a torus; as they are with walls."""
        if not self.torus:
            return points
        inside = (points - self.low) % self.size
        return self.low + np.where(inside < self.size, inside, 0.0)  # a remainder may round up to the size


def plane_of(arena: Arena) -> Plane:
    """Return the plane of `arena`."""
    low, high = np.array(arena.extent, dtype=float)
    return Plane(low, high - low, not arena.walls)


def corners_of(arena: Arena) -> Floats:
    """Return the corners of `arena` (W, 2), in the order that has the arena on the left of every wall."""
    corners = np.array(arena.vertices, dtype=float)
    x, y = (corners - corners[0]).T
    return corners if (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0 else corners[::-1].copy()
