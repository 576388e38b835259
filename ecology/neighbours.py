"""Who is near whom: a spatial index over the living and what is read off it; pure functions of arrays."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ecology.compiler_cache import compiled, use_cache, within
from ecology.ground import Plane, plane
from ecology.ground.plane import way_along
from ecology.state import Bools, Floats, Ints

use_cache(__file__, plane.__file__)

BINS = 32  # for sorting the others near one roughly


class Pairs(NamedTuple):
    """P directed pairs of living slots, by `who`, and for each the nearest first."""

    who: Ints  # (P,)
    other: Ints  # (P,)
    gap: Floats  # (P, 2) from who to other
    distance: Floats  # (P,) between the centres
    starts: Ints  # (N + 1,) first pair of every slot


def find(plane: Plane, position: Floats, alive: Bools, radius: float, last: Pairs | None = None) -> Pairs:
    """Return all pairs of living slots (N,) whose centres are at most `radius` apart.

    The cost grows with the pairs, not with N squared, as long as the radius is small in the arena. There are about as
    many as the `last` time.
    """
    room = 16 + (16 * len(alive) if last is None else len(last.who) * 9 // 8)
    return Pairs(*pairs_within(position, alive, plane.low, plane.size, plane.period, radius, room))


@within
def _cell(x: float, low: float, width: float, count: int) -> int:
    return min(max(int((x - low) / width), 0), count - 1)


@within
def _longer(values: np.ndarray, room: int) -> np.ndarray:
    longer = np.empty(room, values.dtype)
    longer[: len(values)] = values
    return longer


@within
def _sort_into_cells(
    points: Floats, alive: Bools, low: Floats, wide: tuple[float, float], shape: tuple[int, int]
) -> tuple[Ints, Ints, Ints, Floats, Floats]:
    """Return living points (n, 2) in the order of their cells, so that what lies near is read together.

    The column and the row of every point's cell (n, 2), -1 of the dead; where the points of each cell start; and by
    that order the points' indices, x and y. The cells, of which there are `shape`, are `wide` along each axis.
    """
    n, (wx, wy), (nx, ny) = len(points), wide, shape
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
    return cell, start, order, x, y


@within
def _spans(row: int, reach: int, count: int, torus: bool) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the rows within `reach` of a `row` of `count`, from and to; over the seam of a torus there are others."""
    low, high = row - reach, row + reach + 1
    beyond = (0, 0)
    if torus and low < 0:
        beyond = (count + low, count)
    elif torus and high > count:
        beyond = (0, high - count)
    return (max(low, 0), min(high, count)), beyond


@within
def _sort_roughly(square: Floats, index: Ints, count: int, most: float, room: tuple[Ints, Floats, Ints]) -> None:
    """Sort the first `count` squared distances of at most `most`, and their indices, into bins of equal area.

    Numbers in one bin stay as they come. Points that lie evenly fill all bins alike, so few are left out of order.
    """
    bins, squares, indices = room
    scale = BINS / max(most, 1e-300)
    bins[:] = 0
    for k in range(count):
        bins[int(square[k] * scale) + 1] += 1
    for b in range(1, BINS + 1):
        bins[b] += bins[b - 1]
    for k in range(count):
        b = int(square[k] * scale)
        squares[bins[b]], indices[bins[b]] = square[k], index[k]
        bins[b] += 1


@compiled
def pairs_within(
    points: Floats, alive: Bools, low: Floats, size: Floats, period: Floats, radius: float, room: int
) -> tuple[Ints, Ints, Floats, Floats, Ints]:
    """Return all pairs of living points (n, 2) at most `radius` apart: the fields of `Pairs`.

    Pairs are sorted by who, then by distance, then by index. The search uses a grid of cells at least `radius` wide;
    on a torus whose size is less than three radii, it compares every pair. `room` is the number of pairs for which
    memory is allocated at first.
    """
    n, (period_x, period_y), torus = len(points), (period[0], period[1]), period[0] > 0.0
    nx = int(min(max(size[0] / radius, 1.0), math.sqrt(n) + 1.0))
    ny = int(min(max(size[1] / radius, 1.0), math.sqrt(n) + 1.0))
    if torus and (nx < 3 or ny < 3):
        nx = ny = 1
    cell, start, order, x, y = _sort_into_cells(points, alive, low, (size[0] / nx, size[1] / ny), (nx, ny))
    starts = np.zeros(n + 1, np.int64)
    who, other, gap, distance = np.empty(room, np.int64), np.empty(room, np.int64), np.empty((room, 2)), np.empty(room)
    most = radius * radius * (1.0 + 1e-9)  # beyond it nobody needs a root
    square, close, index = np.empty(n), np.empty(n + 1), np.empty(n + 1, np.int64)  # of those near one
    squares, indices, bins = np.empty(n + 1), np.empty(n + 1, np.int64), np.empty(BINS + 2, np.int64)
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
            for low_y, high_y in _spans(cell[i, 1], reach_y, ny, torus):
                # an unsigned index is never negative, so that nothing is checked and distances are computed in fours
                begin, end = np.uint64(start[cx * ny + low_y]), np.uint64(start[cx * ny + high_y])
                for k in range(begin, end):
                    dx, dy = way_along(xi, x[k], period_x), way_along(yi, y[k], period_y)
                    square[k - begin] = dx * dx + dy * dy
                for k in range(begin, end):  # without a branch: about a third is near enough
                    close[found], index[found] = square[k - begin], order[k]
                    found += (square[k - begin] <= most) & (order[k] != i)
        _sort_roughly(close, index, found, most, (bins, squares, indices))
        if p + found > room:
            room = 2 * room + found
            who, other, distance = _longer(who, room), _longer(other, room), _longer(distance, room)
        for k in range(found):
            d, j = math.sqrt(squares[k]), indices[k]
            if d > radius:
                continue
            at = p  # insertion: few are out of order
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
            gap[at, 0] = way_along(xi, points[other[at], 0], period_x)
            gap[at, 1] = way_along(yi, points[other[at], 1], period_y)
    starts[n] = p
    return who[:p], other[:p], gap[:p], distance[:p], starts
