"""Marks of births, deaths, bites and gifts since the last sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from ecology.observers import shapes
from ecology.observers.panels.base import Batch, Panel, Watch, last
from ecology.observers.scene import MARKED

MARKS = 200  # per kind and sample, at most
MARK_TICKS = 20  # for which a mark is shown, and at least two samples


class Marks(Panel):
    """Draws rings, crosses and lines."""

    def sample(self, watch: Watch) -> Any:
        """Return the strips of the marks by kind."""
        species = self.scene.scenario.species
        wide = max(self.scene.radius(each) for each in species)
        far = max(action.reach for each in species for action in each.actions)
        found: dict[str, list[np.ndarray]] = {}
        for event in watch.happened:
            if event.kind in MARKED:
                found.setdefault(event.kind, []).extend(shapes.mark(event.kind, event.place, event.other_place, wide))
        for kind, strips in found.items():
            strips[2 * MARKS :] = []
            if kind in ("bit", "gave"):  # a body that was put elsewhere afterwards gets no line
                strips[:] = [strip for strip in strips if np.hypot(*(strip[1] - strip[0])) <= 2 * far]
        return found

    def open(self, rec: rr.RecordingStream) -> None:
        """Give every kind its colour."""
        for kind, shade in MARKED.items():
            lines = rr.LineStrips2D.from_fields(colors=[shade], radii=rr.Radius.ui_points(0.8), draw_order=25)
            rec.log(f"world/marks/{kind}", lines, static=True)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the marks of the kinds that came up."""
        found = batch.of(self)
        for kind in MARKED:
            if not any(kind in each for each in found):
                continue
            strips = [strip for each in found for strip in each.get(kind, ())]
            lengths = [len(each.get(kind, ())) for each in found]
            marks = rr.LineStrips2D.columns(strips=strips).partition(lengths)
            rec.send_columns(f"world/marks/{kind}", batch.times, marks)

    def overrides(self) -> dict[Any, Any]:
        """Show those of the last ticks, of many agents those of the last sample alone."""
        every = self.scene.every
        recent = max(MARK_TICKS, 2 * every) if self.scene.few else every - 1
        return {f"world/marks/{kind}": last(recent) for kind in MARKED}
