"""A fork that advances beside its run, tick by tick, so that a viewer can show both futures at once."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ecology.errors import EcologyError
from ecology.lab.runs.folder import METRICS, RECORDING, lock
from ecology.lab.runs.stopping import StoppedError
from ecology.observers.base import Observer

if TYPE_CHECKING:
    from ecology.lab.runs.run import Run


def make_fork(run: Run, out: Path | None, do: Sequence[str]) -> Run:
    """Return a run to `out` in the present state of `run`, with the interventions `do` made in it alone; not started.

    Raises EcologyError and leaves `run` unchanged if the folder is taken or an intervention does not fit.
    """
    folder = run.folder.absolute()
    where = folder.with_name(f"{folder.name}-at-{run.now}") if out is None else out
    if run.now >= run.plan.ticks:
        raise EcologyError(f"the run is at its last tick, {run.now}; a fork from here has no future.")
    record = {"run": str(folder), "at": run.now, "changes": {}, "remove": [], "move": {}}
    record |= {"do": list(do)} if do else {}
    forked = type(run)(dataclasses.replace(run.plan, forked=record), where)
    forked.check_folder()
    forked.schedule.entries = list(run.schedule.entries[: run.schedule.done])
    forked.become(copy.deepcopy(run.parts()))
    for text in do:
        forked.do(text)
    return forked


def recorders(run: Run, *, resume: bool = False) -> list[Observer]:
    """Return the observers that write metrics and a recording to the folder of a run that begins or resumes."""
    if not run.plan.record:
        return []
    from ecology.observers.recorder import Recorder  # slow to load
    from ecology.observers.rerun import Recorded, RerunObserver

    every, detail = run.plan.record_every, run.plan.record_detail
    return [
        Recorder(run.folder / METRICS, every, resume=resume, deeds=run.schedule.since(run.now, every)),
        RerunObserver(
            run.folder / RECORDING,
            every=every,
            detail=detail if detail != "auto" else None,
            run=Recorded(run.folder.name, resume, run.born_and_died()),
        ),
    ]


class Twin:
    """A fork that advances beside its original run, in the same thread."""

    def __init__(self, run: Run, observers: Sequence[Observer], do: Sequence[str]) -> None:
        """Start `run`, a fork; the `observers` of its original may show both."""
        self.run, self.over, self.began = run, False, run.now
        run.start()
        self._stack = contextlib.ExitStack()
        self._stack.enter_context(lock(run.folder))
        sides = [
            notify(run.folder.name, "; ".join(do)) for each in observers if (notify := getattr(each, "forked", None))
        ]
        self._ticks = run.living([*recorders(run), *sides], 1)
        next(self._ticks)

    def catch_up(self, tick: int) -> None:
        """Advance to `tick`, or to the end of the fork."""
        while not self.over and self.run.now < tick:
            self._advance()

    def serve(self) -> None:
        """Serve requests to the fork while it waits."""
        if not self.over:
            self.run.serve()

    def finish(self) -> None:
        """Run to the end of the fork."""
        while not self.over:
            self._advance()

    def stop(self, stopped: StoppedError) -> None:
        """Stop the fork as its run was stopped."""
        if not self.over:
            self.over = True
            with contextlib.suppress(StoppedError, StopIteration):
                self._ticks.throw(stopped)
        self._stack.close()

    def close(self) -> None:
        """Leave the fork, whatever ended its run."""
        if not self.over:
            self.over = True
            self._ticks.close()
        self._stack.close()

    def _advance(self) -> None:
        try:
            next(self._ticks)
        except StopIteration:
            self.over = True
