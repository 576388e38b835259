"""How well f of the agent in focus predicts, by component of zeta."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Panel, Watch, scalars, series


class Error(Panel):
    """Draws the error of f: 0 is perfect, 1 as bad as to predict no change."""

    each = True

    def is_there(self) -> bool:
        """Return whether the mind of the species shows its decisions."""
        return self.scene.decides[self.name]

    def sample(self, watch: Watch) -> Any:
        """Return the error (D,), None where nothing is decided."""
        decision = watch.decision(self.name)
        return None if watch.tick is None or decision is None else np.asarray(decision.error, float)

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        names = self.scene.groups[self.name].layout.names
        series(rec, f"learning/{self.name}/error", names, [colours.need_colour(i) for i in range(len(names))])

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        found = batch.of(self)
        at = [i for i, each in enumerate(found) if each is not None]
        if at:
            scalars(rec, f"learning/{self.name}/error", batch.at(at), np.stack([found[i] for i in at]))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot, of the focus alone."""
        if self.name in self.scene.chosen:
            return []
        return [self.plot(f"/learning/{self.name}/error", "error of f, 1: as bad as no change", legend=True)]
