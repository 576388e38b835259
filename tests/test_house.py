"""The house: files, functions and their parameters stay small enough to be read at a glance."""

import ast
import re
from pathlib import Path

HOME = Path(__file__).parents[1]
FILES = [path for root in ("ecology", "agents", "scenarios", "tests") for path in sorted((HOME / root).rglob("*.py"))]
LINES, FUNCTION, PARAMETERS = 650, 80, 8  # at most
LONG = "ecology/spec.py"  # the vocabulary


def functions():
    """Yield what every function of the package is called and its node."""
    for path in FILES:
        where = path.relative_to(HOME)
        if where.parts[0] != "tests":
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                    yield f"{where}:{node.name}", node


def test_no_file_is_long():
    """No file but the vocabulary has more than 650 lines."""
    found = {path: len(path.read_text().splitlines()) for path in FILES}
    assert not {str(path): n for path, n in found.items() if n > LINES and path != HOME / LONG}


def test_no_function_is_long():
    """No function has more than 80 lines."""
    assert not [name for name, node in functions() if node.end_lineno - node.lineno >= FUNCTION]


def test_no_function_has_many_parameters():
    """No function has more than 8 parameters, `self` included; those of a world's `build` are its settings."""

    def count(node):
        return len(node.args.posonlyargs) + len(node.args.args) + len(node.args.kwonlyargs)

    many = [name for name, node in functions() if count(node) > PARAMETERS]
    assert not [name for name in many if not re.fullmatch(r"scenarios/.*:build", name)]
