"""`ecology focus`: bring another agent into focus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ecology.errors import EcologyError

ORDER = 5


def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run that is alive.")],
    who: Annotated[str, typer.Argument(metavar="WHO", help="An agent (prey_17), a species, or hungriest.")],
) -> None:
    """Bring someone else into focus in a run that is recorded or watched."""
    from ecology.lab.runs.folder import CONFIG, is_locked
    from ecology.observers import wishes

    if not (run / CONFIG).is_file():
        raise EcologyError(f"the folder {str(run)!r} holds no run: there is no {CONFIG} in it.")
    print(wishes.ask(run, who, lambda: is_locked(run)))
