"""`ecology bench`: measure the speed of the world."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from ecology.errors import EcologyError, check_writable
from ecology.lab.cli.options import Quiet, announces_compiling, takes_options

ORDER = 8


@dataclass(frozen=True)
class BenchOptions:
    """What `ecology bench` is given."""

    agents_: Annotated[str, typer.Option("--agents", metavar="N,...", help="Numbers of agents to measure.")] = (
        "1,10,100,1000,10000"
    )
    learner: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Learner to measure; NAME-dicts learns through the PettingZoo dicts, `none` measures no learner.",
            show_default="lean and algorithm1",
        ),
    ] = None
    against: Annotated[
        str,
        typer.Option(
            metavar="WORLD,...", help="Worlds to compare with: waterworld, waterworld_few, mpe2, magent2, vmas."
        ),
    ] = ""
    python: Annotated[
        list[str] | None,
        typer.Option(metavar="WORLD=PATH", help="Python interpreter in which another world is installed."),
    ] = None
    rounds: Annotated[int, typer.Option(min=1, help="Number of times that each point is timed.")] = 7
    seconds: Annotated[float, typer.Option(min=0.0, help="Seconds that each timing takes.")] = 0.5
    core: Annotated[
        int | None, typer.Option(min=0, help="CPU core on which all measurements run.", show_default="the last")
    ] = None
    out: Annotated[Path, typer.Option(help="Folder of the table and the figure.")] = Path("runs") / "bench"
    quiet: Quiet = False


@takes_options
@announces_compiling
def command(options: BenchOptions) -> None:
    """Measure agent-steps per second against the number of agents, beside other worlds; write a table and a figure."""

    from ecology.lab.bench import speed as bench

    try:
        counts = sorted({int(word) for word in options.agents_.split(",")})
    except ValueError:
        counts = []
    if not counts or counts[0] < 1:
        raise EcologyError(f"--agents takes whole numbers of at least 1, as 1,10,100, got {options.agents_!r}.")
    pythons = dict(word.partition("=")[::2] for word in options.python or ())
    others = [word.strip() for word in options.against.split(",") if word.strip()]
    for name in pythons:
        if name not in others:
            raise EcologyError(f"--python {name} is none of the worlds to compare with; name it in --against too.")
    learners = [name for name in (options.learner or bench.LEARNERS) if name != "none"]
    out, quiet = options.out, options.quiet
    if (out / bench.TABLE).exists():
        raise EcologyError(f"the folder {str(out)!r} holds a benchmark; give another with --out.")
    check_writable(out)  # fail before the long part
    console = Console(stderr=True, quiet=quiet)
    with bench.pin_to_core(options.core) as pinned, console.status("") as status:
        wanted = bench.points(counts, learners, {name: pythons.get(name, sys.executable) for name in others})
        rows, used = bench.measure(wanted, rounds=options.rounds, seconds=options.seconds, tell=status.update)
    written = bench.write(out, rows, used)
    if not quiet:
        table = Table("", "agents", "agent-steps per second", "quartiles")
        for speed in bench.speeds(rows):
            table.add_row(
                speed.name, f"{speed.agents:,}", f"{speed.median:,.0f}", f"{speed.low:,.0f} to {speed.high:,.0f}"
            )
        Console().print(table)
        taken = sorted(row["calibration_seconds"] * 1e3 for row in rows)
        where = "not pinned" if pinned is None else f"core {pinned}"
        print(f"{where}; the calibration loop took {taken[0]:.1f} to {taken[-1]:.1f} ms between measurements")
        print(", ".join(bench.name_with_version(name, version) for name, version in used.items()))
        print(f"written: {', '.join(map(str, written))}")
