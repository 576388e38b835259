"""Ecology: the world as a PettingZoo parallel environment, and the order of one tick."""

from __future__ import annotations

import copy
import functools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, TypedDict, Unpack

import gymnasium
import numpy as np
from pettingzoo import ParallelEnv

from ecology import changes, empathy, kernels, life, meetings, neighbours, physiology, resources, senses
from ecology.actions import ActionTable, action_mask, compile_actions
from ecology.errors import EcologyError, nearest
from ecology.meetings import World
from ecology.physics import Physics
from ecology.plane import corners_of, plane_of
from ecology.scenario import Scenario
from ecology.senses import Layout
from ecology.spec import Species, require
from ecology.state import CAUSES, Bools, Floats, Ints, State

# one random stream each; new ones come last
CONCERNS = ("birth", "noise", "availability", "motion", "meeting", "offspring", "hazard", "rule", "lesion")
# attributes of Ecology that never change, which a copy shares
FIXED = (
    "scenario", "groups", "_plane", "_walls", "_body", "_eyes", "_tables", "_resources", "_gazes", "_couplings",
    "_radius", "_solid", "_species_of", "_looks", "_choices", "_acting", "_needs", "_has_need", "_patches",
)  # fmt: skip


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


class Ecology(ParallelEnv):
    """Many self-regulated agents in one continuous plane.

    `reset` and `step` are PettingZoo's, in dicts; `reset_arrays` and `step_arrays` are the same
    world without dicts, and give the same trajectory. A closed action is replaced by rest (or,
    where rest is closed too, by what is open: the sleep that immobilises, the go_to committed
    to), and `infos[agent]["closed"]` says so.

    `copy.deepcopy` and `pickle` take a world at any tick, and the copy continues bit for bit.
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
        counts = [s.slots for s in species]
        self.size = sum(counts)
        ends = np.cumsum(counts).tolist()
        blocks = [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]
        self._plane = plane_of(scenario.arena)
        self._walls = corners_of(scenario.arena)
        self._body = physiology.compile_bodies(species, width)
        self._eyes = senses.compile_eyes(species, scenario.arena, scenario.resources)
        self._tables = [compile_actions(s, scenario.resources, species) for s in species]
        self._resources = resources.compile_resources(scenario.resources, scenario.arena, species)
        self._gazes = [
            senses.compile_gaze(s, rows, scenario.arena, scenario.resources, species)
            for s, rows in zip(species, blocks, strict=True)
        ]
        self._couplings = empathy.compile_coupling(species, blocks, width)
        self._radius = np.repeat([float(s.radius) for s in species], counts)
        self._solid = np.repeat([s.solid for s in species], counts)
        self._species_of = np.repeat(np.arange(len(species)), counts)
        self._looks = np.repeat([s.empathy is not None and s.empathy.sight for s in species], counts)
        self._choices = np.repeat([len(s.actions) for s in species], counts)  # (N,)
        self._nobody = np.full(self.size, -1)
        self._near = self._nearness()
        self._meeting = any(s.crowding is not None or any(a.reach for a in s.actions) for s in species)
        self._mortal = (
            self._body.deadly
            or scenario.rule is not None
            or any(s.hazard is not None or any(a.kind == "bite" for a in s.actions) for s in species)
        )
        self.groups: dict[str, Group] = {}
        for i, (s, rows, table, gaze) in enumerate(zip(species, blocks, self._tables, self._gazes, strict=True)):
            self.groups[s.name] = Group(
                name=s.name,
                index=i,
                slots=rows,
                layout=gaze.layout,
                actions=table.names,
                kinds=table.kinds,
                speeds=table.speed,
                turns=table.turn,
                durations=table.duration,
                dt=self.dt,
            )
        self._acting = tuple(zip(self.groups.values(), self._tables, strict=True))
        self._needs = {s.name: tuple(need.name for need in s.needs) for s in species}
        has = [np.arange(width) < len(s.needs) for s in species]
        self._has_need = np.repeat(has, counts, axis=0)  # (N, V) which needs are none of the padding
        ends = np.cumsum([r.count for r in scenario.resources]).tolist()
        self._patches = {r.name: slice(end - r.count, end) for r, end in zip(scenario.resources, ends, strict=True)}
        self.open_population = any(s.grows for s in species)
        if not self.open_population:  # with births there is no end of names: see ecology.fixed
            self.possible_agents = [f"{s.name}_{serial}" for s, serials in self._founders() for serial in serials]
        self._named: tuple[list[str], dict[str, int]] | None = None  # `agents` and their slots; None: to be found
        self._state: State | None = None
        self._picture: Any = None  # of `render`, drawn upon again and again
        self._pairs: neighbours.Pairs | None = None
        self._reweighed: dict[str, float] = {}  # species -> factor of what it feels of others, 1 where not named
        self._seed: int | None = None

    def _nearness(self) -> float:
        """Return the distance within which anyone senses, meets or crowds another; 0: nobody does."""
        found = [0.0]
        for s, gaze in zip(self.scenario.species, self._gazes, strict=True):
            if s.neighbours or (s.empathy is not None and s.empathy.sight):
                found.append(gaze.far)
            found += [action.reach for action in s.actions]
            if s.crowding is not None:
                found.append(s.crowding.within)
        return max(found)

    def _founders(self) -> list[tuple[Species, range]]:
        """Return the species and the serials of those who live at the start."""
        found, start = [], 0
        for s in self.scenario.species:
            found.append((s, range(start, start + s.count)))
            start += s.count
        return found

    # ---- copies --------------------------------------------------------------------------

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the picture, which a copy draws anew."""
        return {**self.__dict__, "_picture": None}

    def __deepcopy__(self, memo: dict[int, Any]) -> Ecology:
        """Return a world of its own, which shares only what never changes."""
        twin = memo[id(self)] = object.__new__(type(self))
        state = self.__getstate__()
        memo |= {id(state[name]): state[name] for name in FIXED}
        twin.__dict__.update(copy.deepcopy(state, memo))
        return twin

    # ---- the world in arrays -------------------------------------------------------------

    @property
    def state_view(self) -> State:
        """Return a read-only view of everything that changes."""
        return self._now().readonly()

    @property
    def seed(self) -> int | None:
        """Return the seed that the world was last reset with, given or drawn; None before the first reset."""
        return self._seed

    def reset_arrays(self, seed: int | None = None) -> Tick:
        """Start the world anew from `seed` and return its first observations.

        Without a seed the first reset draws one from the operating system, and each later reset derives one
        from the last. `env.seed` returns it, and `reset(seed=env.seed)` repeats the episode.
        """
        if seed is not None:
            require(
                isinstance(seed, (int, np.integer)) and seed >= 0,
                f"seed must be a whole number of at least 0, got {seed!r}.",
            )
        self._seed = _next_seed(self._seed) if seed is None else int(seed)
        self._reweighed = {}
        streams = np.random.SeedSequence(self._seed).spawn(len(CONCERNS))
        self._rng = {name: np.random.default_rng(stream) for name, stream in zip(CONCERNS, streams, strict=True)}
        n, table = self.size, self._resources
        r = len(table.stock)
        alive, serial = np.zeros(n, bool), np.full(n, -1)
        position, heading = np.tile(self._walls[0], (n, 1)), np.zeros(n)
        for (s, serials), group in zip(self._founders(), self.groups.values(), strict=True):
            rows = slice(group.slots.start, group.slots.start + s.count)
            alive[rows], serial[rows] = True, serials
            position[rows], heading[rows] = life.place(self.scenario.arena, s, s.count, self._rng["birth"])
        nothing = np.zeros_like(self._body.start)
        self._state = state = State(
            tick=0,
            time=0.0,
            next_serial=int(np.count_nonzero(alive)),
            alive=alive,
            serial=serial,
            parent=np.full(n, -1),
            cause=np.zeros(n, np.int64),
            fatal_need=np.full(n, -1),
            killer=np.full(n, -1),
            age=np.zeros(n),
            position=position,
            heading=senses.wrap(heading),
            internal=np.where(alive[:, None], self._body.start, 0.0),
            drive=np.zeros(n),
            own_drive=np.zeros(n),
            felt=nothing.copy(),
            action=np.concatenate([np.full(t.slots, acts.rest) for t, acts in self._kinds()]),
            hold=np.zeros(n),
            bound_for=np.full(n, -1),
            bit=np.full(n, -1),
            gave=np.full(n, -1),
            inside=np.zeros((n, r), bool),
            seen=np.zeros((n, r), bool),
            resource_position=resources.first_places(table, self._rng["motion"]),
            stock=table.stock.copy(),
            available=resources.appear(table, np.ones(r, bool), 1, self._rng["availability"]),
            grown=np.zeros(r),
            eaten=np.zeros(r),
            ingested=nothing.copy(),
            received=nothing.copy(),
            given=nothing.copy(),
            metabolised=nothing.copy(),
            lost=nothing.copy(),
            returned=0,
            closed=np.zeros(n, np.int64),
        )
        self._named = None
        self._ring = self._rng["lesion"].permutation(n)
        self._physics = Physics(self.scenario.arena, self._radius, self._solid, state.position, state.alive)
        self._feel()
        return self._look(np.zeros(n))

    def _kinds(self) -> Any:
        """Return the species, each with its action table."""
        return zip(self.scenario.species, self._tables, strict=True)

    def step_arrays(self, actions: Ints) -> Tick:
        """Advance one tick: this is the order of things, top to bottom.

        `actions` (N,) holds an index into each slot's own species' actions; entries of dead
        slots are ignored.
        """
        state, body = self._now(), self._body
        # actions: what each body does, a closed action being replaced
        control, speed, direction, closed = self._decide(np.asarray(actions))
        # physics: bodies move and touch
        way = kernels.velocities(direction, speed)
        state.position, returned = self._physics.move(state.position, way, self.dt, state.alive)
        state.returned += returned
        # meetings: bodies that eat from one stock share it; bites, gifts, crowding, the scenario's own rule
        control, ingested, eaten = self._eat(control)
        received, given, killed, ruled, biter, wound = self._meet(control)
        # physiology: bodies drift, act and are disturbed
        before = state.drive
        taken = ingested + received - given
        internal = physiology.advance(body, state.internal, control, state.time, state.age, self.dt, self._rng["noise"])
        internal += received - given
        # births and deaths
        died, killer = self._die(internal, killed, ruled, biter, wound)
        free = ~state.alive  # a slot rests for a tick before a newborn takes it
        for name in ("metabolised", "lost", "age", "hold"):
            setattr(state, name, getattr(state, name).copy())  # what was handed out stays as it was
        state.internal, state.alive = kernels.live(
            state.alive, died, state.internal, taken, internal, body.low, body.high,
            state.metabolised, state.lost, state.age, state.hold, self.dt,
        )  # fmt: skip
        born, parent = self._bear(free)
        # resources: stocks regrow, come and go, move
        self._renew(eaten)
        # time
        state.tick += 1
        state.time = state.tick * self.dt
        # senses and observation
        self._feel()
        tick = self._look(np.where(born, 0.0, before - state.drive), died, closed, born, parent, killer)
        if died.any():
            self._show_fatal(tick, internal)
        return tick

    def _decide(self, actions: np.ndarray) -> tuple[Floats, Floats, Floats, Bools]:
        """Return u (N, V), speed (N,), direction (N,) and who asked for a closed action (N,)."""
        state = self._now()
        actions = self._checked(actions)
        control = np.empty_like(state.internal)
        speed, direction, way = np.empty(self.size), np.empty(self.size), np.empty((self.size, 2))
        closed = np.empty(self.size, bool)
        for name in ("heading", "action", "hold", "bound_for"):
            setattr(state, name, getattr(state, name).copy())  # what was handed out stays as it was
        going = 0
        for group, table in self._acting:
            going += kernels.decide(
                actions, self._masks[group.name], group.slots.start, self.dt, state.alive, state.hold, state.action,
                state.heading, state.bound_for, state.position, state.resource_position, self._toward,
                self._plane.size, self._plane.torus, table.control, table.speed, table.turn, table.direction,
                table.goes_to, table.duration, table.bites, table.rest, control, speed, direction, closed, way,
            )  # fmt: skip
        if going:
            rows = np.flatnonzero(state.bound_for >= 0)
            state.heading[rows] = direction[rows] = np.arctan2(way[rows, 1], way[rows, 0])
        state.closed = state.closed + closed
        return control, speed, direction, closed

    def _eat(self, control: Floats) -> tuple[Floats, Floats, Floats]:
        """Return u (N, V) with every consumption at its share, and what is eaten (N, V) and from what (R,)."""
        state, body = self._now(), self._body
        ingested, eaten = np.zeros(control.shape), np.zeros(len(state.stock))
        wanted, total, source = np.zeros(control.shape), np.zeros(self.size), self._nobody.copy()
        eaters = 0
        for group, table in self._acting:
            eaters += kernels.order_meals(
                group.slots.start, group.size, self.dt, state.alive, state.action, self._here, state.internal,
                body.proportional, table.consumes, table.intake, control, wanted, total, source,
            )  # fmt: skip
        if eaters:
            there = np.where(state.available, state.stock, 0.0)
            part, eaten = resources.share(total, source, there)
            kernels.serve(wanted, source, part, control, ingested)
            state.ingested = state.ingested + ingested
            state.eaten = state.eaten + eaten
        return control, ingested, eaten

    def _meet(self, control: Floats) -> tuple[Floats, Floats, Bools, Bools, Ints, Floats | None]:
        """Return what is received and given (N, V), who is bitten to death and who is killed by the rule, (N,).

        With them the slot of the agent that bit each, -1 without (N,), and what bites took, None: nothing (N, V).
        Crowding is added to the control u (N, V).
        """
        state, n = self._now(), self.size
        received, given = np.zeros(control.shape), np.zeros(control.shape)
        killed, ruled = np.zeros(n, bool), np.zeros(n, bool)
        biter, wound = self._nobody, None
        if not self._meeting and self.scenario.rule is None:
            return received, given, killed, ruled, biter, wound
        if self._meeting:
            state.bit, state.gave = self._nobody.copy(), self._nobody.copy()
            attackers, victims, chance = [], [], []
            for group, table in self._acting:
                rows = group.slots
                action = state.action[rows]
                target = self._targets[group.name][np.arange(group.size), action]
                meets = (target >= 0) & (table.meets[action] >= 0) & state.alive[rows]
                bites = np.flatnonzero(meets & table.bites[action] & (state.hold[rows] <= 0))
                attackers.append(rows.start + bites)
                victims.append(target[bites])
                chance.append(table.chance[action[bites]])
                gives = np.flatnonzero(meets & ~table.bites[action])
                if gives.size:
                    act, giver, to = action[gives], rows.start + gives, target[gives]
                    held = state.internal[giver] - self._body.low[giver]
                    gift = meetings.gifts(table.gives[act] * self.dt, held)
                    given[giver] += gift
                    np.add.at(received, to, np.einsum("kv,kvw->kw", gift, table.arrives[act]))
                    state.gave[giver] = to
            attacker, victim = np.concatenate(attackers), np.concatenate(victims)
            if attacker.size:
                won = meetings.succeed(attacker, victim, np.concatenate(chance), self.dt, n, self._rng["meeting"])
                if won.any():
                    biter, wound = self._bite(attacker[won], victim[won], received, given, killed)
            self._crowd(control)
        if self.scenario.rule is not None:
            world = World(
                state.readonly(), self.dt, {g.name: g.slots for g in self.groups.values()}, self._needs,
                {g.name: g.actions for g in self.groups.values()}, self._patches, self.scenario.arena,
            )  # fmt: skip
            outcome = meetings.checked(self.scenario.rule(world, self._rng["rule"]), self.scenario, world)
            living = state.alive[:, None]
            received += np.where(living, outcome.received, 0.0)
            given += np.where(living, outcome.given, 0.0)
            ruled = outcome.killed & state.alive
            if outcome.position is not None:
                place = self._plane.home(np.asarray(outcome.position, float))
                state.position = np.where(living, place, state.position)
        state.received, state.given = state.received + received, state.given + given
        return received, given, killed, ruled, biter, wound

    def _bite(
        self, attacker: Ints, victim: Ints, received: Floats, given: Floats, killed: Bools
    ) -> tuple[Ints, Floats]:
        """Write what successful bites (k,) come to into what is received and given (N, V) and who is killed (N,).

        Returns the slot of the agent that bit each, -1 without (N,), and what bites took (N, V).
        """
        state = self._now()
        biter, wound = self._nobody.copy(), np.zeros(given.shape)
        biter[victim] = attacker
        state.bit[attacker] = victim
        for group, table in self._acting:
            mine = (attacker >= group.slots.start) & (attacker < group.slots.stop)
            who, whom = attacker[mine], victim[mine]
            act = state.action[who]
            state.hold[who] = table.duration[act]
            received[who] += table.gain[act]
            kills = np.isnan(table.damage[act]).any(axis=1)
            killed[whom[kills]] = True
            wound[whom[~kills]] = table.damage[act[~kills]]
        given += wound
        return biter, wound

    def _crowd(self, control: Floats) -> None:
        """Add to u (N, V) what the others near a body do to it."""
        pairs = self._pairs
        for group, species in zip(self.groups.values(), self.scenario.species, strict=True):
            crowding = species.crowding
            if crowding is None or pairs is None:
                continue
            counts = pairs.distance <= crowding.within
            if crowding.species:
                meant = [s.name in crowding.species for s in self.scenario.species]
                counts &= np.array(meant)[self._species_of[pairs.other]]
            close = pairs.who[counts] - group.slots.start
            others = np.bincount(close[(close >= 0) & (close < group.size)], minlength=group.size)
            for name, rate in crowding.control.items():
                control[group.slots, self._needs[species.name].index(name)] += rate * others

    def _die(
        self, internal: Floats, killed: Bools, ruled: Bools, biter: Ints, wound: Floats | None
    ) -> tuple[Bools, Ints]:
        """Return who dies in this tick and the slot of the agent that killed it, -1 without, both (N,).

        What each died of is noted. It was bitten to death where without the `wound` (N, V) it would have lived.
        """
        state, body = self._now(), self._body
        died, killer = np.zeros(self.size, bool), self._nobody
        if not self._mortal:
            return died, killer
        of_need = physiology.fatal(body, internal) if body.deadly else died
        bitten = died
        if wound is not None and of_need.any():
            bitten = of_need & (biter >= 0) & ~physiology.fatal(body, internal + wound)
        failed = np.zeros(self.size, bool)
        for group, species in zip(self.groups.values(), self.scenario.species, strict=True):
            if species.hazard is not None:
                failed[group.slots] = life.fails(species.hazard, state.age[group.slots], self.dt, self._rng["hazard"])
        for cause, who in (
            ("eaten", killed), ("rule", ruled), ("bitten", bitten), ("need", of_need), ("hazard", failed)
        ):  # fmt: skip
            new = who & state.alive & ~died
            if not new.any():
                continue
            state.cause = np.where(new, CAUSES.index(cause), state.cause)
            if cause in ("bitten", "need"):
                state.fatal_need = np.where(new, physiology.first_fatal(body, internal), state.fatal_need)
            if cause in ("eaten", "bitten"):
                killer = np.where(new, biter, killer)
                state.killer = np.where(new, state.serial[biter], state.killer)
            died = died | new
            self._named = None
        return died, killer

    def _bear(self, free: Bools) -> tuple[Bools, Ints]:
        """Let newborns take `free` slots (N,), and return who is born (N,) and the slot of each one's parent (N,)."""
        state, arena = self._now(), self.scenario.arena
        born, parent = np.zeros(self.size, bool), self._nobody.copy()
        rng = self._rng["offspring"]
        for group, species in zip(self.groups.values(), self.scenario.species, strict=True):
            if not species.grows:
                continue
            rows, needs = group.slots, self._needs[species.name]
            slots = rows.start + np.flatnonzero(free[rows])
            bearers = np.empty(0, np.int64)
            if species.birth is not None:
                able = life.fit(species.birth, needs, state.internal[rows], state.age[rows], state.alive[rows])
                bearers = rows.start + life.bearers(species.birth, able, len(slots), self.dt, rng)
                if bearers.size:
                    state.given = state.given.copy()  # what was handed out stays as it was
                for name, cost in species.birth.cost.items():
                    state.internal[bearers, needs.index(name)] -= cost
                    state.given[bearers, needs.index(name)] += cost
            arriving = (
                min(int(rng.poisson(species.arrival * self.dt)), len(slots) - len(bearers)) if species.arrival else 0
            )
            place, heading = life.place(arena, species, arriving, rng)
            if bearers.size:
                place = np.concatenate(
                    [life.beside(arena, self._walls, state.position[bearers], species.radius, rng), place]
                )
                heading = np.concatenate([rng.uniform(-np.pi, np.pi, len(bearers)), heading])
            new = slots[: len(place)]
            if not new.size:
                continue
            self._settle(new, place, heading)
            parent[new[: len(bearers)]] = bearers
            state.parent[new[: len(bearers)]] = state.serial[bearers]
            born[new] = True
        return born, parent

    def _settle(self, new: Ints, place: Floats, heading: Floats) -> None:
        """Let newborns live in the slots `new` (k,), at `place` (k, 2); what was left of the dead there is lost."""
        state = self._now()
        for name in (
            "serial", "parent", "cause", "fatal_need", "killer", "age", "alive", "action", "bound_for", "position",
            "heading", "received",
        ):  # fmt: skip
            setattr(state, name, getattr(state, name).copy())  # what was handed out stays as it was
        self._named = None
        state.lost[new] += state.internal[new]
        state.received[new] += self._body.start[new]
        state.internal[new] = self._body.start[new]
        state.serial[new] = state.next_serial + np.arange(len(new))
        state.next_serial += len(new)
        state.alive[new], state.age[new], state.cause[new], state.parent[new] = True, 0.0, 0, -1
        state.fatal_need[new], state.killer[new] = -1, -1
        state.position[new], state.heading[new] = place, senses.wrap(heading)
        state.hold[new], state.bound_for[new] = 0.0, -1
        state.action[new] = self._tables[int(self._species_of[new[0]])].rest

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
        places = resources.drift(table, self.scenario.arena, places, self.dt, self._rng["motion"])
        places, gone = resources.relocate(table, places, emptied, self._rng["motion"])
        grown[gone] += table.stock[gone] - stock[gone]
        stock[gone] = table.stock[gone]
        if gone.any():  # who was on the way there does not know where it went
            state.bound_for = state.bound_for.copy()  # a rule may have been shown it
            bound = np.flatnonzero(state.bound_for >= 0)
            state.bound_for[bound[gone[state.bound_for[bound]]]] = -1
        state.stock, state.grown, state.resource_position = stock, state.grown + grown, places
        if table.uncertain:
            units = resources.whole_units(until) - resources.whole_units(state.time)
            state.available = resources.appear(table, state.available, units, self._rng["availability"])

    def _limit(self) -> None:
        """Let stocks that were put or restored be eaten, also where the scenario has unlimited ones only."""
        if self._resources.constant and np.isfinite(self._now().stock).any():
            self._resources = replace(self._resources, constant=False, finite=True)

    def _checked(self, actions: np.ndarray) -> Ints:
        """Return the actions (N,), those of dead slots as 0, or raise EcologyError."""
        if actions.shape != (self.size,) or actions.dtype.kind not in "iu":
            raise EcologyError(
                f"actions must be {self.size} whole numbers, one a slot, got {actions.dtype} {actions.shape}."
            )
        found = np.where(self._now().alive, actions, 0).astype(np.int64)
        bad = kernels.first_unknown(found, self._choices)
        if bad >= 0:
            raise EcologyError(
                f"the action of {self.name_of(bad)} must be a whole number from 0 to {self._choices[bad] - 1}, "
                f"got {int(actions[bad])}."
            )
        return found

    def _feel(self) -> None:
        """Renew what bodies feel and see: drive, reach, sight, neighbours and the action masks."""
        state, body, table = self._now(), self._body, self._resources
        # resources in reach and in sight
        state.bound_for = state.bound_for.copy()  # who has arrived is bound for nothing more
        offered = resources.offered(state.stock, state.available)
        state.inside, state.seen, self._here, self._toward, glimpse = senses.find_patches(
            self._eyes, self._plane, table, len(self.scenario.resources), state, offered
        )
        # others in reach and in sight
        self._pairs = pairs = (
            neighbours.find(self._plane, state.position, state.alive, self._near, self._pairs) if self._near else None
        )
        self._targets = {
            group.name: self._aim(group, acts) for group, acts in zip(self.groups.values(), self._tables, strict=True)
        }
        # the drive, of oneself and of others
        delta = physiology.deviation(body, state.internal)
        last = state.drive, state.felt
        state.own_drive = state.drive = physiology.drive(delta, body.epsilon, 1.0 if body.straight else body.exponent)
        for coupling in self._couplings:
            self._empathise(coupling, delta)
        if self._couplings:  # the dead feel what they felt last: to die is no relief
            state.drive = np.where(state.alive, state.drive, last[0])
            state.felt = np.where(state.alive[:, None], state.felt, last[1])
        self._around = senses.Surroundings(table, self._plane, body, self._species_of, glimpse, pairs, self._eyes)
        self._masks = {
            group.name: action_mask(
                acts,
                state.internal[group.slots],
                state.alive[group.slots],
                state.hold[group.slots],
                state.action[group.slots],
                state.bound_for[group.slots],
                self._here[group.slots],
                self._toward[group.slots],
                self._targets[group.name],
            )
            for group, acts in zip(self.groups.values(), self._tables, strict=True)
        }

    def _aim(self, group: Group, table: ActionTable) -> Ints:
        """Return whom bites and gifts would meet, slots (n, A), -1 nobody: the nearest in reach, no wall between."""
        targets = np.full((group.size, len(group.actions)), -1)
        pairs, state, eyes = self._pairs, self._now(), self._eyes
        for a in table.meeting:
            assert pairs is not None
            targets[:, a] = kernels.in_reach(
                pairs.starts, pairs.other, pairs.distance, group.slots.start, group.size, table.reach[a],
                table.meets[a], self._species_of, state.position, eyes.wall_from, eyes.wall_along, eyes.open,
            )  # fmt: skip
        return targets

    def _empathise(self, coupling: empathy.Coupling, delta: Floats) -> None:
        """Let the state of others enter the drive of one species."""
        state, body, rows = self._now(), self._body, coupling.rows
        felt = empathy.feel(coupling, self._weigh(coupling), state, body)
        state.felt, state.drive = state.felt.copy(), state.drive.copy()
        state.felt[rows] = felt
        if coupling.empathy.form == "sum":
            state.drive[rows] = state.own_drive[rows] + felt[:, 0]
        else:
            together = coupling.own * delta[rows] + felt
            state.drive[rows] = physiology.drive(together, body.epsilon[rows], body.exponent[rows])

    def _weigh(self, coupling: empathy.Coupling) -> Floats:
        """Return who of one species feels whom now and how much, (n, m)."""
        state, pairs, seen = self._now(), self._pairs, None
        if coupling.empathy.sight and pairs is not None:
            seen = senses.sight(self._eyes, pairs, state.position, state.heading, self._looks)
        weight = empathy.matrix(coupling, state, self._plane, pairs, seen, self._ring)
        factor = self._reweighed.get(self.scenario.species[self._species_of[coupling.rows.start]].name, 1.0)
        return weight if factor == 1.0 else weight * factor

    def _look(
        self,
        reward: Floats,
        died: Bools | None = None,
        closed: Bools | None = None,
        born: Bools | None = None,
        parent: Ints | None = None,
        killer: Ints | None = None,
    ) -> Tick:
        """Return what the agents perceive."""
        state, none = self._now(), np.zeros(self.size, bool)
        return Tick(
            observations={
                group.name: senses.observe(gaze, state, self._around, self.scenario.day)
                for group, gaze in zip(self.groups.values(), self._gazes, strict=True)
            },
            masks=self._masks,
            reward=reward,
            drive=state.drive,
            alive=state.alive,
            died=none if died is None else died,
            born=none if born is None else born,
            parent=self._nobody.copy() if parent is None else parent,
            killer=self._nobody.copy() if killer is None or killer is self._nobody else killer,
            closed=none if closed is None else closed,
            action=state.action.copy(),
        )

    def _show_fatal(self, tick: Tick, internal: Floats) -> None:
        """Write the needs with which agents died, from x (N, V) after the tick, into their last observation.

        The state keeps what a dead body stored before the tick, so that the account closes and death is no relief.
        """
        body = self._body
        x = np.where(np.isfinite(internal), np.clip(internal, body.low, body.high), self._now().internal)
        for group, species in zip(self.groups.values(), self.scenario.species, strict=True):
            rows, width = np.flatnonzero(tick.died[group.slots]), len(species.needs)
            at = group.slots.start + rows
            tick.observations[group.name][rows, :width] = (x - body.set_point)[at, :width]

    def _now(self) -> State:
        if self._state is None:
            raise EcologyError("the world has not started: call reset before step.")
        return self._state

    # ---- for those who watch ---------------------------------------------------------------

    def sighted(self, slot: int) -> Ints:
        """Return the slots of the others whom the agent in `slot` sees now, (k,); none where its species looks not."""
        state, pairs = self._now(), self._pairs
        if pairs is None or not self._looks[slot]:
            return np.empty(0, np.int64)
        looks = np.arange(self.size) == slot
        return pairs.other[senses.sight(self._eyes, pairs, state.position, state.heading, looks)]

    def coupling(self, species: str, need: str | None = None) -> tuple[Floats, Ints] | None:
        """Return the weights w_ij with which the n slots of `species` feel m slots now, (n, m), and those slots, (m,).

        The slots of `species` itself are among the m, and w_ii is one's own weight. Sum form: the drive is
        sum_j w_ij d_j. Average form: it is d(sum_j w_ij delta_j), need by need, and the weights are those of `need`,
        or of the need that is felt most. Dead slots have no weights. None where the species has no empathy.
        """
        if species not in self.groups:
            raise EcologyError(f"there is no species {species!r}. {nearest(str(species), self.groups)}")
        needs = self._needs[species]
        if need is not None and need not in needs:
            raise EcologyError(f"species {species!r} has no need {need!r}. {nearest(str(need), needs)}")
        rows = self.groups[species].slots
        for coupling in self._couplings:
            if coupling.rows == rows:
                column = None if need is None else needs.index(need)
                return empathy.weights(coupling, self._weigh(coupling), self._now().alive, column)
        return None

    # ---- putting a world where one wants it ----------------------------------------------

    def put(self, **fields: Any) -> Tick:
        """Overwrite fields of the state between ticks and return a Tick of what is perceived now.

        `env.put(position=..., internal=...)`, each of the field's own shape, for probes and tests. Slots that are no
        longer `alive` have died of the rule; those that are again go on under their name, or get a new one where
        nobody lived. Raises EcologyError, the state being unchanged, for what no world can come to: places outside
        the arena, needs beyond their bounds (but lethal ones, of which the agent then dies), stocks below 0 or above
        their capacity, unknown actions, slots or names.
        """
        state = self._now()
        changed = changes.read(fields, state)
        if "alive" in changed:
            changes.rename(changed, state, self.scenario)
        changes.check(changed, state, self.scenario, self._plane, self._body, self._resources, self._choices)
        for name, value in changed.items():
            setattr(state, name, value)
        state.next_serial = max(state.next_serial, int(state.serial.max(initial=-1)) + 1)
        self._named = None
        self._limit()
        state.position = self._plane.home(state.position)
        if fields.keys() & {"position", "alive"}:  # the solver remembers contacts of another place
            self._physics = Physics(self.scenario.arena, self._radius, self._solid, state.position, state.alive)
        self._feel()
        return self._look(np.zeros(self.size))

    def settle(self, species: str, place: tuple[float, float], heading: float = 0.0) -> tuple[Tick, int]:
        """Let one more agent live between ticks, at `place`; return a Tick of what is perceived now, and its slot.

        It has the needs of a newborn and no parent. Where there are no births, a dead agent returns under its name.
        Raises EcologyError where every slot of the species is taken or the place lies outside the arena.
        """
        state = self._now()
        if species not in self.groups:
            raise EcologyError(f"there is no species {species!r}. {nearest(species, self.groups)}")
        rows = self.groups[species].slots
        free = rows.start + np.flatnonzero(~state.alive[rows])
        require(
            free.size > 0,
            f"all {self.groups[species].size} slots of {species!r} are taken; remove an agent, or raise the capacity "
            "of the species in the scenario.",
        )
        require(
            bool(changes.inside(self.scenario, np.array([place], float))[0]),
            f"the place {place!r} lies outside the arena.",
        )
        new, serial, following = free[:1], state.serial[free[:1]].copy(), state.next_serial
        for name in ("lost", "internal", "hold"):
            setattr(state, name, getattr(state, name).copy())  # what was handed out stays as it was
        self._settle(new, self._plane.home(np.array([place], float)), np.array([heading]))
        if not any(s.grows for s in self.scenario.species):
            state.serial[new], state.next_serial = serial, following
        self._physics = Physics(self.scenario.arena, self._radius, self._solid, state.position, state.alive)
        self._feel()
        return self._look(np.zeros(self.size)), int(new[0])

    def reweigh(self, species: str, factor: float) -> Tick:
        """Multiply what `species` feels of others by `factor` from now on, 0 for nothing; return what is perceived now.

        The weights of the average form are shares, which a common factor leaves as they are: there it is 0 or 1.
        Raises EcologyError where the species has no empathy.
        """
        coupling = next((c for c in self._couplings if species in self.groups and c.rows == self.groups[species].slots),
                        None)  # fmt: skip
        if coupling is None:
            able = [s.name for s in self.scenario.species if s.empathy is not None]
            raise EcologyError(
                f"the species {species!r} has no empathy; "
                + (f"give one that has: {', '.join(able)}." if able else "no species of this scenario has.")
            )
        require(
            bool(np.isfinite(factor)) and (coupling.empathy.form == "sum" or factor in (0.0, 1.0)),
            f"what {species!r} feels, in the average form of empathy, can be switched off or on, not reweighed.",
        )
        self._reweighed = {**self._reweighed, species: float(factor)}
        self._feel()
        return self._look(np.zeros(self.size))

    # ---- leaving a world and coming back ---------------------------------------------------

    def snapshot(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the world has become: arrays by name, and plain values that JSON holds.

        A world that is restored from here lives on bit for bit as this one does.
        """
        state = self._now()
        arrays = {name: array.copy() for name, array in state.arrays().items()}
        plain = {f.name: getattr(state, f.name) for f in fields(state) if f.name not in arrays}
        arrays |= self._physics.memory()
        streams = {name: rng.bit_generator.state for name, rng in self._rng.items()}
        more = {"reweighed": dict(self._reweighed)} if self._reweighed else {}
        return arrays, {"seed": self._seed, "state": plain, "rng": streams, **more}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> Tick:
        """Become the world that `snapshot` returned, and return what its agents perceive.

        Raises EcologyError, the world being unchanged, where the snapshot is of another world.
        """
        fresh = Ecology(self.scenario)
        fresh.reset_arrays(values["seed"])
        state = fresh._now()
        memory = fresh._physics.memory()  # of as many ticks as there were
        own = state.arrays() | {name: array[:0] for name, array in memory.items()}
        known = {name: (array.shape, array.dtype) for name, array in own.items()}
        given = {
            name: ((0, *array.shape[1:]) if name in memory else array.shape, array.dtype)
            for name, array in arrays.items()
        }
        differ = sorted(name for name in known.keys() | given.keys() if known.get(name) != given.get(name))
        require(
            not differ and values["rng"].keys() == fresh._rng.keys(),
            f"the snapshot is of another world than {self.scenario.name!r}: {', '.join(differ) or 'rng'} "
            "differ in shape or type; restore it with the scenario and the settings that it was made with.",
        )
        for name in state.arrays():
            setattr(state, name, arrays[name].copy())
        for name, value in values["state"].items():
            setattr(state, name, value)
        for name, stream in values["rng"].items():
            fresh._rng[name].bit_generator.state = stream
        fresh._physics.remember(arrays, self.dt)
        self._seed, self._rng, self._state = fresh._seed, fresh._rng, state
        self._reweighed = dict(values.get("reweighed", {}))
        self._ring, self._physics = fresh._ring, fresh._physics
        self._named = None
        self._limit()
        self._feel()
        return self._look(np.zeros(self.size))

    # ---- the PettingZoo border -----------------------------------------------------------

    def name_of(self, slot: int) -> str:
        """Return the name of the agent in `slot`."""
        return f"{self.scenario.species[self._species_of[slot]].name}_{int(self._now().serial[slot])}"

    @property
    def agents(self) -> list[str]:  # type: ignore[override]
        """Return the names of the living, in the order of their slots; nobody's before a reset and at the horizon."""
        return self._enlist()[0]

    @property
    def _slots(self) -> dict[str, int]:
        """Return the slots of `agents`, by name."""
        return self._enlist()[1]

    def _enlist(self) -> tuple[list[str], dict[str, int]]:
        """Return `agents` and their slots by name, found again only after a birth or a death."""
        state = self._state
        if state is None or (self.horizon is not None and state.tick >= self.horizon):
            return [], {}
        if self._named is None:
            slots = {self.name_of(slot): slot for slot in np.flatnonzero(state.alive).tolist()}
            self._named = list(slots), slots
        return self._named

    def observation_space(self, agent: str) -> gymnasium.spaces.Dict:
        """Return Dict(observation Box float32 (D,), action_mask Box int8 (A,)), one object for a whole species."""
        return self._spaces[self._species(agent)][0]

    def action_space(self, agent: str) -> gymnasium.spaces.Discrete:
        """Return Discrete(A), one object for a whole species."""
        return self._spaces[self._species(agent)][1]

    @functools.cached_property
    def _spaces(self) -> dict[str, tuple[gymnasium.spaces.Dict, gymnasium.spaces.Discrete]]:
        found = {}
        for group in self.groups.values():
            box = gymnasium.spaces.Box(
                float32_below(group.layout.low), -float32_below(-group.layout.high), dtype=np.float32
            )
            mask = gymnasium.spaces.Box(0, 1, (len(group.actions),), np.int8)
            found[group.name] = (
                gymnasium.spaces.Dict({"observation": box, "action_mask": mask}),
                gymnasium.spaces.Discrete(len(group.actions)),
            )
        return found

    def _species(self, agent: str) -> str:
        """Return the species of anyone who lives, has lived or will; EcologyError for a name that nobody can have."""
        species, _, serial = str(agent).rpartition("_")
        founders = getattr(self, "possible_agents", None)
        if species not in self.groups or not serial.isdecimal() or (founders is not None and agent not in founders):
            raise EcologyError(f"there is no agent {agent!r}. {nearest(str(agent), founders or self.agents)}")
        return species

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start anew; without a seed, from one that is drawn or derived from the last: see `reset_arrays`."""
        tick = self.reset_arrays(seed)
        slots = np.array(list(self._slots.values()), np.int64)
        return self._observation_dict(tick, self.agents, slots), self._info_dict(tick, self.agents, slots)

    def step(
        self, actions: dict[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advance one tick; every living agent needs an action, an index into its action space.

        Newborns are in all five dicts on the tick of their birth, except in the horizon's tick, in which they could
        never act; the dead are in them for a last time. After the end, which is the horizon or the death of the last
        agent where none can arrive, no tick passes and the dicts are empty.
        """
        state = self._now()
        if self._is_over():
            self._read(actions)
            return {}, {}, {}, {}, {}
        names = self.agents
        slots = np.array(list(self._slots.values()), np.int64)
        array = np.zeros(self.size, np.int64)
        array[slots] = self._read(actions)
        tick = self.step_arrays(array)
        over = self.horizon is not None and state.tick >= self.horizon
        if tick.born.any() and not over:
            slots = np.union1d(slots, np.flatnonzero(tick.born))
            names = [self.name_of(slot) for slot in slots.tolist()]
        rewards = dict(zip(names, tick.reward[slots].tolist(), strict=True))
        terminations = dict(zip(names, (~tick.alive[slots]).tolist(), strict=True))
        truncations = dict.fromkeys(names, over)
        observations, infos = self._observation_dict(tick, names, slots), self._info_dict(tick, names, slots)
        return observations, rewards, terminations, truncations, infos

    def _is_over(self) -> bool:
        """Return whether nobody is left who acts, now or later."""
        state = self._now()
        reached = self.horizon is not None and state.tick >= self.horizon
        empty = not state.alive.any() and not any(s.arrival for s in self.scenario.species)
        return not self.agents and (reached or empty)

    def _read(self, actions: Any) -> np.ndarray:
        """Return the actions of `self.agents` (n,) from a dict, or raise EcologyError."""
        require(isinstance(actions, Mapping), f"actions are a dict, name to action, got {actions!r}.")
        missing = [name for name in self.agents if name not in actions]
        require(not missing, f"every living agent needs an action; missing: {', '.join(missing[:5])}.")
        for name in actions if len(actions) > len(self.agents) else ():
            if name not in self._slots:
                self._species(name)
                raise EcologyError(f"the life of {name!r} is over, it cannot act; act for `env.agents` only.")
        wanted = [actions[name] for name in self.agents]
        if not all(issubclass(kind, (int, np.integer)) and kind is not bool for kind in set(map(type, wanted))):
            for name, action in zip(self.agents, wanted, strict=True):
                require(
                    (isinstance(action, (int, np.integer)) and not isinstance(action, bool))
                    or (isinstance(action, np.ndarray) and action.shape == () and action.dtype.kind in "iu"),
                    f"the action of {name} must be a whole number, got {action!r}.",
                )
            wanted = [int(action) for action in wanted]
        try:
            return np.array(wanted, np.int64)
        except OverflowError as error:
            raise EcologyError(f"an action is an index into its action space, got {max(wanted, key=abs)}.") from error

    def _observation_dict(self, tick: Tick, names: list[str], slots: Ints) -> dict[str, Any]:
        found = {}
        for group, part, rows in self._parts(slots):
            zeta, mask = tick.observations[group.name][rows], tick.masks[group.name][rows].view(np.int8)
            for name, observation, open_ in zip(names[part], zeta, mask, strict=True):
                found[name] = {"observation": observation, "action_mask": open_}
        return found

    def _info_dict(self, tick: Tick, names: list[str], slots: Ints) -> dict[str, dict[str, Any]]:
        found: dict[str, dict[str, Any]] = {}
        for _, part, _ in self._parts(slots):
            drive, closed = tick.drive[slots[part]].tolist(), tick.closed[slots[part]].tolist()
            for name, d, shut in zip(names[part], drive, closed, strict=True):
                found[name] = {"drive": d, "closed": shut}
        return found

    def _parts(self, slots: Ints) -> Iterator[tuple[Group, slice, Ints]]:
        """Yield each group with the part of the ordered `slots` that is its own, and their rows in it."""
        for group in self.groups.values():
            start, stop = np.searchsorted(slots, (group.slots.start, group.slots.stop))
            yield group, slice(int(start), int(stop)), slots[start:stop] - group.slots.start

    def state(self) -> np.ndarray:
        """Return a global view for centralised training, float32: position, heading, x and alive of every slot."""
        now = self._now()
        return np.concatenate(
            [now.position.ravel(), now.heading, now.internal[self._has_need], now.alive.astype(float)]
        ).astype(np.float32)

    @functools.cached_property
    def state_space(self) -> gymnasium.spaces.Box:
        """Return the Box of `state()`; the x of a slot is 0 before its first agent."""
        (left, bottom), (right, top) = self.scenario.arena.extent
        body, own, ones = self._body, self._has_need, np.ones(self.size)
        low = [np.tile([left, bottom], self.size), -np.pi * ones, np.minimum(body.low, 0.0)[own], 0 * ones]
        high = [np.tile([right, top], self.size), np.pi * ones, np.maximum(body.high, 0.0)[own], ones]
        return gymnasium.spaces.Box(
            float32_below(np.concatenate(low)), -float32_below(-np.concatenate(high)), dtype=np.float32
        )

    def render(self) -> np.ndarray | None:
        """Return a picture of the world, uint8 (height, width, 3), for render_mode "rgb_array"."""
        if self.render_mode is None:
            return None
        from ecology.observers.picture import Picture, frame  # loads the plotting library

        if self._picture is None:
            self._picture = Picture(self.scenario)
        return self._picture.draw(frame(self.scenario, self._now().readonly()))

    def close(self) -> None:
        """Nothing to release."""


def _next_seed(last: int | None) -> int:
    """Return a seed of 53 bits: drawn from the operating system, or derived from the last one.

    It is not the last one plus 1: the series of neighbouring seeds would share their episodes.
    """
    source = np.random.SeedSequence() if last is None else np.random.SeedSequence([last, 1])
    return int(source.generate_state(1, np.uint64)[0] >> np.uint64(11))


def float32_below(values: Floats) -> np.ndarray:
    """Return float32 bounds that contain what float64 values round to."""
    rounded = values.astype(np.float32)
    return np.where(np.isfinite(rounded), np.nextafter(rounded, np.float32(-np.inf)), rounded).astype(np.float32)


class EnvOptions(TypedDict, total=False):
    """Options of `parallel_env`: those of `Ecology`."""

    horizon: int | None
    render_mode: str | None


def parallel_env(scenario: Scenario, **options: Unpack[EnvOptions]) -> Ecology:
    """Return the world of `scenario` as a PettingZoo ParallelEnv."""
    return Ecology(scenario, **options)
