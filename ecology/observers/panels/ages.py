"""The age structure of every species."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import census
from ecology.observers.panels.base import (
    APART_WIDE,
    HALF_PLOT,
    HALF_WIDE,
    NO_LEGEND,
    Batch,
    Panel,
    Watch,
    labelled,
    set_tick,
)

TALL = 96  # points, of a chart on a small screen


class Bars(Panel):
    """Draws distributions as bars at intervals; a subclass chooses the quantity."""

    entity: str  # below it, one for every name in its samples

    def is_there(self) -> bool:
        """Return whether there is more to be shown than one agent."""
        return self.scene.crowd

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw those that were sampled: middles of the classes, their width and their numbers by name."""
        for s, found in zip(batch.samples, batch.of(self), strict=True):
            if not found:
                continue
            set_tick(rec, s["tick"])
            for name, (middle, width, number) in found.items():
                # bars without width, at the ends of axes with two labels
                ends = labelled(middle[0] - width / 2, middle[-1] + width / 2, HALF_PLOT, APART_WIDE, HALF_WIDE / 2, 0)
                top = labelled(0, max(float(number.max()), 1), TALL)[1]
                at, wide = np.append(middle - 0.45 * width, ends), np.append(np.full(len(middle), 0.9 * width), [0, 0])
                shade = self.scene.colour(name.partition("/")[0])
                bars = rr.BarChart(np.append(number, [0, top]), abscissa=at, widths=wide, color=shade)
                rec.log(f"{self.entity}/{name}", bars)


def bar_views(entity: str, titles: Sequence[tuple[str, str]]) -> list[rrb.View | rrb.Container]:
    """Return a chart for each name and title, side by side or, of many, one behind the other."""
    bars = [rrb.BarChartView(origin=f"/{entity}/{n}", name=title, plot_legend=NO_LEGEND) for n, title in titles]
    return [rrb.Horizontal(*bars) if len(bars) <= 3 else rrb.Tabs(*bars)] if bars else []


class Ages(Bars):
    """Draws the ages of living agents."""

    entity = "population/ages"

    def sample(self, watch: Watch) -> Any:
        """Return the classes by species."""
        if not watch.sparse:
            return None
        found, state = {}, watch.state
        for name, g in self.scene.groups.items():
            middle, number = census.ages(state.age[g.slots][state.alive[g.slots]])
            found[name] = middle, 2 * middle[0], number
        return found

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return a chart per species where ages matter."""
        if not (self.scene.grows or any(s.hazard for s in self.scene.scenario.species)):
            return []
        return bar_views(self.entity, [(name, f"ages of {name}, time") for name in self.scene.groups])
