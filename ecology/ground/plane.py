"""The plane that bodies live in: with walls, or a torus; and angles in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ecology import elementary
from ecology.compiler_cache import use_cache, within
from ecology.spec import Arena
from ecology.state import Floats

use_cache(__file__)


@dataclass(frozen=True)
class Plane:
    """The extent of an arena, and how one goes from here to there."""

    low: Floats  # (2,)
    size: Floats  # (2,)
    torus: bool

    @cached_property
    def period(self) -> Floats:
        """Return the length after which the plane begins again along each axis, (2,); 0 with walls."""
        return self.size * self.torus

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
    return Plane(low, high - low, arena.torus)


def wrap(angle: Floats) -> Floats:
    """Return the angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


@within
def wrap_angle(angle: float) -> float:
    """Return an angle of at most three half turns in [-pi, pi)."""
    angle += math.pi
    if angle >= 2 * math.pi:
        angle -= 2 * math.pi
    elif angle < 0.0:
        angle += 2 * math.pi
    return angle - math.pi


@within
def way_along(a: float, b: float, period: float) -> float:
    """Return the shortest way from a to b along one axis of a plane that begins again after `period`, 0: never."""
    d = b - a
    return d - period * np.round(d / period) if period > 0.0 else d
