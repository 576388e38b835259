"""Deviation maps: J over the arena where one need is at its worst and all else is well."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours, maps
from ecology.observers.panels.base import Batch, Panel, Watch, bounds, lay, set_times, text
from ecology.observers.scene import BACKGROUND, INK, MAP_SCALE, Scene


class Maps(Panel):
    """Draws the maps of a species' agent in focus, at intervals and when the focus changes."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._next, self._last = 0, -1  # ticks of the next map and of the last one

    def is_there(self) -> bool:
        """Return whether the mind of the species has a J that can be mapped."""
        return bool(self.scene.mapped.get(self.name))

    def sample(self, watch: Watch) -> Any:
        """Return the maps (k, rows, columns) where they are due."""
        return self._mapped(watch) if watch.turned or watch.state.tick >= self._next else None

    def final(self, watch: Watch) -> Any:
        """Return the maps as they are at the end."""
        state = watch.state
        return self._mapped(watch) if state.tick > self._last and state.tick % self.scene.every == 0 else None

    def _mapped(self, watch: Watch) -> np.ndarray | None:
        self._next, self._last = watch.state.tick + self.scene.maps_every, watch.state.tick
        group, row = self.scene.groups[self.name], watch.row(self.name)
        if row < 0:
            return None
        return maps.deviation_maps(self.species, group, watch.minds[self.name], row, self.scene.grid)

    def open(self, rec: rr.RecordingStream) -> None:
        """Lay the maps on the plane."""
        for i in maps.mapped_needs(self.species):
            lay(rec, self._image(i), self.scene.grid.corner, (self.scene.grid.cell,) * 2)

    def _image(self, need: int) -> str:
        return f"world/maps/{self.name}/{self.species.needs[need].name}/image"

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the maps that were due."""
        for s, found in zip(batch.samples, batch.of(self), strict=True):
            if found is None or not np.isfinite(found).any():
                continue
            set_times(rec, s["tick"], s["time"])
            for i, value in zip(maps.mapped_needs(self.species), found, strict=True):
                self._draw_one(rec, i, value)

    def _draw_one(self, rec: rr.RecordingStream, need: int, value: np.ndarray) -> None:
        low, high = float(np.nanmin(value)), float(np.nanmax(value))
        image = colours.shade(MAP_SCALE, value, low, high)
        image[~np.isfinite(value)] = BACKGROUND
        rec.log(
            self._image(need),
            rr.Image(image, draw_order=-10),
            rr.AnyValues(
                deviation=pa.array(value.astype(np.float32).reshape(-1)),
                shape=np.array(value.shape, np.int32),
            ),
        )
        x, y = self.scene.grid.corner
        wide, tall = value.shape[1] * self.scene.grid.cell, value.shape[0] * self.scene.grid.cell
        ends = [(x + share * wide, y - 0.03 * tall) for share in (0.2, 0.8)]
        words = [f"dark {low:.2f}", f"bright {high:.2f}"]
        rec.log(f"{self._image(need).removesuffix('image')}range", *text(ends, words, [INK] * 2))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return a view per need."""
        views: list[rrb.View | rrb.Container] = []
        for i in maps.mapped_needs(self.species):
            need = self.species.needs[i]
            there = ["+ /world/walls", "+ /world/resources", "+ /world/resources/rim"]
            views.append(
                rrb.Spatial2DView(
                    origin="/",
                    contents=[*there, f"+ /world/maps/{self.name}/{need.name}/**"],
                    name=need.name,
                    background=BACKGROUND,
                    visual_bounds=bounds(self.scene, 0.19, 0.03),
                )
            )
        return views
