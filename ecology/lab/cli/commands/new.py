"""`ecology new`: start a scenario of your own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
import typer.core
from rich.markup import escape

from ecology.errors import EcologyError
from ecology.lab.cli import parts

ORDER = 2


class HelpWithComponents(typer.core.TyperCommand):
    """Lists the components of `--with` below the help."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help, and below it the components."""
        self.epilog = "\n\n".join(["The components:", *map(escape, parts.listing())])
        super().format_help(ctx, formatter)


CLASS = HelpWithComponents


def command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A Python identifier; NAME.py is written.")],
    with_: Annotated[
        list[str] | None,
        typer.Option("--with", metavar="COMPONENT", help="Component to add, listed below; can be repeated."),
    ] = None,
) -> None:
    """Write a small scenario file to start from."""
    from ecology import scenarios

    name = name.removesuffix(".py")
    if not name.isidentifier():
        raise EcologyError(f"the name of a scenario is a Python word (letters, digits and _), got {name!r}.")
    found = parts.choose_parts(with_ or ())
    path = Path(f"{name}.py")
    text = (scenarios.HERE / "_template.py").read_text(encoding="utf-8")
    text = parts.fill(text, found).replace("NAME", name)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        raise EcologyError(f"the file {str(path)!r} exists; choose another name.") from error
    except OSError as error:
        raise EcologyError(f"the file {str(path)!r} cannot be written: {error.strerror}.") from error
    print(f"{path} is written. Run it with: ecology run {path}")
