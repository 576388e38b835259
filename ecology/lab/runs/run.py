"""A run: its life, what it came to, and the folder that it leaves."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from ecology import Ecology, EcologyError, Scenario, State, Tick, agents, faults
from ecology.agents import checkpoint, loop
from ecology.agents.base import DivergedError, Learner
from ecology.errors import writable
from ecology.interventions import intervene
from ecology.lab.runs import source
from ecology.lab.runs.folder import (
    CHECKPOINT,
    CONFIG,
    KEPT,
    SUMMARY,
    WRITES,
    replace_text,
    write_json,
)
from ecology.lab.runs.interventions import Schedule
from ecology.lab.runs.run_config import Choice, Plan, read_config, resolve, words_of, world_digest
from ecology.lab.runs.stopping import Interrupt, StoppedError
from ecology.observers.base import Mind, Observer
from ecology.observers.control import Control
from ecology.observers.mailbox import Mailbox
from ecology.schedule import ScheduledTick
from ecology.state import CAUSES
from ecology.verbs import split

BLOCKS = 2**16  # in which the ticks of a run are summed up: one tick each, then two, four, ...
DO = "do"  # kind of the requests of `ecology do`
LOOK = 0.1  # seconds between two looks for requests of other processes
LEARNER_STREAM = 1_000  # first word of the learners' spawn keys, beyond those of the world's concerns


# ---- what a run came to ----------------------------------------------------------------------


class Tally:
    """Running sums over a run, an observer: what summary.json says.

    What is asked of a stretch of ticks is summed in blocks. Up to `BLOCKS` ticks a block is one tick; when the blocks
    are full, two become one, so that a life of any length takes the same memory.
    """

    def __init__(
        self, scenario: Scenario, env: Ecology, learners: Mapping[str, Learner], *, every: int = 1, last: int = 0
    ) -> None:
        """Sum up `env`; the scenario's measures are taken every `every` ticks, and at the tick `last`."""
        self._scenario, self._groups, self._learners = scenario, env.groups, learners
        self._every, self._last = every, last
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
        self.delta += np.abs(state.internal - self._set_point) * alive[:, None]
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
        self.measured[:] = self._scenario.measured(state)
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
        """Return the mean drive of the living of a species per block, NaN of nobody, and the ticks of a block."""
        at = list(self._groups).index(species)
        living = self.living[: self._used, at]
        total = self.drive[: self._used, at]
        return np.divide(total, living, out=np.full(len(living), np.nan), where=living > 0), self.span

    def summary(self) -> dict[str, Any]:
        """Return what the run has come to."""
        lived_by = self.living.sum(axis=0)  # per species
        wall, cpu, learner = self.seconds
        tenth = self.tick - max(1, self.tick // 10)
        needs, shares, population = {}, {}, {}
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
        """Become what `state` returned, which has only the blocks that have begun."""
        for name in self.ARRAYS:
            mine = getattr(self, name)
            mine[: len(arrays[name])], mine[len(arrays[name]) :] = arrays[name], 0
        for name in self.VALUES:
            setattr(self, name, values[name])
        self._seconds = np.array(values["seconds"])


def _share(part: float, whole: float) -> float | None:
    """Return part / whole, None of nothing (JSON has no NaN)."""
    return float(part / whole) if whole > 0 and np.isfinite(part) else None


# ---- the run ---------------------------------------------------------------------------------


class Run:
    """A world with its learners and the folder that the run leaves.

    Building one checks everything and writes nothing; then `start` or `resume`, then `live`.
    """

    def __init__(self, plan: Plan, folder: Path) -> None:
        from ecology.observers import recorder  # slow to load

        self.plan, self.folder = plan, folder
        self.scenario = plan.load()
        with _room(f"a world of {sum(s.count for s in self.scenario.species)} agents"):
            self.env = Ecology(self.scenario)
        self.learners = {}
        for i, (species, choice) in enumerate(plan.learners.items()):
            group = self.env.groups[species]
            with _room(f"the learner {choice.name} of {group.size} {species} {_big(choice, plan.copies)}".rstrip()):
                name = source.locate(choice.name, plan.copies)
                self.learners[species] = agents.make(
                    name, group, learner_seed(plan.seed, i), choice.settings, plan.device
                )
        recorder.check_columns(self.scenario, self.learners)  # what cannot be recorded is told before it lives
        with _room(f"a world of {self.env.size} agents"):
            self.tick = self.env.reset_arrays(plan.seed)
        if isinstance(self.tick, ScheduledTick):
            loop.follow(self.env, self.learners, self.tick)
        with _room(f"a world of {self.env.size} agents"):
            self.tally = Tally(self.scenario, self.env, self.learners, every=plan.record_every, last=plan.ticks)
        self.stopped_by: str | None = None
        self.control: Control | None = None  # of the pace, where somebody may set it
        self.schedule = Schedule(folder)
        self._living: int | None = None  # thread in which the run lives
        self._observers: Sequence[Observer] = ()
        self._interrupt = Interrupt()
        self._mailbox: Mailbox | None = None
        self._look = 0.0  # by the clock, when requests of other processes are looked for
        self._saved = 0  # tick of the last checkpoint
        self._resumed = False
        self._previous = False  # whether it goes on from the checkpoint before the last

    @property
    def now(self) -> int:
        """Return the number of ticks lived."""
        return self.env.state_view.tick

    def born_and_died(self) -> tuple[list[int], list[int]]:
        """Return how many of each species were born and have died so far."""
        return self.tally.births.tolist(), self.tally.causes.sum(axis=1).tolist()

    def check_folder(self) -> None:
        """Raise EcologyError where the folder already holds a run."""
        holds = [name for name in WRITES if (self.folder / name).exists()]
        holds += [source.SOURCE] if source.is_foreign(self.folder) else []
        if holds:
            raise EcologyError(
                f"the folder {str(self.folder)!r} already holds a run ({', '.join(holds)}); give another "
                f"--out, or go on with it by --resume {self.folder}."
            )

    def start(self) -> None:
        """Make the folder and write the config; EcologyError where it already holds a run."""
        self.check_folder()
        text = self.plan.to_toml()
        with writable(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            source.keep(self.plan.code, self.folder, self.plan.copies)
            if self.plan.forked:  # its first tick cannot be lived again
                self.save(self.folder / KEPT / str(self.now))
                self.save()
            replace_text(self.folder / CONFIG, text)
            self.schedule.write()

    def restore(self, *, previous: bool = False) -> None:
        """Become what the checkpoint in the folder holds, or the one before it; EcologyError where it does not fit."""
        where = self.folder / CHECKPOINT
        parts = checkpoint.read(where, previous=previous)
        damaged = f"the checkpoint {str(where)!r} is damaged or foreign"
        try:
            self.check_words(parts)
            self._longer_than(parts["tally"][1]["tick"] - 1)
        except (KeyError, TypeError, AttributeError) as error:
            raise EcologyError(f"{damaged} ({type(error).__name__}: {error}). {checkpoint.advice(where)}") from error
        try:
            self.become(parts)
        except Exception as error:
            raise EcologyError(f"{damaged} ({faults.describe(error)}). {checkpoint.advice(where)}") from error
        self._saved = self.now

    def check_words(self, parts: Mapping[str, checkpoint.Part]) -> None:
        """Raise EcologyError where a checkpoint is not of this run's world, learners and seed."""
        told, mine = parts["run"][1], self._words()
        differ = [key for key in mine if told["words"].get(key) != mine[key]]
        if differ:
            raise EcologyError(
                f"the checkpoint in {str(self.folder)!r} is of another world: it differs in {' and '.join(differ)}. "
                f"Restore the scenario file and {CONFIG}, or start the run anew."
            )

    def become(self, parts: Mapping[str, checkpoint.Part]) -> None:
        """Become what `parts` returned; whatever is raised where they do not fit."""
        self.schedule.done = min(int(parts["run"][1].get("interventions", 0)), len(self.schedule.entries))
        self.frozen = set(parts["run"][1].get("frozen", []))
        self.tally.restore(*parts["tally"])
        for species, learner in self.learners.items():
            learner.restore(*parts[f"learner_{species}"])
        self.tick = self.env.restore(*parts["world"])

    def resume(self, *, previous: bool = False) -> None:
        """Go on from the checkpoint (or the previous one), to the plan's ticks.

        `live` writes the config once nothing can fail. A run that was killed before anything but its
        config was written begins.
        """
        begun = any((self.folder / name).exists() for name in WRITES if name != CONFIG)
        if begun or previous or checkpoint.there(self.folder / CHECKPOINT):
            self.restore(previous=previous)
        self._previous = previous
        if self._ended():
            self._longer_than(self.now)
        self._resumed = True

    def _ended(self) -> bool:
        """Return whether the summary says that the run came to the end of what it had lived."""
        try:
            told = json.loads((self.folder / SUMMARY).read_text(encoding="utf-8"))
            return told["ticks"] == self.now and "stopped_at" not in told
        except (OSError, ValueError, TypeError, KeyError):
            return False

    def _longer_than(self, lived: int) -> None:
        if self.plan.ticks <= lived:
            raise EcologyError(f"the run {str(self.folder)!r} has lived its ticks; give more --ticks to go on.")

    def live(self, observers: Sequence[Observer] = ()) -> dict[str, Any]:
        """Live to the plan's ticks, and return the summary; whatever happens, the folder is left readable.

        Raises StoppedError where a signal came, EcologyError where a network diverged or a user's own code failed.
        """
        interrupt = self._interrupt = Interrupt()
        watchers = (self.tally, *observers, interrupt)
        last, keep = self.plan.ticks, self.plan.keep_every
        rhythms = [every for every in (self.plan.checkpoint_every, keep) if every]
        text = self.plan.to_toml()
        with writable(self.folder), self._faults_told(kept=True), contextlib.ExitStack() as at_end:
            at_end.enter_context(self._lives(observers))
            self._mailbox = Mailbox(self.folder, DO)
            first: tuple[Observer, ...] = (interrupt, self.tally)
            for watcher in (*first, *observers):  # the last to begin is the first to end
                if watcher is self.tally and not self.now:
                    self.save()  # what is written from here on can be gone on with
                watcher.begin(self.env, self.learners)
                at_end.callback(watcher.end)
            if self._resumed:
                if self.plan.copies is None:
                    source.keep(self.plan.code, self.folder, tick=self.now)
                replace_text(self.folder / CONFIG, text)
            if self._previous:
                checkpoint.put_aside(self.folder / CHECKPOINT)
            at_end.callback(self._write_summary)
            try:
                while self.now < last:
                    ticks = min(last - self.now, *(every - self.now % every for every in rhythms))
                    self.tick = loop.advance(
                        self.env, self.learners, self.tick, ticks, watchers, time.process_time, self._between
                    )
                    self._keep(observers)
                    if keep and self.now % keep == 0:
                        self.save(self.folder / KEPT / str(self.now))
            except StoppedError as stopped:
                self.stopped_by = str(stopped)
                self._keep(observers)
                raise
            except DivergedError as error:
                who = f"tick {self.now}, {self.env.name_of(error.slot)}"
                self.stopped_by = f"{who}: {error}"
                raise EcologyError(f"{who}: {error} The run up to there is kept in {self.folder}.") from error
            except BaseException as error:
                self.stopped_by = faults.describe(error)
                raise
        return self.summary()

    @contextlib.contextmanager
    def _faults_told(self, *, kept: bool) -> Iterator[None]:
        """Add to an exception in a user's own code how far the run came and, where it is `kept`, how it goes on."""
        try:
            yield
        except Exception as error:
            if faults.user_fault(error) is None:
                raise
            then = kept * (
                f"The run up to there is kept in {self.folder}; once this is mended, go on from tick {self._saved} "
                f"with: {self.resume_command(mended=True)}"
            )
            raise faults.wrap(f"after {self.now} ticks", error, then) from error

    def resume_command(self, *, mended: bool = False) -> str:
        """Return the command that resumes the run, once its own code is `mended` or as it is."""
        choice = source.CURRENT if mended else source.KEPT if self.plan.copies else None
        option = f" --source {choice}" if choice and any(map(source.is_file, self.plan.code)) else ""
        return f"ecology run --resume {self.folder}{option}"

    def _keep(self, observers: Sequence[Observer]) -> None:
        """Write the checkpoint, and before it what is recorded up to it: a run that goes on leaves no gap."""
        for observer in observers:
            getattr(observer, "flush", lambda: None)()
        self.save()

    # ---- between two ticks -----------------------------------------------------------------

    def do(self, text: str) -> str:
        """Intervene between two ticks, as `ecology.interventions` describes it; return what was done.

        May be called before the run lives and, while it lives, from any thread, which then waits for the end of the
        tick. An observer of the run, which cannot wait, is returned nothing; it is done when all have watched. Raises
        EcologyError, nothing being changed, where it does not fit the world.
        """
        split(text)
        if self._living is None:
            self.tick = self._serve(self.tick)
            self.tick, said = self._do(text)
            return said
        if self._living == threading.get_ident():
            self.schedule.add(self.now, text)
            self.schedule.write()
            return ""
        answer: Future[str] = Future()
        self.schedule.requests.put((text, answer))
        return answer.result()

    def _do(self, text: str) -> tuple[Tick, str]:
        """Do an intervention that is not in the schedule, and write it there; return what is perceived then."""
        self.schedule.add(self.now, text)
        try:
            found = self._do_next(text)
        except EcologyError:
            self.schedule.drop()
            raise
        self.schedule.write()
        return found

    def _do_next(self, text: str) -> tuple[Tick, str]:
        """Do the next intervention of the schedule."""
        effect = intervene(self.env, text)
        loop.pass_on_effect(self.env, self.learners, effect, effect.changed)
        self.schedule.done += 1
        for observer in self._observers:
            if (told := getattr(observer, "intervened", None)) is not None:
                told(self.env.state_view, text, effect.said)
        return effect.tick, effect.said

    def _between(self, tick: Tick) -> Tick:
        """Do what is to be done after a tick, and wait for as long as the control says; return what is perceived."""
        control = self.control
        while True:
            tick = self._serve(tick)
            if control is None:
                return tick
            control.advanced(self.now)
            if not (seconds := control.hold(self.now)):
                return tick
            if control.held:
                for observer in self._observers:
                    getattr(observer, "held", lambda: None)()
            self._interrupt.check()
            control.wait(seconds)

    def _serve(self, tick: Tick) -> Tick:
        """Do what is scheduled for now, and what others ask for."""
        while (entry := self.schedule.due(self.now)) is not None:
            try:
                tick, _ = self._do_next(entry.do)
            except EcologyError as error:
                raise EcologyError(
                    f"intervention {self.schedule.done + 1} of the schedule, {entry.do!r} at tick {entry.tick}: {error}"
                ) from error
        while not self.schedule.requests.empty():
            text, answer = self.schedule.requests.get()
            try:
                tick, said = self._do(text)
                answer.set_result(said)
            except BaseException as error:
                answer.set_exception(error)
                if not isinstance(error, EcologyError):
                    raise
        if self._mailbox is not None and time.monotonic() >= self._look:
            self._look = time.monotonic() + LOOK
            if (text_ := self._mailbox.waiting()) is not None:
                try:
                    tick, said = self._do(text_)
                    self._mailbox.answer(text_, f"tick {self.now}: {said}", done=True)
                except EcologyError as error:
                    self._mailbox.answer(text_, str(error), done=False)
        return tick

    @contextlib.contextmanager
    def _lives(self, observers: Sequence[Observer]) -> Iterator[None]:
        """Let the run be asked for interventions."""
        self._living, self._observers = threading.get_ident(), tuple(observers)
        try:
            yield
        finally:
            self._living, self._observers, self._mailbox = None, (), None
            self.schedule.refuse("the run is over.")

    def parts(self) -> dict[str, checkpoint.Part]:
        """Return all that the run has become: what a checkpoint holds."""
        done = {"interventions": self.schedule.done} if self.schedule.done else {}
        still = sorted(species for species, learner in self.learners.items() if not learner.learning)
        frozen = {"frozen": still} if still else {}
        return {
            "run": ({}, {"words": self._words(), **done, **frozen}),
            "tally": self.tally.state(),
            "world": self.env.snapshot(),
        } | {f"learner_{species}": learner.state() for species, learner in self.learners.items()}

    def save(self, where: Path | None = None) -> None:
        """Write the checkpoint, or one to `where`."""
        checkpoint.write(where or self.folder / CHECKPOINT, self.parts())
        if where is None:
            self._saved = self.now

    def live_on(self, at: int, observers: Sequence[Observer] = ()) -> None:
        """Live to the tick `at` and write nothing; StoppedError where a signal came."""
        interrupt = self._interrupt = Interrupt()
        with self._faults_told(kept=False), contextlib.ExitStack() as at_end:
            at_end.enter_context(self._lives(observers))
            for watcher in (interrupt, *observers):
                watcher.begin(self.env, self.learners)
                at_end.callback(watcher.end)
            watchers = (self.tally, *observers, interrupt)
            self.tick = loop.advance(self.env, self.learners, self.tick, at - self.now, watchers, between=self._between)

    def summary(self) -> dict[str, Any]:
        """Return what summary.json holds."""
        head: dict[str, Any] = {
            "scenario": self.plan.scenario,
            "learner": {species: choice.name for species, choice in self.plan.learners.items()},
            "seed": self.plan.seed,
            "ticks": self.tally.tick,
        }
        if self.stopped_by is not None:
            head |= {"stopped_at": self.tally.tick, "stopped_by": self.stopped_by}
        if self.schedule.done:
            head |= {"interventions": self.schedule.done}
        if self.plan.forked:
            at = self.plan.forked["at"]
            head |= {"forked_at": at, "mean_drive_since_fork": self.tally.mean_drive(at)}
            head |= {"mean_own_drive_since_fork": self.tally.mean_drive(at, own=True)}
        return head | self.tally.summary()

    def _words(self) -> dict[str, Any]:
        """Return what a checkpoint must share with the run that it is restored to, as JSON holds it."""
        words = {
            "seed": self.plan.seed,
            "scenario": world_digest(self.scenario),
            "learners": words_of(self.plan.learners),
        }
        return json.loads(json.dumps(words))

    def _write_summary(self) -> None:
        write_json(self.folder / SUMMARY, self.summary())


@contextlib.contextmanager
def _room(what: str) -> Iterator[None]:
    """Turn a failure to allocate into an EcologyError that says that `what` was too large."""
    try:
        yield
    except EcologyError:
        raise
    except (MemoryError, OverflowError, RuntimeError, TypeError, ValueError) as error:
        # torch and numpy tell by their words alone
        told = str(error).partition("\n")[0]
        about = ("memory", "overflow", "maximum allowed dimension", "unable to allocate")
        if not isinstance(error, (MemoryError, OverflowError)) and not any(word in told.lower() for word in about):
            raise
        raise EcologyError(f"{what} is too large for the memory of this machine ({told}); make it smaller.") from error


def _big(choice: Choice, copies: Path | None) -> str:
    """Return the whole numbers that a learner was given beyond its defaults, as "(memory 9000)"."""
    usual = agents.settings(source.locate(choice.name, copies))
    big = [
        f"{key} {value}"
        for key, value in choice.settings.items()
        if type(value) is int and type(usual.get(key)) is int and value > usual[key]
    ]
    return f"({', '.join(big)})" if big else ""


def learner_seed(seed: int, species: int) -> np.random.SeedSequence:
    """Return the seed of the learners of the species numbered `species` in a run seeded `seed`."""
    return np.random.SeedSequence(seed, spawn_key=(LEARNER_STREAM, species))


def read_plan(folder: Path, ticks: int | None = None, device: str | None = None, choice: str | None = None) -> Plan:
    """Return the plan of the run in `folder`, with other `ticks` and another `device` if given.

    `choice` says which code of the user's own to load, see `source.choose`.
    """
    if not (folder / CONFIG).is_file():
        raise EcologyError(f"the folder {str(folder)!r} holds no run: there is no {CONFIG} in it.")
    config = read_config(folder / CONFIG)
    return resolve(config=config, ticks=ticks, device=device, copies=source.choose(folder, choice))


def open_run(folder: Path, ticks: int | None = None, device: str | None = None, choice: str | None = None) -> Run:
    """Return the run that `folder` holds, its learners and its world as built, not yet restored.

    Its learners compute on the run's device, or on another: a checkpoint holds the same whatever wrote it. For
    `choice` see `read_plan`.
    """
    run = Run(read_plan(folder, ticks, device, choice), folder)
    run.schedule.read()
    return run
