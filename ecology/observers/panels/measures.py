"""The scenario's own measures, its cues and the means of traits."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import census, colours
from ecology.observers.panels.base import Batch, Ends, Panel, Watch, population_height, scalars, series
from ecology.observers.scene import Scene


class Measures(Panel):
    """Draws a curve for each."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._ends = Ends("population/measures", population_height(scene))

    def is_there(self) -> bool:
        """Return whether there are any, in a world of several."""
        return self.scene.crowd and bool(self.scene.measures)

    def sample(self, watch: Watch) -> Any:
        """Return their values, (K,)."""
        return census.measure_world(watch.env.scenario, watch.state)

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        cues = {cue.name for cue in self.scene.scenario.cues}
        series(rec, "population/measures", self.scene.measures, colours.PALETTE, steps=set(self.scene.measures) <= cues)
        self._ends.open(rec)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        value = np.stack(batch.of(self))
        scalars(rec, "population/measures", batch.times, value)
        self._ends.draw(rec, batch.ticks, value)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot."""
        measures = self.scene.measures
        name = measures[0] if len(measures) == 1 else "measures and cues"
        return [self.plot("/population/measures", name, legend=len(measures) > 1)]
