"""Figures are drawn wherever a command is started from."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOK = "module://matplotlib_inline.backend_inline"  # what a notebook sets for the commands that it starts
COMMANDS = """
import sys
from ecology.agents import evaluation
from ecology.lab.cli import main
evaluation.BASELINES, evaluation.LONGEST = ("rest",), 10
evaluation.horizon = lambda *_: 10
for words in (
    "run paper --ticks 20 --learner random --quiet --out r",
    "evaluate r --ticks 20 --places 1 --quiet",
    "film r --from 10 --to 20 --quiet",
    "sweep paper --ticks 5 --learner random --seeds 0 --quiet --out s",
):
    try:
        main(words.split())
    except SystemExit as left:
        assert not left.code, words
"""


def run_python(code: str, folder: Path, backend: str) -> str:
    """Return what `code` prints in a fresh Python in `folder` with MPLBACKEND set."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=folder, env={**os.environ, "MPLBACKEND": backend},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_commands_draw_when_a_notebook_starts_them(tmp_path: Path) -> None:
    """A backend that this Python does not have stops no command that draws."""
    run_python(COMMANDS, tmp_path, NOTEBOOK)
    drawn = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert {"r/figures/internal_states.png", "r/film.gif", "s/sweep.png", "s/sweep.svg"} <= drawn
    assert {f"r/figures/baselines{ending}" for ending in (".png", ".svg", ".pdf")} <= drawn


@pytest.mark.parametrize("backend", [NOTEBOOK, "no-such-backend"])
def test_the_library_draws_with_any_backend(backend: str, tmp_path: Path) -> None:
    """From Python, too, MPLBACKEND stops nothing that this project draws."""
    code = (
        "import ecology; from ecology import scenarios\n"
        "env = ecology.parallel_env(scenarios.load('paper'), render_mode='rgb_array')\n"
        "env.reset(seed=0); print(env.render().shape)"
    )
    assert run_python(code, tmp_path, backend) == "(600, 800, 3)\n"


def test_the_backend_of_the_user_holds_for_the_user(tmp_path: Path) -> None:
    """A backend that can be used stays the one of the user's own plots, and the variable stays as it was."""
    code = (
        "import os, ecology.observers.plotting, matplotlib\n"
        "print(matplotlib.rcParams['backend'], os.environ['MPLBACKEND'])"
    )
    assert run_python(code, tmp_path, "svg").split() == ["svg", "svg"]
    assert run_python(code, tmp_path, NOTEBOOK).split()[1] == NOTEBOOK
