"""Past decisions of an agent, computed by repeating the run from the last checkpoint before."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from ecology import Ecology, State, Tick
from ecology.lab.runs.fork import go_to
from ecology.lab.runs.run import open_run
from ecology.observers.base import Mind, Observer
from ecology.observers.census import Choice
from ecology.observers.panels.decision import decision_text

SPAN = 100  # ticks that are computed, about half of them before the requested one


class DecisionRecorder(Observer):
    """Notes every decision of one agent, as the viewer writes it."""

    def __init__(self, species: str, serial: int) -> None:
        self._species, self._serial = species, serial
        self.texts: dict[int, str] = {}

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Let the mind keep what the agent weighs."""
        self._rows, self._env = env.groups[self._species].slots, env
        self._follow(env.state_view, minds)

    def _follow(self, state: State, minds: Mapping[str, Mind]) -> int | None:
        rows = np.flatnonzero(state.alive[self._rows] & (state.serial[self._rows] == self._serial))
        if not rows.size:
            return None
        minds[self._species].follow([int(rows[0])])
        return int(rows[0])

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Note the decision that it acts on."""
        row = self._follow(state, minds)
        decision = None if row is None else minds[self._species].decision(row)
        if decision is not None and not decision.recalled:
            choice = Choice(state.tick, f"{self._species}_{self._serial}", decision)
            self.texts[state.tick] = decision_text(choice)


def decisions(
    folder: Path, who: str, tick: int, *, trust: bool = False, say: Callable[[str], None] | None = None
) -> dict[int, str]:
    """Return the decisions of the agent `who` in the run in `folder` around `tick`, by tick, as the viewer writes them.

    Executes the code of the run, as `ecology fork` does, and takes as long as the run took from the last checkpoint
    before; a run with `--keep-every` has more of them. Raises EcologyError if the run cannot be repeated.
    """
    run = open_run(folder, trust=trust, say=say)
    first = max(tick - SPAN // 2, 0)
    species, _, serial = who.rpartition("_")
    recorder = DecisionRecorder(species, int(serial))
    go_to(run, min(first, run.plan.ticks), [recorder])
    run.live_on(min(first + SPAN, run.plan.ticks), [recorder])
    return {at: text for at, text in recorder.texts.items() if at > first}
