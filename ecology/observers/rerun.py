"""The world and its minds in the Rerun viewer, live and as a recording; the only file that imports rerun.

A recording holds one entity per species for its bodies, however many they are, and one focus agent
per species whose internal state, drive, action and deviation maps are drawn over time:

    world/walls, world/resources, world/axes, world/legend      static, in the units of the plane
    world/agents/SPECIES    Points2D: bodies; internal variables, drive, reward, action as numbers
    world/heading/SPECIES   Arrows2D
    world/trail/SPECIES     Points2D: where bodies were at every tick since the last sample
    world/maps/SPECIES/NEED/image   Image and the numbers of the deviation map behind it
    focus/SPECIES/{deviation,drive,action}      of the focus agent
    learning/SPECIES/{losses,numbers}           of Mind.report(), mean over the living; losses as log10

Timelines: "tick", and "sim_time" (one unit of the model's time shown as one second).

Rerun's plane has y downwards. Positions are written as they are; the transform of `world`, which
mirrors y, turns the picture, so that y points up on the screen and numbers read there are true.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import queue
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from ecology.env import Ecology, Group, Tick
from ecology.errors import EcologyError
from ecology.observers import colours, maps
from ecology.observers.base import Mind
from ecology.observers.viewer import (
    LOOPBACK,
    checked_url,
    free_port,
    joined,
    mended,
    recording_of,
    resumed,
    stretches,
    viewer_process,
    whole,
)
from ecology.scenario import Scenario
from ecology.spec import Species, require
from ecology.state import State

SAMPLES = 256  # sent in one go, at most
SECONDS_FILE, SECONDS_LIVE = 1.0, 0.25  # of the clock between two sendings, at most
TRAILS = 100  # agents up to which every one has a trail; above, the focus agents alone
TRAIL_TICKS = 100  # length of a trail
STATE_TICKS, ACTION_TICKS = 1_000, 100  # of the internal state and the action on the first screen
MEMORY = "256MB"  # of history kept for viewers that attach late
BACKLOG = 64 * 2**20  # bytes that may wait for a viewer elsewhere; older ones are dropped
PATIENCE = 5.0  # seconds granted to a viewer elsewhere when the run ends
QUICK = 512 * 2**20  # bytes up to which a recording is optimised at the end
BACKGROUND, FLOOR, WALL, INK = (16, 18, 22), (42, 46, 54), (225, 225, 225), (235, 235, 235)
ATTEMPTS = 60  # to reach a viewer that was started, half a second apart
SETTLING = 12.0  # seconds in which a viewer's notices of the start fade and chunks load
BAR = 35  # height of the viewer's own bar, logical points
DRIVE_SCALE, MAP_SCALE = "plasma", "viridis"

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
        serve: tuple[str, int] | None = None,
        connect: str | None = None,
        name: str | None = None,
        focus: Iterable[str] = (),
        resume: bool = False,
    ) -> None:
        """Record every `every` ticks, and deviation maps every `maps_every` ticks.

        path: the file, "recording.rrd" of the run's folder. With `resume`, it is gone on with.
        serve: (host, port) where viewers may attach; port 0 takes a free one, `url` says which.
        connect: rerun+http://HOST:PORT/proxy of a viewer elsewhere, which must be open already.
        focus: agents to draw over time by name; the first agent of each species otherwise.
        """
        for word, value in (("every", every), ("maps_every", maps_every)):
            require(
                isinstance(value, int) and value > 0,
                f"a recording's {word} is a whole number of ticks of at least 1; got {value!r}.",
            )
        self._path = Path(path) if path is not None else None
        self._every, self._maps_every, self._name = every, maps_every, name
        self._focus, self._resume = tuple(focus), resume
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
        state = env.state_view
        focus = {g.name: g.slots.start for g in env.groups.values() if g.size}
        for agent in self._focus:
            require(agent in env.possible_agents, f"focus: there is no agent {agent!r}.")
            species = agent.rpartition("_")[0]
            focus[species] = env.possible_agents.index(agent)
        grid = maps.cover(env.scenario.arena)
        self._minds, self._grid = minds, grid
        self._scene = scene = Scene(
            scenario=env.scenario,
            groups=dict(env.groups),
            focus=focus,
            names={species: env.name_of(slot) for species, slot in focus.items()},
            told={name: tuple(minds[name].report()) for name in env.groups},
            mapped={name: self._deviation(env.scenario, env.groups[name], slot) is not None
                    for name, slot in focus.items()},
            grid=grid,
            run=self._name or env.scenario.name,
        )  # fmt: skip
        self._open(state.tick)
        if self._connect:
            self._relay = Relay(self._connect, scene)
        self._samples: list[dict[str, Any]] = []
        self._steps: list[np.ndarray] = []
        self._since = time.monotonic()
        self._next_map = 0
        nothing = np.zeros(env.size)
        self._sample(state, nothing, state.action if state.tick else np.full(env.size, -1), minds)
        self._map(state.tick, state.time)
        self._send()

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Take a sampled tick, and send what has gathered now and then."""
        if state.tick % self._every:
            self._steps.append(_placed(state))
            return
        self._sample(state, tick.reward, tick.action, minds)
        if state.tick >= self._next_map:
            self._map(state.tick, state.time)
        wait = SECONDS_LIVE if self._port or self._relay else SECONDS_FILE
        if len(self._samples) >= SAMPLES or time.monotonic() - self._since > wait:
            self._send()

    def flush(self) -> None:
        """Send the samples at hand, at a checkpoint."""
        self._send()

    def end(self) -> None:
        """Send what is left, close the file and put it in good order."""
        if self._rec is None:
            return
        tick, now = self._last
        if tick > self._mapped_at:
            self._map(tick, now)
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
            if len(parts) > 1 or self._path.stat().st_size <= QUICK:
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
            sinks.append(rr.FileSink(str(self._target)))
        if self._port:
            sinks.append(rr.GrpcServerSink(self._host, self._port, server_memory_limit=MEMORY))
        self._rec = rr.RecordingStream(self._scene.application, recording_id=identity)
        if sinks:
            self._rec.set_sinks(*sinks, default_blueprint=self._scene.blueprint())
        self._scene.open(self._rec)

    def _sample(self, state: State, reward: np.ndarray, action: np.ndarray, minds: Mapping[str, Mind]) -> None:
        """Copy what a sample shows."""
        alive = state.alive
        self._steps.append(_placed(state))
        told = {}
        for name, words in self._scene.told.items():
            living = alive[self._scene.groups[name].slots]
            report = minds[name].report() if words else {}
            known = [np.asarray(report.get(word, np.nan)) * np.ones(len(living)) for word in words]
            told[name] = np.array([_mean(value[living]) for value in known], dtype=float)
        self._last = state.tick, state.time
        self._samples.append(
            {
                "tick": state.tick,
                "time": state.time,
                "heading": state.heading.astype(np.float32),
                "internal": np.where(alive[:, None], state.internal, np.nan).astype(np.float32),
                "drive": np.where(alive, state.drive, np.nan).astype(np.float32),
                "reward": np.where(alive, reward, np.nan).astype(np.float32),
                "action": np.where(alive, action, -1).astype(np.int16),
                "steps": np.stack(self._steps),  # (ticks since the last sample, N, 2)
                "resources": state.resource_position.astype(np.float32),
                "told": told,
            }
        )
        self._steps = []

    def _deviation(self, scenario: Scenario, group: Group, slot: int) -> np.ndarray | None:
        species = scenario.species[group.index]
        return maps.deviation_maps(species, group, self._minds[group.name], slot - group.slots.start, self._grid)

    def _map(self, tick: int, now: float) -> None:
        """Draw the deviation maps of the focus agents as they are."""
        self._next_map, self._mapped_at = tick + self._maps_every, tick
        for name, there in self._scene.mapped.items():
            if there:
                scene = self._scene
                found = self._deviation(scene.scenario, scene.groups[name], scene.focus[name])
                self._show("draw_maps", tick, now, name, found)

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


def _placed(state: State) -> np.ndarray:
    """Return positions (N, 2); a dead body is nowhere, so that viewers do not draw it."""
    return np.where(state.alive[:, None], state.position, np.nan).astype(np.float32)


def _mean(value: np.ndarray) -> float:
    value = value[np.isfinite(value)]
    return float(value.mean()) if value.size else np.nan


@dataclass
class Scene:
    """What is drawn, and where: turns samples into Rerun's columns. Plain data, so that it can be sent."""

    scenario: Scenario
    groups: Mapping[str, Group]
    focus: Mapping[str, int]  # species -> slot
    names: Mapping[str, str]  # species -> name of its focus agent
    told: Mapping[str, tuple[str, ...]]  # species -> numbers that its mind reports
    mapped: Mapping[str, bool]  # species -> whether there are deviation maps
    grid: maps.Grid
    run: str
    _acted: dict[str, int] = field(default_factory=dict)
    _resources: np.ndarray | None = None

    @property
    def application(self) -> str:
        """Return the name under which the viewer keeps the layout: one per scenario."""
        return "ecology-" + re.sub(r"[^A-Za-z0-9_-]", "_", self.scenario.name)

    def open(self, rec: rr.RecordingStream) -> None:
        """Draw what does not change."""
        rec.set_log_time_enabled(False)
        rec.send_recording_name(self.run)
        rec.log("world", rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]), static=True)
        self._draw_arena(rec)
        for name, group in self.groups.items():
            if group.size:
                self._open_species(rec, name, self.scenario.species[group.index])

    def _draw_arena(self, rec: rr.RecordingStream) -> None:
        corners = np.array((*self.scenario.arena.vertices, self.scenario.arena.vertices[0]), float)
        rec.log("world/walls", rr.LineStrips2D([corners], colors=[WALL], draw_order=5), static=True)
        fine = maps.cover(self.scenario.arena, 400)
        floor = np.where(fine.inside[..., None], FLOOR, BACKGROUND).astype(np.uint8)
        _lay(rec, "world/floor", fine.corner, (fine.cell, fine.cell))
        rec.log("world/floor", rr.Image(floor, draw_order=-30), static=True)
        # axes: a number at round places below and left of the arena
        low, high = corners.min(axis=0), corners.max(axis=0)
        size = float((high - low).max())
        step = _round_step(size / 8)
        places, words = [], []
        for axis in range(2):
            for value in np.arange(np.ceil(low[axis] / step) * step, high[axis] + 1e-9, step):
                place = low - 0.035 * size
                place[axis] = value
                places.append(place)
                words.append(f"{'xy'[axis]} {value:g}" if value == low[axis] else f"{value:g}")
        _write(rec, "world/axes", places, words)
        # legend: the colour scale of the drive, and the species' colours
        top, wide, tall = high[1] + 0.06 * size, 0.3 * size, 0.02 * size
        bar = np.tile(colours.scale(DRIVE_SCALE), (2, 1, 1))  # (2, SHADES, 3)
        _lay(rec, "world/legend/drive", (float(low[0]), float(top)), (wide / bar.shape[1], tall / 2))
        rec.log("world/legend/drive", rr.Image(bar), static=True)
        places = [(low[0], top), (low[0] + wide, top)]
        words = ["drive 0", f"{colours.highest_drive(self.scenario):.1f}"]
        _write(rec, "world/legend/numbers", places, words)
        if len(self.groups) > 1:
            start, gap = low[0] + 1.35 * wide, (high[0] - low[0] - 1.35 * wide) / len(self.groups)
            places = [(start + i * gap, top + tall / 2) for i in range(len(self.groups))]
            shades = [colours.species_colour(g.index) for g in self.groups.values()]
            rec.log(
                "world/legend/species",
                rr.Points2D(places, radii=0.01 * size, colors=shades, labels=list(self.groups), show_labels=True),
                static=True,
            )

    def _open_species(self, rec: rr.RecordingStream, name: str, species: Species) -> None:
        colour = colours.species_colour(self.groups[name].index)
        body, heading, trail = (f"world/{part}/{name}" for part in ("agents", "heading", "trail"))
        rec.log(body, rr.Points2D.from_fields(radii=species.radius, draw_order=20), static=True)
        rec.log(heading, rr.Arrows2D.from_fields(radii=0.18 * species.radius, colors=[colour], draw_order=21),
                static=True)  # fmt: skip
        rec.log(trail, rr.Points2D.from_fields(radii=0.25 * species.radius, colors=[colour], draw_order=10),
                static=True)  # fmt: skip
        base = f"focus/{name}"
        _series(rec, f"{base}/deviation", [need.name for need in species.needs],
                [colours.need_colour(i) for i in range(len(species.needs))])  # fmt: skip
        many = species.count > 1
        _series(rec, f"{base}/drive", [self.names[name], *(["mean of the species"] if many else [])],
                [(240, 240, 240), colours.PALETTE[0]])  # fmt: skip
        rec.log(
            f"{base}/action",
            rr.StateConfiguration(
                values=[a.name for a in species.actions],
                labels=[a.name for a in species.actions],
                colors=_packed(np.array(colours.action_colours(self.scenario, species), np.uint8)),
            ),
            static=True,
        )
        for part, words in zip(("losses", "numbers"), _losses(self.told[name]), strict=True):
            if words:
                _series(rec, f"learning/{name}/{part}", words, colours.PALETTE)
        for i in maps.mapped_needs(species) if self.mapped.get(name) else ():
            _lay(
                rec,
                f"world/maps/{name}/{species.needs[i].name}/image",
                self.grid.corner,
                (self.grid.cell,) * 2,
            )

    def draw(self, rec: rr.RecordingStream, samples: Sequence[Mapping[str, Any]]) -> None:
        """Send samples, in columns."""
        column = {
            key: np.stack([s[key] for s in samples])
            for key in ("tick", "time", "heading", "internal", "drive", "reward", "action")
        }
        n = len(samples)
        times = [
            rr.TimeColumn("tick", sequence=column["tick"]),
            rr.TimeColumn("sim_time", duration=column["time"]),
        ]
        top = colours.highest_drive(self.scenario)
        shown = _packed(colours.shade(DRIVE_SCALE, column["drive"], 0.0, top))  # (n, N)
        place = np.stack([s["steps"][-1] for s in samples])  # (n, N, 2)
        self._draw_resources(rec, samples[-1])
        for name, group in self.groups.items():
            if not group.size:
                continue
            species, rows = self.scenario.species[group.index], group.slots
            each = [group.size] * n
            xy = place[:, rows].reshape(-1, 2)
            numbers = {need.name: column["internal"][:, rows, i] for i, need in enumerate(species.needs)}
            numbers |= {key: column[key][:, rows] for key in ("drive", "reward", "action")}
            rec.send_columns(
                f"world/agents/{name}",
                times,
                [
                    *rr.Points2D.columns(positions=xy, colors=shown[:, rows].reshape(-1)).partition(each),
                    *rr.AnyValues.columns(
                        **{key: pa.array(value.reshape(-1)) for key, value in numbers.items()}
                    ).partition(each),
                ],
            )
            angle = column["heading"][:, rows].reshape(-1)
            arrow = 2.5 * species.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
            rec.send_columns(
                f"world/heading/{name}",
                times,
                rr.Arrows2D.columns(origins=xy, vectors=arrow).partition(each),
            )
            who = rows if group.size <= TRAILS else slice(self.focus[name], self.focus[name] + 1)
            steps = [s["steps"][:, who].reshape(-1, 2) for s in samples]
            rec.send_columns(
                f"world/trail/{name}",
                times,
                rr.Points2D.columns(positions=np.concatenate(steps)).partition([len(s) for s in steps]),
            )
            self._draw_focus(rec, name, species, times, column)
            told = np.stack([s["told"][name] for s in samples])  # (n, K)
            for part, words in zip(("losses", "numbers"), _losses(self.told[name]), strict=True):
                if words:
                    value = told[:, [self.told[name].index(word) for word in words]]
                    if part == "losses":
                        value = np.log10(np.where(value > 0, value, np.nan))
                    _scalars(rec, f"learning/{name}/{part}", times, value)

    def _draw_focus(
        self,
        rec: rr.RecordingStream,
        name: str,
        species: Species,
        times: list[rr.TimeColumn],
        column: Mapping[str, np.ndarray],
    ) -> None:
        slot, rows = self.focus[name], self.groups[name].slots
        target = np.array([need.set_point for need in species.needs])
        _scalars(rec, f"focus/{name}/deviation", times, column["internal"][:, slot, : len(target)] - target)
        drive = [column["drive"][:, slot]]
        if species.count > 1:
            drive.append(np.array([_mean(row) for row in column["drive"][:, rows]]))
        _scalars(rec, f"focus/{name}/drive", times, np.stack(drive, axis=1))
        action = column["action"][:, slot]
        before = np.concatenate([[self._acted.get(name, -2)], action[:-1]])
        self._acted[name] = int(action[-1])
        changed = np.flatnonzero(action != before)
        if changed.size:
            rec.send_columns(
                f"focus/{name}/action",
                [
                    rr.TimeColumn("tick", sequence=column["tick"][changed]),
                    rr.TimeColumn("sim_time", duration=column["time"][changed]),
                ],
                rr.StateChange.columns(state=[species.actions[a].name if a >= 0 else "" for a in action[changed]]),
            )

    def _draw_resources(self, rec: rr.RecordingStream, sample: Mapping[str, Any]) -> None:
        """Draw the resources, again only where they have moved."""
        place, resources = sample["resources"], self.scenario.resources
        if not resources or (self._resources is not None and np.array_equal(place, self._resources)):
            return
        self._resources = place
        rec.set_time("tick", sequence=sample["tick"])
        rec.set_time("sim_time", duration=float(sample["time"]))
        radii = np.array([r.radius for r in resources], np.float32)
        shades = colours.resource_colours(self.scenario)
        circles = {"centers": place, "half_sizes": np.stack([radii, radii], axis=1)}
        rec.log("world/resources", rr.Ellipses2D(**circles, colors=shades, draw_order=8))
        # a dark rim, so that a circle stands out from a map of its own colour
        wide = rr.Radius.ui_points(3.0)
        rec.log(
            "world/resources/rim",
            rr.Ellipses2D(**circles, colors=[BACKGROUND], line_radii=wide, draw_order=7),
        )
        names = [r.name for r in resources]
        beside = [self._beside(xy, r.radius, len(r.name)) for xy, r in zip(place, resources, strict=True)]
        rec.log("world/resources/names", *_text(beside, names, shades))

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

    def blueprint(self) -> rrb.Blueprint:
        """Return the layout: the arena over the maps on the left, one agent's life on the right."""
        there = [name for name, group in self.groups.items() if group.size]
        arena: rrb.View | rrb.Container = self._arena_view(there)
        drawn = [self._map_views(name) for name in there if self.mapped.get(name)]
        if drawn:
            arena = rrb.Vertical(arena, _one_or_tabs(drawn), row_shares=[2.3, 1])
        lives = _one_or_tabs([self._life_views(name) for name in there])
        return rrb.Blueprint(
            rrb.Horizontal(arena, lives, column_shares=[1.1, 1]),
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

    def _arena_view(self, there: Sequence[str]) -> rrb.Spatial2DView:
        return rrb.Spatial2DView(
            origin="/",
            contents=["+ /world/**", "- /world/maps/**"],
            name=f"{self.run}: bodies by drive, with heading and the trail of {TRAIL_TICKS} ticks",
            background=BACKGROUND,
            visual_bounds=self._bounds(0.09, 0.11),
            overrides={f"world/trail/{name}": _last(TRAIL_TICKS, self.scenario.dt) for name in there},
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
                    visual_bounds=self._bounds(0.12, 0.03),
                )
            )
        return rrb.Grid(*views, grid_columns=len(views), name=f"deviation of {self.names[name]}")

    def _life_views(self, name: str) -> rrb.Container:
        agent, dt = self.names[name], self.scenario.dt
        # the whole timeline; by itself a view takes the width of the others
        end, at = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative
        always = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=end, end=end))
        # in ticks, the timeline of the first screen; on sim_time the lane shows the present action alone
        latest = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=at(seq=-ACTION_TICKS), end=at(seq=0)))
        legend = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
        losses, numbers = _losses(self.told[name])
        views: list[rrb.View | rrb.Container] = [
            rrb.TimeSeriesView(
                origin=f"/focus/{name}/deviation",
                name=f"{agent}: x - x* of every need, its own unit; last {STATE_TICKS} ticks",
                time_ranges=_last(STATE_TICKS, dt),
                plot_legend=legend,
            ),
            rrb.StateTimelineView(
                origin=f"/focus/{name}/action",
                name=f"{agent}: action; last {ACTION_TICKS} ticks",
                time_ranges=_last(ACTION_TICKS, dt),
                time_view=latest,
            ),
            rrb.TimeSeriesView(
                origin=f"/focus/{name}/drive",
                name="drive, whole life",
                plot_legend=legend,
                axis_x=always,
            ),
        ]
        shares = [3.0, 1.1, 2.0]
        learning = []
        if losses:
            learning.append(
                rrb.TimeSeriesView(
                    origin=f"/learning/{name}/losses",
                    name=f"losses, log10: {', '.join(losses)}",
                    plot_legend=legend,
                    axis_x=always,
                )
            )
        learning += [
            rrb.TimeSeriesView(
                origin=f"/learning/{name}/numbers",
                name=word,
                plot_legend=legend,
                axis_x=always,
                overrides={
                    f"learning/{name}/numbers": rr.SeriesLines.from_fields(
                        visible_series=[other == word for other in numbers]
                    )
                },
            )
            for word in numbers
        ]
        if learning:
            views.append(learning[0] if len(learning) == 1 else rrb.Tabs(*learning, active_tab=0))
            shares.append(2.0)
        return rrb.Vertical(*views, row_shares=shares, name=agent)


def _one_or_tabs(parts: list[rrb.Container]) -> rrb.Container:
    return parts[0] if len(parts) == 1 else rrb.Tabs(*parts, active_tab=0)


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


def _series(rec: rr.RecordingStream, entity: str, words: Sequence[str], shades: Sequence[colours.Colour]) -> None:
    lines = rr.SeriesLines(names=list(words), colors=list(shades[: len(words)]), widths=[1.5] * len(words))
    rec.log(entity, lines, static=True)


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


def screenshot(
    run: Path | str, picture: Path | str, *, tick: int | None = None, size: tuple[int, int] = (1600, 900)
) -> None:
    """Save what a viewer shows of a run (its folder or recording) as a new PNG file, without a screen.

    `tick`: where the cursor stands, the end when None. `size` in logical points; the picture has
    twice as many pixels each way. Needs a Vulkan driver, a software one (Mesa's lavapipe) will do.
    Raises EcologyError, and writes nothing, where the file exists or the viewer cannot draw.
    """
    from PIL import Image

    path, target = recording_of(Path(run)), Path(picture)
    require(target.suffix == ".png", f"a screenshot is a .png file, got {str(target)!r}.")
    require(not target.exists(), f"the file {str(target)!r} exists; choose another name.")
    require(target.parent.is_dir(), f"there is no folder {str(target.parent)!r} for the screenshot; make it first.")
    with tempfile.TemporaryDirectory() as folder:
        one = whole(path) and not resumed(path).exists()
        source = path if one else mended(path, Path(folder) / path.name)
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
