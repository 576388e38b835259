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


@numba.njit(cache=True)
def inside_polygon(vertices: Floats, points: Floats) -> Bools:
    """Return which points (n, 2) lie strictly inside the polygon (W, 2): crossings of a ray to the right, (n,)."""
    found = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        odd = False
        x2, y2 = vertices[-1, 0], vertices[-1, 1]  # the vertex before
        for w in range(len(vertices)):
            x1, y1 = vertices[w, 0], vertices[w, 1]
            if (y1 > y) != (y2 > y):
                rise = y2 - y1
                # the ray from (x, y) crosses the edge where x < x1 + (y - y1) (x2 - x1) / rise
                if ((x - x1) * rise < (y - y1) * (x2 - x1)) == (rise > 0):
                    odd = not odd
            x2, y2 = x1, y1
        found[i] = odd
    return found


@numba.njit(cache=True)
def around(
    position: Floats,
    heading: Floats,
    alive: Bools,
    bound_for: Ints,
    looks: Bools,
    half_angle: Floats,
    range_: Floats,
    patches: Floats,
    reach: Floats,
    kind: Ints,
    kinds: int,
    offered: Bools,
    size: Floats,
    torus: bool,
    wall_from: Floats,
    wall_along: Floats,
    open_: bool,
) -> tuple[Bools, Bools, Ints, Ints, Ints]:
    """Return what n bodies have of R patches of K resources around them.

    Inside which circle each is and which it sees, (n, R); for each resource the nearest patch of those
    `offered` (R,), -1 without: `here`, in whose circle it is, `toward`, that it sees or is `bound_for`
    (n,) while it is in none, and `glimpse`, that it sees or is in, (n, K). Who has arrived is bound for nothing
    more: `bound_for` is written. `looks`, `half_angle`, `range_` (n,) are the eyes, `reach`, `kind` (R,) the
    patches.
    """
    n, count = len(position), len(patches)
    inside, seen = np.zeros((n, count), np.bool_), np.zeros((n, count), np.bool_)
    here, toward, glimpse = np.full((n, kinds), -1), np.full((n, kinds), -1), np.full((n, kinds), -1)
    near, far, any_ = np.empty(kinds), np.empty(kinds), np.empty(kinds)
    for i in range(n):
        if not alive[i]:
            continue
        near[:], far[:], any_[:] = np.inf, np.inf, np.inf
        for r in range(count):
            dx = _way(position[i, 0], patches[r, 0], size[0], torus)
            dy = _way(position[i, 1], patches[r, 1], size[1], torus)
            d = math.sqrt(dx * dx + dy * dy)
            within = d <= reach[r]
            sees = looks[i] and d <= range_[i]
            if sees and half_angle[i] < math.pi:
                turn = math.atan2(dy, dx) - heading[i]
                sees = abs((turn + math.pi) % (2 * math.pi) - math.pi) <= half_angle[i] + 1e-12
            if sees and not open_:
                sees = clear_lines(position[i : i + 1], patches[r : r + 1], wall_from, wall_along)[0]
            inside[i, r], seen[i, r] = within, sees
            bound = bound_for[i] == r
            if bound and within:
                bound_for[i] = -1
            if not offered[r]:
                continue
            k = kind[r]
            if within and d < near[k]:
                near[k], here[i, k] = d, r
            if (sees or bound) and not within and (bound or d < far[k]):  # who is on the way to one goes on to it
                far[k], toward[i, k] = (-1.0 if bound else d), r
            if (sees or within) and d < any_[k]:
                any_[k], glimpse[i, k] = d, r
        for k in range(kinds):
            if here[i, k] >= 0:  # who stands in a patch has arrived
                toward[i, k] = -1
    return inside, seen, here, toward, glimpse


@numba.njit(cache=True)
def open_actions(
    internal: Floats,
    alive: Bools,
    hold: Floats,
    action: Ints,
    bound_for: Ints,
    here: Ints,
    toward: Ints,
    targets: Ints,
    opens_from: Floats,
    closes_at: Floats,
    consumes: Ints,
    goes_to: Ints,
    meets: Ints,
    rest: int,
    committed: bool,
) -> Bools:
    """Return A_zeta, which actions are open, (n, A) for the n slots of one species; see `actions.action_mask`."""
    n, count, needs = len(internal), len(consumes), internal.shape[1]
    mask = np.zeros((n, count), np.bool_)
    for i in range(n):
        if not alive[i]:
            continue
        if hold[i] > 0:
            mask[i, action[i]] = True
            continue
        some = False
        for a in range(count):
            fits = True
            for v in range(needs):
                x = internal[i, v]
                if not (opens_from[a, v] <= x < closes_at[a, v]):
                    fits = False
                    break
            if fits and consumes[a] >= 0:
                fits = here[i, consumes[a]] >= 0
            if fits and goes_to[a] >= 0:
                fits = toward[i, goes_to[a]] >= 0
            if fits and meets[a] >= 0:
                fits = targets[i, a] >= 0
            mask[i, a] = fits
            some |= fits
        if committed and bound_for[i] >= 0 and goes_to[action[i]] >= 0 and mask[i, action[i]]:
            mask[i, :] = False
            mask[i, action[i]] = True
        if not some:
            mask[i, rest] = True  # a body whose thresholds close everything can still do nothing
    return mask


@numba.njit(cache=True)
def nearest_seen(
    starts: Ints,
    other: Ints,
    gap: Floats,
    distance: Floats,
    first: int,
    n: int,
    k: int,
    wanted: Bools,
    species_of: Ints,
    position: Floats,
    heading: Floats,
    half_angle: Floats,
    range_: Floats,
    wall_from: Floats,
    wall_along: Floats,
    open_: bool,
) -> Ints:
    """Return the k nearest pairs that n slots from `first` on see, of the species `wanted` (S,): (n, k), -1 none.

    The pairs of slot i are those from `starts` (N + 1,) of i on; the rest as in `in_view`.
    """
    found = np.full((n, k), -1)
    for row in range(n):
        i = first + row
        have = 0
        for p in range(starts[i], starts[i + 1]):
            if distance[p] > range_[i] or have == k:
                break
            j = other[p]
            if not wanted[species_of[j]]:
                continue
            if half_angle[i] < math.pi:
                turn = math.atan2(gap[p, 1], gap[p, 0]) - heading[i]
                if abs((turn + math.pi) % (2 * math.pi) - math.pi) > half_angle[i] + 1e-12:
                    continue
            if not open_ and not clear_lines(position[i : i + 1], position[j : j + 1], wall_from, wall_along)[0]:
                continue
            found[row, have] = p
            have += 1
    return found


@numba.njit(cache=True)
def in_reach(
    starts: Ints,
    other: Ints,
    distance: Floats,
    first: int,
    n: int,
    reach: float,
    wanted: int,
    species_of: Ints,
    position: Floats,
    wall_from: Floats,
    wall_along: Floats,
    open_: bool,
) -> Ints:
    """Return whom of the species `wanted` is nearest in `reach`, no wall between, for n slots from `first` on: (n,)."""
    found = np.full(n, -1)
    for row in range(n):
        i = first + row
        for p in range(starts[i], starts[i + 1]):
            j = other[p]
            if distance[p] > reach:
                break
            if species_of[j] == wanted and (
                open_ or clear_lines(position[i : i + 1], position[j : j + 1], wall_from, wall_along)[0]
            ):
                found[row] = j
                break
    return found
