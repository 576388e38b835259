"""Runs that several tests look at."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

from ecology import EcologyError
from ecology.agents import checkpoint
from ecology.lab.cli import main
from ecology.lab.runs.folder import CHECKPOINT
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve

CROWD = """
'''Twelve wide bodies in a small room: they touch each other and the walls at every tick.'''
from ecology import Arena, Need, Resource, Scenario, Species, consume, go_to, move, rest, turn

def build(decay=0.01, noise=0.02):
    need = Need(name="food", set_point=2.0, decay=decay, noise=noise, bounds=(0.0, 4.0))
    actions = (rest(), move("walk", 0.3), turn("left", 0.7), turn("right", -0.7),
               consume("berries", {"food": 0.1}), go_to("berries", 0.2))
    crowd = Species(name="crowd", needs=(need,), actions=actions, count=12, radius=0.2)
    return Scenario(name="crowd", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(crowd,),
                    resources=(Resource(name="berries", position=(1.0, 1.0)),))
"""


def lived(folder: Path) -> int:
    """Return the tick of the checkpoint in `folder`, 0 where there is none."""
    with contextlib.suppress(EcologyError):
        return int(checkpoint.read(folder / CHECKPOINT)["tally"][1]["tick"])
    return 0


def cli(*words: str) -> None:
    """Type a command that is expected to succeed."""
    with pytest.raises(SystemExit) as left:
        main(words)
    assert not left.value.code


def files_of(folder: Path) -> dict[Path, bytes]:
    """Return what every file of a folder holds."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


def make_crowd(where: Path, folder: str, ticks: int, every: int = 100, learner: str = "random") -> Run:
    """Return a run of the crowd, not yet begun."""
    (where / "crowd.py").write_text(CROWD)
    plan = resolve(str(where / "crowd.py"), learners=[learner], ticks=ticks, checkpoint_every=every, record=False)
    return Run(plan, where / folder)
