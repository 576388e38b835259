"""The deviation x - x* of every need of the agent in focus."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.census import FocusSamples
from ecology.observers.panels.base import LifePanel, scalars, series, time_columns


class Deviation(LifePanel):
    """Draws a curve per need, in its own unit."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        needs = self.species.needs
        shades = [colours.need_colour(i) for i in range(len(needs))]
        series(rec, f"{self.base}/deviation", [need.name for need in needs], shades)

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw them."""
        scalars(rec, f"{self.base}/deviation", time_columns(life.tick), life.internal - life.target)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot."""
        return [self.recent("deviation", "x - x*")]
