"""A run: its life, and the folder that it leaves."""

from __future__ import annotations

import contextlib
import json
import queue
import threading
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import numpy as np

from ecology import Ecology, EcologyError, Scenario, Tick, agents, faults
from ecology.agents import checkpoint, loop
from ecology.agents.base import DivergedError
from ecology.changes import check_stocks
from ecology.errors import writable
from ecology.interventions import intervene
from ecology.lab.runs import source, twins
from ecology.lab.runs.folder import (
    CHECKPOINT,
    CONFIG,
    KEPT,
    SUMMARY,
    WRITES,
    check_links,
    check_run,
    replace_text,
    write_json,
)
from ecology.lab.runs.gate import Gate
from ecology.lab.runs.interventions import Schedule
from ecology.lab.runs.run_config import Choice, Plan, read_config, resolve, words_of, world_digest
from ecology.lab.runs.run_summary import RunSummary
from ecology.lab.runs.stopping import Interrupt, StoppedError
from ecology.lab.runs.world_file import read_world, write_world
from ecology.observers.base import Observer
from ecology.observers.control import Control
from ecology.observers.mailbox import Mailbox
from ecology.schedule import ScheduledTick
from ecology.verbs import check_command, split

DO = "do"  # kind of the requests of `ecology do`
LOOK = 0.1  # seconds between two looks for requests of other processes
LEARNER_STREAM = 1_000  # first word of the learners' spawn keys, beyond those of the world's concerns


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
        loop.adopt(self.env, self.learners)
        if isinstance(self.tick, ScheduledTick):
            loop.follow(self.env, self.learners, self.tick)
        with _room(f"a world of {self.env.size} agents"):
            self.totals = RunSummary(self.scenario, self.env, self.learners, every=plan.record_every, last=plan.ticks)
        self.stopped_by: str | None = None
        self.control: Control | None = None  # of the pace, where somebody may set it
        self.schedule = Schedule(folder)
        self.twin: twins.Twin | None = None  # the fork that advances beside it
        self._forks: queue.SimpleQueue[tuple[Path | None, tuple[str, ...], Future[Run]]] = queue.SimpleQueue()
        self._living: int | None = None  # thread that executes the run
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
        return self.env.world.state.tick

    def born_and_died(self) -> tuple[list[int], list[int]]:
        """Return how many of each species were born and have died so far."""
        return self.totals.births.tolist(), self.totals.causes.sum(axis=1).tolist()

    def check_folder(self) -> None:
        """Raise EcologyError where the folder already holds a run."""
        holds = [name for name in WRITES if (self.folder / name).exists()]
        holds += [source.SOURCE] if source.is_foreign(self.folder) else []
        if holds:
            raise EcologyError(
                f"the folder {str(self.folder)!r} already holds a run ({', '.join(holds)}); give another "
                f"--out, or continue it with --resume {self.folder}."
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
            write_world(self.folder, self.scenario)
            replace_text(self.folder / CONFIG, text)
            self.schedule.write()

    def restore(self, kept: Path | None = None, *, previous: bool = False) -> None:
        """Restore the checkpoint in the folder, or the one before it; raise EcologyError if it does not fit.

        From a `kept` checkpoint, which need not be the last, the run continues as if nothing had come after it.
        """
        where = kept or self.folder / CHECKPOINT
        self._resumed = kept is not None
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
        theirs, mine = parts["run"][1], self._words()
        differ = [key for key in mine if theirs["words"].get(key) != mine[key]]
        if differ:
            raise EcologyError(
                f"the checkpoint in {str(self.folder)!r} is of another world: it differs in {' and '.join(differ)}. "
                f"Restore the scenario file and {CONFIG}, or start a new run."
            )

    def become(self, parts: Mapping[str, checkpoint.Part]) -> None:
        """Become what `parts` returned; whatever is raised where they do not fit."""
        done, frozen = parts["run"][1].get("interventions", 0), parts["run"][1].get("frozen", [])
        if type(done) is not int or done < 0 or not set(frozen) <= self.learners.keys():
            raise EcologyError(f"interventions are counted, and species are frozen; got {done!r} and {frozen!r}.")
        self.schedule.done = min(done, len(self.schedule.entries))
        self.frozen = set(frozen)
        self.totals.restore(*parts["tally"])
        for species, learner in self.learners.items():
            learner.restore(*parts[f"learner_{species}"])
        self.tick = self.env.restore(*parts["world"])
        loop.adopt(self.env, self.learners)
        if not self.plan.forked and not self.env.world.changes:  # those may lower a capacity
            check_stocks(self.env.state_view, self.env.world.model)
        if self.totals.tick != self.now:
            raise EcologyError(f"the world is at tick {self.now}, its sums at {self.totals.tick}.")

    def resume(self, *, previous: bool = False) -> None:
        """Go on from the checkpoint (or the previous one), to the plan's ticks.

        `live` writes the config once nothing can fail. A run that was killed before anything but its
        config was written begins.
        """
        begun = any((self.folder / name).exists() for name in WRITES if name != CONFIG)
        if begun or previous or checkpoint.exists(self.folder / CHECKPOINT):
            self.restore(previous=previous)
        self._previous = previous
        if self._has_ended():
            self._longer_than(self.now)
        self._resumed = True

    def _has_ended(self) -> bool:
        """Return whether the summary covers all that the run has done."""
        try:
            summary = json.loads((self.folder / SUMMARY).read_text(encoding="utf-8"))
            return summary["ticks"] == self.now and "stopped_at" not in summary
        except (OSError, ValueError, TypeError, KeyError):
            return False

    def _longer_than(self, lived: int) -> None:
        if self.plan.ticks <= lived:
            raise EcologyError(
                f"the run {str(self.folder)!r} has reached its last tick; pass more --ticks to continue."
            )

    def live(self, observers: Sequence[Observer] = ()) -> dict[str, Any]:
        """Live to the plan's ticks, and return the summary; whatever happens, the folder is left readable.

        Raises StoppedError where a signal came, EcologyError where a network diverged or a user's own code failed.
        """
        for _ in self.living(observers):
            pass
        return self.summary()

    def living(self, observers: Sequence[Observer] = (), stride: int | None = None) -> Generator[int]:
        """Run as `live` does, and yield the tick at the start and after every `stride` ticks.

        The caller may pause between two ticks, for example to advance another run.
        """
        last, keep = self.plan.ticks, self.plan.keep_every
        rhythms = [every for every in (self.plan.checkpoint_every, keep) if every]
        stride = 1 if self.scenario.until_extinct else stride
        with self.under_way(observers):
            yield self.now
            while self.now < last and not self._is_extinct():
                ticks = min(last - self.now, *(every - self.now % every for every in rhythms))
                few = ticks if stride is None else min(stride, ticks)
                self.advance(few)
                if few == ticks:
                    self._keep(observers)
                    if keep and self.now % keep == 0:
                        self.save(self.folder / KEPT / str(self.now))
                yield self.now
            if self.twin is not None:
                self.twin.finish()

    def advance(self, ticks: int) -> None:
        """Advance a run in progress by `ticks` ticks."""
        watchers = (self.totals, *self._observers, self._interrupt)
        self.tick = loop.advance(self.env, self.learners, self.tick, ticks, watchers, time.process_time, self._between)

    @contextlib.contextmanager
    def under_way(self, observers: Sequence[Observer]) -> Iterator[None]:
        """Prepare for `advance`: start the observers, and write the results at the end, whatever happens."""
        interrupt = self._interrupt = Interrupt()
        text = self.plan.to_toml()
        check_links(self.folder)
        with writable(self.folder, self._go_on), self._explain_faults(kept=True), contextlib.ExitStack() as at_end:
            at_end.enter_context(self._lives(observers))
            self._mailbox = Mailbox(self.folder, DO)
            first: tuple[Observer, ...] = (interrupt, self.totals)
            with contextlib.ExitStack() as begun:
                for watcher in (*first, *observers):  # the last to begin is the first to end
                    if watcher is self.totals and not self.now:
                        self.save()  # what is written from here on can be gone on with
                    watcher.begin(self.env, self.learners)
                    begun.callback(watcher.end)
                rest = begun.pop_all()
            at_end.push(self._end)  # comes after `rest`
            at_end.enter_context(rest)
            if self._resumed:
                if self.plan.copies is None:
                    source.keep(self.plan.code, self.folder, tick=self.now)
                write_world(self.folder, self.scenario)
                replace_text(self.folder / CONFIG, text)
            if self._previous:
                checkpoint.put_aside(self.folder / CHECKPOINT)
            try:
                yield
            except StoppedError as stopped:
                self.stopped_by = str(stopped)
                self._keep(observers)
                if self.twin is not None:
                    self.twin.stop(stopped)
                raise
            except DivergedError as error:
                who = f"tick {self.now}, {self.env.name_of(error.slot)}"
                self.stopped_by = f"{who}: {error}"
                raise EcologyError(f"{who}: {error} The run up to there is kept in {self.folder}.") from error
            except BaseException as error:
                self.stopped_by = faults.describe(error)
                raise
            finally:
                if self.twin is not None:
                    self.twin.close()

    @contextlib.contextmanager
    def _explain_faults(self, *, kept: bool) -> Iterator[None]:
        """Add to an exception in a user's own code how far the run got and, where it is `kept`, how to resume it."""
        try:
            yield
        except Exception as error:
            if faults.user_fault(error) is None:
                raise
            then = kept * (
                f"The run up to there is kept in {self.folder}; once this is fixed, resume from tick {self._saved} "
                f"with: {self.resume_command(mended=True)}"
            )
            raise faults.wrap(f"after {self.now} ticks", error, then) from error

    def _go_on(self) -> str:
        """Say how to resume the run once there is room again."""
        return f"Then resume from tick {self._saved} with: {self.resume_command()}"

    def resume_command(self, *, mended: bool = False) -> str:
        """Return the command that resumes the run, once its own code is `mended` or as it is."""
        choice = source.CURRENT if mended else source.KEPT if self.plan.copies else None
        option = f" --source {choice}" if choice and any(map(source.is_file, self.plan.code)) else ""
        return f"ecology run --resume {self.folder}{option}"

    def keep_at(self, where: Path | None = None) -> None:
        """Write the checkpoint of a run that is under way, or one to `where`, and what is recorded up to it."""
        self._keep(self._observers, where)

    def _keep(self, observers: Sequence[Observer], where: Path | None = None) -> None:
        """Write the checkpoint, and before it what is recorded up to it, so that a resumed run leaves no gap."""
        for observer in observers:
            getattr(observer, "flush", lambda: None)()
        self.save(where)

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
            check_command(self.scenario, text)
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
            if (notify := getattr(observer, "intervened", None)) is not None:
                notify(self.env.state_view, text, effect.said)
        return effect.tick, effect.said

    def _between(self, tick: Tick) -> Tick:
        """Do what is to be done after a tick, and wait for as long as the control says; return what is perceived."""
        control = self.control
        while True:
            tick = self._serve(tick)
            if control is None:
                return self._go(tick)
            control.advanced(self.now)
            if not (seconds := control.hold(self.now)):
                return self._go(tick)
            if control.held:
                for observer in self._observers:
                    getattr(observer, "held", lambda: None)()
            self._interrupt.check()
            control.wait(seconds)

    def _is_extinct(self) -> bool:
        """Return whether the run ends because no agent is alive and its scenario has `until_extinct`."""
        return self.scenario.until_extinct and self.now > 0 and not self.env.state_view.alive.any()

    def _go(self, tick: Tick) -> Tick:
        """Advance the fork by the next tick first, so that observers of this run see both; return `tick`."""
        if self.twin is not None:
            self.twin.catch_up(self.now + 1)
        return tick

    def fork(self, out: Path | None = None, do: Sequence[str] = ()) -> Run | None:
        """Fork this run between two ticks, with the interventions `do` in the fork alone; return the fork.

        While this run lives, both futures continue side by side, tick by tick: the fork in its own folder, `out` or
        RUN-at-TICK. May be called as `do` may: before the run lives, when the fork is left to the caller to `live`;
        from any thread; from an observer, which is returned None. Raises EcologyError where it cannot be made.
        """
        if self._living is None:
            self.tick = self._serve(self.tick)
            return twins.make_fork(self, out, do)
        answer: Future[Run] = Future()
        self._forks.put((out, tuple(do), answer))
        return None if self._living == threading.get_ident() else answer.result()

    def _fork(self, out: Path | None, do: Sequence[str]) -> Run:
        if self.twin is not None and not self.twin.over:
            raise EcologyError(
                f"the fork {self.twin.run.folder.name!r} is still running; a run can have one fork at a time."
            )
        self.twin = twins.Twin(twins.make_fork(self, out, do), self._observers, do)
        return self.twin.run

    def serve(self) -> None:
        """Serve requests to a run that waits between two strides of `living`."""
        self.tick = self._serve(self.tick)

    def _serve(self, tick: Tick) -> Tick:
        """Make the interventions that are due, and serve requests from other threads."""
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
        while not self._forks.empty():
            out, do, waits = self._forks.get()
            try:
                waits.set_result(self._fork(out, do))
            except BaseException as error:
                waits.set_exception(error)
                if not isinstance(error, EcologyError):
                    raise
        if self.twin is not None:
            self.twin.serve()
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
            while not self._forks.empty():
                self._forks.get()[2].set_exception(EcologyError("the run is over."))

    def parts(self) -> dict[str, checkpoint.Part]:
        """Return all that the run has become: what a checkpoint holds."""
        done = {"interventions": self.schedule.done} if self.schedule.done else {}
        still = sorted(species for species, learner in self.learners.items() if not learner.learning)
        frozen = {"frozen": still} if still else {}
        return {
            "run": ({}, {"words": self._words(), **done, **frozen}),
            "tally": self.totals.state(),
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
        with self._explain_faults(kept=False), contextlib.ExitStack() as at_end:
            at_end.enter_context(self._lives(observers))
            for watcher in (interrupt, *observers):
                watcher.begin(self.env, self.learners)
                at_end.callback(watcher.end)
            watchers = (self.totals, *observers, interrupt)
            self.tick = loop.advance(self.env, self.learners, self.tick, at - self.now, watchers, between=self._between)

    def summary(self) -> dict[str, Any]:
        """Return what summary.json holds."""
        head: dict[str, Any] = {
            "scenario": self.plan.scenario,
            "learner": {species: choice.name for species, choice in self.plan.learners.items()},
            "seed": self.plan.seed,
            "ticks": self.totals.tick,
        }
        if self.stopped_by is not None:
            head |= {"stopped_at": self.totals.tick, "stopped_by": self.stopped_by}
        if self.twin is not None:
            head |= {"fork": self.twin.run.folder.name}
        if self.totals.tick < self.plan.ticks and self._is_extinct():
            head |= {"extinct_at": self.totals.tick}
        if self.schedule.done:
            head |= {"interventions": self.schedule.done}
        if self.plan.forked:
            at = self.plan.forked["at"]
            head |= {"forked_at": at, "mean_drive_since_fork": self.totals.mean_drive(at)}
            head |= {"mean_own_drive_since_fork": self.totals.mean_drive(at, own=True)}
        return head | self.totals.summary()

    def _words(self) -> dict[str, Any]:
        """Return what a checkpoint must share with the run that it is restored to, as JSON holds it."""
        words = {
            "seed": self.plan.seed,
            "scenario": world_digest(self.scenario),
            "learners": words_of(self.plan.learners),
        }
        return json.loads(json.dumps(words))

    def _end(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """Write the summary, which says that a run has ended: last, when all that was recorded is on disk."""
        if error is not None and self.stopped_by is None:
            self.stopped_by = faults.describe(error)
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
        reason = str(error).partition("\n")[0]
        about = ("memory", "overflow", "maximum allowed dimension", "unable to allocate")
        if not isinstance(error, (MemoryError, OverflowError)) and not any(word in reason.lower() for word in about):
            raise
        raise EcologyError(
            f"{what} is too large for the memory of this machine ({reason}); make it smaller."
        ) from error


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


def read_plan(
    folder: Path,
    ticks: int | None = None,
    device: str | None = None,
    choice: str | None = None,
    *,
    trust: bool = False,
    say: Callable[[str], None] | None = None,
) -> Plan:
    """Return the plan of the run in `folder`, with other `ticks` and another `device` if given.

    `choice` says which code of the user's own to load, see `source.choose`. Code that this user has not run before is
    run only with `trust`; `say` is told whose code is run. See `Gate`.
    """
    check_run(folder)
    config = read_config(folder / CONFIG)
    gate = Gate(choice, trust, say)
    return resolve(config=config, ticks=ticks, device=device, copies=source.choose(folder, choice), gate=gate)


def open_run(
    folder: Path,
    ticks: int | None = None,
    device: str | None = None,
    choice: str | None = None,
    *,
    trust: bool = False,
    say: Callable[[str], None] | None = None,
) -> Run:
    """Return the run that `folder` holds, its learners and its world as built, not yet restored.

    Its learners compute on the run's device, or on another: a checkpoint holds the same whatever wrote it. For
    `choice`, `trust` and `say` see `read_plan`.
    """
    run = Run(read_plan(folder, ticks, device, choice, trust=trust, say=say), folder)
    run.schedule.read()
    return run


def load_world(folder: Path) -> Scenario:
    """Return the world of the run in `folder` to show what it recorded, without running code that does not ship."""
    check_run(folder)
    world = read_world(folder)
    return read_plan(folder).load() if world is None else world  # a run of an earlier version
