"""A checkpoint whose values no run comes to, its digests in order, is one clear error, and never a hang."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ecology import EcologyError
from ecology.agents import checkpoint
from ecology.lab.cli import main
from ecology.lab.runs.folder import CHECKPOINT
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import resolve


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run with births, deaths and learners that learn."""
    out = tmp_path_factory.mktemp("tampered") / "run"
    small = {"prey.learner.memory": 200, "prey.learner.place_cells": 20}
    plan = resolve("predator_prey", learners=["lean", "predator=greedy"], changes=small, ticks=60, record=False)
    run = Run(plan, out)
    run.start()
    run.live()
    return out


def array(part: str, name: str, value: float, *at: Any) -> Callable[[Any], None]:
    """Return what puts `value` into an array of a part, everywhere or at a place."""

    def change(parts: Any) -> None:
        parts[part][0][name][at or ...] = value

    return change


def emptied(part: str, name: str) -> Callable[[Any], None]:
    """Return what leaves nothing of an array."""

    def change(parts: Any) -> None:
        parts[part][0][name] = parts[part][0][name][:0]

    return change


def plain(part: str, value: Any, *path: str) -> Callable[[Any], None]:
    """Return what sets a plain value of a part."""

    def change(parts: Any) -> None:
        inner = parts[part][1]
        for key in path[:-1]:
            inner = inner[key]
        inner[path[-1]] = value

    return change


NAN, INF = float("nan"), float("inf")
WRONG = {
    "told far": array("world", "told_position", 1e12, 0),
    "told fast": array("world", "told_velocity", 1e12, 0),
    "told nan": array("world", "told_velocity", NAN, 0),
    "cause 99": array("world", "cause", 99, 0),
    "cause of the living": array("world", "cause", 1),
    "position nan": array("world", "position", NAN, 0),
    "position far": array("world", "position", 1e12, 0),
    "heading": array("world", "heading", 1e12, 0),
    "action": array("world", "action", 10_000, 0),
    "bit": array("world", "bit", 10_000, 0),
    "serial twice": array("world", "serial", 0),
    "age": array("world", "age", -1.0, 0),
    "stock": array("world", "stock", -1.0, 0),
    "stock without end": array("world", "stock", INF, 0),
    "stock beyond its capacity": array("world", "stock", 1e30, 0),
    "resource": array("world", "resource_position", INF, 0),
    "drive": array("world", "drive", INF, 0),
    "tick": plain("world", -5, "state", "tick"),
    "tick of text": plain("world", "5", "state", "tick"),
    "tick of another": plain("world", 59, "state", "tick"),
    "time": plain("world", NAN, "state", "time"),
    "another field": plain("world", 1, "state", "alive"),
    "empty sums": emptied("tally", "drive"),
    "empty counts": emptied("tally", "actions"),
    "sums nan": array("tally", "drive", NAN),
    "sums negative": array("tally", "own_drive", -1.0, 0),
    "more closed than asked for": plain("tally", 10**30, "closed"),
    "counts negative": array("tally", "lived", -1),
    "more born than could be": array("tally", "births", 1_000_000, 0),
    "sums in no block": plain("tally", 3, "span"),
    "seconds": plain("tally", [1.0], "seconds"),
    "weights nan": array("learner_prey", "f", NAN, 0, 0),
    "movement": array("learner_prey", "movement", 10_000, 0),
    "remembered movement": array("learner_prey", "memory.movement", 10_000, 0, 0),
    "stage": array("learner_prey", "stage", 2, 0),
    "left": array("learner_prey", "left", 2**40, 0),
    "count": array("learner_prey", "memory.count", -1, 0),
    "ticks of a learner": plain("learner_prey", -1, "ticks"),
    "met": array("learner_predator", "met", -1.0, 0),
    "mean": emptied("learner_predator", "mean"),
    "interventions": plain("run", -3, "interventions"),
    "frozen": plain("run", ["nobody"], "frozen"),
}


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG.keys())
def test_values_that_no_run_comes_to_are_refused(run: Path, change: Callable[[Any], None], tmp_path: Path) -> None:
    """Whatever is wrong, the run is not resumed."""
    parts = checkpoint.read(run / CHECKPOINT)
    change(parts)
    again = open_run(run, 80)
    again.folder = tmp_path
    checkpoint.write(tmp_path / CHECKPOINT, parts)
    with pytest.raises(EcologyError, match="is damaged or foreign"):
        again.restore()


def test_what_was_not_tampered_with_is_restored(run: Path) -> None:
    """The checks let pass what a run wrote."""
    again = open_run(run, 80)
    again.restore()
    assert again.now == 60


@pytest.mark.parametrize(
    "name", ["summary.json.new", "metrics.parquet.joined", "recording.unfinished.rrd", "checkpoints", "figures", "x/y"]
)
def test_links_are_not_followed(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What a link in a run folder leads to stays as it is: files and folders."""
    plan = resolve("seasons", learners=["random"], ticks=20, record=False)
    run, away = Run(plan, tmp_path / "run"), tmp_path / "away"
    run.start()
    run.live()
    away.mkdir()
    (away / "file").write_text("mine")
    link = run.folder / name
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(away if "." not in name else away / "file")
    for words in (
        ("run", "--resume", str(run.folder), "--ticks", "40"),
        ("evaluate", str(run.folder), "--ticks", "20"),
    ):
        with pytest.raises(SystemExit) as left:
            main([*words, "--quiet"])
        assert left.value.code == 2
        assert f"{name}' is a link to" in capsys.readouterr().err
    assert [path.name for path in away.iterdir()] == ["file"]
    assert (away / "file").read_text() == "mine"


@pytest.mark.parametrize("name", ["world.json", "checkpoint/checkpoint.json", "recording.rrd", "summary.json", "x"])
def test_a_pipe_is_not_waited_for(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A pipe in a run folder, which nobody writes to, is one error wherever the folder is read."""
    run = Run(resolve("seasons", learners=["random"], ticks=10, record=False), tmp_path / "run")
    run.start()
    run.live()
    (run.folder / "recording.rrd").write_bytes(b"RRF2")
    (run.folder / name).unlink(missing_ok=True)
    os.mkfifo(run.folder / name)
    for words in (
        ("run", "--resume", "run", "--ticks", "40"),
        ("evaluate", "run"),
        ("fork", "run", "--at", "5", "--out", "fork"),
        ("film", "run", "film.gif"),
        ("view", "run", "--focus", "agent_0"),
        ("do", "run", "empty food"),
    ):
        command = [words[0], *(str(tmp_path / word) if word in ("run", "fork") else word for word in words[1:])]
        with pytest.raises(SystemExit) as left:
            main(command)
        assert left.value.code == 2
        assert "is neither a file nor a folder" in capsys.readouterr().err or name == "recording.rrd"


def test_a_text_does_not_go_through_a_link(tmp_path: Path) -> None:
    """The file that is written beside is a new one."""
    from ecology.lab.runs.folder import replace_text

    (tmp_path / "mine").write_text("mine")
    (tmp_path / "file.new").symlink_to(tmp_path / "mine")
    replace_text(tmp_path / "file", "text")
    assert (tmp_path / "mine").read_text() == "mine"
    assert (tmp_path / "file").read_text() == "text"
    assert not (tmp_path / "file").is_symlink()
