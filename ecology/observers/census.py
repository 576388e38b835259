"""What happens in a world and how its populations stand, read off one tick after another."""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ecology.decision import Decision
from ecology.env import Ecology
from ecology.ground import plane_of
from ecology.model import Group
from ecology.observers.focus_requests import AGENTS, Click
from ecology.scenario import Scenario
from ecology.spec import Species, require
from ecology.state import CAUSES, Floats, Ints, State
from ecology.world import Tick

KINDS = ("born", "died", "bit", "gave", "ate", "slept")
EATS, SLEEPS = 1, 2  # codes of actions that are told of when they begin
DEATHS = {  # by cause
    "need": "died of {need}, beyond its bounds",
    "eaten": "died, eaten by {killer}",
    "hazard": "died by chance, its hazard",
    "rule": "died by the scenario's rule",
    "bitten": "died of {need}, bitten to death by {killer}",
}
AGES = 12  # bars of an age structure
HUNGRIEST = "hungriest"


@dataclass(frozen=True)
class Happening:
    """k events of one kind in one tick; names are `species` and `serial`, since slots are used again."""

    kind: str
    tick: int
    slot: Ints  # (k,) agent to which it happened, or that did it
    serial: Ints  # (k,)
    place: Floats  # (k, 2)
    other: Ints  # (k,) slot of the parent, the killer, the bitten or the one given to, -1 without
    other_serial: Ints  # (k,)
    other_place: Floats  # (k, 2) where the other is, across the seam of a torus; one's own place without
    what: Ints  # (k,) index of the action, or into CAUSES of a death
    need: Ints  # (k,) column of the lethal need of a death, -1 without
    second: Ints  # (k,) serial of the second parent of a birth, -1 without


class Census:
    """Finds what happened in each tick, and counts births and deaths since it began."""

    def __init__(self, env: Ecology, before: tuple[Sequence[int], Sequence[int]] | None = None) -> None:
        """Look at `env` as it is; `before`: births and deaths so far, by species."""
        state, groups = env.state_view, tuple(env.groups.values())
        self._groups = groups
        self._plane = plane_of(env.scenario.arena)
        code = {"consume": EATS, "sleep": SLEEPS}
        self._code = np.zeros((len(groups), max(len(g.kinds) for g in groups)), np.int8)
        for g in groups:
            self._code[g.index, : len(g.kinds)] = [code.get(kind, 0) for kind in g.kinds]
        self._species_of = np.repeat([g.index for g in groups], [g.size for g in groups])
        self._action, self._gave, self._serial = state.action.copy(), state.gave, state.serial
        self._known = state.alive & (state.tick > 0)  # whose action of the last tick is known
        self.born, self.died = np.array(before or np.zeros((2, len(groups))), np.int64)

    def watch(self, state: State, tick: Tick, only: Ints | None = None) -> list[Happening]:
        """Return what happened in the tick that led to `state`; meals and sleeps of the slots `only` (k,), or all."""
        found = []

        def tell(kind: str, slot: Ints, other: Ints | None = None, what: Ints | None = None) -> None:
            if not slot.size:
                return
            with_ = np.full(len(slot), -1) if other is None else other[slot]
            has_other = with_ >= 0
            found.append(
                Happening(
                    kind=kind,
                    tick=state.tick,
                    slot=slot,
                    serial=state.serial[slot],
                    place=state.position[slot],
                    other=with_,
                    other_serial=np.where(has_other, state.serial[with_], -1),
                    other_place=state.position[slot]
                    + np.where(has_other[:, None], self._plane.gap(state.position[slot], state.position[with_]), 0.0),
                    what=np.zeros(len(slot), np.int64) if what is None else what[slot],
                    need=state.fatal_need[slot],
                    second=np.full(len(slot), -1) if state.second is None else state.second[slot],
                )
            )

        def begun(slot: Ints, now: Ints, before: Ints) -> Ints:
            same = (state.serial[slot] == self._serial[slot]) & self._known[slot] & (now[slot] == before[slot])
            return slot[~same]

        for kind, who, other, what, count in (
            ("born", tick.born, tick.parent, None, self.born),
            ("died", tick.died, tick.killer, state.cause, self.died),
        ):
            slot = np.flatnonzero(who)
            tell(kind, slot, other, what)
            if slot.size:
                count += np.bincount(self._species_of[slot], minlength=len(count))
        tell("bit", np.flatnonzero(state.bit >= 0), state.bit)
        tell("gave", begun(np.flatnonzero(state.gave >= 0), state.gave, self._gave), state.gave)
        acts = np.flatnonzero(tick.alive & ~tick.born) if only is None else only[tick.alive[only] & ~tick.born[only]]
        acts = begun(acts, tick.action, self._action)
        code = self._code[self._species_of[acts], tick.action[acts]]
        tell("ate", acts[code == EATS], None, tick.action)
        tell("slept", acts[code == SLEEPS], None, tick.action)
        self._action, self._gave, self._serial = tick.action, state.gave, state.serial
        self._known = tick.alive & ~tick.born
        return found


def words(scenario: Scenario, groups: Sequence[Group], event: Happening, i: int) -> str:
    """Return the event `i` of a happening as a sentence: "predator_7 bit prey_21"."""

    def name(slot: int, serial: int) -> str:
        return f"{next(g.name for g in groups if g.slots.start <= slot < g.slots.stop)}_{serial}"

    slot = int(event.slot[i])
    group = next(g for g in groups if g.slots.start <= slot < g.slots.stop)
    who = name(slot, int(event.serial[i]))
    other = name(int(event.other[i]), int(event.other_serial[i])) if event.other[i] >= 0 else ""
    mate = f" and {group.name}_{int(event.second[i])}" if event.second[i] >= 0 else ""
    action = scenario.species[group.index].actions[int(event.what[i])] if event.kind in ("ate", "slept") else None
    need = scenario.species[group.index].needs[int(event.need[i])].name
    return {
        "born": f"{who} born, child of {other}{mate}" if other else f"{who} arrived",
        "died": f"{who} {DEATHS[CAUSES[int(event.what[i])]].format(need=need, killer=other)}"
        if event.kind == "died"
        else "",
        "bit": f"{who} bit {other}",
        "gave": f"{who} gave to {other}",
        "ate": f"{who} ate {action.resource}" if action is not None else "",
        "slept": f"{who} slept",
    }[event.kind]


# ---- populations -----------------------------------------------------------------------------


def ages(age: Floats) -> tuple[Floats, Floats]:
    """Return the age structure of the living, of `age` (k,): the middle of each class and its number (AGES,)."""
    oldest = max(float(age.max(initial=0.0)), 1.0)
    number, edges = np.histogram(age, AGES, (0.0, oldest))
    return (edges[1:] + edges[:-1]) / 2, number.astype(float)


def stocks(scenario: Scenario, state: State) -> Floats:
    """Return the stock of every finite resource over all its patches, (K,), in the order of the scenario."""
    ends = np.cumsum([r.count for r in scenario.resources])
    total = [state.stock[end - r.count : end].sum() for r, end in zip(scenario.resources, ends, strict=True)]
    return np.array([t for t, r in zip(total, scenario.resources, strict=True) if np.isfinite(r.stock)])


def plotted_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of what is plotted of the world as a whole: the scenario's measures, then its cues."""
    traits = (f"mean {trait.name} of {s.name}" for s in scenario.species for trait in s.traits)
    return (*scenario.measures, *(cue.name for cue in scenario.cues), *traits)


def measure_world(scenario: Scenario, state: State) -> Floats:
    """Return what is plotted of the world as a whole, in the order of `plotted_names`."""
    return np.array([*scenario.measure(state), *(() if state.cue is None else state.cue), *_means(scenario, state)])


def _means(scenario: Scenario, state: State) -> list[float]:
    """Return the mean of every trait over the living of its species, NaN if there are none."""
    found, start = [], 0
    for s in scenario.species:
        rows = slice(start, start + s.slots)
        start = rows.stop
        found += [
            mean(state.trait[rows, t][state.alive[rows]]) for t in range(len(s.traits)) if state.trait is not None
        ]
    return found


def histograms(scenario: Scenario, state: State) -> dict[str, tuple[Floats, Floats]]:
    """Return the distribution of every trait, "SPECIES/TRAIT", over the living: middles of its classes and numbers."""
    found, start = {}, 0
    for s in scenario.species:
        rows = slice(start, start + s.slots)
        start = rows.stop
        for t, trait in enumerate(s.traits):
            assert state.trait is not None
            number, edges = np.histogram(state.trait[rows, t][state.alive[rows]], AGES, trait.bounds)
            found[f"{s.name}/{trait.name}"] = (edges[1:] + edges[:-1]) / 2, number.astype(float)
    return found


def moving(species: Species) -> list[str]:
    """Return under which name each set point of a species that moves is recorded, "" where it stays."""
    return [f"{need.name}_set_point" if need.set_range is not None else "" for need in species.needs]


def mean(value: Floats) -> float:
    """Return the mean of what is finite of `value` (k,), NaN of nothing."""
    value = value[np.isfinite(value)]
    return float(value.mean()) if value.size else np.nan


# ---- the agent in focus ------------------------------------------------------------------------


@dataclass(frozen=True)
class Choice:
    """The decision of the agent in focus, as it stands after a tick."""

    tick: int
    name: str
    decision: Decision
    plan: tuple[str, ...] = ()  # the best that it sees ahead, where that was asked for
    last: str = ""  # the option before, whose forecast is compared with what came
    came: Sequence[tuple[str, float, float]] = ()  # by component: its name, what f forecast, and what came


@dataclass
class FocusSamples:
    """The data of n samples about the agent in focus; a series breaks where it is NaN."""

    tick: Ints  # (n,)
    internal: Floats  # (n, needs) x
    drive: Floats  # (n,)
    own: Floats | None  # (n,) drive of its own needs, None where its species feels nothing of others
    mean: Floats | None  # (n,) drive of its species
    reward: Floats | None  # (n,)
    action: Ints  # (n,)
    place: Floats  # (n, 2)
    set_point: Floats  # (n, needs) x*, or (needs,) where it stays
    names: Sequence[str]  # n
    field: Sequence[Floats]  # n outlines (k, 2) of the view field
    sight: Sequence[Floats]  # n times (k, 2), where lines of sight end

    @property
    def target(self) -> Floats:
        """Return x* of every sample, (n, needs)."""
        return np.broadcast_to(self.set_point, self.internal.shape)


@dataclass
class Focus:
    """The agent in focus of every species: its slot, -1 while no agent of the species is alive.

    When it dies, the oldest of its species takes its place; with "hungriest", whoever then has the
    largest drive, which is also looked for now and then.
    """

    groups: Sequence[Group]
    wanted: dict[str, int] = field(default_factory=dict)  # species -> serial
    first: str | None = None  # species that is shown first
    hungriest: bool = False
    slots: dict[str, int] = field(default_factory=dict)
    serials: dict[str, int] = field(default_factory=dict)

    @classmethod
    def of(cls, env: Ecology, asked: Sequence[str]) -> Focus:
        """Return the focus that was `asked` for: names of agents, of species, or "hungriest".

        Raises EcologyError for a name that nobody can have.
        """
        focus = cls(tuple(env.groups.values()))
        for word in asked:
            species, serial = focus._who(env, word)
            focus.hungriest |= species is None
            if species is not None and serial is not None:
                focus.wanted[species] = serial
            focus.first = focus.first or species
        return focus

    def turn(self, env: Ecology, word: str) -> None:
        """Request another focus in a running world; `look` then finds the agent.

        Raises EcologyError where nobody of that name lives, and asks for nobody.
        """
        species, serial = self._who(env, word)
        if species is None:
            self.hungriest = True
            self.wanted.clear()
            return
        if serial is not None:
            state, rows = env.state_view, env.groups[species].slots
            require(
                bool((state.alive[rows] & (state.serial[rows] == serial)).any()),
                f"focus: no {word} lives at tick {state.tick}; give the name of one that does, as the viewer and the "
                "event log show them.",
            )
            self.wanted[species] = serial
        self.first = species

    def name_clicked(self, env: Ecology, click: Click) -> str | None:
        """Return the name of whom a click means; None where it means no agent, or one that lives no more."""
        state = env.state_view
        for group in self.groups:
            if click.entity == f"{AGENTS}/{group.name}" and click.row < group.size:
                slot = group.slots.start + click.row
                born = state.tick - state.age[slot] / env.dt  # another may have had the slot before
                if state.alive[slot] and (click.tick is None or click.tick > born - 0.5):
                    return env.name_of(slot)
        return None

    def _who(self, env: Ecology, word: str) -> tuple[str | None, int | None]:
        """Return the species and the serial that `word` means: no serial of a species, neither of "hungriest"."""
        if word == HUNGRIEST:
            return None, None
        if word in env.groups:
            return word, None
        species, _, serial = word.rpartition("_")
        known = species in env.groups and serial.isdecimal()
        if known and not env.open_population:
            known = word in env.possible_agents
        require(
            known,
            f"focus: there is no agent {word!r}; give the name of an agent (as "
            f"{env.name_of(0) if env.state_view.serial[0] >= 0 else next(iter(env.groups)) + '_0'}), "
            f"a species ({', '.join(env.groups)}) or {HUNGRIEST!r}.",
        )
        return species, int(serial)

    def look(self, state: State, *, anew: bool = False) -> list[str]:
        """Find the agents in focus, `anew` also where they are alive; return the species whose focus has changed."""
        changed = []
        for group in self.groups:
            rows = group.slots
            slot, serial = self.slots.get(group.name, -1), self.serials.get(group.name, -1)
            alive = state.alive[rows]
            wanted = self.wanted.get(group.name)
            if wanted is not None and wanted != serial:
                matches = np.flatnonzero(alive & (state.serial[rows] == wanted))
                if matches.size:
                    slot, serial = rows.start + int(matches[0]), wanted
            lives = slot >= 0 and state.alive[slot] and state.serial[slot] == serial
            if not lives or (anew and self.hungriest and serial != wanted):
                slot = -1
                if alive.any():
                    rank = state.own_drive[rows] if self.hungriest else state.age[rows]
                    slot = rows.start + int(np.argmax(np.where(alive, rank, -np.inf)))
            serial = int(state.serial[slot]) if slot >= 0 else -1
            if serial != self.serials.get(group.name, -2):
                changed.append(group.name)
            self.slots[group.name], self.serials[group.name] = slot, serial
        return changed

    def name(self, species: str) -> str:
        """Return the name of the agent in focus."""
        serial = self.serials.get(species, -1)
        return f"{species}_{serial}" if serial >= 0 else f"no {species}"


class Expectations:
    """What the agent in focus felt at every tick, and what it had expected: J against what then happened."""

    def __init__(self) -> None:
        self._serial, self._tick = -1, -1  # of the last drive
        self._drive: deque[float] = deque()  # of the ticks since the oldest expectation
        self._expected: deque[int] = deque()  # ticks

    def follow(self, serial: int, tick: int, drive: float) -> None:
        """Add the drive of a tick, once even if the tick is shown again; start over with another life."""
        if serial == self._serial and tick == self._tick:
            return
        self._tick = tick
        if serial != self._serial:
            self._serial = serial
            self._drive.clear()
            self._expected.clear()
        if self._expected:
            self._drive.append(float(drive))

    def judge(self, tick: int, gamma: float, dt: float) -> list[tuple[int, float]]:
        """Record J at `tick`; return (tick, discounted drive afterwards) of records that are old enough."""
        met = []
        self._expected.append(tick)
        span = math.ceil(math.log(0.05) / math.log(gamma) / dt)  # ticks: what is later weighs 5 %
        while tick - self._expected[0] >= span:
            began = self._expected.popleft()
            met.append((began, afterwards(np.array(self._drive)[:span], gamma, dt)))
            for _ in range(self._expected[0] - began):
                self._drive.popleft()
        return met


def afterwards(drive: Floats, gamma: float, dt: float) -> float:
    """Return the discounted mean of the drives (T,) that followed, what -ln(gamma) J predicts.

    The average of d(t + k dt) with the weights gamma^(k dt), cut off after T ticks.
    """
    weight = gamma ** (dt * np.arange(1, len(drive) + 1))
    return float(weight @ drive / weight.sum())


def without_functions(scenario: Scenario) -> Scenario:
    """Return the scenario as plain data, which can be sent to another process."""
    return dataclasses.replace(scenario, rule=None, measures={}, props=None)
