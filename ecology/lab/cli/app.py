"""The application: every file in commands/ is a command."""

from __future__ import annotations

import importlib
import pkgutil
from typing import Annotated

import typer

import ecology
from ecology.lab.cli import commands

app = typer.Typer(
    name="ecology",
    help="An ecology sandbox: self-regulated agents that learn their bodies and their world.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"ecology {ecology.__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """An ecology sandbox: self-regulated agents that learn their bodies and their world."""


def add_commands() -> None:
    """Add the commands, in their order."""
    found = [
        importlib.import_module(f"{commands.__name__}.{each.name}") for each in pkgutil.iter_modules(commands.__path__)
    ]
    for module in sorted(found, key=lambda module: module.ORDER):
        name = module.__name__.rpartition(".")[2]
        app.command(name, cls=getattr(module, "CLASS", None))(module.command)


add_commands()
