"""Bodies, walls and contacts; the only file that imports pymunk.

Bodies are circles, walls are segments that no body's centre crosses on its way. A command is a velocity; it
is given to the solver as a force before the positions move, so contacts correct the velocity and the corrected
one is what moves the body. All bodies go through one buffer per substep, never one by one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pymunk
import pymunk.batch

from ecology import elementary
from ecology.compiler_cache import compiled, use_cache, within
from ecology.elementary import cosine_and_sine
from ecology.ground import Ground, walls
from ecology.ground.outline import thicken
from ecology.ground.walls import NO_WALLS, Walls, first_exit
from ecology.state import Bools, Floats

use_cache(__file__, walls.__file__, elementary.__file__)

WALL = 0.05  # radius of a thick wall's segments, length; their inner faces are the arena's edges
ROUNDED = 0.5  # of a wall's corner that thick segments may cut off at most, as a share of the smallest radius
SLOP = 0.02  # overlap that contacts tolerate, as a share of the smallest radius
REBUILD = 200  # ticks after which the solver's memory of contacts is dropped
SOLID, GHOST, WALLS = 1, 2, 4  # categories of what can touch
SPATIAL_HASH_FROM = 300  # bodies; below, pymunk's default tree is faster
NOWHERE = np.empty((0, 2))
# how often a way that a wall holds is bent, and how far from the wall it then ends at least, in radii
BENDS, ASIDE = 4, 0.5
MOVE = pymunk.batch.BodyFields.POSITION | pymunk.batch.BodyFields.VELOCITY
COMMAND = MOVE | pymunk.batch.BodyFields.FORCE
SOLVER = ("space", "shapes", "_buffer", "_command", "_moved", "_step")  # attributes that exist once bodies have moved


class Hulls(NamedTuple):
    """What keeps bodies inside: the walls, and how far from their centres bodies reach."""

    walls: Walls
    radius: Floats  # (N,)


class Physics:
    """The bodies of N slots in one arena.

    The solver remembers contacts from tick to tick. Every REBUILD ticks it is rebuilt, and what it
    was told since is kept, so that a world that is left and entered again at any tick goes on exactly.
    The solver is built, and these ticks are repeated, when bodies next move.
    """

    def __init__(
        self,
        ground: Ground,
        radius: Floats,
        solid: Bools,
        position: Floats,
        alive: Bools,
        smallest: float | None = None,
    ) -> None:
        """Place N circles of `radius` (N,) at `position` (N, 2); dead ones touch nothing, ghosts the walls only.

        `smallest` is the radius that any body can have at least; the smallest one's without.
        """
        self.ground, self.radius, self.solid = ground, radius, solid
        self.plane = ground.plane
        self.count = len(radius)
        self.smallest = smallest if smallest is not None else float(radius.min()) if self.count else 1.0
        self._hulls = Hulls(NO_WALLS if ground.torus else ground.walls, radius)
        thick = None if ground.torus else thicken(ground.polygon, WALL, ROUNDED * self.smallest)
        self._rings, self._thick = (list(ground.rings), 0.0) if thick is None else (thick, WALL)
        self.touches = not ground.torus or bool(solid.any())
        self._start(position, alive)

    def resize(self, radius: Floats, position: Floats, alive: Bools) -> None:
        """Give bodies other radii (N,), where they are; if any is another, what was remembered of contacts is gone."""
        if (radius != self.radius).any():
            self.radius, self._hulls = radius, self._hulls._replace(radius=radius)
            self._start(position, alive)

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the solver, which can be neither copied nor pickled."""
        return {name: value for name, value in self.__dict__.items() if name not in SOLVER}

    def _start(self, position: Floats, alive: Bools) -> None:
        """Drop the solver and its contacts; the next one starts with the bodies here."""
        self.recent: list[tuple[Floats, Floats, Bools]] = []  # position, velocity, alive of the ticks since
        self._started = position.copy(), alive.copy()
        self._alive = alive.copy()
        for name in SOLVER:
            self.__dict__.pop(name, None)

    def _build(self) -> None:
        position, self._alive = self._started
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
        for ring in () if self.ground.torus else self._rings:
            for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
                wall = pymunk.Segment(self.space.static_body, tuple(a), tuple(b), self._thick)
                wall.filter = pymunk.ShapeFilter(categories=WALLS)
                self.space.add(wall)
        # one row per body and one, the last, for the static body that carries the walls
        rows = self.count + (not self.ground.torus)
        self._command = np.zeros((rows, 6))
        self._moved = self._command.reshape(-1)[: 4 * rows].reshape(rows, 4)  # the solver answers in the same memory
        self._buffer = pymunk.batch.Buffer()
        self._buffer.set_float_buf(self._command)
        self._touch(np.arange(self.count), self._alive)

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
        if len(self.recent) == REBUILD:
            self._start(position, alive)
        if "space" not in self.__dict__:
            self._build()
            for tick in self.recent:
                self._solve(*tick, dt)
        self.recent.append((position, velocity, alive))
        after, held = self._solve(position, velocity, alive, dt)
        return self.plane.home(after), held

    def _solve(self, position: Floats, velocity: Floats, alive: Bools, dt: float) -> tuple[Floats, int]:
        if alive.tobytes() != self._alive.tobytes():
            changed = np.flatnonzero(alive != self._alive)
            self._touch(changed, alive[changed])
            self._alive = alive.copy()
        # damping has removed the velocities of the tick before
        substeps = command_bodies(self._command, position, velocity, dt, self.smallest)
        h = dt / substeps
        buffer, space = self._buffer, self.space
        if h != self._step:  # a fifth of an overlap goes in one unit of time; more throws crowds about
            self._step, space.collision_bias = h, float(elementary.power(0.8, 1.0 / h))
        after, held = position, 0
        seen = position.copy() if substeps > 1 else NOWHERE
        bends = self._thick == 0 or substeps == 1
        for left in range(substeps - 1, -1, -1):
            pymunk.batch.set_space_bodies(space, COMMAND, buffer)
            space.step(h)
            buffer.clear()
            pymunk.batch.get_space_bodies(space, MOVE, buffer)
            after, put_back = glide(self._moved, h, self._hulls, position, after, seen, bends, left == 0)
            held += put_back
            if left:
                command_bodies(self._command, after, velocity, dt, self.smallest)
        return after, held

    def memory(self) -> dict[str, np.ndarray]:
        """Return the solver's inputs since it was built: K ticks of position, velocity and alive."""
        n, recent = self.count, self.recent
        return {
            "told_position": np.array([p for p, _, _ in recent]).reshape(-1, n, 2),
            "told_velocity": np.array([v for _, v, _ in recent]).reshape(-1, n, 2),
            "told_alive": np.array([a for _, _, a in recent], bool).reshape(-1, n),
        }

    def remember(self, memory: Mapping[str, np.ndarray]) -> None:
        """Go through what `memory` returned again before the next move, so that contacts are what they were."""
        ticks = list(zip(*(memory[f"told_{word}"] for word in ("position", "velocity", "alive")), strict=True))
        if ticks and self.touches:
            self._start(ticks[0][0], ticks[0][2])
            self.recent, self._alive = ticks, ticks[-1][2]


# ---- compiled loops ----------------------------------------------------------------------------


@compiled
def velocities(direction: Floats, speed: Floats) -> Floats:
    """Return the velocity (n, 2) of each direction and speed (n,)."""
    found = np.empty((len(speed), 2))
    for i in range(len(speed)):
        cosine, sine = cosine_and_sine(direction[i])
        found[i, 0], found[i, 1] = cosine * speed[i], sine * speed[i]
    return found


@compiled
def fastest(velocity: Floats) -> float:
    """Return the greatest speed among velocities (n, 2)."""
    most = 0.0
    for i in range(len(velocity)):
        most = max(most, velocity[i, 0] * velocity[i, 0] + velocity[i, 1] * velocity[i, 1])
    return math.sqrt(most)


@compiled
def command_bodies(command: Floats, position: Floats, velocity: Floats, dt: float, smallest: float) -> int:
    """Write what bodies are given for a substep, (>= n, 6), and return how many substeps dt is divided into.

    They get their position, no velocity, and the force that gives unit masses their `velocity` (n, 2) in a
    substep. In one, nobody moves farther than the `smallest` radius.
    """
    substeps = max(1, math.ceil(fastest(velocity) * dt / smallest - 1e-9))
    h = dt / substeps
    for i in range(len(position)):
        command[i, 0], command[i, 1] = position[i, 0], position[i, 1]
        command[i, 2], command[i, 3] = 0.0, 0.0
        command[i, 4], command[i, 5] = velocity[i, 0] / h, velocity[i, 1] / h
    return substeps


@within
def _bend(walls: Walls, radius: float, ax: float, ay: float, bx: float, by: float) -> tuple[float, float, bool]:
    """Return where the way of a body from a to b ends, bent along walls by which it leaves, and whether it was bent."""
    start, end = walls.start, walls.end
    bent = False
    wall = first_exit(walls, ax, ay, bx, by)
    for _ in range(BENDS):
        if wall < 0:
            break
        bent = True
        x, y = end[wall, 0], end[wall, 1]
        along_x, along_y = x - start[wall, 0], y - start[wall, 1]
        length = math.sqrt(along_x * along_x + along_y * along_y)
        inward_x, inward_y = -along_y / length, along_x / length
        was = (ax - x) * inward_x + (ay - y) * inward_y  # how far from the wall
        would = (bx - x) * inward_x + (by - y) * inward_y
        back = min(max(was, ASIDE * radius), radius) - would
        bx, by = bx + back * inward_x, by + back * inward_y
        wall = first_exit(walls, ax, ay, bx, by)
    if wall >= 0:
        bx, by = ax, ay
    return bx, by, bent


@compiled
def glide(
    moved: Floats, h: float, hulls: Hulls, here: Floats, before: Floats, seen: Floats, bends: bool, last: bool
) -> tuple[Floats, int]:
    """Return where n bodies are after a substep of h, (n, 2), and how many of them are held.

    The solver returns `moved` (>= n, 4), position and velocity. A way from `before` (n, 2) that leaves the arena
    `bends` along the wall, or is not gone. After the `last` substep, neither does the straight way from `here` (n, 2),
    where the tick began: a body then ends where it was last `seen` (n, 2) from there, which is written. Held are those
    whose way was changed.
    """
    walls, radius = hulls
    start, end = walls.start, walls.end
    there = np.empty(here.shape)
    held, several = 0, not (bends and last)
    boxes = np.empty((4, len(end)))  # of the walls
    for w in range(len(end)):
        for k in range(2):
            boxes[k, w] = min(end[w, k], start[w, k])
            boxes[2 + k, w] = max(end[w, k], start[w, k])
    for i in range(len(there)):
        ax, ay, sx, sy = before[i, 0], before[i, 1], here[i, 0], here[i, 1]
        bx, by = moved[i, 0] + moved[i, 2] * h, moved[i, 1] + moved[i, 3] * h
        low_x, high_x, low_y, high_y = min(ax, bx, sx), max(ax, bx, sx), min(ay, by, sy), max(ay, by, sy)
        near = 0
        for w in range(len(end)):  # no branches: most bodies are near no wall
            near += (boxes[0, w] <= high_x) & (boxes[1, w] <= high_y) & (boxes[2, w] >= low_x) & (boxes[3, w] >= low_y)
        if near == 0 or (bx == sx and by == sy):
            there[i, 0], there[i, 1] = bx, by
            if several:
                seen[i, 0], seen[i, 1] = bx, by
            continue
        changed = False
        if bends:
            bx, by, changed = _bend(walls, radius[i], ax, ay, bx, by)
        if several or ax != sx or ay != sy:  # else it has just been looked at
            if first_exit(walls, sx, sy, bx, by) < 0:
                seen[i, 0], seen[i, 1] = bx, by
            elif last:
                changed = True
                bx, by = seen[i, 0], seen[i, 1]
        there[i, 0], there[i, 1] = bx, by
        held += changed
    return there, held
