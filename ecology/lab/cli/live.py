"""A run on the command line: who watches it, and what it came to."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ecology import Ecology, EcologyError, State, Tick
from ecology.lab.cli.options import format_number
from ecology.lab.cli.progress import Progress
from ecology.lab.runs.folder import METRICS, RECORDING
from ecology.lab.runs.run import Run
from ecology.lab.runs.stopping import StoppedError
from ecology.observers.base import Mind, Observer
from ecology.observers.wishes import Wishes

if TYPE_CHECKING:
    from ecology.observers.page import Page


def live(it: Run, observers: list[Observer], *, quiet: bool) -> None:
    """Live a run to its end, with progress, and say what it came to."""
    if not quiet:
        observers.append(Progress(it.tally, it.plan.ticks))
    try:
        summary = it.live(observers)
    except StoppedError as stopped:
        if not quiet:
            with contextlib.suppress(OSError):  # a terminal that hung up
                print(f"stopped by {stopped} at tick {it.tally.tick}; go on with: ecology run --resume {it.folder}")
        raise
    if not quiet:
        print_summary(it.folder, summary)


def make_observers(
    it: Run,
    *,
    resume: bool,
    view: bool = False,
    serve: bool = False,
    port: int | None = None,
    connect: str | None = None,
    focus: Sequence[str] = (),
) -> list[Observer]:
    """Return those who record and show the run."""
    from ecology.observers.census import Focus

    observers: list[Observer] = []
    if focus and not (it.plan.record or view or serve or connect):
        raise EcologyError("--focus is of a run that is recorded or watched; leave it out, or leave out --no-record.")
    Focus.of(it.env, focus)  # whom nobody can be is told before anything is written
    wishes = Wishes(it.folder)
    if it.plan.record:
        from ecology.observers.recorder import Recorder  # slow to load

        observers.append(Recorder(it.folder / METRICS, it.plan.record_every, resume=resume))
    if it.plan.record or view or serve or connect:
        from ecology.observers.rerun import RerunObserver  # slow to load
        from ecology.observers.viewer import LOOPBACK, SERVE_PORT, preferred_port

        rerun = RerunObserver(
            it.folder / RECORDING if it.plan.record else None,
            every=it.plan.record_every,
            serve=(LOOPBACK, preferred_port(LOOPBACK, SERVE_PORT) if serve else 0) if view or serve else None,
            connect=connect,
            focus=focus,
            detail=it.plan.record_detail if it.plan.record_detail != "auto" else None,
            name=it.folder.name,
            resume=resume,
            before=it.born_and_died(),
            wishes=wishes,
        )
        observers.append(rerun)
        if rerun.url is not None:
            observers.append(Audience(rerun.url, wishes, view=view, serve=serve, port=port))
    return observers


def web_port(port: int | None) -> int:
    """Return the port to serve browsers at: the one given, or by default one that is free."""
    from ecology.observers import viewer

    if port is not None:
        return viewer.free_port(viewer.LOOPBACK, port)
    return viewer.preferred_port(viewer.LOOPBACK, viewer.WEB_PORT)


class Audience:
    """Opens viewers on a run that serves, an observer: the viewer itself, or a page that tells of clicks."""

    def __init__(self, url: str, wishes: Wishes, *, view: bool, serve: bool, port: int | None = None) -> None:
        from ecology.observers.viewer import needs_display

        if view:
            needs_display("use --serve and look from a browser")
        self.port = web_port(port) if serve else None
        self._url, self._wishes, self._view = url, wishes, view
        self._page: Page | None = None

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Open them: what they attach to is there by now."""
        from ecology.observers import viewer
        from ecology.observers.page import Page

        if self._view:
            viewer.attach(self._url)
        if self.port is not None:
            try:
                self._page = Page([self._url], self._wishes.click, dt=env.dt, port=self.port)
                print(f"watch in a browser: {self._page.url}")
            except EcologyError as error:
                logging.getLogger("ecology").warning("%s The run goes on.", error)
            print(f"watch in a viewer: rerun --connect {self._url}")

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Leave the watching to the viewers."""

    def end(self) -> None:
        """Serve browsers no more; a viewer that was opened stays."""
        if self._page is not None:
            self._page.close()


def print_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Print what a run came to, and what can be done with it."""
    drive, last = summary["mean_drive"], summary["mean_drive_last_tenth"]
    own, last_own = summary["mean_own_drive"], summary["mean_own_drive_last_tenth"]
    felt = f" (own drive {format_number(own)}, {format_number(last_own)})" if (own, last_own) != (drive, last) else ""
    print(
        f"{summary['ticks']:,} ticks in {summary['wall_seconds']:,.1f} s; mean drive {format_number(drive)}, "
        f"in the last tenth {format_number(last)}{felt}. The run is in {folder}"
    )
    several = len(summary["population"]) > 1
    for name, of in summary["population"].items() if several or summary["births"] or summary["deaths"] else ():
        gone = "" if of["died_out"] is None else f" (died out at tick {of['died_out']:,})"
        drive, own = summary["species_drive"][name], summary["species_own_drive"][name]
        felt = f" (own drive {format_number(own)})" if own != drive else ""
        print(
            f"{name}: {of['end']} alive{gone}, {of['mean']:.1f} on average, from {of['least']} to {of['most']}; "
            f"mean drive {format_number(drive)}{felt}"
        )
    for name, of in summary["measures"].items():
        known = [format_number(of[key]) for key in ("mean", "least", "most", "end")]
        print(f"{name}: {known[0]} on average, from {known[1]} to {known[2]}, {known[3]} at the end")
    watch = f"ecology view {folder}   or   " if (folder / RECORDING).exists() else ""
    print(f"next: {watch}ecology evaluate {folder}")
