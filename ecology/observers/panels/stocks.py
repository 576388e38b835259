"""The stocks of the finite resources."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import census, colours
from ecology.observers.panels.base import Batch, Ends, Panel, Watch, population_height, scalars, series
from ecology.observers.scene import Scene


class Stocks(Panel):
    """Draws a curve per finite resource, over all its patches."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._ends = Ends("population/stocks", population_height(scene))

    def is_there(self) -> bool:
        """Return whether any is finite, in a world of several."""
        return self.scene.crowd and bool(self.scene.stocked)

    def sample(self, watch: Watch) -> Any:
        """Return the stocks, (K,)."""
        return census.stocks(self.scene.scenario, watch.state)

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        kinds, shades = self.scene.scenario.resources, colours.resource_colours(self.scene.scenario)
        food = {r.name: shade for r, shade in zip(kinds, shades, strict=True)}
        series(rec, "population/stocks", self.scene.stocked, [food[n] for n in self.scene.stocked])
        self._ends.open(rec)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        value = np.stack(batch.of(self))
        scalars(rec, "population/stocks", batch.times, value)
        self._ends.draw(rec, batch.ticks, value)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot."""
        return [self.plot("/population/stocks", "stocks", legend=len(self.scene.stocked) > 1)]
