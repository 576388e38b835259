"""How many of every species were born and have died so far."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Ends, Panel, Watch, scalars, series
from ecology.observers.scene import Scene

TALL = 96  # points, of the plot on a small screen


class Flow(Panel):
    """Draws two curves per species."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._ends = Ends("population/flow", TALL)

    def is_there(self) -> bool:
        """Return whether there is more to be shown than one agent."""
        return self.scene.crowd

    def sample(self, watch: Watch) -> Any:
        """Return births and deaths by species, (2 S,)."""
        index = [group.index for group in self.scene.groups.values()]
        return np.concatenate([watch.census.born[index], watch.census.died[index]]).astype(float)

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        names, shades = list(self.scene.groups), [self.scene.colour(name) for name in self.scene.groups]
        dim = [colours.darken(shade, 0.55) for shade in shades]
        words = [f"{n} born" for n in names] + [f"{n} died" for n in names]
        series(rec, "population/flow", words, shades + dim, steps=True)
        self._ends.open(rec)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        value = np.stack(batch.of(self))
        scalars(rec, "population/flow", batch.times, value)
        self._ends.draw(rec, batch.ticks, np.append(value.ravel(), 1.0)[:, None])  # at least one

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot where anybody can be born or die."""
        if self.scene.alone or not (self.scene.grows or "died" in self.scene.marks):
            return []
        died = "born (bright) and died (dim) so far" if self.scene.grows else "died so far"
        return [self.plot("/population/flow", died)]
