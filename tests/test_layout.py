"""What the first screen shows, and under which names."""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers import layout, maps, shapes
from ecology.observers import panels as files
from ecology.observers.layout import PLACED, UNTOUCHED, Box, blueprint
from ecology.observers.panels.ahead import Ahead
from ecology.observers.panels.base import Batch, Panel, labelled, labelled_ticks
from ecology.observers.panels.coupling import Coupling
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
    worst = ", ".join(f"{i} {need}" for i, need in enumerate(needs, 2))
    assert any(title.endswith(f"1 now | at their worst: {worst}") for title in titles)
    assert {f"{i}" for i in range(1, len(needs) + 2)} <= set(titles)  # of the maps themselves


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


@pytest.mark.parametrize("tall", [27, 60, 76, 130, 150])
@pytest.mark.parametrize(
    ("low", "high"), [(0, 0), (0, 3.4), (0, 96), (-1.5, 1.5), (31, 42), (0.0316, 0.0317), (0, 400), (-100, 100), (7, 7)]
)
def test_an_axis_has_two_labels(low: float, high: float, tall: float) -> None:
    """A plot's range holds two multiples of the power of ten that the viewer labels, and all that is drawn."""
    least, most = labelled(low, high, tall)
    assert least <= low
    assert high <= most
    apart = 20 * (most - least) / max(tall, 56)  # of two labels, at least
    step = 10.0 ** math.ceil(math.log10(apart) - 1e-9)
    assert math.floor(most / step) - math.ceil(least / step) >= 1
    assert most - least <= 25 * max(high - low, abs(high), 1e-9)


def test_a_label_just_beyond_the_data_is_whole() -> None:
    """A plot that ends a few points below its next label reaches beyond it; one with room to spare does not."""
    assert labelled(0, 4.5, 150)[1] > 5.2
    assert labelled(-4.5, 0, 150)[0] < -5.2
    assert labelled(0, 1.3, 150)[1] < 1.5


@pytest.mark.parametrize("wide", [205, 280, 680])
@pytest.mark.parametrize("number", [1, 44, 99, 100, 450, 583, 800, 1_000, 1_990, 2_000, 5_000, 20_000, 1_000_000])
def test_an_axis_of_ticks_has_two_whole_labels(number: int, wide: float) -> None:
    """The axis of a finished recording shows the first two labels, and half a label is left right of the last one."""
    most = labelled_ticks(number, wide)
    assert most >= number
    step = 10 ** max(0, math.ceil(math.log10(60 * most / wide)))
    last = (most - 1) // step * step  # the viewer leaves out one at the right edge
    assert last >= step
    assert (most - last) * wide / most >= 20


def test_a_resource_that_is_everywhere_is_drawn_on_the_floor(tmp_path: Path) -> None:
    """A circle that holds the whole arena has no outline, and the legend says so; others have names beside them."""
    for name, everywhere in (("laws", ["pool"]), ("colony", ["food"]), ("commons", []), ("paper", [])):
        scene = scene_of(name, tmp_path)
        resources = scene.scenario.resources
        assert [r.name for r in resources if shapes.covers(scene.scenario, r)] == everywhere
        words = [word for row in scene.legend_rows() for _, word, _ in row]
        assert [word for word in words if word.endswith("everywhere")] == [f"{each}: everywhere" for each in everywhere]


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("hunting", ["hunter"]),
        ("colony", ["nurse", "brood"]),
        ("food_share", ["possessor", "partner"]),
        ("enrichment", []),
    ],
)
def test_a_life_that_cannot_change_is_left_out(name: str, shown: list[str], tmp_path: Path) -> None:
    """Prey that only rest, with a need that nothing changes, have no curves; a species that decides or is felt has."""
    scene = scene_of(name, tmp_path)
    origins = {str(getattr(part, "origin", "")) for part in parts(scene)}
    assert [each for each in scene.groups if f"/focus/{each}/needs" in origins] == shown


@pytest.mark.parametrize(("name", "front"), [("well_mixed", "populations"), ("colony", "nurse in focus")])
def test_a_world_without_minds_opens_with_its_populations(name: str, front: str, tmp_path: Path) -> None:
    """Where no species decides, the populations are in front of the lives; else a mind is."""
    tabs = [part.contents for part in parts(scene_of(name, tmp_path)) if type(part).__name__ == "Tabs"]
    names = [[view.name for view in views] for views in tabs]
    assert front in [each[0] for each in names if "populations" in each]


def test_a_coupling_of_one_row_is_a_picture_with_names_and_numbers(tmp_path: Path) -> None:
    """The matrix of one agent that feels two is drawn as cells of pixels, with all names, all weights and a scale."""
    scene, told = scene_of("food_share", tmp_path), dict[str, Any]()
    panel = Coupling(scene, "possessor")
    rec = SimpleNamespace(set_time=lambda *_, **__: None, log=lambda entity, *what, **_: told.update({entity: what}))
    weight = np.array([[1.0, 0.5]], np.float32), ["possessor_0"], ["possessor_0", "partner_1"]
    panel.draw(cast(Any, rec), Batch(scene, [{"tick": 0, "panels": {panel.key: weight}}]))
    image, _ = told["population/coupling/possessor/image"]
    height, width = (
        image.format.as_arrow_array().to_pylist()[0]["height"],
        image.format.as_arrow_array().to_pylist()[0]["width"],
    )
    assert height > 4
    assert width == 2 * height
    (words,) = told["population/coupling/possessor/names"]
    shown = words.labels.as_arrow_array().to_pylist()
    assert sorted(shown) == sorted(["dark 0, bright 1", "possessor_0", "possessor_0", "partner_1", "1", "0.5"])


def test_no_forecast_is_drawn_nowhere(tmp_path: Path) -> None:
    """An ellipse without a centre would lie at the origin: where there is no forecast, its centre is NaN."""
    scene, logged = scene_of("paper", tmp_path), dict[str, Any]()
    panel = Ahead(scene, "agent")
    rec = SimpleNamespace(set_time=lambda *_, **__: None, log=lambda entity, *what, **_: logged.update({entity: what}))
    nothing = np.empty((0, 2)), np.empty((0, 2)), []
    panel.draw(cast(Any, rec), Batch(scene, [{"tick": 0, "panels": {panel.key: nothing}}]))
    (ellipse,) = logged["world/forecast/agent"]
    assert np.isnan(ellipse.centers.as_arrow_array().to_pylist()).all()
