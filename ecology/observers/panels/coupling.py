"""Coupling matrix: how much each agent feels each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Panel, Watch, set_times, text
from ecology.observers.scene import INK, MAP_SCALE

NAMED = 12  # rows and columns up to which names stand beside them
COUPLED = 128  # agents of a species whose coupling is drawn, at most


class Coupling(Panel):
    """Draws the matrix of a species with empathy, at intervals."""

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
        if not (rows.size and columns.size):
            return None
        feels = [watch.env.name_of(groups[self.name].slots.start + int(row)) for row in rows]
        return (
            weight[np.ix_(rows, columns)].astype(np.float32),
            feels,
            [watch.env.name_of(int(others[c])) for c in columns],
        )

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the matrices, with a scale, and with names where there is room for them."""
        entity = f"population/coupling/{self.name}"
        for s, found in zip(batch.samples, batch.of(self), strict=True):
            if found is None:
                continue
            weight, feels, felt = found
            low, high = min(float(weight.min()), 0.0), max(float(weight.max()), 1e-9)
            set_times(rec, s["tick"], s["time"])
            rec.log(entity, rr.Tensor(weight, dim_names=("feels", "felt")))
            rec.log(f"{entity}/image", rr.Image(colours.shade(MAP_SCALE, weight, low, high)))
            (n, m), words = weight.shape, [f"dark {low:.2f}, bright {high:.2f}"]
            spots = [(m / 2, -0.10 * n)]
            if max(n, m) <= NAMED:
                spots += [(-0.14 * m, i + 0.45) for i in range(n)] + [(j + 0.5, n + 0.05 * n) for j in range(m)]
                words += [*feels, *felt]
            rec.log(f"{entity}/names", *text(spots, words, [INK] * len(words)))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the matrix: rows feel, columns are felt."""
        entity = f"/population/coupling/{self.name}"
        name = f"{self.name}: who (row) feels whom (column)"
        return [rrb.Spatial2DView(origin=entity, contents=[f"+ {entity}/image", f"+ {entity}/names"], name=name)]
