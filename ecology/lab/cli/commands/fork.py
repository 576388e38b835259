"""`ecology fork`: continue a run from a tick with a change."""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from ecology.errors import EcologyError
from ecology.lab.cli.options import (
    Quiet,
    Source,
    Trust,
    announces_compiling,
    read_pairs,
    read_setting,
    say,
    takes_options,
)

ORDER = 6


@dataclass(frozen=True)
class ForkOptions:
    """What `ecology fork` is given."""

    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]
    at: Annotated[int, typer.Option(min=0, metavar="TICK", help="Tick at which the fork branches off.")]
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Setting to change; settings that only act at the start have no effect."
        ),
    ] = None
    remove: Annotated[list[str] | None, typer.Option(metavar="AGENT", help="Agent to remove.")] = None
    move: Annotated[list[str] | None, typer.Option(metavar="RESOURCE=x,y", help="Resource to move.")] = None
    do: Annotated[
        list[str] | None, typer.Option(metavar="WHAT", help="Intervention to make in the fork, as in `ecology do`.")
    ] = None
    ticks: Annotated[int | None, typer.Option(min=1, help="Tick to run to.", show_default="as the run")] = None
    out: Annotated[Path | None, typer.Option(help="Folder of the fork.", show_default="RUN-at-TICK")] = None
    record: Annotated[
        bool | None, typer.Option("--record/--no-record", help="Write metrics and a recording, or neither.")
    ] = None
    keep_every: Annotated[int | None, typer.Option(min=0, metavar="N", help="Keep a checkpoint every N ticks.")] = None
    device: Annotated[
        str | None,
        typer.Option(
            metavar="cpu|plain|cuda|cuda:N|mps", help="Device that learners compute on.", show_default="as the run"
        ),
    ] = None
    source: Source = None
    trust: Trust = False
    quiet: Quiet = False


@takes_options
@announces_compiling
def command(options: ForkOptions) -> None:
    """Continue a run from a tick with one thing changed, in a folder of its own."""

    from ecology.lab.cli.live import make_observers, run_and_report
    from ecology.lab.cli.progress import Progress
    from ecology.lab.runs import fork as forks
    from ecology.lab.runs.folder import lock
    from ecology.lab.runs.run import open_run

    run, at, quiet = options.run, options.at, options.quiet
    with contextlib.ExitStack() as stack:
        stack.enter_context(lock(run))
        parent = open_run(run, device=options.device, choice=options.source, trust=options.trust, say=say(quiet))
        change = forks.Change(
            settings=read_pairs("--set", options.set_, read_setting),
            remove=options.remove or (),
            move=read_pairs("--move", options.move, _read_place),
            do=options.do or (),
        )
        forked = forks.fork(
            parent,
            at,
            options.out or run.absolute().with_name(f"{run.absolute().name}-at-{at}"),
            change,
            observers=[] if quiet else [Progress(parent.totals, at)],
            ticks=options.ticks,
            device=options.device,
            record=options.record,
            keep_every=options.keep_every,
        )
        observers = make_observers(forked, resume=False)
        forked.start()
        stack.enter_context(lock(forked.folder))
        run_and_report(forked, observers, quiet=quiet)


def _read_place(text: str) -> tuple[str, tuple[float, float]]:
    """Return resource and place of "RESOURCE=x,y"."""
    name, _, place = text.partition("=")
    try:
        x, y = map(float, place.split(","))
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError
    except ValueError as error:
        raise EcologyError(f"--move takes RESOURCE=x,y, got {text!r}.") from error
    return name.strip(), (x, y)
