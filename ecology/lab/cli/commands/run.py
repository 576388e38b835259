"""`ecology run`: run a scenario."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ecology.errors import EcologyError, nearest
from ecology.lab.cli.options import (
    NAME_OR_PATH,
    RECORD,
    Device,
    Port,
    Quiet,
    Source,
    Trust,
    announces_compiling,
    check_port,
    read_pairs,
    read_setting,
    refuse_with,
    say,
    takes_options,
)

if TYPE_CHECKING:
    from ecology.lab.runs.run import Run

ORDER = 4


@dataclass(frozen=True)
class RunOptions:
    """What `ecology run` is given."""

    scenario: Annotated[str | None, typer.Argument(metavar="SCENARIO", help=NAME_OR_PATH)] = None
    ticks: Annotated[int | None, typer.Option(min=1, help="Length of the run.", show_default="the scenario's")] = None
    seed: Annotated[int | None, typer.Option(min=0, help="Random seed.", show_default="0")] = None
    learner: Annotated[
        list[str] | None, typer.Option(metavar="[SPECIES=]NAME", help="Learner of all species, or of one.")
    ] = None
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="Setting to change: KEY, learner.KEY or SPECIES.learner.KEY."),
    ] = None
    out: Annotated[Path | None, typer.Option(help="Folder of the run.", show_default="runs/SCENARIO-SEED")] = None
    config: Annotated[Path | None, typer.Option(help="config.toml of a run to repeat.")] = None
    replay: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="interventions.jsonl of another run, whose interventions are repeated."),
    ] = None
    resume: Annotated[Path | None, typer.Option(help="Folder of a run to resume.")] = None
    previous: Annotated[
        bool, typer.Option("--previous", help="With --resume: resume from the checkpoint before the last.")
    ] = False
    source: Source = None
    trust: Trust = False
    view: Annotated[bool, typer.Option("--view", help="Open the Rerun viewer on the run.")] = False
    serve: Annotated[bool, typer.Option("--serve", help="Show the run in a browser, and let viewers attach.")] = False
    port: Port = None
    paused: Annotated[bool, typer.Option("--paused", help="With --serve: start paused, before the first tick.")] = False
    pace: Annotated[
        float | None,
        typer.Option(metavar="N", help="With --serve: ticks per second.", show_default="as fast as possible"),
    ] = None
    no_wait: Annotated[
        bool, typer.Option("--no-wait", help="With --serve: do not wait for pages that fall behind.")
    ] = False
    connect: Annotated[str | None, typer.Option(metavar="URL", help="Address of an open viewer to stream to.")] = None
    focus: Annotated[
        list[str] | None,
        typer.Option(metavar="WHO", help="Agent to watch closely: its name (prey_17), a species, or hungriest."),
    ] = None
    record: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Sampling of metrics and recording: every=TICKS, detail=full or lean."),
    ] = None
    no_record: Annotated[bool, typer.Option("--no-record", help="Write neither metrics nor a recording.")] = False
    keep_every: Annotated[
        int | None,
        typer.Option(min=0, metavar="N", help="Keep a checkpoint every N ticks, to fork from.", show_default="none"),
    ] = None
    device: Device = None
    quiet: Quiet = False


@takes_options
@announces_compiling
def command(options: RunOptions) -> None:
    """Run a scenario and write one folder: config, summary, metrics, recording, checkpoint."""
    _check(options)
    from ecology.lab.cli.live import Watching, make_observers, run_and_report
    from ecology.lab.runs.folder import lock

    resume, quiet = options.resume, options.quiet
    with contextlib.ExitStack() as stack:
        if resume is not None:
            stack.enter_context(lock(resume))
            run = _reopen(resume, options)
        else:
            run = _new_run(options)
        if options.replay is not None:
            run.schedule.read(options.replay)
        watching = Watching(
            view=options.view, serve=options.serve, port=options.port, connect=options.connect,
            focus=options.focus or (), paused=options.paused, pace=options.pace, patient=not options.no_wait,
        )  # fmt: skip
        observers = make_observers(run, watching, resume=resume is not None)
        if resume is None:
            run.start()
            stack.enter_context(lock(run.folder))
        run_and_report(run, observers, quiet=quiet)


def _check(options: RunOptions) -> None:
    """Raise EcologyError for options that do not go together."""
    new = options.resume is None
    if not new:
        refuse_with(
            "--resume", SCENARIO=options.scenario, seed=options.seed, learner=options.learner, set=options.set_,
            out=options.out, config=options.config, record=options.record, no_record=options.no_record or None,
            keep_every=options.keep_every, replay=options.replay,
        )  # fmt: skip
    elif options.previous:
        raise EcologyError("--previous requires --resume RUN; give that too, or drop --previous.")
    if options.source is not None and new and options.config is None:
        raise EcologyError("--source requires --resume RUN or --config FILE: a new run uses the files as they are.")
    if options.trust and new and options.config is None:
        raise EcologyError("--trust requires --resume RUN or --config FILE: code that you name yourself is run anyway.")
    check_port(options.port, serve=options.serve)
    for option, given in (("paused", options.paused), ("pace", options.pace is not None), ("no-wait", options.no_wait)):
        if given and not options.serve:
            raise EcologyError(f"--{option} requires --serve.")


def _reopen(resume: Path, options: RunOptions) -> Run:
    """Return the run in the folder `resume` as its checkpoint left it."""
    from ecology.lab.runs.run import open_run

    run = open_run(resume, options.ticks, options.device, options.source, trust=options.trust, say=say(options.quiet))
    if run.plan.island:
        raise EcologyError(
            f"{str(resume)!r} is an island of an archipelago, which is resumed as a whole with: "
            f"ecology archipelago --resume {resume.parent.parent}"
        )
    run.resume(previous=options.previous)
    return run


def _new_run(options: RunOptions) -> Run:
    """Return a run that has not begun; EcologyError where its folder is taken."""
    from ecology.lab.runs import source as sources
    from ecology.lab.runs.gate import Gate
    from ecology.lab.runs.run import Run
    from ecology.lab.runs.run_config import read_config, resolve

    gate, config = Gate(options.source, options.trust, say(options.quiet)), options.config
    words = None if config is None else read_config(config)
    if words and "forked" in words:
        raise EcologyError(f"the config {str(config)!r} belongs to a fork; repeat it with `ecology fork`.")
    copies = None if config is None else sources.choose(config.parent, gate.choice)
    plan = resolve(
        options.scenario,
        config=words,
        copies=copies,
        gate=None if config is None else gate,
        changes=read_pairs("--set", options.set_, read_setting),
        learners=options.learner or (),
        ticks=options.ticks,
        seed=options.seed,
        device=options.device,
        keep_every=options.keep_every,
        **_recording_options(options.record or (), no_record=options.no_record),
    )
    run = Run(plan, options.out or Path("runs") / f"{Path(plan.scenario).stem}-{plan.seed}")
    run.check_folder()
    return run


def _recording_options(words: Sequence[str], *, no_record: bool) -> dict[str, Any]:
    """Return what the plan says of recording, from the words of --record and --no-record."""
    found: dict[str, Any] = {"record": True} if words else {"record": False} if no_record else {}
    parts = [part for word in words if word != RECORD for part in word.split(",")]
    for key, value in read_pairs("--record", parts, read_setting).items():
        if key not in ("every", "detail"):
            raise EcologyError(f"--record has no setting {key!r}. {nearest(key, ('every', 'detail'))}")
        if type(value) is not (int if key == "every" else str):
            raise EcologyError(f"--record takes every=TICKS and detail=full or lean, got {key}={value}.")
        found[f"record_{key}"] = value
    return found
