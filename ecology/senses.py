"""What agents perceive: view field, line of sight, reach, and observations; pure functions of arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ecology import elementary, kernels
from ecology.empathy import own_weights
from ecology.neighbours import Pairs
from ecology.plane import Plane, corners_of, plane_of
from ecology.spec import Arena, Neighbours, Resource, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

SENSES: Mapping[str, int] = {"position": 2, "heading": 1, "clock": 2}  # components in zeta


@dataclass(frozen=True)
class Layout:
    """What the components of zeta are: the agent's knowledge of its own senses, D components."""

    names: tuple[str, ...]  # D
    kinds: tuple[str, ...]  # D: "deviation", "felt", "position", "angle" or "plain"
    scale: Floats  # (D,) size of an ordinary value
    low: Floats  # (D,)
    high: Floats  # (D,)
    regulated: Bools  # (D,) components that count in the drive
    epsilon: float  # of the drive
    exponent: float  # of the drive
    own: Floats  # (D,) w_ii of the average form of empathy, 1 without
    felt_to: Ints  # (D,) deviation that a felt component adds to; -1: it adds to the drive (sum form), or is none

    @property
    def needs(self) -> int:
        """Return how many components are deviations; they come first."""
        return self.kinds.count("deviation")


def layout(species: Species, arena: Arena, resources: Sequence[Resource], everyone: Sequence[Species]) -> Layout:
    """Return the layout of zeta = [delta, what is felt of others, e] for `species` among `everyone`."""
    (left, bottom), (right, top) = arena.extent
    # name, kind, scale, low, high
    rows: list[tuple[str, str, float, float, float]] = [
        (n.name, "deviation", n.scale, n.low - n.set_point, n.bounds[1] - n.set_point) for n in species.needs
    ]
    own = own_weights(species, everyone)
    felt_to = [-1] * len(rows)
    empathy = species.empathy
    if empathy is not None and empathy.perceived:
        if empathy.form == "sum":
            size = math.sqrt(sum(n.scale**2 for n in species.needs if n.regulated))
            rows.append(("felt", "felt", max(abs(empathy.weight) * size, 1e-6), -math.inf, math.inf))
            felt_to.append(-1)
        for v, n in enumerate(species.needs):
            if own[n.name] != 1.0:
                rows.append((f"felt_{n.name}", "felt", abs(1.0 - own[n.name]) * n.scale, -math.inf, math.inf))
                felt_to.append(v)
    for sense in species.senses:
        if sense == "position":
            rows += [
                ("x", "position", max((right - left) / 2, 1e-6), left, right),
                ("y", "position", max((top - bottom) / 2, 1e-6), bottom, top),
            ]
        elif sense == "heading":
            rows.append(("heading", "angle", math.pi, -math.pi, math.pi))
        elif sense == "clock":
            rows += [(f"clock_{part}", "plain", 1.0, -1.0, 1.0) for part in ("cos", "sin")]
    far = farthest(species, plane_of(arena))
    for name in species.sees:
        rows += _place_rows(name, far)
        if any(r.name == name and math.isfinite(r.most) for r in resources):
            rows.append((f"{name}_fullness", "plain", 0.5, 0.0, 1.0))
    for sensed in species.neighbours:
        kinds = _sensed(sensed, everyone)
        label = "_".join(sensed.species) or "other"
        for i in range(sensed.count):
            one = f"{label}_{i + 1}"
            rows += _place_rows(one, far)
            if sensed.heading:
                rows.append((f"{one}_heading", "angle", math.pi, -math.pi, math.pi))
            if len(kinds) > 1:
                rows += [(f"{one}_is_{kind.name}", "plain", 0.5, 0.0, 1.0) for kind in kinds]
            for name in _opened(kinds):
                needs = [n for kind in kinds for n in kind.needs if n.name == name and name in kind.opens]
                low, high = min(n.low - n.set_point for n in needs), max(n.bounds[1] - n.set_point for n in needs)
                rows.append((f"{one}_{name}", "plain", max(n.scale for n in needs), min(low, 0.0), max(high, 0.0)))
    names, kinds_, scale, low_, high_ = zip(*rows, strict=True)
    here = len(species.needs)
    return Layout(
        names=names,
        kinds=kinds_,
        scale=np.array(scale),
        low=np.array(low_),
        high=np.array(high_),
        regulated=np.array([n.regulated for n in species.needs] + [False] * (len(rows) - here)),
        epsilon=species.drive_epsilon,
        exponent=species.drive_exponent,
        own=np.array([own[n.name] for n in species.needs] + [1.0] * (len(rows) - here)),
        felt_to=np.array(felt_to + [-1] * (len(rows) - len(felt_to))),
    )


def _place_rows(name: str, far: float) -> list[tuple[str, str, float, float, float]]:
    return [(f"{name}_distance", "plain", far / 2, 0.0, far), (f"{name}_bearing", "angle", math.pi, -math.pi, math.pi)]


def farthest(species: Species, plane: Plane) -> float:
    """Return the farthest that anything is seen by `species`, length."""
    return min(species.view_range, plane.diagonal)


def _sensed(sensed: Neighbours, everyone: Sequence[Species]) -> list[Species]:
    return [s for s in everyone if not sensed.species or s.name in sensed.species]


def _opened(kinds: Sequence[Species]) -> list[str]:
    return list(dict.fromkeys(name for kind in kinds for name in kind.opens))


@dataclass(frozen=True)
class Gaze:
    """The constants of what one species perceives."""

    species: Species
    rows: slice
    layout: Layout
    far: float
    felt_to: tuple[int, ...]  # columns of what is felt
    sees: tuple[int, ...]  # resource indices
    full: tuple[bool, ...]  # whether the fullness of each is perceived
    neighbours: tuple[tuple[Neighbours, Ints, Ints], ...]  # with the place of each species (S,) among the kinds that
    # are sensed, -1 without, and the columns that each of these opens (kinds, W), -1 without


def compile_gaze(
    species: Species, rows: slice, arena: Arena, resources: Sequence[Resource], everyone: Sequence[Species]
) -> Gaze:
    """Return the constants of what the slots `rows` of `species` perceive."""
    names = [r.name for r in resources]
    sees = tuple(names.index(name) for name in species.sees)
    its = layout(species, arena, resources, everyone)
    found = []
    for sensed in species.neighbours:
        kinds = _sensed(sensed, everyone)
        columns = [
            [[n.name for n in s.needs].index(name) if name in s.opens else -1 for name in _opened(kinds)] for s in kinds
        ]
        kind_of = np.array([kinds.index(s) if s in kinds else -1 for s in everyone], np.int64)
        found.append((sensed, kind_of, np.array(columns, np.int64).reshape(len(kinds), -1)))
    return Gaze(
        species=species,
        rows=rows,
        layout=its,
        far=farthest(species, plane_of(arena)),
        felt_to=tuple(max(int(to), 0) for to, kind in zip(its.felt_to, its.kinds, strict=True) if kind == "felt"),
        sees=sees,
        full=tuple(math.isfinite(resources[i].most) for i in sees),
        neighbours=tuple(found),
    )


class Perception(NamedTuple):
    """What bodies see and can do after a tick, on which they decide in the next one; K resources, A actions."""

    here: Ints  # (N, K) patch of each resource that the body stands in and can consume, -1 without
    toward: Ints  # (N, K) patch of each resource that a go_to leads to, -1 without
    nearest: Ints  # (N, K) nearest patch of each resource that is seen or stood in, -1 without
    pairs: Pairs | None  # of bodies near each other; None where nobody senses or meets another
    targets: Mapping[str, Ints]  # by species (n, A), slot that a bite or gift would meet, -1 without
    masks: Mapping[str, Bools]  # by species (n, A), A_zeta


def observe(model: Model, gaze: Gaze, state: State, seen: Perception) -> np.ndarray:
    """Return zeta = [delta, what is felt, e] of the n slots of one species, float32 (n, D)."""
    species, rows = gaze.species, gaze.rows
    n, width = rows.stop - rows.start, len(species.needs)
    zeta = np.zeros((n, len(gaze.layout.names)), np.float32)
    zeta[:, :width] = state.internal[rows, :width] - model.body.set_point[rows, :width]
    column = width
    for to in gaze.felt_to:
        zeta[:, column] = state.felt[rows, to]
        column += 1
    for sense in species.senses:
        if sense == "position":
            zeta[:, column : column + 2] = state.position[rows]
        elif sense == "heading":
            zeta[:, column] = state.heading[rows]
        elif sense == "clock":
            angle = 2 * math.pi * state.time / (model.scenario.day or 1.0)
            zeta[:, column : column + 2] = elementary.cosine_and_sine(angle)
        column += SENSES[sense]
    plane = model.plane
    for kind, full in zip(gaze.sees, gaze.full, strict=True):
        kernels.write_patches(
            zeta, column, gaze.far, seen.nearest[:, kind], rows.start, state.position, state.heading,
            state.resource_position, plane.size, plane.torus, full, state.stock, model.resources.capacity,
        )  # fmt: skip
        column += 2 + full
    for sensed, kind_of, columns in gaze.neighbours:
        column = _observe_others(zeta, column, gaze, model, state, seen.pairs, (sensed, kind_of, columns))
    return zeta


def _observe_others(
    zeta: np.ndarray,
    column: int,
    gaze: Gaze,
    model: Model,
    state: State,
    pairs: Pairs | None,
    sense: tuple[Neighbours, Ints, Ints],
) -> int:
    """Write what one of `gaze.neighbours` senses into zeta (n, D) from `column` on; return the column after it."""
    sensed, kind_of, columns = sense
    eyes, kinds = model.eyes, len(columns)
    assert pairs is not None
    n = len(zeta)
    found, way = kernels.nearest_seen(
        pairs.starts, pairs.other, pairs.gap, pairs.distance, gaze.rows.start, n, sensed.count, kind_of >= 0,
        model.species_of, state.position, state.heading, eyes.half_angle, eyes.range, eyes.wall_from,
        eyes.wall_along, eyes.open,
    )  # fmt: skip
    angle = elementary.arctan2(way[1], way[0])  # (n, k)
    kernels.write_others(
        zeta, column, gaze.far, found, angle, pairs.other, pairs.distance, gaze.rows.start, state.heading,
        sensed.heading, kind_of, kinds, model.species_of, columns, state.internal, model.body.set_point,
    )  # fmt: skip
    return column + sensed.count * (2 + sensed.heading + (kinds if kinds > 1 else 0) + columns.shape[1])


def show_fatal_needs(
    model: Model, state: State, internal: Floats, died: Bools, observations: Mapping[str, np.ndarray]
) -> None:
    """Write the needs with which agents `died` (N,), from x (N, V) after the tick, into their last observations.

    The state keeps what a dead body stored before the tick, so that the account closes and death is no relief.
    """
    body = model.body
    x = np.where(np.isfinite(internal), np.clip(internal, body.low, body.high), state.internal)
    for group, species in model.species:
        rows, width = np.flatnonzero(died[group.slots]), len(species.needs)
        at = group.slots.start + rows
        observations[group.name][rows, :width] = (x - body.set_point)[at, :width]


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
        return kernels.in_view(
            pairs.starts, pairs.other, pairs.gap, pairs.distance, position, heading, looks,
            self.half_angle, self.range, self.wall_from, self.wall_along, self.open,
        )  # fmt: skip


def compile_eyes(species: tuple[Species, ...], arena: Arena, resources: tuple[Resource, ...]) -> Eyes:
    """Return the constants of sight for the slots of `species`, in their order."""
    counts = [s.slots for s in species]
    x, y = (np.roll(corners_of(arena), -1, axis=0) - corners_of(arena)).T
    convex = bool((x * np.roll(y, -1) >= y * np.roll(x, -1)).all())  # no corner turns to the right
    vertices = np.array(arena.vertices, dtype=float)
    return Eyes(
        half_angle=np.repeat([s.view_angle / 2 for s in species], counts),
        range=np.repeat([s.view_range for s in species], counts),
        sees=np.repeat([bool(s.sees) or any(a.kind == "go_to" for a in s.actions) for s in species], counts),
        open=convex or not arena.walls,
        wall_from=vertices,
        wall_along=np.roll(vertices, -1, axis=0) - vertices,
        reach=np.array([r.radius for r in resources for _ in range(r.count)], float),
    )


def wrap(angle: Floats) -> Floats:
    """Return the angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def clear(eyes: Eyes, start: Floats, end: Floats) -> Bools:
    """Return whether the straight segment from start to end (m, 2) crosses no wall, (m,)."""
    if eyes.open:
        return np.ones(len(start), bool)
    return kernels.clear_lines(start, end, eyes.wall_from, eyes.wall_along)


def find_patches(model: Model, state: State, offered: Bools) -> tuple[Bools, Bools, Ints, Ints, Ints]:
    """Return where the patches are from each body; see `kernels.around`.

    A patch is seen within the angle and the range of the view field, with no wall between. `offered` (R,) are patches
    that can be consumed. An agent that has arrived at a patch is bound for it no more.
    """
    eyes, plane = model.eyes, model.plane
    state.own("bound_for")
    return kernels.around(
        state.position, state.heading, state.alive, state.bound_for, eyes.sees, eyes.half_angle, eyes.range,
        state.resource_position, eyes.reach, model.resources.kind, len(model.scenario.resources), offered,
        plane.size, plane.torus, eyes.wall_from, eyes.wall_along, eyes.open,
    )  # fmt: skip
