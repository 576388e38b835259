"""Loops over pairs of bodies, compiled by Numba: what arrays alone would do many times over.

Compiled once per machine and kept beside this file (or in Numba's own cache where that cannot be written).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ecology.state import Bools, Floats, Ints


@numba.njit(cache=True)
def _cell(x: float, low: float, width: float, count: int) -> int:
    return min(max(int((x - low) / width), 0), count - 1)


@numba.njit(cache=True)
def _way(a: float, b: float, size: float, torus: bool) -> float:
    d = b - a
    return d - size * np.round(d / size) if torus else d


@numba.njit(cache=True)
def pairs_within(
    points: Floats, low: Floats, size: Floats, torus: bool, radius: float
) -> tuple[Ints, Ints, Floats, Floats]:
    """Return who, other (P,), gap (P, 2) and distance (P,) of all pairs of points (n, 2) at most `radius` apart.

    By who, and for each the nearest first, ties by index. A grid of cells at least `radius` wide is searched; on a
    torus the radius must be at most a third of the size, else every pair is looked at.
    """
    n = len(points)
    nx = int(min(max(size[0] / radius, 1.0), math.sqrt(n) + 1.0))
    ny = int(min(max(size[1] / radius, 1.0), math.sqrt(n) + 1.0))
    if torus and (nx < 3 or ny < 3):
        nx = ny = 1
    wx, wy = size[0] / nx, size[1] / ny
    cell = np.empty((n, 2), np.int64)
    start = np.zeros(nx * ny + 1, np.int64)
    for i in range(n):
        cell[i, 0] = _cell(points[i, 0], low[0], wx, nx)
        cell[i, 1] = _cell(points[i, 1], low[1], wy, ny)
        start[cell[i, 0] * ny + cell[i, 1] + 1] += 1
    start = np.cumsum(start)
    fill = start[:-1].copy()
    order = np.empty(n, np.int64)
    for i in range(n):
        c = cell[i, 0] * ny + cell[i, 1]
        order[fill[c]] = i
        fill[c] += 1
    room = 16 * n + 16
    who, other = np.empty(room, np.int64), np.empty(room, np.int64)
    gap, distance = np.empty((room, 2)), np.empty(room)
    reach_x, reach_y = (1 if nx > 1 else 0), (1 if ny > 1 else 0)
    p = 0
    for i in range(n):
        first = p
        for a in range(-reach_x, reach_x + 1):
            cx = cell[i, 0] + a
            if torus:
                cx %= nx
            elif cx < 0 or cx >= nx:
                continue
            for b in range(-reach_y, reach_y + 1):
                cy = cell[i, 1] + b
                if torus:
                    cy %= ny
                elif cy < 0 or cy >= ny:
                    continue
                c = cx * ny + cy
                for k in range(start[c], start[c + 1]):
                    j = order[k]
                    if j == i:
                        continue
                    dx = _way(points[i, 0], points[j, 0], size[0], torus)
                    dy = _way(points[i, 1], points[j, 1], size[1], torus)
                    d = math.sqrt(dx * dx + dy * dy)
                    if d > radius:
                        continue
                    if p == room:
                        room *= 2
                        who, other = _longer(who, room), _longer(other, room)
                        gap_, distance_ = np.empty((room, 2)), np.empty(room)
                        gap_[:p], distance_[:p] = gap, distance
                        gap, distance = gap_, distance_
                    at = p  # insertion: the pairs of one are few
                    while at > first and (distance[at - 1] > d or (distance[at - 1] == d and other[at - 1] > j)):
                        distance[at], other[at] = distance[at - 1], other[at - 1]
                        gap[at, 0], gap[at, 1] = gap[at - 1, 0], gap[at - 1, 1]
                        at -= 1
                    distance[at], other[at], gap[at, 0], gap[at, 1] = d, j, dx, dy
                    who[p] = i
                    p += 1
    return who[:p].copy(), other[:p].copy(), gap[:p].copy(), distance[:p].copy()


@numba.njit(cache=True)
def _longer(values: Ints, room: int) -> Ints:
    longer = np.empty(room, np.int64)
    longer[: len(values)] = values
    return longer


@numba.njit(cache=True)
def clear_lines(start: Floats, end: Floats, wall_from: Floats, wall_along: Floats) -> Bools:
    """Return whether the straight segments from start to end (m, 2) cross no wall (W, 2), (m,)."""
    found = np.ones(len(start), np.bool_)
    for m in range(len(start)):
        ax, ay = end[m, 0] - start[m, 0], end[m, 1] - start[m, 1]
        for w in range(len(wall_from)):
            ox, oy = wall_from[w, 0] - start[m, 0], wall_from[w, 1] - start[m, 1]
            bx, by = wall_along[w, 0], wall_along[w, 1]
            # solve start + t along = wall_from + s wall with t and s in [0, 1]
            cross = ax * by - ay * bx
            t, s = ox * by - oy * bx, ox * ay - oy * ax
            if cross < 0:
                cross, t, s = -cross, -t, -s
            if cross > 0 and 0 <= t <= cross and 0 <= s <= cross:
                found[m] = False
                break
    return found


@numba.njit(cache=True)
def in_view(
    who: Ints,
    other: Ints,
    gap: Floats,
    distance: Floats,
    position: Floats,
    heading: Floats,
    looks: Bools,
    half_angle: Floats,
    range_: Floats,
    wall_from: Floats,
    wall_along: Floats,
    open_: bool,
) -> Bools:
    """Return which pairs (P,) are seen by `who` (N,): within angle and range of its view field, no wall between.

    `gap` (P, 2) and `distance` (P,) are the pairs'; `position`, `heading`, `looks`, `half_angle`, `range_` are by slot.
    """
    seen = np.zeros(len(who), np.bool_)
    for p in range(len(who)):
        i = who[p]
        if not looks[i] or distance[p] > range_[i]:
            continue
        if half_angle[i] < math.pi:
            turn = math.atan2(gap[p, 1], gap[p, 0]) - heading[i]
            turn = (turn + math.pi) % (2 * math.pi) - math.pi
            if abs(turn) > half_angle[i] + 1e-12:
                continue
        if not open_:
            j = other[p]
            line = clear_lines(position[i : i + 1], position[j : j + 1], wall_from, wall_along)
            if not line[0]:
                continue
        seen[p] = True
    return seen
