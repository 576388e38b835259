"""Bodies, walls and contacts; the only file that imports pymunk.

Bodies are circles, walls are segments that no body's centre crosses on its way. A command is a velocity; it
is given to the solver as a force before the positions move, so contacts correct the velocity and the corrected
one is what moves the body. All bodies go through one buffer per substep, never one by one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pymunk
import pymunk.batch

from ecology import elementary
from ecology.kernels import command_bodies, fastest, glide
from ecology.plane import corners_of, plane_of
from ecology.spec import Arena
from ecology.state import Bools, Floats

WALL = 0.05  # radius of a thick wall's segments, length; their inner faces are the arena's edges
ROUNDED = 0.5  # of a wall's corner that thick segments may cut off at most, as a share of the smallest radius
SLOP = 0.02  # overlap that contacts tolerate, as a share of the smallest radius
REBUILD = 200  # ticks after which the solver's memory of contacts is dropped
SOLID, GHOST, WALLS = 1, 2, 4  # categories of what can touch
SPATIAL_HASH_FROM = 300  # bodies; below, pymunk's default tree is faster
NOWHERE = np.empty((0, 2))
MOVE = pymunk.batch.BodyFields.POSITION | pymunk.batch.BodyFields.VELOCITY
COMMAND = MOVE | pymunk.batch.BodyFields.FORCE
SOLVER = ("space", "shapes", "_buffer", "_command", "_step")  # attributes that a copy builds anew


class Physics:
    """The bodies of N slots in one arena.

    The solver remembers contacts from tick to tick. Every REBUILD ticks it is built anew, and what it
    was told since is kept, so that a world that is left and entered again at any tick goes on exactly.
    A copy builds its solver when it first moves, and then repeats these ticks.
    """

    def __init__(self, arena: Arena, radius: Floats, solid: Bools, position: Floats, alive: Bools) -> None:
        """Place N circles of `radius` (N,) at `position` (N, 2); dead ones touch nothing, ghosts the walls only."""
        self.arena, self.radius, self.solid = arena, radius, solid
        self.plane = plane_of(arena)
        self.count = len(radius)
        self.smallest = float(radius.min()) if self.count else 1.0
        self.corners = corners_of(arena) if arena.walls else NOWHERE
        thick = _outward(arena, ROUNDED * self.smallest)
        self._walls, self._thick = (self.corners, 0.0) if thick is None else (thick, WALL)
        self.touches = arena.walls or bool(solid.any())
        self._build(position, alive)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the solver, which can be neither copied nor pickled."""
        return {name: value for name, value in self.__dict__.items() if name not in SOLVER}

    def _build(self, position: Floats, alive: Bools) -> None:
        self.told: list[tuple[Floats, Floats, Bools]] = []  # position, velocity, alive of the ticks since
        self._built = position.copy(), alive.copy()
        self._alive = alive.copy()
        if not self.touches:
            return
        self.space = pymunk.Space()
        self._step = 0.0  # duration for which the space is set up
        self.space.damping = 0.0  # a body without a command does not glide
        self.space.collision_slop = SLOP * self.smallest
        if self.count > SPATIAL_HASH_FROM:
            self.space.use_spatial_hash(2.5 * float(self.radius.max()), 2 * self.count)
        bodies = [pymunk.Body(1.0, math.inf) for _ in range(self.count)]
        self.shapes = [pymunk.Circle(body, r) for body, r in zip(bodies, self.radius.tolist(), strict=True)]
        for body, place in zip(bodies, position.tolist(), strict=True):
            body.position = place
        self.space.add(*bodies, *self.shapes)
        if self.arena.walls:
            for a, b in zip(self._walls, np.roll(self._walls, -1, axis=0), strict=True):
                wall = pymunk.Segment(self.space.static_body, tuple(a), tuple(b), self._thick)
                wall.filter = pymunk.ShapeFilter(categories=WALLS)
                self.space.add(wall)
        # one row per body and one, the last, for the static body that carries the walls
        self._rows = self.count + self.arena.walls
        self._command = np.zeros((self._rows, 6))
        self._buffer = pymunk.batch.Buffer()
        self._touch(np.arange(self.count), alive)

    def _touch(self, slots: np.ndarray, alive: Bools) -> None:
        """Let the bodies of `slots` collide where `alive` (len(slots),), and pass through all else."""
        touching = [pymunk.ShapeFilter(categories=GHOST, mask=WALLS), pymunk.ShapeFilter(0, SOLID, SOLID | WALLS)]
        nothing = pymunk.ShapeFilter(mask=0)
        for slot, solid, there in zip(slots.tolist(), self.solid[slots].tolist(), alive.tolist(), strict=True):
            self.shapes[slot].filter = touching[solid] if there else nothing

    def move(self, position: Floats, velocity: Floats, dt: float, alive: Bools | None = None) -> tuple[Floats, int]:
        """Return positions (N, 2) after `dt` at the commanded `velocity` (N, 2), and the count put back.

        `alive` (N,) are who can be touched from now on; who could be before when None.
        Substeps are as many as keep a body from moving farther than the smallest radius in one.
        A body whose way would cross a wall is led along it, or stays where it was: the guarantee, counted.
        """
        if not self.touches:
            return self.plane.home(position + velocity * dt), 0
        alive = self._alive if alive is None else alive
        if len(self.told) == REBUILD:
            self._build(position, alive)
        elif "space" not in self.__dict__:
            self._rebuild(dt)
        self.told.append((position, velocity, alive))
        after, held = self._solve(position, velocity, alive, dt)
        return self.plane.home(after), held

    def _solve(self, position: Floats, velocity: Floats, alive: Bools, dt: float) -> tuple[Floats, int]:
        changed = np.flatnonzero(alive != self._alive)
        if changed.size:
            self._touch(changed, alive[changed])
            self._alive = alive.copy()
        substeps = max(1, math.ceil(fastest(velocity) * dt / self.smallest - 1e-9))
        h = dt / substeps
        buffer, space = self._buffer, self.space
        if h != self._step:  # a fifth of an overlap goes in one unit of time; more throws crowds about
            self._step, space.collision_bias = h, float(elementary.power(0.8, 1.0 / h))
        after, held = position, 0
        seen = position.copy() if substeps > 1 else NOWHERE
        bends = self._thick == 0 or substeps == 1
        for left in range(substeps - 1, -1, -1):
            command_bodies(self._command, after, velocity, h)  # damping has removed the velocity before
            buffer.set_float_buf(self._command)
            pymunk.batch.set_space_bodies(space, COMMAND, buffer)
            space.step(h)
            buffer.clear()
            pymunk.batch.get_space_bodies(space, MOVE, buffer)
            moved = np.frombuffer(buffer.float_buf(), dtype=np.float64).reshape(-1, 4)
            after, corrected = glide(
                moved, self.count, h, self.corners, self.radius, position, after, seen, bends, left == 0
            )
            held += corrected
        return after, held

    def memory(self) -> dict[str, np.ndarray]:
        """Return what the solver was told since it was built: K ticks of position, velocity and alive."""
        n, told = self.count, self.told
        return {
            "told_position": np.array([p for p, _, _ in told]).reshape(-1, n, 2),
            "told_velocity": np.array([v for _, v, _ in told]).reshape(-1, n, 2),
            "told_alive": np.array([a for _, _, a in told], bool).reshape(-1, n),
        }

    def remember(self, memory: Mapping[str, np.ndarray], dt: float) -> None:
        """Go through what `memory` returned again, so that the solver's contacts are what they were."""
        ticks = list(zip(*(memory[f"told_{word}"] for word in ("position", "velocity", "alive")), strict=True))
        if ticks and self.touches:
            self._build(ticks[0][0], ticks[0][2])
            self._repeat(ticks, dt)

    def _rebuild(self, dt: float) -> None:
        """Build the solver of a copy as that of the original was, with the contacts that it had."""
        ticks = self.told
        self._build(*self._built)
        self._repeat(ticks, dt)

    def _repeat(self, ticks: list[tuple[Floats, Floats, Bools]], dt: float) -> None:
        for position, velocity, alive in ticks:
            self.told.append((position, velocity, alive))
            self._solve(position, velocity, alive, dt)


def _outward(arena: Arena, cut: float) -> Floats | None:
    """Return the corners (W, 2) of a polygon whose edges lie WALL outside those of `arena`.

    None where more than `cut` of a wall would be left out, because it is too thin or too pointed, or without walls.
    """
    import shapely  # slow to load, needed once per world

    if not arena.walls:
        return None
    polygon = shapely.Polygon(arena.vertices)
    grown = polygon.buffer(WALL, join_style="mitre", mitre_limit=10.0).exterior
    return np.array(grown.coords)[:-1] if grown.buffer(WALL + cut).covers(polygon.exterior) else None
