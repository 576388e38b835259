"""`ecology script`: write the interventions of a run as a schedule."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ORDER = 6


def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    out: Annotated[Path | None, typer.Option(metavar="FILE.py", help="File to write.", show_default="printed")] = None,
) -> None:
    """Write the interventions of a run as the schedule of its scenario.

    In the scenario's file, `schedule=SCHEDULE` repeats them in every run: with the same seed the run is the same, bit
    for bit.
    """
    from ecology.errors import EcologyError, writable
    from ecology.lab.runs.folder import check_run
    from ecology.lab.runs.interventions import as_schedule
    from ecology.lab.runs.world_file import read_world

    check_run(run)
    world = read_world(run)
    if world is None:
        raise EcologyError(
            f"the run {str(run)!r} is of an earlier version, without world.json; resume it to write that."
        )
    text = as_schedule(run, world.dt)
    if out is None:
        print(text, end="")
        return
    if out.suffix != ".py" or out.exists():
        raise EcologyError(f"--out takes a new file whose name ends in .py, got {str(out)!r}; give another.")
    with writable(out.parent):
        out.write_text(text, encoding="utf-8")
    print(f"written: {out}")
