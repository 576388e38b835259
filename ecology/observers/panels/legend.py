"""Legend above the arena: the colour scale of the drive, and all other colours."""

from __future__ import annotations

import numpy as np
import rerun as rr

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Panel, lay, set_tick, text, write
from ecology.observers.scene import DRIVE_SCALE, INK, Scene


class Legend(Panel):
    """Writes the legend once, and the top of the colour scale again where it changes."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._top = -1.0  # as it was last written

    def open(self, rec: rr.RecordingStream) -> None:
        """Write the colour scale above the arena, and above it the rest."""
        scene = self.scene
        low, high = np.array(scene.scenario.arena.extent)
        size, self._top = scene.legend_unit, -1.0
        top, wide, tall = high[1] + 0.06 * size, 0.3 * size, 0.02 * size
        bar = np.tile(colours.scale(DRIVE_SCALE), (2, 1, 1))  # (2, SHADES, 3)
        lay(rec, "world/legend/drive", (float(low[0]), float(top)), (wide / bar.shape[1], tall / 2))
        rec.log("world/legend/drive", rr.Image(bar), static=True)
        for i, row in enumerate(scene.legend_rows()):
            y = high[1] + (0.12 + 0.055 * i) * size
            xs = np.array([low[0] + at + 0.012 * size for at, _, _ in row])
            shades = [shade for _, _, shade in row]
            dots = np.stack([xs, np.full(len(row), y)], axis=1)
            rec.log(f"world/legend/{i}", rr.Points2D(dots, radii=0.009 * size, colors=shades), static=True)
            middle = [(x + (0.03 + 0.009 * len(word)) * size, y + 0.022 * size)
                      for x, (_, word, _) in zip(xs, row, strict=True)]  # fmt: skip
            write(rec, f"world/legend/{i}/words", middle, [word for _, word, _ in row])

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Write the ends of the colour scale where its top has changed."""
        scene = self.scene
        (low, _), (_, high) = scene.scenario.arena.extent
        what = "heading: drive 0" if scene.mixed else "body: drive 0"
        y = high + 0.06 * scene.legend_unit
        places = [(low + 0.05 * scene.legend_unit, y), (low + 0.3 * scene.legend_unit, y)]
        for s in batch.samples:
            if s["top"] == self._top:
                continue
            self._top = s["top"]
            set_tick(rec, s["tick"])
            words = text(places, [what, f"{self._top:g}"], [INK] * 2)
            rec.log("world/legend/numbers", *words, rr.AnyValues(top=self._top))
