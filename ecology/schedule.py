"""The schedule of a scenario: what happens at which tick, and how a tick comes to hold it.

Events are interventions: `interventions.intervene` does them, whoever runs the world. They come after the tick that
ends at their time, so that an agent perceives what they did before it acts again.
"""

from __future__ import annotations

import bisect
import heapq
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ecology.errors import EcologyError
from ecology.interventions import Effect, intervene
from ecology.scenario import Scenario
from ecology.spec import Session
from ecology.state import State
from ecology.verbs import MissingError
from ecology.world import Tick

if TYPE_CHECKING:
    from ecology.env import Ecology

GAPS = (
    2_000  # first word of the spawn key of the stream that gaps are drawn from, beyond those of concerns and learners
)


class Due(NamedTuple):
    """An event, and the number of ticks after which it happens."""

    tick: int
    text: str
    felt: bool
    begins: bool = False  # whether it is the beginning of a trial, which does nothing


@dataclass(frozen=True)
class ScheduledTick(Tick):
    """A tick after which the schedule did something: what is perceived then, and the tick as it was lived."""

    lived: Tick
    state: State  # read-only, before the events
    effects: tuple[tuple[str, Effect], ...]  # the line of each event and what it did
    felt: bool  # whether what they did is experienced as a part of the tick


class Timetable:
    """What is still to come of a scenario's schedule: `next` is the tick of it, infinite when nothing is."""

    def __init__(self, scenario: Scenario) -> None:
        """Take the events of a scenario; `start` begins with them."""
        self._scenario, self.next = scenario, math.inf
        self._waiting: list[tuple[int, int, int]] = []  # a heap: tick, place in the schedule, how often it has happened
        self._trials: list[Due] = []  # of all sessions, in order
        self._at = 0  # how many of them have happened
        self._begins: list[int] = []  # tick at which each trial begins
        self._names: list[tuple[str, int]] = []  # session and number of each trial

    def start(self, seed: int, after: int = -1) -> None:
        """Begin in a world of `seed` in which what is due up to the tick `after` has happened."""
        dt = float(self._scenario.dt)
        self._waiting = [(ticks(event.at, dt), i, 0) for i, event in enumerate(self._scenario.schedule)]
        heapq.heapify(self._waiting)
        self._trials, self._at, self._begins, self._names = [], 0, [], []
        now, rng = 0.0, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(GAPS,)))
        for session in self._scenario.sessions:
            for number in range(1, session.trials + 1):
                self._names.append((session.name, number))
                self._begins.append(ticks(now, dt))
                self._trials += _events_of(session, number, now, dt)
                now += session.length + (rng.exponential(session.gap) if session.random else session.gap)
        self.take(after)

    def take(self, tick: int) -> list[Due]:
        """Return what is due by `tick`, in order: the schedule's before the trials'; it has happened then."""
        found, dt = [], float(self._scenario.dt)
        while self._waiting and self._waiting[0][0] <= tick:
            at, place, times = heapq.heappop(self._waiting)
            event = self._scenario.schedule[place]
            found.append(Due(at, event.do, event.felt))
            following = None if event.every is None else event.at + (times + 1) * event.every
            if following is not None and following <= event.until:
                heapq.heappush(self._waiting, (max(ticks(following, dt), at + 1), place, times + 1))
        while self._at < len(self._trials) and self._trials[self._at].tick <= tick:
            found.append(self._trials[self._at])
            self._at += 1
        coming = self._waiting[0][0] if self._waiting else math.inf
        self.next = min(coming, self._trials[self._at].tick if self._at < len(self._trials) else math.inf)
        return sorted(found, key=lambda due: due.tick)

    def trial(self, tick: int) -> tuple[str, int]:
        """Return the session and the number of the trial, from 1, that began last by `tick`; "" and 0 without any."""
        at = bisect.bisect_right(self._begins, tick)
        return self._names[at - 1] if at else ("", 0)


def ticks(time: float, dt: float) -> int:
    """Return the number of ticks that end nearest to `time`."""
    return math.floor(time / dt + 0.5)


def _events_of(session: Session, number: int, began: float, dt: float) -> list[Due]:
    """Return what happens in a trial, in order."""
    found = [Due(ticks(began, dt), f"trial {number} of {session.name}", felt=True, begins=True)]
    for event in session.events:
        at, times = event.at, 0
        while at < session.length and at <= event.until:
            found.append(Due(ticks(began + at, dt), event.do, event.felt))
            if event.every is None:
                break
            times += 1
            at = event.at + times * event.every
    return sorted(found, key=lambda due: due.tick)  # stable: the beginning first, then as they are written


def carry_out(env: Ecology, due: list[Due], lived: Tick) -> ScheduledTick:
    """Do the events that are `due` after the tick `lived`, and return what is perceived then.

    What they do is felt, a part of the tick's reward, unless one of them says that it is not. An event whose agent
    lives no more, or for which no slot is free, does nothing; its sentence says why. Raises EcologyError for one that
    does not fit the world at all.
    """
    world, before = env.world, env.state_view
    felt = all(event.felt for event in due)
    reward, died, born = lived.reward.copy(), lived.died.copy(), lived.born.copy()
    effects, now = [], lived
    for event in due:
        if event.begins:
            effects.append((event.text, Effect(f"{event.text} begins", now)))
            continue
        drive, world.resting = world.state.drive, died
        try:
            effect = intervene(env, event.text)
        except MissingError as error:
            effect = Effect(f"{event.text!r} could not be done: {error}", now)
        except EcologyError as error:
            raise EcologyError(f"the schedule, {event.text!r} at tick {event.tick}: {error}") from error
        finally:
            world.resting = None
        now = effect.tick
        if felt:
            reward += np.where(now.alive & ~born, drive - now.drive, 0.0)
        died[list(effect.died)] = True
        born[list(effect.born)] = True
        effects.append((event.text, effect))
    observations = {
        name: np.where(lived.died[group.slots, None], lived.observations[name], now.observations[name])
        for name, group in env.groups.items()
    }
    return ScheduledTick(
        observations=observations, masks=now.masks, reward=np.where(born & ~lived.born, 0.0, reward), drive=now.drive,
        alive=now.alive, died=died, born=born, parent=lived.parent, killer=lived.killer, closed=lived.closed,
        action=lived.action, lived=lived, state=before, effects=tuple(effects), felt=felt,
    )  # fmt: skip
