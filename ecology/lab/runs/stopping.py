"""A signal stops a run after a whole tick."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Mapping
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ecology import Ecology, State, Tick
    from ecology.observers.base import Mind


class StoppedError(Exception):
    """A signal asked the run to stop; it stops after a whole tick."""

    def __init__(self, signum: int) -> None:
        super().__init__(signal.Signals(signum).name)
        self.signum = signum


class Interrupt:
    """Turn SIGINT, SIGTERM and SIGHUP into a stop after the present tick; an observer, the last one."""

    def __init__(self) -> None:
        self.signum = 0  # of the signal that came
        self._before: dict[int, Any] = {}

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Listen to the signals."""
        self.listen()

    def listen(self) -> None:
        """Listen to the signals until `end`; only the main thread can."""
        with contextlib.suppress(ValueError):
            for name in ("SIGINT", "SIGTERM", "SIGHUP"):
                signum = getattr(signal, name, None)  # Windows has no SIGHUP, nohup ignores it
                if signum is not None and (name != "SIGHUP" or signal.getsignal(signum) is not signal.SIG_IGN):
                    self._before[signum] = signal.signal(signum, self._heard)

    def check(self) -> None:
        """Stop the run where a signal has come."""
        if self.signum:
            raise StoppedError(self.signum)

    def _heard(self, signum: int, frame: FrameType | None) -> None:
        self.signum = signum

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Stop the run where a signal has come."""
        self.check()

    def end(self) -> None:
        """Put the signals' former handlers back."""
        for signum, handler in self._before.items():
            signal.signal(signum, handler)
