"""Ground: the arena compiled once, walls in arrays, and what is asked of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ecology import elementary
from ecology.ground.outline import polygon_of, rings_of
from ecology.ground.plane import Plane, plane_of
from ecology.ground.scatter import scatter_in
from ecology.ground.walls import Walls, clear_lines, inside_rings, reaches, stay_inside, walls_of
from ecology.spec import Arena
from ecology.state import Bools, Floats

MIRRORS = 8  # reflections in one step, after which a point stays where it was


@dataclass(frozen=True, eq=False)
class Ground:
    """The shape of an arena of W walls."""

    plane: Plane
    polygon: Any  # shapely: the arena, holes and inner walls cut out
    rings: tuple[Floats, ...]  # (k, 2) corners in order, the outer ring first; the sides of an inner wall are a ring
    walls: Walls
    open: bool  # whether no wall can come between two points

    @property
    def torus(self) -> bool:
        """Return whether an agent that leaves on one side comes in on the other."""
        return self.plane.torus

    def inside(self, points: Floats) -> Bools:
        """Return which points (n, 2) lie in the arena, (n,); all of them on a torus."""
        if self.torus:
            return np.ones(len(points), bool)
        return inside_rings(self.walls, np.asarray(points, float))

    def stays(self, here: Floats, there: Floats) -> Bools:
        """Return which straight ways from here to there (n, 2), which begin in the arena, stay in it, (n,)."""
        return stay_inside(self.walls, here, there)

    def clear(self, here: Floats, there: Floats) -> Bools:
        """Return which straight segments from here to there (n, 2) cross no wall, (n,)."""
        if self.open:
            return np.ones(len(here), bool)
        return clear_lines(self.walls, here, there)

    def reach(self, place: Floats, ways: Floats, far: float) -> Floats:
        """Return the distances (k,) from a place (2,) along unit vectors (k, 2) to the nearest wall, at most `far`."""
        if self.torus:
            return np.full(len(ways), far)
        return reaches(self.walls, np.asarray(place, float), ways, far)

    def room(self, points: Floats) -> Floats:
        """Return how far points (n, 2) are from the nearest wall, (n,)."""
        start, _, along = self.walls
        offset = points[:, None] - start
        share = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
        return elementary.hypot(*np.moveaxis(offset - share[..., None] * along, -1, 0)).min(axis=1)

    def scatter(self, margin: float, count: int, rng: np.random.Generator) -> Floats:
        """Return points (count, 2), uniform over the arena and at least `margin` from its walls."""
        if not count:
            return np.empty((0, 2))
        margin = 0.0 if self.torus else margin
        room = self.polygon.buffer(-margin, join_style="mitre")
        return scatter_in(room, count, rng, f"{margin!r} away from every wall")

    def reflect(self, here: Floats, step: Floats) -> Floats:
        """Return where a point `here` (2,) ends after `step` (2,), mirrored at the walls, (2,)."""
        begin, wall = here, self.walls.along
        there, last = here + step, -1
        for _ in range(MIRRORS):
            along, offset = there - here, self.walls.start - here
            cross = along[0] * wall[:, 1] - along[1] * wall[:, 0]
            parallel = cross == 0
            cross = np.where(parallel, 1.0, cross)
            t = (offset[:, 0] * wall[:, 1] - offset[:, 1] * wall[:, 0]) / cross  # of the way
            s = (offset[:, 0] * along[1] - offset[:, 1] * along[0]) / cross  # of the wall
            t = np.where(parallel | (t < 0) | (t > 1) | (s < 0) | (s > 1), np.inf, t)
            if last >= 0:
                t[last] = np.inf  # it starts on the wall that it was mirrored at
            hit = int(np.argmin(t))
            if not np.isfinite(t[hit]):
                break
            normal = np.array([-wall[hit, 1], wall[hit, 0]]) / elementary.hypot(*wall[hit])
            here, last = here + t[hit] * along, hit
            there = there - 2.0 * ((there - here) @ normal) * normal
        else:
            return begin
        return there if self.inside(there[None])[0] else begin


def ground_of(arena: Arena) -> Ground:
    """Return the ground of `arena`."""
    rings = rings_of(arena)
    x, y = (np.roll(rings[0], -1, axis=0) - rings[0]).T
    convex = len(rings) == 1 and bool((x * np.roll(y, -1) >= y * np.roll(x, -1)).all())  # no corner turns to the right
    return Ground(
        plane=plane_of(arena),
        polygon=polygon_of(arena),
        rings=tuple(rings),
        walls=walls_of(rings),
        open=convex or arena.torus,
    )


def scatter(arena: Arena, margin: float, count: int, rng: np.random.Generator) -> Floats:
    """Return points (count, 2), uniform over `arena` and at least `margin` from its walls."""
    return ground_of(arena).scatter(margin, count, rng)
