"""What the first screen shows, and under which names."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers import layout, maps
from ecology.observers import panels as files
from ecology.observers.layout import PLACED, UNTOUCHED, Box, blueprint
from ecology.observers.panels.base import Panel
from ecology.observers.panels.futures import Futures
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


def test_every_panel_has_a_place_and_is_sampled() -> None:
    """Each file of a panel is in the layout, and what is in any part of the layout is sampled, once."""
    modules = [
        importlib.import_module(f"{files.__name__}.{each.name}") for each in pkgutil.iter_modules(files.__path__)
    ]
    kinds = {
        kind
        for module in modules
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, Panel) and kind.__module__ == module.__name__
    }
    bases = {base for kind in kinds for base in kind.__bases__}
    assert kinds - bases - {Futures} == set(PLACED)  # both futures are sampled by the run that has a fork
    boxes = [value for value in vars(layout).values() if isinstance(value, Box)]
    assert len(boxes) > 3
    while boxes:
        for part in boxes.pop().parts:
            if isinstance(part, Box):
                boxes.append(part)
            else:
                assert part in PLACED
    assert len(set(PLACED)) == len(PLACED)


def test_a_click_finds_bodies_alone() -> None:
    """Every entity that a panel draws in the arena is one that a click passes through, but for the bodies."""
    sources = [Path(path) / f"{each.name}.py" for path in files.__path__ for each in pkgutil.iter_modules([path])]
    drawn = {name for path in sources for name in re.findall(r"world/(\w+)", path.read_text(encoding="utf-8"))}
    elsewhere = {"maps", "here"}  # in views of their own
    assert drawn - elsewhere - {"agents"} <= set(UNTOUCHED)
