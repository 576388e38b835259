"""`ecology new`: begin a scenario of your own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ecology.errors import EcologyError

ORDER = 2


def command(name: Annotated[str, typer.Argument(help="A Python word; NAME.py is written.")]) -> None:
    """Write a small scenario file, to be changed and run."""
    from ecology import scenarios

    name = name.removesuffix(".py")
    if not name.isidentifier():
        raise EcologyError(f"the name of a scenario is a Python word (letters, digits and _), got {name!r}.")
    path = Path(f"{name}.py")
    text = (scenarios.HERE / "_template.py").read_text(encoding="utf-8").replace("NAME", name)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise EcologyError(f"the file {str(path)!r} exists; choose another name.") from error
    except OSError as error:
        raise EcologyError(f"the file {str(path)!r} cannot be written: {error.strerror}.") from error
    print(f"{path} is written. Run it with: ecology run {path}")
