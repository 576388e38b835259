"""`ecology do`: intervene in a run in progress."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ORDER = 6


def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run in progress.")],
    what: Annotated[
        list[str],
        typer.Argument(
            metavar="WHAT",
            help="Intervention: move AGENT X Y; move RESOURCE[.N] X Y; refill RESOURCE[.N] [STOCK]; "
            "empty RESOURCE[.N]; put SPECIES X Y; remove AGENT; set AGENT NEED VALUE; shift AGENT NEED SET_POINT; "
            "empathy SPECIES WEIGHT; learning SPECIES on|off; show CUE VALUE; change PATH NUMBER.",
        ),
    ],
) -> None:
    """Intervene in a run in progress, between two of its ticks, and print what was done."""
    from ecology.lab.runs.folder import CONFIG, INTERVENTIONS, check_run, is_locked
    from ecology.observers.mailbox import request
    from ecology.verbs import split

    check_run(run)
    text = " ".join(what)
    split(text)
    print(
        request(
            run,
            "do",
            text,
            lambda: is_locked(run),
            ended=f"to change the past, add a line to {INTERVENTIONS} and repeat the run with "
            f"`ecology run --config {run}/{CONFIG} --replay {INTERVENTIONS}`.",
            silent="a tick takes longer than that; check interventions.jsonl to see whether it was done.",
        )
    )
