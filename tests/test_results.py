"""What a run and a sweep report: own drives beside felt ones, a scenario's own measures, and each species alone."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from ecology import Ecology, EcologyError, agents, scenarios
from ecology.agents import lives
from ecology.lab.cli import main
from ecology.lab.runs import sweep as sweeps
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import resolve

WORLD = """
import numpy as np
from ecology import Arena, Empathy, Hazard, Need, Resource, Scenario, Species, consume, rest

def hunger(state):
    return np.maximum(2.0 - state.internal[:, 0], 0.0).mean()

def build(weight=0.5, prey=0, hazard=0.0, bad=False, ticks=60):
    need = Need(name="food", set_point=2.0, decay=0.02, noise=0.05, bounds=(0.0, 4.0))
    words = dict(needs=(need,), actions=(rest(), consume("berries", {"food": 0.1})), learner="random",
                 position=(1.0, 1.0), solid=False)
    empathy = Empathy(weight=weight, form="average") if weight else None
    species = (Species(name="agent", count=3, empathy=empathy, **words),)
    if prey:
        species += (Species(name="prey", count=prey, hazard=Hazard(rate=hazard) if hazard else None, **words),)
    measures = {"hunger": hunger, "now": lambda state: state.tick, "never": lambda state: np.nan}
    if bad:
        measures["bad"] = lambda state: state.nothing
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=species,
                    resources=(Resource(name="berries", position=(1.0, 1.0)),), ticks=ticks, measures=measures)
"""

Type = Callable[..., tuple[int, str, str]]


@pytest.fixture
def ecology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Type:
    """Return the command line in a folder that holds world.py: words -> exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    Path("world.py").write_text(WORLD)

    def type_(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as left:
            main(words)
        return int(left.value.code or 0), *capsys.readouterr()

    return type_


@pytest.fixture
def sweep(ecology: Type, monkeypatch: pytest.MonkeyPatch) -> Type:
    """Return `ecology sweep world.py --out out --seeds 0:2`, whose runs are run in this process."""

    def attempt(cell: sweeps.Cell, stop: threading.Event) -> tuple[int, str]:
        run = open_run(cell.folder)
        run.resume()
        run.live()
        return 0, ""

    monkeypatch.setattr(sweeps, "by_process", attempt)
    return lambda *words: ecology("sweep", "world.py", "--out", "out", "--seeds", "0:2", "--workers", "1", *words)


def summary_of(folder: str) -> dict[str, Any]:
    """Return the summary of a run."""
    return json.loads((Path(folder) / "summary.json").read_text())


def test_own_drives_and_measures_are_kept(ecology: Type) -> None:
    """Metrics and summary hold the bodies' own drive, worked out here from the needs, and the scenario's measures."""
    code, out, err = ecology("run", "world.py", "--out", "mine", "--record", "every=1", "--set", "prey=2")
    assert code == 0, err
    metrics = pq.read_table("mine/metrics.parquet").to_pydict()
    summary = summary_of("mine")
    own = np.array(metrics["own_drive"])
    np.testing.assert_allclose(own, np.sqrt((np.array(metrics["food"]) - 2.0) ** 2 + 1e-3), atol=1e-5)
    drive, agent = np.array(metrics["drive"]), np.array(metrics["species"]) == "agent"
    assert np.abs(drive - own)[agent].mean() > 0.01  # what is felt is something else
    assert np.array_equal(drive[~agent], own[~agent])
    tick = np.array(metrics["tick"])
    for name, values in (("mean_drive", drive), ("mean_own_drive", own)):
        assert summary[name] == pytest.approx(values.mean(), rel=1e-5)
        assert summary[f"{name}_last_tenth"] == pytest.approx(values[tick > 54].mean(), rel=1e-5)
        by = summary[name.replace("mean", "species")]
        assert by == pytest.approx({"agent": values[agent].mean(), "prey": values[~agent].mean()}, rel=1e-5)
    assert f"own drive {summary['mean_own_drive']:.3f}" in out
    assert metrics["measures.now"] == metrics["tick"]
    hunger = [np.maximum(2.0 - np.array(metrics["food"])[tick == t], 0).mean() for t in range(1, 61)]
    np.testing.assert_allclose(metrics["measures.hunger"], np.repeat(hunger, 5), atol=1e-5)
    assert summary["measures"]["hunger"] == pytest.approx(
        {"end": hunger[-1], "mean": np.mean(hunger), "least": min(hunger), "most": max(hunger)}, abs=1e-5
    )
    assert summary["measures"]["now"] == {"end": 60, "mean": 30.5, "least": 1, "most": 60}
    assert summary["measures"]["never"] == dict.fromkeys(("end", "mean", "least", "most"))
    assert f"hunger: {np.mean(hunger):.3f} on average" in out


def test_without_empathy_both_drives_are_one(ecology: Type) -> None:
    """Where nobody feels anything the two are equal number for number, and only one is printed."""
    code, out, _ = ecology("run", "world.py", "--out", "mine", "--set", "weight=0.0")
    metrics = pq.read_table("mine/metrics.parquet")
    summary = summary_of("mine")
    assert code == 0
    assert metrics["own_drive"] == metrics["drive"]
    assert summary["mean_own_drive"] == summary["mean_drive"]
    assert "own drive" not in out


def test_measures_are_sampled_as_metrics_are_and_resumed(tmp_path: Path) -> None:
    """Measures are taken every `record_every` ticks and at the end, whether the run was stopped between or not."""
    (tmp_path / "world.py").write_text(WORLD)

    def summary(folder: str, *ticks: int) -> dict[str, Any]:
        for i, until in enumerate(ticks):
            plan = resolve(str(tmp_path / "world.py"), ticks=until, record=False, record_every=7)
            run = Run(plan, tmp_path / folder)
            run.resume() if i else run.start()
            run.live()
        return run.summary()

    whole, parts = summary("whole", 60), summary("parts", 23, 60)
    assert whole["measures"]["now"] == {"end": 60, "mean": 31.5, "least": 7, "most": 56}
    assert parts["measures"]["hunger"] == whole["measures"]["hunger"]
    for key in ("mean_own_drive", "species_drive", "species_own_drive"):
        assert parts[key] == whole[key]


def test_a_measure_that_fails_is_reported_without_a_recording_too(ecology: Type) -> None:
    """An exception in a measure names its line, with exit code 2; the summary says how far the run came."""
    code, _, err = ecology("run", "world.py", "--out", "mine", "--no-record", "--set", "bad=true")
    assert code == 2
    assert "state.nothing" in err
    assert summary_of("mine")["stopped_at"] == 10


def test_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    """A need named as the column of the own drive is one clear error before the first tick."""
    (tmp_path / "world.py").write_text(WORLD.replace('"food"', '"own_drive"'))
    with pytest.raises(EcologyError, match=r"'own_drive'.*names of other columns"):
        Run(resolve(str(tmp_path / "world.py")), tmp_path / "out")


def test_an_evaluation_measures_own_drives(tmp_path: Path) -> None:
    """A life without learning has the own drives too, worked out here from the deviations that are perceived."""
    (tmp_path / "world.py").write_text(WORLD)
    scenario = scenarios.load(str(tmp_path / "world.py"))
    learner = agents.make("random", Ecology(scenario).groups["agent"], np.random.SeedSequence(0), {})
    life = lives.fresh_life(scenario, learner, 40, seed=0)
    own = np.sqrt(life.zeta[11:, :, 0] ** 2 + 1e-3).mean(axis=1)
    np.testing.assert_allclose(lives.drive_series(life, 10, own=True), own, atol=1e-5)
    assert np.abs(life.drive[1:] - life.own_drive).mean() > 1e-3  # agents alike have one mean, whatever they feel


def test_a_sweep_with_empathy_shows_own_drives_first(sweep: Type, monkeypatch: pytest.MonkeyPatch) -> None:
    """The own drive is printed and drawn before the felt one, and both are columns of the table."""
    drawn: list[list[str]] = []
    draw = sweeps.draw_sweep
    monkeypatch.setattr(
        sweeps, "draw_sweep", lambda path, panels, title: (drawn.append([*panels]), draw(path, panels, title))
    )
    code, out, err = sweep("--set", "weight=0.0,0.5")
    assert code == 0, err
    assert drawn == [["mean own drive", "mean drive"]]
    assert 0 < out.index("mean own drive") < out.index("mean drive")
    assert "mean own drive" in err  # of each run, as it ends
    table = pq.read_table("out/sweep.parquet").to_pydict()
    own = [np.mean([v for v, w in zip(table["mean_own_drive"], table["set.weight"], strict=True) if w == x])
           for x in (0.0, 0.5)]  # fmt: skip
    assert all(f"{mean:.3f}" in out for mean in own)
    assert table["measures.now.mean"] == [np.mean(range(10, 61, 10))] * 4
    assert Path("out/sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_a_sweep_of_several_species_shows_each(sweep: Type) -> None:
    """Of several species, populations and drives of each are shown, not one mean over all."""
    code, out, err = sweep("--set", "weight=0.0", "--set", "prey=4", "--set", "hazard=0.02,0.3")
    assert code == 0, err
    for name in ("agent population", "agent drive", "prey population", "prey drive"):
        assert name in out
    assert "mean drive" not in out
    table = pq.read_table("out/sweep.parquet").to_pydict()
    for name in ("population.prey.mean", "species_drive.prey"):
        assert f"{np.mean(table[name][:2]):.3f}" in out


def test_a_column_of_ones_own_is_shown(sweep: Type) -> None:
    """--show prints and draws any number of the table instead; a cause of death that a run did not have counts 0."""
    words = ("--set", "prey=4", "--set", "hazard=0.0,0.3")
    code, out, err = sweep(*words, "--show", "measures.hunger.mean", "--show", "population.prey.died_of.hazard")
    assert code == 0, err
    table = pq.read_table("out/sweep.parquet").to_pydict()
    assert table["population.prey.died_of.hazard"][:2] == [0, 0]
    assert min(table["population.prey.died_of.hazard"][2:]) > 0
    assert f"{np.mean(table['measures.hunger.mean'][:2]):.3f}" in out
    assert "hunger" in out
    assert "mean drive" not in out
    code, out, _ = sweep(*words, "--show", "births")  # nothing is run again, another column is shown
    assert code == 0
    assert "births" in out
    assert "hunger" not in out


def test_a_column_of_some_runs_is_shown(sweep: Type) -> None:
    """A species that only some settings have can be shown, for the runs that have it."""
    code, out, err = sweep("--set", "prey=0,2", "--set", "weight=0.0", "--show", "species_drive.prey")
    assert code == 0, err
    assert "prey drive" in out
    table = pq.read_table("out/sweep.parquet").to_pydict()
    assert table["species_drive.prey"][:2] == [None, None]


@pytest.mark.parametrize("column", ["measures.hungr.mean", "hunger", "seed", "set.weight", ""])
def test_a_column_that_is_none_is_one_clear_error(sweep: Type, column: str) -> None:
    """A column that the table will not hold, or that holds no result, is refused before anything is run."""
    code, _, err = sweep("--show", column)
    assert code == 2
    assert ("--show takes a column" if column else "''") in err
    if "hungr" in column:
        assert "'measures.hunger.mean'" in err
    assert not Path("out").exists()


def test_columns_are_chosen_by_what_is_felt() -> None:
    """Own drives lead where they differ, per species too; of a measured run what was learned leads."""

    def columns(evaluate: bool = False, **summary: Any) -> list[str]:
        cell = sweeps.cells_of("commons", Path("out"), seeds=[0], settings={}, evaluate=evaluate)[0]
        return sweeps.columns_of([sweeps.Outcome(cell, summary)])

    assert columns(mean_drive=1.0, mean_own_drive=1.0) == ["mean_drive"]
    assert columns(mean_drive=1.0, mean_own_drive=2.0) == ["mean_own_drive", "mean_drive"]
    assert columns(True, mean_drive=1.0, learned_drive=1.0, learned_own_drive=1.0) == ["learned_drive"]
    assert columns(True, learned_drive=1.0, learned_own_drive=0.5) == ["learned_own_drive", "learned_drive"]
    felt = {"species_drive": {"nurse": 1.0, "brood": 2.0}, "species_own_drive": {"nurse": 0.5, "brood": 2.0}}
    assert columns(**felt) == [
        "population.nurse.mean", "species_own_drive.nurse", "species_drive.nurse",
        "population.brood.mean", "species_drive.brood",
    ]  # fmt: skip
    assert [sweeps.label(column) for column in columns(**felt)[:3]] == [
        "nurse population",
        "nurse own drive",
        "nurse drive",
    ]
