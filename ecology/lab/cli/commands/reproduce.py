"""`ecology reproduce`: reproduce published results and compare them."""

from __future__ import annotations

import signal
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from ecology.errors import EcologyError, check_writable
from ecology.lab.cli.options import Quiet, announces_compiling, read_pairs, read_setting
from ecology.lab.runs.stopping import StoppedError
from ecology.machine import count_cpus

ORDER = 10
WIDE = 180  # characters of the certificate where there is no terminal


class HelpWithCases(typer.core.TyperCommand):
    """Tells the names of the results below its help: they are slow to load, and no other command waits for them."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help, and below it the names."""
        from ecology.lab.certificate.cases import all_cases

        lines = [f"{case.name}: {case.about}" for case in all_cases().values()]
        self.epilog = "\n\n".join(["The cases, by NAME:", *map(escape, lines)])
        super().format_help(ctx, formatter)


CLASS = HelpWithCases


@announces_compiling
def command(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Cases to reproduce, listed below.", show_default="all"),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder of the results; finished parts in it are not repeated.")] = Path(
        "runs/reproduce"
    ),
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
    quiet: Quiet = False,
) -> None:
    """Reproduce published results and compare them with ours (95 % interval) and with the closed form."""
    from ecology.lab.certificate.cases import choose_cases

    cases = choose_cases(names or ())
    minds = bool(names) and "minds" in [case.name for case in cases]
    for option, value in (("seeds", seeds), ("ticks", ticks), ("life", life), ("set", set_), ("workers", workers)):
        if value and not minds:
            raise EcologyError(f"--{option} is an option of `ecology reproduce minds`; name minds, or drop --{option}.")
    check_writable(out)  # what cannot be kept is told before the long part
    others = [case for case in cases if not (minds and case.name == "minds")]
    if minds:
        _measure_minds(
            out, seeds or "0:32", ticks, life, read_pairs("--set", set_, read_setting), workers or count_cpus(), quiet
        )
    if others:
        _certify(others, out, quiet)


def _measure_minds(
    out: Path, seeds: str, ticks: int | None, life: int | None, settings: Mapping[str, Any], workers: int, quiet: bool
) -> None:
    """Train and measure many seeds of `paper`, each in a process, and print what must hold beside what was found."""
    from ecology.lab.certificate import minds
    from ecology.lab.runs import sweep as sweeps

    jobs = minds.jobs(out, sweeps.seeds_of(seeds), ticks or minds.TRAINED, life or minds.LIFE, settings)
    waiting = [job for job in jobs if not minds.is_done(job.folder, job.life)]
    check_writable(jobs[0].folder)
    console, began, failed = Console(stderr=True, quiet=quiet), time.monotonic(), list[str]()
    left = sum(map(minds.seconds, waiting)) / min(workers, max(len(waiting), 1))
    console.print(
        f"minds: {len(jobs)} seeds, {len(waiting)} of them to measure; {_long(left) if waiting else 'done'}",
        highlight=False,
        soft_wrap=True,
    )
    over = 0

    def tell(result: tuple[minds.Job, str], _: int) -> None:
        nonlocal over
        job, fault = result
        over += 1
        if fault:
            failed.append(f"seed {job.seed}: {fault}")
        text = fault or minds.line(job)
        more = len(waiting) - over
        then = _long((time.monotonic() - began) / over * more) + " left" if more else "done"
        console.print(f"{over} of {len(waiting)}  seed {job.seed}: {text}; {then}", highlight=False, soft_wrap=True)

    try:
        sweeps.schedule(waiting, minds.work, lambda: workers, tell)
    except StoppedError:
        console.print(f"stopped; what is done is kept in {out}, the same command resumes", soft_wrap=True)
        raise
    finally:
        done = [job for job in jobs if minds.is_done(job.folder, job.life)]
        if done:
            text, written = minds.write(out, done)
            if not quiet:
                print(f"{text}\nwritten: {', '.join(map(str, written))}")
    if failed:
        raise EcologyError(f"{len(failed)} of {len(jobs)} seeds were not measured. {' '.join(failed)}")


def _certify(cases: Sequence[Any], out: Path, quiet: bool) -> None:
    """Run the unfinished parts of cases, and write and print their rows."""
    from ecology.lab.certificate import part_store as ledgers
    from ecology.lab.certificate import reference, report

    ledger, console = ledgers.PartStore(out), Console(stderr=True, quiet=quiet)
    work = [(case, part) for case in cases for part in ledgers.unfinished_parts(case, ledger)]
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
            console.print(f"stopped; what is done is kept in {out}, the same command resumes", soft_wrap=True)
            raise StoppedError(signal.SIGINT) from None
        left -= part.seconds
    done = {case.name: ledgers.values(case, ledger) for case in cases}
    found = {case.name: case.rows(done[case.name]) for case in cases}
    tables = {case.name: case.table(done[case.name]) for case in cases if case.table is not None}
    written = report.write(out, found, tables)
    for case in cases:
        written += report.draw_case(out, case, done[case.name])
    if not quiet:
        table = Table(*report.HEAD)
        for name, rows in found.items():
            for row in rows:
                table.add_row(*report.cells(name, row))
            table.add_section()
        screen = Console()
        screen.print(table, width=screen.width if screen.is_terminal else WIDE)
        print(reference.line())
        print(f"written: {', '.join(map(str, written))}")


def _long(seconds: float) -> str:
    """Return how long something takes, in words."""
    return f"about {seconds / 60:.0f} min" if seconds >= 90 else f"about {max(seconds, 1):.0f} s"
