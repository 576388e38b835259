"""Fields that shine through the floor, and closed doors."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from ecology.observers import places
from ecology.observers.panels.base import Batch, Panel, Watch, lay, set_tick
from ecology.observers.scene import INK, Scene


class Fields(Panel):
    """Draws fields and doors again where they have changed."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._grid = places.grid_of(scene.scenario.arena)
        self._fields: dict[str, np.ndarray] = {}  # as they were last drawn
        self._doors = b""

    def is_there(self) -> bool:
        """Return whether there are fields or doors."""
        return bool(self.scene.scenario.fields or self.scene.scenario.arena.doors)

    def sample(self, watch: Watch) -> Any:
        """Return how strong every field is, and the closed doors."""
        arena = self.scene.scenario.arena
        levels = places.levels(watch.env.world.model, watch.state, self._grid) if self.scene.scenario.fields else {}
        return levels, places.closed_doors(arena, watch.state.doors)

    def open(self, rec: rr.RecordingStream) -> None:
        """Lay the images of the fields on the plane."""
        for each in self.scene.scenario.fields:
            lay(rec, f"world/fields/{each.name}", self._grid.corner, (self._grid.cell, self._grid.cell))

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw what has changed."""
        for s, (levels, lines) in zip(batch.samples, batch.of(self), strict=True):
            changed = [
                (i, name)
                for i, (name, level) in enumerate(levels.items())
                if name not in self._fields or not np.array_equal(level, self._fields[name])
            ]
            doors = b"".join(line.tobytes() for line in lines)
            set_tick(rec, s["tick"])
            for i, name in changed:
                rec.log(f"world/fields/{name}", rr.Image(places.image(levels[name], i), draw_order=-20 + i))
                self._fields[name] = levels[name]
            if doors != self._doors:
                rec.log("world/doors", rr.LineStrips2D(lines, colors=[INK], draw_order=5))
                self._doors = doors
