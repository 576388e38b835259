"""The reward of the agent in focus."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.census import FocusSamples
from ecology.observers.panels.base import HALF_PLOT, LifePanel, scalars, series, time_columns


class Reward(LifePanel):
    """Draws the reward of the last ticks."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curve."""
        series(rec, f"{self.base}/reward", ["reward"], [colours.PALETTE[1]])

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw it, where it is known."""
        if life.reward is not None:
            scalars(rec, f"{self.base}/reward", time_columns(life.tick), life.reward[:, None])

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot; after the fact, of many, no rewards are known."""
        if not self.scene.full and self.name in self.scene.chosen:
            return []
        return [self.recent("reward", "reward", HALF_PLOT, legend=False)]
