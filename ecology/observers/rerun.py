"""The world and its minds in the Rerun viewer, live and as a recording; what looks back at one is in hindsight.py.

A recording holds one entity per species for its bodies, however many they are, and one agent in
focus per species whose needs, drive, decision and deviation maps are drawn over time:

    world/walls, world/axes, world/legend       static, in the units of the plane
    world/resources, .../stock, .../names       circles, how full they are, and what they are called
    world/agents/SPECIES    Points2D and Arrows2D: bodies and headings, a row per slot; internal
                            variables, serial and action as numbers; in full, drive and reward too
    world/trail/SPECIES     Points2D: where bodies were at every tick since the last sample
    world/focus/SPECIES     LineStrips2D: view field and lines of sight of the agent in focus; its name
    world/marks/KIND        LineStrips2D: births, deaths, bites and gifts since the last sample
    world/maps/SPECIES/NEED/image   Image and the numbers of the deviation map behind it
    focus/SPECIES/{needs,deviation,drive,reward,action,decision}    of the agent in focus
    learning/SPECIES/{losses,numbers,error,J,met}   of Mind.report(), mean over the living, losses as
                            log10; of the focus: f's error, J, and the discounted drive met afterwards
    population/{count,flow,drive,stocks,measures}, population/ages/SPECIES, population/coupling/SPECIES
    events/SPECIES          TextLog: who was born, died, bit, gave, ate, slept

Timelines: "tick", and "sim_time" (one unit of the model's time shown as one second). A slot is taken
by one agent after another: `serial` says which, and a series breaks where another life begins.

Rerun's plane has y downwards. Positions are written as they are; the transform of `world`, which
mirrors y, turns the picture, so that y points up on the screen and numbers read there are true.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import pickle
import queue
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

# read by Rerun when it is loaded: that a file is written without its index is meant (see `_open`), no warning is due
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding::rrd::file_sink=error")

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from ecology.env import Ecology, Group, Tick
from ecology.errors import EcologyError
from ecology.observers import census, colours, maps, shapes
from ecology.observers.base import Mind
from ecology.observers.census import Census, Focus, Happening, Life
from ecology.observers.frame import Frame
from ecology.observers.viewer import (
    LOOPBACK,
    checked_url,
    complete,
    free_port,
    joined,
    resumed,
    stretches,
    viewer_process,
    whole,
)
from ecology.observers.wishes import Wishes
from ecology.plane import plane_of
from ecology.scenario import Scenario
from ecology.spec import Species, require
from ecology.state import State

SAMPLES = 256  # sent in one go, at most
SECONDS_FILE, SECONDS_LIVE = 1.0, 0.25  # of the clock between two sendings, at most
FEW = 100  # agents up to which every one has a trail, all its numbers and all its meals told; above, the focus alone
TRAIL_TICKS = 100  # length of a trail
MARK_TICKS = 20  # for which a birth, a death, a bite or a gift is marked, and at least two samples
STATE_TICKS, ACTION_TICKS = 1_000, 100  # of the internal state and the action on the first screen
FOCUS_TICKS = 500  # after which the hungriest is looked for again
SPARSE = 20  # samples between two age structures, and between two coupling matrices
LINES = {True: 20, False: 5}  # of the event log, per kind and sample, of few and of many; the rest is counted
COUPLED = 128  # agents whose coupling is drawn, at most
MARKS = 200  # per kind and sample, at most
MEMORY = "256MB"  # of history kept for viewers that attach late
BACKLOG = 64 * 2**20  # bytes that may wait for a viewer elsewhere; older ones are dropped
PATIENCE = 5.0  # seconds granted to a viewer elsewhere when the run ends
TIDY = 2 * 2**30  # bytes up to which a recording is put in order at the end, by a process that takes as much memory
BACKGROUND, FLOOR, WALL, INK = (16, 18, 22), (42, 46, 54), (225, 225, 225), (235, 235, 235)
FAINT = (120, 124, 132)
MARKED = {"born": INK, "died": INK, "bit": colours.BITING, "gave": colours.GIVING}
ATTEMPTS = 60  # to reach a viewer that was started, half a second apart
SETTLING = 12.0  # seconds in which a viewer's notices of the start fade and chunks load
BAR = 35  # height of the viewer's own bar, logical points
DRIVE_SCALE, MAP_SCALE = "plasma", "viridis"
STEPS = 64  # of the colour scale of the drive
COMPASS = 512  # directions in which a heading is drawn, and recorded for the viewer
DETAILS = ("full", "lean")
DEAD = 255  # action of a slot in which nobody lives

log = logging.getLogger("ecology")


class RerunObserver:
    """Shows a run in the Rerun viewer: as a file, to viewers that attach, to a viewer elsewhere.

    Nothing that a viewer does stops or changes the run: the file and the server never wait for
    one, and a viewer elsewhere (`connect`) is fed by a process of its own from a bounded queue.
    """

    def __init__(
        self,
        path: Path | str | None = None,
        *,
        every: int = 10,
        maps_every: int = 1_000,
        detail: str | None = None,
        serve: tuple[str, int] | None = None,
        connect: str | None = None,
        name: str | None = None,
        focus: Iterable[str] = (),
        resume: bool = False,
        before: tuple[Sequence[int], Sequence[int]] | None = None,
        wishes: Wishes | None = None,
    ) -> None:
        """Record every `every` ticks, and deviation maps every `maps_every` ticks.

        path: the file, "recording.rrd" of the run's folder. With `resume`, it is gone on with.
        detail: "full", or "lean" without drive and reward of every agent (the focus has them, and colours
        show the drive); full up to 100 agents and lean above when None.
        serve: (host, port) where viewers may attach; port 0 takes a free one, `url` says which.
        connect: rerun+http://HOST:PORT/proxy of a viewer elsewhere, which must be open already.
        focus: whom to draw over time: names of agents, a species (shown first), or "hungriest"; the first
        agent of each species otherwise. When one dies, another of its species takes its place.
        """
        for word, value in (("every", every), ("maps_every", maps_every)):
            require(
                isinstance(value, int) and value > 0,
                f"a recording's {word} is a whole number of ticks of at least 1; got {value!r}.",
            )
        require(
            detail is None or detail in DETAILS,
            f"a recording's detail is one of {', '.join(DETAILS)}; got {detail!r}.",
        )
        self._path = Path(path) if path is not None else None
        self._every, self._maps_every, self._name, self._detail = every, maps_every, name, detail
        self._asked, self._resume, self._before = tuple(focus), resume, before
        self._wishes = wishes or Wishes()
        require(
            self._path is None or resume or not self._path.exists(),
            f"there is a recording at {str(path)!r} already; choose another folder, or resume that run.",
        )
        self._host, self._port = (serve[0], free_port(*serve)) if serve else (LOOPBACK, 0)
        self._connect = checked_url(connect) if connect else None
        self._relay: Relay | None = None
        self._rec: rr.RecordingStream | None = None

    @property
    def url(self) -> str | None:
        """Return where viewers attach, None where nothing is served."""
        return f"rerun+http://{self._host}:{self._port}/proxy" if self._port else None

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Lay out the first screen and show the world as it stands."""
        state, scenario = env.state_view, env.scenario
        self._env, self._minds, self._grid = env, minds, maps.cover(scenario.arena)
        self._focus, self._census = Focus.of(env, self._asked), Census(env, self._before)
        self._focus.look(state)
        self._scene = scene = Scene(
            scenario=census.without_functions(scenario),
            groups={name: group for name, group in env.groups.items() if group.size},
            names={name: self._focus.name(name) for name in env.groups},
            first=self._focus.first,
            told={name: tuple(minds[name].report()) for name in env.groups},
            mapped={name: self._deviation(name) is not None for name in env.groups},
            decides={name: self._decision(name, None) is not None for name in env.groups},
            coupled=tuple(name for name in env.groups if env.coupling(name) is not None),
            measures=tuple(scenario.measures),
            grows=env.open_population,
            marks=tuple(shapes.marked(scenario)),
            grid=self._grid,
            run=self._name or scenario.name,
            every=self._every,
            full=(self._detail or ("full" if env.size <= FEW else "lean")) == "full",
            few=env.size <= FEW,
        )
        self._open(state.tick)
        if self._connect:
            self._relay = Relay(self._connect, scene)
        self._samples: list[dict[str, Any]] = []
        self._steps: list[np.ndarray] = []
        self._happened: list[Happening] = []
        self._told: set[str] = set()  # species whose focus is another since the last sample
        self._past: dict[str, Past] = {name: Past() for name in scene.groups}
        self._since = time.monotonic()
        self._next_map, self._sampled = 0, 0
        self._sample(state, None)
        self._map(state)
        self._send()

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Take a sampled tick, and send what has gathered now and then."""
        sampled = state.tick % self._every == 0
        turned = sampled and self._heed(state)
        self._told.update(self._focus.look(state, anew=turned or state.tick % FOCUS_TICKS == 0))
        slots = np.array(list(self._focus.slots.values()), np.int64)
        self._happened += self._census.watch(state, tick, None if self._scene.few else slots[slots >= 0])
        for name, past in self._past.items():
            past.follow(self._focus.serials[name], state.drive[self._focus.slots[name]])
        if not sampled:
            self._steps.append(self._placed(state))
            return
        self._sample(state, tick)
        if turned or state.tick >= self._next_map:
            self._map(state)
        wait = SECONDS_LIVE if self._port or self._relay else SECONDS_FILE
        if len(self._samples) >= SAMPLES or time.monotonic() - self._since > wait:
            self._send()

    def _heed(self, state: State) -> bool:
        """Turn to those whom somebody wishes to see, where they live; say whether there were any."""
        words = [name for click in self._wishes.clicks() if (name := self._focus.clicked(self._env, click))]
        for word in words:
            self._focus.turn(self._env, word)
        if (asked := self._wishes.word()) is not None:
            try:
                self._focus.turn(self._env, asked)
                self._wishes.answer(asked, f"{asked} is in focus from tick {state.tick} on", done=True)
                words.append(asked)
            except EcologyError as error:
                self._wishes.answer(asked, str(error), done=False)
        if self._scene.crowd and self._focus.first != self._scene.first:
            self._scene.first = self._focus.first
            if self._port or self._relay:  # a file alone keeps its first layout
                self._show("lay_out", self._scene.first)
        return bool(words)

    def flush(self) -> None:
        """Send the samples at hand, at a checkpoint."""
        self._send()

    def end(self) -> None:
        """Send what is left, close the file and put it in good order."""
        if self._rec is None:
            return
        state = self._env.state_view
        if state.tick > self._mapped_at and state.tick % self._every == 0:
            self._map(state)
        self._send()
        rec, self._rec = self._rec, None
        try:
            rec.flush(timeout_sec=PATIENCE)
        except RuntimeError as error:  # a viewer that hangs; the file is written all the same
            log.warning("the last of the recording may be missing in the viewer: %s", error)
        rec.disconnect()
        if self._relay:
            self._relay.close()
        if self._path:
            parts = [self._path] if self._target == self._path else [self._path, self._target]
            if len(parts) > 1 or self._path.stat().st_size <= TIDY:
                joined(parts, self._path)

    def _open(self, tick: int) -> None:
        """Open the file and the server, and send the first screen to both."""
        sinks: list[Any] = []
        identity = None
        if self._path:
            self._target = self._path
            if self._resume and tick == 0:  # the run was killed before its first checkpoint: it begins anew
                for part in stretches(self._path):
                    part.unlink()
            if self._resume and self._path.exists():
                self._target = resumed(self._path)
                if self._target.exists() or not whole(self._path):  # the run was killed
                    joined(stretches(self._path), self._path)
                identity = recording_id(self._path)
            self._path.parent.mkdir(parents=True, exist_ok=True)
            # the index of a file grows in memory with every chunk sent, some 4 kB each; `end` makes it instead
            sinks.append(rr.FileSink(str(self._target), write_footer=False))
        if self._port:
            sinks.append(rr.GrpcServerSink(self._host, self._port, server_memory_limit=MEMORY))
        self._rec = rr.RecordingStream(self._scene.application, recording_id=identity)
        if sinks:
            self._rec.set_sinks(*sinks, default_blueprint=self._scene.blueprint())
        self._scene.open(self._rec)

    # ---- what a sample holds ---------------------------------------------------------------

    def _placed(self, state: State) -> np.ndarray:
        """Return where those with a trail are, (k, 2): every slot, or one focus per species; the dead are nowhere."""
        if self._scene.few:
            return np.where(state.alive[:, None], state.position, np.nan).astype(np.float32)
        slots = np.array([self._focus.slots[name] for name in self._scene.groups])
        return np.where((slots >= 0)[:, None], state.position[slots], np.nan).astype(np.float32)

    def _sample(self, state: State, tick: Tick | None) -> None:
        """Copy what a sample shows; without a tick, the world as it stands before one."""
        alive, scene = state.alive, self._scene
        self._steps.append(self._placed(state))
        told = {}
        for name, group in scene.groups.items():
            report = self._minds[name].report() if scene.told[name] else {}
            living = alive[group.slots]
            known = [np.asarray(report.get(word, np.nan)) * np.ones(len(living)) for word in scene.told[name]]
            told[name] = np.array([_mean(value[living]) for value in known], dtype=float)
        acted = alive if tick is not None else alive & (state.tick > 0)
        sample = {
            "tick": state.tick,
            "time": state.time,
            "place": np.where(alive[:, None], state.position, np.nan).astype(np.float32),
            "heading": state.heading.astype(np.float32),
            "internal": np.where(alive[:, None], state.internal, np.nan).astype(np.float32),
            "drive": np.where(alive, state.drive, np.nan).astype(np.float32),
            "reward": np.where(alive, 0.0 if tick is None else tick.reward, np.nan).astype(np.float32),
            "serial": state.serial.astype(np.int32),
            "action": np.where(acted, state.action, DEAD).astype(np.uint8),
            "steps": np.stack(self._steps),  # (ticks since the last sample, k, 2)
            "resources": state.resource_position.astype(np.float32),
            "stock": shapes.fullness(scene.scenario, state).astype(np.float32),
            "told": told,
            "happened": self._happened,
            "focus": {name: self._look(name, state, tick) for name in scene.groups},
            "born": self._census.born.copy(),
            "died": self._census.died.copy(),
            "stocks": census.stocks(scene.scenario, state),
            "measures": np.array(self._env.scenario.measured(state)),
        }
        if self._sampled % SPARSE == 0:
            sample["ages"] = {name: census.ages(state.age[g.slots][alive[g.slots]]) for name, g in scene.groups.items()}
            sample["coupling"] = {name: self._coupling(name, state) for name in scene.coupled}
        self._samples.append(sample)
        self._sampled += 1
        self._steps, self._happened, self._told = [], [], set()

    def _look(self, name: str, state: State, tick: Tick | None) -> dict[str, Any]:
        """Return what is shown of the agent in focus of a species."""
        slot, past = self._focus.slots[name], self._past[name]
        species = self._scene.scenario.species[self._scene.groups[name].index]
        shown: dict[str, Any] = {"slot": slot, "name": self._focus.name(name), "anew": name in self._told}
        if slot < 0:
            return shown
        seen = np.concatenate([state.resource_position[state.seen[slot]], state.position[self._env.sighted(slot)]])
        gap = plane_of(self._scene.scenario.arena).gap(state.position[slot], seen)
        shown["sight"] = state.position[slot] + gap
        shown["field"] = shapes.view_field(species, state.position[slot], float(state.heading[slot]))
        decision = self._decision(name, tick) if tick is not None else None
        if decision is not None:
            shown["decision"] = decision
            shown["error"] = np.asarray(decision["error"], float)
            shown["met"] = past.judge(state.tick, state.time, float(decision["gamma"]), self._env.dt)
        return shown

    def _decision(self, name: str, tick: Tick | None) -> dict[str, Any] | None:
        """Return what the focus of a species weighs now; without a tick, whether it could."""
        group = self._env.groups[name]
        row = self._focus.slots[name] - group.slots.start
        if not group.size or (tick is not None and row < 0):
            return None
        if tick is None:
            zeta = np.zeros(len(group.layout.names), np.float32)
            return self._minds[name].decision(0, zeta, np.ones(len(group.actions), bool))
        return self._minds[name].decision(row, tick.observations[name][row], tick.masks[name][row])

    def _coupling(self, name: str, state: State) -> np.ndarray | None:
        """Return who feels whom and how much among the first living, (n, m)."""
        found = self._env.coupling(name)
        if found is None:
            return None
        weight, others = found
        rows = np.flatnonzero(state.alive[self._scene.groups[name].slots])[:COUPLED]
        columns = np.flatnonzero(state.alive[others])[:COUPLED]
        return weight[np.ix_(rows, columns)].astype(np.float32) if rows.size and columns.size else None

    def _deviation(self, name: str) -> np.ndarray | None:
        group, slot = self._env.groups[name], self._focus.slots[name]
        if not group.size:
            return None
        species = self._env.scenario.species[group.index]
        return maps.deviation_maps(species, group, self._minds[name], max(slot - group.slots.start, 0), self._grid)

    def _map(self, state: State) -> None:
        """Draw the deviation maps of the agents in focus as they are."""
        self._next_map, self._mapped_at = state.tick + self._maps_every, state.tick
        for name, there in self._scene.mapped.items():
            if there and self._focus.slots[name] >= 0:
                self._show("draw_maps", state.tick, state.time, name, self._deviation(name))

    def _send(self) -> None:
        samples, self._samples = self._samples, []
        self._since = time.monotonic()
        if samples:
            self._show("draw", samples)

    def _show(self, what: str, *arguments: Any) -> None:
        """Draw in the recording, and hand the same to the viewer elsewhere."""
        getattr(self._scene, what)(self._rec, *arguments)
        if self._relay:
            self._relay.put(pickle.dumps((what, arguments)))


class Past:
    """What the agent in focus felt at every tick, and what it had expected: J against what then happened."""

    def __init__(self) -> None:
        self._serial = -1
        self._drive: deque[float] = deque()  # of the ticks since the oldest expectation
        self._expected: deque[tuple[int, float]] = deque()  # tick and time

    def follow(self, serial: int, drive: float) -> None:
        """Take in the drive of a tick; another life begins anew."""
        if serial != self._serial:
            self._serial = serial
            self._drive.clear()
            self._expected.clear()
        if self._expected:
            self._drive.append(float(drive))

    def judge(self, tick: int, now: float, gamma: float, dt: float) -> list[tuple[int, float, float]]:
        """Note that J was told at `tick`; return (tick, time, discounted drive afterwards) of those long enough ago."""
        met = []
        self._expected.append((tick, now))
        span = math.ceil(math.log(0.05) / math.log(gamma) / dt)  # ticks: what is later weighs 5 %
        while tick - self._expected[0][0] >= span:
            began, then = self._expected.popleft()
            met.append((began, then, census.afterwards(np.array(self._drive)[:span], gamma, dt)))
            for _ in range(self._expected[0][0] - began):
                self._drive.popleft()
        return met


def _mean(value: np.ndarray) -> float:
    value = value[np.isfinite(value)]
    return float(value.mean()) if value.size else np.nan


@dataclass
class Scene:
    """What is drawn, and where: turns samples into Rerun's columns. Plain data, so that it can be sent."""

    scenario: Scenario
    groups: Mapping[str, Group]  # with at least one slot
    names: Mapping[str, str]  # species -> name of its focus at the start
    first: str | None  # species that is shown first
    told: Mapping[str, tuple[str, ...]]  # species -> numbers that its mind reports
    mapped: Mapping[str, bool]  # species -> whether there are deviation maps
    decides: Mapping[str, bool]  # species -> whether its mind shows its decisions
    coupled: tuple[str, ...]  # species with empathy
    measures: tuple[str, ...]  # of the scenario
    grows: bool  # whether anyone can be born
    marks: tuple[str, ...]  # kinds of events that can come up
    grid: maps.Grid
    run: str
    every: int
    full: bool  # whether every agent's drive and reward are recorded
    few: bool  # whether every agent has a trail
    chosen: Mapping[str, str] = field(default_factory=dict)  # species -> who is shown after the fact instead
    _acted: dict[str, int] = field(default_factory=dict)
    _resources: np.ndarray | None = None

    @property
    def application(self) -> str:
        """Return the name under which the viewer keeps the layout: one per scenario."""
        return "ecology-" + re.sub(r"[^A-Za-z0-9_-]", "_", self.scenario.name)

    @property
    def crowd(self) -> bool:
        """Return whether this is a population, not one agent."""
        return sum(group.size for group in self.groups.values()) > 1

    @property
    def mixed(self) -> bool:
        """Return whether there are several species: bodies have their colours, and headings show the drive."""
        return len(self.groups) > 1

    def _at(self, name: str) -> str:
        """Return where the life of a species' focus is drawn."""
        return f"chosen/{self.chosen[name]}" if name in self.chosen else f"focus/{name}"

    def colour(self, name: str) -> colours.Colour:
        """Return the colour of a species."""
        return colours.species_colour(self.groups[name].index, alone=not self.mixed)

    @property
    def _size(self) -> float:
        """Return the longer side of the arena."""
        return shapes.size(self.scenario)

    @property
    def _stocked(self) -> list[str]:
        return [r.name for r in self.scenario.resources if math.isfinite(r.stock)]

    # ---- what does not change ---------------------------------------------------------------

    def open(self, rec: rr.RecordingStream) -> None:
        """Draw what does not change."""
        rec.set_log_time_enabled(False)
        rec.send_recording_name(self.run)
        rec.log("world", rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]), static=True)
        shown = colours.scale(DRIVE_SCALE)[np.linspace(0, colours.SHADES - 1, STEPS).round().astype(int)]
        top = colours.highest_drive(self.scenario)
        rec.log(
            "world",
            rr.AnnotationContext(
                [
                    (i, f"drive {'≥ ' * (i == STEPS - 1)}{top * i / (STEPS - 1):.2f}", c.tolist())
                    for i, c in enumerate(shown)
                ]
            ),
            static=True,
        )
        self._draw_arena(rec)
        self._draw_legend(rec)
        for name, group in self.groups.items():
            self._open_species(rec, name, self.scenario.species[group.index])
        for kind, shade in MARKED.items():
            rec.log(
                f"world/marks/{kind}",
                rr.LineStrips2D.from_fields(colors=[shade], radii=rr.Radius.ui_points(0.8), draw_order=25),
                static=True,
            )
        self._open_population(rec)

    def _draw_arena(self, rec: rr.RecordingStream) -> None:
        arena = self.scenario.arena
        corners = np.array((*arena.vertices, arena.vertices[0]), float)
        shade = WALL if arena.walls else FAINT
        rec.log("world/walls", rr.LineStrips2D([corners], colors=[shade], draw_order=5), static=True)
        fine = maps.cover(arena, 400)
        floor = np.where(fine.inside[..., None], FLOOR, BACKGROUND).astype(np.uint8)
        _lay(rec, "world/floor", fine.corner, (fine.cell, fine.cell))
        rec.log("world/floor", rr.Image(floor, draw_order=-30), static=True)
        # axes: a number at round places below and left of the arena
        low, high = corners.min(axis=0), corners.max(axis=0)
        step = _round_step(self._size / 8)
        places, words = [], []
        for axis in range(2):
            for value in np.arange(np.ceil(low[axis] / step) * step, high[axis] + 1e-9, step):
                place = low - 0.035 * self._size
                place[axis] = value
                places.append(place)
                words.append(f"{'xy'[axis]} {value:g}" if value == low[axis] else f"{value:g}")
        _write(rec, "world/axes", places, words)

    def _legend(self) -> list[tuple[str, colours.Colour]]:
        """Return what the legend says besides the drive: words with their colour."""
        found = [(name, self.colour(name)) for name in self.groups] if self.mixed else []
        shades = colours.resource_colours(self.scenario)
        found += [(r.name, s) for r, s in zip(self.scenario.resources, shades, strict=True) if r.count > 1]
        found += [(shapes.KINDS[kind], MARKED[kind]) for kind in self.marks]
        return found

    def _rows(self) -> list[list[tuple[float, str, colours.Colour]]]:
        """Return the rows of the legend: words with their place along x, from the arena's left side."""
        width = np.ptp(np.array(self.scenario.arena.vertices, float)[:, 0])
        rows: list[list[tuple[float, str, colours.Colour]]] = [[]]
        at = 0.0
        for word, shade in self._legend():
            wide = self._size * (0.05 + 0.0125 * len(word))
            if at + wide > width and rows[-1]:
                rows.append([])
                at = 0.0
            rows[-1].append((at, word, shade))
            at += wide
        return rows if rows[0] else []

    def _draw_legend(self, rec: rr.RecordingStream) -> None:
        """Write the colour scale of the drive above the arena, and above it what else has a colour."""
        low, high = np.array(self.scenario.arena.extent)
        size = self._size
        top, wide, tall = high[1] + 0.06 * size, 0.3 * size, 0.02 * size
        bar = np.tile(colours.scale(DRIVE_SCALE), (2, 1, 1))  # (2, SHADES, 3)
        _lay(rec, "world/legend/drive", (float(low[0]), float(top)), (wide / bar.shape[1], tall / 2))
        rec.log("world/legend/drive", rr.Image(bar), static=True)
        what = "heading: drive 0" if self.mixed else "body: drive 0"
        places = [(low[0] + 0.02 * size, top), (low[0] + wide, top)]
        _write(rec, "world/legend/numbers", places, [what, f"{colours.highest_drive(self.scenario):.1f}"])
        for i, row in enumerate(self._rows()):
            y = high[1] + (0.12 + 0.055 * i) * size
            xs = np.array([low[0] + at + 0.012 * size for at, _, _ in row])
            shades = [shade for _, _, shade in row]
            dots = np.stack([xs, np.full(len(row), y)], axis=1)
            rec.log(f"world/legend/{i}", rr.Points2D(dots, radii=0.009 * size, colors=shades), static=True)
            middle = [(x + (0.02 + 0.006 * len(word)) * size, y + 0.022 * size)
                      for x, (_, word, _) in zip(xs, row, strict=True)]  # fmt: skip
            _write(rec, f"world/legend/{i}/words", middle, [word for _, word, _ in row])

    def radius(self, species: Species) -> float:
        """Return the radius with which a body is drawn."""
        return shapes.radius(self.scenario, species)

    def _open_species(self, rec: rr.RecordingStream, name: str, species: Species) -> None:
        colour, radius = self.colour(name), self.radius(species)
        body = f"world/agents/{name}"
        # the other one is coloured by class: the drive
        of_body, of_arrow = ([colour], None) if self.mixed else (None, [colour])
        points = rr.Points2D.from_fields(radii=radius, colors=of_body, show_labels=False, draw_order=20)
        rec.log(body, points, static=True)
        arrows = rr.Arrows2D.from_fields(radii=0.2 * radius, colors=of_arrow, show_labels=False)
        rec.log(body, arrows, static=True)
        trail = colours.shaded(colour, 0.6)
        rec.log(f"world/trail/{name}", rr.Points2D.from_fields(radii=0.25 * radius, colors=[trail], draw_order=10),
                static=True)  # fmt: skip
        self.open_life(rec, name, species)
        for part, told in zip(("losses", "numbers"), _losses(self.told[name]), strict=True):
            if told:
                _series(rec, f"learning/{name}/{part}", told, colours.PALETTE)
        if self.decides[name]:
            layout = self.groups[name].layout
            _series(
                rec, f"learning/{name}/error", layout.names, [colours.need_colour(i) for i in range(len(layout.names))]
            )
            _series(rec, f"learning/{name}/J", ["-ln(gamma) J"], [colours.PALETTE[0]])
            _series(rec, f"learning/{name}/met", ["drive met afterwards, discounted"], [colours.PALETTE[1]])
        for i in maps.mapped_needs(species) if self.mapped.get(name) else ():
            _lay(
                rec,
                f"world/maps/{name}/{species.needs[i].name}/image",
                self.grid.corner,
                (self.grid.cell,) * 2,
            )

    def open_life(self, rec: rr.RecordingStream, name: str, species: Species) -> None:
        """Name and colour what is drawn of the life of a species' focus."""
        thin = rr.Radius.ui_points(0.4)
        rec.log(f"world/{self._at(name)}", rr.LineStrips2D.from_fields(colors=[FAINT], radii=thin, draw_order=15),
                static=True)  # fmt: skip
        label = rr.Points2D.from_fields(radii=1e-4, colors=[INK], show_labels=True, draw_order=30)
        rec.log(f"world/{self._at(name)}/name", label, static=True)
        base, shades = self._at(name), [colours.need_colour(i) for i in range(len(species.needs))]
        _series(rec, f"{base}/deviation", [need.name for need in species.needs], shades)
        words, lines = [], []
        for need, shade in zip(species.needs, shades, strict=True):
            words += [need.name, "set point", "lower bound", "upper bound"]
            lines += [shade, INK, FAINT, FAINT]
        _series(rec, f"{base}/needs", words, lines, [2.0, 1.0, 1.0, 1.0] * len(species.needs))
        many = self.groups[name].size > 1
        who = self.chosen.get(name, "in focus" if many else self.names[name])
        words = [who, *(["mean of the species"] * many)]
        _series(rec, f"{base}/drive", words, [(240, 240, 240), colours.PALETTE[0]])
        _series(rec, f"{base}/reward", ["reward"], [colours.PALETTE[1]])
        rec.log(
            f"{base}/action",
            rr.StateConfiguration(
                values=[a.name for a in species.actions],
                labels=[a.name for a in species.actions],
                colors=_packed(np.array(colours.action_colours(self.scenario, species), np.uint8)),
            ),
            static=True,
        )

    def _open_population(self, rec: rr.RecordingStream) -> None:
        """Name and colour the series of the populations."""
        if not self.crowd:
            return
        names, shades = list(self.groups), [self.colour(name) for name in self.groups]
        dim = [colours.shaded(shade, 0.55) for shade in shades]
        _series(rec, "population/count", names, shades, [2.0] * len(names))
        _series(rec, "population/flow", [f"{n} born" for n in names] + [f"{n} died" for n in names], shades + dim)
        words = [word for n in names for word in (n, f"{n} - sd", f"{n} + sd")]
        thrice = [each for shade, faint in zip(shades, dim, strict=True) for each in (shade, faint, faint)]
        _series(rec, "population/drive", words, thrice, [2.0, 0.8, 0.8] * len(names))
        if self._stocked:
            food = dict(
                zip((r.name for r in self.scenario.resources), colours.resource_colours(self.scenario), strict=True)
            )
            _series(rec, "population/stocks", self._stocked, [food[n] for n in self._stocked])
        if self.measures:
            _series(rec, "population/measures", self.measures, colours.PALETTE)

    # ---- what a sample brings ---------------------------------------------------------------

    def draw(self, rec: rr.RecordingStream, samples: Sequence[Mapping[str, Any]]) -> None:
        """Send samples, in columns."""
        column = {
            key: np.stack([s[key] for s in samples])
            for key in ("tick", "time", "place", "heading", "internal", "drive", "reward", "serial", "action")
        }
        times = _times(column["tick"], column["time"])
        self._draw_resources(rec, times, samples)
        turn = 2 * np.pi / COMPASS
        angle = (column["heading"] / turn).round() * turn
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32)  # (n, N, 2)
        top = colours.highest_drive(self.scenario)
        level = (np.clip(np.nan_to_num(column["drive"]) / top, 0, 1) * (STEPS - 1)).round().astype(np.uint16)
        for i, (name, group) in enumerate(self.groups.items()):
            species, rows = self.scenario.species[group.index], group.slots
            each = [group.size] * len(samples)
            numbers = {need.name: column["internal"][:, rows, k] for k, need in enumerate(species.needs)}
            extra = ("drive", "reward") if self.full else ()
            numbers |= {key: column[key][:, rows] for key in (*extra, "serial", "action")}
            drive = {"class_ids": level[:, rows].reshape(-1)}
            arrow = (2.5 * self.radius(species) * way[:, rows]).reshape(-1, 2)
            at = column["place"][:, rows].reshape(-1, 2)
            rec.send_columns(
                f"world/agents/{name}",
                times,
                [
                    *rr.Points2D.columns(positions=at, **({} if self.mixed else drive)).partition(each),
                    *rr.Arrows2D.columns(vectors=arrow, **(drive if self.mixed else {})).partition(each),
                    *rr.AnyValues.columns(
                        **{key: pa.array(value.reshape(-1)) for key, value in numbers.items()}
                    ).partition(each),
                ],
            )
            who = rows if self.few else slice(i, i + 1)
            steps = [s["steps"][:, who].reshape(-1, 2) for s in samples]
            rec.send_columns(
                f"world/trail/{name}",
                times,
                rr.Points2D.columns(positions=np.concatenate(steps)).partition([len(s) for s in steps]),
            )
            self._draw_focus(rec, name, species, samples, column)
            told = np.stack([s["told"][name] for s in samples])  # (n, K)
            for part, words in zip(("losses", "numbers"), _losses(self.told[name]), strict=True):
                if words:
                    value = told[:, [self.told[name].index(word) for word in words]]
                    if part == "losses":
                        value = np.log10(np.where(value > 0, value, np.nan))
                    _scalars(rec, f"learning/{name}/{part}", times, value)
        self._draw_marks(rec, times, samples)
        self._tell(rec, samples)
        if self.crowd:
            self._draw_population(rec, samples, times, column)

    def _draw_focus(
        self,
        rec: rr.RecordingStream,
        name: str,
        species: Species,
        samples: Sequence[Mapping[str, Any]],
        column: Mapping[str, np.ndarray],
    ) -> None:
        shown = [s["focus"][name] for s in samples]
        n, rows = np.arange(len(samples)), self.groups[name].slots
        slot = np.array([f["slot"] for f in shown])
        gap = np.where((slot < 0) | [f["anew"] for f in shown], np.nan, 0.0)  # a series breaks between two lives
        many = self.groups[name].size > 1
        life = Life(
            tick=column["tick"],
            time=column["time"],
            internal=column["internal"][n, slot][:, : len(species.needs)] + gap[:, None],
            drive=column["drive"][n, slot] + gap,
            mean=np.array([_mean(row) for row in column["drive"][:, rows]]) if many else None,
            reward=column["reward"][n, slot] + gap,
            action=np.where(slot < 0, DEAD, column["action"][n, slot]),
            place=np.where((slot < 0)[:, None], np.nan, column["place"][n, slot]),
            names=[f["name"] for f in shown],
            field=[f.get("field", np.empty((0, 2))) for f in shown],
            sight=[f.get("sight", np.empty((0, 2))) for f in shown],
        )
        self.draw_life(rec, name, species, life)
        self._draw_decisions(rec, name, shown, column)

    def draw_life(self, rec: rr.RecordingStream, name: str, species: Species, life: Life) -> None:
        """Send what is drawn of the life of a species' focus."""
        base, needs, times = self._at(name), species.needs, _times(life.tick, life.time)
        x, n = life.internal, len(life.tick)
        target = np.array([need.set_point for need in needs])
        bounds = np.array([(need.set_point, need.low, need.bounds[1]) for need in needs])
        bounds[~np.isfinite(bounds)] = np.nan
        beside = np.broadcast_to(bounds, (n, *bounds.shape))
        _scalars(rec, f"{base}/deviation", times, x - target)
        _scalars(rec, f"{base}/needs", times, np.concatenate([x[..., None], beside], axis=-1).reshape(n, -1))
        drive = [life.drive] if life.mean is None else [life.drive, life.mean]
        _scalars(rec, f"{base}/drive", times, np.stack(drive, axis=1))
        if life.reward is not None:
            _scalars(rec, f"{base}/reward", times, life.reward[:, None])
        self._draw_action(rec, name, species, life.tick, life.time, life.action)
        # the view field and the lines of sight, in the plane
        strips: list[np.ndarray] = []
        lengths = []
        for at, outline, sight in zip(life.place, life.field, life.sight, strict=True):
            seen = [np.stack([at, there]) for there in sight] + ([outline] if len(outline) else [])
            strips += seen
            lengths.append(len(seen))
        rec.send_columns(f"world/{base}", times, rr.LineStrips2D.columns(strips=strips).partition(lengths))
        if self.crowd:
            place = life.place - [0.0, 1.2 * self.radius(species)]
            labels = rr.Points2D.columns(positions=place, labels=life.names)
            rec.send_columns(f"world/{base}/name", times, labels)

    def _draw_action(
        self,
        rec: rr.RecordingStream,
        name: str,
        species: Species,
        tick: np.ndarray,
        now: np.ndarray,
        action: np.ndarray,
    ) -> None:
        before = np.concatenate([[self._acted.get(name, -2)], action[:-1]])
        self._acted[name] = int(action[-1])
        changed = np.flatnonzero(action != before)
        if changed.size:
            words = [species.actions[a].name if a != DEAD else "" for a in action[changed]]
            rec.send_columns(
                f"{self._at(name)}/action", _times(tick[changed], now[changed]), rr.StateChange.columns(state=words)
            )

    def _draw_decisions(
        self, rec: rr.RecordingStream, name: str, shown: Sequence[Mapping[str, Any]], column: Mapping[str, np.ndarray]
    ) -> None:
        """Write what the agent in focus weighs, and how its f and its J fare."""
        at = np.array([i for i, f in enumerate(shown) if "decision" in f], int)
        if not at.size:
            return
        times = _times(column["tick"][at], column["time"][at])
        told = [shown[i]["decision"] for i in at]
        each = [len(d["names"]) for d in told]
        keys = ("next_drive", "slope", "sum", "score", "open")
        numbers = {key: pa.array(np.concatenate([np.asarray(d[key]) for d in told])) for key in keys}
        text = [_table(shown[i]["name"], d) for i, d in zip(at, told, strict=True)]
        rec.send_columns(
            f"focus/{name}/decision",
            times,
            [
                *rr.TextDocument.columns(text=text, media_type=["text/markdown"] * len(text)),
                *rr.AnyValues.columns(**numbers).partition(each),
            ],
        )
        _scalars(rec, f"learning/{name}/error", times, np.stack([shown[i]["error"] for i in at]))
        _scalars(rec, f"learning/{name}/J", times, np.array([[d["J"]] for d in told]))
        met = [each for i in at for each in shown[i]["met"]]
        if met:
            ticks, nows, value = (np.array(part) for part in zip(*met, strict=True))
            _scalars(rec, f"learning/{name}/met", _times(ticks, nows), value[:, None])

    def _draw_resources(
        self, rec: rr.RecordingStream, times: list[rr.TimeColumn], samples: Sequence[Mapping[str, Any]]
    ) -> None:
        """Draw the resources again where they have moved, and how full the finite ones are."""
        resources = [r for r in self.scenario.resources for _ in range(r.count)]
        if not resources:
            return
        shades = colours.resource_colours(self.scenario)
        kind = np.repeat(np.arange(len(self.scenario.resources)), [r.count for r in self.scenario.resources])
        each = [shades[k] for k in kind]
        radii = np.array([r.radius for r in resources], np.float32)
        place = np.stack([s["resources"] for s in samples])  # (n, R, 2)
        before = np.concatenate([place[:1] if self._resources is None else self._resources[None], place[:-1]])
        moved = np.flatnonzero((place != before).any(axis=(1, 2)))
        if self._resources is None:
            moved = np.union1d([0], moved)
            thin = rr.Radius.ui_points(1.0 if len(resources) > len(shades) else 1.5)
            line = rr.Ellipses2D.from_fields(colors=each, line_radii=thin, draw_order=8)
            rec.log("world/resources", line, static=True)
            # a dark rim, so that a circle stands out from a map of its own colour
            rim = rr.Ellipses2D.from_fields(colors=[BACKGROUND], line_radii=rr.Radius.ui_points(3.0), draw_order=7)
            rec.log("world/resources/rim", rim, static=True)
            full = rr.Points2D.from_fields(colors=[colours.shaded(s, 0.5) for s in each], draw_order=6)
            rec.log("world/resources/stock", full, static=True)
            single = [k for k, r in enumerate(self.scenario.resources) if r.count == 1]
            words = rr.Points2D.from_fields(
                radii=1e-4,
                labels=[self.scenario.resources[k].name for k in single],
                colors=[shades[k] for k in single],
                show_labels=True,
                draw_order=30,
            )
            rec.log("world/resources/names", words, static=True)
        self._resources = place[-1]
        some = [times[0], times[1]] if len(moved) == len(samples) else _times(
            np.array([samples[int(i)]["tick"] for i in moved]), np.array([samples[int(i)]["time"] for i in moved])
        )  # fmt: skip
        finite = not all(r.constant for r in resources)
        if moved.size:
            parts, at = [len(resources)] * len(moved), place[moved].reshape(-1, 2)
            half = np.tile(np.stack([radii, radii], axis=1), (len(moved), 1))
            circles = [*rr.Ellipses2D.columns(centers=at, half_sizes=half).partition(parts)]
            rec.send_columns("world/resources", some, circles)
            rec.send_columns("world/resources/rim", some, circles)
            if finite:
                rec.send_columns("world/resources/stock", some, rr.Points2D.columns(positions=at).partition(parts))
            first = [int(np.flatnonzero(kind == k)[0]) for k, r in enumerate(self.scenario.resources) if r.count == 1]
            beside = [self._beside(p[k], radii[k], len(resources[k].name)) for p in place[moved] for k in first]
            if first:
                words_ = rr.Points2D.columns(positions=beside).partition([len(first)] * len(moved))
                rec.send_columns("world/resources/names", some, words_)
        if finite:
            full_ = (STEPS * np.sqrt(np.stack([s["stock"] for s in samples]))).round() / STEPS * radii
            rec.send_columns(
                "world/resources/stock",
                times,
                rr.Points2D.columns(radii=full_.astype(np.float32).reshape(-1)).partition(
                    [len(resources)] * len(samples)
                ),
            )

    def _beside(self, centre: np.ndarray, radius: float, letters: int) -> tuple[float, float]:
        """Return where a word may hang below or above a circle without lying on a wall."""
        import shapely  # slow to load

        walls = shapely.Polygon(self.scenario.arena.vertices).exterior
        size = max(walls.bounds[2] - walls.bounds[0], walls.bounds[3] - walls.bounds[1])
        half, tall = 0.009 * size * letters, 0.04 * size  # of the word, as the first screen shows it
        x, y = map(float, centre)
        for gap in np.arange(0.0, 0.3, 0.01) * size:
            for top in (y - radius - gap, y + radius + gap + tall):
                if not walls.intersects(shapely.box(x - half, top - tall, x + half, top)):
                    return x, top
        return x, y - radius

    def _draw_marks(
        self, rec: rr.RecordingStream, times: list[rr.TimeColumn], samples: Sequence[Mapping[str, Any]]
    ) -> None:
        """Mark births, deaths, bites and gifts where they happened since the last sample."""
        wide = max(self.radius(species) for species in self.scenario.species)
        far = max(action.reach for species in self.scenario.species for action in species.actions)
        for kind in MARKED:
            found = [[e for e in s["happened"] if e.kind == kind] for s in samples]
            if not any(found):
                continue
            strips, lengths = [], []
            for events in found:
                mine = [strip for e in events for strip in shapes.mark(kind, e.place, e.other_place, wide)][: 2 * MARKS]
                if kind in ("bit", "gave"):  # who was put elsewhere after it is not joined by a line
                    mine = [strip for strip in mine if np.hypot(*(strip[1] - strip[0])) <= 2 * far]
                strips += mine
                lengths.append(len(mine))
            rec.send_columns(f"world/marks/{kind}", times, rr.LineStrips2D.columns(strips=strips).partition(lengths))

    def _tell(self, rec: rr.RecordingStream, samples: Sequence[Mapping[str, Any]]) -> None:
        """Write the event log: every event of a few agents, of many the most telling, and how many more."""
        groups = list(self.groups.values())
        for group in groups:
            rows: list[tuple[int, float, str, str]] = []
            most = LINES[self.few]
            for s in samples:
                left: dict[str, int] = {}
                focus = s["focus"][group.name]
                if focus["anew"]:
                    rows.append((s["tick"], s["time"], "focus", f"now in focus: {focus['name']}"))
                for event in s["happened"]:
                    mine = (event.slot >= group.slots.start) & (event.slot < group.slots.stop)
                    for i in np.flatnonzero(mine):
                        left[event.kind] = left.get(event.kind, 0) + 1
                        if left[event.kind] <= most:
                            words = census.words(self.scenario, groups, event, int(i))
                            rows.append((event.tick, event.time, event.kind, words))
                rows += [
                    (s["tick"], s["time"], kind, f"and {many - most} more {group.name} {kind}")
                    for kind, many in left.items()
                    if many > most
                ]
            if rows:
                ticks, nows, kinds, texts = zip(*rows, strict=True)
                shades = _packed(np.array([MARKED.get(kind, FAINT) for kind in kinds], np.uint8))
                rec.send_columns(
                    f"events/{group.name}",
                    _times(np.array(ticks), np.array(nows)),
                    rr.TextLog.columns(text=texts, level=kinds, color=shades),
                )

    def _draw_population(
        self,
        rec: rr.RecordingStream,
        samples: Sequence[Mapping[str, Any]],
        times: list[rr.TimeColumn],
        column: Mapping[str, np.ndarray],
    ) -> None:
        """Draw numbers, births and deaths, drives, ages, stocks, measures and couplings."""
        count, drives = [], []
        for group in self.groups.values():
            drive = column["drive"][:, group.slots]
            lives = np.isfinite(drive)
            many = lives.sum(axis=1)
            total = np.where(lives, drive, 0.0).sum(axis=1)
            mean = np.divide(total, many, out=np.full(len(many), np.nan), where=many > 0)
            off = np.where(lives, drive - mean[:, None], 0.0)
            spread = np.sqrt(np.divide((off**2).sum(axis=1), many, out=np.full(len(many), np.nan), where=many > 0))
            count.append(many.astype(float))
            drives += [mean, mean - spread, mean + spread]
        _scalars(rec, "population/count", times, np.stack(count, axis=1))
        _scalars(rec, "population/drive", times, np.stack(drives, axis=1))
        index = [group.index for group in self.groups.values()]
        flow = np.stack([np.concatenate([s["born"][index], s["died"][index]]) for s in samples]).astype(float)
        _scalars(rec, "population/flow", times, flow)
        for word, there in (("stocks", self._stocked), ("measures", self.measures)):
            if there:
                _scalars(rec, f"population/{word}", times, np.stack([s[word] for s in samples]))
        for s in samples:
            if "ages" not in s:
                continue
            rec.set_time("tick", sequence=s["tick"])
            rec.set_time("sim_time", duration=float(s["time"]))
            for name, (middle, number) in s["ages"].items():
                shade, wide = self.colour(name), np.full(len(middle), 0.9 * 2 * middle[0])
                rec.log(
                    f"population/ages/{name}", rr.BarChart(number, abscissa=middle - wide / 2, widths=wide, color=shade)
                )
            for name, weight in s["coupling"].items():
                if weight is not None:
                    rec.log(f"population/coupling/{name}", rr.Tensor(weight, dim_names=("feels", "felt")))

    def draw_maps(self, rec: rr.RecordingStream, tick: int, now: float, name: str, found: np.ndarray | None) -> None:
        """Send the deviation maps (k, rows, columns) of a species' focus agent."""
        if found is None or not np.isfinite(found).any():
            return
        rec.set_time("tick", sequence=tick)
        rec.set_time("sim_time", duration=now)
        species = self.scenario.species[self.groups[name].index]
        x, y = self.grid.corner
        for i, value in zip(maps.mapped_needs(species), found, strict=True):
            entity = f"world/maps/{name}/{species.needs[i].name}"
            low, high = float(np.nanmin(value)), float(np.nanmax(value))
            image = colours.shade(MAP_SCALE, value, low, high)
            image[~np.isfinite(value)] = BACKGROUND
            rec.log(
                f"{entity}/image",
                rr.Image(image, draw_order=-10),
                rr.AnyValues(
                    deviation=pa.array(value.astype(np.float32).reshape(-1)),
                    shape=np.array(value.shape, np.int32),
                ),
            )
            wide, tall = value.shape[1] * self.grid.cell, value.shape[0] * self.grid.cell
            ends = [(x + share * wide, y - 0.03 * tall) for share in (0.2, 0.8)]
            words = [f"dark {low:.2f}", f"bright {high:.2f}"]
            rec.log(f"{entity}/range", *_text(ends, words, [INK] * 2))

    # ---- the first screen ------------------------------------------------------------------

    def lay_out(self, rec: rr.RecordingStream, first: str | None) -> None:
        """Show the life of the species `first` first from now on."""
        self.first = first
        rec.send_blueprint(self.blueprint())

    def blueprint(self) -> rrb.Blueprint:
        """Return the layout: the arena over the maps on the left; on the right a life, or populations and lives."""
        there = sorted(self.groups, key=lambda name: name != self.first)
        arena = self._arena_view()
        below = [self._map_views(name) for name in there if self.mapped.get(name)]
        events: rrb.View = rrb.TextLogView(
            origin="/events", name="events", columns=rrb.TextLogColumns(text_log_columns=["LogLevel", "Body"])
        )
        if self.crowd:
            left = rrb.Vertical(arena, rrb.Tabs(events, *below, active_tab=0), row_shares=[2.6, 1])
            right: rrb.Container | rrb.View = rrb.Tabs(
                self._population_views(), *(self._life_views(name) for name in there), active_tab=int(bool(self.first))
            )
        else:
            left = rrb.Vertical(arena, rrb.Tabs(*below, events, active_tab=0), row_shares=[2.3, 1])
            right = self._life_views(there[0]) if there else events
        return rrb.Blueprint(
            rrb.Horizontal(left, right, column_shares=[1.1, 1]),
            rrb.TimePanel(timeline="tick", play_state="following", state="collapsed"),
            collapse_panels=True,
            auto_layout=False,
            auto_views=False,
        )

    def _bounds(self, below: float, above: float) -> rrb.VisualBounds2D:
        """Return the arena and a margin, in the view's plane: y mirrored."""
        corners = np.array(self.scenario.arena.vertices, float)
        low, high = corners.min(axis=0), corners.max(axis=0)
        size = float((high - low).max())
        return rrb.VisualBounds2D(
            x_range=[low[0] - 0.06 * size, high[0] + 0.03 * size],
            y_range=[-high[1] - above * size, -low[1] + below * size],
        )

    def _arena_view(self) -> rrb.Spatial2DView:
        overrides: dict[Any, Any] = {
            f"world/trail/{name}": _last(TRAIL_TICKS, self.scenario.dt) for name in self.groups
        }
        # arrows begin where bodies are: the positions are recorded once
        origin = VisualizerComponentMapping(
            target="Arrows2D:origins",
            source_kind=ComponentSourceKind.SourceComponent,
            source_component="Points2D:positions",
        )
        for name in self.groups:
            overrides[f"world/agents/{name}"] = [
                rr.Points2D.from_fields().visualizer(),
                rr.Arrows2D.from_fields(draw_order=21).visualizer(mappings=[origin]),
            ]
        recent = max(MARK_TICKS, 2 * self.every) if self.few else self.every - 1  # of many, the last sample's alone
        overrides |= {f"world/marks/{kind}": _last(recent, self.scenario.dt) for kind in MARKED}
        whose = "all" if self.few else "the focus then" if self.chosen else "the focus"
        what = f"trails of {TRAIL_TICKS} ticks ({whose})" if self.crowd else f"its trail of {TRAIL_TICKS} ticks"
        seen = "view field and lines of sight of the focus"
        shown: list[str] = []
        for name, who in self.chosen.items():  # in the place of the focus that was
            seen = f"view field of {who}"
            shown += [f"- /world/focus/{name}/**", f"+ /world/chosen/{who}/**"]
        return rrb.Spatial2DView(
            origin="/",
            contents=["+ /world/**", "- /world/maps/**", "- /world/chosen/**", *shown],
            name=f"{self.run}: {what}, {seen}",
            background=BACKGROUND,
            visual_bounds=self._bounds(0.09, 0.11 + 0.055 * len(self._rows())),
            overrides=overrides,
        )

    def _map_views(self, name: str) -> rrb.Container:
        species = self.scenario.species[self.groups[name].index]
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
                    visual_bounds=self._bounds(0.19, 0.03),
                )
            )
        whose = f"the {name} then in focus" if name in self.chosen else self._who(name)
        return rrb.Grid(*views, grid_columns=len(views), name=f"deviation of {whose}")

    def _who(self, name: str) -> str:
        """Return what the agent in focus is called in a title: its name, or a word where it can change."""
        if name in self.chosen:
            return self.chosen[name]
        return f"{name} in focus" if self.groups[name].size > 1 or self.grows else self.names[name]

    def _population_views(self) -> rrb.Container:
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
            for name in self.groups
        ]
        rows: list[rrb.View | rrb.Container] = [
            rrb.Horizontal(count, flow) if self.grows or "died" in self.marks else count,
            drive,
        ]
        if self.grows or any(s.hazard for s in self.scenario.species):
            rows.append(rrb.Horizontal(*bars) if len(bars) <= 3 else rrb.Tabs(*bars))
        last: list[rrb.View] = []
        if self._stocked:
            last.append(_plot("/population/stocks", "stocks, units of intake"))
        if self.measures:
            last.append(_plot("/population/measures", "measures of the scenario"))
        last += [
            rrb.TensorView(origin=f"/population/coupling/{name}", name=f"{name}: who (row) feels whom (column)")
            for name in self.coupled
        ]
        if last:
            rows.append(rrb.Horizontal(*last) if len(last) <= 3 else rrb.Tabs(*last))
        return rrb.Vertical(*rows, name="populations")

    def _life_views(self, name: str) -> rrb.Container:
        who, dt = self._who(name), self.scenario.dt
        at = rrb.TimeRangeBoundary.cursor_relative
        # in ticks, the timeline of the first screen; on sim_time the lane shows the present action alone
        known = self.full or name not in self.chosen  # after the fact, of many, no rewards, nor what is felt of others
        feels = self.scenario.species[self.groups[name].index].empathy is not None
        title = "drive, whole life" if known or not feels else "drive of its own needs, whole life"
        drive = _plot(f"/{self._at(name)}/drive", title)
        reward = rrb.TimeSeriesView(
            origin=f"/{self._at(name)}/reward",
            name=f"reward, last {STATE_TICKS} ticks",
            time_ranges=_last(STATE_TICKS, dt),
            plot_legend=rrb.PlotLegend(visible=False),
        )
        latest = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=at(seq=-ACTION_TICKS), end=at(seq=0)))
        views: list[rrb.View | rrb.Container] = [
            rrb.Tabs(
                self._need_views(name),
                rrb.TimeSeriesView(
                    origin=f"/{self._at(name)}/deviation",
                    name="x - x* of every need, its own unit",
                    time_ranges=_last(STATE_TICKS, dt),
                    plot_legend=LEGEND,
                ),
                # where slots are used again, a line would join two lives
                *([self._everyone_views(name)] if 1 < self.groups[name].size <= FEW and not self.grows else []),
                active_tab=0,
            ),
            rrb.StateTimelineView(
                origin=f"/{self._at(name)}/action",
                name=f"{who}: action; last {ACTION_TICKS} ticks",
                time_ranges=_last(ACTION_TICKS, dt),
                time_view=latest,
            ),
            rrb.Horizontal(drive, reward) if known else drive,
        ]
        shares = [3.0, 1.1, 1.6]
        learning = self._learning_views(name)
        if self.decides[name]:
            title = "decision: the least score open is taken"
            text = rrb.TextDocumentView(origin=f"/{self._at(name)}/decision", name=title)
            views.append(rrb.Horizontal(text, rrb.Tabs(*learning, active_tab=0)) if learning else text)
            shares.append(2.6)
        elif learning:
            views.append(learning[0] if len(learning) == 1 else rrb.Tabs(*learning, active_tab=0))
            shares.append(2.0)
        return rrb.Vertical(*views, row_shares=shares, name=who)

    def _need_views(self, name: str) -> rrb.Container:
        """Return a plot per need: the variable against its set point and its bounds."""
        species = self.scenario.species[self.groups[name].index]
        views = []
        for i, need in enumerate(species.needs):
            shown = [i == k // 4 for k in range(4 * len(species.needs))]
            views.append(
                rrb.TimeSeriesView(
                    origin=f"/{self._at(name)}/needs",
                    name=f"{need.name} (x* {need.set_point:g})",
                    time_ranges=_last(STATE_TICKS, self.scenario.dt),
                    plot_legend=rrb.PlotLegend(visible=False),
                    overrides={f"{self._at(name)}/needs": rr.SeriesLines.from_fields(visible_series=shown)},
                )
            )
        title = f"{self._who(name)}: every need with x* (white) and bounds (grey); last {STATE_TICKS} ticks"
        return rrb.Grid(*views, grid_columns=min(3, math.ceil(math.sqrt(len(views)))), name=title)

    def _everyone_views(self, name: str) -> rrb.Container:
        """Return a plot per need with a line for every agent: that of an agent that is clicked stands out."""
        species, views = self.scenario.species[self.groups[name].index], []
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
                    time_ranges=_last(STATE_TICKS, self.scenario.dt),
                    plot_legend=rrb.PlotLegend(visible=False),
                    overrides={f"world/agents/{name}": [lines]},
                )
            )
        title = f"every {name}; click one in the arena"
        return rrb.Grid(*views, grid_columns=min(3, math.ceil(math.sqrt(len(views)))), name=title)

    def _learning_views(self, name: str) -> list[rrb.View]:
        losses, numbers = _losses(self.told[name])
        found: list[rrb.View] = (
            [_plot(f"/learning/{name}/losses", f"losses, log10: {', '.join(losses)}")] if losses else []
        )
        if self.decides[name] and name not in self.chosen:
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


# the whole timeline; by itself a view takes the width of the others
ALWAYS = rrb.TimeAxis(
    link="Independent",
    view_range=rrb.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite()),
)
LEGEND = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)


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


def _losses(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the reported names that are losses, and the others."""
    losses = [word for word in words if word.startswith("loss")]
    return losses, [word for word in words if word not in losses]


def _table(name: str, decision: Mapping[str, Any]) -> str:
    """Return a decision as a table in Markdown, the least score first, what is closed last."""
    open_, score = np.asarray(decision["open"]), np.asarray(decision["score"])
    order = np.argsort(np.where(open_, score, np.inf), kind="stable")
    rows = [
        f"**{name}**, -ln(γ) J = {decision['J']:.3f}",
        "",
        "| movement | next drive | dJ/dζ·f | sum | score |",
        "|---|---|---|---|---|",
    ]
    for i in order:
        numbers = " | ".join(f"{decision[key][i]:.3f}" for key in ("next_drive", "slope", "sum", "score"))
        word = decision["names"][i]
        word = f"**{word}**" if i == order[0] and open_[i] else word if open_[i] else f"~~{word}~~ closed"
        rows.append(f"| {word} | {numbers if open_[i] else ' - | - | - | -'} |")
    return "\n".join(rows)


def _round_step(least: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at least `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * next(m for m in (1, 2, 5, 10) if m * power >= least * (1 - 1e-9)))


def _packed(shade: np.ndarray) -> np.ndarray:
    """Return opaque colours 0xRRGGBBAA, uint32 (...), of uint8 (..., 3)."""
    r, g, b = (shade[..., i].astype(np.uint32) for i in range(3))
    return (r << 24) | (g << 16) | (b << 8) | np.uint32(255)


def _lay(rec: rr.RecordingStream, entity: str, corner: tuple[float, float], cell: tuple[float, float]) -> None:
    """Lay the images of `entity` on the plane: lower left corner, size of a pixel."""
    rec.log(entity, rr.Transform3D(translation=[*corner, 0], scale=[*cell, 1]), static=True)


def _text(places: Any, words: Sequence[str], shades: Sequence[colours.Colour]) -> tuple[rr.Points2D]:
    """Return words just below `places` (n, 2)."""
    return (rr.Points2D(places, radii=1e-4, labels=list(words), colors=shades, show_labels=True, draw_order=30),)


def _write(rec: rr.RecordingStream, entity: str, places: Any, words: Sequence[str]) -> None:
    rec.log(entity, *_text(places, words, [INK] * len(words)), static=True)


def _series(
    rec: rr.RecordingStream,
    entity: str,
    words: Sequence[str],
    shades: Sequence[colours.Colour],
    widths: Sequence[float] | None = None,
) -> None:
    several = [shades[i % len(shades)] for i in range(len(words))]
    lines = rr.SeriesLines(names=list(words), colors=several, widths=widths or [1.5] * len(words))
    rec.log(entity, lines, static=True)


def _times(ticks: np.ndarray, times: np.ndarray) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("tick", sequence=ticks), rr.TimeColumn("sim_time", duration=times)]


def _scalars(rec: rr.RecordingStream, entity: str, times: list[rr.TimeColumn], value: np.ndarray) -> None:
    """Send `value` (n, K) as K series."""
    rows, each = value.shape
    rec.send_columns(entity, times, rr.Scalars.columns(scalars=value.reshape(-1)).partition([each] * rows))


# ---- a viewer elsewhere ---------------------------------------------------------------------


class Relay:
    """Feeds a viewer elsewhere from a process of its own, so that the run never waits for it.

    What waits is bounded by `BACKLOG` bytes; the oldest is dropped. A viewer that cannot be
    reached, is slow or goes away is told of once, in the log, and the run goes on.
    """

    def __init__(self, url: str, scene: Scene) -> None:
        """Start the process that streams `scene` to the viewer at `url`."""
        self._url, self._told = url, False
        self._waiting: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._bytes, self._lock = 0, threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ecology.observers.rerun", url],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "RUST_LOG": "off"},
            start_new_session=True,
        )
        self._thread = threading.Thread(target=self._feed, args=(pickle.dumps(scene),), daemon=True)
        self._thread.start()

    def put(self, message: bytes) -> None:
        """Let `message` wait for its turn, in the place of the oldest where there is no room."""
        with self._lock:
            self._waiting.put(message)
            self._bytes += len(message)
            dropped = False
            while self._bytes > BACKLOG:
                self._bytes -= len(self._waiting.get_nowait() or b"")
                dropped = True
        if dropped:
            self._tell("is slower than the run; it is shown the newest")

    def close(self) -> None:
        """Give the viewer `PATIENCE` seconds to take what waits, then leave."""
        self._waiting.put(None)
        self._thread.join(PATIENCE)
        try:
            self._process.wait(0.1 if self._thread.is_alive() else PATIENCE)
        except subprocess.TimeoutExpired:
            self._tell("did not take the end of the run")
            self._process.kill()
            self._process.wait()
        self._thread.join(PATIENCE)

    def _feed(self, first: bytes) -> None:
        pipe = self._process.stdin
        assert pipe is not None
        message: bytes | None = first
        try:
            while message is not None:
                pipe.write(len(message).to_bytes(8, "big") + message)
                pipe.flush()
                message = self._waiting.get()
                with self._lock:
                    self._bytes -= len(message or b"")
        except OSError:
            self._tell("cannot be reached, or went away; it is shown no more")
        with contextlib.suppress(OSError):
            pipe.close()

    def _tell(self, what: str) -> None:
        if not self._told:
            self._told = True
            log.warning("the viewer at %s %s. The run goes on.", self._url, what)


def _relayed(url: str) -> int:
    """Draw what comes in over stdin (from `Relay`, of the same program) in the viewer at `url`."""
    source = sys.stdin.buffer
    scene: Scene | None = None
    while head := source.read(8):
        message = pickle.loads(source.read(int.from_bytes(head, "big")))
        if scene is None:
            scene = message
            rec = rr.RecordingStream(scene.application)
            rec.connect_grpc(url, default_blueprint=scene.blueprint())
            scene.open(rec)
        else:
            what, arguments = message
            getattr(scene, what)(rec, *arguments)
        try:
            rec.flush(timeout_sec=4 * PATIENCE)
        except RuntimeError:
            return 1
    rec.disconnect()
    return 0


# ---- recordings -----------------------------------------------------------------------------


def recording_id(path: Path) -> str:
    """Return the identity of the recording at `path`."""
    from rerun.chunk import RrdReader

    try:
        return RrdReader(str(path)).recordings()[0].recording_id
    except (RuntimeError, IndexError) as error:
        raise EcologyError(
            f"the recording {str(path)!r} is damaged ({error}); move it away to go on with a new one."
        ) from error


def frames(run: Path | str, scenario: Scenario, first: int | None = None, last: int | None = None) -> list[Frame]:
    """Return what was recorded of a run (its folder or recording) from the tick `first` to `last`, both included.

    Without `first`, as many ticks as a film has by default. Drives are as fine as their colours.
    """
    from ecology.observers.film import FRAMES

    with complete(run) as source:
        groups, start = [], 0
        for species in scenario.species:
            groups.append((species, slice(start, start + species.slots)))
            start += species.slots
        known = [_column(source, f"/world/agents/{s.name}", "Points2D:positions") for s, rows in groups if s.slots]
        ticks = np.array(sorted({tick for column in known for tick in column}), int)
        ticks = ticks[(ticks >= (first or 0)) & (ticks <= (np.inf if last is None else last))]
        ticks = ticks[-FRAMES:] if first is None else ticks
        shape = (len(ticks), start)
        place, angle, drive = np.full((*shape, 2), np.nan), np.zeros(shape), np.zeros(shape)
        top = colours.highest_drive(scenario)
        for species, rows in groups:
            entity = f"/world/agents/{species.name}"
            parts = [_column(source, entity, name) for name in ("Points2D:positions", "Arrows2D:vectors")]
            level = _column(source, entity, "Points2D:class_ids") or _column(source, entity, "Arrows2D:class_ids")
            for i, tick in enumerate(ticks if species.slots else ()):
                place[i, rows] = np.reshape(parts[0][tick], (-1, 2))
                way = np.reshape(parts[1][tick], (-1, 2))
                angle[i, rows] = np.arctan2(way[:, 1], way[:, 0])
                drive[i, rows] = np.asarray(level[tick]) * top / (STEPS - 1)
        patches = _column(source, "/world/resources", "Ellipses2D:centers")
        stock = _column(source, "/world/resources/stock", "Points2D:radii")
        marks = {kind: _column(source, f"/world/marks/{kind}", "LineStrips2D:strips") for kind in MARKED}
    time_of = scenario.dt * ticks
    radii = np.array([r.radius for r in scenario.resources for _ in range(r.count)])
    found = []
    for i, tick in enumerate(ticks):
        full = _latest(stock, tick)
        found.append(
            Frame(
                tick=int(tick),
                time=float(time_of[i]),
                position=place[i],
                heading=angle[i],
                drive=drive[i],
                patches=np.reshape(_latest(patches, tick), (-1, 2)) if patches else np.empty((0, 2)),
                full=np.ones(len(radii)) if full is None else (np.asarray(full) / radii) ** 2,
                marks={k: [np.reshape(strip, (-1, 2)) for strip in of.get(int(tick), ())] for k, of in marks.items()},
            )
        )
    return found


def _column(path: Path, entity: str, component: str) -> dict[int, Any]:
    """Return the values of a component of a recording by tick, in order."""
    from rerun.chunk import RrdReader

    found: dict[int, Any] = {}
    for chunk in RrdReader(str(path)).stream().filter(content=entity, components=component, is_static=False):
        batch = chunk.to_record_batch()
        ticks, values = batch.column("tick").to_pylist(), batch.column(component)
        found |= {tick: plain(values[i].values) for i, tick in enumerate(ticks) if values[i].is_valid}
    return dict(sorted(found.items()))


def plain(values: Any) -> Any:
    """Return an Arrow array as NumPy, nested ones of one length flattened; strips of points as a list of those."""
    if pa.types.is_list(values.type):
        return [plain(each.values) for each in values]
    if pa.types.is_fixed_size_list(values.type):
        return plain(values.flatten())
    return values.to_numpy(zero_copy_only=False)


def _latest(column: Mapping[int, Any], tick: int) -> Any:
    """Return the last value at or before `tick`, None without."""
    before = [at for at in column if at <= tick]
    return column[before[-1]] if before else None


def screenshot(
    run: Path | str, picture: Path | str, *, tick: int | None = None, size: tuple[int, int] = (1600, 900)
) -> None:
    """Save what a viewer shows of a run (its folder or recording) as a new PNG file, without a screen.

    `tick`: where the cursor stands, the end when None. `size` in logical points; the picture has
    twice as many pixels each way. Needs a Vulkan driver, a software one (Mesa's lavapipe) will do.
    Raises EcologyError, and writes nothing, where the file exists or the viewer cannot draw.
    """
    from PIL import Image

    target = Path(picture)
    require(target.suffix == ".png", f"a screenshot is a .png file, got {str(target)!r}.")
    require(not target.exists(), f"the file {str(target)!r} exists; choose another name.")
    require(target.parent.is_dir(), f"there is no folder {str(target.parent)!r} for the screenshot; make it first.")
    with complete(run) as source, tempfile.TemporaryDirectory() as folder:
        shown = Path(folder) / target.name
        _shoot(source.resolve(), shown, tick, size)
        with Image.open(shown) as drawn:  # without the window's own bar
            drawn.crop((0, BAR * drawn.width // size[0], drawn.width, drawn.height)).save(target)


def _shoot(source: Path, shown: Path, tick: int | None, size: tuple[int, int]) -> None:
    """Save the window of a viewer on the recording `source` to the file `shown`."""
    from rerun.experimental import ViewerClient

    port, reason = free_port(LOOPBACK, 0), "it stopped at once"
    with viewer_process(
        "--headless", "--hide-welcome-screen", "--port", str(port), "--window-size", f"{size[0]}x{size[1]}"
    ) as process:
        viewer = None
        for _ in range(ATTEMPTS):
            if process.poll() is not None:
                break
            try:
                viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
                viewer.open(str(source))
                break
            except Exception as error:
                viewer, reason = None, str(error)
                time.sleep(0.5)
        require(
            viewer is not None,
            f"no viewer could be started to draw {str(source)!r}: {reason}. It needs a Vulkan driver; where there "
            "is no GPU, install Mesa's lavapipe.",
        )
        assert viewer is not None
        try:
            time.sleep(SETTLING)
            if tick is not None:
                viewer.set_time("tick", sequence=tick, play_state="paused")
                time.sleep(SETTLING / 3)
            reports = [r for view in viewer.get_state().views for r in view.reports]
            viewer.save_screenshot(str(shown))
        except Exception as error:
            raise EcologyError(f"the viewer cannot draw {str(source)!r}: {error}.") from error
    require(not reports, f"the viewer cannot draw all of {str(source)!r}: {reports}.")


if __name__ == "__main__":
    # the process leaves at once: what a viewer that hangs has not taken must not keep it
    os._exit(_relayed(sys.argv[1]))
