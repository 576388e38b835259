"""`ecology archipelago`: run worlds side by side that exchange agents."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ecology.errors import EcologyError
from ecology.lab.cli.options import (
    NAME_OR_PATH,
    Quiet,
    Ray,
    Source,
    Trust,
    announces_compiling,
    format_number,
    read_pairs,
    read_setting,
    refuse_with,
    say,
    takes_options,
)

if TYPE_CHECKING:
    from ecology.lab.islands.hosts import Handle
    from ecology.lab.islands.run import ArchipelagoRun

ORDER = 5
LINE = 10.0  # seconds between two lines of progress


@dataclass(frozen=True)
class ArchipelagoOptions:
    """What `ecology archipelago` is given."""

    archipelago: Annotated[str | None, typer.Argument(metavar="ARCHIPELAGO", help=NAME_OR_PATH)] = None
    ticks: Annotated[int | None, typer.Option(min=1, help="Length of the run.", show_default="the archipelago's")] = (
        None
    )
    seed: Annotated[int | None, typer.Option(min=0, help="Random seed.", show_default="0")] = None
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Setting of the archipelago to change.")
    ] = None
    out: Annotated[Path | None, typer.Option(help="Folder of the run.", show_default="runs/NAME-SEED")] = None
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes or actors that run the islands.", show_default="one per CPU")
    ] = None
    ray: Ray = None
    device: Annotated[
        str | None, typer.Option(metavar="cpu|cuda", help="Device that learners compute on.", show_default="cpu")
    ] = None
    gpus: Annotated[
        float | None,
        typer.Option(
            "--gpus-per-worker",
            min=0.0,
            help="GPUs that each Ray actor reserves.",
            show_default="1 with --device cuda",
        ),
    ] = None
    memory: Annotated[
        float | None,
        typer.Option("--memory-per-worker", min=0.0, metavar="GIB", help="Memory that each Ray actor reserves."),
    ] = None
    snapshot_every: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Ticks between two common snapshots.", show_default="10000"),
    ] = None
    keep_every: Annotated[
        int | None,
        typer.Option(
            min=0, metavar="N", help="Keep a common snapshot every N ticks, to fork from.", show_default="none"
        ),
    ] = None
    record_every: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Ticks between two samples of an island.", show_default="10")
    ] = None
    no_record: Annotated[bool, typer.Option("--no-record", help="Write neither metrics nor recordings.")] = False
    resume: Annotated[Path | None, typer.Option(help="Folder of a run to resume.")] = None
    fork: Annotated[Path | None, typer.Option(help="Folder of a run to fork; needs --at.")] = None
    at: Annotated[
        int | None, typer.Option(min=0, metavar="TICK", help="With --fork: tick of the common snapshot to fork from.")
    ] = None
    source: Source = None
    trust: Trust = False
    quiet: Quiet = False


@takes_options
@announces_compiling
def command(options: ArchipelagoOptions) -> None:
    """Run an archipelago: islands side by side that exchange agents, with one recording per island and one of all."""
    from ecology.lab.runs.folder import lock
    from ecology.lab.runs.stopping import StoppedError

    _check(options)
    quiet = options.quiet
    with contextlib.ExitStack() as stack:
        if options.resume is not None:
            stack.enter_context(lock(options.resume))
        run = _open(options)
        make, count = _hosts(run, options.ray, options.gpus, options.memory)
        if options.resume is None:
            run.folder.mkdir(parents=True, exist_ok=True)
            stack.enter_context(lock(run.folder))
        try:
            summary = run.live(make, options.workers or count, _progress(quiet))
        except StoppedError as stopped:
            if not quiet:
                print(f"stopped by {stopped} at tick {run.now}; resume with: ecology archipelago --resume {run.folder}")
            raise
    if not quiet:
        _print(run, summary)


def _check(options: ArchipelagoOptions) -> None:
    """Raise EcologyError for options that do not go together."""
    kept = options.resume or options.fork
    if kept is not None:
        refuse_with(
            "--resume" if options.resume is not None else "--fork",
            ARCHIPELAGO=options.archipelago, seed=options.seed, device=options.device,
            record_every=options.record_every, snapshot_every=options.snapshot_every, keep_every=options.keep_every,
            no_record=options.no_record or None,
        )  # fmt: skip
    if options.resume is not None:
        refuse_with("--resume", set=options.set_, out=options.out, fork=options.fork)
    if (options.fork is None) != (options.at is None):
        raise EcologyError("--fork RUN and --at TICK go together; give both.")
    if kept is None and options.archipelago is None:
        raise EcologyError("name an archipelago to run, or give --resume RUN or --fork RUN.")


def _open(options: ArchipelagoOptions) -> ArchipelagoRun:
    """Return the run that the options name: resumed, forked or new."""
    from ecology.lab.islands import run as islands
    from ecology.lab.runs.gate import Gate

    changes = read_pairs("--set", options.set_, read_setting)
    gate = Gate(options.source, options.trust, say(options.quiet))
    if options.resume is not None:
        return islands.resume(options.resume, options.ticks, gate)
    if options.fork is not None:
        return islands.fork(options.fork, options.at or 0, changes, options.out, options.ticks, gate)
    return islands.start(
        str(options.archipelago), changes, options.out, ticks=options.ticks, seed=options.seed,
        device=options.device, keep_every=options.keep_every, snapshot_every=options.snapshot_every,
        record_every=options.record_every, record=False if options.no_record else None,
    )  # fmt: skip


def _hosts(
    run: ArchipelagoRun, ray: str | None, gpus: float | None, memory: float | None
) -> tuple[Callable[[Path], Handle], int]:
    """Return a function that starts a host, and the number of hosts to start."""
    from ecology.lab.islands.hosts import ProcessHost, RayHost
    from ecology.lab.runs import cluster
    from ecology.machine import count_cpus

    if ray is None:
        for option, value in (("--gpus-per-worker", gpus), ("--memory-per-worker", memory)):
            if value is not None:
                raise EcologyError(f"{option} requires --ray; give --ray local to share out this machine, or drop it.")
        return ProcessHost, count_cpus()
    share = cluster.gpus_per_run(ray, run.voyage.device, gpus, memory, per="worker")
    joined = cluster.join(ray)
    nodes = cluster.capacity(joined, {"CPU": 1.0, "GPU": share, "memory": (memory or 0.0) * 2**30})
    return lambda folder: RayHost(joined, folder.absolute(), gpus=share, memory=memory or 0.0), max(1, nodes)


def _progress(quiet: bool) -> Callable[[str], None]:
    """Return a function that prints the progress of the islands, at most once every LINE seconds."""
    then = [time.monotonic() + LINE]

    def tell(words: str) -> None:
        if not quiet and time.monotonic() >= then[0]:
            then[0] = time.monotonic() + LINE
            with contextlib.suppress(OSError):
                print(words, file=sys.stderr, flush=True)

    return tell


def _print(run: ArchipelagoRun, summary: dict[str, Any]) -> None:
    """Print a summary of the archipelago's run."""
    passed = f"{summary['migrated']:,} migrated, {summary['refused']:,} found no room"
    if run.voyage.world.pool is not None:
        passed = f"{summary['generations']:,} generations" + (f"; {passed}" if run.voyage.world.migrations else "")
    print(
        f"{summary['ticks']:,} ticks on {len(summary['islands'])} islands in {summary['wall_seconds']:,.1f} s, "
        f"{summary['agent_steps_per_second']:,.0f} agent-steps per second, {summary['exchange_share']:.1%} of the time "
        f"in exchanges; {passed}"
    )
    for i, island in enumerate(summary["islands"]):
        if i == 8:
            print(f"... and {len(summary['islands']) - i} more, see {run.folder / 'summary.json'}")
            break
        alive = ", ".join(f"{of['end']} {name}" for name, of in island["population"].items())
        print(f"island {i}: {alive}; mean drive {format_number(island['mean_drive'])}")
    if run.voyage.record:
        print(f"next: ecology view {run.folder}   or   ecology view {run.voyage.folder_of(run.folder, 0)}")
