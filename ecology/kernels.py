"""Loops over bodies, pairs and patches, compiled by Numba: what arrays alone would do many times over.

Compiled once per machine and kept beside this file (or where `compiler_cache` says if that cannot be written).
"""

from __future__ import annotations

import math

import numba
import numpy as np

from ecology import elementary
from ecology.compiler_cache import use_cache
from ecology.elementary import angle_of, cosine_and_sine
from ecology.state import Bools, Floats, Ints

use_cache(__file__, elementary.__file__)

compiled = numba.njit(cache=True, no_cfunc_wrapper=True)  # type: ignore[call-overload]  # called by Python
within = numba.njit(cache=True, no_cfunc_wrapper=True, no_cpython_wrapper=True)  # type: ignore[call-overload]  # called by other kernels alone


@within
def _cell(x: float, low: float, width: float, count: int) -> int:
    return min(max(int((x - low) / width), 0), count - 1)


@within
def _way(a: float, b: float, size: float, torus: bool) -> float:
    d = b - a
    return d - size * np.round(d / size) if torus else d


@compiled
def pairs_within(
    points: Floats, alive: Bools, low: Floats, size: Floats, torus: bool, radius: float, room: int
) -> tuple[Ints, Ints, Floats, Floats, Ints]:
    """Return who, other (P,), gap (P, 2) and distance (P,) of all pairs of living points (n, 2) at most `radius` apart.

    By who, and for each the nearest first, ties by index; with them where those of each start, (n + 1,). A grid of
    cells at least `radius` wide is searched; on a torus the radius must be at most a third of the size, else every
    pair is looked at. `room` is for how many pairs room is made at first.
    """
    n = len(points)
    nx = int(min(max(size[0] / radius, 1.0), math.sqrt(n) + 1.0))
    ny = int(min(max(size[1] / radius, 1.0), math.sqrt(n) + 1.0))
    if torus and (nx < 3 or ny < 3):
        nx = ny = 1
    wx, wy = size[0] / nx, size[1] / ny
    # the points in the order of their cells, so that what lies near is read together
    cell = np.full((n, 2), -1)
    start = np.zeros(nx * ny + 1, np.int64)
    for i in range(n):
        if alive[i]:
            cell[i, 0] = _cell(points[i, 0], low[0], wx, nx)
            cell[i, 1] = _cell(points[i, 1], low[1], wy, ny)
            start[cell[i, 0] * ny + cell[i, 1] + 1] += 1
    start = np.cumsum(start)
    fill = start[:-1].copy()
    order, x, y = np.empty(n, np.int64), np.empty(n), np.empty(n)
    for i in range(n):
        if alive[i]:
            c = cell[i, 0] * ny + cell[i, 1]
            order[fill[c]], x[fill[c]], y[fill[c]] = i, points[i, 0], points[i, 1]
            fill[c] += 1
    starts = np.zeros(n + 1, np.int64)
    who, other, gap, distance = np.empty(room, np.int64), np.empty(room, np.int64), np.empty((room, 2)), np.empty(room)
    most = radius * radius * (1.0 + 1e-9)  # beyond it nobody needs a root
    close, index = np.empty(n + 1), np.empty(n + 1, np.int64)  # of those near one
    reach_x, reach_y = (1 if nx > 1 else 0), (1 if ny > 1 else 0)
    p = 0
    for i in range(n):
        first = p
        starts[i] = p
        if not alive[i]:
            continue
        xi, yi = points[i, 0], points[i, 1]
        found = 0
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
                for k in range(start[c], start[c + 1]):  # without a branch: about a third is near enough
                    dx, dy = _way(xi, x[k], size[0], torus), _way(yi, y[k], size[1], torus)
                    square = dx * dx + dy * dy
                    close[found], index[found] = square, order[k]
                    found += (square <= most) & (order[k] != i)
        if p + found > room:
            room = 2 * room + found
            who, other, distance = _longer(who, room), _longer(other, room), _longer(distance, room)
        for k in range(found):
            d, j = math.sqrt(close[k]), index[k]
            if d > radius:
                continue
            at = p  # insertion: the pairs of one are few
            while at > first and (distance[at - 1] > d or (distance[at - 1] == d and other[at - 1] > j)):
                distance[at], other[at] = distance[at - 1], other[at - 1]
                at -= 1
            distance[at], other[at], who[p] = d, j, i
            p += 1
        if room > len(gap):
            gap_ = np.empty((room, 2))
            gap_[:first] = gap[:first]
            gap = gap_
        for at in range(first, p):
            gap[at, 0] = _way(xi, points[other[at], 0], size[0], torus)
            gap[at, 1] = _way(yi, points[other[at], 1], size[1], torus)
    starts[n] = p
    return who[:p], other[:p], gap[:p], distance[:p], starts


@within
def _longer(values: np.ndarray, room: int) -> np.ndarray:
    longer = np.empty(room, values.dtype)
    longer[: len(values)] = values
    return longer


@within
def wrapped(angle: float) -> float:
    """Return an angle of at most three half turns in [-pi, pi)."""
    angle += math.pi
    if angle >= 2 * math.pi:
        angle -= 2 * math.pi
    elif angle < 0.0:
        angle += 2 * math.pi
    return angle - math.pi


@within
def _crosses(ax: float, ay: float, ox: float, oy: float, bx: float, by: float) -> bool:
    """Return whether t a = o + s b for some t and s in [0, 1]; o is where b starts, seen from where a starts."""
    cross = ax * by - ay * bx
    t, s = ox * by - oy * bx, ox * ay - oy * ax
    if cross < 0:
        cross, t, s = -cross, -t, -s
    return cross > 0 and 0 <= t <= cross and 0 <= s <= cross


@compiled
def clear_lines(start: Floats, end: Floats, wall_from: Floats, wall_along: Floats) -> Bools:
    """Return whether the straight segments from start to end (m, 2) cross no wall (W, 2), (m,)."""
    found = np.ones(len(start), np.bool_)
    for m in range(len(start)):
        ax, ay = end[m, 0] - start[m, 0], end[m, 1] - start[m, 1]
        for w in range(len(wall_from)):
            ox, oy = wall_from[w, 0] - start[m, 0], wall_from[w, 1] - start[m, 1]
            if _crosses(ax, ay, ox, oy, wall_along[w, 0], wall_along[w, 1]):
                found[m] = False
                break
    return found


@within
def _near_walls(place: Floats, far: float, wall_from: Floats, wall_along: Floats, near: Ints) -> int:
    """Write the walls that may come nearer than `far` to a place into `near` (W,), and return how many they are."""
    count = 0
    far += 1e-9
    x, y = place[0], place[1]
    for w in range(len(wall_from)):
        x1, y1 = wall_from[w, 0], wall_from[w, 1]
        x2, y2 = x1 + wall_along[w, 0], y1 + wall_along[w, 1]
        if min(x1, x2) <= x + far and max(x1, x2) >= x - far and min(y1, y2) <= y + far and max(y1, y2) >= y - far:
            near[count] = w
            count += 1
    return count


@within
def _hidden(start: Floats, end: Floats, wall_from: Floats, wall_along: Floats, near: Ints, count: int) -> bool:
    """Return whether one of the first `count` walls of `near` lies between two places."""
    ax, ay = end[0] - start[0], end[1] - start[1]
    for at in range(count):
        w = near[at]
        if _crosses(ax, ay, wall_from[w, 0] - start[0], wall_from[w, 1] - start[1], wall_along[w, 0], wall_along[w, 1]):
            return True
    return False


@within
def _aside(dx: float, dy: float, d: float, heading: float, cos: float, sin: float, half: float, edge: float) -> bool:
    """Return whether what lies at (dx, dy), d away, is out of the view angle; `cos`, `sin` are of the heading.

    The angle itself is worked out only near the `edge`, cos(half), where rounding could decide.
    """
    if half >= math.pi:
        return False
    ahead = dx * cos + dy * sin
    if ahead > (edge + 1e-9) * d:
        return False
    if ahead < (edge - 1e-9) * d:
        return True
    turn = angle_of(dy, dx) - heading
    return abs((turn + math.pi) % (2 * math.pi) - math.pi) > half + 1e-12


@compiled
def in_view(
    starts: Ints,
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
    """Return which pairs (P,) are seen by those who look: within angle and range of the view field, no wall between.

    The pairs of slot i are those from `starts` (N + 1,) of i on, with `other` (P,), `gap` (P, 2) and `distance`
    (P,); `position`, `heading`, `looks`, `half_angle`, `range_` are by slot.
    """
    seen = np.zeros(len(other), np.bool_)
    near = np.empty(len(wall_from), np.int64)
    for i in range(len(starts) - 1):
        if not looks[i] or starts[i] == starts[i + 1]:
            continue
        (cos, sin), edge = cosine_and_sine(heading[i]), cosine_and_sine(half_angle[i])[0]
        walls = 0 if open_ else _near_walls(position[i], range_[i], wall_from, wall_along, near)
        for p in range(starts[i], starts[i + 1]):
            if distance[p] > range_[i]:
                break
            if _aside(gap[p, 0], gap[p, 1], distance[p], heading[i], cos, sin, half_angle[i], edge):
                continue
            seen[p] = not _hidden(position[i], position[other[p]], wall_from, wall_along, near, walls)
    return seen


@compiled
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


@compiled
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
    near_walls = np.empty(len(wall_from), np.int64)
    for i in range(n):
        if not alive[i]:
            continue
        near[:], far[:], any_[:] = np.inf, np.inf, np.inf
        (cos, sin), edge = cosine_and_sine(heading[i]), cosine_and_sine(half_angle[i])[0]
        walls = 0 if open_ else _near_walls(position[i], range_[i], wall_from, wall_along, near_walls)
        for r in range(count):
            dx = _way(position[i, 0], patches[r, 0], size[0], torus)
            dy = _way(position[i, 1], patches[r, 1], size[1], torus)
            d = math.sqrt(dx * dx + dy * dy)
            within = d <= reach[r]
            sees = looks[i] and d <= range_[i]
            if sees:
                sees = not _aside(dx, dy, d, heading[i], cos, sin, half_angle[i], edge)
            if sees:
                sees = not _hidden(position[i], patches[r], wall_from, wall_along, near_walls, walls)
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


@compiled
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
    """Return A_zeta, which actions are open, (n, A) for the n slots of one species; see `actions.open_actions`."""
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


@compiled
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
) -> tuple[Ints, Floats]:
    """Return the k nearest pairs that n slots from `first` on see, of the species `wanted` (S,).

    (n, k), -1 none, and the ways there, (2, n, k). The pairs of slot i are those from `starts` (N + 1,) of i on; the
    rest as in `in_view`.
    """
    found, way = np.full((n, k), -1), np.zeros((2, n, k))
    near = np.empty(len(wall_from), np.int64)
    for row in range(n):
        i = first + row
        if starts[i] == starts[i + 1]:
            continue
        (cos, sin), edge = cosine_and_sine(heading[i]), cosine_and_sine(half_angle[i])[0]
        walls = 0 if open_ else _near_walls(position[i], range_[i], wall_from, wall_along, near)
        have = 0
        for p in range(starts[i], starts[i + 1]):
            if distance[p] > range_[i] or have == k:
                break
            j = other[p]
            if not wanted[species_of[j]]:
                continue
            if _aside(gap[p, 0], gap[p, 1], distance[p], heading[i], cos, sin, half_angle[i], edge):
                continue
            if _hidden(position[i], position[j], wall_from, wall_along, near, walls):
                continue
            found[row, have] = p
            way[0, row, have], way[1, row, have] = gap[p, 0], gap[p, 1]
            have += 1
    return found, way


@compiled
def write_patches(
    zeta: np.ndarray,
    column: int,
    far: float,
    patch: Ints,
    first: int,
    position: Floats,
    heading: Floats,
    places: Floats,
    size: Floats,
    torus: bool,
    full: bool,
    stock: Floats,
    capacity: Floats,
) -> None:
    """Write distance and bearing of the `patch` (N,) that each sees, -1 none, into zeta (n, D) from `column` on.

    The rows of zeta are the slots from `first` on. Where its fullness is perceived, that too.
    """
    for row in range(len(zeta)):
        i = first + row
        r = patch[i]
        if r < 0:
            zeta[row, column] = far
            continue
        dx = _way(position[i, 0], places[r, 0], size[0], torus)
        dy = _way(position[i, 1], places[r, 1], size[1], torus)
        zeta[row, column] = min(math.sqrt(dx * dx + dy * dy), far)
        zeta[row, column + 1] = wrapped(angle_of(dy, dx) - heading[i])
        if full:
            zeta[row, column + 2] = stock[r] / capacity[r]


@compiled
def write_others(
    zeta: np.ndarray,
    column: int,
    far: float,
    found: Ints,
    angle: Floats,
    other: Ints,
    distance: Floats,
    first: int,
    heading: Floats,
    with_heading: bool,
    kind_of: Ints,
    kinds: int,
    species_of: Ints,
    columns: Ints,
    internal: Floats,
    set_point: Floats,
) -> None:
    """Write what n slots from `first` on sense of others into zeta (n, D) from `column` on.

    `found` (n, k) are the pairs, at `angle` (n, k); `kind_of` (S,) is the place of a species among the `kinds` that
    are sensed, and `columns` (kinds, W) the needs that each lets others perceive, -1 without.
    """
    for row in range(len(found)):
        i, c = first + row, column
        for place in range(found.shape[1]):
            p = found[row, place]
            if p < 0:
                zeta[row, c] = far
            else:
                j = other[p]
                kind = kind_of[species_of[j]]
                zeta[row, c] = distance[p]
                zeta[row, c + 1] = wrapped(angle[row, place] - heading[i])
                at = c + 2
                if with_heading:
                    zeta[row, at] = wrapped(heading[j] - heading[i])
                    at += 1
                if kinds > 1:
                    zeta[row, at + kind] = 1.0
                    at += kinds
                for w in range(columns.shape[1]):
                    need = columns[kind, w]
                    if need >= 0:
                        zeta[row, at + w] = internal[j, need] - set_point[j, need]
            c += 2 + with_heading + (kinds if kinds > 1 else 0) + columns.shape[1]


@compiled
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


# ---- the tick: one call for what would be dozens of arrays ---------------------------------------


@compiled
def first_unknown(actions: Ints, counts: Ints) -> int:
    """Return the first slot whose action (N,) is no index into its `counts` (N,) actions, -1: all are."""
    for i in range(len(actions)):
        if actions[i] < 0 or actions[i] >= counts[i]:
            return i
    return -1


@compiled
def decide(
    wanted: Ints,
    mask: Bools,
    first: int,
    dt: float,
    alive: Bools,
    hold: Floats,
    action: Ints,
    heading: Floats,
    bound_for: Ints,
    position: Floats,
    patches: Floats,
    toward: Ints,
    size: Floats,
    torus: bool,
    acts_control: Floats,
    acts_speed: Floats,
    acts_turn: Floats,
    acts_direction: Floats,
    acts_goes_to: Ints,
    acts_duration: Floats,
    acts_bites: Bools,
    rest: int,
    control: Floats,
    speed: Floats,
    direction: Floats,
    closed: Bools,
    way: Floats,
) -> int:
    """Write what n slots of one species, from `first` on, do, and return how many go to a patch.

    `wanted` (N,) are actions, of which the `mask` (n, A) lets some be. Written, by slot: `hold`, `action`, `heading`,
    `bound_for`; `control` (N, V), `speed`, `direction` and `closed` (N,); `way` (N, 2) to the patch that a body goes
    to, whose heading and direction are left to the caller.
    """
    going = 0
    for row in range(len(mask)):
        i = first + row
        a = wanted[i]
        open_ = mask[row, a]
        closed[i] = alive[i] and not open_
        if not open_:  # rest where it is open, else what the body is held to: a sleep, a committed go_to
            a = rest if mask[row, rest] or not alive[i] else np.argmax(mask[row])
        action[i] = a
        for v in range(control.shape[1]):  # as an assignment of rows it would take four times as long to compile
            control[i, v] = acts_control[a, v]
        bound_for[i] = -1
        if not alive[i]:
            speed[i], direction[i] = 0.0, heading[i] if np.isnan(acts_direction[a]) else acts_direction[a]
            continue
        if acts_duration[a] > 0 and not acts_bites[a] and hold[i] <= 0:
            hold[i] = acts_duration[a]
        speed[i] = acts_speed[a]
        if acts_goes_to[a] >= 0:
            r = toward[i, acts_goes_to[a]]
            bound_for[i] = r
            way[i, 0] = _way(position[i, 0], patches[r, 0], size[0], torus)
            way[i, 1] = _way(position[i, 1], patches[r, 1], size[1], torus)
            speed[i] = min(speed[i], math.sqrt(way[i, 0] * way[i, 0] + way[i, 1] * way[i, 1]) / dt)
            going += 1
        else:
            heading[i] = (heading[i] + acts_turn[a] * dt + math.pi) % (2 * math.pi) - math.pi
        direction[i] = heading[i] if np.isnan(acts_direction[a]) else acts_direction[a]
    return going


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
def command_bodies(command: Floats, position: Floats, velocity: Floats, h: float) -> None:
    """Write position, no velocity and the force that gives unit masses their `velocity` (n, 2) in h, (>= n, 6)."""
    for i in range(len(position)):
        command[i, 0], command[i, 1] = position[i, 0], position[i, 1]
        command[i, 2], command[i, 3] = 0.0, 0.0
        command[i, 4], command[i, 5] = velocity[i, 0] / h, velocity[i, 1] / h


# how often a way that a wall holds is bent, and how far from the wall it then ends at least, in radii
BENDS, ASIDE = 4, 0.5


@within
def _exit(corners: Floats, ax: float, ay: float, bx: float, by: float) -> int:
    """Return the first wall by which the way from a to b leaves the polygon (W, 2), -1 none; wall w ends at corner w.

    The corners go round to the left. The side of a line that a point lies on is computed by one formula, for both
    walls of a corner and for both ways that meet in a point, so no way slips through between two walls. A way that
    touches a corner or ends on a wall leaves.
    """
    found, first = -1, np.inf
    low_x, high_x, low_y, high_y = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
    dx, dy = bx - ax, by - ay
    x2, y2 = corners[-1, 0], corners[-1, 1]  # the corner before
    for w in range(len(corners)):
        x1, y1 = x2, y2
        x2, y2 = corners[w, 0], corners[w, 1]
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
def stays(corners: Floats, start: Floats, end: Floats) -> Bools:
    """Return which straight ways from start to end (n, 2) stay in the polygon (W, 2), corners to the left, (n,)."""
    found = np.empty(len(start), np.bool_)
    for i in range(len(start)):
        found[i] = _exit(corners, start[i, 0], start[i, 1], end[i, 0], end[i, 1]) < 0
    return found


@compiled
def glide(
    moved: Floats,
    n: int,
    h: float,
    corners: Floats,
    radius: Floats,
    start: Floats,
    before: Floats,
    seen: Floats,
    bends: bool,
    last: bool,
) -> tuple[Floats, int]:
    """Return where n bodies of rows (>= n, 4), position and velocity, are after a substep of h, and how many are held.

    With `corners` (W, 2), a way from `before` (n, 2) that leaves the polygon `bends` along the wall, or is not gone.
    After the `last` substep, neither does the straight way from `start` (n, 2), where the tick began: a body then ends
    where it was last `seen` (n, 2) from there, which is written. Held are those whose way was changed.
    """
    found, held, several = np.empty((n, 2)), 0, not (bends and last)
    boxes = np.empty((4, len(corners)))  # of the walls
    for w in range(len(corners)):
        for k in range(2):
            boxes[k, w] = min(corners[w, k], corners[w - 1, k])
            boxes[2 + k, w] = max(corners[w, k], corners[w - 1, k])
    for i in range(n):
        ax, ay, sx, sy = before[i, 0], before[i, 1], start[i, 0], start[i, 1]
        bx, by = moved[i, 0] + moved[i, 2] * h, moved[i, 1] + moved[i, 3] * h
        found[i, 0], found[i, 1] = bx, by
        low_x, high_x, low_y, high_y = min(ax, bx, sx), max(ax, bx, sx), min(ay, by, sy), max(ay, by, sy)
        near = 0
        for w in range(len(corners)):  # no branches: most bodies are near no wall
            near += (boxes[0, w] <= high_x) & (boxes[1, w] <= high_y) & (boxes[2, w] >= low_x) & (boxes[3, w] >= low_y)
        if near == 0 or (bx == sx and by == sy):
            if several:
                seen[i, 0], seen[i, 1] = bx, by
            continue
        changed = False
        wall = _exit(corners, ax, ay, bx, by) if bends else -1
        for _ in range(BENDS):
            if wall < 0:
                break
            changed = True
            x, y = corners[wall, 0], corners[wall, 1]
            along_x, along_y = x - corners[wall - 1, 0], y - corners[wall - 1, 1]
            length = math.sqrt(along_x * along_x + along_y * along_y)
            inward_x, inward_y = -along_y / length, along_x / length
            was = (ax - x) * inward_x + (ay - y) * inward_y  # how far from the wall
            would = (bx - x) * inward_x + (by - y) * inward_y
            back = min(max(was, ASIDE * radius[i]), radius[i]) - would
            bx, by = bx + back * inward_x, by + back * inward_y
            wall = _exit(corners, ax, ay, bx, by)
        if wall >= 0:
            bx, by = ax, ay
        if several or ax != sx or ay != sy:  # else it has just been looked at
            if _exit(corners, sx, sy, bx, by) < 0:
                seen[i, 0], seen[i, 1] = bx, by
            elif last:
                changed = True
                bx, by = seen[i, 0], seen[i, 1]
        found[i, 0], found[i, 1] = bx, by
        held += changed
    return found, held


@compiled
def order_meals(
    first: int,
    n: int,
    dt: float,
    alive: Bools,
    action: Ints,
    here: Ints,
    internal: Floats,
    proportional: Bools,
    acts_consumes: Ints,
    acts_intake: Floats,
    control: Floats,
    wanted: Floats,
    total: Floats,
    source: Ints,
) -> int:
    """Write what n slots of one species, from `first` on, ask of a patch in a tick, and return how many do.

    `wanted` (N, V) and its `total` (N,) are in units of intake, `source` (N,) is the patch, -1 none; who is held to a
    meal that is gone gets no `control` (N, V). A proportional need's control multiplies x, so it asks for u x dt.
    """
    eaters = 0
    for i in range(first, first + n):
        kind = acts_consumes[action[i]]
        if kind < 0 or not alive[i]:
            continue
        if here[i, kind] < 0:
            control[i] = 0.0
            continue
        eaters += 1
        source[i] = here[i, kind]
        for v in range(internal.shape[1]):
            asked = acts_intake[action[i], v]
            if proportional[i, v]:
                asked *= internal[i, v]
            wanted[i, v] = max(asked, 0.0) * dt
            total[i] += wanted[i, v]
    return eaters


@compiled
def share(wanted: Floats, source: Ints, stock: Floats, crumb: float) -> tuple[Floats, Floats]:
    """Return the share of what it asks for that each body gets (n,), and what leaves each stock (R,).

    See `resources.share`; a body without a source, -1, gets nothing.
    """
    eaten, part, given = np.zeros(len(stock)), np.ones(len(stock)), np.zeros(len(wanted))
    for i in range(len(wanted)):
        if source[i] >= 0:
            eaten[source[i]] += wanted[i]
    for r in range(len(stock)):
        if eaten[r] > 0 and eaten[r] >= stock[r] * (1 - crumb):
            part[r] = stock[r] / eaten[r]
            eaten[r] = stock[r]
    for i in range(len(wanted)):
        if source[i] >= 0:
            given[i] = part[source[i]]
    return given, eaten


@compiled
def serve(wanted: Floats, source: Ints, part: Floats, control: Floats, ingested: Floats) -> None:
    """Write `control`, `ingested` (N, V) of those with a `source` (N,), who have their `part` of what is `wanted`."""
    for i in range(len(source)):
        if source[i] >= 0:
            for v in range(wanted.shape[1]):
                ingested[i, v] = wanted[i, v] * part[i]
                control[i, v] *= part[i]


@compiled
def live(
    alive: Bools,
    died: Bools,
    before: Floats,
    taken: Floats,
    after: Floats,
    low: Floats,
    high: Floats,
    metabolised: Floats,
    lost: Floats,
    age: Floats,
    hold: Floats,
    dt: float,
) -> tuple[Floats, Bools]:
    """Return x (N, V) kept within its bounds, the organism's automatic regulation, and who lives on (N,).

    x goes from `before` to `after` by f and g and what was `taken` from outside; one that dies, or is dead, keeps
    what it was. Written: `metabolised` and `lost` (N, V), before + taken - metabolised - lost = kept; `age`, `hold`.
    """
    kept, lives = before.copy(), np.empty(len(alive), np.bool_)
    for i in range(len(alive)):
        lives[i] = alive[i] and not died[i]
        if alive[i]:
            for v in range(before.shape[1]):
                if lives[i]:
                    kept[i, v] = min(max(after[i, v], low[i, v]), high[i, v])
                metabolised[i, v] += before[i, v] + taken[i, v] - after[i, v]
                lost[i, v] += after[i, v] - kept[i, v]
        if lives[i]:
            age[i] += dt
        hold[i] = max(hold[i] - dt, 0.0) if hold[i] > 1.5 * dt else 0.0
    return kept, lives
