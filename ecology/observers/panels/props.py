"""Lines that a scenario adds to the picture: a corridor, food in hand, a trap."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import rerun as rr

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Panel, Watch, set_tick
from ecology.observers.scene import Scene


class Props(Panel):
    """Draws the lines of `Scenario.props` again where they have changed."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._drawn: dict[str, list[np.ndarray]] = {}  # as they were last drawn

    def is_there(self) -> bool:
        """Return whether the scenario names any."""
        return self.scene.has_props

    def sample(self, watch: Watch) -> Any:
        """Return the lines by name."""
        props = watch.env.scenario.props
        found = {} if props is None else props(watch.state)
        return {name: [np.asarray(line, float).reshape(-1, 2) for line in lines] for name, lines in found.items()}

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw what has changed."""
        for s, found in zip(batch.samples, batch.of(self), strict=True):
            for i, (name, lines) in enumerate(found.items()):
                before = self._drawn.get(name)
                if before is not None and len(before) == len(lines) and all(map(np.array_equal, before, lines)):
                    continue
                set_tick(rec, s["tick"])
                shade = colours.PALETTE[(3 + i) % len(colours.PALETTE)]
                thick = rr.Radius.ui_points(1.6)
                rec.log(
                    f"world/props/{re.sub(r'[^A-Za-z0-9]', '_', name)}",
                    rr.LineStrips2D(lines, colors=[shade], radii=thick, draw_order=23),
                )
                self._drawn[name] = lines
