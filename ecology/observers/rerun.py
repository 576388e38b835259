"""The run in the Rerun viewer, live and as a recording: takes samples and sends them.

What is drawn of them is told in drawing.py, where on the screen in layout.py; hindsight.py looks back at a recording.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

# read by Rerun when it is loaded: that bytes of a run that failed are not written is told by the run
os.environ.setdefault("RUST_LOG", "warn,re_sdk::binary_stream_sink=error")

import rerun as rr

from ecology.env import Ecology
from ecology.errors import EcologyError
from ecology.ground import plane_of
from ecology.observers import census, maps, places, relay, shapes
from ecology.observers.backdrop import open_scene
from ecology.observers.base import Mind
from ecology.observers.census import Census, Choice, Focus, Happening
from ecology.observers.control import Control
from ecology.observers.drawing import Drawing
from ecology.observers.layout import blueprint
from ecology.observers.readback import recording_id
from ecology.observers.recording_file import RecordingFile, cut
from ecology.observers.scene import DEAD, FEW, Scene
from ecology.observers.viewer import (
    LOOPBACK,
    checked_url,
    free_port,
    joined,
    resumed,
    stretches,
    unfinished,
    whole,
)
from ecology.observers.wishes import Wishes
from ecology.spec import require
from ecology.state import State
from ecology.world import Tick

SAMPLES = 256  # sent in one go, at most
SECONDS_FILE, SECONDS_LIVE = 1.0, 0.25  # of the clock between two sendings, at most
FOCUS_TICKS = 500  # after which the hungriest is looked for again
SPARSE = 20  # samples between two age structures, and between two coupling matrices
COUPLED = 128  # agents of a species whose coupling is drawn, at most
TIDY = 2 * 2**30  # bytes up to which a recording is put in order at the end, by a process that takes as much memory
DETAILS = ("full", "lean")


class RerunObserver:
    """Shows a run in the Rerun viewer: as a file, to viewers that attach, to a viewer elsewhere.

    Nothing that a viewer does stops or changes the run: the server for viewers that attach and a viewer
    elsewhere (`connect`) are processes of their own, each fed from a bounded queue that drops the oldest.
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
        control: Control | None = None,
    ) -> None:
        """Record every `every` ticks, and deviation maps every `maps_every` ticks.

        path: the file, "recording.rrd" of the run's folder. With `resume`, it is gone on with.
        detail: "full", or "lean" without drive and reward of every agent (the focus has them, and colours
        show the drive); full up to 100 agents and lean above when None.
        serve: (host, port) where viewers may attach; port 0 takes a free one, `url` says which.
        connect: rerun+http://HOST:PORT/proxy of a viewer elsewhere, which must be open already.
        focus: whom to draw over time: names of agents, a species (shown first), or "hungriest"; the first
        agent of each species otherwise. When one dies, another of its species takes its place.
        control: of the run's pace, where somebody may set it: is told of decisions and of what was sent. Where it
        makes the run slow, more ticks are sampled, so that every picture is of the present.
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
        self._wishes, self._control = wishes or Wishes(), control
        require(
            self._path is None or resume or not self._path.exists(),
            f"there is a recording at {str(path)!r} already; choose another folder, or resume that run.",
        )
        self._host, self._port = (serve[0], free_port(*serve)) if serve else (LOOPBACK, 0)
        self._connect = checked_url(connect) if connect else None
        self._relays: list[relay.Relay] = []
        self._rec: rr.RecordingStream | None = None
        self._ended = True  # until it begins
        self._file: RecordingFile | None = None
        self._drawing: Drawing | None = None

    @property
    def url(self) -> str | None:
        """Return where viewers attach, None where nothing is served."""
        return f"rerun+http://{self._host}:{self._port}/proxy" if self._port else None

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Lay out the first screen and show the world as it stands."""
        self._ended = False
        try:
            self._begin(env, minds)
        except BaseException:
            self._ended = True  # nobody ends what has not begun
            self._close()
            raise

    def _close(self) -> None:
        """Close the file, and give viewers what waits for them."""
        with contextlib.ExitStack() as at_end:
            for each in self._relays:
                at_end.callback(each.close)
            if self._file is not None:
                at_end.callback(self._file.close)

    def _begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        state, scenario = env.state_view, env.scenario
        self._env, self._minds, self._grid = env, minds, maps.cover(scenario.arena)
        self._cells = places.grid_of(scenario.arena)
        self._focus, self._census = Focus.of(env, self._asked), Census(env, self._before)
        self._focus.look(state)
        self._scene = scene = Scene(
            scenario=census.without_functions(scenario),
            groups={name: group for name, group in env.groups.items() if group.size},
            names={name: self._focus.name(name) for name in env.groups},
            first=self._focus.first,
            told={name: tuple(minds[name].report()) for name in env.groups},
            mapped={name: self._deviation(name) is not None for name in env.groups},
            decides={name: bool(env.groups[name].size) and self._minds[name].decides for name in env.groups},
            coupled=tuple(name for name in env.groups if env.coupling(name) is not None),
            measures=census.plotted(scenario),
            grows=env.open_population,
            marks=tuple(shapes.marked(scenario)),
            grid=self._grid,
            run=self._name or scenario.name,
            every=self._every,
            full=(self._detail or ("full" if env.size <= FEW else "lean")) == "full",
            few=env.size <= FEW,
        )
        goes_on = self._open(state.tick)
        if self._port:
            self._relays.append(relay.Relay(relay.SERVE, f"{self._host}:{self._port}", scene))
        if self._connect:
            self._relays.append(relay.Relay(relay.CONNECT, self._connect, scene))
        self._samples: list[dict[str, Any]] = []
        self._steps: list[np.ndarray] = []
        self._happened: list[Happening] = []
        self._told: set[str] = set()  # species whose focus is another since the last sample
        self._past: dict[str, census.Past] = {name: census.Past() for name in scene.groups}
        self._decided: dict[str, list[Choice]] = {name: [] for name in scene.groups}  # since the last sample
        self._follow()
        self._since = time.monotonic()
        self._next_map, self._sampled, self._shown, self._mapped_at = 0, 0, -1, state.tick
        self._tick: Tick | None = None  # the last one
        self._did = (-1, -1)  # slot and action of the one that is shown first
        self._deeds: list[tuple[int, float, str]] = []  # interventions since the last sample
        drawing = self._drawing
        self._drawing = None if goes_on else drawing  # a recording that goes on has this tick
        self._sample(state, None)
        self._map(state)
        self._send()
        self._drawing = drawing
        self._write()

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Take a sampled tick, and send what has gathered now and then."""
        self._tick = tick
        sampled = state.tick % self._every == 0 or self._is_slow()
        turned = sampled and self._heed(state)
        self._refocus(state, anew=turned or state.tick % FOCUS_TICKS == 0)
        slots = np.array(list(self._focus.slots.values()), np.int64)
        self._happened += self._census.watch(state, tick, None if self._scene.few else slots[slots >= 0])
        for name, past in self._past.items():
            past.follow(self._focus.serials[name], state.drive[self._focus.slots[name]])
        for name in self._scene.groups:
            self._decide(name, state, sampled=sampled)
        if self._control and self._has_decided(state):
            self._control.decided()
        if not sampled:
            self._steps.append(self._placed(state))
            return
        self._sample(state, tick)
        if turned or state.tick >= self._next_map:
            self._map(state)
        wait = SECONDS_LIVE if self._relays else SECONDS_FILE
        if len(self._samples) >= SAMPLES or time.monotonic() - self._since > wait:
            self._send()

    def intervened(self, state: State, text: str, said: str) -> None:
        """Note what was done from outside: an event."""
        self._deeds.append((state.tick, state.time, said))

    def held(self) -> None:
        """Show the world as it stands while the run waits."""
        state = self._env.state_view
        turned = self._heed(state)
        if not (turned or self._deeds or state.tick != self._shown):
            return
        self._refocus(state, anew=turned)
        for name in self._scene.groups if self._tick is not None else ():
            self._decided[name] = [each for each in self._decided[name] if each.tick != state.tick]
            self._decide(name, state, sampled=True)
        self._sample(state, self._tick)
        if turned:
            self._map(state)
        self._send()

    def _refocus(self, state: State, *, anew: bool) -> None:
        """Find who is in focus."""
        changed = self._focus.look(state, anew=anew)
        self._told.update(changed)
        if changed:
            self._follow()

    def _is_slow(self) -> bool:
        """Return whether a picture is due before the next sample of the recording."""
        return self._control is not None and time.monotonic() - self._since > 2 * SECONDS_LIVE

    def _heed(self, state: State) -> bool:
        """Turn to those whom somebody wishes to see, where they live; say whether there were any."""
        words = [name for click in self._wishes.clicks() if (name := self._focus.clicked(self._env, click))]
        for word in words:
            self._focus.turn(self._env, word)
        for asked, answer in self._wishes.words():
            try:
                self._focus.turn(self._env, asked)
                answer(f"{asked} is in focus from tick {state.tick} on", True)
                words.append(asked)
            except EcologyError as error:
                answer(str(error), False)
        if self._scene.crowd and self._focus.first != self._scene.first:
            self._scene.first = self._focus.first
            self._lay_out()
        return bool(words)

    def _lay_out(self) -> None:
        """Lay the screen out anew where somebody looks on; of several layouts in a file one is shown by chance."""
        for each in self._relays:
            each.put(pickle.dumps(("lay_out", (self._scene.first,))))

    def flush(self) -> None:
        """Write the samples at hand, at a checkpoint."""
        self._send()
        self._write()

    def end(self) -> None:
        """Send what is left, close the file and put it in good order."""
        if self._ended:
            return
        self._ended = True
        with contextlib.ExitStack() as at_end:
            at_end.callback(self._close)
            state = self._env.state_view
            if state.tick > self._mapped_at and state.tick % self._every == 0:
                self._map(state)
            if self._deeds:  # since the last sample
                self._sample(state, self._tick)
            self._send()
            self._write()
        if self._path:
            parts = [self._path] if self._target == self._path else [self._path, self._target]
            if len(parts) > 1 or self._path.stat().st_size <= TIDY:
                joined(parts, self._path)

    def _open(self, tick: int) -> bool:
        """Open the file, if there is one, and draw the first screen there; return whether it goes on with a recording.

        What a run that was killed recorded after the tick that it goes on from is left out: it is recorded again.
        """
        if self._path is None:
            return False
        self._target, identity, layout = self._path, None, True
        unfinished(self._path).unlink(missing_ok=True)
        if self._resume and (tick == 0 or not (self._path.exists() and self._path.stat().st_size)):
            for part in stretches(self._path):  # the run was killed before its first checkpoint: it begins anew
                part.unlink()
        if self._resume and self._path.exists():
            self._target = resumed(self._path)
            if self._target.exists() or not whole(self._path):  # the run was killed
                joined(stretches(self._path), self._path)
            identity = recording_id(self._path)
            layout = cut(self._path, tick, self._scene.application, identity)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._rec = rr.RecordingStream(self._scene.application, recording_id=identity)
        self._file = RecordingFile(self._target, self._rec)
        if layout:  # of several in a file one is shown by chance
            self._rec.send_blueprint(blueprint(self._scene))
        open_scene(self._rec, self._scene)
        self._drawing = Drawing(self._rec, self._scene)
        return identity is not None

    def _write(self) -> None:
        """Put what was drawn into the file."""
        if self._file is not None:
            self._file.append()

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
            told[name] = np.array([census.mean(value[living]) for value in known], dtype=float)
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
            "fields": places.levels(self._env.world.model, state, self._cells) if scene.scenario.fields else {},
            "doors": places.closed_doors(scene.scenario.arena, state.doors),
            "resources": shapes.patches(scene.scenario, state).astype(np.float32),
            "stock": shapes.fullness(scene.scenario, state).astype(np.float32),
            "told": told,
            "happened": self._happened,
            "deeds": self._deeds,
            "focus": {name: self._look(name, state, tick) for name in scene.groups},
            "born": self._census.born.copy(),
            "died": self._census.died.copy(),
            "stocks": census.stocks(scene.scenario, state),
            "measures": census.measured(self._env.scenario, state),
        }
        if state.set_point is not None:
            sample["set_point"] = np.where(alive[:, None], state.set_point, np.nan).astype(np.float32)
        if self._sampled == 0 or state.tick % (SPARSE * self._every) == 0:  # by the tick: a run that is resumed, too
            sample["ages"] = {name: census.ages(state.age[g.slots][alive[g.slots]]) for name, g in scene.groups.items()}
            sample["traits"] = census.histograms(scene.scenario, state)
            sample["coupling"] = {name: self._coupling(name, state) for name in scene.coupled}
        self._samples.append(sample)
        self._sampled += 1
        self._shown, self._deeds = state.tick, []
        self._steps, self._happened, self._told = [], [], set()
        self._decided = {name: [] for name in scene.groups}

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
        shown["own"] = float(state.own_drive[slot])
        shown["choices"] = self._decided[name]
        if tick is not None and self._decided[name]:
            decision, row = self._decided[name][-1].decision, slot - self._scene.groups[name].slots.start
            value = self._minds[name].deviation(row, tick.observations[name][row : row + 1])
            shown["J"] = decision.value if value is None else float(value[0])
            shown["error"] = np.asarray(decision.error, float)
            shown["met"] = past.judge(state.tick, state.time, float(decision.gamma), self._env.dt)
        return shown

    def _follow(self) -> None:
        """Let the minds keep the decisions of those in focus."""
        for name, group in self._scene.groups.items():
            if self._scene.decides[name]:
                slot = self._focus.slots[name]
                self._minds[name].follow([slot - group.slots.start] if slot >= 0 else [])

    def _decide(self, name: str, state: State, *, sampled: bool) -> None:
        """Note the decision of the focus of a species at a sample, and where it has just been made."""
        slot = self._focus.slots[name]
        if slot < 0 or not self._scene.decides[name]:
            return
        decision = self._minds[name].decision(slot - self._scene.groups[name].slots.start)
        if decision is not None and (sampled or decision.age == 1):
            self._decided[name].append(Choice(state.tick, state.time, self._focus.name(name), decision))

    @property
    def focus(self) -> str:
        """Return the name of the agent whose life is shown first."""
        name = self._focus.first or next(iter(self._scene.groups), "")
        return self._focus.name(name) if name else "nobody"

    def _has_decided(self, state: State) -> bool:
        """Return whether the agent that is shown first made a decision in this tick, or does something else now."""
        name = self._focus.first or next(iter(self._scene.groups), "")
        slot = self._focus.slots.get(name, -1)
        before, self._did = self._did, (slot, int(state.action[slot]))
        if slot < 0:
            return False
        if self._scene.decides[name]:
            made = self._minds[name].decision(slot - self._scene.groups[name].slots.start)
            return made is not None and made.age == 1
        return self._did != before

    def _coupling(self, name: str, state: State) -> np.ndarray | None:
        """Return the weights with which the first living feel the first living of each species, (n, m)."""
        found = self._env.coupling(name)
        if found is None:
            return None
        weight, others = found
        rows = np.flatnonzero(state.alive[self._scene.groups[name].slots])[:COUPLED]
        living = [others[(others >= g.slots.start) & (others < g.slots.stop)] for g in self._scene.groups.values()]
        columns = np.searchsorted(others, np.concatenate([slots[state.alive[slots]][:COUPLED] for slots in living]))
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
            self._write()
            if self._control:
                self._control.sent(samples[-1]["tick"])

    def _show(self, what: str, *arguments: Any) -> None:
        """Draw in the recording, and hand the same to those that viewers attach to."""
        if self._drawing is not None:
            getattr(self._drawing, what)(*arguments)
        if self._relays:
            message = pickle.dumps((what, arguments))
            for each in self._relays:
                each.put(message)
