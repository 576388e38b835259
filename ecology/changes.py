"""What may be put into a state between ticks: the same that a scenario may say, and names that stay true."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import powers
from ecology.errors import EcologyError, nearest
from ecology.ground import wrap
from ecology.ground.outline import polygon_of
from ecology.model import Model
from ecology.scenario import FARTHEST, Scenario
from ecology.spec import require
from ecology.state import CAUSES, Bools, Floats, State

ROUNDING = 1e-9  # share of a capacity by which a stock that has grown to it may exceed it
SNAPSHOT = "the snapshot"  # in messages, what holds a wrong value
WHAT = {"b": "True or False", "i": "whole numbers", "f": "numbers"}


def read(fields: Mapping[str, Any], state: State) -> dict[str, np.ndarray]:
    """Return `fields` as arrays of the shape and type that they have in `state`; EcologyError where they are not."""
    known = state.arrays()
    found = {}
    for name, value in fields.items():
        if name not in known:
            raise EcologyError(f"the state has no array {name!r}. {nearest(name, known)}")
        like = known[name]
        try:
            given = np.asarray(value)
        except ValueError as error:
            raise EcologyError(f"state {name!r} has the shape {like.shape}, got {value!r}.") from error
        require(given.shape == like.shape, f"state {name!r} has the shape {like.shape}, got {given.shape}.")
        kind = like.dtype.kind
        fits = given.dtype.kind in {"b": "biuf", "i": "iuf", "f": "iuf"}[kind]
        if fits and kind == "b":
            fits = bool(np.isin(given, (0, 1)).all())
        if fits and kind == "i":
            fits = bool((np.isfinite(given) & (given == np.round(given)) & (np.abs(given) < 2.0**62)).all())
        require(fits, f"state {name!r} must be {WHAT[kind]}, got {value!r}.")
        found[name] = given.astype(like.dtype)  # a copy
    return found


def rename(changed: dict[str, np.ndarray], state: State, model: Model) -> None:
    """Add to `changed` what follows where `alive` is put: names, and causes of death, which only the dead have."""
    alive = changed["alive"]
    if "serial" not in changed:
        new = np.flatnonzero(alive & (state.serial < 0))
        require(
            not new.size or model.grows,
            f"set_state: nobody can live in the slots {new.tolist()}; a world without births has names only for the "
            "agents that start in it. Raise the count of their species.",
        )
        changed["serial"] = state.serial.copy()
        changed["serial"][new] = model.serials(state, len(new))
    if "cause" not in changed:
        changed["cause"] = np.where(alive, 0, np.where(state.alive, CAUSES.index("rule"), state.cause))
    for name in ("fatal_need", "killer"):
        if name not in changed:
            changed[name] = np.where(alive, -1, getattr(state, name))


def check_changes(changed: dict[str, np.ndarray], state: State, model: Model) -> None:
    """Raise EcologyError where `changed` would give `state` values that no world can reach; headings are wrapped."""
    scenario, body, table, plane, choices = model.scenario, model.body, model.resources, model.plane, model.choices
    alive = changed.get("alive", state.alive)
    slots, patches = len(alive), len(table.stock)
    names = max(state.next_serial, int(changed.get("serial", state.serial).max(initial=-1)) + 1)
    for name, value in changed.items():
        if value.dtype.kind == "f" and name != "stock":
            _hold(name, value, np.isfinite(value), "finite")
    if "heading" in changed:
        heading = changed["heading"]
        away = (heading < -np.pi) | (heading >= np.pi)
        changed["heading"] = np.where(away, wrap(heading), heading)
    if changed.keys() & {"internal", "alive"}:
        x = changed.get("internal", state.internal)
        low, high = body.low, body.high
        good = ((x >= low) & (x <= high)) | body.lethal | ~alive[:, None]  # beyond those that are lethal it dies
        if not good.all():
            slot, need = np.argwhere(~good)[0]
            _hold("internal", x, good, f"within the bounds of the need, {low[slot, need]:g} to {high[slot, need]:g}")
    if "set_point" in changed:
        x = changed["set_point"]
        _hold("set_point", x, (x >= body.least) & (x <= body.most), "within the set_range of the need")
    if "trait" in changed and model.heredity is not None:
        x = changed["trait"]
        _hold("trait", x, (x >= model.heredity.low) & (x <= model.heredity.high), "within the bounds of the trait")
    if "cue" in changed:
        _hold("cue", changed["cue"], (changed["cue"] >= 0) & (changed["cue"] <= 1), "from 0 to 1")
    if changed.keys() & {"position", "alive"}:
        place = changed.get("position", state.position)
        _hold("position", place, inside(scenario, place) | ~alive, "inside the arena")
    if "resource_position" in changed:
        place = changed["resource_position"] = plane.home(changed["resource_position"])
        _hold("resource_position", place, inside(scenario, place), "inside the arena")
    if "stock" in changed:
        stock = changed["stock"]
        good = (stock >= 0) & (stock <= table.capacity * (1.0 + ROUNDING))
        if not good.all():
            _hold("stock", stock, good, f"from 0 to the capacity, {table.capacity[np.argmin(good)]:g}")
    for name, least in (("age", 0.0), ("hold", 0.0)):
        if name in changed:
            _hold(name, changed[name], changed[name] >= least, "at least 0")
    if "load" in changed and model.hauling is not None:
        load = changed["load"]
        _hold("load", load, (load >= 0) & (load <= model.hauling.most), "from 0 to what its species carries")
    for name in powers.SHARES:
        if name in changed:
            _hold(name, changed[name], (changed[name] >= 0) & (changed[name] <= 1), "from 0 to 1")
    for name, low_, high_ in (
        ("action", 0, choices), ("cause", 0, len(CAUSES)), ("fatal_need", -1, body.low.shape[1]),
        ("bound_for", -1, patches), ("bit", -1, slots), ("gave", -1, slots), ("closed", 0, np.inf),
        ("parent", -1, names), ("killer", -1, names),
    ):  # fmt: skip
        if name in changed:
            value, top = changed[name], np.broadcast_to(high_, changed[name].shape)
            good = (value >= low_) & (value < top)
            if not good.all():
                _hold(name, value, good, f"a whole number from {low_} to {top[np.argmin(good)] - 1}")
    _names(changed, state, model, alive)


def check_snapshot(state: State, solver: Mapping[str, np.ndarray], model: Model) -> None:
    """Raise EcologyError if a snapshot's state, or the inputs of its `solver`, has values that no world can reach.

    A fork may change the arena, the bounds and the stocks of a scenario under a state, so those are not compared; see
    `check_stocks` for a run that is no fork.
    """
    slots, patches, names = model.size, len(model.resources.stock), state.next_serial
    for name, count in (("tick", state.tick), ("next_serial", names), ("returned", state.returned)):
        good = type(count) is int and 0 <= count < 2**62
        require(good, f"the snapshot's {name} is a whole number of at least 0, got {count!r}.")
    require(
        type(state.time) in (int, float) and 0.0 <= state.time < np.inf,
        f"the snapshot's time is a number of at least 0, got {state.time!r}.",
    )
    arrays = {**state.arrays(), **solver}
    for name, value in arrays.items():
        if value.dtype.kind == "f" and name != "stock":
            _hold(name, value, np.isfinite(value), "finite", SNAPSHOT)
    (left, bottom), (right, top) = model.scenario.arena.extent
    reach = max(right - left, top - bottom)  # a fork may have moved the walls
    for name in ("position", "resource_position", "told_position"):
        near = (arrays[name] >= (left - reach, bottom - reach)) & (arrays[name] <= (right + reach, top + reach))
        _hold(name, arrays[name], near, "in the arena", SNAPSHOT)
    speed, fastest = solver["told_velocity"], FARTHEST * model.radius.max(initial=0.0) / model.dt
    if model.stages is not None:
        fastest *= model.stages.size.max()
    _hold("told_velocity", speed, np.abs(speed) <= fastest * (1 + ROUNDING), f"at most {fastest:g}", SNAPSHOT)
    _hold("stock", state.stock, state.stock >= 0, "at least 0", SNAPSHOT)
    for name in powers.SHARES & arrays.keys():
        _hold(name, arrays[name], (arrays[name] >= 0) & (arrays[name] <= 1), "from 0 to 1", SNAPSHOT)
    _hold("heading", state.heading, np.abs(state.heading) <= np.pi, "from -pi to pi", SNAPSHOT)
    for name, least, most in (("partner", -1, slots), ("second", -1, names), ("cue", 0, np.nextafter(1, 2))):
        if name in arrays:
            value = arrays[name]
            _hold(name, value, (value >= least) & (value < most), "of its range", SNAPSHOT)
    for name, low, high in (
        ("age", 0, np.inf), ("hold", 0, np.inf), ("closed", 0, np.inf), ("action", 0, model.choices),
        ("cause", 0, len(CAUSES)), ("fatal_need", -1, model.body.low.shape[1]), ("bound_for", -1, patches),
        ("bit", -1, slots), ("gave", -1, slots), ("parent", -1, names), ("killer", -1, names), ("serial", -1, names),
    ):  # fmt: skip
        value = arrays[name]
        _hold(name, value, (value >= low) & (value < high), "of its range", SNAPSHOT)
    used, times = np.unique(state.serial[state.serial >= 0], return_counts=True)
    require((times == 1).all(), f"the snapshot has the serials {used[times > 1].tolist()} twice.")
    _hold("serial", state.serial, (state.serial >= 0) | ~state.alive, "at least 0 where alive", SNAPSHOT)
    fits = ((state.cause > 0) == ~state.alive) | (state.serial < 0)
    _hold("cause", state.cause, fits, "0 where alive and above 0 where dead", SNAPSHOT)


def check_stocks(state: State, model: Model) -> None:
    """Raise EcologyError if a stock of a snapshot is beyond the capacity of its resource.

    Where patches appear, one that a body leaves may hold more in its first tick, but not without end.
    """
    capacity = model.resources.capacity
    most = capacity * (1.0 + ROUNDING)
    if model.appearing is not None:
        most = np.where(np.isfinite(capacity), np.finfo(float).max, np.inf)
    _hold("stock", state.stock, state.stock <= most, "at most the capacity", SNAPSHOT)


def inside(scenario: Scenario, place: Floats) -> Bools:
    """Return which of `place` (n, 2) a scenario would allow, (n,); all where the arena is a torus."""
    if scenario.arena.torus:
        return np.ones(len(place), bool)
    import shapely  # slow to load

    found: Bools = shapely.contains_xy(polygon_of(scenario.arena), place)
    return found


def _names(changed: Mapping[str, np.ndarray], state: State, model: Model, alive: Bools) -> None:
    """Raise EcologyError where two would have one name, or names and causes of death do not fit the living."""
    serial, cause = changed.get("serial", state.serial), changed.get("cause", state.cause)
    if "serial" in changed:
        same, named = serial == state.serial, model.grows
        new = named & (serial >= state.next_serial)
        _hold(
            "serial", serial, same | new, f"what it is, or in a world of births a new one from {state.next_serial} on"
        )
        used, count = np.unique(serial[serial >= 0], return_counts=True)
        require(
            (count == 1).all(), f"state 'serial' must be another in every slot, got {used[count > 1].tolist()} twice."
        )
        _hold("serial", serial, (serial >= 0) | ~alive, "at least 0 where alive")
    if "cause" in changed:
        fits = ((cause > 0) == ~alive) | (serial < 0)
        _hold("cause", cause, fits, "0 where alive and above 0 where dead")


def _hold(name: str, value: np.ndarray, good: np.ndarray, rule: str, where: str = "set_state") -> None:
    """Raise EcologyError that names the first row of `value` that is not `good` and the `rule` that it breaks."""
    rows = good.reshape(len(good), -1).all(axis=1) if len(good) else good
    if not rows.all():
        row = int(np.argmin(rows))
        raise EcologyError(f"{where}: {name}[{row}] must be {rule}, got {value[row].tolist()!r}.")
