"""Ecology: a world as a PettingZoo parallel environment."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, TypedDict, Unpack

import gymnasium
import numpy as np
from pettingzoo import ParallelEnv

from ecology.errors import EcologyError, nearest
from ecology.migration import Bodies
from ecology.model import Group, compile_model
from ecology.scenario import Scenario
from ecology.schedule import Timetable, carry_out
from ecology.spec import require
from ecology.state import Floats, Ints, State
from ecology.world import ArrayWorld, Tick


class Ecology(ParallelEnv):
    """Many self-regulated agents in one continuous plane.

    `reset` and `step` are PettingZoo's, in dicts; `reset_arrays` and `step_arrays` are the same
    world without dicts, and give the same trajectory. A closed action is replaced by rest (or,
    where rest is closed too, by what is open: the sleep that immobilises, the go_to committed
    to), and `infos[agent]["closed"]` says so.

    `copy.deepcopy` and `pickle` take a world at any tick, and the copy continues bit for bit.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "ecology",
        "render_modes": ["rgb_array", "human"],
        "is_parallelizable": True,
    }

    def __init__(self, scenario: Scenario, *, horizon: int | None = None, render_mode: str | None = None) -> None:
        """Build the world of `scenario`; after `horizon` ticks every agent is truncated."""
        require(
            isinstance(scenario, Scenario),
            f"a world is built from a Scenario, got {scenario!r}; `ecology.scenarios.load(name)` returns one.",
        )
        require(
            render_mode is None or render_mode in self.metadata["render_modes"],
            f"render_mode must be one of {self.metadata['render_modes']} or None, got {render_mode!r}.",
        )
        require(
            horizon is None or (isinstance(horizon, (int, np.integer)) and horizon > 0),
            f"horizon must be a positive whole number of ticks, got {horizon!r}.",
        )
        self.world = ArrayWorld(compile_model(scenario))
        self.timetable: Timetable | None = None  # of the schedule, if there is one
        if scenario.schedule or scenario.sessions:
            self.timetable = Timetable(scenario)
        self.horizon = horizon
        self.render_mode = render_mode
        if not self.open_population:  # with births there is no end of names: see ecology.fixed
            founders = self.world.model.founders()
            self.possible_agents = [f"{s.name}_{serial}" for s, serials in founders for serial in serials]
        # turnover, then `agents`, their slots by name and their slots (n,)
        self._named: tuple[int, list[str], dict[str, int], Ints] = -1, [], {}, np.empty(0, np.int64)
        self._window: Any = None  # of render_mode "human"
        self._picture: Any = None  # of `render`, drawn upon again and again

    def __getstate__(self) -> dict[str, Any]:
        """Return all but the picture, which a copy draws again."""
        return {**self.__dict__, "_picture": None}

    @property
    def scenario(self) -> Scenario:
        """Return the scenario of the world."""
        return self.world.model.scenario

    @property
    def dt(self) -> float:
        """Return the length of a tick, units of time."""
        return self.world.model.dt

    @property
    def size(self) -> int:
        """Return the number of slots of all species."""
        return self.world.model.size

    @property
    def groups(self) -> Mapping[str, Group]:
        """Return the slots of every species, by its name."""
        return self.world.model.groups

    @property
    def open_population(self) -> bool:
        """Return whether agents can be born."""
        return self.world.model.grows

    # ---- the world in arrays -------------------------------------------------------------

    @property
    def state_view(self) -> State:
        """Return a read-only view of everything that changes."""
        return self.world.state.readonly()

    @property
    def seed(self) -> int | None:
        """Return the seed that the world was last reset with, given or drawn; None before the first reset."""
        return self.world.seed

    def reset_arrays(self, seed: int | None = None) -> Tick:
        """Start the world from `seed` and return its first observations.

        Without a seed the first reset draws one from the operating system, and each later reset derives one
        from the last. `env.seed` returns it, and `reset(seed=env.seed)` repeats the episode.
        """
        if seed is not None:
            require(
                isinstance(seed, (int, np.integer)) and seed >= 0,
                f"seed must be a whole number of at least 0, got {seed!r}.",
            )
        seed = _next_seed(self.seed) if seed is None else int(seed)
        tick = self.world.reset(seed)
        if self.timetable is None:
            return tick
        self.timetable.start(seed)
        return self._run_schedule(tick)

    def step_arrays(self, actions: Ints, steering: Floats | None = None) -> Tick:
        """Advance one tick, see `ecology.world.ArrayWorld.step` for the order of things.

        `actions` (N,) holds an index into each slot's own species' actions; entries of dead
        slots are ignored. What the schedule does after the tick is perceived with it: a `ScheduledTick` then.
        `steering` (N, 2) is the speed and the turn rate of bodies that move, see `ecology.steered`; where it is NaN
        they are the action's.
        """
        if steering is not None:
            require(
                isinstance(steering, np.ndarray)
                and steering.shape == (self.size, 2)
                and steering.dtype.kind == "f"
                and not np.isinf(steering).any(),
                f"steering is an array of speeds and turn rates of shape ({self.size}, 2), NaN for none, got "
                f"{steering!r}.",
            )
        tick = self.world.step(actions, steering)
        return tick if self.timetable is None else self._run_schedule(tick)

    def _run_schedule(self, tick: Tick) -> Tick:
        """Return the tick with what the schedule does after it."""
        assert self.timetable is not None
        now = self.world.state.tick
        return tick if self.timetable.next > now else carry_out(self, self.timetable.take(now), tick)

    def find_visible(self, slot: int) -> Ints:
        """Return the slots of the others that the agent in `slot` sees now, (k,); none if its species does not look."""
        return self.world.find_visible(slot)

    def coupling(self, species: str, need: str | None = None) -> tuple[Floats, Ints] | None:
        """Return the weights of empathy w_ij of the n slots of `species` for m slots, (n, m), and those slots, (m,).

        The slots of `species` itself are among the m, and w_ii is an agent's weight for itself. Sum form: the drive is
        sum_j w_ij d_j. Average form: it is d(sum_j w_ij delta_j), need by need, and the weights are those of `need`,
        or of the need that is felt most. Dead slots have no weights. None where the species has no empathy.
        """
        return self.world.coupling(species, need)

    def set_state(self, **fields: Any) -> Tick:
        """Overwrite fields of the state between ticks and return a Tick of what is perceived now.

        `env.set_state(position=..., internal=...)`, each of the field's own shape, for probes. Slots that are no
        longer `alive` have died of the rule; those that are alive again keep their name, or get a new one in a slot
        that was never used. Raises EcologyError, the state being unchanged, for values that no world can reach: places
        outside the arena, needs beyond their bounds (but lethal ones, of which the agent then dies), stocks below 0
        or above their capacity, unknown actions, slots or names.
        """
        return self.world.set_state(**fields)

    def settle(self, species: str, place: tuple[float, float], heading: float = 0.0) -> tuple[Tick, int]:
        """Add an agent at `place` between ticks; return a Tick of what is perceived now, and its slot.

        It has the needs of a newborn and no parent. Where there are no births, a dead agent returns under its name.
        Raises EcologyError where every slot of the species is taken or the place lies outside the arena.
        """
        return self.world.settle(species, place, heading)

    def take_out(self, slots: Ints) -> tuple[Tick, Bodies]:
        """Remove the agents in `slots` (k,), of one species, between ticks; return the Tick and their bodies.

        Their slots are then as if never used. `bring_in` of another world takes the bodies.
        """
        return self.world.take_out(slots)

    def bring_in(self, species: str, bodies: Bodies, rng: np.random.Generator) -> tuple[Tick, Ints]:
        """Add agents that left another world, between ticks; return the Tick and their slots (k,).

        They keep their serial, age, needs and traits, and start where agents of the species start at birth. Worlds that
        exchange agents need serials of their own: `Scenario.numbering`. Raises EcologyError and leaves the world
        unchanged if there are too few free slots or the species differs.
        """
        return self.world.bring_in(species, bodies, rng)

    def breed(self, species: str, parents: Ints, traits: Floats | None, rng: np.random.Generator) -> tuple[Tick, Ints]:
        """Add newborns between ticks, with the serials of their `parents` (k,) and with `traits` (k, T).

        Returns the Tick and their slots (k,). Raises EcologyError if there are too few free slots.
        """
        return self.world.breed(species, parents, traits, rng)

    def reweigh(self, species: str, factor: float) -> Tick:
        """Multiply what `species` feels of others by `factor` from now on, 0 for nothing; return what is perceived now.

        The weights of the average form are shares, which a common factor leaves as they are: there it is 0 or 1.
        Raises EcologyError where the species has no empathy.
        """
        return self.world.reweigh(species, factor)

    def change(self, path: str, value: float) -> Tick:
        """Change a number of the scenario between ticks, such as `prey.birth.rate`; return what is perceived now.

        Raises EcologyError, the world being unchanged, where there is no such number, where the scenario would not be
        valid with it, and where slots, actions or the observation space would be other ones.
        """
        return self.world.change(path, value)

    def snapshot(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the complete state of the world: arrays by name, and plain values that JSON holds.

        A world that is restored from here continues bit for bit as this one does.
        """
        return self.world.snapshot()

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> Tick:
        """Become the world that `snapshot` returned, and return what its agents perceive.

        Raises EcologyError, the world being unchanged, where the snapshot is of another world.
        """
        tick = self.world.restore(arrays, values)
        if self.timetable is not None:
            self.timetable.start(values["seed"], after=self.world.state.tick)
        return tick

    # ---- the PettingZoo border -----------------------------------------------------------

    def name_of(self, slot: int) -> str:
        """Return the name of the agent in `slot`."""
        return self.world.model.name_of(slot, self.world.state.serial)

    @property
    def agents(self) -> list[str]:  # type: ignore[override]
        """Return the names of the living, in the order of their slots; none before a reset and at the horizon."""
        return self._enlist()[0]

    @property
    def _slots(self) -> dict[str, int]:
        """Return the slots of `agents`, by name."""
        return self._enlist()[1]

    def _enlist(self) -> tuple[list[str], dict[str, int], Ints]:
        """Return `agents`, their slots by name and their slots (n,), found again only after a birth or a death."""
        if not self.world.started or self._is_at_horizon():
            return [], {}, np.empty(0, np.int64)
        if self._named[0] != self.world.turnover:
            slots = self.world.model.living(self.world.state)
            self._named = self.world.turnover, list(slots), slots, np.array(list(slots.values()), np.int64)
        return self._named[1:]

    def observation_space(self, agent: str) -> gymnasium.spaces.Dict:
        """Return Dict(observation Box float32 (D,), action_mask Box int8 (A,)), one object for a whole species."""
        return self._spaces[self.species_of(agent)][0]

    def action_space(self, agent: str) -> gymnasium.spaces.Discrete:
        """Return Discrete(A), one object for a whole species."""
        return self._spaces[self.species_of(agent)][1]

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

    def species_of(self, agent: str) -> str:
        """Return the species of an agent, alive or not; EcologyError for a name that no agent can have."""
        species, _, serial = str(agent).rpartition("_")
        founders = getattr(self, "possible_agents", None)
        if species not in self.groups or not serial.isdecimal() or (founders is not None and agent not in founders):
            raise EcologyError(f"there is no agent {agent!r}. {nearest(str(agent), founders or self.agents)}")
        return species

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start a new episode; without a seed, from one that is drawn or derived from the last: see `reset_arrays`."""
        tick = self.reset_arrays(seed)
        names, _, slots = self._enlist()
        return self._observation_dict(tick, names, slots), self._info_dict(tick, names, slots)

    def step(
        self, actions: dict[str, Any], steering: Floats | None = None
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advance one tick; every living agent needs an action, an index into its action space.

        Newborns are in all five dicts on the tick of their birth, except in the horizon's tick, in which they could
        never act; the dead are in them for a last time. After the end, which is the horizon or the death of the last
        agent where none can arrive, no tick passes and the dicts are empty.
        """
        if self._is_over():
            self._read(actions)
            return {}, {}, {}, {}, {}
        names, _, slots = self._enlist()
        array = np.zeros(self.size, np.int64)
        array[slots] = self._read(actions)
        tick = self.step_arrays(array, steering)
        over = self._is_at_horizon()
        if self.open_population and tick.born.any() and not over:
            slots = np.union1d(slots, np.flatnonzero(tick.born))
            names = [self.name_of(slot) for slot in slots.tolist()]
        rewards = dict(zip(names, self._of(slots, tick.reward).tolist(), strict=True))
        terminations = dict(zip(names, (~self._of(slots, tick.alive)).tolist(), strict=True))
        truncations = dict.fromkeys(names, over)
        observations, infos = self._observation_dict(tick, names, slots), self._info_dict(tick, names, slots)
        return observations, rewards, terminations, truncations, infos

    def _is_at_horizon(self) -> bool:
        return self.horizon is not None and self.world.state.tick >= self.horizon

    def _is_over(self) -> bool:
        """Return whether no agent acts, now or later."""
        empty = not self.world.state.alive.any() and not any(s.arrival for s in self.scenario.species)
        return not self.agents and (self._is_at_horizon() or empty)

    def _read(self, actions: Any) -> np.ndarray:
        """Return the actions of `self.agents` (n,) from a dict, or raise EcologyError."""
        require(isinstance(actions, Mapping), f"actions are a dict, name to action, got {actions!r}.")
        names, slots, _ = self._enlist()
        if not slots.keys() <= actions.keys():
            missing = [name for name in names if name not in actions]
            raise EcologyError(f"every living agent needs an action; missing: {', '.join(missing[:5])}.")
        for name in actions if len(actions) > len(names) else ():
            if name not in slots:
                self.species_of(name)
                raise EcologyError(f"the life of {name!r} is over, it cannot act; act for `env.agents` only.")
        wanted = list(map(actions.__getitem__, names))
        if not all(issubclass(kind, (int, np.integer)) and kind is not bool for kind in set(map(type, wanted))):
            for name, action in zip(names, wanted, strict=True):
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
        found: dict[str, Any] = {}
        for group, part, rows in self._parts(slots):
            zeta, mask = tick.observations[group.name], tick.masks[group.name]  # the world decides by the masks
            zeta, mask = (zeta, mask.copy()) if len(rows) == len(zeta) else (zeta[rows], mask[rows])
            shown = zip(names[part], zeta, mask.view(np.int8), strict=True)
            found |= {name: {"observation": one, "action_mask": open_} for name, one, open_ in shown}
        return found

    def _info_dict(self, tick: Tick, names: list[str], slots: Ints) -> dict[str, dict[str, Any]]:
        drive, closed = self._of(slots, tick.drive).tolist(), self._of(slots, tick.closed).tolist()
        return {name: {"drive": d, "closed": shut} for name, d, shut in zip(names, drive, closed, strict=True)}

    def _of(self, slots: Ints, array: np.ndarray) -> np.ndarray:
        """Return the rows of the ordered `slots` of an `array` (N, ...), which is not copied if they are all."""
        return array if len(slots) == self.size else array[slots]

    def _parts(self, slots: Ints) -> Iterator[tuple[Group, slice, Ints]]:
        """Yield each group with the part of the ordered `slots` that is its own, and their rows in it."""
        for group in self.groups.values():
            start, stop = np.searchsorted(slots, (group.slots.start, group.slots.stop))
            yield group, slice(int(start), int(stop)), slots[start:stop] - group.slots.start

    def state(self) -> np.ndarray:
        """Return a global view for centralised training, float32: position, heading, x and alive of every slot."""
        now, has_need = self.world.state, self.world.model.has_need
        return np.concatenate(
            [now.position.ravel(), now.heading, now.internal[has_need], now.alive.astype(float)]
        ).astype(np.float32)

    @functools.cached_property
    def state_space(self) -> gymnasium.spaces.Box:
        """Return the Box of `state()`; the x of a slot is 0 before its first agent."""
        (left, bottom), (right, top) = self.scenario.arena.extent
        body, own, ones = self.world.model.body, self.world.model.has_need, np.ones(self.size)
        low = [np.tile([left, bottom], self.size), -np.pi * ones, np.minimum(body.low, 0.0)[own], 0 * ones]
        high = [np.tile([right, top], self.size), np.pi * ones, np.maximum(body.high, 0.0)[own], ones]
        return gymnasium.spaces.Box(
            float32_below(np.concatenate(low)), -float32_below(-np.concatenate(high)), dtype=np.float32
        )

    def render(self) -> np.ndarray | None:
        """Return a picture of the world, uint8 (height, width, 3), for "rgb_array"; show it in a window for "human"."""
        if self.render_mode is None:
            return None
        from ecology.observers.picture import Picture, frame  # loads the plotting library

        if self._picture is None:
            self._picture = Picture(self.scenario)
        picture = self._picture.draw(frame(self.scenario, self.world.state.readonly(), self.world.model))
        if self.render_mode != "human":
            return picture
        if self._window is None:
            from ecology.observers.window import Window

            self._window = Window(self.scenario.name)
        self._window.show(picture)
        return None

    def close(self) -> None:
        """Close the window of render_mode "human"."""
        if self._window is not None:
            self._window.close()
            self._window = None


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
