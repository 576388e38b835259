"""Controls of a run that is served: pause, step, pace, and waiting for viewers.

A run asks `Control.hold` before every tick whether it has to wait; orders come from other threads. Nothing here
changes what happens in a tick, only when it begins.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import Any

from ecology.errors import EcologyError, nearest

ORDERS = ("pause", "go", "step", "decision", "pace")
GONE = 3.0  # seconds after which a watcher that reports nothing is gone
WATCHERS = 32  # pages that are listened to at a time, at most
STUCK = 5.0  # seconds after which a watcher whose picture does not move is no longer waited for
BEHIND = 1.0  # seconds by which a picture may be behind, at the present speed
LEAST = 30  # ticks by which it may be behind at any speed
RATED = 2.0  # seconds over which the speed is measured


@dataclass
class Watcher:
    """A page that shows the run."""

    shown: float  # tick of its picture
    furthest: float  # the latest that it has shown
    moved: float  # by the clock, when that last changed
    heard: float  # by the clock, when it last reported


class Control:
    """Says before every tick whether the run waits; every method may be called from any thread."""

    def __init__(self, *, paused: bool = False, pace: float | None = None, patient: bool = True) -> None:
        """Begin `paused` or not, at a `pace` in ticks per second, or as fast as it goes for None.

        patient: whether the run waits for pages that are behind.
        """
        self._lock, self._woken = threading.Lock(), threading.Event()
        self._pace = check_pace(pace)
        self._paused, self._patient = paused, patient
        self._holding = False  # whether the run was last told to wait because it is paused
        self._steps = 0  # ticks granted to a run that is paused
        self._until_decision = False
        self._due = 0.0  # by the clock, when the next tick may begin
        self._watchers: dict[str, Watcher] = {}
        self._sent = 0  # tick of the last picture that was sent
        self._times: deque[tuple[float, int]] = deque()  # clock and tick, for the speed
        self._tick = 0

    # ---- orders ------------------------------------------------------------------------------

    def order(self, what: str, pace: float | None = None) -> None:
        """Take an order: pause, go, step (one tick), decision (to the next one of the focus) or pace.

        Raises EcologyError for anything else.
        """
        if what not in ORDERS:
            raise EcologyError(f"there is no order {what!r}. {nearest(str(what), ORDERS)}")
        if what == "pace":
            pace = check_pace(pace)
        with self._lock:
            self._holding = False
            if what == "pace":
                self._pace, self._due = pace, 0.0
            elif what == "go":
                self._paused, self._steps, self._until_decision = False, 0, False
            else:
                self._paused = True
                self._steps += what == "step"
                self._until_decision = what == "decision"
        self._woken.set()

    def decided(self) -> None:
        """Pause a run that advances to the next decision: the agent in focus has just made one."""
        with self._lock:
            self._until_decision = False

    # ---- the run -----------------------------------------------------------------------------

    def hold(self, tick: int) -> float:
        """Return for how many seconds the run waits at `tick`, to ask again then; 0 grants it the next tick.

        The seconds are at most 0.05, so that signals and other orders are heard.
        """
        now = time.monotonic()
        with self._lock:
            if self._paused and not self._until_decision:
                if not self._steps:
                    self._holding = True
                    self._note(now, tick)
                    return 0.05
                self._steps -= 1
                return 0.0
            if self._pace is not None:
                if now < self._due:
                    return min(self._due - now, 0.05)
                # a tick that took too long is not made up for
                self._due = (max(self._due, now - 1.0 / self._pace) if self._due else now) + 1.0 / self._pace
            if self._lag(now) > self._allowed(now):
                return 0.02
            return 0.0

    def wait(self, seconds: float) -> None:
        """Wait for so long, or until an order comes."""
        if self._woken.wait(seconds):
            self._woken.clear()

    @property
    def held(self) -> bool:
        """Return whether the run waits because it is paused, and has heard no order since."""
        with self._lock:
            return self._holding

    def advanced(self, tick: int) -> None:
        """Note that the run is at `tick`."""
        with self._lock:
            self._note(time.monotonic(), tick)

    def sent(self, tick: int) -> None:
        """Note that the picture of `tick` was sent to the viewers."""
        with self._lock:
            self._sent = tick

    def _note(self, now: float, tick: int) -> None:
        self._tick = tick
        if not self._times or now - self._times[-1][0] > 0.1:
            self._times.append((now, tick))
        while len(self._times) > 2 and now - self._times[0][0] > RATED:
            self._times.popleft()

    # ---- watchers ----------------------------------------------------------------------------

    def seen(self, watcher: str, shown: float | None) -> None:
        """Note that the page `watcher` shows the tick `shown`; None: it looks back, and is not waited for."""
        now = time.monotonic()
        with self._lock:
            if shown is None or not math.isfinite(shown):
                self._watchers.pop(watcher, None)
                return
            known = self._watchers.get(watcher)
            if known is None:
                self._watchers = {name: each for name, each in self._watchers.items() if now - each.heard < GONE}
                if len(self._watchers) >= WATCHERS:
                    return
            furthest = shown if known is None else max(shown, known.furthest)
            moved = now if known is None or shown > known.furthest else known.moved
            if known is not None and self._sent <= known.shown:  # nothing new to be shown
                moved = now
            self._watchers[watcher] = Watcher(shown, furthest, moved, now)

    def _lag(self, now: float) -> float:
        """Return by how many ticks the last of the pages is behind that are waited for."""
        if not self._patient:
            return 0.0
        lags = [self._sent - w.shown for w in self._watchers.values() if now - w.heard < GONE and now - w.moved < STUCK]
        return max([0.0, *lags])

    def _allowed(self, now: float) -> float:
        return max(LEAST, BEHIND * self._speed(now))

    def _speed(self, now: float) -> float:
        """Return ticks per second of late."""
        if not self._times:
            return 0.0
        then, tick = self._times[0]
        return max(self._tick - tick, 0) / max(now - then, 1e-3) if now - then > 0.05 else 0.0

    def status(self) -> dict[str, Any]:
        """Return how the run goes, as JSON holds it."""
        now = time.monotonic()
        with self._lock:
            watchers = [w for w in self._watchers.values() if now - w.heard < GONE]
            return {
                "tick": self._tick,
                "paused": self._paused and not self._until_decision,
                "to_decision": self._until_decision,
                "pace": self._pace,
                "speed": round(self._speed(now), 1),
                "watchers": len(watchers),
                "waits": self._lag(now) > self._allowed(now),
            }


def check_pace(pace: float | None) -> float | None:
    """Return a pace in ticks per second; EcologyError where it is none."""
    if pace is None:
        return None
    good = isinstance(pace, (int, float)) and not isinstance(pace, bool) and math.isfinite(pace) and pace > 0
    if not good:
        raise EcologyError(f"a pace is a number of ticks per second above 0, got {pace!r}.")
    return max(float(pace), 0.01)
