"""Agents that leave a world between two ticks and arrive in another.

A body keeps its serial, its age, its needs, its traits and its memories. Its position and its relations to other agents
stay behind.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ecology import heredity, life
from ecology.spec import require
from ecology.state import Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

Bodies = Mapping[str, np.ndarray]  # field of the state -> rows (k, ...) of k agents of one species

GOES_ALONG = (
    "serial",
    "parent",
    "second",
    "age",
    "internal",
    "action",
    "hold",
    "set_point",
    "trait",
    "traces",
    "failed",
)


def check_can_migrate(model: Model, species: str) -> None:
    """Raise EcologyError where agents of `species` cannot leave this world or arrive in it."""
    group = model.group(species)
    s = model.scenario.species[group.index]
    require(s.grows, f"agents of {species!r} can only arrive where births are allowed: give it Birth(rate=0.0).")
    require(not s.carries, f"agents of {species!r} carry things, which belong to their world; they cannot migrate.")


def take_out(state: State, slots: Ints) -> Bodies:
    """Return the bodies in `slots` (k,), and reset those slots as if never used; `state` is a new one."""
    bodies = {
        name: np.array(value[slots]) for name in GOES_ALONG if isinstance(value := getattr(state, name), np.ndarray)
    }
    state.own("alive", "serial", "parent", "cause", "fatal_need", "killer")
    state.alive[slots], state.cause[slots] = False, 0
    for name in ("serial", "parent", "fatal_need", "killer"):
        getattr(state, name)[slots] = -1
    return bodies


def bring_in(model: Model, state: State, species: str, bodies: Bodies, rng: np.random.Generator) -> Ints:
    """Place `bodies` of `species` in free slots of `state`, a new one; return these slots (k,).

    They start where the species' agents start at birth, drawn by `rng`. Raises EcologyError if there are too few
    slots, or if the bodies are of another kind.
    """
    check_can_migrate(model, species)
    slots = _free(model, state, species, len(bodies["serial"]))
    mine = {name: value.shape[1:] for name in GOES_ALONG if isinstance(value := getattr(state, name), np.ndarray)}
    require(
        {name: rows.shape[1:] for name, rows in bodies.items()} == mine,
        f"agents of {species!r} arrive with {sorted(bodies)}, and here they have {sorted(mine)}; islands between which "
        "a species migrates need the same species.",
    )
    if not slots.size:
        return slots
    following = max(state.next_serial, int(bodies["serial"].max()) + 1)
    _start(model, state, species, slots, rng)
    state.received[slots] += bodies["internal"] - state.internal[slots]
    for name, values in bodies.items():
        state.own(name)
        getattr(state, name)[slots] = values
    state.next_serial = following
    return slots


def breed(
    model: Model, state: State, species: str, parents: Ints, traits: Floats | None, rng: np.random.Generator
) -> Ints:
    """Start newborns of `parents` (k,), serials of agents anywhere, in free slots of `state`; return the slots (k,).

    They inherit `traits` (k, T); with None, or without parents, they have no traits of their own.
    """
    check_can_migrate(model, species)
    slots = _free(model, state, species, len(parents))
    if slots.size:
        _start(model, state, species, slots, rng)
        state.parent[slots] = parents
        if traits is not None:
            heredity.settle(model, state, slots, traits)
    return slots


def _free(model: Model, state: State, species: str, count: int) -> Ints:
    """Return the first `count` free slots of a species; EcologyError where there are fewer."""
    rows = model.group(species).slots
    slots: Ints = rows.start + np.flatnonzero(~state.alive[rows])[:count]
    require(
        len(slots) == count,
        f"{count} agents of {species!r} arrive, and {len(slots)} slots are free; raise the capacity of the species.",
    )
    return slots


def _start(model: Model, state: State, species: str, slots: Ints, rng: np.random.Generator) -> None:
    """Start lives in `slots`, where agents of the species start at birth."""
    position, heading = life.place(model.ground, model.scenario.species[model.group(species).index], len(slots), rng)
    state.own("lost", "internal", "hold")
    life.start_lives(model, state, slots, position, heading)
