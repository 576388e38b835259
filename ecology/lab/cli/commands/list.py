"""`ecology list`: list what can be run."""

from __future__ import annotations

import ast
import shutil
import sys
import textwrap
from pathlib import Path

ORDER = 1
NARROWEST, WIDEST = 50, 200  # columns of a terminal that are used, at least and at most


def command() -> None:
    """List the scenarios, the archipelagos and the learners, one line each."""
    from ecology import agents, scenarios

    learners = {name: line for name, (_, _, _, line) in agents.LEARNERS.items()}
    worlds = {name: _first_line(scenarios.HERE / f"{name}.py") for name in scenarios.names()}
    archipelagos = {name: _first_line(scenarios.ARCHIPELAGOS / f"{name}.py") for name in scenarios.archipelago_names()}
    width = max(map(len, [*worlds, *archipelagos, *learners]))
    columns = min(max(shutil.get_terminal_size().columns, NARROWEST), WIDEST) if sys.stdout.isatty() else sys.maxsize
    for title, lines in (("scenarios", worlds), ("archipelagos", archipelagos), ("learners", learners)):
        print(title)
        for name, line in lines.items():
            indent = " " * (width + 4)
            print(textwrap.fill(f"  {name:<{width}}  {line}", columns, subsequent_indent=indent))


def _first_line(path: Path) -> str:
    """Return the first line of the docstring of a file, without running it."""
    try:
        node = ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, SyntaxError) as error:
        return f"(cannot be read: {error})"
    return (ast.get_docstring(node) or "").partition("\n")[0]
