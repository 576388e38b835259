"""What the first screen shows, and under which names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers import maps
from ecology.observers.layout import blueprint
from ecology.observers.sampler import Sampler, Sampling
from ecology.observers.scene import Scene


def scene_of(name: str, folder: Path) -> Scene:
    """Return what is drawn of a shipped scenario."""
    run = Run(resolve(name, ticks=1, record=False), folder / name)
    run.env.reset(seed=0)
    return Sampler(run.env, run.learners, how=Sampling(name, 1, 1)).scene


def parts(scene: Scene) -> Iterator[Any]:
    """Give all containers and views of the layout."""
    waiting: list[Any] = [blueprint(scene).root_container]
    while waiting:
        part = waiting.pop()
        yield part
        waiting += getattr(part, "contents", None) if hasattr(part, "contents") and not hasattr(part, "origin") else []


@pytest.mark.parametrize(("name", "shown"), [("heat", False), ("commons", True)])
def test_one_agent_is_no_population(name: str, shown: bool, tmp_path: Path) -> None:
    """A world of one agent that has cues shows these, and no mean over one; a world of several shows its population."""
    scene = scene_of(name, tmp_path)
    origins = {getattr(part, "origin", None) for part in parts(scene)}
    assert ("/population/drive" in origins) is shown
    assert ("/population/measures" in origins) is bool(scene.measures)
    assert scene.crowd
    assert scene.alone is not shown


def test_the_maps_are_named_where_there_is_room(tmp_path: Path) -> None:
    """The title above the maps, whose own titles a narrow screen cuts off, names all of them in their order."""
    scene = scene_of("paper", tmp_path)
    needs = [scene.scenario.species[0].needs[i].name for i in maps.mapped_needs(scene.scenario.species[0])]
    titles = [str(part.name) for part in parts(scene) if getattr(part, "name", None)]
    assert any(title.endswith(f"now | at their worst: {', '.join(needs)}") for title in titles)
