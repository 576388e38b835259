"""Bodies, walls and contacts; the only file that imports pymunk.

Bodies are circles, walls are segments. A command is a velocity; it is given to the solver as a
force before the positions move, so contacts correct the velocity and the corrected one is what
moves the body. All bodies go through one buffer per substep, never one by one.
"""

from __future__ import annotations

import math

import numpy as np
import pymunk
import pymunk.batch

from ecology.spec import Arena
from ecology.state import Bools, Floats

WALL = 0.05  # radius of a wall's segments, length; their inner faces are the arena's edges
SLOP = 0.02  # overlap that contacts tolerate, as a share of the smallest radius
SPATIAL_HASH_FROM = 300  # bodies; below, pymunk's default tree is faster
MOVE = pymunk.batch.BodyFields.POSITION | pymunk.batch.BodyFields.VELOCITY
COMMAND = MOVE | pymunk.batch.BodyFields.FORCE


class Physics:
    """The bodies of N slots in the walls of one arena."""

    def __init__(self, arena: Arena, radius: Floats, position: Floats, alive: Bools) -> None:
        """Place N circles of `radius` (N,) at `position` (N, 2); dead ones touch nothing."""
        self.radius = radius
        self.count = len(radius)
        self.smallest = float(radius.min()) if self.count else 1.0
        self.vertices = np.array(arena.vertices, dtype=float)
        self.space = pymunk.Space()
        self.space.damping = 0.0  # a body without a command does not glide
        self.space.collision_slop = SLOP * self.smallest
        if self.count > SPATIAL_HASH_FROM:
            self.space.use_spatial_hash(2.5 * float(radius.max()), 2 * self.count)
        self.shapes = []
        for i in range(self.count):
            body = pymunk.Body(1.0, math.inf)
            body.position = tuple(position[i])
            shape = pymunk.Circle(body, float(radius[i]))
            self.space.add(body, shape)
            self.shapes.append(shape)
        walls = _outward(self.vertices, WALL)
        for a, b in zip(walls, np.roll(walls, -1, axis=0), strict=True):
            self.space.add(pymunk.Segment(self.space.static_body, tuple(a), tuple(b), WALL))
        # one row per body and one, the last, for the static body that carries the walls
        self._command = np.zeros((self.count + 1, 6))
        self._buffer = pymunk.batch.Buffer()
        self.touch(np.arange(self.count), alive)

    def touch(self, slots: np.ndarray, alive: Bools) -> None:
        """Let the bodies of `slots` collide where `alive` (len(slots),), and pass through all else."""
        for slot, there in zip(slots, alive, strict=True):
            self.shapes[slot].filter = pymunk.ShapeFilter() if there else pymunk.ShapeFilter(mask=0)

    def move(self, position: Floats, velocity: Floats, dt: float) -> tuple[Floats, int]:
        """Return positions (N, 2) after `dt` at the commanded `velocity` (N, 2), and the count put back.

        Substeps are as many as keep a body from moving farther than the smallest radius in one.
        A body that would end outside the arena stays where it was: the guarantee, counted.
        """
        fastest = math.sqrt(float(np.max(np.einsum("ij,ij->i", velocity, velocity)))) if self.count else 0.0
        substeps = max(1, math.ceil(fastest * dt / self.smallest - 1e-9))
        h = dt / substeps
        command, buffer, space = self._command, self._buffer, self.space
        space.collision_bias = 0.8 ** (1.0 / h)  # a fifth of an overlap goes in one; more throws crowds about
        after = position
        for _ in range(substeps):
            command[:-1, 0:2] = after
            command[:-1, 2:4] = 0.0
            command[:-1, 4:6] = velocity / h  # force for unit mass; damping has removed the rest
            buffer.set_float_buf(command)
            pymunk.batch.set_space_bodies(space, COMMAND, buffer)
            space.step(h)
            buffer.clear()
            pymunk.batch.get_space_bodies(space, MOVE, buffer)
            moved = np.frombuffer(buffer.float_buf(), dtype=np.float64).reshape(-1, 4)[:-1]
            after = moved[:, 0:2] + moved[:, 2:4] * h
        outside = ~inside_polygon(self.vertices, after)
        count = int(np.count_nonzero(outside))
        if count:
            after[outside] = position[outside]
        return after, count


def inside_polygon(vertices: Floats, points: Floats) -> Bools:
    """Return which points (n, 2) lie strictly inside the polygon (W, 2): crossings of a ray, (n,)."""
    x, y = points[:, 0, None], points[:, 1, None]
    x1, y1 = vertices[:, 0], vertices[:, 1]
    x2, y2 = vertices[np.arange(-1, len(vertices) - 1)].T  # the vertex before
    above = y1 > y  # (n, W)
    spans = above != (y2 > y)
    rise = y2 - y1
    # the ray from (x, y) to the right crosses the edge: x < x1 + (y - y1) (x2 - x1) / rise
    left = ((x - x1) * rise < (y - y1) * (x2 - x1)) == (rise > 0)
    return (np.count_nonzero(spans & left, axis=1) & 1).astype(bool)


def _outward(vertices: Floats, by: float) -> Floats:
    """Return the polygon whose edges lie `by` outside those of `vertices`."""
    import shapely  # slow to load, needed once per world

    grown = shapely.Polygon(vertices).buffer(by, join_style="mitre", mitre_limit=10.0)
    return np.array(grown.exterior.coords)[:-1]
