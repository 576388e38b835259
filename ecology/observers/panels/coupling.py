"""Coupling matrix: how much each agent feels each other."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.panels.base import Batch, Panel, Watch, set_tick, text
from ecology.observers.scene import INK, MAP_SCALE

WIDE = (2.0, 1.0)  # width and height of the rectangle in which a matrix is drawn
ROWS, COLUMNS = 4, 6  # names beside and below it, at most
FEW = 2  # names below one of more columns, whose cells are narrow
UP = 0.14  # by which a word begins above the middle of its cell
PIXELS = 8  # of a cell
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
        """Draw the matrices in a rectangle of one size, with a scale, names, and numbers where there is room."""
        entity = f"population/coupling/{self.name}"
        for s, found in zip(batch.samples, batch.of(self), strict=True):
            if found is None:
                continue
            weight, feels, felt = found
            low, high = min(float(weight.min()), 0.0), max(float(weight.max()), 1e-9)
            set_tick(rec, s["tick"])
            rec.log(entity, rr.Tensor(weight, dim_names=("feels", "felt")))
            # the viewer takes a picture of one row for something else: a cell is several pixels
            image = colours.shade(MAP_SCALE, weight, low, high).repeat(PIXELS, axis=0).repeat(PIXELS, axis=1)
            (tall, wide), (n, m) = (WIDE[1] / image.shape[0], WIDE[0] / image.shape[1]), weight.shape
            rec.log(f"{entity}/image", rr.Image(image), rr.Transform3D(scale=[wide, tall, 1]))
            spots, words = [(0.5 * WIDE[0], -0.32)], [f"dark {low:.3g}, bright {high:.3g}"]
            x, y = (np.arange(m) + 0.5) * WIDE[0] / m, (np.arange(n) + 0.5) * WIDE[1] / n - UP
            for i in range(0, n, -(-n // ROWS)):
                spots.append((-0.42, y[i]))
                words.append(feels[i])
            for k, j in enumerate(range(0, m, -(-m // (COLUMNS if m <= COLUMNS else FEW)))):  # in two lines, by turns
                spots.append((x[j], WIDE[1] + 0.02 + 0.2 * (k % 2)))
                words.append(felt[j])
            if n <= ROWS and m <= COLUMNS:
                spots += [(x[j], y[i]) for i in range(n) for j in range(m)]
                words += [f"{each:.2g}" for each in weight.ravel()]
            rec.log(f"{entity}/names", *text(spots, words, [INK] * len(words)))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the matrix: rows feel, columns are felt."""
        entity = f"/population/coupling/{self.name}"
        name = f"{self.name}: who (row) feels whom (column)"
        around = rrb.VisualBounds2D(x_range=[-0.85, WIDE[0] + 0.1], y_range=[-0.36, WIDE[1] + 0.66])
        shown = [f"+ {entity}/image", f"+ {entity}/names"]
        return [rrb.Spatial2DView(origin=entity, contents=shown, name=name, visual_bounds=around)]
