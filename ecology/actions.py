"""Actions as arrays: controls, motions and the action mask of all slots of a species at once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ecology import elementary, fields, life_stages
from ecology.compiler_cache import compiled, use_cache
from ecology.elementary import angle_of
from ecology.errors import EcologyError
from ecology.ground import plane
from ecology.ground.plane import way_along
from ecology.spec import Action, Resource, Species
from ecology.state import Bodies, Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model
    from ecology.senses import Perception

use_cache(__file__, plane.__file__, elementary.__file__)


class Effects(NamedTuple):
    """What an action makes a body do: columns of `ActionTable`."""

    control: Floats
    intake: Floats
    speed: Floats
    turn: Floats
    direction: Floats
    consumes: Ints
    goes_to: Ints
    duration: Floats
    bites: Bools
    rest: int


class Conditions(NamedTuple):
    """When an action is open: columns of `ActionTable`."""

    opens_from: Floats
    closes_at: Floats
    consumes: Ints
    goes_to: Ints
    meets: Ints
    rest: int
    committed: bool


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
    chance: Floats  # (A,) of a bite or a meal, per unit of time
    drain: Floats | None  # (A, V) share of x that is lost per unit of time; None: no action drains
    by_stock: Bools  # (A,) whether a meal is the smaller, the less of its capacity the patch holds
    gain: Floats  # (A, V) of a bite, units
    damage: Floats  # (A, V) of a bite, units by the columns of the bitten; NaN: it kills
    gives: Floats  # (A, V) per unit of time
    arrives: Floats  # (A, V, V) share of what is given of a need (row) that the receiver gets of one (column)
    duration: Floats  # (A,)
    opens_from: Floats  # (A, V)
    closes_at: Floats  # (A, V)
    rest: int  # index of the rest action
    committed: bool  # whether a go_to excludes the other actions until it ends

    @cached_property
    def effects(self) -> Effects:
        """Return what actions make a body do."""
        return Effects(*(getattr(self, name) for name in Effects._fields))

    @cached_property
    def conditions(self) -> Conditions:
        """Return when actions are open."""
        return Conditions(*(getattr(self, name) for name in Conditions._fields))


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
        drain=_drains(acts, columns[species.name], width) if any(a.drain for a in acts) else None,
        by_stock=np.array([a.by_stock for a in acts]),
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


def _drains(acts: Sequence[Action], columns: Mapping[str, int], width: int) -> Floats:
    """Return the share of x that each of A actions takes of each need per unit of time, (A, V)."""
    found = np.zeros((len(acts), width))
    for a, action in enumerate(acts):
        for name, rate in action.drain.items():
            found[a, columns[name]] = rate
    return found


class Deeds(NamedTuple):
    """What bodies do in a tick, an open action each."""

    control: Floats  # (N, V) u, per unit of time; stages that follow write into it
    speed: Floats  # (N,)
    direction: Floats  # (N,) radians
    closed: Bools  # (N,) agents whose action was closed and was replaced
    way: Floats  # (N, 2) to the patch that a body goes to
    consumes: Ints  # (N,) resource, -1 without
    intake: Floats  # (N, V) the part of u that is taken out of a resource's stock, per unit of time
    busy: Ints  # (2,) how many bodies go to a patch, and how many consume


def no_deeds(n: int, needs: int) -> Deeds:
    """Return deeds to be written for n slots."""
    empty = np.empty
    return Deeds(
        empty((n, needs)), empty(n), empty(n), empty(n, bool), empty((n, 2)), empty(n, np.int64), empty((n, needs)),
        np.zeros(2, np.int64),
    )  # fmt: skip


def decide(model: Model, state: State, seen: Perception, actions: np.ndarray, steering: Floats | None = None) -> Deeds:
    """Return what each body does of the `actions` (N,) that were chosen; closed ones are replaced.

    A body that moves along its heading does so at the speed and the turn rate of `steering` (N, 2), where that is given
    and not NaN, in place of its action's.
    """
    before = state.heading
    chosen = whole_numbers(model, actions)
    deeds = no_deeds(*state.internal.shape)
    state.own("heading", "action", "hold", "bound_for")
    bodies = state.bodies()
    for group, table in model.acting:
        mask = seen.masks[group.name]
        bad = apply_choices(group.slots.start, chosen, mask, seen.toward, model.dt, table.effects, bodies, deeds)
        if bad >= 0:
            raise EcologyError(
                f"the action of {model.name_of(bad, state.serial)} must be a whole number from 0 to "
                f"{model.choices[bad] - 1}, got {int(actions[bad])}."
            )
        if table.drain is not None:
            deeds.control[group.slots] -= table.drain[state.action[group.slots]] * state.internal[group.slots]
    if deeds.busy[0]:
        lead(bodies, state.resource_position, model.plane.period, model.dt, deeds.speed, deeds.direction, deeds.way)
    if (factor := pace(model, state)) is not None:
        hurry(model, state, deeds, factor)
    if steering is not None:
        steer(model, state, steering, before, deeds, factor)
    state.closed = state.closed + deeds.closed
    return deeds


def steer(model: Model, state: State, steering: Floats, before: Floats, deeds: Deeds, factor: Floats | None) -> None:
    """Write speed and direction of the bodies that move as `steering` (N, 2) says; see `decide`.

    Speed and turn rate are kept within what the species' own moves and turns can do; headings are turned from those
    `before` the tick (N,).
    """
    speed, direction = deeds.speed, deeds.direction
    for group, table in model.acting:
        rows, action = group.slots, state.action[group.slots]
        kinds = np.array(table.kinds)
        moves = (kinds == "move") & np.isnan(table.direction)
        if not moves.any():
            continue
        wanted = steering[rows]
        steers = state.alive[rows] & moves[action] & ~np.isnan(wanted).any(axis=1)
        slots = rows.start + np.flatnonzero(steers)
        swerve = np.abs(table.turn).max()
        turn = np.clip(wanted[steers, 1], -swerve, swerve)
        state.heading[slots] = (before[slots] + turn * model.dt + math.pi) % (2 * math.pi) - math.pi
        direction[slots] = state.heading[slots]
        speed[slots] = np.clip(wanted[steers, 0], 0.0, table.speed[action[steers]])
        if factor is not None:
            speed[slots] *= factor[slots]


def pace(model: Model, state: State) -> Floats | None:
    """Return the factor of every body's speed by age, traits, fields and the rule, (N,); None without any."""
    mud = model.fields is not None and model.fields.slows
    found = None
    for factor in (
        None if model.stages is None else model.stages.of(model.stages.speed, state.age),
        None if model.heredity is None else model.heredity.values(state, "speed", 1.0),
        fields.share(model, state, "slowing") if mud else None,
        state.pace,
    ):
        found = factor if found is None else found if factor is None else found * factor
    return found


def hurry(model: Model, state: State, deeds: Deeds, factor: Floats) -> None:
    """Multiply the speed of the deeds by `factor` (N,); a go_to still ends where it leads."""
    speed, way = deeds.speed, deeds.way
    going, left = np.flatnonzero(state.bound_for >= 0), np.full(len(speed), np.inf)
    left[going] = np.sqrt(way[going, 0] ** 2 + way[going, 1] ** 2) / model.dt
    for group, table in model.acting:
        rows = group.slots
        full = table.speed[state.action[rows]] * factor[rows]
        speed[rows] = np.where(state.alive[rows], np.minimum(full, left[rows]), 0.0)


def whole_numbers(model: Model, actions: np.ndarray) -> Ints:
    """Return the `actions` (N,) as 64-bit integers, or raise EcologyError where they are none."""
    if actions.shape != (model.size,) or actions.dtype.kind not in "iu":
        raise EcologyError(
            f"actions must be {model.size} whole numbers, one a slot, got {actions.dtype} {actions.shape}."
        )
    return actions.astype(np.int64, copy=False)


def open_actions(
    model: Model, state: State, bodies: Bodies, here: Ints, toward: Ints, targets: dict[str, Ints]
) -> dict[str, Bools]:
    """Return A_zeta by species, which actions are open, (n, A).

    Thresholds of the body close actions; consume is open where there is a patch `here` (N, K) of its resource, go_to
    where one leads `toward` (N, K) another, bite and give where there is a target (n, A), all -1 without; an action
    that still immobilises is the only one open. A dead slot has no open action.
    """
    masks = {
        group.name: open_masks(
            group.slots.start, bodies, state.internal, here, toward, targets[group.name], table.conditions
        )
        for group, table in model.acting
    }
    if model.stages is not None:
        life_stages.close(model, state, masks)
    if model.cued is not None:
        close_uncued(model, state, masks)
    return masks


def compile_cued(everyone: Sequence[Species], cues: Mapping[str, int]) -> tuple[Ints | None, ...] | None:
    """Return by species the cue that each action waits for, (A,), -1 for none; None if no action waits."""
    found = [
        np.array([-1 if a.cue is None else cues[a.cue] for a in s.actions], np.int64)
        if any(a.cue is not None for a in s.actions)
        else None
        for s in everyone
    ]
    return tuple(found) if any(each is not None for each in found) else None


def close_uncued(model: Model, state: State, masks: dict[str, Bools]) -> None:
    """Close in `masks`, by species (n, A), actions whose cue is not shown; an action that binds a body continues."""
    assert model.cued is not None
    assert state.cue is not None
    for (group, table), cue in zip(model.acting, model.cued, strict=True):
        if cue is None:
            continue
        rows, mask = group.slots, masks[group.name]
        mask &= ((cue < 0) | (state.cue[cue] > 0)) | (state.hold[rows] > 0)[:, None]
        mask[:, table.rest] |= state.alive[rows] & ~mask.any(axis=1)


# ---- compiled loops ----------------------------------------------------------------------------


@compiled
def apply_choices(
    first: int, chosen: Ints, mask: Bools, toward: Ints, dt: float, effects: Effects, bodies: Bodies, deeds: Deeds
) -> int:
    """Write what n slots of one species, from `first` on, do; return the first slot that has no such action, or -1.

    `chosen` (N,) are actions, of which the `mask` (n, A) lets some be; `toward` (N, K) are the patches that a go_to
    leads to. Written, by slot: hold, action, heading and bound_for of the bodies, and the deeds, but for the ways to
    patches. Those who are busy are added up.
    """
    alive, heading = bodies.alive, bodies.heading
    for row in range(len(mask)):
        i = first + row
        a = chosen[i] if alive[i] else 0
        if a < 0 or a >= mask.shape[1]:
            return i
        open_ = mask[row, a]
        deeds.closed[i] = alive[i] and not open_
        if not open_:  # rest where it is open, else what the body is held to: a sleep, a committed go_to
            a = effects.rest if mask[row, effects.rest] or not alive[i] else np.argmax(mask[row])
        bodies.action[i] = a
        for v in range(deeds.control.shape[1]):  # as an assignment of rows it would take four times as long to compile
            deeds.control[i, v] = effects.control[a, v]
            deeds.intake[i, v] = effects.intake[a, v]
        deeds.consumes[i] = effects.consumes[a]
        bodies.bound_for[i] = -1
        if not alive[i]:
            deeds.speed[i] = 0.0
            deeds.direction[i] = heading[i] if np.isnan(effects.direction[a]) else effects.direction[a]
            continue
        if effects.duration[a] > 0 and not effects.bites[a] and bodies.hold[i] <= 0:
            bodies.hold[i] = effects.duration[a]
        deeds.speed[i] = effects.speed[a]
        deeds.busy[1] += effects.consumes[a] >= 0
        if effects.goes_to[a] >= 0:
            bodies.bound_for[i] = toward[i, effects.goes_to[a]]
            deeds.busy[0] += 1
        else:
            heading[i] = (heading[i] + effects.turn[a] * dt + math.pi) % (2 * math.pi) - math.pi
        deeds.direction[i] = heading[i] if np.isnan(effects.direction[a]) else effects.direction[a]
    return -1


@compiled
def lead(
    bodies: Bodies, patches: Floats, period: Floats, dt: float, speed: Floats, direction: Floats, way: Floats
) -> None:
    """Turn bodies that go to one of the `patches` (R, 2) towards it; none moves farther than to it in dt.

    Written: their heading, `speed`, `direction` (N,) and `way` (N, 2). The plane begins again after its `period` (2,).
    """
    position = bodies.position
    for i in range(len(position)):
        r = bodies.bound_for[i]
        if r >= 0:
            way[i, 0] = way_along(position[i, 0], patches[r, 0], period[0])
            way[i, 1] = way_along(position[i, 1], patches[r, 1], period[1])
            speed[i] = min(speed[i], math.sqrt(way[i, 0] * way[i, 0] + way[i, 1] * way[i, 1]) / dt)
            bodies.heading[i] = direction[i] = angle_of(way[i, 1], way[i, 0])


@compiled
def open_masks(
    first: int, bodies: Bodies, internal: Floats, here: Ints, toward: Ints, targets: Ints, conditions: Conditions
) -> Bools:
    """Return A_zeta, which actions are open, (n, A) for the n slots of one species, from `first` on.

    `targets` is (n, A), the rest is by slot; see `open_actions`.
    """
    opens_from, closes_at, consumes, goes_to, meets, rest, committed = conditions
    action = bodies.action
    n, count, needs = len(targets), len(consumes), internal.shape[1]
    mask = np.zeros((n, count), np.bool_)
    for row in range(n):
        i = first + row
        if not bodies.alive[i]:
            continue
        if bodies.hold[i] > 0:
            mask[row, action[i]] = True
            continue
        some = False
        for a in range(count):
            fits = True
            for v in range(needs):
                x = internal[i, v]
                if not (opens_from[a, v] <= x < closes_at[a, v]):
                    fits = False
                    break
            if fits and consumes[a] >= 0:
                fits = here[i, consumes[a]] >= 0
            if fits and goes_to[a] >= 0:
                fits = toward[i, goes_to[a]] >= 0
            if fits and meets[a] >= 0:
                fits = targets[row, a] >= 0
            mask[row, a] = fits
            some |= fits
        if committed and bodies.bound_for[i] >= 0 and goes_to[action[i]] >= 0 and mask[row, action[i]]:
            mask[row, :] = False
            mask[row, action[i]] = True
        if not some:
            mask[row, rest] = True  # a body whose thresholds close everything can still do nothing
    return mask
