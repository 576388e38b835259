"""Who feels whom, and how much."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers.panels.base import Batch, Panel, Watch, set_times

COUPLED = 128  # agents of a species whose coupling is drawn, at most


class Coupling(Panel):
    """Draws the matrix of a species with empathy, now and then."""

    each = True

    def is_there(self) -> bool:
        """Return whether the species has empathy, in a world of several."""
        return self.scene.crowd and self.name in self.scene.coupled

    def sample(self, watch: Watch) -> Any:
        """Return the weights with which the first living feel the first living of each species, (n, m)."""
        found = watch.env.coupling(self.name) if watch.sparse else None
        if found is None:
            return None
        (weight, others), alive, groups = found, watch.state.alive, self.scene.groups
        rows = np.flatnonzero(alive[groups[self.name].slots])[:COUPLED]
        living = [others[(others >= g.slots.start) & (others < g.slots.stop)] for g in groups.values()]
        columns = np.searchsorted(others, np.concatenate([slots[alive[slots]][:COUPLED] for slots in living]))
        return weight[np.ix_(rows, columns)].astype(np.float32) if rows.size and columns.size else None

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the matrices."""
        for s, weight in zip(batch.samples, batch.of(self), strict=True):
            if weight is not None:
                set_times(rec, s["tick"], s["time"])
                rec.log(f"population/coupling/{self.name}", rr.Tensor(weight, dim_names=("feels", "felt")))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the matrix."""
        name = self.name
        return [rrb.TensorView(origin=f"/population/coupling/{name}", name=f"{name}: who (row) feels whom (column)")]
