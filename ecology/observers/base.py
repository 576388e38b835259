"""What a watcher is: it is shown the world and the minds in it, and changes nothing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ecology.env import Ecology, Tick
from ecology.state import Bools, Floats, State


@dataclass(frozen=True)
class Decision:
    """A choice between M options, with the numbers that it was made by; drives and scores in drive units."""

    options: tuple[str, ...]  # M names
    open: Bools  # (M,) which of them could be chosen
    next_drive: Floats  # (M,) predicted drive after each
    slope: Floats  # (M,) dJ/dzeta . f along each
    score: Floats  # (M,) what was compared: an agent that does not explore takes the least that is open
    taken: int  # index of the option that the agent takes
    explored: bool | None  # whether it was taken to explore, whatever the scores; None where that was not kept
    learned: bool  # whether anything was learned by then; without, scores are those of a random network
    value: float  # -ln(gamma) J at the time
    gamma: float  # discount per unit of time
    error: Floats  # (D,) error of f per component of zeta: 0 is perfect, 1 as bad as no change, NaN unknown
    age: int = 0  # ticks acted on it so far
    length: int | None = None  # ticks that it takes in all; None where the world ends it, as an arrival does
    recalled: bool = False  # whether the numbers were computed afterwards, by what the agent knows by now

    @property
    def total(self) -> Floats:
        """Return the predicted drive plus the slope, (M,): the right side of the HJB equation, one option ahead."""
        return self.next_drive + self.slope


class Mind(Protocol):
    """What a learner shows of itself to those who watch; every learner does."""

    def report(self) -> Mapping[str, np.ndarray]:
        """Return numbers by name, each (n,), one per slot of the species: losses, epsilon, ..."""
        ...

    def deviation(self, slot: int, zeta: np.ndarray) -> np.ndarray | None:
        """Return -ln(gamma) J, drive units, (m,) at states (m, D), of the agent in `slot`, or None."""
        ...

    @property
    def decides(self) -> bool:
        """Return whether `decision` shows anything, now or later."""
        ...

    def follow(self, slots: Collection[int]) -> None:
        """Keep from now on what the agents in `slots` weigh when they decide, and forget it of all others."""
        ...

    def decision(self, slot: int) -> Decision | None:
        """Return the decision that the agent in `slot` acts on, None where there is none."""
        ...


class Observer(Protocol):
    """Someone who watches a run; a class derived from it defines only the methods that it needs."""

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Be shown the world before its first tick; `minds` by species."""
        return

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Be shown the read-only state after a tick."""
        return

    def end(self) -> None:
        """Finish: flush and close what was written."""
        return
