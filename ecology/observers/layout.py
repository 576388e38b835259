"""The first screen: which panels a recording has, and where the viewer shows them.

A new panel is a file in panels/ and its place here: in ARENA if it draws in the plane, else in one of the boxes below.
Every panel with a place is sampled (`PLACED`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange

from ecology.observers import maps
from ecology.observers.panels.action import Action
from ecology.observers.panels.ages import Ages
from ecology.observers.panels.ahead import Ahead
from ecology.observers.panels.base import LifePanel, Panel, bounds
from ecology.observers.panels.bodies import Bodies
from ecology.observers.panels.count import Count
from ecology.observers.panels.coupling import Coupling
from ecology.observers.panels.decision import DecisionTable
from ecology.observers.panels.deviation import Deviation
from ecology.observers.panels.drive import Drive
from ecology.observers.panels.drives import Drives
from ecology.observers.panels.error import Error
from ecology.observers.panels.events import Events
from ecology.observers.panels.everyone import Everyone
from ecology.observers.panels.expectation import Expectation
from ecology.observers.panels.fields import Fields
from ecology.observers.panels.flow import Flow
from ecology.observers.panels.futures import Futures
from ecology.observers.panels.here import Here
from ecology.observers.panels.legend import Legend
from ecology.observers.panels.losses import Losses
from ecology.observers.panels.maps import Maps
from ecology.observers.panels.marks import Marks
from ecology.observers.panels.measures import Measures
from ecology.observers.panels.minds import Minds
from ecology.observers.panels.needs import Needs
from ecology.observers.panels.nobody import Nobody
from ecology.observers.panels.numbers import Numbers
from ecology.observers.panels.plane import Plane
from ecology.observers.panels.props import Props
from ecology.observers.panels.resources import Resources
from ecology.observers.panels.reward import Reward
from ecology.observers.panels.shares import Shares
from ecology.observers.panels.sight import Sight
from ecology.observers.panels.stocks import Stocks
from ecology.observers.panels.trails import TRAIL_TICKS, Trails
from ecology.observers.panels.traits import Traits
from ecology.observers.scene import BACKGROUND, Scene


@dataclass(frozen=True)
class Box:
    """Panels and boxes of panels, one below the other, side by side, or one behind the other."""

    how: str  # "rows", "columns" or "tabs"
    parts: Sequence[type[Panel] | Box]
    shares: Sequence[float] = ()


def rows(*parts: type[Panel] | Box, shares: Sequence[float] = ()) -> Box:
    """Return panels one below the other, with shares of the height."""
    return Box("rows", parts, shares)


def columns(*parts: type[Panel] | Box, shares: Sequence[float] = ()) -> Box:
    """Return panels side by side, with shares of the width."""
    return Box("columns", parts, shares)


def tabs(*parts: type[Panel] | Box) -> Box:
    """Return panels one behind the other."""
    return Box("tabs", parts)


# layers of the arena, the lowest first
ARENA: Sequence[type[Panel]] = (Plane, Legend, Fields, Props, Resources, Bodies, Trails, Sight, Ahead, Marks, Nobody)
LIFE = rows(
    tabs(Needs, Shares, Deviation, Everyone),
    Action,
    columns(DecisionTable, tabs(Drive, Reward, Losses, Expectation, Error, Numbers), shares=(1.25, 1.0)),
    shares=(2.65, 1.3, 2.9),
)
POPULATIONS = rows(columns(Count, Flow), Drives, Ages, Traits, columns(Stocks, Measures, Coupling))
STRIP = columns(Count, Drives)  # below the minds of a crowd
CUES = columns(Stocks, Measures)  # below the mind of one agent
MAPS: Sequence[type[Panel]] = (Here, Maps)  # side by side, a tab below the arena for each species
BELOW: Sequence[type[Panel]] = (Events,)  # the arena, a tab each
UNSEEN: Sequence[type[Panel]] = (Minds,)  # recorded for looking back
FORK: Sequence[type[Panel]] = (*(kind for kind in ARENA if kind is not Legend), DecisionTable)  # of the other future
UNTOUCHED = (  # entities of the arena that a click passes through: of every layer but the bodies
    *("walls", "floor", "axes", "legend", "fields", "doors", "resources", "trail", "marks", "props"),
    *("focus", "chosen", "plan", "forecast", "came", "nobody"),
)
WIDE_MAPS = 3  # side by side, up to which their titles have room
FORKED = "fork"  # the entity below which it lies


def _kinds(box: Box) -> Iterator[type[Panel]]:
    for part in box.parts:
        if isinstance(part, Box):
            yield from _kinds(part)
        else:
            yield part


BOXES = (LIFE, POPULATIONS, STRIP, CUES)
_placed = (*ARENA, *(kind for box in BOXES for kind in _kinds(box)), *MAPS, *BELOW, *UNSEEN)
PLACED: Sequence[type[Panel]] = tuple(dict.fromkeys(_placed))  # every panel once, in the order in which they are drawn


def panels(scene: Scene, kinds: Sequence[type[Panel]] | None = None, only: str | None = None) -> list[Panel]:
    """Return the panels of a scene, or those of the `kinds`, of all species or `only` of one."""
    kinds = PLACED if kinds is None else kinds
    names = [name for name in scene.groups if only in (None, name)]
    found = [kind(scene, name) for kind in kinds for name in (names if kind.each else [""])]
    return [panel for panel in found if panel.is_there()]


def life_panels(scene: Scene, name: str) -> list[LifePanel]:
    """Return the panels that draw the life of a species' focus, or of any agent after the fact."""
    return [panel for panel in panels(scene, only=name) if isinstance(panel, LifePanel)]


def blueprint(scene: Scene) -> rrb.Blueprint:
    """Return the layout: the arena over the maps on the left; on the right a life, or populations and lives."""
    ordered = sorted(scene.groups, key=lambda name: name != scene.first)
    mapped = [map_ for name in ordered for map_ in _maps(scene, name)]
    others = [view for kind in BELOW for view in _views(scene, kind)]
    detailed = [name for name in ordered if scene.alone or name in (scene.first, *scene.chosen) or not scene.idle(name)]
    lives = [_place(scene, LIFE, name, name=scene.who(name)) for name in detailed]
    populations: Any = None
    if scene.crowd:
        below, shares = rrb.Tabs(*others, *mapped, active_tab=0), [2.6, 1.0]
        populations = None if scene.alone else _place(scene, POPULATIONS, name="populations")
        minded = scene.alone or any(scene.decides.values())  # a mind in front, if there is one
        whole = [populations] if populations else []
        right: Any = rrb.Tabs(*([*lives, *whole] if minded else [*whole, *lives]), active_tab=0)
        strip = _place(scene, CUES if scene.alone else STRIP)
        if strip is not None and lives and minded:
            right = rrb.Vertical(right, strip, row_shares=[4.4, 1.0])
    else:
        below, shares = rrb.Tabs(*mapped, *others, active_tab=0), [2.3, 1.0]
        right = lives[0] if lives else others[0]
    arena: Any = _arena_view(scene)
    if scene.fork:
        arena = rrb.Horizontal(arena, _arena_view(scene, forked=True))
        futures = _futures(scene, ordered)
        right = rrb.Tabs(futures, *lives, *([populations] if populations else []), active_tab=0)
    left = rrb.Vertical(arena, below, row_shares=shares)
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[1, 1.1]),  # the names of fatigues need the width
        _time_panel(scene),
        collapse_panels=True,
        auto_layout=False,
        auto_views=False,
    )


def _time_panel(scene: Scene) -> rrb.TimePanel:
    """Return the timeline: at its end, or looping if no agent is alive at its end."""
    if scene.lived_until is None:
        return rrb.TimePanel(timeline="tick", play_state="following", state="collapsed")
    lived = AbsoluteTimeRange(0, scene.lived_until)
    return rrb.TimePanel(
        timeline="tick", play_state="playing", loop_mode="selection", time_selection=lived, state="collapsed"
    )


def _views(scene: Scene, kind: type[Panel], name: str = "") -> list[rrb.View | rrb.Container]:
    """Return the views of the panels of a kind; of a species where it has one for each."""
    return [view for panel in panels(scene, (kind,), name if kind.each and name else None) for view in panel.views()]


def _maps(scene: Scene, name: str) -> list[rrb.View | rrb.Container]:
    """Return the map of J at the present state of a species' agent in focus, beside the maps at made-up states."""
    kinds = [kind for kind in MAPS if kind is not Here or name not in scene.chosen]
    shown: list[Any] = [view for kind in kinds for view in _views(scene, kind, name)]
    if not shown:
        return []
    whose = f"the {name} then in focus" if name in scene.chosen else scene.who(name)
    species = scene.scenario.species[scene.groups[name].index]
    words = [*(["now"] * (Here in kinds)), *(species.needs[i].name for i in maps.mapped_needs(species))]
    if len(shown) > WIDE_MAPS:  # narrow maps cut off their titles: they have numbers, and there is room here
        words = [f"{i} {word}" for i, word in enumerate(words, 1)]
        for i, view in enumerate(shown, 1):
            view.name = f"{i}"
    now, worst = words[: Here in kinds], words[Here in kinds :]
    title = " | ".join([*now, f"at their worst: {', '.join(worst)}"])
    return [rrb.Grid(*shown, grid_columns=len(shown), name=f"J of {whose}, dark is low: {title}")]


def _place(scene: Scene, box: Box, species: str = "", name: str | None = None) -> Any:
    """Return the container of a box; panels without views are left out, and a box of one panel is that panel."""
    shown: list[Any] = []
    shares = []
    for i, part in enumerate(box.parts):
        if isinstance(part, Box):
            inner = _place(scene, part, species)
            views = [] if inner is None else [inner]
        else:
            views = _views(scene, part, species)
        shown += views
        shares += [box.shares[i] if box.shares else 1.0] * len(views)
    if not shown or (len(shown) == 1 and name is None):
        return shown[0] if shown else None
    if box.how == "rows":
        return rrb.Vertical(*shown, row_shares=shares, name=name)
    if box.how == "columns":
        return rrb.Horizontal(*shown, column_shares=shares, name=name)
    return rrb.Tabs(*shown, active_tab=0, name=name)


def _futures(scene: Scene, names: Sequence[str]) -> rrb.Container:
    """Return both futures in one picture: the decisions of the agents in focus, and the differences."""
    first = next((name for name in names if scene.decides[name]), None)
    decisions = [
        rrb.TextDocumentView(origin=f"{below}/focus/{first}/decision", name=f"{title}: decision in force")
        for below, title in (("", scene.run), (f"/{FORKED}", scene.fork))
        if first is not None
    ]
    shown = [*Futures(scene).views(), *([rrb.Horizontal(*decisions)] if decisions else [])]
    return rrb.Vertical(*shown, name="both futures")


def _add(overrides: dict[Any, Any], more: Mapping[Any, Any]) -> None:
    """Add to the overrides of a view, where an entity may have some already."""
    for entity, how in more.items():
        several = how if isinstance(how, list) else [how]
        before = overrides.get(entity, [])
        overrides[entity] = [*(before if isinstance(before, list) else [before]), *several]


def _arena_view(scene: Scene, *, forked: bool = False) -> rrb.Spatial2DView:
    overrides: dict[Any, Any] = {}
    below = f"{FORKED}/world" if forked else "world"
    above = (0.11 + 0.055 * len(scene.legend_rows())) * scene.legend_unit / scene.size
    for entity in UNTOUCHED:  # a click finds bodies alone
        overrides[f"{below}/{entity}"] = rrb.EntityBehavior(interactive=False)
    if forked:
        for panel in panels(scene, [kind for kind in FORK if kind in ARENA]):
            _add(overrides, {f"{FORKED}/{entity}": how for entity, how in panel.overrides().items()})
        return rrb.Spatial2DView(
            origin="/",
            contents=[f"+ /{FORKED}/world/**"],
            name=scene.fork,
            background=BACKGROUND,
            visual_bounds=bounds(scene, 0.09, above),
            overrides=overrides,
        )
    for panel in panels(scene, ARENA):
        _add(overrides, panel.overrides())
    whose = "all" if scene.few else "the focus then" if scene.chosen else "the focus"
    what = f"trails of {TRAIL_TICKS} ticks ({whose})" if scene.crowd else f"its trail of {TRAIL_TICKS} ticks"
    seen = "view field and lines of sight of the focus"
    shown: list[str] = []
    for name, who in scene.chosen.items():  # in the place of the focus that was
        shown += [f"- /world/{what}/{name}" for what in ("plan", "forecast", "came")]
        seen = f"view field of {who}"
        shown += [f"- /world/focus/{name}/**", f"+ /world/chosen/{who}/**"]
    return rrb.Spatial2DView(
        origin="/",
        contents=["+ /world/**", "- /world/maps/**", "- /world/here/**", "- /world/chosen/**", *shown],
        name=scene.run if scene.fork else f"{scene.run}: {what}, {seen}",  # half as wide beside a fork
        background=BACKGROUND,
        visual_bounds=bounds(scene, 0.09, above),
        overrides=overrides,
    )
