"""Patches that come and go: what spoils, what a body leaves, seeds, and what the scenario's rule brings.

A patch of a resource with `gone_below` is a row that waits, its stock 0, until something takes it: nothing grows on it,
nobody sees it, and it is not drawn. Shapes: N slots, R patches, V needs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ecology import elementary
from ecology.ground import scatter_in
from ecology.ground.outline import polygon_of
from ecology.resources import room_of
from ecology.scenario import Scenario
from ecology.spec import Remains, Seeding
from ecology.state import CAUSES, Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.meetings import Met
    from ecology.model import Model


@dataclass(frozen=True, eq=False)
class Left:
    """What the bodies of one species leave."""

    slots: slice
    patches: slice
    remains: Remains
    share: Floats  # (V,) of what is stored
    causes: Bools  # (causes,) of the deaths that leave something


@dataclass(frozen=True, eq=False)
class Appearing:
    """The constants of patches that spoil, come and go."""

    decay: Floats  # (R,) share per unit of time
    gone_below: Floats  # (R,) -1 where patches stay
    start: Floats  # (R,) stock at the start, 0 where a patch is not there yet
    seeds: tuple[tuple[slice, Seeding, Any], ...]  # patches, how they appear, and where: a shapely geometry
    left: tuple[Left, ...]
    spoils: bool
    comes: bool  # whether any patch comes and goes


def compile_appearing(
    scenario: Scenario, patches: Mapping[str, slice], slots: Mapping[str, slice], width: int
) -> Appearing | None:
    """Return the constants for `patches` by resource and `slots` by species, or None where all patches stay."""
    resources = scenario.resources
    each = [r for r in resources for _ in range(r.count)]
    decay = np.array([r.decay for r in each], float)
    ends = np.array([-1.0 if r.gone_below is None else r.gone_below for r in each], float)
    if not (decay.any() or (ends >= 0).any()):
        return None
    start = np.array([r.stock for r in each], float)
    for r in resources:
        if r.gone_below is not None:
            present = r.count if r.present is None or r.stock <= r.gone_below else r.present
            start[patches[r.name]][present:] = 0.0
    start[(ends >= 0) & (start <= ends)] = 0.0
    left = []
    for s in scenario.species:
        if s.remains is not None:
            share = np.zeros(width)
            share[: len(s.needs)] = [s.remains.needs.get(need.name, 0.0) for need in s.needs]
            causes = np.array([cause in s.remains.causes for cause in CAUSES])
            left.append(Left(slots[s.name], patches[s.remains.resource], s.remains, share, causes))
    return Appearing(
        decay=decay,
        gone_below=ends,
        start=start,
        seeds=tuple(
            (patches[r.name], r.seeding, room_of(r, scenario.arena, scenario.species) or polygon_of(scenario.arena))
            for r in resources
            if r.seeding is not None
        ),
        left=tuple(left),
        spoils=bool(decay.any()),
        comes=bool((ends >= 0).any()),
    )


def absent(model: Model, stock: Floats) -> Bools:
    """Return which patches are gone, (R,) for the stock (R,)."""
    if model.appearing is None:
        return np.zeros(len(stock), bool)
    return (model.appearing.gone_below >= 0) & (stock <= 0)


# ---- what a tick changes -------------------------------------------------------------------


def renew(model: Model, state: State, died: Bools, met: Met, rng: Mapping[str, np.random.Generator]) -> None:
    """Let stocks spoil and patches go, and new ones appear: what the dead leave, the rule's, and seeds."""
    table, outcome = model.appearing, met.outcome
    if outcome is not None and outcome.stock is not None:
        state.own("stock", "grown")
        change(model, state, outcome.stock)
    if table is None:
        return
    state.own("stock", "grown")
    if table.spoils:
        stored = np.where(table.decay > 0, state.stock, 0.0)
        add(state, stored * elementary.expm1(-table.decay * model.dt))
    if not table.comes:
        return
    state.own("resource_position", "bound_for")
    add(state, np.where((state.stock <= table.gone_below) & (table.gone_below >= 0), -state.stock, 0.0))
    if died.any():
        for left in table.left:
            leave(model, state, table, left, died)
    if outcome is not None:
        for name, rows in outcome.patches.items():
            place(model, state, model.patches[name], rows[:, :2], rows[:, 2])
    for patches, seeding, room in table.seeds:
        places = scatter_seeds(model, state, patches, seeding, room, rng["motion"])
        place(model, state, patches, places, np.full(len(places), model.resources.stock[patches.start]))


def add(state: State, amount: Floats) -> None:
    """Add `amount` (R,), which may be negative, to the stocks; their accounts tell it as growth."""
    state.stock += amount
    state.grown += amount


def change(model: Model, state: State, amount: Floats) -> None:
    """Add `amount` (R,), which may be negative, to stocks that are there, within 0 and the capacity."""
    finite = np.isfinite(state.stock) & ~absent(model, state.stock)
    after = np.clip(state.stock + amount, 0.0, np.maximum(model.resources.capacity, state.stock))
    add(state, np.where(finite, after - np.where(finite, state.stock, 0.0), 0.0))


def place(model: Model, state: State, patches: slice, places: Floats, stock: Floats) -> int:
    """Let patches appear at `places` (k, 2) with `stock` (k,) in free rows; return how many of them, from the first."""
    free: Ints = patches.start + np.flatnonzero(state.stock[patches] <= 0)[: len(places)]
    count = len(free)
    if count:
        state.resource_position[free] = model.plane.home(places[:count])
        state.stock[free] = stock[:count]
        state.grown[free] += stock[:count]
        state.bound_for[np.isin(state.bound_for, free)] = -1  # the one that it was bound for is gone
    return count


def leave(model: Model, state: State, table: Appearing, left: Left, died: Bools) -> None:
    """Let the bodies of one species that `died` (N,) leave patches, and take out of them what these hold."""
    rows = left.slots
    dead = rows.start + np.flatnonzero(died[rows] & left.causes[state.cause[rows]])
    low = np.where(left.share > 0, model.body.low[dead], 0.0)
    stored = np.maximum(state.internal[dead] - low, 0.0) * left.share  # (k, V)
    total = left.remains.body + stored.sum(axis=1)
    some = total > table.gone_below[left.patches.start]
    dead, stored, total = dead[some], stored[some], total[some]
    amount = np.minimum(total, model.resources.capacity[left.patches.start])
    count = place(model, state, left.patches, state.position[dead], amount)
    if count:
        state.own("internal", "given")
        part = stored[:count] * (amount / total)[:count, None]
        state.internal[dead[:count]] -= part
        state.given[dead[:count]] += part


def scatter_seeds(
    model: Model, state: State, patches: slice, seeding: Seeding, room: Any, rng: np.random.Generator
) -> Floats:
    """Return where seeds of a resource land in a tick, (k, 2)."""
    parents = patches.start + np.flatnonzero(state.stock[patches] > 0)
    anywhere = int(rng.poisson(seeding.rate * model.dt)) if seeding.rate else 0
    beside = int(rng.poisson(seeding.offspring * model.dt * len(parents))) if seeding.offspring and len(parents) else 0
    free = patches.stop - patches.start - len(parents)
    places = [np.empty((0, 2))]
    if min(anywhere, free):
        places.append(scatter_in(room, min(anywhere, free), rng, "seeds"))
    if beside:
        parent = state.resource_position[parents[rng.integers(len(parents), size=beside)]]
        turn, way = rng.uniform(-np.pi, np.pi, beside), seeding.reach * np.sqrt(rng.random(beside))
        land = parent + way[:, None] * np.stack([elementary.cos(turn), elementary.sin(turn)], axis=1)
        if not model.ground.torus:
            land = land[np.logical_and(model.ground.inside(land), model.ground.stays(parent, land))]
        places.append(model.plane.home(land))
    return np.concatenate(places)
