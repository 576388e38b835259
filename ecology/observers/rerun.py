"""The run in the Rerun viewer, live and as a recording: takes samples and sends them.

What is sampled and drawn is in panels/, a file each, where on the screen in layout.py; hindsight.py looks back at a
recording.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# read by Rerun when it is loaded: that bytes of a run that failed are not written is told by the run
os.environ.setdefault("RUST_LOG", "warn,re_sdk::binary_stream_sink=error")

import rerun as rr

from ecology.env import Ecology
from ecology.errors import EcologyError
from ecology.observers import relay
from ecology.observers.base import Mind, Observer
from ecology.observers.control import Control
from ecology.observers.drawing import Drawing, open_scene
from ecology.observers.focus_requests import FocusRequests
from ecology.observers.layout import FORK, blueprint
from ecology.observers.panels.base import Watch
from ecology.observers.panels.decision import headline
from ecology.observers.panels.futures import Futures
from ecology.observers.readback import prepare_to_resume, replace_layout, span
from ecology.observers.recording_file import RecordingFile, open_stream
from ecology.observers.sampler import Sampler, Sampling
from ecology.observers.scene import Scene
from ecology.observers.viewer import (
    LOOPBACK,
    SERVE_PORT,
    check_url,
    free_port,
    join_recordings,
    preferred_port,
    recording_parts,
    unfinished_path,
)
from ecology.spec import require
from ecology.state import State
from ecology.world import Tick

SAMPLES = 256  # sent in one go, at most
SECONDS_FILE, SECONDS_LIVE = 1.0, 0.25  # of the clock between two sendings, at most
TIDY = 2 * 2**30  # bytes up to which a recording is put in order at the end, by a process that takes as much memory
DETAILS = ("full", "lean")


@dataclass(frozen=True)
class Viewers:
    """Where viewers see a world while it lives."""

    # host and port where they may attach; port 0 picks a free one at once, None the usual one, or else a free one,
    # when the run starts
    serve: tuple[str, int | None] | None = None
    connect: str | None = None  # rerun+http://HOST:PORT/proxy of one elsewhere, which must be open already


@dataclass(frozen=True)
class Recorded:
    """The run whose world is recorded."""

    name: str | None = None  # the scenario's without
    resume: bool = False  # continue the file
    before: tuple[Sequence[int], Sequence[int]] | None = None  # births and deaths so far, by species
    requests: FocusRequests | None = None  # for another focus
    # of its pace, if anyone may set it: is told of decisions and of what was sent. Where it slows the run down, more
    # ticks are sampled, so that every picture is current
    control: Control | None = None


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
        focus: Iterable[str] = (),
        viewers: Viewers | None = None,
        run: Recorded | None = None,
    ) -> None:
        """Record every `every` ticks, and deviation maps every `maps_every` ticks.

        path: the file, "recording.rrd" of the run's folder.
        detail: "full", or "lean" without drive and reward of every agent (the focus has them, and colours
        show the drive); full up to 100 agents and lean above when None.
        focus: whom to draw over time: names of agents, a species (shown first), or "hungriest"; the first
        agent of each species otherwise. When one dies, another of its species takes its place.
        viewers: that see the world while it lives. run: whose world it is, where it is a run's.
        """
        viewers, run = viewers or Viewers(), run or Recorded()
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
        self._how, self._run, self._asked = Sampling(run.name or "", every, maps_every, detail), run, tuple(focus)
        self._requests, self._control = run.requests or FocusRequests(), run.control
        require(
            self._path is None or run.resume or not self._path.exists(),
            f"there is a recording at {str(path)!r} already; choose another folder, or resume that run.",
        )
        self._host, port = viewers.serve or (LOOPBACK, 0)
        self._port = free_port(self._host, port) if viewers.serve and port is not None else 0
        self._usual = port is None  # whether the port is chosen when the run starts
        self._connect = check_url(viewers.connect) if viewers.connect else None
        self._relays: list[relay.Relay] = []
        self._rec: rr.RecordingStream | None = None
        self._ended = True  # until it begins
        self._file: RecordingFile | None = None
        self._drawing: Drawing | None = None
        self.mind = ""  # the decision of the agent that is shown first, and its plan, at the last sample

    @property
    def url(self) -> str | None:
        """Return where viewers attach, None where nothing is served yet."""
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
        self._env = env
        if self._usual:  # late: another run that starts now would find the same port free
            self._port = preferred_port(self._host, SERVE_PORT)
        self._sampler = Sampler(
            env,
            minds,
            asked=self._asked,
            before=self._run.before,
            how=self._how._replace(run=self._how.run or env.scenario.name),
            watched=self._is_watched,
        )
        self._scene = self._sampler.scene
        self._side: Side | None = None  # the other future, of a fork
        self._futures: Futures | None = None
        goes_on = self._open(state.tick)
        if self._port:
            self._relays.append(relay.Relay(relay.SERVE, f"{self._host}:{self._port}", self._scene))
        if self._connect:
            self._relays.append(relay.Relay(relay.CONNECT, self._connect, self._scene))
        self._samples: list[dict[str, Any]] = []
        self._since = time.monotonic()
        self._shown = -1
        drawing = self._drawing
        self._drawing = None if goes_on else drawing  # a recording that goes on has this tick
        self._sample(self._sampler.look(state))
        self._send()
        self._drawing = drawing
        self._write()

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Take a sampled tick, and send what has gathered now and then."""
        sampled = state.tick % self._how.every == 0 or self._is_slow()
        turned = sampled and self._serve_requests(state)
        look = self._sampler.watch(state, tick, sampled=sampled, turned=turned)
        if self._control and self._sampler.has_decided(state):
            self._control.decided()
        if not sampled:
            return
        self._sample(look)
        wait = SECONDS_LIVE if self._relays else SECONDS_FILE
        if len(self._samples) >= SAMPLES or time.monotonic() - self._since > wait:
            self._send()

    def _sample(self, look: Watch) -> None:
        """Take a sample, with the other future where there is one."""
        first = self._sampler.shown_first
        if first and (decision := look.decision(first)) is not None:
            plan = look.plan(first) if look.closely else None
            ahead = "" if plan is None else f"; plan: {' → '.join(plan.options)}"
            self.mind = headline(decision, look.state.tick) + ahead
        else:
            self.mind = ""
        sample = self._sampler.sample(look)
        if self._side is not None and self._futures is not None:
            other = self._side.look()
            sample["futures"] = self._futures.compare(look, other)
            sample["fork"] = self._side.sampler.sample(other)
        self._samples.append(sample)
        self._shown = look.state.tick

    def _sample_between(self, look: Watch) -> None:
        """Take a sample where none is due."""
        self._sampler.follow(look)
        self._sample(look)

    def intervened(self, state: State, text: str, said: str) -> None:
        """Note what was done from outside: an event."""
        self._sampler.deeds.append((state.tick, said))

    def held(self) -> None:
        """Show the world as it stands while the run waits."""
        state = self._env.state_view
        turned = self._serve_requests(state)
        fresh = self._side is not None and self._side.is_fresh
        is_shown = state.tick == self._shown and state.tick == self._sampler.closest
        if is_shown and not (turned or fresh or self._sampler.deeds):
            return
        self._sampler.refocus(state, anew=turned)
        self._sample_between(self._sampler.look(state, turned=turned, waits=True))
        self._send()

    def _is_watched(self) -> bool:
        """Return whether a viewer is attached."""
        return any(each.watched for each in self._relays)

    def _is_slow(self) -> bool:
        """Return whether a picture is due before the next sample of the recording."""
        return self._control is not None and time.monotonic() - self._since > 2 * SECONDS_LIVE

    def _serve_requests(self, state: State) -> bool:
        """Turn to those whom somebody requests to see, where they live; say whether there were any."""
        focus = self._sampler.focus
        names = [name for click in self._requests.clicks() if (name := focus.name_clicked(self._env, click))]
        for name in names:
            self._turn(name)
        for asked, answer in self._requests.words():
            why = self._turn(asked)
            answer(f"{asked} is in focus from tick {state.tick} on" if why is None else why, why is None)
            names += [asked] * (why is None)
        if self._scene.crowd and focus.first != self._scene.first:
            self._scene.first = focus.first
            self._lay_out()
        return bool(names)

    def _turn(self, who: str) -> str | None:
        """Bring `who` into focus, in both futures if it is alive in both; return the reason if that is impossible."""
        if self._side is not None:
            self._side.sampler.turn(who)
        return self._sampler.turn(who)

    def _lay_out(self) -> None:
        """Send a new layout to attached viewers; of several layouts in a file, one would be shown by chance."""
        for each in self._relays:
            each.put(pickle.dumps(("lay_out", (self._scene.first,))))

    def forked(self, name: str, change: str) -> Side:
        """Show the fork `name` beside this run from now on; return the observer to attach to the fork."""
        self._send()
        asked = [self._sampler.focus.name(species) for species in self._scene.groups]
        asked = [each for each in asked if not each.startswith("no ")]
        first = self._sampler.shown_first
        asked.sort(key=lambda each: each.rpartition("_")[0] != first)
        how = self._how._replace(run=name)
        self._side = Side(how, tuple(asked), self._open_fork, watched=self._is_watched)
        self._scene.fork, self._scene.forked_at = name, self._env.state_view.tick
        self._futures = Futures(self._scene)
        self._futures.begin(self._env.state_view.tick, change)
        return self._side

    def _open_fork(self, scene: Scene) -> None:
        """Begin to draw the other future."""
        self._show("open_fork", scene)
        self._lay_out()

    def flush(self) -> None:
        """Write the samples so far at a checkpoint, with one of this tick, so that the file lacks nothing up to it."""
        state = self._env.state_view
        if state.tick != self._shown:
            self._sample_between(self._sampler.look(state))
        self._send()
        self._write()

    def end(self) -> None:
        """Send what is left, close the file and put it in good order."""
        if self._ended:
            return
        self._ended = True
        with contextlib.ExitStack() as at_end:
            at_end.callback(self._close)
            look = self._sampler.look(self._env.state_view)
            found = {panel.key: value for panel in self._sampler.panels if (value := panel.final(look)) is not None}
            if self._sampler.deeds:  # since the last sample
                self._sample(look)
            self._send()
            if found:
                self._show("draw_final", {"tick": look.state.tick, "panels": found})
            self._write()
        if self._path:
            parts = [self._path] if self._target == self._path else [self._path, self._target]
            if (len(parts) > 1 or self._path.stat().st_size <= TIDY) and join_recordings(parts, self._path):
                self._lay_out_file()

    def _lay_out_file(self) -> None:
        """Give the recording a layout that knows where it ends; it keeps the one it has where there is no room."""
        assert self._path is not None
        self._scene.span = span(self._path)
        with tempfile.TemporaryDirectory() as folder, contextlib.suppress(OSError, RuntimeError, EcologyError):
            layout = Path(folder) / "layout.rbl"
            blueprint(self._scene).save(self._scene.application, layout)
            replace_layout(self._path, layout, self._path, self._scene.application)

    def _open(self, tick: int) -> bool:
        """Open the file, if there is one, and draw the first screen there; return whether it continues a recording.

        What a run that was killed recorded after the tick that it goes on from is left out: it is recorded again.
        """
        if self._path is None:
            return False
        self._target, identity, layout = self._path, None, True
        unfinished_path(self._path).unlink(missing_ok=True)
        if self._run.resume and (tick == 0 or not (self._path.exists() and self._path.stat().st_size)):
            for part in recording_parts(self._path):  # the run was killed before its first checkpoint: it starts over
                part.unlink()
        if self._run.resume and self._path.exists():
            self._target, identity, layout = prepare_to_resume(self._path, tick, self._scene.application)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._rec = open_stream(self._scene.application, identity)
        self._file = RecordingFile(self._target, self._rec)
        if layout:  # of several in a file one is shown by chance
            self._file.lay_out(blueprint(self._scene), self._scene.application)
        open_scene(self._rec, self._scene)
        self._drawing = Drawing(self._rec, self._scene)
        return identity is not None

    def _write(self) -> None:
        """Put what was drawn into the file."""
        if self._file is not None:
            self._file.append()

    @property
    def focus(self) -> str:
        """Return the name of the agent whose life is shown first."""
        name = self._sampler.shown_first
        return self._sampler.focus.name(name) if name else "nobody"

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


class Side(Observer):
    """Watches the fork of a run for the observer that shows both."""

    def __init__(
        self,
        how: Sampling,
        asked: Sequence[str],
        opened: Callable[[Scene], None],
        *,
        watched: Callable[[], bool],
    ) -> None:
        """Sample the fork as `how` says, with the `asked` focus; call `opened` with the scene.

        watched: whether a viewer is attached.
        """
        self._how, self._asked, self._open_fork, self._watched, self.is_fresh = how, asked, opened, watched, True

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Start to follow the fork."""
        self._env = env
        self.sampler = Sampler(env, minds, FORK, asked=self._asked, how=self._how, watched=self._watched)
        self._open_fork(self.sampler.scene)

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Look at a tick."""
        self.sampler.watch(state, tick, sampled=state.tick % self._how.every == 0)

    def intervened(self, state: State, text: str, said: str) -> None:
        """Note an intervention in the fork."""
        self.sampler.deeds.append((state.tick, said))
        self.is_fresh = True

    def look(self) -> Watch:
        """Return what a sample is taken from."""
        self.is_fresh = False
        self.sampler.refocus(self._env.state_view, anew=False)
        return self.sampler.look(self._env.state_view)
