"""Interactions of bodies: bites, gifts, crowding, and the scenario's own rule."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from ecology import elementary, powers, setpoints
from ecology.compiler_cache import compiled, use_cache
from ecology.errors import EcologyError, nearest
from ecology.ground import Ground, ground_of, walls
from ecology.ground.walls import Walls, is_clear
from ecology.neighbours import Pairs
from ecology.spec import Arena
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.actions import ActionTable
    from ecology.model import Model
    from ecology.scenario import Scenario
    from ecology.senses import Perception

use_cache(__file__, walls.__file__)


@dataclass
class Outcome:
    """What a rule returns: the effects of one tick, for N slots and V needs."""

    received: Floats  # (N, V) units added to needs
    given: Floats  # (N, V) units taken from needs
    killed: Bools  # (N,) whether the agent dies
    position: Floats | None = None  # (N, 2) where bodies are put; None: they stay where they are
    stock: Floats | None = None  # (R,) units added to stocks that are there, taken where negative
    patches: dict[str, Floats] = field(default_factory=dict)  # resource -> (k, 3) x, y, stock of patches that appear
    births: dict[str, Floats] = field(default_factory=dict)  # species -> (k, 2) where newborns start
    parents: dict[str, Ints] = field(default_factory=dict)  # species -> (k,) slot of each newborn's parent; -1: none
    pace: Floats | None = None  # (N,) share of its speed at which a body moves in the next tick, from 0 to 1; None: all
    sight: Floats | None = None  # (N,) share of its view range that it sees until the next tick, from 0 to 1; None: all
    doors: dict[str, bool] = field(default_factory=dict)  # name -> whether it is to be open after this tick
    memory: dict[str, Any] = field(default_factory=dict)  # name -> value that the rule remembers from now on
    set_point: Floats | None = None  # (N, V) x* from now on, of needs with a set_range; None: they stay

    def __setattr__(self, name: str, value: object) -> None:
        if name not in OUTCOME:
            raise EcologyError(
                f"the outcome of a rule has no field {name!r}. {nearest(name, OUTCOME)} A rule changes nothing else."
            )
        object.__setattr__(self, name, value)


OUTCOME = tuple(f.name for f in fields(Outcome))


@dataclass(frozen=True)
class World:
    """What a scenario's rule gets: the read-only state in the middle of a tick, and the names of its rows and columns.

    Bodies have moved; needs are as they were at the start of the tick.
    """

    state: State  # read-only
    dt: float
    slots: Mapping[str, slice]  # by species
    needs: Mapping[str, tuple[str, ...]]  # by species, in the order of the columns
    actions: Mapping[str, tuple[str, ...]]  # by species, in the order of the indices
    resources: Mapping[str, slice] = field(default_factory=dict)  # rows of its patches, by resource
    arena: Arena | None = None
    ground: Ground | None = None  # of the arena, once compiled
    memory: Mapping[str, np.ndarray] = field(default_factory=dict)  # the rule's own state: `Scenario.memory`, as it is
    doors: Mapping[str, bool] = field(default_factory=dict)  # by name, whether it is open

    def resource(self, name: str) -> slice:
        """Return the rows of the patches of a resource in `state.stock`, `state.resource_position` and the like."""
        return self.resources[self._check_name(self.resources, name, "resource")]

    def inside(self, position: Floats) -> Bools:
        """Return which of `position` (n, 2) lie in the arena, (n,); all do where it has no walls, as a torus."""
        if self.arena is None:
            return np.ones(len(position), bool)
        ground = ground_of(self.arena) if self.ground is None else self.ground
        return ground.inside(position)

    def column(self, species: str, need: str) -> int:
        """Return the column of a need of `species` in `state.internal`."""
        return self._index(self.needs, species, need, "need")

    def does(self, species: str, action: str) -> Bools:
        """Return which slots of `species` are alive and execute `action` in this tick, (n,)."""
        rows = self.slots[self._check_name(self.slots, species, "species")]
        return (self.state.action[rows] == self._index(self.actions, species, action, "action")) & self.state.alive[
            rows
        ]

    def no_effect(self) -> Outcome:
        """Return an outcome of zeros, to be written into."""
        shape = self.state.internal.shape
        return Outcome(np.zeros(shape), np.zeros(shape), np.zeros(shape[0], bool))

    def _index(self, table: Mapping[str, tuple[str, ...]], species: str, name: str, what: str) -> int:
        names = table[self._check_name(table, species, "species")]
        return names.index(self._check_name(names, name, what))

    @staticmethod
    def _check_name(names: Collection[str], name: str, what: str) -> str:
        if name not in names:
            raise EcologyError(f"the rule asks for the {what} {name!r}. {nearest(name, names)}")
        return name


Rule = Callable[[World, np.random.Generator], Outcome]


def validate_outcome(outcome: Outcome, scenario: Scenario, world: World) -> Outcome:
    """Return the outcome of a scenario's own rule in `world`, or raise EcologyError where it is none."""
    owner, state = f"the rule of scenario {scenario.name!r}", world.state
    if not isinstance(outcome, Outcome):
        raise EcologyError(f"{owner} must return an Outcome (start from world.no_effect()), got {outcome!r}.")
    for word, like in (
        ("received", state.internal), ("given", state.internal), ("position", state.position),
        ("set_point", state.internal),
    ):  # fmt: skip
        value = getattr(outcome, word)
        if value is None and word in ("position", "set_point"):
            continue
        numbers = isinstance(value, np.ndarray) and value.dtype.kind in "biuf"
        if not numbers or value.shape != like.shape or not np.isfinite(value).all():
            raise EcologyError(
                f"{owner}: {word} must be an array of finite numbers of shape {like.shape}, got {value!r}."
            )
    killed = outcome.killed
    if not isinstance(killed, np.ndarray) or killed.shape != state.alive.shape or killed.dtype != bool:
        raise EcologyError(
            f"{owner}: killed must be an array of true or false of shape {state.alive.shape}, got {killed!r}."
        )
    for species, needs in world.needs.items():
        rows = world.slots[species]
        for word in ("received", "given"):
            beyond = getattr(outcome, word)[rows, len(needs) :]
            if beyond.size and (beyond[state.alive[rows]] != 0).any():
                raise EcologyError(
                    f"{owner}: {word} has a column other than 0 for {species!r} that is none of its needs "
                    f"({', '.join(needs)}); find the column of a need by world.column({species!r}, need)."
                )
    if outcome.set_point is not None:
        setpoints.check_set_points(outcome.set_point, scenario, world.slots, owner)
    if outcome.position is not None:
        outside = state.alive & ~world.inside(outcome.position)
        if outside.any():
            slot = int(np.argmax(outside))
            species = next(name for name, rows in world.slots.items() if rows.start <= slot < rows.stop)
            raise EcologyError(
                f"{owner}: position puts {species}_{state.serial[slot]} at {outcome.position[slot].tolist()}, outside "
                "the arena; world.inside(position) says which places are within."
            )
    powers.check_outcome(outcome, scenario, world, owner)
    return outcome


# ---- what a tick changes -------------------------------------------------------------------


@dataclass
class Met:
    """The effects of meetings in one tick."""

    received: Floats  # (N, V)
    given: Floats  # (N, V)
    killed: Bools  # (N,) bitten to death
    ruled: Bools  # (N,) killed by the scenario's rule
    biter: Ints  # (N,) slot of the agent that bit each, -1 without
    wound: Floats | None = None  # (N, V) what bites took; None: nothing
    outcome: Outcome | None = None  # of the scenario's rule


def meet(model: Model, state: State, seen: Perception, control: Floats, rng: Mapping[str, np.random.Generator]) -> Met:
    """Let bodies bite, give and crowd, and apply the scenario's rule; crowding is added to the control u (N, V)."""
    n = model.size
    met = Met(
        received=np.zeros(control.shape),
        given=np.zeros(control.shape),
        killed=np.zeros(n, bool),
        ruled=np.zeros(n, bool),
        biter=model.nobody,
    )
    if not model.meets and model.scenario.rule is None:
        return met
    if model.meets:
        _bite_and_give(model, state, seen, met, rng["meeting"])
        _crowd(model, seen.pairs, control)
    if model.scenario.rule is not None:
        _apply_rule(model, state, met, rng["rule"])
    state.received, state.given = state.received + met.received, state.given + met.given
    return met


def _bite_and_give(model: Model, state: State, seen: Perception, met: Met, rng: np.random.Generator) -> None:
    """Write the effects of bites and gifts into `met` and the state."""
    state.bit, state.gave = model.nobody.copy(), model.nobody.copy()
    attackers, victims, chance = [], [], []
    for group, table in model.acting:
        rows = group.slots
        action = state.action[rows]
        target = seen.targets[group.name][np.arange(group.size), action]
        meets = (target >= 0) & (table.meets[action] >= 0) & state.alive[rows]
        bites = np.flatnonzero(meets & table.bites[action] & (state.hold[rows] <= 0))
        attackers.append(rows.start + bites)
        victims.append(target[bites])
        chance.append(table.chance[action[bites]])
        gives = np.flatnonzero(meets & ~table.bites[action])
        if gives.size:
            act, giver, to = action[gives], rows.start + gives, target[gives]
            gift = gifts(table.gives[act] * model.dt, state.internal[giver] - model.body.low[giver])
            met.given[giver] += gift
            np.add.at(met.received, to, np.einsum("kv,kvw->kw", gift, table.arrives[act]))
            state.gave[giver] = to
    attacker, victim = np.concatenate(attackers), np.concatenate(victims)
    if attacker.size:
        won = succeed(attacker, victim, np.concatenate(chance), model.dt, model.size, rng)
        if won.any():
            _wound(model, state, attacker[won], victim[won], met)


def _wound(model: Model, state: State, attacker: Ints, victim: Ints, met: Met) -> None:
    """Write the effects of successful bites (k,) into `met` and the state."""
    biter, wound = model.nobody.copy(), np.zeros(met.given.shape)
    biter[victim] = attacker
    state.bit[attacker] = victim
    for group, table in model.acting:
        mine = (attacker >= group.slots.start) & (attacker < group.slots.stop)
        own, bitten = attacker[mine], victim[mine]
        act = state.action[own]
        state.hold[own] = table.duration[act]
        met.received[own] += table.gain[act]
        kills = np.isnan(table.damage[act]).any(axis=1)
        met.killed[bitten[kills]] = True
        wound[bitten[~kills]] = table.damage[act[~kills]]
    met.given += wound
    met.biter, met.wound = biter, wound


def _crowd(model: Model, pairs: Pairs | None, control: Floats) -> None:
    """Add to u (N, V) what the others near a body do to it."""
    for group, species in model.species:
        crowding = species.crowding
        if crowding is None or pairs is None:
            continue
        counts = pairs.distance <= crowding.within
        if crowding.species:
            meant = [s.name in crowding.species for s in model.scenario.species]
            counts &= np.array(meant)[model.species_of[pairs.other]]
        close = pairs.who[counts] - group.slots.start
        others = np.bincount(close[(close >= 0) & (close < group.size)], minlength=group.size)
        for name, rate in crowding.control.items():
            control[group.slots, model.needs[species.name].index(name)] += rate * others


def _apply_rule(model: Model, state: State, met: Met, rng: np.random.Generator) -> None:
    """Write what the scenario's own rule comes to into `met` and the state."""
    rule, groups = model.scenario.rule, model.groups.values()
    assert rule is not None
    world = World(
        state.readonly(), model.dt, {g.name: g.slots for g in groups}, model.needs,
        {g.name: g.actions for g in groups}, model.patches, model.scenario.arena, model.ground,
        powers.recall(model.memory, state.memory),
        {} if state.doors is None else dict(
            zip([d.name for d in model.scenario.arena.doors], state.doors.tolist(), strict=True)
        ),
    )  # fmt: skip
    outcome = validate_outcome(rule(world, rng), model.scenario, world)
    living = state.alive[:, None]
    met.outcome = outcome
    state.pace, state.sight = outcome.pace, outcome.sight
    if outcome.memory and state.memory is not None:
        state.memory = powers.remember(model.memory, state.memory, outcome.memory)
    met.received += np.where(living, outcome.received, 0.0)
    met.given += np.where(living, outcome.given, 0.0)
    met.ruled = outcome.killed & state.alive
    if outcome.set_point is not None and state.set_point is not None:
        state.set_point = np.where(living, outcome.set_point, state.set_point)
    if outcome.position is not None:
        position = model.plane.home(np.asarray(outcome.position, float))
        state.position = np.where(living, position, state.position)


def aim(model: Model, state: State, pairs: Pairs | None) -> dict[str, Ints]:
    """Return by species whom bites and gifts would meet, slots (n, A): the nearest in reach, no wall between; -1."""
    return {
        group.name: _aim_of(model, state, pairs, group.slots, table) if table.meeting else model.no_targets[group.name]
        for group, table in model.acting
    }


def _aim_of(model: Model, state: State, pairs: Pairs | None, rows: slice, table: ActionTable) -> Ints:
    targets = np.full((rows.stop - rows.start, len(table.names)), -1)
    for a in table.meeting:
        assert pairs is not None
        targets[:, a] = in_reach(
            pairs, rows.start, len(targets), table.reach[a], table.meets[a], model.species_of, state.position,
            model.vision.walls,
        )  # fmt: skip
    return targets


def succeed(attackers: Ints, victims: Ints, chance: Floats, dt: float, slots: int, rng: np.random.Generator) -> Bools:
    """Return which of the attackers (k,) succeed on their victims (k,), at most one on each victim.

    `chance` (k,) is per unit of time. Numbers are drawn for all `slots`, so that they do not depend on who bites.
    """
    drawn, order = rng.random((2, slots))
    success = drawn[attackers] < 1.0 - elementary.power(1.0 - chance, dt)
    winner = np.full(slots, np.inf)
    np.minimum.at(winner, victims[success], order[attackers[success]])
    return success & (order[attackers] == winner[victims])


def gifts(wanted: Floats, held: Floats) -> Floats:
    """Return what is given (k, V) of what is `wanted` (k, V): at most what is `held` (k, V) above the bound."""
    return np.minimum(wanted, np.maximum(held, 0.0))


@compiled
def in_reach(
    pairs: Pairs,
    first: int,
    n: int,
    reach: float,
    wanted: int,
    species_of: Ints,
    position: Floats,
    walls: Walls,
) -> Ints:
    """Return whom of the species `wanted` is nearest in `reach`, no wall between, for n slots from `first` on: (n,)."""
    found = np.full(n, -1)
    for row in range(n):
        i = first + row
        for p in range(pairs.starts[i], pairs.starts[i + 1]):
            j = pairs.other[p]
            if pairs.distance[p] > reach:
                break
            if species_of[j] == wanted and is_clear(walls, position[i], position[j]):
                found[row] = j
                break
    return found
