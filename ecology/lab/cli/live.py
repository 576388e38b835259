"""A run on the command line: what records and shows it while it runs; `summary.py` prints the summary."""

from __future__ import annotations

import contextlib
import logging
import signal
import tempfile
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ecology import Ecology, EcologyError, State, Tick
from ecology.ground.outline import drawn_lines
from ecology.lab import compiling
from ecology.lab.cli.progress import Progress
from ecology.lab.cli.summary import print_summary
from ecology.lab.runs.folder import METRICS, RECORDING
from ecology.lab.runs.run import Run
from ecology.lab.runs.stopping import StoppedError
from ecology.observers.base import Mind, Observer
from ecology.observers.control import Control
from ecology.observers.focus_requests import AGENTS, Click, FocusRequests

if TYPE_CHECKING:
    from ecology.observers.hindsight import Hindsight
    from ecology.observers.page import Page
    from ecology.observers.rerun import RerunObserver


def run_and_report(run: Run, observers: list[Observer], *, quiet: bool) -> None:
    """Run to the end with a progress bar and print the summary; then serve the page of the run until Ctrl-C."""
    if not quiet:
        observers.append(Progress(run.totals, run.plan.ticks))
    audience = next((each for each in observers if isinstance(each, Audience)), None)
    with contextlib.ExitStack() as at_end:
        if audience is not None:
            at_end.callback(audience.close)
        try:
            with compiling.share_compiling(run.learners.values()):
                summary = run.live(observers)
        except StoppedError as stopped:
            if not quiet:
                with contextlib.suppress(OSError):  # a terminal that hung up
                    print(f"stopped by {stopped} at tick {run.totals.tick}; resume with: {run.resume_command()}")
            raise
        if not quiet:
            print_summary(run.folder, summary)
        if audience is not None and audience.url is not None:
            look_back(run, audience)


def look_back(run: Run, audience: Audience) -> None:
    """Serve the recording of a run that is over at the address of its page, until Ctrl-C."""
    with contextlib.ExitStack() as stack:
        if run.plan.record:
            from ecology.observers import viewer
            from ecology.observers.hindsight import Hindsight

            past = Hindsight(
                stack.enter_context(viewer.open_recording(run.folder)), run.scenario, run.folder.absolute().name
            )
            kept = Path(stack.enter_context(tempfile.TemporaryDirectory())) / RECORDING
            audience.look_back(past.write_view(None, kept), past)
        print(f"the page is still there: {audience.url}\nstop with Ctrl-C", flush=True)
        with contextlib.suppress(KeyboardInterrupt):
            wait()


def wait() -> None:
    """Wait for Ctrl-C, or to be ended."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    threading.Event().wait()


@dataclass(frozen=True)
class Watching:
    """How a run is watched while it lives; without anything, it is not."""

    view: bool = False  # open a viewer
    serve: bool = False  # show it in a browser, with its controls
    port: int | None = None  # of the page
    connect: str | None = None  # address of an open viewer
    focus: Sequence[str] = ()  # whom to watch closely
    paused: bool = False  # at the first tick
    pace: float | None = None  # ticks per second
    patient: bool = True  # wait for pages that fall behind

    @property
    def now(self) -> bool:
        """Return whether anyone sees the run before it is over."""
        return bool(self.view or self.serve or self.connect)


def make_observers(run: Run, watching: Watching | None = None, *, resume: bool) -> list[Observer]:
    """Return the observers that record and show the run."""
    from ecology.observers.census import Focus

    how = watching or Watching()
    observers: list[Observer] = []
    if how.focus and not (run.plan.record or how.now):
        raise EcologyError("--focus is of a run that is recorded or watched; leave it out, or leave out --no-record.")
    Focus.of(run.env, how.focus)  # an unknown agent is refused before anything is written
    requests = FocusRequests(run.folder)
    if how.serve:
        run.control = Control(paused=how.paused, pace=how.pace, patient=how.patient)
    if run.plan.record:
        from ecology.observers.recorder import Recorder  # slow to load

        every = run.plan.record_every
        observers.append(Recorder(run.folder / METRICS, every, resume=resume, deeds=run.schedule.since(run.now, every)))
    if run.plan.record or how.now:
        from ecology.observers.rerun import Recorded, RerunObserver, Viewers  # slow to load
        from ecology.observers.viewer import LOOPBACK

        served = (LOOPBACK, None if how.serve else 0) if how.view or how.serve else None
        rerun = RerunObserver(
            run.folder / RECORDING if run.plan.record else None,
            every=run.plan.record_every,
            viewers=Viewers(served, how.connect),
            focus=how.focus,
            detail=run.plan.record_detail if run.plan.record_detail != "auto" else None,
            run=Recorded(run.folder.name, resume, run.born_and_died(), requests, run.control),
        )
        observers.append(rerun)
        if served is not None:
            observers.append(Audience(run, rerun, requests, how))
    return observers


def web_port(port: int | None) -> int:
    """Return the port to serve browsers at: the one given, or by default one that is free."""
    from ecology.observers import viewer

    if port is not None:
        return viewer.free_port(viewer.LOOPBACK, port)
    return viewer.preferred_port(viewer.LOOPBACK, viewer.WEB_PORT)


class Audience:
    """Opens viewers on a run that serves, an observer: the viewer itself, or a page with the controls of the run."""

    def __init__(self, run: Run, rerun: RerunObserver, requests: FocusRequests, how: Watching) -> None:
        from ecology.observers.viewer import needs_display

        if how.view:
            needs_display("use --serve and look from a browser")
        if how.port is not None:
            web_port(how.port)  # a taken port is refused before anything is written
        self._serves, self._port = how.serve, how.port
        self._run, self._rerun, self._requests, self._view = run, rerun, requests, how.view
        self._page: Page | None = None
        self._state: State | None = None
        self._over = self._can_look_back = False

    @property
    def url(self) -> str | None:
        """Return the address of the page, None without one."""
        return None if self._page is None else self._page.url

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Open them: what they attach to is there by now."""
        from ecology.observers import viewer
        from ecology.observers.page import Page, Shown

        self._state, source = env.state_view, self._rerun.url
        assert source is not None
        if self._view:
            viewer.attach(source)
        if self._serves:
            name = self._run.folder.absolute().name
            try:  # at the usual port only now: another run that starts would find the same one free
                port = web_port(self._port)
                self._page = Page(Shown([source], self.hear, desk=self), port=port, name=name)
                print(
                    f"watch in a browser: {self._page.url} (every program on this machine can open it, and pause or "
                    "change the run there)",
                    flush=True,
                )
            except EcologyError as error:
                logging.getLogger("ecology").warning("%s The run continues.", error)
            print(
                f"watch in a viewer: rerun --connect {source} (every program on this machine can read "
                "it, and draw there for other viewers; none of that reaches the run)",
                flush=True,
            )

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Leave the watching to the viewers."""
        self._state = state

    def intervened(self, state: State, text: str, said: str) -> None:
        """Take the state after an intervention."""
        self._state = state

    def end(self) -> None:
        """Tell pages that the run is over; they stay until `close`."""
        self._over = True

    def look_back(self, recording: Path, past: Hindsight) -> None:
        """Show a recording of the run to pages that are loaded from now on."""
        if self._page is not None:
            from ecology.observers.page import Shown

            shown = Shown([recording.name], past.hear, {recording.name: recording}, named=past.layer_named)
            self._page.look_back(shown, self)
            self._can_look_back = True

    def close(self) -> None:
        """Serve browsers no more; a viewer that was opened stays."""
        if self._page is not None:
            self._page.close()

    # ---- for the page, in its threads --------------------------------------------------------

    def status(self, page: str, shown: float | None) -> dict[str, Any]:
        """Return how the run goes, to a `page` that shows the tick `shown`."""
        control, state = self._run.control, self._state
        assert control is not None
        assert state is not None
        control.seen(page, shown)
        more = {
            "ticks": self._run.plan.ticks, "alive": _alive(self._run.env, state), "focus": self._rerun.focus,
            "mind": self._rerun.mind, "over": self._over, "fork": self._fork_status(),
            "back": "ready" if self._can_look_back else "making" if self._run.plan.record else "",
        }  # fmt: skip
        return {**control.status(), "tick": state.tick, **more, "folder": str(self._run.folder)}

    def _fork_status(self) -> dict[str, Any] | None:
        """Return the status of the fork beside the run, None without one."""
        if (twin := self._run.twin) is None:
            return None
        fork = twin.run
        alive = _alive(fork.env, fork.env.state_view)
        return {"name": fork.folder.name, "folder": str(fork.folder), "at": twin.began, "alive": alive}

    def hear(self, click: Click) -> str | None:
        """Handle a click; report if it hits no living agent."""
        self._requests.hear(click)
        state, name = self._state, click.entity.removeprefix(f"{AGENTS}/")
        group = self._run.env.groups.get(name)
        if state is None or group is None or click.row >= group.size:
            return "Nobody is there: click a body, or press f and write a name."
        alive = bool(state.alive[group.slots.start + click.row])
        return None if alive else f"That {name} lives no more; look back at it when the run is over."

    def order(self, order: str, pace: float | None) -> dict[str, Any]:
        """Pause, step or pace the run."""
        self._check_alive()
        assert self._run.control is not None
        self._run.control.order(order, pace)
        return self._run.control.status()

    def do(self, text: str) -> str:
        """Intervene."""
        self._check_alive()
        return self._run.do(text)

    def fork(self, text: str) -> str:
        """Fork the run, with the intervention `text` in the fork if there is any."""
        self._check_alive()
        fork = self._run.fork(do=[text] if text.strip() else [])
        assert fork is not None
        return f"forked at tick {self._run.now:,}: {fork.folder}"

    def do_in_fork(self, text: str) -> str:
        """Intervene in the fork."""
        twin = self._run.twin
        if twin is None or twin.over:
            raise EcologyError("this run has no fork in progress; fork it first.")
        return twin.run.do(text)

    def focus(self, who: str) -> str:
        """Bring an agent into focus."""
        self._check_alive()
        return self._requests.name(who)

    def world(self) -> dict[str, Any]:
        """Return the walls, and where resources and agents are, with their radii and colours."""
        from ecology.observers import colours, shapes

        state, scenario, env = self._state, self._run.scenario, self._run.env
        assert state is not None
        model = env.world.model
        kinds = zip(scenario.resources, colours.resource_colours(scenario), strict=True)
        looks = [{"radius": r.radius, "colour": list(shade)} for r, shade in kinds for _ in range(r.count)]
        resources = [
            {"name": name, "x": x, "y": y, **look}
            for name, (x, y), look in zip(model.patch_names(), state.resource_position.tolist(), looks, strict=True)
        ]
        shown = [
            {
                "radius": shapes.radius(scenario, species),
                "colour": list(colours.species_colour(i, alone=len(env.groups) == 1)),
            }
            for i, species in enumerate(scenario.species)
        ]
        agents = []
        for name, slot in model.living(state).items():
            x, y = state.position[slot].tolist()
            agents.append({"name": name, "x": x, "y": y, **shown[model.species_of[slot]]})
        walls = [list(map(float, corner)) for corner in scenario.arena.vertices]
        lines = [line.tolist() for line in drawn_lines(scenario.arena)[1:]]  # holes and inner walls
        return {"walls": walls, "lines": lines, "resources": resources, "agents": agents, "tick": state.tick}

    def _check_alive(self) -> None:
        if self._over:
            raise EcologyError("the run is over.")


def _alive(env: Ecology, state: State) -> dict[str, int]:
    """Return how many live, by species."""
    return {name: int(state.alive[group.slots].sum()) for name, group in env.groups.items() if group.size}
