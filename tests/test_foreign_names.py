"""Modules and packages of other names and other people: none takes the place of the project's own."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq

ROOT = Path(__file__).parent.parent
WORLD = """
from agents import DECAY
from ecology import Arena, Need, Scenario, Species, rest

def build(decay=DECAY, ticks=5):
    need = Need(name="food", set_point=2.0, decay=decay)
    agent = Species(name="agent", needs=(need,), actions=(rest(),), learner="random")
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(agent,), ticks=ticks)
"""


def sweep(folder: Path, **variables: str) -> list[float]:
    """Return the decays in the table of `ecology sweep world.py`, run in a folder."""
    words = ("sweep", "world.py", "--seeds", "0", "--out", "out", "--quiet")
    done = subprocess.run(
        [sys.executable, "-P", "-m", "ecology", *words],
        cwd=folder, env=os.environ | variables, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return pq.read_table(folder / "out" / "sweep.parquet")["set.decay"].to_pylist()


def test_a_folder_may_hold_modules_of_the_projects_names(tmp_path: Path) -> None:
    """A scenario finds the user's agents.py beside it; commands and their processes find the project's packages."""
    (tmp_path / "world.py").write_text(WORLD)
    (tmp_path / "agents.py").write_text("DECAY = 0.07")
    for name in ("ecology", "scenarios"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('a module of the user')")
    assert sweep(tmp_path) == [0.07]


def test_another_package_may_be_installed_under_a_generic_name(tmp_path: Path) -> None:
    """A package `agents`, as openai-agents brings one, is what `import agents` finds, and the project does not."""
    site, home = tmp_path / "site", tmp_path / "home"
    (site / "agents").mkdir(parents=True)
    home.mkdir()
    (site / "agents" / "__init__.py").write_text("DECAY = 0.09")
    (home / "world.py").write_text(WORLD)
    assert sweep(home, PYTHONPATH=str(site)) == [0.09]


def test_every_process_of_our_own_is_started_away_from_the_present_folder() -> None:
    """Wherever a package starts Python, -P keeps the present folder from being searched."""
    found = 0
    for path in sorted(path for name in ("ecology", "agents", "scenarios") for path in (ROOT / name).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, (ast.List, ast.Tuple)) and node.elts and ast.unparse(node.elts[0]) == "sys.executable":
                assert ast.unparse(node.elts[1]) == "'-P'", path
                found += 1
    assert found == 5
