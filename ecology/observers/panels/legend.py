"""The legend above the arena: the colour scale of the drive, and what else has a colour."""

from __future__ import annotations

import numpy as np
import rerun as rr

from ecology.observers import colours
from ecology.observers.panels.base import Panel, lay, write
from ecology.observers.scene import DRIVE_SCALE


class Legend(Panel):
    """Writes the legend once."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Write the colour scale above the arena, and above it the rest."""
        scene = self.scene
        low, high = np.array(scene.scenario.arena.extent)
        size = scene.size
        top, wide, tall = high[1] + 0.06 * size, 0.3 * size, 0.02 * size
        bar = np.tile(colours.scale(DRIVE_SCALE), (2, 1, 1))  # (2, SHADES, 3)
        lay(rec, "world/legend/drive", (float(low[0]), float(top)), (wide / bar.shape[1], tall / 2))
        rec.log("world/legend/drive", rr.Image(bar), static=True)
        what = "heading: drive 0" if scene.mixed else "body: drive 0"
        places = [(low[0] + 0.02 * size, top), (low[0] + wide, top)]
        write(rec, "world/legend/numbers", places, [what, f"{colours.highest_drive(scene.scenario):.1f}"])
        for i, row in enumerate(scene.legend_rows()):
            y = high[1] + (0.12 + 0.055 * i) * size
            xs = np.array([low[0] + at + 0.012 * size for at, _, _ in row])
            shades = [shade for _, _, shade in row]
            dots = np.stack([xs, np.full(len(row), y)], axis=1)
            rec.log(f"world/legend/{i}", rr.Points2D(dots, radii=0.009 * size, colors=shades), static=True)
            middle = [(x + (0.02 + 0.006 * len(word)) * size, y + 0.022 * size)
                      for x, (_, word, _) in zip(xs, row, strict=True)]  # fmt: skip
            write(rec, f"world/legend/{i}/words", middle, [word for _, word, _ in row])
