"""`ecology sweep`: run a scenario many times."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from ecology.errors import EcologyError, writable
from ecology.lab.cli.options import (
    NAME_OR_PATH,
    Device,
    Quiet,
    Ray,
    Source,
    Trust,
    announces_compiling,
    format_number,
    read_pairs,
    takes_options,
)
from ecology.lab.runs.stopping import StoppedError
from ecology.machine import count_cpus

if TYPE_CHECKING:
    from ecology.lab.runs.sweep import Attempt, Cell, Outcome

ORDER = 7


@dataclass(frozen=True)
class SweepOptions:
    """What `ecology sweep` is given."""

    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help=NAME_OR_PATH)]
    seeds: Annotated[
        str, typer.Option(metavar="FIRST:END", help="Seeds to run, END excluded; lists such as 1,4,9:12 work too.")
    ] = "0:8"
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE,...",
            help="Values of a setting to sweep: KEY, learner.KEY or SPECIES.learner.KEY.",
        ),
    ] = None
    learner: Annotated[
        list[str] | None,
        typer.Option(metavar="[SPECIES=]NAME,...", help="Learners to sweep, of all species or of one."),
    ] = None
    ticks: Annotated[int | None, typer.Option(min=1, help="Length of each run.", show_default="the scenario's")] = None
    out: Annotated[Path | None, typer.Option(help="Folder of the sweep.", show_default="runs/sweep-SCENARIO")] = None
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of runs at a time.", show_default="one per CPU")
    ] = None
    ray: Ray = None
    slurm: Annotated[
        str | None,
        typer.Option(
            metavar="PARTITION",
            help="Run as jobs of a Slurm partition; `default` takes the cluster's, `local` runs jobs on this machine.",
        ),
    ] = None
    minutes: Annotated[
        int | None,
        typer.Option("--minutes-per-run", min=1, help="Time limit of a Slurm job.", show_default="the partition's"),
    ] = None
    device: Device = None
    gpus: Annotated[
        float | None,
        typer.Option(
            "--gpus-per-run",
            min=0.0,
            help="GPUs that each run reserves on Ray or Slurm.",
            show_default="1 with --device cuda",
        ),
    ] = None
    memory: Annotated[
        float | None,
        typer.Option("--memory-per-run", min=0.0, metavar="GIB", help="Memory that each run reserves on Ray or Slurm."),
    ] = None
    record: Annotated[bool, typer.Option("--record", help="Write metrics and a recording of every run.")] = False
    evaluate: Annotated[
        bool, typer.Option("--evaluate", help="Evaluate what each run has learned, as `ecology evaluate` does.")
    ] = False
    show: Annotated[
        list[str] | None,
        typer.Option(metavar="COLUMN", help="Column of sweep.parquet to print and draw.", show_default="the drive"),
    ] = None
    source: Source = None
    trust: Trust = False
    quiet: Quiet = False


@takes_options
@announces_compiling
def command(options: SweepOptions) -> None:
    """Run many seeds and settings; write one table and one figure. Run the same command again to resume."""
    from ecology.lab.runs import cluster
    from ecology.lab.runs import sweep as sweeps

    if options.ray is not None and options.slurm is not None:
        raise EcologyError("--ray and --slurm are two ways to run a sweep elsewhere; give one of them.")
    if options.minutes is not None and options.slurm is None:
        raise EcologyError("--minutes-per-run requires --slurm.")
    settings: dict[str, list[Any]] = read_pairs("--set", options.set_, sweeps.values_of, several=True)
    out = (options.out or Path("runs") / f"sweep-{Path(options.scenario).stem}").absolute()
    cells = sweeps.cells_of(
        options.scenario, out, seeds=sweeps.seeds_of(options.seeds), settings=settings,
        learners=options.learner or (), evaluate=options.evaluate, ticks=options.ticks, record=options.record,
        device=options.device, source=options.source, trust=options.trust,
    )  # fmt: skip
    elsewhere = options.ray or options.slurm
    gpus = cluster.gpus_per_run(elsewhere, options.device, options.gpus, options.memory)
    _check(cells, out, options.show or (), elsewhere=elsewhere is not None)
    outcomes = [sweeps.Outcome(cell, sweeps.finished_summary(cell)) for cell in cells]
    waiting = [outcome.cell for outcome in outcomes if outcome.summary is None]
    outcomes = [outcome for outcome in outcomes if outcome.summary is not None]
    attempt, count = _workers(options, out, gpus) if waiting else (sweeps.by_process, count_cpus)
    with writable(out):
        out.mkdir(parents=True, exist_ok=True)
    sweep = Sweep(cells, outcomes, out, Path(options.scenario).stem, options.show or ())
    _live(sweep, waiting, attempt, count if options.workers is None else lambda: options.workers or 1, options.quiet)
    failed = [outcome for outcome in outcomes if outcome.summary is None]
    for outcome in failed:
        print(f"ecology: the run {outcome.cell.folder} failed: {outcome.failed}", file=sys.stderr)
    if failed:
        raise typer.Exit(max(outcome.code for outcome in failed))


def _workers(options: SweepOptions, out: Path, gpus: float) -> tuple[Attempt, Callable[[], int]]:
    """Return how a run is attempted, here or elsewhere, and the number of runs at a time."""
    from ecology.lab.runs import cluster, slurm
    from ecology.lab.runs import sweep as sweeps

    memory = options.memory or 0.0
    if options.ray is not None:
        return cluster.by_ray(options.ray, gpus=gpus, memory=memory)
    if options.slurm is not None:
        return slurm.by_slurm(options.slurm, out, gpus=gpus, memory=memory, minutes=options.minutes)
    return sweeps.by_process, count_cpus


@dataclass(frozen=True)
class Sweep:
    """A sweep under way."""

    cells: Sequence[Cell]
    outcomes: list[Outcome]  # of the cells that are over; grows
    out: Path
    title: str
    show: Sequence[str]  # columns


def _check(cells: Sequence[Cell], out: Path, show: Sequence[str], *, elsewhere: bool) -> None:
    """Raise EcologyError where the sweep cannot start: what no run can start with is reported once."""
    from ecology.lab.runs import sweep as sweeps
    from ecology.lab.runs.run import Run

    for cell in cells:
        sweeps.check_cell(cell)
    sweeps.check_folder(out, cells)

    def built(cell: Cell) -> Run:
        plan = dataclasses.replace(cell.plan, device="cpu") if elsewhere else cell.plan  # the device is elsewhere
        return Run(plan, cell.folder)

    first = built(cells[0])
    sweeps.check_shown(show, cells, lambda cell: (first if cell is cells[0] else built(cell)).summary())


def _live(sweep: Sweep, waiting: Sequence[Cell], attempt: Attempt, workers: Callable[[], int], quiet: bool) -> None:
    """Run the cells that are waiting, add their results to the outcomes, and sum up all cells."""
    from ecology.lab.cli.progress import runs_bar
    from ecology.lab.runs import sweep as sweeps
    from ecology.lab.runs.folder import lock

    cells, outcomes, out, show = sweep.cells, sweep.outcomes, sweep.out, sweep.show
    console = Console(stderr=True, quiet=quiet)
    with contextlib.ExitStack() as stack:
        stack.enter_context(lock(out))
        bar = stack.enter_context(contextlib.ExitStack())
        advance = bar.enter_context(runs_bar(console, len(cells), len(outcomes)))

        def tell(outcome: Outcome, running: int) -> None:
            outcomes.append(outcome)
            said = outcome.failed
            if outcome.summary is not None:
                row = sweeps.rows_of([outcome])[0]
                columns = sweeps.columns_of([outcome], show)
                said = ", ".join(f"{sweeps.label(column)} {format_number(row.get(column))}" for column in columns)
            console.print(f"{outcome.cell.name}: {said}", highlight=False)
            advance(f"{running} under way")

        try:
            sweeps.live(waiting, attempt, workers, tell)
        except StoppedError as stopped:
            if not quiet:
                print(f"stopped by {stopped}; the same command resumes")
            raise
        finally:
            bar.close()  # before the table
            done = [outcome for outcome in outcomes if outcome.summary is not None]
            left = [
                sweeps.Outcome(cell, sweeps.ended_summary(cell))
                for cell in cells
                if sweeps.finished_summary(cell) is None
            ]
            unmeasured = [outcome for outcome in left if outcome.summary is not None]  # they keep their rows
            columns = sweeps.columns_of(done, show)
            with writable(out):
                written = sweeps.sum_up(out, [*done, *unmeasured], sweep.title, columns)
            if not quiet:
                _say_sweep({sweeps.label(column): sweeps.points(done, column) for column in columns})
                print(
                    f"{len(done)} of {len(cells)} runs are whole. Written: {', '.join(map(str, written)) or 'nothing'}"
                )


def _say_sweep(found: Mapping[str, Sequence[Any]]) -> None:
    """Print the means of a sweep, a table for every name in `found`."""
    for name, points in found.items():
        if points:
            table = Table(*(axis.removeprefix("set.") for axis in points[0].varied), "runs", name, "95 % interval")
            for point in points:
                interval = f"{point.low:.3f} to {point.high:.3f}" if point.runs > 1 else "-"
                words = map(str, (*point.varied.values(), point.runs))
                table.add_row(*words, format_number(point.mean), interval)
            Console().print(table)
