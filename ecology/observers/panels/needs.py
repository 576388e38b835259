"""Every need of the agent in focus, with its set point and its bounds."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.census import FocusSamples
from ecology.observers.panels.base import (
    FULL_PLOT,
    HALF_PLOT,
    NO_LEGEND,
    STATE_TICKS,
    THIRD_PLOT,
    LifePanel,
    labelled,
    last,
    scalars,
    series,
    time_columns,
)
from ecology.observers.scene import FAINT, INK
from ecology.spec import Need

HEIGHTS = (130, 60, 27)  # points, of a plot on a small screen, by the number of rows


class Needs(LifePanel):
    """Draws a plot per need."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the series: the need, set point, lower and upper bound, for each."""
        words, lines, needs = [], [], self.species.needs
        for i, need in enumerate(needs):
            words += [need.name, "set point", "lower bound", "upper bound"]
            lines += [colours.need_colour(i), INK, FAINT, FAINT]
        series(rec, f"{self.base}/needs", words, lines, [2.0, 1.0, 1.0, 1.0] * len(needs))

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw them."""
        x, n = life.internal, len(life.tick)
        bounds = np.array([(need.low, need.bounds[1]) for need in self.species.needs])
        bounds[~np.isfinite(bounds)] = np.nan
        target = np.where([need.regulated for need in self.species.needs], life.target, np.nan)
        beside = np.concatenate([target[..., None], np.broadcast_to(bounds, (n, *bounds.shape))], axis=-1)
        value = np.concatenate([x[..., None], beside], axis=-1).reshape(n, -1)
        scalars(rec, f"{self.base}/needs", time_columns(life.tick), value)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return a plot per need: the variable against its set point and its bounds."""
        needs, views = self.species.needs, []
        columns = min(3, math.ceil(math.sqrt(len(needs))))
        rows = math.ceil(len(needs) / columns)
        for i, need in enumerate(needs):
            steps = rr.components.InterpolationMode.StepAfter if not need.regulated and not need.decay else None
            shown = [i == k // 4 for k in range(4 * len(needs))]
            views.append(
                rrb.TimeSeriesView(
                    origin=f"/{self.base}/needs",
                    name=f"{need.name}{_aim(need)}",
                    time_ranges=last(STATE_TICKS),
                    plot_legend=NO_LEGEND,
                    axis_x=self.recent_axis((FULL_PLOT, HALF_PLOT, THIRD_PLOT)[columns - 1]),
                    axis_y=_axis(need, HEIGHTS[min(rows, len(HEIGHTS)) - 1]),
                    overrides={
                        f"{self.base}/needs": rr.SeriesLines.from_fields(visible_series=shown, interpolation_mode=steps)
                    },
                )
            )
        title = "needs: white x*, grey bounds"
        return [rrb.Grid(*views, grid_columns=columns, name=title)]


def _aim(need: Need) -> str:
    """Return what a need is regulated to."""
    if not need.regulated:
        return ""
    return ": x* moves" if need.set_range is not None else f": x* {need.set_point:.4g}"


def _axis(need: Need, tall: float) -> rrb.ScalarAxis | None:
    """Return the range of a plot `tall` points high: the bounds, with two labels; None where there are no bounds."""
    low, high = need.low, need.bounds[1]
    if not (math.isfinite(low) and math.isfinite(high)):
        return None
    return rrb.ScalarAxis(range=labelled(low, high, tall))
