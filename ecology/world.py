"""ArrayWorld: a world in arrays, and the order of one tick."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import NoneType
from typing import Any

import numpy as np

from ecology import (
    actions,
    appearing,
    changes,
    doors,
    empathy,
    fields,
    hauling,
    heredity,
    life,
    life_stages,
    meetings,
    migration,
    neighbours,
    physiology,
    powers,
    resources,
    senses,
    setpoints,
    sight,
)
from ecology.errors import EcologyError, nearest
from ecology.ground import wrap
from ecology.model import Model, compile_model
from ecology.paths import with_change
from ecology.physics import Physics, velocities
from ecology.senses import Perception, faults
from ecology.spec import require
from ecology.state import Bools, Floats, Ints, State
from ecology.verbs import MissingError

# one random stream each; new ones come last
CONCERNS = ("birth", "noise", "availability", "motion", "meeting", "offspring", "hazard", "rule", "lesion")


@dataclass(frozen=True)
class Tick:
    """What one tick brought, in arrays; per species under its name."""

    observations: Mapping[str, np.ndarray]  # float32 (n, D), zeta; of an agent that died, its needs at death
    masks: Mapping[str, Bools]  # (n, A), A_zeta
    reward: Floats  # (N,) drive before minus drive after
    drive: Floats  # (N,)
    alive: Bools  # (N,) at the end of the tick
    died: Bools  # (N,) in this tick
    born: Bools  # (N,) in this tick
    parent: Ints  # (N,) slot of the parent, -1 without
    killer: Ints  # (N,) slot of the agent that bit it to death in this tick, -1 without
    closed: Bools  # (N,) whose action was closed and was replaced
    action: Ints  # (N,) executed in the tick


class ArrayWorld:
    """A world of N slots: its `model`, which never changes, and its `state`, a new one after every tick.

    `copy.deepcopy` and `pickle` take a world at any tick, and the copy continues bit for bit.
    """

    def __init__(self, model: Model) -> None:
        """Build a world of `model`; it starts with `reset`."""
        self.model = self._first = model
        self.changes: dict[str, float] = {}  # numbers of the scenario that were changed since, by path
        self.resting: Bools | None = None  # (N,) slots that nobody takes, though free
        self.seed: int | None = None  # of the last reset
        self.turnover = 0  # changes of who lives, so far
        self.reweighed: dict[str, float] = {}  # species -> factor of what it feels of others, 1 where not named
        self._state: State | None = None

    @property
    def state(self) -> State:
        """Return what changes; arrays that a state holds are never written once the tick is over."""
        if self._state is None:
            raise EcologyError("the world has not started: call reset before step.")
        return self._state

    @property
    def started(self) -> bool:
        """Return whether the world has been reset."""
        return self._state is not None

    # ---- the tick ------------------------------------------------------------------------

    def reset(self, seed: int) -> Tick:
        """Start from `seed` and return the first observations."""
        if self.changes:
            self.model, self.changes = self._first, {}
        self.model = model = doors.fit(self.model)
        self.seed, self.reweighed = seed, {}
        concerns = (*CONCERNS, heredity.STREAM) if model.heredity is not None else CONCERNS
        concerns = (*concerns, "senses") if any(spec.faults for spec in model.observation_specs) else concerns
        concerns = (*concerns, "yield") if model.yields else concerns
        streams = np.random.SeedSequence(seed).spawn(len(concerns))
        self._rng = {name: np.random.default_rng(stream) for name, stream in zip(concerns, streams, strict=True)}
        self._state = state = _first_state(model, self._rng)
        self.model = model = doors.fit(model, state.doors)
        self.turnover += 1
        self.lesion_order = self._rng["lesion"].permutation(model.size)  # of the shuffled lesion
        self._touch(state)
        self.perception = self._perceive(state, None)
        self._sense(state)
        return self._observe(np.zeros(model.size))

    def step(self, chosen: Ints, steering: Floats | None = None) -> Tick:
        """Advance one tick: this is the order of its steps, top to bottom.

        `chosen` (N,) holds an index into each slot's own species' actions; entries of dead slots are ignored.
        `steering` (N, 2) is the speed and the turn rate of those that move, NaN: as their action has them.
        """
        before = self.state
        model, seen, rng = self.model, self.perception, self._rng
        state = before.next()
        # actions: what each body does
        deeds = actions.decide(model, state, seen, np.asarray(chosen), steering)
        # physics: bodies move and touch
        way = velocities(deeds.direction, deeds.speed)
        state.position, put_back = self._physics.move(state.position, way, model.dt, state.alive)
        state.returned += put_back
        # resources: bodies that eat from one stock share it
        ingested, eaten = resources.eat(model, state, seen, deeds, rng)
        hauling.haul(model, state, seen, eaten)
        # meetings: bites, gifts, crowding, the scenario's own rule
        met = meetings.meet(model, state, seen, deeds.control, rng)
        fields.expose(model, state, deeds.control)
        # physiology: bodies drift, act and are disturbed
        internal = physiology.advance(
            physiology.body_now(model, state),
            state.internal,
            deeds.control,
            state.time,
            state.age,
            model.dt,
            rng["noise"],
        )
        internal += met.received - met.given
        # deaths and births; a slot rests for a tick before a newborn takes it
        died, killer = life.die(model, state, internal, met, rng["hazard"])
        free = ~state.alive
        physiology.commit(model, state, internal, ingested + met.received - met.given, died)
        born, parent = life.reproduce(model, state, free, met, rng["offspring"])
        heredity.inherit(model, state, born, parent, rng)
        # resources: stocks regrow, come and go, move
        resources.renew(model, state, eaten, rng)
        appearing.renew(model, state, died, met, rng)
        hauling.fall(model, state, died)
        fields.advance(model, state)
        # time
        state.tick += 1
        state.time = state.tick * model.dt
        if model.moving is not None:
            setpoints.move(model, state, heredity.base(model, state), ingested + met.received, before.time)
        if model.stages is not None and model.stages.grow:
            self._physics.resize(life_stages.radii(model, state), state.position, state.alive)
        if doors.turn(model, state, met.outcome):
            self._fit(state)
        # senses and observation
        self.perception = self._perceive(state, seen.pairs)
        self._sense(state)
        self._state = state
        reward = before.drive - state.drive
        if model.grows:
            reward = np.where(born, 0.0, reward)
        tick = self._observe(reward, died, deeds.closed, born, parent, killer)
        dead = model.mortal and bool(died.any())
        if dead or (model.grows and born.any()):
            self.turnover += 1
        if dead:
            senses.show_fatal_needs(model, state, internal, died, tick.observations)
        return tick

    def _perceive(self, state: State, last: neighbours.Pairs | None) -> Perception:
        """Return what bodies see and can do, and update what they feel; there are about as many pairs as the `last`."""
        model = self.model
        vision = sight.vision_now(model, state)
        state.own("bound_for")
        bodies = state.bodies()
        reached, patches = sight.find_patches(model, state, vision, bodies)
        state.inside, state.seen, here, toward = reached[0], reached[1], patches[0], patches[1]
        if model.appearing is not None and model.appearing.comes:
            is_present = ~appearing.absent(model, state.stock)
            state.inside, state.seen = state.inside & is_present, state.seen & is_present
        pairs = neighbours.find(model.plane, state.position, state.alive, model.near, last) if model.near else None
        targets = meetings.aim(model, state, pairs)
        empathy.update_drives(model, state, vision, pairs, self.lesion_order, self.reweighed)
        masks = actions.open_actions(model, state, bodies, here, toward, targets)
        hauling.close_actions(model, state, here, masks)
        return Perception(here, toward, patches[2], pairs, targets, masks, vision)

    def _sense(self, state: State) -> None:
        """Draw what faulty senses read in this tick, and let memories fade and take up what is sensed."""
        if state.failed is not None:
            faults.draw_faults(self.model, state, self._rng["senses"])
        senses.remember(self.model, state, self.perception)

    def _observe(
        self,
        reward: Floats,
        died: Bools | None = None,
        closed: Bools | None = None,
        born: Bools | None = None,
        parent: Ints | None = None,
        killer: Ints | None = None,
    ) -> Tick:
        """Return what the agents perceive."""
        model, state, seen = self.model, self.state, self.perception
        tick = object.__new__(Tick)  # a frozen dataclass sets its fields one by one, which takes microseconds
        tick.__dict__.update(
            observations={
                name: senses.observe(model, spec, state, seen)
                for name, spec in zip(model.groups, model.observation_specs, strict=True)
            },
            masks=seen.masks,
            reward=reward,
            drive=state.drive,
            alive=state.alive,
            died=np.zeros(model.size, bool) if died is None else died,
            born=np.zeros(model.size, bool) if born is None else born,
            parent=model.nobody.copy() if parent is None else parent,
            killer=model.nobody.copy() if killer is None or killer is model.nobody else killer,
            closed=np.zeros(model.size, bool) if closed is None else closed,
            action=state.action.copy(),
        )
        return tick

    def _fit(self, state: State) -> None:
        """Take the walls that go with the doors of `state`, and a solver that knows them."""
        self.model = doors.fit(self.model, state.doors)
        self._touch(state)

    def _touch(self, state: State) -> None:
        """Take a new solver for the bodies where they are."""
        model = self.model
        radius, least = life_stages.radii(model, state), None
        if radius is not model.radius:
            assert model.stages is not None
            least = float((model.radius[:, None] * model.stages.size).min())
        self._physics = Physics(model.ground, radius, model.solid, state.position, state.alive, least)

    # ---- what observers may ask ------------------------------------------------------------

    def find_visible(self, slot: int) -> Ints:
        """Return the slots of the others that the agent in `slot` sees now, (k,); none if its species does not look."""
        model, state, pairs = self.model, self.state, self.perception.pairs
        if pairs is None or not model.looks[slot]:
            return np.empty(0, np.int64)
        looks = np.arange(model.size) == slot
        return pairs.other[self.perception.vision.sees_others(pairs, state.position, state.heading, looks)]

    def coupling(self, species: str, need: str | None = None) -> tuple[Floats, Ints] | None:
        """Return the weights of empathy, see `Ecology.coupling`."""
        model = self.model
        model.group(species)
        needs = model.needs[species]
        if need is not None and need not in needs:
            raise EcologyError(f"species {species!r} has no need {need!r}. {nearest(str(need), needs)}")
        coupling = model.coupling(species)
        if coupling is None:
            return None
        column = None if need is None else needs.index(need)
        state = self.state
        seen = self.perception
        weight = empathy.weigh(model, state, seen.vision, coupling, seen.pairs, self.lesion_order, self.reweighed)
        return empathy.weights(coupling, weight, state.alive, column)

    # ---- changing a world between ticks ------------------------------------------------------

    def set_state(self, **values: Any) -> Tick:
        """Overwrite fields of the state between ticks, see `Ecology.set_state`."""
        model, before = self.model, self.state
        changed = changes.read(values, before)
        if "alive" in changed:
            changes.rename(changed, before, model)
        changes.check_changes(changed, before, model)
        state = before.next()
        for name, value in changed.items():
            setattr(state, name, value)
        state.next_serial = max(state.next_serial, int(state.serial.max(initial=-1)) + 1)
        state.position = model.plane.home(state.position)
        if state.load is not None and "alive" in values:  # the dead carry nothing
            state.load = np.where(state.alive[:, None], state.load, 0.0)
        if "doors" in values:
            self._fit(state)
        elif values.keys() & {"position", "alive"}:  # the solver remembers contacts of another place
            self._touch(state)
        return self._resume(state)

    def settle(self, species: str, place: tuple[float, float], heading: float) -> tuple[Tick, int]:
        """Add an agent between ticks, see `Ecology.settle`."""
        model, state = self.model, self.state.next()
        rows = model.group(species).slots
        empty = ~state.alive[rows] if self.resting is None else ~(state.alive | self.resting)[rows]
        free = rows.start + np.flatnonzero(empty)
        if not free.size:
            raise MissingError(
                f"all {model.groups[species].size} slots of {species!r} are taken; remove an agent, or raise the "
                "capacity of the species in the scenario."
            )
        require(
            bool(changes.inside(model.scenario, np.array([place], float))[0]),
            f"the place {place!r} lies outside the arena.",
        )
        new, serial, following = free[:1], state.serial[free[:1]].copy(), state.next_serial
        state.own("lost", "internal", "hold")
        life.start_lives(model, state, new, model.plane.home(np.array([place], float)), np.array([heading]))
        if model.heredity is not None:
            heredity.settle(model, state, new, heredity.arrive(model.heredity, self._rng[heredity.STREAM])[new])
        if not model.grows:
            state.serial[new], state.next_serial = serial, following
        self._touch(state)
        return self._resume(state), int(new[0])

    def take_out(self, slots: Ints) -> tuple[Tick, migration.Bodies]:
        """Let the agents in `slots` leave between ticks, see `Ecology.take_out`."""
        state = self.state.next()
        bodies = migration.take_out(state, slots)
        self._touch(state)
        return self._resume(state), bodies

    def bring_in(self, species: str, bodies: migration.Bodies, rng: np.random.Generator) -> tuple[Tick, Ints]:
        """Let agents of another world arrive between ticks, see `Ecology.bring_in`."""
        state = self.state.next()
        slots = migration.bring_in(self.model, state, species, bodies, rng)
        self._touch(state)
        return self._resume(state), slots

    def breed(self, species: str, parents: Ints, traits: Floats | None, rng: np.random.Generator) -> tuple[Tick, Ints]:
        """Let newborns of parents elsewhere start between ticks, see `Ecology.breed`."""
        state = self.state.next()
        slots = migration.breed(self.model, state, species, parents, traits, rng)
        self._touch(state)
        return self._resume(state), slots

    def reweigh(self, species: str, factor: float) -> Tick:
        """Multiply what `species` feels of others by `factor`, see `Ecology.reweigh`."""
        model = self.model
        coupling = model.coupling(species)
        if coupling is None:
            able = [s.name for s in model.scenario.species if s.empathy is not None]
            raise EcologyError(
                f"the species {species!r} has no empathy; "
                + (f"give one that has: {', '.join(able)}." if able else "no species of this scenario has.")
            )
        require(
            bool(np.isfinite(factor)) and (coupling.empathy.form == "sum" or factor in (0.0, 1.0)),
            f"what {species!r} feels, in the average form of empathy, can be switched off or on, not reweighed.",
        )
        self.reweighed = {**self.reweighed, species: float(factor)}
        return self._resume(self.state.next())

    def change(self, path: str, value: float) -> Tick:
        """Change a number of the scenario between ticks, see `Ecology.change`."""
        state = self.state.next()
        self.model = doors.fit(self._with_change(self.model, path, value), state.doors)
        self.changes = {**self.changes, path: float(value)}
        self._touch(state)
        return self._resume(state)

    @staticmethod
    def _with_change(model: Model, path: str, value: float) -> Model:
        """Return the model of the scenario with the number at `path` changed."""
        found = compile_model(with_change(model.scenario, path, value))
        differ = model.like(found)
        require(
            not differ,
            f"{path!r} cannot be changed between ticks, {differ} would be another; set it in the scenario, or change "
            "another number.",
        )
        return found

    def snapshot(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the complete state of the world, see `Ecology.snapshot`."""
        state = self.state
        arrays = {name: array.copy() for name, array in state.arrays().items()}
        plain = _plain(state)
        arrays |= self._physics.memory()
        streams = {name: rng.bit_generator.state for name, rng in self._rng.items()}
        more = {"reweighed": dict(self.reweighed)} if self.reweighed else {}
        more |= {"changes": dict(self.changes)} if self.changes else {}
        return arrays, {"seed": self.seed, "state": plain, "rng": streams, **more}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> Tick:
        """Become the world that `snapshot` returned, see `Ecology.restore`."""
        fresh = ArrayWorld(self._first)
        fresh.reset(values["seed"])
        for path, value in values.get("changes", {}).items():
            fresh.change(path, value)
        state = fresh.state.next()
        memory = fresh._physics.memory()  # of as many ticks as there were
        own = state.arrays() | {name: array[:0] for name, array in memory.items()}
        own |= {name: np.zeros(self.model.size) for name in powers.SHARES if name in arrays}
        known = {name: (array.shape, array.dtype) for name, array in own.items()}
        given = {
            name: ((0, *array.shape[1:]) if name in memory else array.shape, array.dtype)
            for name, array in arrays.items()
        }
        differ = sorted(name for name in known.keys() | given.keys() if known.get(name) != given.get(name))
        require(
            not differ and values["rng"].keys() == fresh._rng.keys(),
            f"the snapshot is of another world than {self.model.scenario.name!r}: {', '.join(differ) or 'rng'} "
            "differ in shape or type; restore it with the scenario and the settings that it was made with.",
        )
        for name in own.keys() - memory.keys():
            setattr(state, name, arrays[name].copy())
        require(
            values["state"].keys() == _plain(state).keys(),
            f"the snapshot's plain values are {sorted(values['state'])}; restore it with the version that wrote it.",
        )
        for name, value in values["state"].items():
            setattr(state, name, value)
        changes.check_snapshot(state, {name: arrays[name] for name in memory}, fresh.model)
        for name, stream in values["rng"].items():
            fresh._rng[name].bit_generator.state = stream
        if state.doors is not None:
            fresh._fit(state)
        elif fresh.model.stages is not None:
            fresh._touch(state)
        fresh._physics.remember(arrays)
        self.reweighed = dict(values.get("reweighed", {}))
        self.model, self.changes = fresh.model, fresh.changes
        self.seed, self._rng, self.lesion_order, self._physics = (
            fresh.seed,
            fresh._rng,
            fresh.lesion_order,
            fresh._physics,
        )
        if not len(arrays["told_position"]):  # the solver was built for the bodies where they are
            self._touch(state)
        return self._resume(state)

    def _resume(self, state: State) -> Tick:
        """Continue from `state`, which no tick has led to, and return what is perceived."""
        if self.model.resources.constant and np.isfinite(state.stock).any():
            self.model = self.model.with_finite_stocks()
        self.perception = self._perceive(state, None)
        self._state = state
        self.turnover += 1
        return self._observe(np.zeros(self.model.size))


def _plain(state: State) -> dict[str, Any]:
    """Return the fields of a state that are no arrays; what this world does not use is None and left out."""
    values = {f.name: getattr(state, f.name) for f in dataclasses.fields(state)}
    return {name: value for name, value in values.items() if not isinstance(value, (np.ndarray, NoneType))}


def _first_senses(model: Model) -> dict[str, Any]:
    """Return the arrays of memories and faults at the start, where any species has them."""
    found: dict[str, Any] = {}
    traces, faulty = (
        max(map(len, parts)) for parts in zip(*((s.traces, s.faults) for s in model.observation_specs), strict=True)
    )
    if traces:
        found["traces"] = np.zeros((model.size, traces))
    if faulty:
        found |= {"misread": np.zeros((model.size, faulty)), "failed": np.zeros((model.size, faulty), bool)}
    return found


def _first_state(model: Model, rng: Mapping[str, np.random.Generator]) -> State:
    """Return the state in which a world starts."""
    n, table = model.size, model.resources
    r = len(table.stock)
    alive, serial = np.zeros(n, bool), np.full(n, -1)
    position, heading = np.tile(model.ground.rings[0][0], (n, 1)), np.zeros(n)
    for (s, serials), group in zip(model.founders(), model.groups.values(), strict=True):
        rows = slice(group.slots.start, group.slots.start + s.count)
        alive[rows], serial[rows] = True, serials
        position[rows], heading[rows] = life.place(model.ground, s, s.count, rng["birth"])
    nothing = np.zeros_like(model.body.start)
    trait = None if model.heredity is None else heredity.arrive(model.heredity, rng[heredity.STREAM])
    state = State(
        tick=0,
        time=0.0,
        next_serial=int(serial.max(initial=-1)) + 1,
        alive=alive,
        serial=serial,
        parent=np.full(n, -1),
        cause=np.zeros(n, np.int64),
        fatal_need=np.full(n, -1),
        killer=np.full(n, -1),
        age=np.zeros(n),
        position=position,
        heading=wrap(heading),
        internal=np.where(alive[:, None], model.body.start, 0.0),
        drive=np.zeros(n),
        own_drive=np.zeros(n),
        felt=nothing.copy(),
        action=np.concatenate([np.full(group.size, table_.rest) for group, table_ in model.acting]),
        hold=np.zeros(n),
        bound_for=np.full(n, -1),
        bit=np.full(n, -1),
        gave=np.full(n, -1),
        inside=np.zeros((n, r), bool),
        seen=np.zeros((n, r), bool),
        resource_position=resources.first_places(table, rng["motion"]),
        stock=(table.stock if model.appearing is None else model.appearing.start).copy(),
        available=resources.appear(table, np.ones(r, bool), 1, rng["availability"]),
        grown=np.zeros(r),
        eaten=np.zeros(r),
        ingested=nothing.copy(),
        received=nothing.copy(),
        given=nothing.copy(),
        metabolised=nothing.copy(),
        lost=nothing.copy(),
        returned=0,
        closed=np.zeros(n, np.int64),
        **_first_senses(model),
        memory=powers.first_memory(model.scenario.memory),
        load=None if model.hauling is None else np.zeros_like(model.hauling.most),
        grid=fields.first_grid(model.fields),
        doors=doors.first_doors(model.scenario.arena),
        set_point=model.body.set_point.copy() if model.body.moves else None,
        trait=trait,
        partner=model.nobody.copy() if model.mates else None,
        second=model.nobody.copy() if model.mates else None,
        cue=np.array([cue.start for cue in model.scenario.cues], float) if model.scenario.cues else None,
    )
    if state.set_point is not None:
        state.set_point = setpoints.at_birth(model, heredity.base(model, state), 0.0)
    return state
