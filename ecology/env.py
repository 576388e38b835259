"""Ecology: the world as a PettingZoo parallel environment, and the order of one tick."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import gymnasium
import numpy as np
from pettingzoo import ParallelEnv

from ecology import physiology, resources, senses
from ecology.actions import action_mask, compile_actions
from ecology.errors import EcologyError, nearest
from ecology.life import place
from ecology.physics import Physics
from ecology.scenario import Scenario
from ecology.senses import Layout
from ecology.spec import require
from ecology.state import Bools, Floats, Ints, State

CONCERNS = ("birth", "noise", "availability", "motion")  # one random stream each; new ones come last


@dataclass(frozen=True)
class Group:
    """The slots of one species and what its agents know of themselves."""

    name: str
    index: int  # of the species in the scenario
    slots: slice
    layout: Layout  # of zeta
    actions: tuple[str, ...]
    kinds: tuple[str, ...]  # of the actions
    speeds: Floats  # (A,)
    turns: Floats  # (A,) radians per unit of time
    durations: Floats  # (A,) minimal durations, units of time
    dt: float

    @property
    def size(self) -> int:
        """Return the number of slots."""
        return self.slots.stop - self.slots.start


@dataclass(frozen=True)
class Tick:
    """What one tick brought, in arrays; per species under its name."""

    observations: Mapping[str, np.ndarray]  # float32 (n, D), zeta
    masks: Mapping[str, Bools]  # (n, A), A_zeta
    reward: Floats  # (N,) drive before minus drive after
    drive: Floats  # (N,)
    alive: Bools  # (N,) at the end of the tick
    died: Bools  # (N,) in this tick
    born: Bools  # (N,) in this tick
    parent: Ints  # (N,) slot of the parent, -1 without
    closed: Bools  # (N,) whose action was closed and was replaced
    action: Ints  # (N,) executed in the tick


class Ecology(ParallelEnv):
    """Many self-regulated agents in one continuous plane.

    `reset` and `step` are PettingZoo's, in dicts; `reset_arrays` and `step_arrays` are the same
    world without dicts, and give the same trajectory. A closed action is replaced by rest (or,
    where rest is closed too, by what is open: the sleep that immobilises, the go_to committed
    to), and `infos[agent]["closed"]` says so.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "ecology", "render_modes": ["rgb_array"], "is_parallelizable": True}

    def __init__(self, scenario: Scenario, *, horizon: int | None = None, render_mode: str | None = None) -> None:
        """Build the world of `scenario`; after `horizon` ticks every agent is truncated."""
        require(
            isinstance(scenario, Scenario),
            f"a world is built from a Scenario, got {scenario!r}; `scenarios.load(name)` returns one.",
        )
        require(
            render_mode is None or render_mode in self.metadata["render_modes"],
            f"render_mode must be one of {self.metadata['render_modes']} or None, got {render_mode!r}.",
        )
        require(
            horizon is None or (isinstance(horizon, (int, np.integer)) and horizon > 0),
            f"horizon must be a positive whole number of ticks, got {horizon!r}.",
        )
        self.scenario = scenario
        self.horizon = horizon
        self.render_mode = render_mode
        self.dt = float(scenario.dt)
        species = scenario.species
        width = max(len(s.needs) for s in species)
        self.size = sum(s.count for s in species)
        self._body = physiology.compile_bodies(species, width)
        self._eyes = senses.compile_eyes(species, scenario.arena, scenario.resources)
        self._tables = [compile_actions(s, scenario.resources, width) for s in species]
        self._resources = resources.compile_resources(scenario.resources)
        self._radius = np.repeat([float(s.radius) for s in species], [s.count for s in species])
        self.groups: dict[str, Group] = {}
        start = 0
        for i, s in enumerate(species):
            table = self._tables[i]
            slots = slice(start, start + s.count)
            start += s.count
            self.groups[s.name] = Group(
                name=s.name,
                index=i,
                slots=slots,
                layout=senses.layout(s, scenario.arena),
                actions=table.names,
                kinds=table.kinds,
                speeds=table.speed,
                turns=table.turn,
                durations=table.duration,
                dt=self.dt,
            )
        self._group_of = {slot: g for g in self.groups.values() for slot in range(g.slots.start, g.slots.stop)}
        self.possible_agents = [f"{self._group_of[slot].name}_{slot}" for slot in range(self.size)]
        self._slot_of = {name: slot for slot, name in enumerate(self.possible_agents)}
        self.agents: list[str] = []
        self._state: State | None = None
        self._seed = 0

    # ---- the world in arrays -------------------------------------------------------------

    @property
    def state_view(self) -> State:
        """Return a read-only view of everything that changes."""
        return self._now().readonly()

    def reset_arrays(self, seed: int | None = None) -> Tick:
        """Start the world anew from `seed` and return its first observations."""
        if seed is not None:
            require(
                isinstance(seed, (int, np.integer)) and seed >= 0,
                f"seed must be a whole number of at least 0, got {seed!r}.",
            )
            self._seed = int(seed)
        streams = np.random.SeedSequence(self._seed).spawn(len(CONCERNS))
        self._rng = {name: np.random.default_rng(stream) for name, stream in zip(CONCERNS, streams, strict=True)}
        n, table = self.size, self._resources
        r = len(table.stock)
        places = [place(self.scenario.arena, s, s.count, self._rng["birth"]) for s in self.scenario.species]
        position = np.concatenate([p for p, _ in places])
        heading = senses.wrap(np.concatenate([h for _, h in places]))
        self._state = state = State(
            tick=0,
            time=0.0,
            next_serial=n,
            alive=np.ones(n, bool),
            serial=np.arange(n),
            age=np.zeros(n),
            position=position,
            heading=heading,
            internal=self._body.start.copy(),
            drive=np.zeros(n),
            action=np.zeros(n, np.int64),
            hold=np.zeros(n),
            bound_for=np.full(n, -1),
            inside=np.zeros((n, r), bool),
            seen=np.zeros((n, r), bool),
            resource_position=resources.first_places(table, self.scenario.arena, self._rng["motion"]),
            stock=table.stock.copy(),
            available=resources.appear(table, np.ones(r, bool), 1, self._rng["availability"]),
            grown=np.zeros(r),
            eaten=np.zeros(r),
            ingested=np.zeros_like(self._body.start),
            metabolised=np.zeros_like(self._body.start),
            lost=np.zeros_like(self._body.start),
            returned=0,
            closed=np.zeros(n, np.int64),
        )
        for group, acts in zip(self.groups.values(), self._tables, strict=True):
            state.action[group.slots] = acts.rest
        self._physics = Physics(self.scenario.arena, self._radius, state.position, state.alive)
        self._feel()
        return self._look(np.zeros(n), np.zeros(n, bool), np.zeros(n, bool))

    def step_arrays(self, actions: Ints) -> Tick:
        """Advance one tick: this is the order of things, top to bottom.

        `actions` (N,) holds an index into each slot's own species' actions; entries of dead
        slots are ignored.
        """
        state, body = self._now(), self._body
        # actions: what each body does, a closed action being replaced
        control, speed, direction, closed = self._decide(np.asarray(actions))
        # physics: bodies move and touch
        way = np.stack([np.cos(direction), np.sin(direction)], axis=1) * speed[:, None]
        state.position, returned = self._physics.move(state.position, way, self.dt)
        state.returned += returned
        # meetings: bodies that eat from one stock share it
        control, ingested, eaten = self._eat(control)
        # physiology: bodies drift, act and are disturbed
        before = state.drive
        internal = physiology.advance(body, state.internal, control, state.time, state.age, self.dt, self._rng["noise"])
        # births and deaths
        died = physiology.fatal(body, internal) & state.alive if body.deadly else np.zeros(self.size, bool)
        alive = state.alive & ~died
        kept = np.where(alive[:, None], physiology.clamp(body, internal), state.internal)
        metabolised, lost = physiology.spent(state.internal, ingested, internal, kept, state.alive)
        state.metabolised, state.lost = state.metabolised + metabolised, state.lost + lost
        state.internal, state.alive = kept, alive
        if died.any():
            slots = np.flatnonzero(died)
            self._physics.touch(slots, alive[slots])
        # resources: stocks regrow, come and go, move
        self._renew(eaten)
        # time
        state.tick += 1
        state.time = state.tick * self.dt
        state.age = state.age + self.dt * alive
        state.hold = np.maximum(state.hold - self.dt, 0.0) * (state.hold > 1.5 * self.dt)
        # senses and observation
        self._feel()
        return self._look(before - state.drive, died, closed)

    def _decide(self, actions: np.ndarray) -> tuple[Floats, Floats, Floats, Bools]:
        """Return u (N, V), speed (N,), direction (N,) and who asked for a closed action (N,)."""
        state = self._now()
        self._check_actions(actions)
        control = np.zeros_like(state.internal)
        speed, direction = np.zeros(self.size), state.heading.copy()
        closed = np.zeros(self.size, bool)
        for group, table in zip(self.groups.values(), self._tables, strict=True):
            rows = group.slots
            mask, wanted = self._masks[group.name], actions[rows]
            open_ = mask[np.arange(group.size), wanted]
            alive = state.alive[rows]
            closed[rows] = ~open_ & alive
            # rest where it is open, else what the body is held to: a sleep, a committed go_to
            fallback = np.where(mask[:, table.rest] | ~alive, table.rest, mask.argmax(axis=1))
            action = np.where(open_, wanted, fallback)
            begins = (table.duration[action] > 0) & (state.hold[rows] <= 0) & alive
            state.hold[rows] = np.where(begins, table.duration[action], state.hold[rows])
            state.action[rows] = action
            control[rows] = table.control[action]
            heading = senses.wrap(state.heading[rows] + table.turn[action] * self.dt)
            pace = table.speed[action]
            target = table.goes_to[action]
            going = np.flatnonzero(target >= 0)
            if going.size:
                gap = state.resource_position[target[going]] - state.position[rows][going]
                heading[going] = np.arctan2(gap[:, 1], gap[:, 0])
                pace = pace.copy()
                pace[going] = np.minimum(pace[going], np.hypot(gap[:, 0], gap[:, 1]) / self.dt)
            state.bound_for[rows] = target
            state.heading[rows] = np.where(alive, heading, state.heading[rows])
            absolute = table.direction[action]
            direction[rows] = np.where(np.isnan(absolute), state.heading[rows], absolute)
            speed[rows] = np.where(alive, pace, 0.0)
        state.closed += closed
        return control, speed, direction, closed

    def _eat(self, control: Floats) -> tuple[Floats, Floats, Floats]:
        """Return u (N, V) with every consumption at its share, and what is eaten (N, V) and from what (R,)."""
        state, body = self._now(), self._body
        ingested, eaten = np.zeros(control.shape), np.zeros(len(state.stock))
        source = np.empty(self.size, np.int64)
        for group, table in zip(self.groups.values(), self._tables, strict=True):
            source[group.slots] = table.consumes[state.action[group.slots]]
        eaters = np.flatnonzero(source >= 0)
        if eaters.size:
            rates = np.empty(control.shape)
            for group, table in zip(self.groups.values(), self._tables, strict=True):
                rates[group.slots] = table.intake[state.action[group.slots]]
            wanted = resources.asked(rates[eaters], body.proportional[eaters], state.internal[eaters], self.dt)
            there = np.where(state.available, state.stock, 0.0)
            part, eaten = resources.share(wanted.sum(axis=1), source[eaters], there)
            ingested[eaters] = wanted * part[:, None]
            control[eaters] *= part[:, None]
            state.ingested = state.ingested + ingested
            state.eaten = state.eaten + eaten
        return control, ingested, eaten

    def _renew(self, eaten: Floats) -> None:
        """Let the resources live through the tick in which `eaten` (R,) was eaten."""
        state, table = self._now(), self._resources
        if table.constant:
            state.grown = state.eaten
            return
        emptied = np.isfinite(state.stock) & (eaten > 0) & (state.stock - eaten <= 0)
        stock, grown = resources.regrow(table, state.stock, eaten, state.time, self.dt)
        until = (state.tick + 1) * self.dt
        places = resources.swing(table, state.resource_position, until)
        places = resources.drift(table, self._physics.vertices, places, self.dt, self._rng["motion"])
        places, gone = resources.relocate(table, self.scenario.arena, places, emptied, self._rng["motion"])
        grown[gone] += table.stock[gone] - stock[gone]
        stock[gone] = table.stock[gone]
        if gone.any():  # who was on the way there does not know where it went
            bound = np.flatnonzero(state.bound_for >= 0)
            state.bound_for[bound[gone[state.bound_for[bound]]]] = -1
        state.stock, state.grown, state.resource_position = stock, state.grown + grown, places
        if table.uncertain:
            units = resources.whole_units(until) - resources.whole_units(state.time)
            state.available = resources.appear(table, state.available, units, self._rng["availability"])

    def _check_actions(self, actions: np.ndarray) -> None:
        require(
            actions.shape == (self.size,) and np.issubdtype(actions.dtype, np.integer),
            f"actions must be {self.size} whole numbers, one a slot, got {actions.dtype} {actions.shape}.",
        )
        for group in self.groups.values():
            wanted = actions[group.slots]
            if group.size and (wanted.min() < 0 or wanted.max() >= len(group.actions)):
                bad = int(np.flatnonzero((wanted < 0) | (wanted >= len(group.actions)))[0])
                raise EcologyError(
                    f"the action of {self.name_of(group.slots.start + bad)} must be a whole number from 0 to "
                    f"{len(group.actions) - 1}, got {int(wanted[bad])}."
                )

    def _feel(self) -> None:
        """Renew what bodies feel and see: drive, reach, sight and the action masks."""
        state, body = self._now(), self._body
        delta = physiology.deviation(body, state.internal)
        state.drive = physiology.drive(delta, body.epsilon)
        state.inside, state.seen = senses.reach_and_sight(
            self._eyes, state.position, state.heading, state.alive, state.resource_position
        )
        arrived = (
            state.inside[np.arange(self.size), state.bound_for] & (state.bound_for >= 0)
            if len(state.stock)
            else np.zeros(self.size, bool)
        )
        state.bound_for[arrived] = -1
        sure = not (self._resources.finite or self._resources.uncertain)
        offered = None if sure else resources.offered(state.stock, state.available)
        self._masks = {
            group.name: action_mask(
                table,
                state.internal[group.slots],
                state.inside[group.slots],
                state.seen[group.slots],
                state.alive[group.slots],
                state.hold[group.slots],
                state.action[group.slots],
                state.bound_for[group.slots],
                offered,
            )
            for group, table in zip(self.groups.values(), self._tables, strict=True)
        }

    def _look(self, reward: Floats, died: Bools, closed: Bools) -> Tick:
        """Return what the agents perceive."""
        state = self._now()
        observations = {}
        for group, species in zip(self.groups.values(), self.scenario.species, strict=True):
            rows = group.slots
            observations[group.name] = senses.observe(
                species,
                self._body.set_point[rows],
                state.internal[rows],
                state.position[rows],
                state.heading[rows],
                state.time,
                self.scenario.day,
            )
        return Tick(
            observations=observations,
            masks=self._masks,
            reward=reward,
            drive=state.drive,
            alive=state.alive,
            died=died,
            born=np.zeros(self.size, bool),
            parent=np.full(self.size, -1),
            closed=closed,
            action=state.action.copy(),
        )

    def _now(self) -> State:
        if self._state is None:
            raise EcologyError("the world has not started: call reset before step.")
        return self._state

    # ---- putting a world where one wants it ----------------------------------------------

    def put(self, **fields: Any) -> Tick:
        """Overwrite fields of the state between ticks and return a Tick of what is perceived now.

        `env.put(position=..., internal=...)`, each of the field's own shape, for probes and tests.
        """
        state = self._now()
        known = state.arrays()
        for name, value in fields.items():
            if name not in known:
                raise EcologyError(f"the state has no array {name!r}. {nearest(name, known)}")
            value = np.asarray(value, dtype=known[name].dtype)
            require(
                value.shape == known[name].shape,
                f"state {name!r} has the shape {known[name].shape}, got {value.shape}.",
            )
            setattr(state, name, value.copy())
        if "alive" in fields:
            self._physics.touch(np.arange(self.size), state.alive)
        self._feel()
        return self._look(np.zeros(self.size), np.zeros(self.size, bool), np.zeros(self.size, bool))

    # ---- leaving a world and coming back ---------------------------------------------------

    def snapshot(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the world has become: arrays by name, and plain values that JSON holds.

        Contacts are forgotten on the way (the solver's hidden memory of the last tick), so that a
        world that lives on from here and one that is restored from here stay bit-identical.
        """
        state = self._now()
        self._physics = Physics(self.scenario.arena, self._radius, state.position, state.alive)
        arrays = {name: array.copy() for name, array in state.arrays().items()}
        plain = {f.name: getattr(state, f.name) for f in fields(state) if f.name not in arrays}
        streams = {name: rng.bit_generator.state for name, rng in self._rng.items()}
        return arrays, {"seed": self._seed, "state": plain, "rng": streams}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> Tick:
        """Become the world that `snapshot` returned, and return what its agents perceive.

        Raises EcologyError, the world being unchanged, where the snapshot is of another world.
        """
        fresh = Ecology(self.scenario)
        fresh.reset_arrays(values["seed"])
        state = fresh._now()
        known = {name: (array.shape, array.dtype) for name, array in state.arrays().items()}
        given = {name: (array.shape, array.dtype) for name, array in arrays.items()}
        differ = sorted(name for name in known.keys() | given.keys() if known.get(name) != given.get(name))
        require(
            not differ and values["rng"].keys() == fresh._rng.keys(),
            f"the snapshot is of another world than {self.scenario.name!r}: {', '.join(differ) or 'rng'} "
            "differ in shape or type; restore it with the scenario and the settings that it was made with.",
        )
        for name, array in arrays.items():
            setattr(state, name, array.copy())
        for name, value in values["state"].items():
            setattr(state, name, value)
        for name, stream in values["rng"].items():
            fresh._rng[name].bit_generator.state = stream
        self._seed, self._rng, self._state = fresh._seed, fresh._rng, state
        self._physics = Physics(self.scenario.arena, self._radius, state.position, state.alive)
        self.agents = [self.name_of(int(slot)) for slot in np.flatnonzero(state.alive)]
        self._feel()
        return self._look(np.zeros(self.size), np.zeros(self.size, bool), np.zeros(self.size, bool))

    # ---- the PettingZoo border -----------------------------------------------------------

    def name_of(self, slot: int) -> str:
        """Return the name of the agent in `slot`."""
        return f"{self._group_of[slot].name}_{int(self._now().serial[slot])}"

    @functools.cache  # noqa: B019  (PettingZoo wants the same object every time)
    def observation_space(self, agent: str) -> gymnasium.spaces.Dict:
        """Return Dict(observation Box float32 (D,), action_mask Box int8 (A,))."""
        group = self._group_of[self._slot(agent)]
        return gymnasium.spaces.Dict(
            {
                "observation": gymnasium.spaces.Box(
                    _float32_below(group.layout.low), -_float32_below(-group.layout.high), dtype=np.float32
                ),
                "action_mask": gymnasium.spaces.Box(0, 1, (len(group.actions),), np.int8),
            }
        )

    @functools.cache  # noqa: B019
    def action_space(self, agent: str) -> gymnasium.spaces.Discrete:
        """Return Discrete(A)."""
        return gymnasium.spaces.Discrete(len(self._group_of[self._slot(agent)].actions))

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start anew; without a seed, with the next one after the last."""
        tick = self.reset_arrays(self._seed + 1 if seed is None and self._state is not None else seed)
        self.agents = list(self.possible_agents)
        slots = range(self.size)
        return self._observation_dict(tick, slots), self._info_dict(tick, slots)

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advance one tick; every living agent needs an action, an index into its action space."""
        self._now()
        require(isinstance(actions, Mapping), f"actions are a dict, name to action, got {actions!r}.")
        before = [self._slot_of[name] for name in self.agents]
        array = np.zeros(self.size, np.int64)
        missing = [name for name in self.agents if name not in actions]
        require(not missing, f"every living agent needs an action; missing: {', '.join(missing[:5])}.")
        living = set(self.agents)
        for name, action in actions.items():
            if name not in living:
                known = name in self._slot_of
                raise EcologyError(
                    f"the life of {name!r} is over, it cannot act; act for `env.agents` only."
                    if known
                    else f"there is no agent {name!r}. {nearest(str(name), self.agents)}"
                )
            require(
                (isinstance(action, (int, np.integer)) and not isinstance(action, bool))
                or (isinstance(action, np.ndarray) and action.shape == () and action.dtype.kind in "iu"),
                f"the action of {name} must be a whole number, got {action!r}.",
            )
            count = len(self._group_of[self._slot_of[name]].actions)
            require(
                0 <= int(action) < count,
                f"the action of {name} must be a whole number from 0 to {count - 1}, got {int(action)}.",
            )
            array[self._slot_of[name]] = int(action)
        tick = self.step_arrays(array)
        over = self.horizon is not None and self._now().tick >= self.horizon
        names = [self.possible_agents[slot] for slot in before]
        observations, infos = self._observation_dict(tick, before), self._info_dict(tick, before)
        rewards = dict(zip(names, tick.reward[before].tolist(), strict=True))
        terminations = dict(zip(names, (~tick.alive[before]).tolist(), strict=True))
        truncations = dict.fromkeys(names, over)
        self.agents = [] if over else [name for name in names if not terminations[name]]
        return observations, rewards, terminations, truncations, infos

    def _observation_dict(self, tick: Tick, slots: Any) -> dict[str, Any]:
        found = {}
        for slot in slots:
            group = self._group_of[slot]
            row = slot - group.slots.start
            found[self.possible_agents[slot]] = {
                "observation": tick.observations[group.name][row],
                "action_mask": tick.masks[group.name][row].view(np.int8),
            }
        return found

    def _info_dict(self, tick: Tick, slots: Any) -> dict[str, dict[str, Any]]:
        found = {}
        for slot in slots:
            group = self._group_of[slot]
            found[self.possible_agents[slot]] = {
                "action_mask": tick.masks[group.name][slot - group.slots.start].view(np.int8),
                "drive": float(tick.drive[slot]),
                "closed": bool(tick.closed[slot]),
            }
        return found

    def _slot(self, agent: str) -> int:
        if agent not in self._slot_of:
            raise EcologyError(f"there is no agent {agent!r}. {nearest(str(agent), self._slot_of)}")
        return self._slot_of[agent]

    def state(self) -> np.ndarray:
        """Return a global view for centralised training, float32: position, heading, x and alive of every slot."""
        now = self._now()
        return np.concatenate(
            [now.position.ravel(), now.heading, now.internal.ravel(), now.alive.astype(float)]
        ).astype(np.float32)

    def render(self) -> np.ndarray | None:
        """Return a picture of the world, uint8 (height, width, 3), for render_mode "rgb_array"."""
        if self.render_mode is None:
            return None
        from ecology.observers.picture import draw  # loads the plotting library

        return draw(self.scenario, self._now().readonly())

    def close(self) -> None:
        """Nothing to release."""


def _float32_below(values: Floats) -> np.ndarray:
    """Return float32 bounds that contain what float64 values round to."""
    rounded = values.astype(np.float32)
    return np.where(np.isfinite(rounded), np.nextafter(rounded, np.float32(-np.inf)), rounded).astype(np.float32)


def parallel_env(scenario: Scenario, **options: Any) -> Ecology:
    """Return the world of `scenario` as a PettingZoo ParallelEnv."""
    return Ecology(scenario, **options)
