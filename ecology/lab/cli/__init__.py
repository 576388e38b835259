"""The command line: the only place that joins worlds, learners, scenarios and those who watch.

What is slow to load (torch, rerun, matplotlib) is loaded by the command that needs it.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import logging
import math
import os
import re
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
import typer.core
from numba.core import event
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import ecology
from ecology import Ecology, EcologyError, Scenario, State, Tick, agents, scenarios
from ecology import faults as _faults
from ecology.errors import check_writable, describe_refusal, is_from_system, nearest, writable
from ecology.lab import compiling as _compiling
from ecology.lab.runs import run as _run
from ecology.lab.runs.run import Run, StoppedError, Tally
from ecology.lab.runs.run_config import read_config, resolve
from ecology.lab.values import read_value
from ecology.observers.base import Mind, Observer
from ecology.observers.wishes import Wishes

if TYPE_CHECKING:
    from ecology.observers.page import Page

REFRESH = 0.25  # seconds between two pictures of the progress bar
LINE = 10.0  # seconds between two lines of progress where there is no terminal
EVALUATION_SEED = 1_000  # added to the run's seed: an evaluation draws other numbers than the life
EVALUATED = 10_000  # ticks of every life of an evaluation
RECORD = "on"  # what a bare --record stands for
WIDE = 180  # characters of the certificate where there is no terminal
CHECKED = 200  # ticks of a life in `ecology check`
SKIPPED = 1_000  # ticks of a life from birth that are not measured, or its first tenth if that is less

app = typer.Typer(
    name="ecology",
    help="An ecology sandbox: self-regulated agents that learn their bodies and their world.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"ecology {ecology.__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """An ecology sandbox: self-regulated agents that learn their bodies and their world."""


def main(words: Sequence[str] | None = None) -> None:
    """Run the command line; a user's error is one message on stderr and exit code 2.

    Before the message of an exception in a user's own code stand the frames from there on.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # torch reads it; on small networks threads only cost
    given = list(sys.argv[1:] if words is None else words)
    _compiling.notice.say = _ignore if "--quiet" in given else _compiling.Lines(_print_error)
    try:
        with event.install_listener("numba:compile", _compiling.notice):
            app(args=_spelt(given))
    except StoppedError as stopped:
        sys.exit(128 + stopped.signum)
    except Exception as error:
        told = error if isinstance(error, EcologyError) else _faults.of(error) or _refused(error)
        if told is None:
            raise
        frames = told.frames if isinstance(told, _faults.FaultError) else ""
        print(f"{frames}ecology: {told}", file=sys.stderr)
        sys.exit(2)


def _ignore(words: str) -> None:
    """Print nothing."""


def _print_error(words: str) -> None:
    """Print a line on stderr; a terminal that hung up stops nothing."""
    with contextlib.suppress(OSError):
        print(words, file=sys.stderr, flush=True)


def _refused(error: Exception) -> EcologyError | None:
    """Return what to say where the operating system refused a path that the user gave; else None."""
    if not isinstance(error, OSError) or not is_from_system(error) or error.filename is None:
        return None
    return EcologyError(f"{describe_refusal(error)}. Give another path, or allow using this one.")


def _spelt(words: list[str]) -> list[str]:
    """Return the words of `run` with a bare --record, which takes KEY=VALUE, written out.

    EcologyError where one is empty, as a shell makes of a variable that is not set: a path of nothing is here.
    """
    for before, word in zip(["ecology", *words], words, strict=False):
        if not word or re.fullmatch(r"--[\w-]+=", word):
            option = word.removesuffix("=") or before
            raise EcologyError(
                f"no word is empty, got '' after {option}; write what is meant, or leave it out with its option."
            )
    if words[:1] != ["run"]:
        return words
    after = [*words[1:], ""]
    bare = [word == "--record" and "=" not in next_ for word, next_ in zip(words, after, strict=True)]
    return [part for word, alone in zip(words, bare, strict=True) for part in ([word, RECORD] if alone else [word])]


# ---- list and new ----------------------------------------------------------------------------


@app.command("list")
def list_() -> None:
    """Show the scenarios and the learners, one line each."""
    learners = {name: line for name, (_, _, _, line) in agents.LEARNERS.items()}
    worlds = {name: _first_line(scenarios.HERE / f"{name}.py") for name in scenarios.names()}
    width = max(map(len, [*worlds, *learners]))
    for title, lines in (("scenarios", worlds), ("learners", learners)):
        print(title)
        for name, line in lines.items():
            print(f"  {name:<{width}}  {line}")


def _first_line(path: Path) -> str:
    """Return the first line of the docstring of a file, without running it."""
    try:
        node = ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, SyntaxError) as error:
        return f"(cannot be read: {error})"
    return (ast.get_docstring(node) or "").partition("\n")[0]


@app.command()
def new(name: Annotated[str, typer.Argument(help="A Python word; NAME.py is written.")]) -> None:
    """Write a small scenario file, to be changed and run."""
    name = name.removesuffix(".py")
    if not name.isidentifier():
        raise EcologyError(f"the name of a scenario is a Python word (letters, digits and _), got {name!r}.")
    path = Path(f"{name}.py")
    text = (scenarios.HERE / "_template.py").read_text(encoding="utf-8").replace("NAME", name)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise EcologyError(f"the file {str(path)!r} exists; choose another name.") from error
    except OSError as error:
        raise EcologyError(f"the file {str(path)!r} cannot be written: {error.strerror}.") from error
    print(f"{path} is written. Run it with: ecology run {path}")


# ---- check -----------------------------------------------------------------------------------


@app.command()
def check(
    scenario: Annotated[str, typer.Argument(help="A name of `ecology list`, or a path to a .py file.")],
    ticks: Annotated[int, typer.Option(min=1, help="Length of every life that is looked at.")] = CHECKED,
) -> None:
    """Hold a scenario to the contract that every scenario keeps; exit code 1 where it is broken."""
    from ecology import contract  # needed by this command only

    broken = 0
    for holds, error in contract.check(scenarios.load(scenario), ticks):
        fault = None if error is None else _faults.of(error)
        if fault is not None:
            raise fault from error
        print(f"{'FAIL' if error else 'pass'}  {holds}", flush=True)
        if error:
            broken += 1
            print(f"      {contract.reason(error)}")
    if broken:
        print(f"{scenario} breaks the contract in {broken} of {len(contract.CHECKS)} points.", file=sys.stderr)
        raise typer.Exit(1)
    print(f"{scenario} keeps the contract, over {ticks} ticks and {len(contract.CHECKS)} points.")


# ---- run -------------------------------------------------------------------------------------


@app.command()
def run(
    scenario: Annotated[str | None, typer.Argument(help="A name of `ecology list`, or a path to a .py file.")] = None,
    ticks: Annotated[int | None, typer.Option(min=1, help="Length of the run.", show_default="the scenario's")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of everything random.", show_default="0")] = None,
    learner: Annotated[list[str] | None, typer.Option(metavar="[SPECIES=]NAME", help="Who learns.")] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A setting: KEY, learner.KEY or SPECIES.learner.KEY."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the run.", show_default="runs/SCENARIO-SEED")] = None,
    config: Annotated[Path | None, typer.Option(help="A config.toml to repeat.")] = None,
    resume: Annotated[Path | None, typer.Option(help="Folder of a run to go on with.")] = None,
    previous: Annotated[
        bool, typer.Option("--previous", help="With --resume: go on from the checkpoint before the last.")
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Open the Rerun viewer and watch.")] = False,
    serve: Annotated[bool, typer.Option("--serve", help="Let viewers attach while it runs.")] = False,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="Port of the page for --serve.", show_default="9090, or one that is free"),
    ] = None,
    connect: Annotated[str | None, typer.Option(metavar="URL", help="Stream to a viewer that is open.")] = None,
    focus: Annotated[
        list[str] | None,
        typer.Option(metavar="WHO", help="Whom to watch closely: an agent (prey_17), a species, or hungriest."),
    ] = None,
    record: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE", help="How metrics and recording are written: every=TICKS, detail=full or lean."
        ),
    ] = None,
    no_record: Annotated[bool, typer.Option("--no-record", help="Write neither metrics nor a recording.")] = False,
    keep_every: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="Keep a checkpoint every N ticks for good.", show_default="none"),
    ] = None,
    device: Annotated[
        str | None, typer.Option(metavar="cpu|cuda|cuda:N|mps", help="Where learners compute.", show_default="cpu")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Run a scenario and leave one folder: config, summary, metrics, recording, checkpoint."""
    if resume is not None:
        _refuse("--resume", SCENARIO=scenario, seed=seed, learner=learner, set=set_, out=out, config=config)
        _refuse("--resume", record=record, no_record=no_record or None, keep_every=keep_every)
    elif previous:
        raise EcologyError("--previous is of --resume RUN; give that too, or leave it out.")
    _check_port(port, serve=serve)
    with contextlib.ExitStack() as stack:
        if resume is not None:
            stack.enter_context(_run.held(resume))
            it = _run.opened(resume, ticks, device)
            it.resume(previous=previous)
        else:
            words = None if config is None else read_config(config)
            if words and "forked" in words:
                raise EcologyError(f"the config {str(config)!r} is of a fork; repeat that with `ecology fork`.")
            plan = resolve(
                scenario,
                config=words,
                changes=_pairs("--set", set_, _setting),
                learners=learner or (),
                ticks=ticks,
                seed=seed,
                device=device,
                keep_every=keep_every,
                **_recorded(record or (), no_record=no_record),
            )
            it = Run(plan, out or Path("runs") / f"{Path(plan.scenario).stem}-{plan.seed}")
            it.check_folder()
        observers = _watchers(
            it, resume=resume is not None, view=view, serve=serve, port=port, connect=connect, focus=focus or ()
        )
        if resume is None:
            it.start()
            stack.enter_context(_run.held(it.folder))
        _live(it, observers, quiet=quiet)


def _live(it: Run, observers: list[Observer], *, quiet: bool) -> None:
    """Live a run to its end, with progress, and say what it came to."""
    if not quiet:
        observers.append(Progress(it.tally, it.plan.ticks))
    try:
        summary = it.live(observers)
    except StoppedError as stopped:
        if not quiet:
            with contextlib.suppress(OSError):  # a terminal that hung up
                print(f"stopped by {stopped} at tick {it.tally.tick}; go on with: ecology run --resume {it.folder}")
        raise
    if not quiet:
        _say(it.folder, summary)


@app.command()
def focus(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run that is alive.")],
    who: Annotated[str, typer.Argument(metavar="WHO", help="An agent (prey_17), a species, or hungriest.")],
) -> None:
    """Bring someone else into focus in a run that is recorded or watched."""
    from ecology.observers import wishes

    if not (run / _run.CONFIG).is_file():
        raise EcologyError(f"the folder {str(run)!r} holds no run: there is no {_run.CONFIG} in it.")
    print(wishes.ask(run, who, lambda: _run.busy(run)))


def _check_port(port: int | None, *, serve: bool) -> None:
    if port is not None and not serve:
        raise EcologyError("--port requires --serve.")


def _refuse(option: str, **given: Any) -> None:
    for name, value in given.items():
        if value is not None and value != []:
            word = name if name.isupper() else f"--{name.replace('_', '-')}"
            raise EcologyError(f"{option} goes on with a run as it was told; leave out {word}, or start a run anew.")


def _setting(text: str) -> tuple[str, Any]:
    """Return key and value of "key=value"."""
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise EcologyError(f"--set takes KEY=VALUE, got {text!r}.")
    return key.strip(), read_value(value)


def _pairs(
    option: str, words: Sequence[str] | None, read: Callable[[str], tuple[str, Any]], *, several: bool = False
) -> dict[str, Any]:
    """Return what `read` makes of the words of an option, by key; EcologyError where a key is there twice.

    Where `option` takes `several` values of a key, the error writes them in one.
    """
    found: dict[str, Any] = {}
    told: dict[str, str] = {}
    for word in words or ():
        key, value = read(word)
        typed = word.partition("=")[2].strip()
        if key in found:
            instead = f"{key}={told[key]},{typed}" if several else f"{key}={typed}"
            raise EcologyError(
                f"{option} takes {key!r} once, got {told[key]!r} and {typed!r}; write {option} {instead} alone."
            )
        found[key], told[key] = value, typed
    return found


def _recorded(words: Sequence[str], *, no_record: bool) -> dict[str, Any]:
    """Return what the plan says of recording, from the words of --record and --no-record."""
    found: dict[str, Any] = {"record": True} if words else {"record": False} if no_record else {}
    parts = [part for word in words if word != RECORD for part in word.split(",")]
    for key, value in _pairs("--record", parts, _setting).items():
        if key not in ("every", "detail"):
            raise EcologyError(f"--record has no setting {key!r}. {nearest(key, ('every', 'detail'))}")
        if type(value) is not (int if key == "every" else str):
            raise EcologyError(f"--record takes every=TICKS and detail=full or lean, got {key}={value}.")
        found[f"record_{key}"] = value
    return found


def _watchers(
    it: Run,
    *,
    resume: bool,
    view: bool = False,
    serve: bool = False,
    port: int | None = None,
    connect: str | None = None,
    focus: Sequence[str] = (),
) -> list[Observer]:
    """Return those who record and show the run."""
    from ecology.observers.census import Focus

    observers: list[Observer] = []
    if focus and not (it.plan.record or view or serve or connect):
        raise EcologyError("--focus is of a run that is recorded or watched; leave it out, or leave out --no-record.")
    Focus.of(it.env, focus)  # whom nobody can be is told before anything is written
    wishes = Wishes(it.folder)
    if it.plan.record:
        from ecology.observers.recorder import Recorder  # slow to load

        observers.append(Recorder(it.folder / _run.METRICS, it.plan.record_every, resume=resume))
    if it.plan.record or view or serve or connect:
        from ecology.observers.rerun import RerunObserver  # slow to load
        from ecology.observers.viewer import LOOPBACK, SERVE_PORT, preferred_port

        rerun = RerunObserver(
            it.folder / _run.RECORDING if it.plan.record else None,
            every=it.plan.record_every,
            serve=(LOOPBACK, preferred_port(LOOPBACK, SERVE_PORT) if serve else 0) if view or serve else None,
            connect=connect,
            focus=focus,
            detail=it.plan.record_detail if it.plan.record_detail != "auto" else None,
            name=it.folder.name,
            resume=resume,
            before=it.born_and_died(),
            wishes=wishes,
        )
        observers.append(rerun)
        if rerun.url is not None:
            observers.append(Audience(rerun.url, wishes, view=view, serve=serve, port=port))
    return observers


def _web_port(port: int | None) -> int:
    """Return the port to serve browsers at: the one given, or by default one that is free."""
    from ecology.observers import viewer

    if port is not None:
        return viewer.free_port(viewer.LOOPBACK, port)
    return viewer.preferred_port(viewer.LOOPBACK, viewer.WEB_PORT)


class Audience:
    """Opens viewers on a run that serves, an observer: the viewer itself, or a page that tells of clicks."""

    def __init__(self, url: str, wishes: Wishes, *, view: bool, serve: bool, port: int | None = None) -> None:
        from ecology.observers.viewer import needs_display

        if view:
            needs_display("use --serve and look from a browser")
        self.port = _web_port(port) if serve else None
        self._url, self._wishes, self._view = url, wishes, view
        self._page: Page | None = None

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Open them: what they attach to is there by now."""
        from ecology.observers import viewer
        from ecology.observers.page import Page

        if self._view:
            viewer.attach(self._url)
        if self.port is not None:
            try:
                self._page = Page([self._url], self._wishes.click, dt=env.dt, port=self.port)
                print(f"watch in a browser: {self._page.url}")
            except EcologyError as error:
                logging.getLogger("ecology").warning("%s The run goes on.", error)
            print(f"watch in a viewer: rerun --connect {self._url}")

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Leave the watching to the viewers."""

    def end(self) -> None:
        """Serve browsers no more; a viewer that was opened stays."""
        if self._page is not None:
            self._page.close()


class Progress:
    """Show how far the run is, an observer: a bar on a terminal, a line now and then elsewhere."""

    def __init__(self, tally: Tally, ticks: int) -> None:
        self._tally, self._ticks = tally, ticks
        self._console = Console(stderr=True)
        self._every = REFRESH if self._console.is_terminal else LINE
        self._bar: Any = None
        self._from, self._then = 0, 0.0  # tick and time of the last picture
        self._compiled, self._say = 0, _compiling.notice.say  # functions so far; who says so without a bar

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Start the bar."""
        self._from, self._then = self._tally.tick, time.monotonic()
        if self._console.is_terminal:
            from rich import progress  # slow to load

            self._bar = progress.Progress(
                progress.BarColumn(),
                progress.TaskProgressColumn(),
                progress.TextColumn("{task.description}"),
                progress.TimeRemainingColumn(),
                console=self._console,
                auto_refresh=False,
            )
            self._bar.start()
            self._task = self._bar.add_task("", total=self._ticks, completed=self._from)
            self._say, _compiling.notice.say = _compiling.notice.say, self._describe
        self._compiled = _compiling.notice.count

    def _describe(self, words: str) -> None:
        """Show in the bar what keeps the run waiting."""
        with contextlib.suppress(OSError):
            self._bar.update(self._task, description=words)
            self._bar.refresh()

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Renew the picture, a few times per second at most; a tick that compiled something is no measure of speed."""
        if self._compiled != _compiling.notice.count:
            self._compiled = _compiling.notice.count
            self._from, self._then = self._tally.tick, time.monotonic()
        if time.monotonic() >= self._then + self._every:
            with contextlib.suppress(OSError):  # a terminal that hung up stops nothing
                self._show(minds)

    def _show(self, minds: Mapping[str, Mind]) -> None:
        now, at = time.monotonic(), self._tally.tick
        parts = [f"{(at - self._from) / max(now - self._then, 1e-9):,.0f} ticks/s"]
        drive, own = self._tally.mean_drive(self._from), self._tally.mean_drive(self._from, own=True)
        if drive is not None:
            parts.append(f"mean drive {drive:.2f}")
        if own != drive:
            parts.append(f"own drive {own:.2f}")
        for key, symbol in (("loss_f", "L_f"), ("loss_J", "L_J")):
            losses = [np.asarray(report[key]) for mind in minds.values() if key in (report := mind.report())]
            known = np.concatenate(losses) if losses else np.empty(0)
            known = known[np.isfinite(known)]
            if known.size:
                parts.append(f"{symbol} {known.mean():.3g}")
        self._from, self._then = at, now
        if self._bar is not None:
            self._bar.update(self._task, completed=at, description="  ".join(parts))
            self._bar.refresh()
        else:
            self._console.print(f"tick {at:,} of {self._ticks:,}  {'  '.join(parts)}", highlight=False)

    def end(self) -> None:
        """Leave the last picture."""
        if self._bar is not None:
            _compiling.notice.say = self._say
            with contextlib.suppress(OSError):
                self._bar.update(self._task, completed=self._tally.tick)
                self._bar.refresh()
                self._bar.stop()


def _say(folder: Path, summary: Mapping[str, Any]) -> None:
    drive, last = summary["mean_drive"], summary["mean_drive_last_tenth"]
    own, last_own = summary["mean_own_drive"], summary["mean_own_drive_last_tenth"]
    felt = f" (own drive {_figure(own)}, {_figure(last_own)})" if (own, last_own) != (drive, last) else ""
    print(
        f"{summary['ticks']:,} ticks in {summary['wall_seconds']:,.1f} s; mean drive {_figure(drive)}, "
        f"in the last tenth {_figure(last)}{felt}. The run is in {folder}"
    )
    several = len(summary["population"]) > 1
    for name, of in summary["population"].items() if several or summary["births"] or summary["deaths"] else ():
        gone = "" if of["died_out"] is None else f" (died out at tick {of['died_out']:,})"
        drive, own = summary["species_drive"][name], summary["species_own_drive"][name]
        felt = f" (own drive {_figure(own)})" if own != drive else ""
        print(
            f"{name}: {of['end']} alive{gone}, {of['mean']:.1f} on average, from {of['least']} to {of['most']}; "
            f"mean drive {_figure(drive)}{felt}"
        )
    for name, of in summary["measures"].items():
        known = [_figure(of[key]) for key in ("mean", "least", "most", "end")]
        print(f"{name}: {known[0]} on average, from {known[1]} to {known[2]}, {known[3]} at the end")
    watch = f"ecology view {folder}   or   " if (folder / _run.RECORDING).exists() else ""
    print(f"next: {watch}ecology evaluate {folder}")


def _figure(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.3f}"


# ---- fork ------------------------------------------------------------------------------------


@app.command()
def fork(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    at: Annotated[int, typer.Option(min=0, metavar="TICK", help="From which it is another future.")],
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="A setting that is changed; one of the start changes nothing."),
    ] = None,
    remove: Annotated[list[str] | None, typer.Option(metavar="AGENT", help="Who is no longer there.")] = None,
    move: Annotated[list[str] | None, typer.Option(metavar="RESOURCE=x,y", help="What lies elsewhere.")] = None,
    ticks: Annotated[int | None, typer.Option(min=1, help="To which it lives.", show_default="as the run")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the fork.", show_default="RUN-at-TICK")] = None,
    record: Annotated[bool | None, typer.Option("--record/--no-record", help="Write metrics and recording.")] = None,
    keep_every: Annotated[int | None, typer.Option(min=0, metavar="N", help="As of `run`.")] = None,
    device: Annotated[
        str | None,
        typer.Option(metavar="cpu|cuda|cuda:N|mps", help="Where learners compute.", show_default="as the run"),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Go on with the world of a run from a tick on, with one thing changed, in a folder of its own."""
    from ecology.lab.runs import fork as _fork

    with contextlib.ExitStack() as stack:
        stack.enter_context(_run.held(run))
        it = _run.opened(run, device=device)
        forked = _fork.fork(
            it,
            at,
            out or run.absolute().with_name(f"{run.absolute().name}-at-{at}"),
            changes=_pairs("--set", set_, _setting),
            remove=remove or (),
            move=_pairs("--move", move, _place),
            ticks=ticks,
            device=device,
            record=record,
            keep_every=keep_every,
            observers=[] if quiet else [Progress(it.tally, at)],
        )
        observers = _watchers(forked, resume=False)
        forked.start()
        stack.enter_context(_run.held(forked.folder))
        _live(forked, observers, quiet=quiet)


def _place(text: str) -> tuple[str, tuple[float, float]]:
    """Return resource and place of "RESOURCE=x,y"."""
    name, _, place = text.partition("=")
    try:
        x, y = map(float, place.split(","))
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError
    except ValueError as error:
        raise EcologyError(f"--move takes RESOURCE=x,y, got {text!r}.") from error
    return name.strip(), (x, y)


# ---- sweep -----------------------------------------------------------------------------------


@app.command()
def sweep(
    scenario: Annotated[str, typer.Argument(help="A name of `ecology list`, or a path to a .py file.")],
    seeds: Annotated[str, typer.Option(metavar="FIRST:END", help="Or 1,4,9:12; END is not among them.")] = "0:8",
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE,...", help="Values of a setting: KEY, learner.KEY, ..."),
    ] = None,
    learner: Annotated[list[str] | None, typer.Option(metavar="[SPECIES=]NAME,...", help="Who learns.")] = None,
    ticks: Annotated[int | None, typer.Option(min=1, help="Length of a run.", show_default="the scenario's")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of the sweep.", show_default="runs/sweep-SCENARIO")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Runs at a time.", show_default="one a CPU")] = None,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Run on the Ray cluster at HOST:PORT; `auto` finds one, `local` starts one."
        ),
    ] = None,
    device: Annotated[
        str | None, typer.Option(metavar="cpu|cuda|cuda:N|mps", help="Where learners compute.", show_default="cpu")
    ] = None,
    gpus: Annotated[
        float | None,
        typer.Option("--gpus-per-run", min=0.0, help="GPUs of a run on Ray.", show_default="1 with --device cuda"),
    ] = None,
    memory: Annotated[
        float | None, typer.Option("--memory-per-run", min=0.0, metavar="GIB", help="Memory of a run on Ray.")
    ] = None,
    record: Annotated[bool, typer.Option("--record", help="Write metrics and a recording of every run.")] = False,
    evaluate: Annotated[
        bool, typer.Option("--evaluate", help="Measure what each has learned, as `ecology evaluate` does.")
    ] = False,
    show: Annotated[
        list[str] | None,
        typer.Option(metavar="COLUMN", help="Column of sweep.parquet to print and draw.", show_default="the drive"),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Run a scenario under many seeds and settings; write one table and one figure. Typed again, it goes on."""
    from ecology.lab.runs import sweep as _sweep

    settings: dict[str, list[Any]] = _pairs("--set", set_, _sweep.values_of, several=True)
    out = (out or Path("runs") / f"sweep-{Path(scenario).stem}").absolute()
    cells = _sweep.cells_of(
        scenario, out, seeds=_sweep.seeds_of(seeds), settings=settings, learners=learner or (), evaluate=evaluate,
        ticks=ticks, record=record, device=device,
    )  # fmt: skip
    gpus = _sweep.gpus_per_run(ray, device, gpus, memory)
    for cell in cells:
        _sweep.check(cell)
    _sweep.check_folder(out, cells)

    def built(cell: _sweep.Cell) -> Run:
        plan = cell.plan if ray is None else dataclasses.replace(cell.plan, device="cpu")  # the device is elsewhere
        return Run(plan, cell.folder)

    first = built(cells[0])  # what no run can start with is reported once, and now
    _sweep.check_shown(show or (), cells, lambda cell: (first if cell is cells[0] else built(cell)).summary())
    outcomes = [_sweep.Outcome(cell, _sweep.finished(cell)) for cell in cells]
    waiting = [outcome.cell for outcome in outcomes if outcome.summary is None]
    outcomes = [outcome for outcome in outcomes if outcome.summary is not None]
    attempt: _sweep.Attempt = _sweep.by_process
    count: Callable[[], int] = _cpus
    if ray is not None and waiting:
        attempt, count = _sweep.by_ray(ray, gpus=gpus, memory=memory or 0.0)
    with writable(out):
        out.mkdir(parents=True, exist_ok=True)
    console = Console(stderr=True, quiet=quiet)
    with contextlib.ExitStack() as stack:
        stack.enter_context(_run.held(out))
        advance = stack.enter_context(_bar(console, len(cells), len(outcomes)))

        def tell(outcome: _sweep.Outcome, running: int) -> None:
            outcomes.append(outcome)
            said = outcome.failed
            if outcome.summary is not None:
                told = _sweep.rows_of([outcome])[0]
                columns = _sweep.columns_of([outcome], show or ())
                said = ", ".join(f"{_sweep.label(column)} {_figure(told.get(column))}" for column in columns)
            console.print(f"{outcome.cell.name}: {said}", highlight=False)
            advance(f"{running} under way")

        try:
            _sweep.live(waiting, attempt, count if workers is None else lambda: workers, tell)
        except StoppedError as stopped:
            if not quiet:
                print(f"stopped by {stopped}; go on with the same command")
            raise
        finally:
            done = [outcome for outcome in outcomes if outcome.summary is not None]
            left = [_sweep.Outcome(cell, _sweep.lived(cell)) for cell in cells if _sweep.finished(cell) is None]
            unmeasured = [outcome for outcome in left if outcome.summary is not None]  # they keep their rows
            columns = _sweep.columns_of(done, show or ())
            with writable(out):
                written = _sweep.sum_up(out, [*done, *unmeasured], Path(scenario).stem, columns)
            if not quiet:
                _say_sweep({_sweep.label(column): _sweep.points(done, column) for column in columns})
                print(
                    f"{len(done)} of {len(cells)} runs are whole. Written: {', '.join(map(str, written)) or 'nothing'}"
                )
    failed = [outcome for outcome in outcomes if outcome.summary is None]
    for outcome in failed:
        print(f"ecology: the run {outcome.cell.folder} failed: {outcome.failed}", file=sys.stderr)
    if failed:
        raise typer.Exit(max(outcome.code for outcome in failed))


def _cpus() -> int:
    """Return how many CPUs this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextlib.contextmanager
def _bar(console: Console, total: int, done: int) -> Iterator[Callable[[str], None]]:
    """Show a bar of whole runs on a terminal; what it gives moves it by one."""
    from rich import progress  # slow to load

    with progress.Progress(
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TextColumn("runs  {task.description}"),
        progress.TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal or done == total,
    ) as bar:
        task = bar.add_task("", total=total, completed=done)
        yield lambda words: bar.update(task, advance=1, description=words)


def _say_sweep(found: Mapping[str, Sequence[Any]]) -> None:
    """Print the means of a sweep, a table for every name in `found`."""
    for name, points in found.items():
        if points:
            table = Table(*(axis.removeprefix("set.") for axis in points[0].varied), "runs", name, "95 % interval")
            for point in points:
                interval = f"{point.low:.3f} to {point.high:.3f}" if point.runs > 1 else "-"
                words = map(str, (*point.varied.values(), point.runs))
                table.add_row(*words, _figure(point.mean), interval)
            Console().print(table)


# ---- bench -----------------------------------------------------------------------------------


@app.command()
def bench(
    agents_: Annotated[
        str, typer.Option("--agents", metavar="N,...", help="Numbers of agents.")
    ] = "1,10,100,1000,10000",
    learner: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Who learns, NAME-dicts through the dicts; `none`: nobody.",
            show_default="lean and algorithm1",
        ),
    ] = None,
    against: Annotated[
        str, typer.Option(metavar="WORLD,...", help="waterworld, waterworld_few, mpe2, magent2, vmas.")
    ] = "",
    python: Annotated[
        list[str] | None, typer.Option(metavar="WORLD=PATH", help="The Python that has another world.")
    ] = None,
    rounds: Annotated[int, typer.Option(min=1, help="How often each is timed.")] = 7,
    seconds: Annotated[float, typer.Option(min=0.0, help="For how long each time.")] = 0.5,
    core: Annotated[int | None, typer.Option(min=0, help="All run on this one.", show_default="the last")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the table and the figure.")] = Path("runs") / "bench",
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Measure agent-steps per second against the number of agents, beside other worlds; write a table and a figure."""
    from ecology.lab.bench import speed as _bench

    try:
        counts = sorted({int(word) for word in agents_.split(",")})
    except ValueError:
        counts = []
    if not counts or counts[0] < 1:
        raise EcologyError(f"--agents takes whole numbers of at least 1, as 1,10,100, got {agents_!r}.")
    pythons = dict(word.partition("=")[::2] for word in python or ())
    others = [word.strip() for word in against.split(",") if word.strip()]
    for name in pythons:
        if name not in others:
            raise EcologyError(f"--python {name} is of a world that is not compared with; name it in --against too.")
    learners = [name for name in (learner or _bench.LEARNERS) if name != "none"]
    if (out / _bench.TABLE).exists():
        raise EcologyError(f"the folder {str(out)!r} holds a benchmark; give another with --out.")
    check_writable(out)  # what cannot be kept is told before the long part
    console = Console(stderr=True, quiet=quiet)
    with _bench.pinned(core) as pinned, console.status("") as status:
        wanted = _bench.points(counts, learners, {name: pythons.get(name, sys.executable) for name in others})
        rows, used = _bench.measure(wanted, rounds=rounds, seconds=seconds, tell=status.update)
    written = _bench.write(out, rows, used)
    if not quiet:
        table = Table("", "agents", "agent-steps per second", "quartiles")
        for speed in _bench.speeds(rows):
            table.add_row(
                speed.name, f"{speed.agents:,}", f"{speed.median:,.0f}", f"{speed.low:,.0f} to {speed.high:,.0f}"
            )
        Console().print(table)
        taken = sorted(row["calibration_seconds"] * 1e3 for row in rows)
        where = "not pinned" if pinned is None else f"core {pinned}"
        print(f"{where}; the loop that is always the same took {taken[0]:.1f} to {taken[-1]:.1f} ms between them")
        print(", ".join(_bench.called(name, version) for name, version in used.items()))
        print(f"written: {', '.join(map(str, written))}")


# ---- evaluate and view -----------------------------------------------------------------------


@app.command()
def evaluate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    species: Annotated[str | None, typer.Option(help="Whose learner.", show_default="the first")] = None,
    ticks: Annotated[int, typer.Option(min=10, help="Length of every life that is measured.")] = EVALUATED,
    places: Annotated[int, typer.Option(min=1, help="Places per need at which choices are probed.")] = 60,
    seed: Annotated[int | None, typer.Option(min=0, show_default="the run's + 1000")] = None,
    in_: Annotated[
        str | None, typer.Option("--in", metavar="SCENARIO", help="Another world.", show_default="the run's")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="A setting of the world to measure it in.")
    ] = None,
    device: Annotated[
        str, typer.Option(metavar="cpu|cuda|cuda:N|mps", help="Where the learner computes.")
    ] = "cpu",  # one agent at a time: elsewhere it takes longer
    again: Annotated[
        bool, typer.Option("--again", help="Replace an evaluation that was made with other words.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Measure a run's learner against baselines; write evaluation.json and figures."""
    it = _run.opened(run, device=device)
    if species is not None and species not in it.learners:
        raise EcologyError(f"the run has no species {species!r}. {nearest(species, it.learners)}")
    learner = it.learners[species or next(iter(it.learners))]
    world, where = _elsewhere(it, learner.group.name, in_, set_ or ())
    seed = it.plan.seed + EVALUATION_SEED if seed is None else seed
    if not again:
        words: dict[str, Any] = {"scenario": world.name, "settings": dict(world.settings)}
        words |= {"species": learner.group.name, "device": device, "seed": seed, "ticks": ticks, "places": places}
        _run.check_evaluation(where, words)
    it.restore()
    from ecology.agents import evaluation, figures  # slow to load
    from ecology.observers import recorder

    metrics = run / _run.METRICS
    for folder in (where, where / _run.FIGURES):  # what cannot be kept, or is damaged, is told before the long part
        check_writable(folder)
    if recorder.sources(metrics):
        recorder.read(metrics)

    console = Console(stderr=True, quiet=quiet)
    with console.status("evaluating") as status:

        def tell(words: str) -> None:
            if console.is_terminal:
                status.update(words)
            else:
                console.print(words, highlight=False)

        findings = evaluation.evaluate(
            world,
            learner,
            seed,
            ticks=ticks,
            skip=min(SKIPPED, ticks // 10),
            places=places,
            name=it.plan.learners[learner.group.name].name,
            device=device,
            home=None if world is it.scenario else it.scenario,
            lived=evaluation.Lived(*it.tally.drives(learner.group.name)),
            tell=tell,
        )
        tell("figures")
        with writable(where):
            drawn = figures.draw(where / _run.FIGURES, world, findings, learner.group.layout.names, metrics)
            _run.write_json(where / _run.EVALUATION, findings.report)  # last: with it the evaluation is whole
    if not quiet:
        _say_findings(findings.report)
        print(f"written: {where / _run.EVALUATION} and {len(drawn)} figures in {where / _run.FIGURES}")


def _elsewhere(it: Run, species: str, scenario: str | None, changes: Sequence[str]) -> tuple[Scenario, Path]:
    """Return the world to measure the learner of a species in, and the folder for what is found.

    That is the run's own for its first species in its own world, and else one within it, named for what is another.
    """
    words = [] if species == next(iter(it.learners)) else ["of", species]
    world = it.scenario
    if scenario is not None or changes:
        own = {} if scenario is not None else it.plan.settings
        scenario = scenario or it.plan.scenario
        world = scenarios.load(scenario, **{**own, **_pairs("--set", changes, _setting)})
        words += ["in", Path(scenario).stem, *changes]
    return world, it.folder / re.sub(r"[^\w=.-]+", "_", "-".join(words))


def _say_findings(report: Mapping[str, Any]) -> None:
    """Print an evaluation as tables."""
    console = Console()
    owns = report.get("mean_own_drive", {})
    feels = any(own["mean"] != report["mean_drive"][name]["mean"] for name, own in owns.items())
    drives = Table(
        "",
        "mean drive",
        "95 % interval",
        *(["mean own drive", "95 % interval"] if feels else []),
        title=f"{report['scenario']}, {report['ticks']:,} ticks, on {report['device']}",
    )
    known = {name: drive for name, drive in report["mean_drive"].items() if drive["mean"] is not None}
    for name, drive in sorted(known.items(), key=lambda item: item[1]["mean"]):
        words = []
        for each in (drive, owns[name]) if feels else (drive,):
            interval = f"{each['low']:.3f} to {each['high']:.3f}" if each["blocks"] > 1 else "-"
            words += [_figure(each["mean"]), interval]
        drives.add_row(name, *words, style="bold" if name == "learned" else None)
    console.print(drives)
    gap = report["closed_gap"]
    if gap is not None:
        console.print("worse than camping" if gap < 0 else f"{gap:.0%} of the way from camping to the planner")
    _say_lives(console, report)
    maps, probe = report["deviation_maps"] or {}, report["probe"]
    if maps or probe:
        needs = Table("need", "minimum of J to resource", "rank correlation", "eaten first")
        for name in {**maps, **probe}:
            mapped, right = maps.get(name, {}), probe.get(name, {}).get("share_right")
            needs.add_row(
                name,
                _figure(mapped.get("distance_of_minimum")),
                _figure(mapped.get("spearman_with_walking_distance")),
                "-" if right is None else f"{right:.0%}",
            )
        console.print(needs)
    for name, check in (report["deviation_check"] or {}).items():
        if isinstance(check, Mapping):
            console.print(
                f"J against measured drive, {name.replace('_', ' ')}: correlation "
                f"{_figure(check['correlation'])}, bias {_figure(check['bias'])}",
                highlight=False,
            )


def _say_lives(console: Console, report: Mapping[str, Any]) -> None:
    """Print how the run went, the worst block of the evaluated life, and where the agents were stuck."""
    lived, below = report["as_lived"], report["regulated"]["below"]
    if lived is not None:
        text = f"as lived: mean drive {_figure(lived['mean_drive_last_tenth'])} in the last tenth"
        if below is not None:
            since = lived["regulated_from"]
            then = (
                f"never stays below {below:.2f}" if since is None else f"stays below {below:.2f} from tick {since:,} on"
            )
            text += f"; its running mean over {lived['window']:,} ticks {then}"
        console.print(text, highlight=False)
    for name, words in (("learned", "frozen life"), ("learned_epsilon_0", "frozen life, epsilon 0")):
        worst, sinks = report["worst_block"][name], report["stuck"][name] or []
        if worst is not None:
            console.print(
                f"{words}: worst 1,000 ticks from tick {worst['from']:,}, mean drive {worst['mean']:.2f}; "
                + (f"stuck {len(sinks)} times" if sinks else "never stuck"),
                highlight=False,
            )
        for sink in sinks[:3]:
            x, y = sink["place"]
            console.print(
                f"  ticks {sink['from']:,} to {sink['to']:,} at ({x:.2f}, {y:.2f}): {sink['action']} in "
                f"{sink['share_of_action']:.0%}, mean drive {sink['mean_drive']:.2f}",
                highlight=False,
            )


# ---- reproduce -------------------------------------------------------------------------------


class _Reproduce(typer.core.TyperCommand):
    """Tells the names of the results below its help: they are slow to load, and no other command waits for them."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help, and below it the names."""
        from ecology.lab.certificate import case as _reproduce

        lines = [f"{case.name}: {case.about}" for case in _reproduce.cases().values()]
        self.epilog = "\n\n".join(["The results, by NAME:", *map(escape, lines)])
        super().format_help(ctx, formatter)


@app.command(cls=_Reproduce)
def reproduce(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME ...]", help="Results, listed below.", show_default="all")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder; what is done there is not done again.")] = Path("runs/reproduce"),
    seeds: Annotated[
        str | None, typer.Option(metavar="FIRST:END", help="Seeds of `minds`, END excluded.", show_default="0:32")
    ] = None,
    ticks: Annotated[
        int | None, typer.Option(min=1, help="Length of each training run of `minds`.", show_default="60000")
    ] = None,
    life: Annotated[
        int | None, typer.Option(min=1, help="Length of each frozen life of `minds`.", show_default="20000")
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Setting of the runs of `minds`.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes that measure `minds`.", show_default="one per CPU")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Live results from elsewhere again: theirs, the closed form, ours with interval, and a verdict."""
    from ecology.lab.certificate import case as _reproduce  # slow to load

    cases = _reproduce.chosen(names or ())
    minds = bool(names) and "minds" in [case.name for case in cases]
    for option, value in (("seeds", seeds), ("ticks", ticks), ("life", life), ("set", set_), ("workers", workers)):
        if value and not minds:
            raise EcologyError(f"--{option} is an option of `ecology reproduce minds`; name minds, or drop --{option}.")
    check_writable(out)  # what cannot be kept is told before the long part
    others = [case for case in cases if not (minds and case.name == "minds")]
    if minds:
        _measure_minds(out, seeds or "0:32", ticks, life, _pairs("--set", set_, _setting), workers or _cpus(), quiet)
    if others:
        _certify(others, out, quiet)


def _measure_minds(
    out: Path, seeds: str, ticks: int | None, life: int | None, settings: Mapping[str, Any], workers: int, quiet: bool
) -> None:
    """Train and measure many seeds of `paper`, each in a process, and print what must hold beside what was found."""
    from ecology.lab.certificate import minds as _minds
    from ecology.lab.runs import sweep as _sweep

    jobs = _minds.jobs(out, _sweep.seeds_of(seeds), ticks or _minds.TRAINED, life or _minds.LIFE, settings)
    waiting = [job for job in jobs if not _minds.is_done(job.folder, job.life)]
    check_writable(jobs[0].folder)
    console, began, failed = Console(stderr=True, quiet=quiet), time.monotonic(), list[str]()
    left = sum(map(_minds.seconds, waiting)) / min(workers, max(len(waiting), 1))
    console.print(
        f"minds: {len(jobs)} seeds, {len(waiting)} of them to measure; {_long(left) if waiting else 'done'}",
        highlight=False,
        soft_wrap=True,
    )
    over = 0

    def tell(result: tuple[_minds.Job, str], _: int) -> None:
        nonlocal over
        job, fault = result
        over += 1
        if fault:
            failed.append(f"seed {job.seed}: {fault}")
        told = fault or _minds.line(job)
        more = len(waiting) - over
        then = _long((time.monotonic() - began) / over * more) + " left" if more else "done"
        console.print(f"{over} of {len(waiting)}  seed {job.seed}: {told}; {then}", highlight=False, soft_wrap=True)

    try:
        _sweep.schedule(waiting, _minds.work, lambda: workers, tell)
    except StoppedError:
        console.print(f"stopped; what is done is kept in {out}, the same command resumes", soft_wrap=True)
        raise
    finally:
        done = [job for job in jobs if _minds.is_done(job.folder, job.life)]
        if done:
            text, written = _minds.write(out, done)
            if not quiet:
                print(f"{text}\nwritten: {', '.join(map(str, written))}")
    if failed:
        raise EcologyError(f"{len(failed)} of {len(jobs)} seeds were not measured. {' '.join(failed)}")


def _certify(cases: Sequence[Any], out: Path, quiet: bool) -> None:
    """Do the parts of cases that are not done, and write and print their rows."""
    from ecology.lab.certificate import case as _reproduce

    ledger, console = _reproduce.Ledger(out), Console(stderr=True, quiet=quiet)
    work = [(case, part) for case in cases for part in _reproduce.left(case, ledger)]
    for case in cases:
        seconds = sum(part.seconds for mine, part in work if mine is case)
        console.print(
            f"{case.name}: {case.about}; {_long(seconds) if seconds else 'done'}", highlight=False, soft_wrap=True
        )
        for note in case.notes:
            console.print(f"  {note}", highlight=False, soft_wrap=True)
    left = sum(part.seconds for _, part in work)
    for i, (case, part) in enumerate(work, 1):
        console.print(
            f"{i} of {len(work)}  {case.name} {part.key}  {_long(left)} left", highlight=False, soft_wrap=True
        )
        try:
            ledger.do(case, part)
        except (KeyboardInterrupt, StoppedError):
            console.print(f"stopped; what is done is kept in {out}, the same command goes on", soft_wrap=True)
            raise StoppedError(signal.SIGINT) from None
        left -= part.seconds
    found = {case.name: _reproduce.rows(case, ledger) for case in cases}
    tables = {case.name: text for case in cases if (text := _reproduce.table(case, ledger)) is not None}
    written = _reproduce.write(out, found, tables)
    if not quiet:
        table = Table(*_reproduce.HEAD)
        for name, rows in found.items():
            for row in rows:
                table.add_row(*_reproduce.cells(name, row))
            table.add_section()
        screen = Console()
        screen.print(table, width=screen.width if screen.is_terminal else WIDE)
        print(f"written: {', '.join(map(str, written))}")


def _long(seconds: float) -> str:
    """Return how long something takes, in words."""
    return f"about {seconds / 60:.0f} min" if seconds >= 90 else f"about {max(seconds, 1):.0f} s"


@app.command()
def view(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or a recording.")],
    focus: Annotated[
        str | None, typer.Option(metavar="WHO", help="An agent (prey_17) whose life is drawn, or a species.")
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Show it in a browser, where a click brings an agent into focus.")
    ] = False,
    port: Annotated[
        int | None,
        typer.Option(min=1, max=65535, help="Port of the page for --serve.", show_default="9090, or one that is free"),
    ] = None,
    screenshot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Save a picture instead; needs no screen.")
    ] = None,
    tick: Annotated[int | None, typer.Option(min=0, help="Of the picture.", show_default="the last")] = None,
) -> None:
    """Open the recording of a run in the Rerun viewer, or save what it shows (the README's pictures)."""
    if tick is not None and screenshot is None:
        raise EcologyError("--tick is of a picture; give --screenshot FILE.png too, or leave it out.")
    _check_port(port, serve=serve)
    if serve and screenshot is not None:
        raise EcologyError("--serve and --screenshot are two ways to look; give one of them.")
    from ecology.observers import viewer  # only here is a viewer looked for

    with contextlib.ExitStack() as stack:
        if focus is not None or serve:
            from ecology.observers.hindsight import Hindsight  # slow to load

            if not (run / _run.CONFIG).is_file():
                raise EcologyError(
                    f"--focus and --serve need the world of a run: there is no {_run.CONFIG} in {str(run)!r}; give "
                    "the folder of the run."
                )
            world = resolve(config=read_config(run / _run.CONFIG)).load()
            past = Hindsight(stack.enter_context(viewer.complete(run)), world, run.absolute().name)
            run = past.shown(focus, Path(stack.enter_context(tempfile.TemporaryDirectory())) / _run.RECORDING)
        if serve:
            from ecology.observers.page import Page

            page = Page([run.name], past.hear, files={run.name: run}, dt=world.dt, port=_web_port(port))
            stack.callback(page.close)
            print(f"look in a browser: {page.url}\nstop with Ctrl-C", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                _wait()
        elif screenshot is not None:
            from ecology.observers import screenshot as pictures  # slow to load

            pictures.screenshot(run, screenshot, tick=tick)
            print(f"written: {screenshot}")
        else:
            viewer.view(run)


def _wait() -> None:
    """Wait for Ctrl-C, or to be ended."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    threading.Event().wait()


@app.command()
def film(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run that recorded.")],
    target: Annotated[
        Path | None, typer.Argument(metavar="[OUT.gif|OUT.mp4]", help="A new file.", show_default="RUN/film.gif")
    ] = None,
    from_: Annotated[
        int | None, typer.Option("--from", min=0, metavar="TICK", show_default="200 frames before the end")
    ] = None,
    to: Annotated[int | None, typer.Option(min=0, metavar="TICK", show_default="the last")] = None,
    fps: Annotated[float, typer.Option(help="Frames per second, one recorded tick each.")] = 20.0,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Make a film of a stretch of a run from what it recorded: a gif, or an mp4 with the extra `film`."""
    from ecology.observers import film as films
    from ecology.observers import readback  # slow to load

    target = run / "film.gif" if target is None else target
    scenario = resolve(config=read_config(run / _run.CONFIG)).load()
    films.check(target, fps)
    frames = readback.frames(run, scenario, from_, to)
    console = Console(stderr=True, quiet=quiet)
    with console.status("drawing") as status:

        def tell(i: int) -> None:
            status.update(f"drawing tick {frames[i].tick}")

        films.film(scenario, frames, target, fps=fps, tell=tell)
    if not quiet:
        print(f"written: {target}, ticks {frames[0].tick} to {frames[-1].tick}, {len(frames)} frames")
