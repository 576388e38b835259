"""`ecology focus`: bring another agent into focus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

ORDER = 5


def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run in progress.")],
    who: Annotated[str, typer.Argument(metavar="WHO", help="Agent (prey_17), species, or hungriest.")],
) -> None:
    """Bring another agent into focus in a run that records or is watched."""
    from ecology.lab.runs.folder import check_run, is_locked
    from ecology.observers import focus_requests

    check_run(run)
    print(focus_requests.request_focus(run, who, lambda: is_locked(run)))
