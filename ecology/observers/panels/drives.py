"""The drive of the living of every species: mean and spread."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Ends, Panel, population_height, scalars, series
from ecology.observers.scene import Scene


class Drives(Panel):
    """Draws three curves per species."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._ends = Ends("population/drive", population_height(scene))
        self._shown = {n: group for n, group in scene.groups.items() if not scene.idle(n)}

    def is_there(self) -> bool:
        """Return whether there is more to be shown than one agent."""
        return self.scene.crowd and bool(self._shown)

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        names, shades = list(self._shown), [self.scene.colour(name) for name in self._shown]
        words = [word for n in names for word in (n, f"{n} - sd", f"{n} + sd")]
        thrice = [each for shade in shades for each in (shade, *[colours.darken(shade, 0.55)] * 2)]
        series(rec, "population/drive", words, thrice, [2.0, 0.8, 0.8] * len(names))
        self._ends.open(rec)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        curves = []
        for group in self._shown.values():
            drive = batch.column["drive"][:, group.slots]
            lives = np.isfinite(drive)
            many, none = lives.sum(axis=1), np.full(len(drive), np.nan)
            mean = np.divide(np.where(lives, drive, 0.0).sum(axis=1), many, out=none.copy(), where=many > 0)
            off = np.where(lives, drive - mean[:, None], 0.0)
            spread = np.sqrt(np.divide((off**2).sum(axis=1), many, out=none.copy(), where=many > 0))
            curves += [mean, mean - spread, mean + spread]
        value = np.stack(curves, axis=1)
        scalars(rec, "population/drive", batch.times, value)
        self._ends.draw(rec, batch.ticks, value)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot, of several agents."""
        return [] if self.scene.alone else [self.plot("/population/drive", "drive of the living: mean, one sd")]
