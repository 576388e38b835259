"""What a run comes to: running sums over its ticks."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, EcologyError, Scenario, State, Tick
from ecology.agents import checkpoint
from ecology.agents.base import Learner
from ecology.observers.base import Mind
from ecology.spec import Species
from ecology.state import CAUSES

BLOCKS = 2**16  # in which the ticks of a run are summed up: one tick each, then two, four, ...


class RunSummary:
    """Running sums over a run, an observer: what summary.json says.

    What is asked of a stretch of ticks is summed in blocks. Up to `BLOCKS` ticks a block is one tick; when the blocks
    are full, two become one, so that a life of any length takes the same memory.
    """

    def __init__(
        self, scenario: Scenario, env: Ecology, learners: Mapping[str, Learner], *, every: int = 1, last: int = 0
    ) -> None:
        """Sum up `env`; the scenario's measures are taken every `every` ticks, and at the tick `last`."""
        self._scenario, self._groups, self._learners = scenario, env.groups, learners
        self._every, self._last, self._env = every, last, env
        self._feels = any(species.empathy is not None for species in scenario.species)
        needs = max(len(s.needs) for s in scenario.species)
        self._set_point = np.zeros((env.size, needs))
        for s, group in zip(scenario.species, env.groups.values(), strict=True):
            self._set_point[group.slots, : len(s.needs)] = [need.set_point for need in s.needs]
        self._row = np.arange(env.size)
        self.tick = 0
        self._seconds = np.zeros(3)  # as `seconds`, before it last began
        self._began: np.ndarray | None = None
        self.births = np.zeros(len(env.groups), np.int64)  # by species
        self.closed = 0  # actions asked for that were closed
        self.returned = 0  # times that the arena put a body back inside
        self.span = 1  # ticks of a block
        self.drive = np.zeros((BLOCKS, len(env.groups)))  # per block and species, summed over the living
        self.own_drive = self.drive.copy()  # the same, without what is felt of others
        self.living = np.zeros((BLOCKS, len(env.groups)), np.int64)  # per block and species, summed over its ticks
        now = [np.count_nonzero(env.state_view.alive[group.slots]) for group in env.groups.values()]
        self.now, self.least, self.most = np.array(now), np.array(now), np.array(now)  # living, per species
        self.gone = np.zeros(len(env.groups), np.int64)  # tick at which the last of a species died, 0 while it lives
        self.causes = np.zeros((len(env.groups), len(CAUSES)), np.int64)  # deaths by species and cause
        self.fatal = np.zeros((len(env.groups), needs), np.int64)  # deaths by species and the lethal need
        self.killed = np.zeros((len(env.groups), len(env.groups)), np.int64)  # deaths by species and the killer's
        self._species_of = np.repeat(np.arange(len(env.groups)), [group.size for group in env.groups.values()])
        self.delta = np.zeros((env.size, needs))  # |delta| per slot, summed over its ticks alive
        self.lived = np.zeros(env.size, np.int64)  # ticks alive per slot
        measures = len(scenario.measures)
        self.measured = np.full(measures, np.nan)  # when they were last taken
        self.measured_sum, self.measured_count = np.zeros(measures), np.zeros(measures, np.int64)  # of finite ones
        self.measured_least, self.measured_most = self.measured.copy(), self.measured.copy()
        self.actions = np.zeros((env.size, max(len(g.actions) for g in env.groups.values())), np.int64)

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Start the clock."""
        self._began = self._clocks()

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Add one tick."""
        at, alive = state.tick - 1, tick.alive
        now = np.array([np.count_nonzero(alive[group.slots]) for group in self._groups.values()])
        self.gone[(self.now > 0) & (now == 0)] = state.tick
        self.gone[now > 0] = 0  # newcomers bring a species back
        self.now[:] = now
        if at == 0:
            self.least[:] = self.most[:] = self.now
        np.minimum(self.least, self.now, out=self.least)
        np.maximum(self.most, self.now, out=self.most)
        if at == BLOCKS * self.span:
            self._fold()
        drive = self._by_species(tick.drive, alive)
        self.drive[at // self.span] += drive
        self.own_drive[at // self.span] += self._by_species(state.own_drive, alive) if self._feels else drive
        self.living[at // self.span] += self.now
        self.tick = state.tick
        set_point = self._set_point if state.set_point is None else state.set_point
        self.delta += np.abs(state.internal - set_point) * alive[:, None]
        self.lived += alive
        self.actions[self._row, tick.action] += alive
        if tick.died.any():
            for i, group in enumerate(self._groups.values()):
                causes = state.cause[group.slots][tick.died[group.slots]]
                self.causes[i] += np.bincount(causes, minlength=len(CAUSES))
            died = np.flatnonzero(tick.died)
            of_need, bitten = died[state.fatal_need[died] >= 0], died[tick.killer[died] >= 0]
            np.add.at(self.fatal, (self._species_of[of_need], state.fatal_need[of_need]), 1)
            np.add.at(self.killed, (self._species_of[bitten], self._species_of[tick.killer[bitten]]), 1)
        if tick.born.any():
            self.births += [np.count_nonzero(tick.born[group.slots]) for group in self._groups.values()]
        self.closed, self.returned = int(state.closed.sum()), state.returned
        if self.measured.size and (state.tick % self._every == 0 or state.tick == self._last):
            self._measure(state)

    def _by_species(self, values: np.ndarray, alive: np.ndarray) -> list[float]:
        """Return values (N,) summed over the living of each species."""
        return [values[group.slots] @ alive[group.slots] for group in self._groups.values()]

    def _measure(self, state: State) -> None:
        """Take the scenario's measures; one at the last tick that is no sample is kept, and not summed up."""
        self.measured[:] = self._scenario.measure(state)
        if state.tick % self._every:
            return
        finite = np.isfinite(self.measured)
        self.measured_sum += np.where(finite, self.measured, 0.0)
        self.measured_count += finite
        known = np.where(finite, self.measured, np.nan)
        np.fmin(self.measured_least, known, out=self.measured_least)
        np.fmax(self.measured_most, known, out=self.measured_most)

    def _fold(self) -> None:
        """Make one block of two, and room for as many again."""
        for blocks in (self.drive, self.own_drive, self.living):
            half = BLOCKS // 2
            blocks[:half] = blocks[::2] + blocks[1::2]
            blocks[half:] = 0
        self.span *= 2

    @property
    def _used(self) -> int:
        """Return the number of blocks that have begun."""
        return -(-self.tick // self.span)

    def end(self) -> None:
        """Stop the clock."""
        self._seconds, self._began = self.seconds, None

    @property
    def seconds(self) -> np.ndarray:
        """Return the time of the run so far: by the wall, of the CPU, and of the CPU for acting and learning."""
        return self._seconds + (0.0 if self._began is None else self._clocks() - self._began)

    def _clocks(self) -> np.ndarray:
        learners = sum(learner.seconds for learner in self._learners.values())
        return np.array([time.perf_counter(), time.process_time(), learners])

    def mean_drive(self, start: int = 0, *, own: bool = False, species: int | None = None) -> float | None:
        """Return the drive of the living, averaged over agents and ticks from `start` on.

        `own` leaves out what is felt of others; `species` is the number of one, all are meant without. A block in
        which `start` lies counts with the share of its ticks from there on.
        """
        if start >= self.tick:
            return None
        first, into = divmod(start, self.span)
        share = np.ones(self._used - first)
        share[0] -= into / min(self.span, self.tick - first * self.span)
        which = slice(None) if species is None else slice(species, species + 1)
        drive, living = (
            blocks[first : self._used, which].sum(axis=1)
            for blocks in (self.own_drive if own else self.drive, self.living)
        )
        return _share(float(share @ drive), float(share @ living))

    def drives(self, species: str) -> tuple[np.ndarray, int]:
        """Return the mean drive of the living of a species per block, NaN without any, and the ticks of a block."""
        at = list(self._groups).index(species)
        living = self.living[: self._used, at]
        total = self.drive[: self._used, at]
        return np.divide(total, living, out=np.full(len(living), np.nan), where=living > 0), self.span

    def summary(self) -> dict[str, Any]:
        """Return the results of the run so far."""
        lived_by = self.living.sum(axis=0)  # per species
        wall, cpu, learner = self.seconds
        tenth = self.tick - max(1, self.tick // 10)
        needs, shares = {}, {}
        population: dict[str, dict[str, Any]] = {}
        for i, (species, group) in enumerate(zip(self._scenario.species, self._groups.values(), strict=True)):
            population[species.name] = {
                "end": int(self.now[i]),
                "mean": float(lived_by[i] / self.tick if self.tick else self.now[i]),
                "least": int(self.least[i]),
                "most": int(self.most[i]),
                "died_out": int(self.gone[i]) or None,
                "died_of": {cause: int(n) for cause, n in zip(CAUSES, self.causes[i], strict=True) if n},
                "fatal_needs": {need.name: int(n) for need, n in zip(species.needs, self.fatal[i], strict=False) if n},
                "killed_by": {name: int(n) for name, n in zip(self._groups, self.killed[i], strict=True) if n},
            }
            if species.traits:
                population[species.name]["traits"] = self._traits(species, group.slots)
            lived = self.lived[group.slots].sum()
            delta = self.delta[group.slots].sum(axis=0)
            needs[species.name] = {n.name: _share(delta[i], lived) for i, n in enumerate(species.needs)}
            counts = self.actions[group.slots].sum(axis=0)
            shares[species.name] = {a: _share(counts[i], lived) for i, a in enumerate(group.actions)}
        return {
            "wall_seconds": round(wall, 3),
            "cpu_seconds": round(cpu, 3),
            "learner_cpu_seconds": round(learner, 3),
            "agent_steps_per_second": _share(int(lived_by.sum()), wall),
            "mean_drive": self.mean_drive(),
            "mean_drive_last_tenth": self.mean_drive(tenth) if self.tick else None,
            "mean_own_drive": self.mean_drive(own=True),
            "mean_own_drive_last_tenth": self.mean_drive(tenth, own=True) if self.tick else None,
            "species_drive": {name: self.mean_drive(species=i) for i, name in enumerate(self._groups)},
            "species_own_drive": {name: self.mean_drive(own=True, species=i) for i, name in enumerate(self._groups)},
            "mean_abs_deviation": needs,
            "action_shares": shares,
            "population": population,
            "deaths": int(self.causes.sum()),
            "births": int(self.births.sum()),
            "closed_actions": self.closed,
            "bodies_put_back": self.returned,
            "measures": {
                name: {
                    "end": float(self.measured[i]),
                    "mean": _share(self.measured_sum[i], self.measured_count[i]),
                    "least": float(self.measured_least[i]),
                    "most": float(self.measured_most[i]),
                }
                for i, name in enumerate(self._scenario.measures)
            },
        }

    def _traits(self, species: Species, rows: slice) -> dict[str, dict[str, float | None]]:
        """Return mean and standard deviation of the traits of a species as they are now; None if no agent is alive."""
        state = self._env.state_view
        assert state.trait is not None
        living = state.trait[rows][state.alive[rows]]
        return {
            trait.name: {
                "mean": float(living[:, t].mean()) if len(living) else None,
                "sd": float(living[:, t].std()) if len(living) else None,
            }
            for t, trait in enumerate(species.traits)
        }

    BLOCKED = ("drive", "own_drive", "living")  # of which only the blocks that have begun are kept
    ARRAYS = (
        *BLOCKED, "now", "least", "most", "gone", "births", "causes", "fatal", "killed", "delta", "lived", "actions",
        "measured", "measured_sum", "measured_count", "measured_least", "measured_most",
    )  # fmt: skip
    VALUES = ("tick", "span", "closed", "returned")

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the sums: arrays, and plain values."""
        arrays = {name: getattr(self, name) for name in self.ARRAYS}
        arrays |= {name: arrays[name][: self._used] for name in self.BLOCKED}
        return arrays, {"seconds": self.seconds.tolist()} | {name: getattr(self, name) for name in self.VALUES}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Become what `state` returned, which has only the blocks that have begun.

        Raises EcologyError, nothing being changed, where it does not fit.
        """
        for name in self.VALUES:
            if type(values[name]) is not int or values[name] < 0:
                raise EcologyError(f"{name} is a whole number of at least 0, got {values[name]!r}.")
        tick, span = values["tick"], values["span"]
        if span < 1 or span & (span - 1) or tick > BLOCKS * span:
            raise EcologyError(f"{tick} ticks are not summed in blocks of {span}.")
        seconds = np.array(values["seconds"], float)
        if seconds.shape != (3,) or not (np.isfinite(seconds) & (seconds >= 0)).all():
            raise EcologyError(f"seconds are three numbers of at least 0, got {values['seconds']!r}.")
        most = 2 * self._env.size * max(tick, 1)  # of anything that is counted, in and between ticks
        if values["closed"] > most:
            raise EcologyError(f"{values['closed']!r} closed actions were not asked for in {tick} ticks.")
        positive = {"own_drive", "delta"} if self._feels else {"drive", "own_drive", "delta"}
        for name in self.ARRAYS:
            mine = getattr(self, name)
            like = mine[: -(-tick // span)] if name in self.BLOCKED else mine
            known = not name.startswith("measured") or name == "measured_count"  # a measure may be anything
            counts = mine.dtype.kind == "i"
            low, below = 0 if counts or name in positive else None, 1 + most if counts else None
            checkpoint.check_array(name, arrays[name], like, finite=known, low=low, below=below)
        for name in self.ARRAYS:
            mine = getattr(self, name)
            mine[: len(arrays[name])], mine[len(arrays[name]) :] = arrays[name], 0
        for name in self.VALUES:
            setattr(self, name, values[name])
        self._seconds = seconds


def _share(part: float, whole: float) -> float | None:
    """Return part / whole, None of nothing (JSON has no NaN)."""
    return float(part / whole) if whole > 0 and np.isfinite(part) else None
