"""Base classes of panels. A panel is one part of a recording, from its sample in the run to its views on the screen."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.decision import Decision, Plan
from ecology.env import Ecology
from ecology.observers import census, colours, maps
from ecology.observers.base import Mind
from ecology.observers.census import Census, Focus, FocusSamples, Happening
from ecology.observers.scene import BACKGROUND, DEAD, INK, MAP_SCALE, Scene
from ecology.spec import Species
from ecology.state import State
from ecology.world import Tick

STATE_TICKS = 2_000  # of the internal state on the first screen: two labels of the axis, however narrow the plot
HUGE = 1e300  # range of an axis that is left alone
APART, HALF = 20, 8  # points: between two labels of an axis, at least, and half a label
NEAR = 22  # points beyond a range within which the viewer would draw a label, and cut it off
APART_WIDE, HALF_WIDE = 62, 28  # points: between two labels of an axis of ticks, at least, and half a label
FULL_PLOT, HALF_PLOT, THIRD_PLOT = 680, 280, 205  # points, of a plot on a small screen, by its part of the right side
STRIP_TALL, ALONE_TALL = 66, 96  # points, of a plot of populations below minds, and without any, on a small screen


@dataclass
class Watch:
    """The source of panels' samples: a run after a tick, and the agents in focus."""

    env: Ecology
    minds: Mapping[str, Mind]
    scene: Scene
    focus: Focus
    census: Census
    state: State
    tick: Tick | None  # None before the first one
    sampled: bool  # whether a sample is taken at this tick
    sparse: bool = False  # whether slowly changing quantities are sampled too
    closely: bool = False  # whether costly quantities are sampled too: plans, J at the present state
    turned: bool = False  # whether a user requested another focus
    changed: frozenset[str] = frozenset()  # species whose focus is another since the last sample
    happened: Sequence[Happening] = ()  # since the last sample
    deeds: Sequence[tuple[int, str]] = ()  # interventions since the last sample: tick, what was done
    _plans: dict[str, Plan | None] = field(default_factory=dict)
    _decisions: dict[str, Decision | None] = field(default_factory=dict)
    _reports: dict[str, Mapping[str, np.ndarray]] = field(default_factory=dict)

    def row(self, name: str) -> int:
        """Return the slot of a species' focus within its species, -1 without one."""
        slot = self.focus.slots[name]
        return slot - self.scene.groups[name].slots.start if slot >= 0 else -1

    def plan(self, name: str) -> Plan | None:
        """Return the best plan of a species' agent in focus at its last decision, None without one."""
        if name not in self._plans:
            row = self.row(name)
            self._plans[name] = self.minds[name].plan_ahead(row) if row >= 0 and self.scene.decides[name] else None
        return self._plans[name]

    def decision(self, name: str) -> Decision | None:
        """Return the decision that a species' agent in focus acts on, None without one."""
        if name not in self._decisions:
            row = self.row(name)
            self._decisions[name] = self.minds[name].decision(row) if row >= 0 and self.scene.decides[name] else None
        return self._decisions[name]

    def report(self, name: str) -> Mapping[str, np.ndarray]:
        """Return the numbers that a species' minds report."""
        if name not in self._reports:
            self._reports[name] = self.minds[name].report()
        return self._reports[name]


class Batch:
    """Samples in a row, as panels draw them."""

    def __init__(self, scene: Scene, samples: Sequence[Mapping[str, Any]]) -> None:
        self.scene, self.samples = scene, samples
        self.ticks = np.array([s["tick"] for s in samples])
        self.times = time_columns(self.ticks)

    def of(self, panel: Panel) -> list[Any]:
        """Return what a panel sampled, n; None where it sampled nothing."""
        return [s["panels"].get(panel.key) for s in self.samples]

    def at(self, rows: Sequence[int] | np.ndarray) -> list[rr.TimeColumn]:
        """Return the times of some samples."""
        return time_columns(np.array([self.samples[int(i)]["tick"] for i in rows]))

    @functools.cached_property
    def column(self) -> dict[str, np.ndarray]:
        """Return what every sample holds of all slots, by name, (n, N, ...)."""
        keys = ("tick", "place", "heading", "internal", "drive", "reward", "serial", "action")
        found = {key: np.stack([s[key] for s in self.samples]) for key in keys}
        if "set_point" in self.samples[0]:
            found["set_point"] = np.stack([s["set_point"] for s in self.samples])
        return found

    def life(self, name: str) -> FocusSamples:
        """Return the life of a species' focus."""
        if name not in self._lives:
            self._lives[name] = self._life(name)
        return self._lives[name]

    @functools.cached_property
    def _lives(self) -> dict[str, FocusSamples]:
        return {}

    def _life(self, name: str) -> FocusSamples:
        group, column = self.scene.groups[name], self.column
        species = self.scene.scenario.species[group.index]
        shown = [s["focus"][name] for s in self.samples]
        n, slot = np.arange(len(shown)), np.array([f["slot"] for f in shown])
        gap = np.where((slot < 0) | [f["anew"] for f in shown], np.nan, 0.0)  # a series breaks between two lives
        many, needs = group.size > 1, len(species.needs)
        moving = "set_point" in column
        return FocusSamples(
            tick=column["tick"],
            internal=column["internal"][n, slot][:, :needs] + gap[:, None],
            set_point=column["set_point"][n, slot][:, :needs]
            if moving
            else np.array([need.set_point for need in species.needs]),
            drive=column["drive"][n, slot] + gap,
            own=np.array([f.get("own", np.nan) for f in shown]) + gap if species.empathy is not None else None,
            mean=np.array([census.mean(row) for row in column["drive"][:, group.slots]]) if many else None,
            reward=column["reward"][n, slot] + gap,
            action=np.where(slot < 0, DEAD, column["action"][n, slot]),
            place=np.where((slot < 0)[:, None], np.nan, column["place"][n, slot]),
            names=[f["name"] for f in shown],
            field=[f.get("field", np.empty((0, 2))) for f in shown],
            sight=[f.get("sight", np.empty((0, 2))) for f in shown],
        )


class Panel:
    """One part of a recording. A subclass defines only the methods that it needs; layout.py places its views."""

    each = False  # whether there is one for every species

    def __init__(self, scene: Scene, name: str = "") -> None:
        """Make a panel of `scene`, for the species `name` if there is one panel per species."""
        self.scene, self.name = scene, name
        self.key = f"{type(self).__name__} {name}".strip()

    @property
    def species(self) -> Species:
        """Return the species that the panel shows."""
        return self.scene.scenario.species[self.scene.groups[self.name].index]

    @property
    def base(self) -> str:
        """Return the entity below which the life of the species' focus is drawn."""
        return self.scene.at(self.name)

    def is_there(self) -> bool:
        """Return whether the scene has anything for the panel to show."""
        return True

    def follow(self, watch: Watch) -> None:
        """Look at the run after every tick, also between two samples."""
        return

    def sample(self, watch: Watch) -> Any:
        """Return the panel's sample as plain data that no longer changes with the run, None if there is nothing.

        Called once per sample, not per tick: see `follow`.
        """
        return None

    def final(self, watch: Watch) -> Any:
        """Return a last sample to draw at the end of the run."""
        return None

    def open(self, rec: rr.RecordingStream) -> None:
        """Draw what does not change: names, colours.

        `rec` logs to `population/x`, without a slash; the origin of a view is `/population/x`.
        """
        return

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw samples."""
        return

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the panel's views on the screen, none for a layer of the arena."""
        return []

    def overrides(self) -> dict[Any, Any]:
        """Return the overrides with which the arena shows the entities of a layer."""
        return {}

    def plot(
        self, origin: str, name: str, wide: float = HALF_PLOT, *, since: int = 0, legend: bool = False, **more: Any
    ) -> Any:
        """Return a view, `wide` points wide, of series over the whole run, or from the tick `since` on.

        Its name or a legend says which is which.
        """
        at, axis = rrb.TimeRangeBoundary, ALWAYS
        if self.scene.span is not None:
            first, end = max(since, self.scene.span[0]), self.scene.span[1]
            most = labelled_ticks(end - first, wide)
            axis = time_axis(at.absolute(seq=first - (most // 20 if first else 0)), at.absolute(seq=first + most))
        return rrb.TimeSeriesView(
            origin=origin, name=name, plot_legend=LEGEND if legend else NO_LEGEND, axis_x=axis, **more
        )

    def recent_axis(self, wide: float) -> rrb.TimeAxis | None:
        """Return the axis of a plot, `wide` points wide, of the last ticks before the cursor; None while a run goes on.

        By itself, a view takes the range of what it shows.
        """
        if self.scene.span is None:
            return None
        (first, end), at = self.scene.span, rrb.TimeRangeBoundary
        most = labelled_ticks(end - first, wide)
        if end - first <= STATE_TICKS:
            return time_axis(at.infinite(), at.cursor_relative(seq=first + most - end))
        return time_axis(at.cursor_relative(seq=-STATE_TICKS - STATE_TICKS // 20), at.cursor_relative(seq=0))


class LifePanel(Panel):
    """A panel about the life of a species' agent in focus, or of any agent of a finished recording."""

    each = True

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the life that the samples hold."""
        self.draw_life(rec, batch.life(self.name))

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw a life."""
        return

    def recent(self, what: str, name: str, wide: float = FULL_PLOT, *, legend: bool = True) -> rrb.TimeSeriesView:
        """Return a view of the last ticks of `what` of the agent."""
        return rrb.TimeSeriesView(
            origin=f"/{self.base}/{what}",
            name=name,
            time_ranges=last(STATE_TICKS),
            plot_legend=LEGEND if legend else NO_LEGEND,
            axis_x=self.recent_axis(wide),
        )


# ---- how panels draw ------------------------------------------------------------------------


def time_axis(start: rrb.TimeRangeBoundary, end: rrb.TimeRangeBoundary) -> rrb.TimeAxis:
    """Return a time axis of its own, of ticks: the viewer takes one range for all timelines."""
    return rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=start, end=end))


# the whole timeline; by itself a view takes the width of the others
ALWAYS = time_axis(rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.infinite())
LEGEND = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
NO_LEGEND = rrb.PlotLegend(visible=False)


def time_columns(ticks: np.ndarray) -> list[rr.TimeColumn]:
    """Return the timeline of samples."""
    return [rr.TimeColumn("tick", sequence=ticks)]


def scalars(rec: rr.RecordingStream, entity: str, times: list[rr.TimeColumn], value: np.ndarray) -> None:
    """Send `value` (n, K) as K series."""
    rows, each = value.shape
    rec.send_columns(entity, times, rr.Scalars.columns(scalars=value.reshape(-1)).partition([each] * rows))


def series(
    rec: rr.RecordingStream,
    entity: str,
    words: Sequence[str],
    shades: Sequence[colours.Colour],
    widths: Sequence[float] | None = None,
    *,
    steps: bool = False,
) -> None:
    """Name and colour the series of an entity, drawn in steps where they jump between whole numbers."""
    several = [shades[i % len(shades)] for i in range(len(words))]
    mode = rr.components.InterpolationMode.StepAfter if steps else None
    lines = rr.SeriesLines(
        names=list(words), colors=several, widths=widths or [1.5] * len(words), interpolation_mode=mode
    )
    rec.log(entity, lines, static=True)


def lay(rec: rr.RecordingStream, entity: str, corner: tuple[float, float], cell: tuple[float, float]) -> None:
    """Lay the images of `entity` on the plane: lower left corner, size of a pixel."""
    rec.log(entity, rr.Transform3D(translation=[*corner, 0], scale=[*cell, 1]), static=True)


def draw_map(rec: rr.RecordingStream, folder: str, grid: maps.Grid, value: np.ndarray, *more: Any) -> None:
    """Draw a map `value` (rows, columns) of J, NaN outside the arena, and its range in words; log `more` with it."""
    low, high = float(np.nanmin(value)), float(np.nanmax(value))
    image = colours.shade(MAP_SCALE, value, low, high)
    image[~np.isfinite(value)] = BACKGROUND
    rec.log(f"{folder}/image", rr.Image(image, draw_order=-10), *more)
    (x, y), (tall, wide) = grid.corner, (extent * grid.cell for extent in value.shape)
    rec.log(f"{folder}/range", *text([(x + 0.5 * wide, y - 0.03 * tall)], [f"{_short(low)} to {_short(high)}"], [INK]))


def _short(value: float) -> str:
    """Return a number as a narrow map has room for it."""
    return f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"


def text(places: Any, words: Sequence[str], shades: Sequence[colours.Colour]) -> tuple[rr.Points2D]:
    """Return words just below `places` (n, 2)."""
    return (rr.Points2D(places, radii=1e-4, labels=list(words), colors=shades, show_labels=True, draw_order=30),)


def write(rec: rr.RecordingStream, entity: str, places: Any, words: Sequence[str]) -> None:
    """Write words just below `places` (n, 2), for good."""
    rec.log(entity, *text(places, words, [INK] * len(words)), static=True)


def set_tick(rec: rr.RecordingStream, tick: int) -> None:
    """Let what is logged next be of a tick."""
    rec.set_time("tick", sequence=tick)


def labelled_ticks(number: int, wide: float) -> int:
    """Return how many ticks an axis has that shows `number` of them with two whole labels, `wide` points wide.

    The viewer labels the multiples of a power of ten, counted from the first tick: the least whose labels have room.
    It cuts off one that is close to the right edge; the axis has room for it here, also in a plot that is wider.
    """
    room = wide - HALF_WIDE
    step = 10 ** max(0, math.ceil(math.log10(APART_WIDE * max(number, 1) / room)))
    last, fine = max(step, number // step * step), max(step // 10, 1)
    return -(-max(number, math.ceil(last * wide / room)) // fine) * fine


def labelled(
    low: float, high: float, tall: float, apart: float = APART, half: float = HALF, near: float = NEAR
) -> tuple[float, float]:
    """Return the narrowest range around `low` to `high` that shows two labels whole in a plot `tall` points high.

    The viewer labels the multiples of a power of ten: the least whose labels have room. The range includes one that
    lies just beyond it.
    """
    room = max(tall - 2 * half, 2 * apart)
    while high - low < HUGE:
        span = max(high - low, 1e-9 * max(abs(high), abs(low), 1e-3))
        step = 10.0 ** math.ceil(math.log10(apart * span / room) - 1e-9)
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last > first:
            down, up, point = step * math.floor(low / step + 1e-9), step * math.ceil(high / step - 1e-9), span / room
            least, most = down if low - down < near * point else low, up if up - high < near * point else high
            if apart * (most - least) <= step * room:  # the labels still have room
                low, high = least, most
            return low - half * point, high + half * point
        down, up = low - (first - 1) * step, (last + 1) * step - high
        low, high = (low, (last + 1) * step) if up <= down or low == 0 else ((first - 1) * step, high)
    return low, high


def population_height(scene: Scene) -> float:
    """Return the height of a plot of populations, points, on a small screen."""
    return STRIP_TALL if any(scene.decides.values()) else ALONE_TALL


class Ends:
    """Keeps two labels on the axis of a plot: invisible points at the ends of its range, which includes 0."""

    def __init__(self, entity: str, tall: float) -> None:
        """Mark the axis of the plot of `entity`, `tall` points high on a small screen."""
        self._entity, self._tall = f"{entity}/ends", tall
        self._low, self._high = 0.0, 0.0  # of all values so far
        self._ends = (0.0, 0.0)  # as they were last drawn

    def open(self, rec: rr.RecordingStream) -> None:
        """Make the points invisible."""
        unseen = rr.SeriesPoints(colors=[[0, 0, 0, 0]] * 2, names=["end of the axis"] * 2, marker_sizes=[0.1, 0.1])
        rec.log(self._entity, unseen, static=True)

    def draw(self, rec: rr.RecordingStream, ticks: np.ndarray, value: np.ndarray) -> None:
        """Mark the range of the values (n, K) so far, where it has grown."""
        known = value[np.isfinite(value)]
        if not known.size:
            return
        self._low, self._high = min(self._low, float(known.min())), max(self._high, float(known.max()))
        if self._low == self._high:  # of zeros alone the viewer's own axis has labels
            return
        ends = labelled(self._low, self._high, self._tall)
        if ends != self._ends:
            self._ends = ends
            scalars(rec, self._entity, time_columns(ticks[:1]), np.array([ends]))


def name_shades(words: Sequence[str], shades: Sequence[colours.Colour]) -> str:
    """Return a legend in words: "f orange, J blue"."""
    return ", ".join(f"{word} {colours.colour_name(shade)}" for word, shade in zip(words, shades, strict=False))


def bounds(scene: Scene, below: float, above: float) -> rrb.VisualBounds2D:
    """Return the arena and a margin, shares of its size, in the view's plane: y mirrored.

    Beside a fork it is drawn smaller, and its words take more of the width.
    """
    low, high = np.array(scene.scenario.arena.extent, float)
    size = float((high - low).max())
    return rrb.VisualBounds2D(
        x_range=[low[0] - (0.16 if scene.fork else 0.06) * size, high[0] + (0.06 if scene.fork else 0.03) * size],
        y_range=[-high[1] - above * size, -low[1] + below * size],
    )


def last(ticks: int) -> rrb.VisibleTimeRanges:
    """Return the range of the last `ticks` ticks."""
    at = rrb.TimeRangeBoundary.cursor_relative
    return rrb.VisibleTimeRanges([rrb.VisibleTimeRange("tick", start=at(seq=-ticks), end=at(seq=0))])
