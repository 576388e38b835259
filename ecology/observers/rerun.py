"""The run in the Rerun viewer, live and as a recording: takes samples and sends them.

What is sampled and drawn is in panels/, a file each, where on the screen in layout.py; hindsight.py looks back at a
recording.
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
from ecology.model import Group
from ecology.observers import census, maps, relay, shapes
from ecology.observers.base import Mind
from ecology.observers.census import Census, Focus, Happening
from ecology.observers.control import Control
from ecology.observers.drawing import Drawing, open_scene
from ecology.observers.layout import blueprint, panels
from ecology.observers.panels.base import Panel, Watch
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
        state = env.state_view
        self._env, self._minds = env, minds
        self._focus, self._census = Focus.of(env, self._asked), Census(env, self._before)
        self._focus.look(state)
        self._scene = scene = self._make_scene(env, minds)
        self._panels = panels(scene)
        self._followers = [panel for panel in self._panels if type(panel).follow is not Panel.follow]
        goes_on = self._open(state.tick)
        if self._port:
            self._relays.append(relay.Relay(relay.SERVE, f"{self._host}:{self._port}", scene))
        if self._connect:
            self._relays.append(relay.Relay(relay.CONNECT, self._connect, scene))
        self._samples: list[dict[str, Any]] = []
        self._happened: list[Happening] = []
        self._changed: set[str] = set()  # species whose focus is another since the last sample
        self._follow()
        self._since = time.monotonic()
        self._sampled, self._shown = 0, -1
        self._tick: Tick | None = None  # the last one
        self._did = (-1, -1)  # slot and action of the one that is shown first
        self._deeds: list[tuple[int, float, str]] = []  # interventions since the last sample
        drawing = self._drawing
        self._drawing = None if goes_on else drawing  # a recording that goes on has this tick
        self._sample(self._look(state))
        self._send()
        self._drawing = drawing
        self._write()

    def _make_scene(self, env: Ecology, minds: Mapping[str, Mind]) -> Scene:
        """Return what is drawn of a world and its minds."""
        scenario, grid, few = env.scenario, maps.cover(env.scenario.arena), env.size <= FEW
        groups = env.groups
        return Scene(
            scenario=census.without_functions(scenario),
            groups={name: group for name, group in groups.items() if group.size},
            names={name: self._focus.name(name) for name in groups},
            first=self._focus.first,
            told={name: tuple(minds[name].report()) for name in groups},
            mapped={name: self._has_maps(group, minds[name], grid) for name, group in groups.items()},
            decides={name: bool(groups[name].size) and minds[name].decides for name in groups},
            coupled=tuple(name for name in groups if env.coupling(name) is not None),
            measures=census.plotted(scenario),
            grows=env.open_population,
            marks=tuple(shapes.marked(scenario)),
            grid=grid,
            run=self._name or scenario.name,
            every=self._every,
            maps_every=self._maps_every,
            full=(self._detail or ("full" if few else "lean")) == "full",
            few=few,
        )

    def _has_maps(self, group: Group, mind: Mind, grid: maps.Grid) -> bool:
        if not group.size:
            return False
        row = max(self._focus.slots[group.name] - group.slots.start, 0)
        species = self._env.scenario.species[group.index]
        return maps.deviation_maps(species, group, mind, row, grid) is not None

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Take a sampled tick, and send what has gathered now and then."""
        self._tick = tick
        sampled = state.tick % self._every == 0 or self._is_slow()
        turned = sampled and self._heed(state)
        self._refocus(state, anew=turned or state.tick % FOCUS_TICKS == 0)
        slots = np.array(list(self._focus.slots.values()), np.int64)
        self._happened += self._census.watch(state, tick, None if self._scene.few else slots[slots >= 0])
        look = self._look(state, sampled=sampled, turned=turned)
        for panel in self._followers:
            panel.follow(look)
        if self._control and self._has_decided(state):
            self._control.decided()
        if not sampled:
            return
        self._sample(look)
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
        look = self._look(state, turned=turned)
        if self._tick is not None:
            for panel in self._followers:
                panel.follow(look)
        self._sample(look)
        self._send()

    def _refocus(self, state: State, *, anew: bool) -> None:
        """Find who is in focus."""
        changed = self._focus.look(state, anew=anew)
        self._changed.update(changed)
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
            look = self._look(state)
            found = {panel.key: value for panel in self._panels if (value := panel.final(look)) is not None}
            if self._deeds:  # since the last sample
                self._sample(look)
            self._send()
            if found:
                self._show("draw_final", {"tick": state.tick, "time": state.time, "panels": found})
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

    def _look(self, state: State, *, sampled: bool = True, turned: bool = False) -> Watch:
        """Return what panels take their samples from."""
        sparse = self._sampled == 0 or state.tick % (SPARSE * self._every) == 0
        return Watch(
            env=self._env,
            minds=self._minds,
            scene=self._scene,
            focus=self._focus,
            census=self._census,
            state=state,
            tick=self._tick,
            sampled=sampled,
            sparse=sparse,
            turned=turned,
            changed=frozenset(self._changed),
            happened=self._happened,
            deeds=self._deeds,
        )

    def _sample(self, look: Watch) -> None:
        """Copy what a sample shows; before the first tick, the world as it stands."""
        state, tick, alive = look.state, look.tick, look.state.alive
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
            "focus": {name: self._in_focus(name, state) for name in self._scene.groups},
        }
        if state.set_point is not None:
            sample["set_point"] = np.where(alive[:, None], state.set_point, np.nan).astype(np.float32)
        sample["panels"] = {panel.key: panel.sample(look) for panel in self._panels}
        self._samples.append(sample)
        self._sampled += 1
        self._shown, self._deeds = state.tick, []
        self._happened, self._changed = [], set()

    def _in_focus(self, name: str, state: State) -> dict[str, Any]:
        """Return who is in focus of a species, and what it sees."""
        slot = self._focus.slots[name]
        species = self._scene.scenario.species[self._scene.groups[name].index]
        shown: dict[str, Any] = {"slot": slot, "name": self._focus.name(name), "anew": name in self._changed}
        if slot < 0:
            return shown
        seen = np.concatenate([state.resource_position[state.seen[slot]], state.position[self._env.sighted(slot)]])
        gap = plane_of(self._scene.scenario.arena).gap(state.position[slot], seen)
        shown["sight"] = state.position[slot] + gap
        shown["field"] = shapes.view_field(species, state.position[slot], float(state.heading[slot]))
        shown["own"] = float(state.own_drive[slot])
        return shown

    def _follow(self) -> None:
        """Let the minds keep the decisions of those in focus."""
        for name, group in self._scene.groups.items():
            if self._scene.decides[name]:
                slot = self._focus.slots[name]
                self._minds[name].follow([slot - group.slots.start] if slot >= 0 else [])

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
