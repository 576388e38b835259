"""The losses that a species' minds report, mean over the living."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import census, colours
from ecology.observers.panels.base import Batch, Panel, Watch, scalars, series
from ecology.observers.scene import Scene, losses


class Reported(Panel):
    """Draws some of the numbers that a species' minds report, mean over the living."""

    each = True
    part: str  # of the entity

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self.entity = f"learning/{name}/{self.part}"

    @property
    def words(self) -> list[str]:
        """Return the names of the numbers that are drawn."""
        return losses(self.scene.reported[self.name])[self.part == "numbers"]

    def is_there(self) -> bool:
        """Return whether there are any."""
        return bool(self.words)

    def sample(self, watch: Watch) -> Any:
        """Return the mean of each over the living, (K,)."""
        report, living = watch.report(self.name), watch.state.alive[self.scene.groups[self.name].slots]
        known = [np.asarray(report.get(word, np.nan)) * np.ones(len(living)) for word in self.words]
        return np.array([census.mean(value[living]) for value in known], dtype=float)

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        series(rec, self.entity, self.words, colours.PALETTE)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        scalars(rec, self.entity, batch.times, self.scale(np.stack(batch.of(self))))

    def scale(self, value: np.ndarray) -> np.ndarray:
        """Return what is drawn of the numbers (n, K)."""
        return value


class Losses(Reported):
    """Draws losses by their logarithm."""

    part = "losses"

    def scale(self, value: np.ndarray) -> np.ndarray:
        """Return log10 of the losses."""
        return np.log10(np.where(value > 0, value, np.nan))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot."""
        return [
            self.plot(f"/{self.entity}", f"log10 loss {', '.join(word.removeprefix('loss_') for word in self.words)}")
        ]
