"""Shortest ways of a body around walls, holes and corners: a visibility graph and Dijkstra's algorithm."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import shapely
from scipy.sparse.csgraph import dijkstra

from ecology.ground.outline import polygon_of
from ecology.spec import Arena
from ecology.state import Bools, Floats

SLACK = 0.02  # overlap with a wall that a path tolerates, length
POINTED = 1.5  # radii that a way around a pointed corner keeps from it at most

Norm = Callable[[Floats], Floats]  # (..., 2) -> (...), the cost of a straight walk


def euclid(way: Floats) -> Floats:
    """Return the length (...) of ways (..., 2)."""
    return np.hypot(way[..., 0], way[..., 1])


def gauge(angles: Floats) -> Norm:
    """Return the norm of an agent that can only walk along `angles` (k,): the way's length, tacking included.

    Its unit ball is the convex hull of the unit vectors, which must surround the origin.
    """
    angles = np.unique(np.round(np.mod(angles, 2 * math.pi), 9))
    after = np.roll(angles, -1)
    half = np.mod(after - angles, 2 * math.pi) / 2
    middle = angles + half
    normals = np.stack([np.cos(middle), np.sin(middle)]) / np.cos(half)  # (2, k)
    return lambda way: (way @ normals).max(axis=-1)


class Paths:
    """Shortest walks of a body in an arena: a visibility graph over the corners to go around, those of holes too."""

    def __init__(self, arena: Arena, radius: float) -> None:
        room = polygon_of(arena).buffer(-radius, join_style="mitre", mitre_limit=POINTED)
        parts = [shapely.geometry.polygon.orient(part) for part in getattr(room, "geoms", [room])]
        corners = []
        for ring in [ring for part in parts for ring in (part.exterior, *part.interiors)]:
            at = np.array(ring.coords)[:-1]
            came, goes = at - np.roll(at, 1, axis=0), np.roll(at, -1, axis=0) - at
            corners.append(at[came[:, 0] * goes[:, 1] - came[:, 1] * goes[:, 0] < -1e-9])
        self.corners = np.concatenate(corners)  # (c, 2) the reflex ones
        self._room = room.buffer(min(SLACK, radius / 2), join_style="mitre", mitre_limit=POINTED)
        shapely.prepare(self._room)
        self._linked = self.clear(self.corners[:, None], self.corners[None])  # (c, c)

    def fits(self, points: Floats) -> Bools:
        """Return where the body fits at `points` (..., 2), (...)."""
        return shapely.intersects_xy(self._room, points[..., 0], points[..., 1])

    def clear(self, start: Floats, end: Floats) -> Bools:
        """Return whether the body walks straight from `start` (..., 2) to `end` (..., 2), (...)."""
        start, end = np.broadcast_arrays(start, end)
        return shapely.covers(self._room, shapely.linestrings(np.stack([start, end], axis=-2)))

    def to(self, goal: Floats, norm: Norm = euclid) -> tuple[Floats, Floats]:
        """Return the points that lead to `goal` (2,), itself the last, (c + 1, 2), and the ways left."""
        points = np.concatenate([self.corners, goal[None]])
        linked = np.zeros((len(points), len(points)), bool)
        linked[:-1, :-1] = self._linked
        linked[:-1, -1] = self.clear(self.corners, goal)
        cost = np.where(linked, norm(points[None] - points[:, None]), np.inf)  # from row to column
        np.fill_diagonal(cost, np.inf)
        back = np.where(np.isfinite(cost.T), np.maximum(cost.T, 1e-12), 0.0)
        return points, dijkstra(back, indices=len(points) - 1)

    def distance(self, start: Floats, goal: tuple[float, float] | Floats, norm: Norm = euclid) -> Floats:
        """Return the walking distance (m,) from `start` (m, 2) to `goal` (2,), infinite where none leads."""
        start = np.asarray(start, float)
        points, left = self.to(np.asarray(goal, float), norm)
        way = points[None] - start[:, None]  # (m, c + 1, 2)
        seen = self.clear(start[:, None], points[None])
        return np.where(seen, norm(way) + left, np.inf).min(axis=1)
