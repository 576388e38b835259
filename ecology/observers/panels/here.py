"""Map of J over the arena, for the present state of the agent in focus at every place."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import maps
from ecology.observers.panels.base import Batch, Panel, Watch, bounds, draw_map, lay, set_tick
from ecology.observers.panels.bodies import Bodies
from ecology.observers.scene import BACKGROUND, Scene

CELLS = 40  # along the longer side of the arena


class Here(Panel):
    """Draws J at the state of the agent in focus, with the position replaced by that of each cell."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._grid = maps.cover(scene.scenario.arena, CELLS)

    def is_there(self) -> bool:
        """Return whether the mind of the species has a J that can be mapped."""
        return bool(self.scene.mapped.get(self.name))

    def sample(self, watch: Watch) -> Any:
        """Return J (rows, columns) where it is looked at closely, NaN outside; else None."""
        row = watch.row(self.name)
        if watch.tick is None or row < 0 or not watch.closely:
            return None
        names, inside = self.scene.groups[self.name].layout.names, self._grid.inside
        rows, columns = np.nonzero(inside)
        zeta = np.repeat(watch.tick.observations[self.name][row : row + 1], len(rows), axis=0)
        zeta[:, names.index("x")], zeta[:, names.index("y")] = self._grid.x[columns], self._grid.y[rows]
        value = watch.minds[self.name].deviation(row, zeta)
        if value is None:
            return None
        found = np.full(inside.shape, np.nan, np.float32)
        found[rows, columns] = value
        return found

    def open(self, rec: rr.RecordingStream) -> None:
        """Lay it on the plane."""
        lay(rec, f"world/here/{self.name}/image", self._grid.corner, (self._grid.cell,) * 2)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the maps."""
        for s, value in zip(batch.samples, batch.of(self), strict=True):
            if value is None or not np.isfinite(value).any():
                continue
            set_tick(rec, s["tick"])
            draw_map(rec, f"world/here/{self.name}", self._grid, value)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the map with the agent, its plan and its forecast in it."""
        paths = ["walls", "resources", "resources/rim", f"here/{self.name}/**", f"agents/{self.name}"]
        paths += [f"plan/{self.name}", f"forecast/{self.name}"]
        return [
            rrb.Spatial2DView(
                origin="/",
                contents=[f"+ /world/{each}" for each in paths],
                name="now",
                background=BACKGROUND,
                visual_bounds=bounds(self.scene, 0.19, 0.03),
                overrides=Bodies(self.scene, self.name).overrides(),  # its heading begins where it is
            )
        ]
