"""Actions as arrays: controls, motions and the action mask of all slots of a species at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ecology import elementary, kernels
from ecology.errors import EcologyError
from ecology.spec import Resource, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model
    from ecology.senses import Perception


@dataclass(frozen=True)
class ActionTable:
    """The actions of one species in arrays, A actions and V needs (the most of any species)."""

    names: tuple[str, ...]  # A
    kinds: tuple[str, ...]  # A
    control: Floats  # (A, V) u, per unit of time
    intake: Floats  # (A, V) the part of u that is taken out of a resource's stock, per unit of time
    speed: Floats  # (A,)
    turn: Floats  # (A,) radians per unit of time
    direction: Floats  # (A,) absolute direction of a move, NaN: the heading
    consumes: Ints  # (A,) resource index, -1 without
    goes_to: Ints  # (A,) resource index, -1 without
    meets: Ints  # (A,) species index of whom it bites or gives to, -1 without
    meeting: tuple[int, ...]  # the actions that meet someone
    bites: Bools  # (A,)
    reach: Floats  # (A,)
    chance: Floats  # (A,) of a bite, per unit of time
    gain: Floats  # (A, V) of a bite, units
    damage: Floats  # (A, V) of a bite, units by the columns of the bitten; NaN: it kills
    gives: Floats  # (A, V) per unit of time
    arrives: Floats  # (A, V, V) share of what is given of a need (row) that the receiver gets of one (column)
    duration: Floats  # (A,)
    opens_from: Floats  # (A, V)
    closes_at: Floats  # (A, V)
    rest: int  # index of the rest action
    committed: bool  # whether a go_to excludes the other actions until it ends


def compile_actions(species: Species, resources: tuple[Resource, ...], everyone: Sequence[Species]) -> ActionTable:
    """Return the action table of `species`, which meets `everyone`; it has columns for as many needs as any of them."""
    width = max(len(s.needs) for s in everyone)
    columns = {s.name: {need.name: i for i, need in enumerate(s.needs)} for s in everyone}
    column = columns[species.name]
    index = {s.name: i for i, s in enumerate(everyone)}
    row = {resource.name: i for i, resource in enumerate(resources)}
    acts = species.actions
    control = np.zeros((len(acts), width))
    opens_from = np.full((len(acts), width), -np.inf)
    closes_at = np.full((len(acts), width), np.inf)
    gain, gives, damage = np.zeros((3, len(acts), width))
    arrives = np.zeros((len(acts), width, width))
    for i, action in enumerate(acts):
        for name, value in action.control.items():
            control[i, column[name]] = value
        for name, value in action.gain.items():
            gain[i, column[name]] = value
        for name, value in (action.damage or {}).items():
            damage[i, columns[str(action.species)][name]] = value
        if action.damage is None:
            damage[i] = np.nan
        for name, value in action.gives.items():
            gives[i, column[name]] = value
            arrives[i, column[name], columns[str(action.species)][name]] = action.efficiency
        for name, value in action.opens_from.items():
            opens_from[i, column[name]] = value
        thresholds = dict(action.closes_at)
        if action.kind != "sleep":
            for name, value in species.collapse.items():
                thresholds[name] = min(value, thresholds.get(name, np.inf))
        for name, value in thresholds.items():
            closes_at[i, column[name]] = value
    fed = np.zeros(width, bool)  # a need that cannot lie below its set point is tired, not fed
    fed[: len(species.needs)] = [need.low < need.set_point for need in species.needs]
    consumes = np.array([a.kind == "consume" for a in acts])
    resource = [row[a.resource] if a.resource is not None else -1 for a in acts]
    return ActionTable(
        names=tuple(a.name for a in acts),
        kinds=tuple(a.kind for a in acts),
        control=control,
        intake=np.where(consumes[:, None] & fed, np.maximum(control, 0.0), 0.0),
        speed=np.array([a.speed for a in acts], float),
        turn=np.array([a.turn for a in acts], float),
        direction=np.array([np.nan if a.direction is None else a.direction for a in acts], float),
        consumes=np.array([r if a.kind == "consume" else -1 for a, r in zip(acts, resource, strict=True)], np.int64),
        goes_to=np.array([r if a.kind == "go_to" else -1 for a, r in zip(acts, resource, strict=True)], np.int64),
        meets=np.array([-1 if a.species is None else index[a.species] for a in acts], np.int64),
        meeting=tuple(i for i, a in enumerate(acts) if a.species is not None),
        bites=np.array([a.kind == "bite" for a in acts]),
        reach=np.array([a.reach for a in acts], float),
        chance=np.array([a.chance for a in acts], float),
        gain=gain,
        damage=damage,
        gives=gives,
        arrives=arrives,
        duration=np.array([a.duration for a in acts], float),
        opens_from=opens_from,
        closes_at=closes_at,
        rest=next(i for i, a in enumerate(acts) if a.kind == "rest"),
        committed=species.commitment == "committed",
    )


class Deeds(NamedTuple):
    """What bodies do in a tick, an open action each."""

    control: Floats  # (N, V) u, per unit of time; stages that follow write into it
    speed: Floats  # (N,)
    direction: Floats  # (N,) radians
    closed: Bools  # (N,) agents whose action was closed and was replaced


def decide(model: Model, state: State, seen: Perception, actions: np.ndarray) -> Deeds:
    """Return what each body does of the `actions` (N,) that were chosen; closed ones are replaced."""
    chosen = checked_actions(model, state, actions)
    n = model.size
    control = np.empty_like(state.internal)
    speed, direction, way, closed = np.empty(n), np.empty(n), np.empty((n, 2)), np.empty(n, bool)
    state.own("heading", "action", "hold", "bound_for")
    going = 0
    for group, table in model.acting:
        going += kernels.decide(
            chosen, seen.masks[group.name], group.slots.start, model.dt, state.alive, state.hold, state.action,
            state.heading, state.bound_for, state.position, state.resource_position, seen.toward,
            model.plane.size, model.plane.torus, table.control, table.speed, table.turn, table.direction,
            table.goes_to, table.duration, table.bites, table.rest, control, speed, direction, closed, way,
        )  # fmt: skip
    if going:
        rows = np.flatnonzero(state.bound_for >= 0)
        state.heading[rows] = direction[rows] = elementary.arctan2(way[rows, 1], way[rows, 0])
    state.closed = state.closed + closed
    return Deeds(control, speed, direction, closed)


def checked_actions(model: Model, state: State, actions: np.ndarray) -> Ints:
    """Return the `actions` (N,), 0 in dead slots, or raise EcologyError for an unknown one."""
    if actions.shape != (model.size,) or actions.dtype.kind not in "iu":
        raise EcologyError(
            f"actions must be {model.size} whole numbers, one a slot, got {actions.dtype} {actions.shape}."
        )
    found = np.where(state.alive, actions, 0).astype(np.int64)
    bad = kernels.first_unknown(found, model.choices)
    if bad >= 0:
        raise EcologyError(
            f"the action of {model.name_of(bad, state.serial)} must be a whole number from 0 to "
            f"{model.choices[bad] - 1}, got {int(actions[bad])}."
        )
    return found


def open_actions(model: Model, state: State, here: Ints, toward: Ints, targets: dict[str, Ints]) -> dict[str, Bools]:
    """Return A_zeta by species, which actions are open, (n, A).

    Thresholds of the body close actions; consume is open where there is a patch `here` (N, K) of its resource, go_to
    where one leads `toward` (N, K) another, bite and give where there is a target (n, A), all -1 without; an action
    that still immobilises is the only one open. A dead slot has no open action.
    """
    return {
        group.name: kernels.open_actions(
            state.internal[group.slots], state.alive[group.slots], state.hold[group.slots], state.action[group.slots],
            state.bound_for[group.slots], here[group.slots], toward[group.slots], targets[group.name],
            table.opens_from, table.closes_at, table.consumes, table.goes_to, table.meets, table.rest, table.committed,
        )
        for group, table in model.acting
    }  # fmt: skip
