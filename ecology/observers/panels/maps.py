"""Deviation maps: J over the arena where one need is at its worst and all else is well."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import maps
from ecology.observers.panels.base import Batch, Panel, Watch, bounds, draw_map, lay, set_tick
from ecology.observers.scene import BACKGROUND, Scene


class Maps(Panel):
    """Draws the maps of a species' agent in focus, at intervals and when the focus changes."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._last = -1  # tick of the last map

    def is_there(self) -> bool:
        """Return whether the mind of the species has a J that can be mapped."""
        return bool(self.scene.mapped.get(self.name))

    def sample(self, watch: Watch) -> Any:
        """Return the maps (k, rows, columns) where they are due."""
        every = self.scene.maps_every  # at its multiples, also in a run that is resumed between two of them
        due = watch.turned or watch.state.tick // every > self._last // every
        return self._map(watch) if due else None

    def final(self, watch: Watch) -> Any:
        """Return the maps as they are at the end."""
        state = watch.state
        return self._map(watch) if state.tick > self._last and state.tick % self.scene.every == 0 else None

    def _map(self, watch: Watch) -> np.ndarray | None:
        self._last = watch.state.tick
        group, row = self.scene.groups[self.name], watch.row(self.name)
        if row < 0:
            return None
        return maps.deviation_maps(self.species, group, watch.minds[self.name], row, self.scene.grid)

    def open(self, rec: rr.RecordingStream) -> None:
        """Lay the maps on the plane."""
        for i in maps.mapped_needs(self.species):
            lay(rec, f"{self._folder(i)}/image", self.scene.grid.corner, (self.scene.grid.cell,) * 2)

    def _folder(self, need: int) -> str:
        return f"world/maps/{self.name}/{self.species.needs[need].name}"

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the maps that were due."""
        for s, found in zip(batch.samples, batch.of(self), strict=True):
            if found is None or not np.isfinite(found).any():
                continue
            set_tick(rec, s["tick"])
            for i, value in zip(maps.mapped_needs(self.species), found, strict=True):
                self._draw_one(rec, i, value)

    def _draw_one(self, rec: rr.RecordingStream, need: int, value: np.ndarray) -> None:
        numbers = rr.AnyValues(
            deviation=pa.array(value.astype(np.float32).reshape(-1)), shape=np.array(value.shape, np.int32)
        )
        draw_map(rec, self._folder(need), self.scene.grid, value, numbers)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return a view per need."""
        views: list[rrb.View | rrb.Container] = []
        for i in maps.mapped_needs(self.species):
            need = self.species.needs[i]
            paths = ["+ /world/walls", "+ /world/resources", "+ /world/resources/rim"]
            views.append(
                rrb.Spatial2DView(
                    origin="/",
                    contents=[*paths, f"+ /world/maps/{self.name}/{need.name}/**"],
                    name=need.name,
                    background=BACKGROUND,
                    visual_bounds=bounds(self.scene, 0.19, 0.03),
                )
            )
        return views
