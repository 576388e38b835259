"""Trails: where bodies were at every tick since the last sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Panel, Watch, last
from ecology.observers.scene import Scene

TRAIL_TICKS = 100  # length of a trail


class Trails(Panel):
    """Draws the trail of every agent if there are few, otherwise that of the focus."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._steps: list[np.ndarray] = []

    def _places(self, watch: Watch) -> np.ndarray:
        """Return where those with a trail are, (k, 2): every slot, or the focus; the dead are nowhere."""
        state = watch.state
        if self.scene.few:
            rows = self.scene.groups[self.name].slots
            return np.where(state.alive[rows, None], state.position[rows], np.nan).astype(np.float32)
        slot = watch.focus.slots[self.name]
        place = state.position[slot : slot + 1] if slot >= 0 else np.full((1, 2), np.nan)
        return place.astype(np.float32)

    def follow(self, watch: Watch) -> None:
        """Note a tick between two samples."""
        if not watch.sampled:
            self._steps.append(self._places(watch))

    def sample(self, watch: Watch) -> Any:
        """Return the places since the last sample, (ticks, k, 2)."""
        found = np.stack([*self._steps, self._places(watch)])
        self._steps = []
        return found

    def open(self, rec: rr.RecordingStream) -> None:
        """Give it its size and colour."""
        colour, radius = self.scene.colour(self.name), self.scene.radius(self.species)
        trail = rr.Points2D.from_fields(radii=0.25 * radius, colors=[colours.darken(colour, 0.6)], draw_order=10)
        rec.log(f"world/trail/{self.name}", trail, static=True)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the places since the sample before each."""
        steps = [each.reshape(-1, 2) for each in batch.of(self)]
        dots = rr.Points2D.columns(positions=np.concatenate(steps)).partition([len(s) for s in steps])
        rec.send_columns(f"world/trail/{self.name}", batch.times, dots)

    def overrides(self) -> dict[Any, Any]:
        """Show the trails of the last ticks alone."""
        return {f"world/trail/{self.name}": last(TRAIL_TICKS)}
