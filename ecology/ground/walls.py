"""Compiled loops over walls: what lies inside, which ways and looks they cross."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ecology.compiler_cache import compiled, use_cache, within
from ecology.state import Bools, Floats, Ints

use_cache(__file__)


class Walls(NamedTuple):
    """W straight walls. A wall goes from its start to its end, and has the arena on its left."""

    start: Floats  # (W, 2)
    end: Floats  # (W, 2)
    along: Floats  # (W, 2) from start to end


NO_WALLS = Walls(*np.empty((3, 0, 2)))


def walls_of(rings: Sequence[Floats]) -> Walls:
    """Return the walls of closed rings of corners, (k, 2) each."""
    start, end = np.concatenate([np.roll(ring, 1, axis=0) for ring in rings]), np.concatenate(rings)
    return Walls(start, end, end - start)


@compiled
def inside_rings(walls: Walls, points: Floats) -> Bools:
    """Return which points (n, 2) lie strictly inside rings of walls: odd crossings of a ray to the right, (n,)."""
    start, end = walls.start, walls.end
    found = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        odd = False
        for w in range(len(end)):
            x1, y1, x2, y2 = end[w, 0], end[w, 1], start[w, 0], start[w, 1]
            if (y1 > y) != (y2 > y):
                rise = y2 - y1
                # the ray from (x, y) crosses the edge where x < x1 + (y - y1) (x2 - x1) / rise
                if ((x - x1) * rise < (y - y1) * (x2 - x1)) == (rise > 0):
                    odd = not odd
        found[i] = odd
    return found


@within
def first_exit(walls: Walls, ax: float, ay: float, bx: float, by: float) -> int:
    """Return the first wall by which the way from a to b leaves the arena, -1 none.

    The side of a line that a point lies on is computed by one formula, for both walls of a corner and for both ways
    that meet in a point, so no way slips through between two walls. A way that touches a corner or ends on a wall
    leaves.
    """
    start, end = walls.start, walls.end
    found, first = -1, np.inf
    low_x, high_x, low_y, high_y = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
    dx, dy = bx - ax, by - ay
    for w in range(len(end)):
        x1, y1, x2, y2 = start[w, 0], start[w, 1], end[w, 0], end[w, 1]
        if max(x1, x2) < low_x or min(x1, x2) > high_x or max(y1, y2) < low_y or min(y1, y2) > high_y:
            continue
        before = (x2 - x1) * (ay - y2) - (y2 - y1) * (ax - x2)
        after = (x2 - x1) * (by - y2) - (y2 - y1) * (bx - x2)
        if not before > 0 or after > 0:
            continue
        one, other = dx * (y1 - ay) - dy * (x1 - ax), dx * (y2 - ay) - dy * (x2 - ax)
        if (one > 0 and other > 0) or (one < 0 and other < 0):
            continue
        share = before / (before - after)
        if share < first:
            found, first = w, share
    return found


@compiled
def stay_inside(walls: Walls, here: Floats, there: Floats) -> Bools:
    """Return which straight ways from here to there (n, 2), which begin in the arena, stay in it, (n,)."""
    found = np.empty(len(here), np.bool_)
    for i in range(len(here)):
        found[i] = first_exit(walls, here[i, 0], here[i, 1], there[i, 0], there[i, 1]) < 0
    return found


@within
def _crosses(ax: float, ay: float, ox: float, oy: float, bx: float, by: float) -> bool:
    """Return whether t a = o + s b for some t and s in [0, 1]; o is where b starts, seen from where a starts."""
    cross = ax * by - ay * bx
    t, s = ox * by - oy * bx, ox * ay - oy * ax
    if cross < 0:
        cross, t, s = -cross, -t, -s
    return cross > 0 and 0 <= t <= cross and 0 <= s <= cross


@within
def is_clear(walls: Walls, here: Floats, there: Floats) -> bool:
    """Return whether the straight segment from here to there (2,) crosses no wall."""
    start, along = walls.start, walls.along
    ax, ay = there[0] - here[0], there[1] - here[1]
    for w in range(len(start)):
        if _crosses(ax, ay, start[w, 0] - here[0], start[w, 1] - here[1], along[w, 0], along[w, 1]):
            return False
    return True


@compiled
def clear_lines(walls: Walls, here: Floats, there: Floats) -> Bools:
    """Return which straight segments from here to there (m, 2) cross no wall, (m,)."""
    found = np.empty(len(here), np.bool_)
    for m in range(len(here)):
        found[m] = is_clear(walls, here[m], there[m])
    return found


@within
def reach(walls: Walls, x: float, y: float, dx: float, dy: float, far: float) -> float:
    """Return the distance from (x, y) along the unit vector (dx, dy) to the nearest wall, at most `far`."""
    start, along = walls.start, walls.along
    best = far
    for w in range(len(start)):
        bx, by = along[w, 0], along[w, 1]
        ox, oy = start[w, 0] - x, start[w, 1] - y
        cross = dx * by - dy * bx
        if cross == 0.0:
            continue
        way, share = (ox * by - oy * bx) / cross, (ox * dy - oy * dx) / cross
        if 0.0 <= way < best and 0.0 <= share <= 1.0:
            best = way
    return best


@compiled
def reaches(walls: Walls, place: Floats, ways: Floats, far: float) -> Floats:
    """Return the distances (k,) from a place (2,) along unit vectors (k, 2) to the nearest wall, at most `far`."""
    found = np.empty(len(ways))
    for k in range(len(ways)):
        found[k] = reach(walls, place[0], place[1], ways[k, 0], ways[k, 1], far)
    return found


@within
def near_walls(walls: Walls, place: Floats, far: float, near: Ints) -> int:
    """Write the walls that may come nearer than `far` to a place into `near` (W,), and return how many they are."""
    start, along = walls.start, walls.along
    count = 0
    far += 1e-9
    x, y = place[0], place[1]
    for w in range(len(start)):
        x1, y1 = start[w, 0], start[w, 1]
        x2, y2 = x1 + along[w, 0], y1 + along[w, 1]
        if min(x1, x2) <= x + far and max(x1, x2) >= x - far and min(y1, y2) <= y + far and max(y1, y2) >= y - far:
            near[count] = w
            count += 1
    return count


@within
def is_hidden(walls: Walls, here: Floats, there: Floats, near: Ints, count: int) -> bool:
    """Return whether one of the first `count` walls of `near` lies between two places."""
    start, along = walls.start, walls.along
    ax, ay = there[0] - here[0], there[1] - here[1]
    for at in range(count):
        w = near[at]
        if _crosses(ax, ay, start[w, 0] - here[0], start[w, 1] - here[1], along[w, 0], along[w, 1]):
            return True
    return False
