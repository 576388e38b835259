"""The drive of the agent in focus: its own, what it feels of others, and the mean of its species."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.census import Life
from ecology.observers.panels.base import LifePanel, called, plot, scalars, series, time_columns


class Drive(LifePanel):
    """Draws the drive over the whole life."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        series(rec, f"{self.base}/drive", *self._curves())

    def _curves(self) -> tuple[list[str], list[colours.Colour]]:
        """Return names and colours of the curves."""
        many, feels = self.scene.groups[self.name].size > 1, self.species.empathy is not None
        who = self.scene.chosen.get(self.name, "in focus" if many else self.scene.names[self.name])
        words = [who, *(["its own", "felt of others"] * feels), *(["mean of the species"] * many)]
        felt = [colours.PALETTE[1], colours.PALETTE[5]] * feels
        return words, [(240, 240, 240), *felt, colours.PALETTE[0]]

    def draw_life(self, rec: rr.RecordingStream, life: Life) -> None:
        """Draw them."""
        parts = [life.drive, *([] if life.own is None else [life.own, life.drive - life.own])]
        parts += [] if life.mean is None else [life.mean]
        scalars(rec, f"{self.base}/drive", time_columns(life.tick, life.time), np.stack(parts, axis=1))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot."""
        # after the fact, of many, what is felt of others is not known
        known = self.scene.full or self.name not in self.scene.chosen or self.species.empathy is None
        words, shades = self._curves()
        short = [word.removesuffix(" of the species").removesuffix(" of others").removeprefix("its ") for word in words]
        title = ("drive" if known else "own drive") + (f": {called(short[1:], shades[1:])}" if len(words) > 1 else "")
        return [plot(f"/{self.base}/drive", title)]
