"""Number of living agents of every species."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers.panels.base import Batch, Ends, Panel, population_height, scalars, series
from ecology.observers.scene import Scene


class Count(Panel):
    """Draws a curve per species."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._ends = Ends("population/count", population_height(scene))

    def is_there(self) -> bool:
        """Return whether there is more to be shown than one agent."""
        return self.scene.crowd

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        names = list(self.scene.groups)
        series(
            rec, "population/count", names, [self.scene.colour(name) for name in names], [2.0] * len(names), steps=True
        )
        self._ends.open(rec)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        drive = batch.column["drive"]
        count = [np.isfinite(drive[:, g.slots]).sum(axis=1).astype(float) for g in self.scene.groups.values()]
        value = np.stack(count, axis=1)
        scalars(rec, "population/count", batch.times, value)
        self._ends.draw(rec, batch.ticks, value)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot if agents can be born or die."""
        if self.scene.alone or not (self.scene.grows or "died" in self.scene.marks):
            return []
        return [self.plot("/population/count", "living")]
