"""What bodies carry: they take it out of stocks, put it down as a patch where they stand, or store it in one.

Shapes: N slots, K resources, R patches. A load is in units of the resource's stock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ecology import appearing, resources
from ecology.spec import Resource, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model
    from ecology.senses import Perception


@dataclass(frozen=True, eq=False)
class Carriers:
    """The constants of one species that carries."""

    slots: slice
    takes: Ints  # (A,) resource, -1 without
    drops: Ints  # (A,) resource that is put down, -1 without
    into: Ints  # (A,) resource whose patch it is put into, -1 without
    rate: Floats  # (A,) units per unit of time
    rest: int


@dataclass(frozen=True, eq=False)
class Hauling:
    """The constants of all that is carried."""

    each: tuple[Carriers, ...]
    most: Floats  # (N, K) that a body carries
    patches: tuple[slice, ...]  # by resource
    comes: Bools  # (K,) whether its patches come and go


def compile_hauling(
    species: Sequence[Species], things: Sequence[Resource], slots: Mapping[str, slice], patches: Mapping[str, slice]
) -> Hauling | None:
    """Return the constants of what `species` carry; None if no species does."""
    if not any(s.carries for s in species):
        return None
    row = {r.name: i for i, r in enumerate(things)}
    most = np.zeros((sum(s.slots for s in species), len(things)))
    each = []
    for s in species:
        for name, amount in s.carries.items():
            most[slots[s.name], row[name]] = amount

        def of(kind: str, word: str, s: Species = s) -> Ints:
            return np.array([row[getattr(a, word)] if a.kind == kind else -1 for a in s.actions], np.int64)

        rest = next(i for i, a in enumerate(s.actions) if a.kind == "rest")
        rate = np.array([a.amount for a in s.actions], float)
        each.append(
            Carriers(slots[s.name], of("take", "resource"), of("drop", "resource"), of("drop", "into"), rate, rest)
        )
    comes = np.array([r.gone_below is not None for r in things], bool)
    return Hauling(tuple(each), most, tuple(patches[r.name] for r in things), comes)


# ---- what is open --------------------------------------------------------------------------------


def close_actions(model: Model, state: State, here: Ints, masks: Mapping[str, Bools]) -> None:
    """Close what cannot be taken or put down in `masks`, (n, A) by species; `here` (N, K) is where each stands."""
    table, load = model.hauling, state.load
    if table is None or load is None:
        return
    for carriers, mask in zip(table.each, masks.values(), strict=True):
        rows = carriers.slots
        for a in np.flatnonzero(carriers.takes >= 0):
            k = carriers.takes[a]
            mask[:, a] &= (here[rows, k] >= 0) & (load[rows, k] < table.most[rows, k])
        for a in np.flatnonzero(carriers.drops >= 0):
            k, into = carriers.drops[a], carriers.into[a]
            stores = _store_of(model, state, np.arange(rows.start, rows.stop), into) >= 0
            mask[:, a] &= (load[rows, k] > 0) & (stores | table.comes[into])
        mask[state.alive[rows] & ~mask.any(axis=1), carriers.rest] = True


def _store_of(model: Model, state: State, who: Ints, resource: int) -> Ints:
    """Return the first patch of a resource with room that each slot of `who` (k,) is in, -1 without, (k,)."""
    assert model.hauling is not None
    patches = model.hauling.patches[resource]
    fits = state.inside[who, patches] & (state.stock < model.resources.capacity)[patches]
    return np.where(fits.any(axis=1), patches.start + fits.argmax(axis=1), -1)


# ---- what a tick changes -------------------------------------------------------------------------


def haul(model: Model, state: State, seen: Perception, eaten: Floats) -> None:
    """Let bodies take and put down; `eaten` (R,) is what meals have taken out of the stocks in this tick."""
    table = model.hauling
    if table is None:
        return
    state.own("load", "stock", "grown", "resource_position", "bound_for")
    for carriers in table.each:
        rows = carriers.slots
        action, alive = state.action[rows], state.alive[rows]
        for a in np.flatnonzero((carriers.takes >= 0) | (carriers.drops >= 0)).tolist():
            who = rows.start + np.flatnonzero(alive & (action == a))
            if who.size and carriers.takes[a] >= 0:
                _take(model, state, who, int(carriers.takes[a]), carriers.rate[a] * model.dt, seen.here, eaten)
            elif who.size:
                _drop(model, state, who, int(carriers.drops[a]), int(carriers.into[a]), carriers.rate[a] * model.dt)


def _take(model: Model, state: State, who: Ints, kind: int, most: float, here: Ints, eaten: Floats) -> None:
    """Let slots `who` (k,) take at most `most` each; where a stock is short they share it as eaters do."""
    assert model.hauling is not None
    assert state.load is not None
    room = np.maximum(model.hauling.most[who, kind] - state.load[who, kind], 0.0)
    source = here[who, kind]
    wanted = np.where(source >= 0, np.minimum(most, room), 0.0)
    part, taken = resources.share(wanted, source, np.where(state.available, state.stock - eaten, 0.0))
    state.load[who, kind] += wanted * part
    appearing.add(state, np.where(np.isfinite(state.stock), -taken, 0.0))


def _drop(model: Model, state: State, who: Ints, kind: int, into: int, most: float) -> None:
    """Let slots `who` (k,) put down at most `most` each, into the patch that each is in, or as a new one.

    What finds no place they keep; where a patch is nearly full, they share the room.
    """
    assert state.load is not None
    wanted = np.minimum(most, state.load[who, kind])
    patch = _store_of(model, state, who, into)
    stored = patch >= 0
    if stored.any():
        stays = np.isinf(state.stock)
        room = np.where(stays, np.inf, model.resources.capacity - np.where(stays, 0.0, state.stock))
        part, put = resources.share(wanted[stored], patch[stored], room)
        state.load[who[stored], kind] -= wanted[stored] * part
        appearing.add(state, np.where(np.isfinite(state.stock), put, 0.0))
    state.load[who[~stored], kind] -= _put_down(model, state, into, who[~stored], wanted[~stored])


def _put_down(model: Model, state: State, resource: int, who: Ints, amount: Floats) -> Floats:
    """Let patches of `amount` (k,) appear under slots `who` (k,); return what each has put down, 0 without a place."""
    table, ends = model.hauling, model.appearing
    assert table is not None
    found = np.zeros(len(who))
    if not table.comes[resource] or ends is None:
        return found
    patches = table.patches[resource]
    amount = np.minimum(amount, model.resources.capacity[patches.start])
    enough = np.flatnonzero(amount > ends.gone_below[patches.start])
    enough = enough[: appearing.place(model, state, patches, state.position[who[enough]], amount[enough])]
    found[enough] = amount[enough]
    return found


def fall(model: Model, state: State, died: Bools) -> None:
    """Drop the load of agents that `died` (N,) as patches, where these come and go; the rest is lost with it."""
    if model.hauling is None or state.load is None or not died.any():
        return
    state.own("load", "stock", "grown", "resource_position", "bound_for")
    for kind in np.flatnonzero(state.load[died].any(axis=0)).tolist():
        who = np.flatnonzero(died & (state.load[:, kind] > 0))
        _put_down(model, state, kind, who, state.load[who, kind])
    state.load[died] = 0.0
