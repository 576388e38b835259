"""The first screen: which views of a recording the viewer opens, and where."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from ecology.observers import maps
from ecology.observers.scene import BACKGROUND, FAINT, FEW, MARKED, Scene, losses

TRAIL_TICKS = 100  # length of a trail
MARK_TICKS = 20  # for which a birth, a death, a bite or a gift is marked, and at least two samples
STATE_TICKS, ACTION_TICKS = 1_000, 100  # of the internal state and the action on the first screen

# the whole timeline; by itself a view takes the width of the others
ALWAYS = rrb.TimeAxis(
    link="Independent",
    view_range=rrb.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite()),
)
LEGEND = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)


def blueprint(scene: Scene) -> rrb.Blueprint:
    """Return the layout: the arena over the maps on the left; on the right a life, or populations and lives."""
    there = sorted(scene.groups, key=lambda name: name != scene.first)
    arena = _arena_view(scene)
    below = [_map_views(scene, name) for name in there if scene.mapped.get(name)]
    events: rrb.View = rrb.TextLogView(
        origin="/events", name="events", columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
    )
    if scene.crowd:
        left = rrb.Vertical(arena, rrb.Tabs(events, *below, active_tab=0), row_shares=[2.6, 1])
        right: rrb.Container | rrb.View = rrb.Tabs(
            _population_views(scene), *(_life_views(scene, name) for name in there), active_tab=int(bool(scene.first))
        )
    else:
        left = rrb.Vertical(arena, rrb.Tabs(*below, events, active_tab=0), row_shares=[2.3, 1])
        right = _life_views(scene, there[0]) if there else events
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1.1, 1]),
        rrb.TimePanel(timeline="tick", play_state="following", state="collapsed"),
        collapse_panels=True,
        auto_layout=False,
        auto_views=False,
    )


def _bounds(scene: Scene, below: float, above: float) -> rrb.VisualBounds2D:
    """Return the arena and a margin, in the view's plane: y mirrored."""
    corners = np.array(scene.scenario.arena.vertices, float)
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float((high - low).max())
    return rrb.VisualBounds2D(
        x_range=[low[0] - 0.06 * size, high[0] + 0.03 * size],
        y_range=[-high[1] - above * size, -low[1] + below * size],
    )


def _arena_view(scene: Scene) -> rrb.Spatial2DView:
    overrides: dict[Any, Any] = {f"world/trail/{name}": _last(TRAIL_TICKS, scene.scenario.dt) for name in scene.groups}
    # arrows begin where bodies are: the positions are recorded once
    origin = VisualizerComponentMapping(
        target="Arrows2D:origins",
        source_kind=ComponentSourceKind.SourceComponent,
        source_component="Points2D:positions",
    )
    for name in scene.groups:
        overrides[f"world/agents/{name}"] = [
            rr.Points2D.from_fields().visualizer(),
            rr.Arrows2D.from_fields(draw_order=21).visualizer(mappings=[origin]),
        ]
    recent = max(MARK_TICKS, 2 * scene.every) if scene.few else scene.every - 1  # of many, the last sample's alone
    overrides |= {f"world/marks/{kind}": _last(recent, scene.scenario.dt) for kind in MARKED}
    whose = "all" if scene.few else "the focus then" if scene.chosen else "the focus"
    what = f"trails of {TRAIL_TICKS} ticks ({whose})" if scene.crowd else f"its trail of {TRAIL_TICKS} ticks"
    seen = "view field and lines of sight of the focus"
    shown: list[str] = []
    for name, who in scene.chosen.items():  # in the place of the focus that was
        seen = f"view field of {who}"
        shown += [f"- /world/focus/{name}/**", f"+ /world/chosen/{who}/**"]
    return rrb.Spatial2DView(
        origin="/",
        contents=["+ /world/**", "- /world/maps/**", "- /world/chosen/**", *shown],
        name=f"{scene.run}: {what}, {seen}",
        background=BACKGROUND,
        visual_bounds=_bounds(scene, 0.09, 0.11 + 0.055 * len(scene.legend_rows())),
        overrides=overrides,
    )


def _map_views(scene: Scene, name: str) -> rrb.Container:
    species = scene.scenario.species[scene.groups[name].index]
    views = []
    for i in maps.mapped_needs(species):
        need = species.needs[i]
        views.append(
            rrb.Spatial2DView(
                origin="/",
                contents=[
                    "+ /world/walls",
                    "+ /world/resources",
                    "+ /world/resources/rim",
                    f"+ /world/maps/{name}/{need.name}/**",
                ],
                name=f"J, {need.name} at {-need.set_point:g}",
                background=BACKGROUND,
                visual_bounds=_bounds(scene, 0.19, 0.03),
            )
        )
    whose = f"the {name} then in focus" if name in scene.chosen else scene.who(name)
    return rrb.Grid(*views, grid_columns=len(views), name=f"deviation of {whose}")


def _population_views(scene: Scene) -> rrb.Container:
    """Return the panels of the populations."""
    count = _plot("/population/count", "living, number")
    flow = _plot("/population/flow", "born and died so far, number")
    drive = _plot("/population/drive", "drive of the living: mean and spread (one sd)")
    bars = [
        rrb.BarChartView(
            origin=f"/population/ages/{name}",
            name=f"ages of {name}, time",
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for name in scene.groups
    ]
    rows: list[rrb.View | rrb.Container] = [
        rrb.Horizontal(count, flow) if scene.grows or "died" in scene.marks else count,
        drive,
    ]
    if scene.grows or any(s.hazard for s in scene.scenario.species):
        rows.append(rrb.Horizontal(*bars) if len(bars) <= 3 else rrb.Tabs(*bars))
    traits = [
        rrb.BarChartView(
            origin=f"/population/traits/{s.name}/{trait.name}",
            name=f"{trait.name} of {s.name} ({trait.of})",
            plot_legend=rrb.PlotLegend(visible=False),
        )
        for s in scene.scenario.species
        for trait in s.traits
    ]
    if traits:
        rows.append(rrb.Horizontal(*traits) if len(traits) <= 3 else rrb.Tabs(*traits))
    last: list[rrb.View] = []
    if scene.stocked:
        last.append(_plot("/population/stocks", "stocks, units of intake"))
    if scene.measures:
        last.append(_plot("/population/measures", "measures and cues of the scenario"))
    last += [
        rrb.TensorView(origin=f"/population/coupling/{name}", name=f"{name}: who (row) feels whom (column)")
        for name in scene.coupled
    ]
    if last:
        rows.append(rrb.Horizontal(*last) if len(last) <= 3 else rrb.Tabs(*last))
    return rrb.Vertical(*rows, name="populations")


def _life_views(scene: Scene, name: str) -> rrb.Container:
    who, dt = scene.who(name), scene.scenario.dt
    at = rrb.TimeRangeBoundary.cursor_relative
    # in ticks, the timeline of the first screen; on sim_time the lane shows the present action alone
    known = scene.full or name not in scene.chosen  # after the fact, of many, no rewards, nor what is felt of others
    feels = scene.scenario.species[scene.groups[name].index].empathy is not None
    title = "drive, whole life" if known or not feels else "drive of its own needs, whole life"
    drive = _plot(f"/{scene.at(name)}/drive", title)
    reward = rrb.TimeSeriesView(
        origin=f"/{scene.at(name)}/reward",
        name=f"reward, last {STATE_TICKS} ticks",
        time_ranges=_last(STATE_TICKS, dt),
        plot_legend=rrb.PlotLegend(visible=False),
    )
    latest = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=at(seq=-ACTION_TICKS), end=at(seq=0)))
    views: list[rrb.View | rrb.Container] = [
        rrb.Tabs(
            _need_views(scene, name),
            rrb.TimeSeriesView(
                origin=f"/{scene.at(name)}/shares",
                name="shares of the needs in its own drive, drive units",
                time_ranges=_last(STATE_TICKS, dt),
                plot_legend=LEGEND,
            ),
            rrb.TimeSeriesView(
                origin=f"/{scene.at(name)}/deviation",
                name="x - x* of every need, its own unit",
                time_ranges=_last(STATE_TICKS, dt),
                plot_legend=LEGEND,
            ),
            # where slots are used again, a line would join two lives
            *([_everyone_views(scene, name)] if 1 < scene.groups[name].size <= FEW and not scene.grows else []),
            active_tab=0,
        ),
        rrb.StateTimelineView(
            origin=f"/{scene.at(name)}/action",
            name=f"{who}: action; last {ACTION_TICKS} ticks",
            time_ranges=_last(ACTION_TICKS, dt),
            time_view=latest,
        ),
        rrb.Horizontal(drive, reward) if known else drive,
    ]
    shares = [3.0, 1.1, 1.6]
    learning = _learning_views(scene, name)
    if scene.decides[name]:
        title = "decision in force"
        text = rrb.TextDocumentView(origin=f"/{scene.at(name)}/decision", name=title)
        views.append(rrb.Horizontal(text, rrb.Tabs(*learning, active_tab=0)) if learning else text)
        shares.append(2.6)
    elif learning:
        views.append(learning[0] if len(learning) == 1 else rrb.Tabs(*learning, active_tab=0))
        shares.append(2.0)
    return rrb.Vertical(*views, row_shares=shares, name=who)


def _need_views(scene: Scene, name: str) -> rrb.Container:
    """Return a plot per need: the variable against its set point and its bounds."""
    species = scene.scenario.species[scene.groups[name].index]
    views = []
    for i, need in enumerate(species.needs):
        shown = [i == k // 4 for k in range(4 * len(species.needs))]
        views.append(
            rrb.TimeSeriesView(
                origin=f"/{scene.at(name)}/needs",
                name=f"{need.name} (x* {need.set_point:g}{', moves' * (need.set_range is not None)})",
                time_ranges=_last(STATE_TICKS, scene.scenario.dt),
                plot_legend=rrb.PlotLegend(visible=False),
                overrides={f"{scene.at(name)}/needs": rr.SeriesLines.from_fields(visible_series=shown)},
            )
        )
    title = f"{scene.who(name)}: every need with x* (white) and bounds (grey); last {STATE_TICKS} ticks"
    return rrb.Grid(*views, grid_columns=min(3, math.ceil(math.sqrt(len(views)))), name=title)


def _everyone_views(scene: Scene, name: str) -> rrb.Container:
    """Return a plot per need with a line for every agent: that of an agent that is clicked stands out."""
    species, views = scene.scenario.species[scene.groups[name].index], []
    for need in species.needs:
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
                time_ranges=_last(STATE_TICKS, scene.scenario.dt),
                plot_legend=rrb.PlotLegend(visible=False),
                overrides={f"world/agents/{name}": [lines]},
            )
        )
    title = f"every {name}; click one in the arena"
    return rrb.Grid(*views, grid_columns=min(3, math.ceil(math.sqrt(len(views)))), name=title)


def _learning_views(scene: Scene, name: str) -> list[rrb.View]:
    lost, numbers = losses(scene.told[name])
    found: list[rrb.View] = [_plot(f"/learning/{name}/losses", f"losses, log10: {', '.join(lost)}")] if lost else []
    if scene.decides[name] and name not in scene.chosen:
        found.append(
            rrb.TimeSeriesView(
                origin=f"/learning/{name}",
                contents=[f"+ /learning/{name}/J", f"+ /learning/{name}/met"],
                name="J against the drive met afterwards",
                plot_legend=LEGEND,
                axis_x=ALWAYS,
            )
        )
        found.append(_plot(f"/learning/{name}/error", "error of f per variable; 1: no better than no change"))
    for word in numbers:
        lines = rr.SeriesLines.from_fields(visible_series=[other == word for other in numbers])
        found.append(_plot(f"/learning/{name}/numbers", word, {f"learning/{name}/numbers": lines}))
    return found


def _plot(origin: str, name: str, overrides: dict[Any, Any] | None = None) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=LEGEND, axis_x=ALWAYS, overrides=overrides)


def _last(ticks: int, dt: float) -> rrb.VisibleTimeRanges:
    """Return the range of the last `ticks` ticks on both timelines."""
    at = rrb.TimeRangeBoundary.cursor_relative
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange("tick", start=at(seq=-ticks), end=at(seq=0)),
            rrb.VisibleTimeRange("sim_time", start=at(seconds=-ticks * dt), end=at(seconds=0)),
        ]
    )
