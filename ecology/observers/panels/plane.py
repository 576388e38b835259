"""The arena itself: floor, walls and axes."""

from __future__ import annotations

import numpy as np
import rerun as rr

from ecology.ground.outline import drawn_lines
from ecology.observers import maps
from ecology.observers.panels.base import Panel, lay, write
from ecology.observers.scene import BACKGROUND, FAINT, FLOOR, WALL


class Plane(Panel):
    """Lays out the plane with y upwards, and draws everything in it that does not change."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Draw the arena."""
        scene, arena = self.scene, self.scene.scenario.arena
        rec.log("world", rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]), static=True)
        corners, shade = np.array(arena.vertices, float), FAINT if arena.torus else WALL
        rec.log("world/walls", rr.LineStrips2D(drawn_lines(arena), colors=[shade], draw_order=5), static=True)
        fine = maps.cover(arena, 400)
        floor = np.where(fine.inside[..., None], FLOOR, BACKGROUND).astype(np.uint8)
        lay(rec, "world/floor", fine.corner, (fine.cell, fine.cell))
        rec.log("world/floor", rr.Image(floor, draw_order=-30), static=True)
        # axes: a number at round places below and left of the arena
        low, high = corners.min(axis=0), corners.max(axis=0)
        step = _round_step(scene.size / 8)
        for axis, name in enumerate("xy"):
            values = np.arange(np.ceil(low[axis] / step) * step, high[axis] + 1e-9, step)
            values = values if len(values) > 1 else np.array([low[axis], high[axis]])
            places = np.tile(low - 0.035 * scene.size, (len(values), 1))
            places[:, axis] = values
            words = [f"{name} {value:g}" if i == 0 else f"{value:g}" for i, value in enumerate(values)]
            # an entity each, found by trial: with one, the viewer writes "No data available" where no body is drawn
            write(rec, f"world/axes/{name}", places, words)


def _round_step(least: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at least `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * next(m for m in (1, 2, 5, 10) if m * power >= least * (1 - 1e-9)))
