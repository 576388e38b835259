"""Options and values that several commands share."""

from __future__ import annotations

import functools
import inspect
import math
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import MISSING, fields
from typing import Annotated, Any, get_type_hints

import typer

from ecology.errors import EcologyError
from ecology.lab.values import read_value

RECORD = "on"  # what a bare --record stands for

NAME_OR_PATH = "Name from `ecology list`, or path of a .py file."  # help of a scenario or an archipelago
Quiet = Annotated[bool, typer.Option("--quiet", help="Print errors only.")]
Port = Annotated[
    int | None,
    typer.Option(min=1, max=65535, help="Port of the page for --serve.", show_default="9090, or one that is free"),
]
Device = Annotated[
    str | None,
    typer.Option(metavar="cpu|plain|cuda|cuda:N|mps", help="Device that learners compute on.", show_default="cpu"),
]

Ray = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Run on the Ray cluster at HOST:PORT; `auto` finds one, `local` starts one."),
]

Source = Annotated[
    str | None,
    typer.Option(
        "--source",
        metavar="kept|current",
        help="If a scenario or learner file of the run has changed or is missing: load the copy kept in RUN/source, or "
        "the file as it is now.",
        show_default="report an error",
    ),
]

Trust = Annotated[
    bool,
    typer.Option("--trust", help="Run the code that the run names, even if you have not run it before. Read it first."),
]


def say(quiet: bool) -> Callable[[str], None] | None:
    """Return a function that reports on stderr whose code is run, None with --quiet."""
    return None if quiet else functools.partial(print, file=sys.stderr, flush=True)


def announces_compiling(command: Callable[..., None]) -> Callable[..., None]:
    """Wrap a command so that it reports when it waits for compilation, unless it is quiet."""

    @functools.wraps(command)
    def announced(*args: Any, **options: Any) -> None:
        from ecology.lab import compiling  # loads Numba, which takes a moment

        quiet = options.get("quiet", False) or any(getattr(arg, "quiet", False) for arg in args)
        with compiling.announce_compiling(quiet=quiet):
            command(*args, **options)

    return announced


def takes_options(command: Callable[[Any], None]) -> Callable[..., None]:
    """Wrap a command whose one argument is a dataclass, so that Typer sees every field of it as an option.

    A field is written as Typer reads a parameter: its annotation says what the option is, its default what it is
    when not given.
    """
    (kind,) = (hint for name, hint in get_type_hints(command).items() if name != "return")
    hints = get_type_hints(kind, include_extras=True)

    @functools.wraps(command)
    def flat(**given: Any) -> None:
        command(kind(**given))

    flat.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                each.name,
                inspect.Parameter.POSITIONAL_OR_KEYWORD,
                default=inspect.Parameter.empty if each.default is MISSING else each.default,
                annotation=hints[each.name],
            )
            for each in fields(kind)
        ]
    )
    flat.__annotations__ = {**hints, "return": None}
    return flat


def spell_out(words: list[str]) -> list[str]:
    """Return the command-line arguments, with a value added to a bare --record of `run`, which takes KEY=VALUE.

    Raises EcologyError if an argument is empty, as a shell variable that is not set becomes: an empty path would mean
    the current folder.
    """
    for before, word in zip(["ecology", *words], words, strict=False):
        if not word or re.fullmatch(r"--[\w-]+=", word):
            option = word.removesuffix("=") or before
            raise EcologyError(
                f"no word is empty, got '' after {option}; write what is meant, or leave it out with its option."
            )
    if words[:1] != ["run"]:
        return words
    after = [*words[1:], ""]
    bare = [word == "--record" and "=" not in next_ for word, next_ in zip(words, after, strict=True)]
    return [part for word, alone in zip(words, bare, strict=True) for part in ([word, RECORD] if alone else [word])]


def check_port(port: int | None, *, serve: bool) -> None:
    """Raise EcologyError if a port is given without --serve."""
    if port is not None and not serve:
        raise EcologyError("--port requires --serve.")


def refuse_with(option: str, **given: Any) -> None:
    """Raise EcologyError if an option is given that cannot be combined with `option`."""
    for name, value in given.items():
        if value is not None and value != []:
            word = name if name.isupper() else f"--{name.replace('_', '-')}"
            raise EcologyError(f"{option} continues a run with its own settings; leave out {word}, or start a new run.")


def read_setting(text: str) -> tuple[str, Any]:
    """Return key and value of "key=value"."""
    key, sign, value = text.partition("=")
    if not sign or not key.strip():
        raise EcologyError(f"--set takes KEY=VALUE, got {text!r}.")
    return key.strip(), read_value(value)


def read_pairs(
    option: str, words: Sequence[str] | None, read: Callable[[str], tuple[str, Any]], *, several: bool = False
) -> dict[str, Any]:
    """Return the values of an option by key, each read by `read`; raise EcologyError if a key occurs twice.

    If `option` takes `several` values of a key, the error shows how to join them in one.
    """
    found: dict[str, Any] = {}
    values: dict[str, str] = {}
    for word in words or ():
        key, value = read(word)
        typed = word.partition("=")[2].strip()
        if key in found:
            instead = f"{key}={values[key]},{typed}" if several else f"{key}={typed}"
            raise EcologyError(
                f"{option} takes {key!r} once, got {values[key]!r} and {typed!r}; write {option} {instead} alone."
            )
        found[key], values[key] = value, typed
    return found


def format_number(value: float | None) -> str:
    """Return a number with three digits after the point, "-" for None and numbers that are not finite."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.3f}"
