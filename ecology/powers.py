"""What a scenario's own rule may do beyond needs, deaths and places: checks of its outcome, and its own memory.

The memory is one array of the state, one name after the other, so that checkpoints, copies and forks have it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ecology.errors import EcologyError, nearest
from ecology.spec import require
from ecology.state import Floats

if TYPE_CHECKING:
    from ecology.meetings import Outcome, World
    from ecology.scenario import Scenario

SHARES = frozenset({"pace", "sight"})  # arrays of the state that are there only while a rule sets them


class Slot(NamedTuple):
    """Where a name's value stands in the memory."""

    rows: slice
    shape: tuple[int, ...]


# ---- memory ----------------------------------------------------------------------------------


def _number_array(value: object) -> Floats | None:
    """Return `value` as an array of finite numbers, None where it is none."""
    try:
        found = np.asarray(value)
    except ValueError:
        return None
    return found.astype(float) if found.dtype.kind in "biuf" and np.isfinite(found).all() else None


def check_memory(owner: str, memory: Mapping[str, object], has_rule: bool) -> None:
    """Raise EcologyError unless every value of `memory` is a finite number or an array of them."""
    require(
        has_rule or not memory,
        f"{owner}: memory is the rule's own state, and there is no rule; give one or leave it out.",
    )
    for name, value in memory.items():
        require(
            _number_array(value) is not None,
            f"{owner}: memory {name!r} must be a finite number or an array of them, got {value!r}.",
        )


def compile_memory(memory: Mapping[str, object]) -> dict[str, Slot]:
    """Return where each value stands in the one array."""
    found, at = {}, 0
    for name, value in memory.items():
        array = np.asarray(value, float)
        found[name] = Slot(slice(at, at + array.size), array.shape)
        at += array.size
    return found


def first_memory(memory: Mapping[str, object]) -> Floats | None:
    """Return the memory at the start, (M,); None where a rule has none."""
    return np.concatenate([np.asarray(value, float).ravel() for value in memory.values()]) if memory else None


def recall(where: Mapping[str, Slot], memory: Floats | None) -> dict[str, np.ndarray]:
    """Return the values by name, views of the `memory` (M,) that cannot be written."""
    if memory is None:
        return {}
    view = memory.view()
    view.setflags(write=False)
    return {name: view[slot.rows].reshape(slot.shape) for name, slot in where.items()}


def remember(where: Mapping[str, Slot], memory: Floats, values: Mapping[str, Any]) -> Floats:
    """Return the memory (M,) in which `values` have replaced those of their names."""
    after = memory.copy()
    for name, value in values.items():
        after[where[name].rows] = np.asarray(value, float).ravel()
    return after


# ---- the outcome of a rule ---------------------------------------------------------------------


def check_outcome(outcome: Outcome, scenario: Scenario, world: World, owner: str) -> None:
    """Raise EcologyError, which begins with `owner`, where a rule wants what cannot be."""
    state = world.state
    for word, like, low, high in (
        ("stock", state.stock, -np.inf, np.inf),
        ("pace", state.drive, 0.0, 1.0),
        ("sight", state.drive, 0.0, 1.0),
    ):
        value = getattr(outcome, word)
        if value is not None and (
            not isinstance(value, np.ndarray) or value.dtype.kind not in "biuf" or value.shape != like.shape
            or not np.isfinite(value).all() or (value < low).any() or (value > high).any()
        ):  # fmt: skip
            within = "finite numbers" if low < 0 else f"numbers from {low:g} to {high:g}"
            raise EcologyError(f"{owner}: {word} must be an array of {within} of shape {like.shape}, got {value!r}.")
    for word in ("patches", "births", "parents", "memory", "doors"):
        value = getattr(outcome, word)
        if not isinstance(value, dict):
            raise EcologyError(f"{owner}: {word} must be a dict by name, got {value!r}.")
    _check_patches(outcome, scenario, world, owner)
    _check_births(outcome, scenario, world, owner)
    for name, opens in outcome.doors.items():
        if name not in world.doors:
            raise EcologyError(f"{owner}: doors names the door {name!r}. {nearest(str(name), world.doors)}")
        if not isinstance(opens, (bool, np.bool_)):
            raise EcologyError(f"{owner}: the door {name!r} is to be open, True, or closed, False, got {opens!r}.")
    for name, value in outcome.memory.items():
        if name not in world.memory:
            raise EcologyError(
                f"{owner}: memory {name!r} is not in the memory of the scenario. {nearest(name, world.memory)} "
                "Write Scenario(memory={name: value at the start})."
            )
        array, shape = _number_array(value), world.memory[name].shape
        if array is None or array.shape != shape:
            raise EcologyError(f"{owner}: memory {name!r} must be finite numbers of shape {shape}, got {value!r}.")


def _check_places(places: Any, columns: int, world: World, owner: str, what: str) -> None:
    good = isinstance(places, np.ndarray) and places.dtype.kind in "iuf" and places.ndim == 2
    if not good or places.shape[1] != columns or not np.isfinite(places).all():
        row = "x and y" if columns == 2 else "x, y and stock"
        raise EcologyError(f"{owner}: {what} must be finite numbers of shape (k, {columns}), {row}, got {places!r}.")
    outside = ~world.inside(places[:, :2])
    if outside.any():
        raise EcologyError(
            f"{owner}: {what} has a place outside the arena, {places[outside][0, :2].tolist()}; "
            "world.inside(position) says which places are within."
        )


def _check_patches(outcome: Outcome, scenario: Scenario, world: World, owner: str) -> None:
    for name, rows in outcome.patches.items():
        known = {r.name: r for r in scenario.resources}
        if name not in known:
            raise EcologyError(f"{owner}: patches names the resource {name!r}. {nearest(str(name), known)}")
        least, most = known[name].gone_below, known[name].most
        if least is None:
            raise EcologyError(
                f"{owner}: patches of {name!r} cannot appear, they stay where they are; give the resource gone_below."
            )
        _check_places(rows, 3, world, owner, f"patches of {name!r}")
        if ((rows[:, 2] <= least) | (rows[:, 2] > most)).any():
            raise EcologyError(
                f"{owner}: a patch of {name!r} appears with a stock above {least:g} and at most {most:g}, got "
                f"{rows[:, 2].tolist()}."
            )


def _check_births(outcome: Outcome, scenario: Scenario, world: World, owner: str) -> None:
    known = {s.name: s for s in scenario.species}
    for name, places in outcome.births.items():
        if name not in known:
            raise EcologyError(f"{owner}: births names the species {name!r}. {nearest(str(name), known)}")
        if not known[name].grows:
            raise EcologyError(
                f"{owner}: nobody can be born into the species {name!r}; give it Birth(rate=0.0) and a capacity."
            )
        _check_places(places, 2, world, owner, f"births of {name!r}")
    for name, parents in outcome.parents.items():
        count, slots = len(outcome.births.get(name, ())), len(world.state.alive)
        good = isinstance(parents, np.ndarray) and parents.dtype.kind in "iu" and parents.shape == (count,)
        if not good or ((parents < -1) | (parents >= slots)).any():
            raise EcologyError(
                f"{owner}: parents of {name!r} must be {count} slots, one for each birth, or -1, got {parents!r}."
            )
