"""`ecology new --with`: every component alone, and all of them together, make a world that runs."""

import dataclasses

import numpy as np
import pytest

from ecology import Ecology, scenarios, spec
from ecology.lab import cli
from ecology.lab.cli import parts


def write(folder, monkeypatch, *names):
    """Return the scenario that `ecology new room --with ...` writes."""
    monkeypatch.chdir(folder)
    with pytest.raises(SystemExit) as end:
        cli.main(["new", "room", *(word for name in names for word in ("--with", name))])
    assert end.value.code == 0
    return scenarios.load(str(folder / "room.py"))


@pytest.mark.parametrize("name", sorted(parts.PARTS))
def test_every_component_makes_a_world_of_its_own(name, tmp_path, monkeypatch):
    """The file builds, differs from the one without the component, and lives some ticks."""
    plain = write(tmp_path, monkeypatch)
    (tmp_path / "room.py").unlink()
    built = write(tmp_path, monkeypatch, name)
    assert built != plain
    env = Ecology(built)
    tick = env.reset_arrays(0)
    for _ in range(3):
        actions = [tick.masks[group.name].argmax(axis=1) for group in env.groups.values()]
        tick = env.step_arrays(np.concatenate(actions))
    assert "# +" not in (tmp_path / "room.py").read_text()


def test_all_components_live_in_one_world(tmp_path, monkeypatch):
    """They can be put together, and accounts close."""
    env = Ecology(write(tmp_path, monkeypatch, *parts.PARTS))
    tick = env.reset_arrays(0)
    start = env.world.model.body.start[0]  # before the schedule
    rng = np.random.default_rng(0)
    for _ in range(60):
        masks = tick.masks["agent"]
        tick = env.step_arrays(np.where(masks, rng.random(masks.shape), -1.0).argmax(axis=1))
    state = env.state_view
    stored = state.ingested + state.received - state.given - state.metabolised - state.lost
    assert start + stored[0] == pytest.approx(state.internal[0], abs=1e-9)


def test_every_building_block_has_its_line():
    """Every dataclass of a scenario is in the template or in a component."""
    blocks = {
        name
        for name, value in vars(spec).items()
        if dataclasses.is_dataclass(value) and value.__module__ == spec.__name__
    }
    text = (scenarios.HERE / "_template.py").read_text(encoding="utf-8")
    known = {name for name in blocks if f"{name}(" in text} | {n for part in parts.PARTS.values() for n in part.imports}
    assert blocks - known == {"Action", "Oscillation", "Relocation"}  # written by functions; other motions than Drift


def test_an_unknown_component_is_refused(tmp_path, monkeypatch, capsys):
    """The message names the nearest one, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        cli.main(["new", "room", "--with", "feilds"])
    assert end.value.code == 2
    assert "fields" in capsys.readouterr().err
    assert not (tmp_path / "room.py").exists()
