"""How far a run or a sweep is, on the terminal."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from rich.console import Console

from ecology import Ecology, State, Tick
from ecology.lab import compiling
from ecology.lab.runs.run_summary import RunSummary
from ecology.observers.base import Mind

REFRESH = 0.25  # seconds between two pictures of the progress bar
LINE = 60.0  # seconds between two lines of progress where there is no terminal


class Progress:
    """Show how far the run is, an observer: a bar on a terminal, a line now and then elsewhere."""

    def __init__(self, totals: RunSummary, ticks: int) -> None:
        self._totals, self._ticks = totals, ticks
        self._console = Console(stderr=True)
        self._every = REFRESH if self._console.is_terminal else LINE
        self._bar: Any = None
        self._from, self._then = 0, 0.0  # tick and time of the last picture
        self._compiled, self._say = 0, compiling.notice.say  # functions so far; who says so without a bar

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Start the bar."""
        self._from, self._then = self._totals.tick, time.monotonic()
        if self._console.is_terminal:
            from rich import progress  # slow to load

            self._bar = progress.Progress(
                progress.BarColumn(),
                progress.TaskProgressColumn(),
                progress.TextColumn("{task.description}"),
                progress.TimeRemainingColumn(),
                console=self._console,
                auto_refresh=False,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=self._ticks, completed=self._from)
            self._say, compiling.notice.say = compiling.notice.say, self._describe
        self._compiled = compiling.notice.count

    def _describe(self, words: str) -> None:
        """Show in the bar what keeps the run waiting."""
        with contextlib.suppress(OSError):
            self._bar.update(self._task, description=words)
            self._bar.refresh()

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Renew the picture, a few times per second at most; a tick that compiled something is no measure of speed."""
        if self._compiled != compiling.notice.count:
            self._compiled = compiling.notice.count
            self._from, self._then = self._totals.tick, time.monotonic()
        if time.monotonic() >= self._then + self._every:
            with contextlib.suppress(OSError):  # a terminal that hung up stops nothing
                self._show(minds)

    def _show(self, minds: Mapping[str, Mind]) -> None:
        now, at = time.monotonic(), self._totals.tick
        parts = [f"{(at - self._from) / max(now - self._then, 1e-9):,.0f} ticks/s"]
        drive, own = self._totals.mean_drive(self._from), self._totals.mean_drive(self._from, own=True)
        if drive is not None:
            parts.append(f"mean drive {drive:.2f}")
        if own != drive:
            parts.append(f"own drive {own:.2f}")
        for key, symbol in (("loss_f", "L_f"), ("loss_J", "L_J")):
            losses = [np.asarray(report[key]) for mind in minds.values() if key in (report := mind.report())]
            known = np.concatenate(losses) if losses else np.empty(0)
            known = known[np.isfinite(known)]
            if known.size:
                parts.append(f"{symbol} {known.mean():.3g}")
        self._from, self._then = at, now
        if self._bar is not None:
            self._bar.update(self._task, completed=at, description="  ".join(parts))
            self._bar.refresh()
        else:
            self._console.print(f"tick {at:,} of {self._ticks:,}  {'  '.join(parts)}", highlight=False)

    def end(self) -> None:
        """Leave the last picture."""
        if self._bar is not None:
            compiling.notice.say = self._say
            with contextlib.suppress(OSError):
                self._bar.update(self._task, completed=self._totals.tick)
                self._bar.refresh()
                self._bar.stop()


@contextlib.contextmanager
def runs_bar(console: Console, total: int, done: int) -> Iterator[Callable[[str], None]]:
    """Show a bar of whole runs on a terminal; what it gives moves it by one."""
    from rich import progress  # slow to load

    with progress.Progress(
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("runs  {task.description}"),
        progress.TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal or done == total,
    ) as bar:
        task = bar.add_task("", total=total, completed=done)
        yield lambda words: bar.update(task, advance=1, description=words)
