"""Every need of every agent of a species; the lines of a clicked agent stand out."""

from __future__ import annotations

import math

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from ecology.observers.panels.base import FULL_PLOT, HALF_PLOT, NO_LEGEND, STATE_TICKS, THIRD_PLOT, Panel, last
from ecology.observers.scene import FAINT, FEW


class Everyone(Panel):
    """Shows a plot per need with a line for every agent, from the recorded bodies."""

    each = True

    def is_there(self) -> bool:
        """Return whether there are several, not too many, and none takes the slot of another."""
        # where slots are used again, a line would join two lives
        return 1 < self.scene.groups[self.name].size <= FEW and not self.scene.grows

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plots."""
        name, views = self.name, []
        columns = min(3, math.ceil(math.sqrt(len(self.species.needs))))
        for need in self.species.needs:
            source = VisualizerComponentMapping(
                target="Scalars:scalars",
                source_kind=ComponentSourceKind.SourceComponent,
                source_component=need.name,
            )
            lines = rr.SeriesLines(widths=0.6, colors=[FAINT]).visualizer(mappings=[source])
            views.append(
                rrb.TimeSeriesView(
                    origin=f"/world/agents/{name}",
                    contents=f"/world/agents/{name}",
                    name=f"{need.name} of every {name}",
                    time_ranges=last(STATE_TICKS),
                    plot_legend=NO_LEGEND,
                    axis_x=self.recent_axis((FULL_PLOT, HALF_PLOT, THIRD_PLOT)[columns - 1]),
                    overrides={f"world/agents/{name}": [lines]},
                )
            )
        title = f"every {name}"
        return [rrb.Grid(*views, grid_columns=columns, name=title)]
