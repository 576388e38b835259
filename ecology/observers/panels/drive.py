"""The drive of the agent in focus: its own, what it feels of others, and the mean of its species."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.census import FocusSamples
from ecology.observers.panels.base import Ends, LifePanel, name_shades, scalars, series, time_columns
from ecology.observers.scene import Scene

TALL = 150  # points, of the plot on a small screen


class Drive(LifePanel):
    """Draws the drive over the whole life."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._ends = Ends(f"{self.base}/drive", TALL)

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        series(rec, f"{self.base}/drive", *self._curves())
        self._ends.open(rec)

    def _curves(self) -> tuple[list[str], list[colours.Colour]]:
        """Return names and colours of the curves."""
        many, feels = self.scene.groups[self.name].size > 1, self.species.empathy is not None
        who = self.scene.chosen.get(self.name, "in focus" if many else self.scene.names[self.name])
        words = [who, *(["its own", "felt of others"] * feels), *(["mean of the species"] * many)]
        felt = [colours.PALETTE[1], colours.PALETTE[5]] * feels
        return words, [(240, 240, 240), *felt, colours.PALETTE[0]]

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw them."""
        parts = [life.drive, *([] if life.own is None else [life.own, life.drive - life.own])]
        parts += [] if life.mean is None else [life.mean]
        value = np.stack(parts, axis=1)
        scalars(rec, f"{self.base}/drive", time_columns(life.tick), value)
        self._ends.draw(rec, life.tick, value)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot."""
        # after the fact, of many, what is felt of others is not known
        known = self.scene.full or self.name not in self.scene.chosen or self.species.empathy is None
        words, shades = self._curves()
        short = [word.removesuffix(" of the species").removesuffix(" of others").removeprefix("its ") for word in words]
        title = "drive" if known else "own drive"
        if len(words) == 1:
            return [self.plot(f"/{self.base}/drive", title)]
        # a narrow tab would cut off the colours: they stand below it
        legend = name_shades(short[1:], shades[1:]).replace("light blue", "blue")
        return [rrb.Vertical(self.plot(f"/{self.base}/drive", legend), name=title)]
