"""The drive of the living of every species: mean and spread."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Panel, plot, scalars, series


class Drives(Panel):
    """Draws three curves per species."""

    def is_there(self) -> bool:
        """Return whether there is more to be shown than one agent."""
        return self.scene.crowd

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        names, shades = list(self.scene.groups), [self.scene.colour(name) for name in self.scene.groups]
        words = [word for n in names for word in (n, f"{n} - sd", f"{n} + sd")]
        thrice = [each for shade in shades for each in (shade, *[colours.shaded(shade, 0.55)] * 2)]
        series(rec, "population/drive", words, thrice, [2.0, 0.8, 0.8] * len(names))

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        curves = []
        for group in self.scene.groups.values():
            drive = batch.column["drive"][:, group.slots]
            lives = np.isfinite(drive)
            many, none = lives.sum(axis=1), np.full(len(drive), np.nan)
            mean = np.divide(np.where(lives, drive, 0.0).sum(axis=1), many, out=none.copy(), where=many > 0)
            off = np.where(lives, drive - mean[:, None], 0.0)
            spread = np.sqrt(np.divide((off**2).sum(axis=1), many, out=none.copy(), where=many > 0))
            curves += [mean, mean - spread, mean + spread]
        scalars(rec, "population/drive", batch.times, np.stack(curves, axis=1))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot, of several agents."""
        return [] if self.scene.alone else [plot("/population/drive", "drive of the living: mean, one sd")]
