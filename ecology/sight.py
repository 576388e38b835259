"""Sight: view fields, lines of sight and reach; what each body sees of patches and of others."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ecology import elementary, fields
from ecology.compiler_cache import compiled, use_cache, within
from ecology.elementary import angle_of, cosine_and_sine
from ecology.ground import Ground, plane, walls
from ecology.ground.plane import way_along
from ecology.ground.walls import NO_WALLS, Walls, is_hidden, near_walls
from ecology.neighbours import Pairs
from ecology.spec import Species
from ecology.state import Bodies, Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__, plane.__file__, walls.__file__, elementary.__file__)


class Vision(NamedTuple):
    """The constants of sight: each slot's view field, and what may hide things."""

    half_angle: Floats  # (n,)
    range: Floats  # (n,)
    sees: Bools  # (n,) slots that look for resources
    walls: Walls  # that can come between two points of the arena

    def sees_others(self, pairs: Pairs, position: Floats, heading: Floats, looks: Bools) -> Bools:
        """Return in which pairs (P,) `who` sees the other; `looks` (N,) marks slots that look."""
        return in_view(self, pairs, position, heading, looks)


class Places(NamedTuple):
    """Where R patches of resources are, and whether they can be consumed and gone to: available and not empty."""

    position: Floats  # (R, 2)
    radius: Floats  # (R,)
    kind: Ints  # (R,) resource
    stock: Floats  # (R,)
    available: Bools  # (R,)


def hiding(ground: Ground) -> Walls:
    """Return the walls that can come between two points: none where the arena is open."""
    return NO_WALLS if ground.open else ground.walls


def compile_vision(species: tuple[Species, ...], ground: Ground) -> Vision:
    """Return the constants of sight for the slots of `species`, in their order."""
    counts = [s.slots for s in species]
    return Vision(
        half_angle=np.repeat([s.view_angle / 2 for s in species], counts),
        range=np.repeat([s.view_range for s in species], counts),
        sees=np.repeat([bool(s.sees) or any(a.kind == "go_to" for a in s.actions) for s in species], counts),
        walls=hiding(ground),
    )


def vision_now(model: Model, state: State) -> Vision:
    """Return the vision of the bodies now: fields and the rule may shorten how far they see."""
    dims = model.fields is not None and model.fields.dims
    if state.sight is None and not dims:
        return model.vision
    share = fields.share(model, state, "dimming") if dims else np.ones(model.size)
    far = np.minimum(model.vision.range, model.plane.diagonal)  # of what has no end a share has none either
    return model.vision._replace(range=far * (share if state.sight is None else share * state.sight))


def find_patches(model: Model, state: State, vision: Vision, bodies: Bodies) -> tuple[Bools, Ints]:
    """Return where the patches are from each body; see `around`.

    A patch is seen within the angle and the range of the view field, with no wall between. An agent that has arrived at
    a patch is bound for it no more, which is written to `bodies`.
    """
    table = model.resources
    places = Places(state.resource_position, table.radius, table.kind, state.stock, state.available)
    return around(vision, bodies, places, len(model.scenario.resources), model.plane.period)


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
def in_view(vision: Vision, pairs: Pairs, position: Floats, heading: Floats, looks: Bools) -> Bools:
    """Return which pairs (P,) are seen by slots that look: within angle and range of the view field, no wall between.

    `position` (N, 2), `heading` and `looks` (N,) are by slot.
    """
    _, other, gap, distance, starts = pairs
    half_angle, range_, _, walls = vision
    seen = np.zeros(len(other), np.bool_)
    near = np.empty(len(walls.start), np.int64)
    for i in range(len(starts) - 1):
        if not looks[i] or starts[i] == starts[i + 1]:
            continue
        (cos, sin), edge = cosine_and_sine(heading[i]), cosine_and_sine(half_angle[i])[0]
        count = near_walls(walls, position[i], range_[i], near)
        for p in range(starts[i], starts[i + 1]):
            if distance[p] > range_[i]:
                break
            if _aside(gap[p, 0], gap[p, 1], distance[p], heading[i], cos, sin, half_angle[i], edge):
                continue
            seen[p] = not is_hidden(walls, position[i], position[other[p]], near, count)
    return seen


@compiled
def around(
    vision: Vision,
    bodies: Bodies,
    places: Places,
    kinds: int,
    period: Floats,
) -> tuple[Bools, Ints]:
    """Return what n bodies have of R patches around them, of K `kinds` of resources.

    Inside which circle each is and which it sees, (2, n, R); for each resource the nearest patch of those that can be
    consumed, -1 without: `here`, in whose circle it is, `toward`, that it sees or is bound for while it is in none, and
    `glimpse`, that it sees or is in, (3, n, K). Who has arrived is bound for nothing more, which is written. The plane
    begins again after its `period` (2,).
    """
    half_angle, range_, looks, walls = vision
    place, radius, kind, stock, available = places
    alive, position, heading, bound_for = bodies.alive, bodies.position, bodies.heading, bodies.bound_for
    n, count = len(position), len(place)
    reached, nearest = np.zeros((2, n, count), np.bool_), np.full((3, n, kinds), -1)
    (inside, seen), (here, toward, glimpse) = (reached[0], reached[1]), (nearest[0], nearest[1], nearest[2])
    near, far, any_ = np.empty(kinds), np.empty(kinds), np.empty(kinds)
    some_walls = np.empty(len(walls.start), np.int64)
    for i in range(n):
        if not alive[i]:
            continue
        near[:], far[:], any_[:] = np.inf, np.inf, np.inf
        (cos, sin), edge = cosine_and_sine(heading[i]), cosine_and_sine(half_angle[i])[0]
        hiding_ = near_walls(walls, position[i], range_[i], some_walls)
        for r in range(count):
            dx = way_along(position[i, 0], place[r, 0], period[0])
            dy = way_along(position[i, 1], place[r, 1], period[1])
            d = math.sqrt(dx * dx + dy * dy)
            contains = d <= radius[r]
            sees = looks[i] and d <= range_[i]
            if sees:
                sees = not _aside(dx, dy, d, heading[i], cos, sin, half_angle[i], edge)
            if sees:
                sees = not is_hidden(walls, position[i], place[r], some_walls, hiding_)
            inside[i, r], seen[i, r] = contains, sees
            bound = bound_for[i] == r
            if bound and contains:
                bound_for[i] = -1
            if not (available[r] and stock[r] > 0):
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
    return reached, nearest


@compiled
def nearest_seen(
    vision: Vision, pairs: Pairs, position: Floats, heading: Floats, first: int, n: int, k: int, wanted: Bools
) -> Ints:
    """Return the k nearest pairs that n slots from `first` on see, with slots that are `wanted` (N,): (n, k), -1 none.

    `position` (N, 2) and `heading` (N,) are by slot.
    """
    _, other, gap, distance, starts = pairs
    half_angle, range_, _, walls = vision
    found = np.full((n, k), -1)
    near = np.empty(len(walls.start), np.int64)
    for row in range(n):
        i = first + row
        if starts[i] == starts[i + 1]:
            continue
        (cos, sin), edge = cosine_and_sine(heading[i]), cosine_and_sine(half_angle[i])[0]
        count = near_walls(walls, position[i], range_[i], near)
        have = 0
        for p in range(starts[i], starts[i + 1]):
            if distance[p] > range_[i] or have == k:
                break
            j = other[p]
            if not wanted[j]:
                continue
            if _aside(gap[p, 0], gap[p, 1], distance[p], heading[i], cos, sin, half_angle[i], edge):
                continue
            if is_hidden(walls, position[i], position[j], near, count):
                continue
            found[row, have] = p
            have += 1
    return found
