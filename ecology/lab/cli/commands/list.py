"""`ecology list`: list what can be run."""

from __future__ import annotations

import ast
import importlib.util
import shutil
import sys
import textwrap
from pathlib import Path

ORDER = 1
NARROWEST, WIDEST = 50, 200  # columns of a terminal that are used, at least and at most


def command() -> None:
    """List the scenarios, the archipelagos and the learners, one line each."""
    worlds, archipelagos, learners = lines()
    width = max(map(len, [*worlds, *archipelagos, *learners]))
    columns = min(max(shutil.get_terminal_size().columns, NARROWEST), WIDEST) if sys.stdout.isatty() else sys.maxsize
    for title, each in (("scenarios", worlds), ("archipelagos", archipelagos), ("learners", learners)):
        print(title)
        for name, line in each.items():
            indent = " " * (width + 4)
            print(textwrap.fill(f"  {name:<{width}}  {line}", columns, subsequent_indent=indent))


def lines() -> tuple[dict[str, str], dict[str, str], dict[str, str]]:
    """Return the lines of scenarios, archipelagos and learners by name, read from their files: importing takes long."""
    home = _folder("ecology.scenarios")
    worlds, archipelagos = (
        {path.stem: _first_line(path) for path in sorted(folder.glob("[!_]*.py"))}
        for folder in (home, home / "archipelagos")
    )
    for node in ast.parse((_folder("ecology.agents") / "__init__.py").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == "LEARNERS" and node.value is not None:
            return worlds, archipelagos, {name: words[-1] for name, words in ast.literal_eval(node.value).items()}
    raise AssertionError("ecology.agents has no LEARNERS")


def _folder(package: str) -> Path:
    """Return the folder of a package, which is not imported."""
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent


def _first_line(path: Path) -> str:
    """Return the first line of the docstring of a file, without running it."""
    try:
        node = ast.parse(path.read_text(encoding="utf-8"))
    except (OSError, SyntaxError) as error:
        return f"(cannot be read: {error})"
    return (ast.get_docstring(node) or "").partition("\n")[0]
