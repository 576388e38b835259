"""What a run leaves: its folder, whether it ends, is stopped, goes on or diverges."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from runs import (
    CROWD,
    cli,
)

from ecology import EcologyError, agents
from ecology.agents import checkpoint
from ecology.agents.base import DivergedError, Learner, Transition
from ecology.lab.cli import main
from ecology.lab.runs import run_summary
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import Plan, read_config, resolve
from ecology.observers.base import Observer


def test_births_are_counted_where_there_is_room_for_more(tmp_path: Path) -> None:
    """The summary counts the born, whatever the number of slots; slots that were never taken are no births."""
    text = CROWD.replace("count=12", "count=3, capacity=12, birth=Birth(rate=0.1)").replace("Arena,", "Arena, Birth,")
    (tmp_path / "growing.py").write_text(text)
    run = Run(resolve(str(tmp_path / "growing.py"), learners=["random"], ticks=100, record=False), tmp_path / "out")
    run.start()
    summary = run.live()
    assert summary["births"] - summary["deaths"] == run.tick.alive.sum() - 3
    assert summary["births"] > 0


def test_a_run_has_ended_when_all_that_is_recorded_is_on_disk(tmp_path: Path) -> None:
    """The summary comes last: a run that is killed or fails while its observers end can be resumed."""

    class Failing(Observer):
        def end(self) -> None:
            assert not (tmp_path / "out" / "summary.json").exists()
            raise OSError("no room")

    (tmp_path / "crowd.py").write_text(CROWD)
    run = Run(resolve(str(tmp_path / "crowd.py"), learners=["random"], ticks=20, record=False), tmp_path / "out")
    run.start()
    with pytest.raises(EcologyError, match="no room"):
        run.live([Failing()])
    told = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert told["ticks"] == 20
    assert "no room" in told["stopped_by"]
    again = open_run(tmp_path / "out")
    again.resume()
    assert "stopped_at" not in again.live()


PREY = """
from ecology import Arena, Need, Scenario, Species, bite, rest

def build():
    calm = Need(name="calm", set_point=1.0)
    def kind(name, place, *acts, decay=0.0):
        food = Need(name="food", set_point=1.0, decay=decay, bounds=(0.0, 4.0), lethal=decay != 0 or name == "wounded")
        return Species(name=name, needs=(calm, food), actions=(rest(), *acts), position=place, count=2, solid=False)
    return Scenario(
        name="prey", arena=Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8))),
        species=(kind("wolf", (2.0, 2.0), bite("wounded", reach=1.0, damage={"food": 0.3})),
                 kind("fox", (6.0, 6.0), bite("killed", reach=1.0)),
                 kind("wounded", (2.0, 2.5)), kind("killed", (6.0, 6.5)), kind("starved", (2.0, 6.0), decay=0.1)))
"""


def test_the_summary_says_of_what_and_by_whom_they_died(tmp_path: Path) -> None:
    """By species: the causes of death, the lethal needs and the species of the killers; also of a resumed run."""
    (tmp_path / "prey.py").write_text(PREY)
    for ticks in (5, 60):
        plan = resolve(str(tmp_path / "prey.py"), learners=["random"], ticks=ticks, record=False)
        run = Run(plan, tmp_path / "run")
        run.start() if ticks == 5 else run.resume()
        found = run.live()["population"]
    told = {name: [found[name][word] for word in ("died_of", "fatal_needs", "killed_by")] for name in found}
    assert told == {
        "wolf": [{}, {}, {}],
        "fox": [{}, {}, {}],
        "wounded": [{"bitten": 2}, {"food": 2}, {"wolf": 2}],
        "killed": [{"eaten": 2}, {}, {"fox": 2}],
        "starved": [{"need": 2}, {"food": 2}, {}],
    }


def test_a_long_run_is_summed_up_in_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often two blocks became one, also after resuming, the summary is that of every tick."""
    text = CROWD.replace(
        "count=12", "count=3, capacity=12, birth=Birth(rate=0.01), arrival=0.5, hazard=Hazard(rate=0.02)"
    )
    (tmp_path / "growing.py").write_text(text.replace("Arena,", "Arena, Birth, Hazard,"))

    def plan(ticks: int) -> Plan:
        return resolve(str(tmp_path / "growing.py"), learners=["random"], ticks=ticks, record=False)

    whole = Run(plan(160), tmp_path / "whole")
    whole.start()
    expected = whole.live()
    assert whole.totals.span == 1
    assert expected["population"]["crowd"]["least"] < expected["population"]["crowd"]["most"]
    monkeypatch.setattr(run_summary, "BLOCKS", 16)
    part = Run(plan(50), tmp_path / "parts")
    part.start()
    part.live()
    again = Run(plan(160), tmp_path / "parts")
    again.resume()
    found = again.live()
    for key in [key for key in expected if "drive" in key]:  # sums of sums differ by rounding
        assert found.pop(key) == pytest.approx(expected.pop(key), rel=1e-12)
    for key in ("wall_seconds", "cpu_seconds", "learner_cpu_seconds", "agent_steps_per_second"):
        del found[key], expected[key]
    assert found == expected
    assert (again.totals.span, len(again.totals.drive), again.totals.state()[0]["drive"].shape) == (16, 16, (10, 1))
    (fine, one), (coarse, many) = whole.totals.drives("crowd"), again.totals.drives("crowd")
    assert (len(fine), one, len(coarse), many) == (160, 1, 10, 16)
    living = whole.totals.living[:160, 0]  # a block weighs each tick by the living
    expected_drive = (fine * living).reshape(10, 16).sum(axis=1) / living.reshape(10, 16).sum(axis=1)
    np.testing.assert_allclose(coarse, expected_drive)
    assert again.totals.mean_drive(152) == pytest.approx(again.totals.mean_drive(144))  # half of the last block
    assert again.totals.mean_drive(160) is None


def test_a_species_that_died_out_is_told_with_its_tick(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tick after which none of a species lived is told, also by a run that went on; where some live it is null."""
    text = CROWD.replace("Arena,", "Arena, Hazard,").replace("radius=0.2)", "radius=0.2, hazard=Hazard(rate=0.02))")
    (tmp_path / "dying.py").write_text(text)
    words = ("run", str(tmp_path / "dying.py"), "--learner", "random", "--no-record")
    cli(*words, "--ticks", "20", "--out", str(tmp_path / "parts"))
    assert "died out" not in capsys.readouterr().out

    def told(folder: str) -> dict[str, Any]:
        return json.loads((tmp_path / folder / "summary.json").read_text())["population"]["crowd"]

    assert told("parts")["end"] > 0
    assert told("parts")["died_out"] is None
    cli(*words, "--ticks", "1500", "--out", str(tmp_path / "whole"))
    died_out = told("whole")["died_out"]
    assert f"crowd: 0 alive (died out at tick {died_out:,}), " in capsys.readouterr().out
    for ticks in (died_out - 1, died_out, 1500):
        cli("run", "--resume", str(tmp_path / "parts"), "--ticks", str(ticks), "--quiet")
        assert told("parts")["end"] == (ticks < died_out)
        assert told("parts")["died_out"] == (None if ticks < died_out else died_out)
    assert told("parts") == told("whole")


def test_a_species_that_came_back_has_not_died_out(crowd: Callable[..., Run]) -> None:
    """Only the last death counts: newcomers undo it, and one who never lived has not died."""
    run = crowd("out", 10)
    totals, tick, state = run.totals, run.tick, run.env.state_view
    for at, living in enumerate((12, 0, 0, 3, 0, 0), start=1):
        alive = np.arange(12) < living
        totals.watch(replace(state, tick=at), replace(tick, alive=alive), {})
        assert totals.gone.tolist() == [{2: 2, 3: 2, 5: 5, 6: 5}.get(at, 0)]


def test_a_run_leaves_one_folder(tmp_path: Path) -> None:
    """Config, summary, metrics, recording and checkpoint are written, and nothing else."""
    out = tmp_path / "mine"
    cli("run", "paper", "--learner", "random", "--ticks", "200", "--out", str(out), "--quiet")
    assert {path.name for path in out.iterdir()} == {
        "config.toml", "summary.json", "metrics.parquet", "recording.rrd", "checkpoint", "checkpoint.previous", ".lock",
        "world.json",
    }  # fmt: skip
    summary = json.loads((out / "summary.json").read_text())
    assert summary["scenario"] == "paper"
    assert summary["learner"] == {"agent": "random"}
    assert (summary["seed"], summary["ticks"], summary["deaths"], summary["births"]) == (0, 200, 0, 0)
    assert "stopped_at" not in summary
    assert summary["wall_seconds"] > 0
    assert 0 < summary["learner_cpu_seconds"] < summary["cpu_seconds"]
    assert summary["agent_steps_per_second"] == pytest.approx(200 / summary["wall_seconds"], rel=0.05)
    assert sum(summary["action_shares"]["agent"].values()) == pytest.approx(1.0)
    assert summary["mean_abs_deviation"]["agent"].keys() >= {"need_1", "muscle_fatigue", "sleep_fatigue"}
    metrics = pq.read_table(out / "metrics.parquet")
    assert metrics["tick"].to_pylist() == list(range(10, 201, 10))
    assert (out / "recording.rrd").read_bytes()[:3] == b"RRF"
    config = tomllib.loads((out / "config.toml").read_text())
    assert {"ecology", "python", "numpy", "torch", "pymunk", "dt"} <= config["made_with"].keys()


def test_the_summary_is_what_metrics_say(tmp_path: Path) -> None:
    """Mean drive, its last tenth and the needs' mean deviations agree with a recording of every tick."""
    config = tmp_path / "config.toml"
    config.write_text("record_every = 1")
    out = tmp_path / "mine"
    words = ["--config", str(config), "--learner", "random", "--ticks", "300", "--out", str(out), "--quiet"]
    cli("run", "seasons", *words)
    summary = json.loads((out / "summary.json").read_text())
    metrics = pq.read_table(out / "metrics.parquet").to_pydict()
    drive = np.array(metrics["drive"])
    assert summary["mean_drive"] == pytest.approx(drive.mean(), rel=1e-5)
    assert summary["mean_drive_last_tenth"] == pytest.approx(drive[-30:].mean(), rel=1e-5)
    delta = np.abs(np.array(metrics["warmth"]) - 2.0)
    assert summary["mean_abs_deviation"]["agent"]["warmth"] == pytest.approx(delta.mean(), rel=1e-5)
    rests = metrics["action"].count("rest") / 300
    assert summary["action_shares"]["agent"]["rest"] == pytest.approx(rests)


class Diverging(Learner):
    """Lives for a while, then finds that a network of its third agent is no longer finite."""

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Rest."""
        return np.zeros(self.size, np.int64)

    def learn(self, transition: Transition) -> None:
        """Diverge after 30 ticks."""
        self.ticks = getattr(self, "ticks", 0) + 1
        if self.ticks == 30:
            raise DivergedError("the deviation function J", self.group.slots.start + 2, "Lower it.")


def test_a_network_that_diverges_stops_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names tick, agent and what to do; the folder keeps the run and the last good checkpoint."""
    monkeypatch.setattr(agents, "LEARNERS", {**agents.LEARNERS, "diverging": (__name__, "Diverging", None, "")})
    (tmp_path / "crowd.py").write_text(CROWD)
    (tmp_path / "config.toml").write_text("checkpoint_every = 20\nrecord_every = 1")
    words = [
        "--learner",
        "diverging",
        "--config",
        str(tmp_path / "config.toml"),
        "--out",
        str(tmp_path / "out"),
    ]
    with pytest.raises(SystemExit, match="2"):
        main(["run", str(tmp_path / "crowd.py"), "--ticks", "100", *words])
    err = capsys.readouterr().err
    assert "tick 30, crowd_2: the deviation function J is no longer finite. Lower it." in err
    assert "Traceback" not in err
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["stopped_at"] == 29
    assert "crowd_2" in summary["stopped_by"]
    assert pq.read_table(tmp_path / "out/metrics.parquet").num_rows == 29 * 12
    assert checkpoint.read(tmp_path / "out/checkpoint")["tally"][1]["tick"] == 20


def test_a_plan_is_what_its_config_says(tmp_path: Path) -> None:
    """Writing a plan and reading it back gives the same plan."""
    plan = resolve("paper", learners=["hjb"], changes={"learner.gamma": 0.9, "heading": False}, seed=4)
    path = tmp_path / "config.toml"
    path.write_text(plan.to_toml())
    again = resolve(config=read_config(path))
    assert again.to_toml() == plan.to_toml()
    assert again.settings["set_points"] == (1.0, 2.0, 3.0, 4.0)


def test_runs_differ_by_their_seed() -> None:
    """Learners and world of different seeds draw different numbers, of one seed the same."""

    def first(seed: int) -> list[int]:
        plan = resolve("seasons", learners=["random"], seed=seed)
        run = Run(plan, Path(os.devnull))
        tick, chosen = run.tick, []
        for _ in range(20):
            action = run.learners["agent"].act(tick.observations["agent"], tick.masks["agent"])
            chosen.append(int(action[0]))
            tick = run.env.step_arrays(action)
        return chosen

    assert first(1) == first(1)
    assert first(1) != first(2)
