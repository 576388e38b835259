"""The benchmark, in its short form: that it measures what it says, not how fast it is."""

from __future__ import annotations

import os
import sys

import numpy as np
import pyarrow.parquet as pq
import pytest

from ecology import agents
from ecology.agents import loop
from ecology.lab.bench import speed
from ecology.lab.cli import main

SHORT = ["bench", "--rounds", "2", "--seconds", "0", "--quiet"]


def refused(capsys, *words):
    """Return what a benchmark that is refused says."""
    with pytest.raises(SystemExit) as stop:
        main([*SHORT, *words])
    assert stop.value.code == 2
    return capsys.readouterr().err


def test_a_short_benchmark_leaves_a_table_and_a_figure(tmp_path):
    """Every world has a row per round and number of agents, whose agent-steps are its ticks times its agents."""
    before = os.sched_getaffinity(0)
    with pytest.raises(SystemExit, match="0"):
        main([*SHORT, "--agents", "12", "--learner", "algorithm1", "--out", str(tmp_path / "out")])
    rows = pq.read_table(tmp_path / "out" / "bench.parquet").to_pylist()
    expected = [(name, 12, turn) for turn in (0, 1) for name in ("arrays", "dicts", "algorithm1")]
    assert [(row["name"], row["agents"], row["round"]) for row in rows] == expected
    for row in rows:
        assert row["ticks"] >= (speed.LEARNS if row["name"] == "algorithm1" else speed.LEAST)
        assert row["agent_steps"] == row["ticks"] * row["agents"]
        assert row["agent_steps_per_second"] == pytest.approx(row["agent_steps"] / row["cpu_seconds"])
        assert row["calibration_seconds"] > 0
        assert '"numpy"' in row["versions"]
    assert (tmp_path / "out" / "bench.png").read_bytes().startswith(b"\x89PNG")
    assert os.sched_getaffinity(0) == before


def test_medians_and_quartiles_are_over_rounds():
    """Of 1 to 5 the median is 3 and the quartiles are 2 and 4."""
    rows = [{"name": "arrays", "agents": 7, "agent_steps_per_second": float(v)} for v in (5, 1, 4, 2, 3)]
    assert speed.speeds(rows) == [speed.Speed(name="arrays", agents=7, median=3.0, low=2.0, high=4.0)]


@pytest.mark.parametrize("what", ["arrays", "dicts", "algorithm1", "algorithm1-dicts"])
def test_a_point_steps_the_world_it_names(what, monkeypatch):
    """A tick of a point is one tick of one world with walls, sight, eight neighbours and that many agents.

    Who learns has lived in it before.
    """
    worlds = []
    monkeypatch.setattr(speed, "LIVED", 7)
    monkeypatch.setattr(speed, "parallel_env", lambda scenario: worlds.append(speed.Ecology(scenario)) or worlds[-1])
    step = speed.stepping(what, 5)
    assert [step() for _ in range(3)] == [5, 5, 5]
    (env,) = worlds
    assert env.state_view.tick == (10 if what == "algorithm1" else 3)  # the dicts are those of a life started over
    assert env.size == 5
    assert len(env.scenario.arena.vertices) > 4
    assert sum(name.endswith("_distance") for name in env.groups["agent"].layout.names if "other" in name) == 8


def test_other_worlds_run_in_their_own_python():
    """Each other world is timed where it has room, by the Python that was given for it."""
    found = speed.points([1, 10, 5000], [], {"waterworld": "/elsewhere/python", "vmas": sys.executable})
    others = [(p.name, p.agents, p.command[0]) for p in found if p.name not in ("arrays", "dicts")]
    assert others == [("waterworld", 10, "/elsewhere/python"), ("vmas", 10, sys.executable)]


def test_a_world_that_is_not_installed_says_what_to_install(tmp_path, capsys):
    """Where the library is missing, the error names it and what to do."""
    blocked = tmp_path / "python"
    blocked.write_text(f'#!/bin/sh\nexec {sys.executable} -S "$@"\n')  # a Python without anything installed
    blocked.chmod(0o755)
    words = ["--agents", "2", "--learner", "none", "--out", str(tmp_path / "out")]
    for name, advice in (("waterworld", "pettingzoo==1.25.0"), ("mpe2", "pip install -e '.[bench]'")):
        said = refused(capsys, *words, "--against", name, "--python", f"{name}={blocked}")
        assert "No module named" in said
        assert advice in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--agents", "0"], "--agents takes whole numbers"),
        (["--agents", "many"], "--agents takes whole numbers"),
        (["--against", "watterworld"], "waterworld"),
        (["--python", "mpe2=/nowhere"], "name it in --against"),
        (["--agents", "4", "--against", "mpe2", "--python", "mpe2=/nowhere"], "cannot be started"),
        (["--learner", "algorithm2"], "algorithm1"),
        (["--core", "100000"], "--core"),
    ],
)
def test_what_cannot_be_measured_is_refused(words, said, tmp_path, capsys):
    """A user's error is one message and exit code 2, and nothing is written."""
    assert said in refused(capsys, "--agents", "1", *words, "--out", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_a_benchmark_is_not_overwritten(tmp_path, capsys):
    """A folder that holds a benchmark is left as it is."""
    (tmp_path / "bench.parquet").write_text("mine")
    assert "give another" in refused(capsys, "--out", str(tmp_path))
    assert (tmp_path / "bench.parquet").read_text() == "mine"


def test_who_learns_through_dicts_learns_the_same():
    """Networks are the same bit for bit as those of a learner that is given arrays."""
    weights = []
    for through in (False, True):
        env = speed.world(5)
        (group,) = env.groups.values()
        learner = agents.make("algorithm1", group, np.random.SeedSequence(0), {})
        tick = env.reset_arrays(seed=0)
        if through:
            step = speed._through_dicts(env, learner)
            assert [step() for _ in range(20)] == [5] * 20
        else:
            loop.run(env, {group.name: learner}, tick, 20)
        weights.append(learner.J.weights.copy())
    assert np.array_equal(*weights)
    assert not np.array_equal(weights[0][0], weights[0][1])
