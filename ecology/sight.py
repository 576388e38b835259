"""Sight: view fields, lines of sight and reach; what each body sees of patches and of others."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary, fields
from ecology.compiler_cache import compiled, use_cache, within
from ecology.elementary import angle_of, cosine_and_sine
from ecology.ground import Ground, plane, walls
from ecology.ground.plane import way_along
from ecology.ground.walls import is_hidden, near_walls
from ecology.neighbours import Pairs
from ecology.spec import Resource, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__, plane.__file__, walls.__file__, elementary.__file__)


@dataclass(frozen=True)
class Eyes:
    """The constants of sight: each slot's view field, the walls and the resources' reach."""

    half_angle: Floats  # (n,)
    range: Floats  # (n,)
    sees: Bools  # (n,) slots that look for resources
    open: bool  # whether no wall can come between two points of the arena
    wall_from: Floats  # (W, 2)
    wall_along: Floats  # (W, 2) from the first to the second end
    reach: Floats  # (R,) radius of the patch's circle

    def sees_others(self, pairs: Pairs, position: Floats, heading: Floats, looks: Bools) -> Bools:
        """Return which pairs (P,) are seen by `who`: in its view field, no wall between; `looks` (N,) are who look."""
        return in_view(
            pairs.starts, pairs.other, pairs.gap, pairs.distance, position, heading, looks,
            self.half_angle, self.range, self.wall_from, self.wall_along, self.open,
        )  # fmt: skip


def compile_eyes(species: tuple[Species, ...], ground: Ground, resources: tuple[Resource, ...]) -> Eyes:
    """Return the constants of sight for the slots of `species`, in their order."""
    counts = [s.slots for s in species]
    return Eyes(
        half_angle=np.repeat([s.view_angle / 2 for s in species], counts),
        range=np.repeat([s.view_range for s in species], counts),
        sees=np.repeat([bool(s.sees) or any(a.kind == "go_to" for a in s.actions) for s in species], counts),
        open=ground.open,
        wall_from=ground.start,
        wall_along=ground.along,
        reach=np.array([r.radius for r in resources for _ in range(r.count)], float),
    )


def eyes_now(model: Model, state: State) -> Eyes:
    """Return the eyes of the bodies as they are now: fields and the rule may shorten how far they see."""
    dims = model.fields is not None and model.fields.dims
    if state.sight is None and not dims:
        return model.eyes
    share = fields.share(model, state, "dimming") if dims else np.ones(model.size)
    far = np.minimum(model.eyes.range, model.plane.diagonal)  # of what has no end a share has none either
    return replace(model.eyes, range=far * (share if state.sight is None else share * state.sight))


def find_patches(model: Model, state: State, eyes: Eyes, offered: Bools) -> tuple[Bools, Bools, Ints, Ints, Ints]:
    """Return where the patches are from each body; see `around`.

    A patch is seen within the angle and the range of the view field, with no wall between. `offered` (R,) are patches
    that can be consumed. An agent that has arrived at a patch is bound for it no more.
    """
    extent = model.plane
    state.own("bound_for")
    return around(
        state.position, state.heading, state.alive, state.bound_for, eyes.sees, eyes.half_angle, eyes.range,
        state.resource_position, eyes.reach, model.resources.kind, len(model.scenario.resources), offered,
        extent.size, extent.torus, eyes.wall_from, eyes.wall_along, eyes.open,
    )  # fmt: skip


# ---- compiled loops ----------------------------------------------------------------------------


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
        walls = 0 if open_ else near_walls(position[i], range_[i], wall_from, wall_along, near)
        for p in range(starts[i], starts[i + 1]):
            if distance[p] > range_[i]:
                break
            if _aside(gap[p, 0], gap[p, 1], distance[p], heading[i], cos, sin, half_angle[i], edge):
                continue
            seen[p] = not is_hidden(position[i], position[other[p]], wall_from, wall_along, near, walls)
    return seen


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
    some_walls = np.empty(len(wall_from), np.int64)
    for i in range(n):
        if not alive[i]:
            continue
        near[:], far[:], any_[:] = np.inf, np.inf, np.inf
        (cos, sin), edge = cosine_and_sine(heading[i]), cosine_and_sine(half_angle[i])[0]
        walls = 0 if open_ else near_walls(position[i], range_[i], wall_from, wall_along, some_walls)
        for r in range(count):
            dx = way_along(position[i, 0], patches[r, 0], size[0], torus)
            dy = way_along(position[i, 1], patches[r, 1], size[1], torus)
            d = math.sqrt(dx * dx + dy * dy)
            contains = d <= reach[r]
            sees = looks[i] and d <= range_[i]
            if sees:
                sees = not _aside(dx, dy, d, heading[i], cos, sin, half_angle[i], edge)
            if sees:
                sees = not is_hidden(position[i], patches[r], wall_from, wall_along, some_walls, walls)
            inside[i, r], seen[i, r] = contains, sees
            bound = bound_for[i] == r
            if bound and contains:
                bound_for[i] = -1
            if not offered[r]:
                continue
            k = kind[r]
            if contains and d < near[k]:
                near[k], here[i, k] = d, r
            if (sees or bound) and not contains and (bound or d < far[k]):  # who is on the way to one goes on to it
                far[k], toward[i, k] = (-1.0 if bound else d), r
            if (sees or contains) and d < any_[k]:
                any_[k], glimpse[i, k] = d, r
        for k in range(kinds):
            if here[i, k] >= 0:  # who stands in a patch has arrived
                toward[i, k] = -1
    return inside, seen, here, toward, glimpse


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
        walls = 0 if open_ else near_walls(position[i], range_[i], wall_from, wall_along, near)
        have = 0
        for p in range(starts[i], starts[i + 1]):
            if distance[p] > range_[i] or have == k:
                break
            j = other[p]
            if not wanted[species_of[j]]:
                continue
            if _aside(gap[p, 0], gap[p, 1], distance[p], heading[i], cos, sin, half_angle[i], edge):
                continue
            if is_hidden(position[i], position[j], wall_from, wall_along, near, walls):
                continue
            found[row, have] = p
            way[0, row, have], way[1, row, have] = gap[p, 0], gap[p, 1]
            have += 1
    return found, way
