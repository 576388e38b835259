"""Observers: they see the world and the learners in it, and change nothing."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Protocol

import numpy as np

from ecology.decision import Decision, Plan
from ecology.env import Ecology
from ecology.state import State
from ecology.world import Tick


class Mind(Protocol):
    """The part of a learner that observers can see; every learner has it."""

    def report(self) -> Mapping[str, np.ndarray]:
        """Return numbers by name, each (n,), one per slot of the species: losses, epsilon, ..."""
        ...

    def deviation(self, slot: int, zeta: np.ndarray) -> np.ndarray | None:
        """Return -ln(gamma) J, drive units, (m,) at states (m, D), of the agent in `slot`, or None."""
        ...

    @property
    def decides(self) -> bool:
        """Return whether `decision` ever returns a decision."""
        ...

    def follow(self, slots: Collection[int]) -> None:
        """Record from now on the decisions of the agents in `slots`, and drop those of all others."""
        ...

    def decision(self, slot: int) -> Decision | None:
        """Return the decision that the agent in `slot` acts on, None where there is none."""
        ...

    def plan_ahead(self, slot: int) -> Plan | None:
        """Return the best plan that the agent in `slot` found when it decided, None where there is none."""
        ...


class Observer(Protocol):
    """Observer of a run; a class derived from it defines only the methods that it needs.

    A run calls three more methods of observers that have them: `flush()` before a checkpoint; `intervened(state, text,
    said)` after an intervention, with the state after it, its line and what was done; and `held()` repeatedly while
    the run is paused.
    """

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Called once before the first tick; `minds` are the learners by species."""
        return

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Called after every tick with the read-only state."""
        return

    def end(self) -> None:
        """Called once after the last tick, also when an exception ends the run."""
        return
