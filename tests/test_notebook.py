"""The page "From a notebook", executed, and `agents.load`, which it is about."""

from __future__ import annotations

import inspect
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from ecology import EcologyError, agents
from ecology.agents import checkpoint, lives, loop
from ecology.lab.cli import main

PAGE = (Path(__file__).parent.parent / "docs" / "guides" / "notebook.md").read_text(encoding="utf-8")


def ecology(*words):
    """Type a command that succeeds."""
    with pytest.raises(SystemExit) as left:
        main(words)
    assert left.value.code in (0, None)


def test_every_block_of_the_page_runs(tmp_path, monkeypatch, capsys):
    """The blocks run one after the other in an empty folder, and do what the text around them says."""
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```(\w*)\n(.*?)```", PAGE, flags=re.DOTALL)
    assert {kind for kind, _ in blocks} == {"sh", "python"}
    names = {}
    for kind, text in blocks:
        if kind == "sh":
            for line in text.splitlines():
                ecology(*shlex.split(line)[1:])
        else:
            exec(compile(text, "notebook.md", "exec"), names)
    said = capsys.readouterr().out
    assert "1500" in said
    assert "watched 100 ticks" in said
    usual, met = names["futures"].values()
    assert len(usual) == len(met) == 200
    assert met[0] < 0.2 < usual[0]  # a tick after it; the drive of no deviation is the square root of epsilon
    assert names["trace"].ticks == list(range(1001, 1201))
    assert names["metrics"]["tick"][-1] == names["summary"]["ticks"] == 1000  # loading changed no file


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a run of several species that are born, bite and die."""
    path = tmp_path_factory.mktemp("runs") / "mine"
    words = ("--learner", "qvalue", "--ticks", "60", "--no-record", "--quiet", "--out", str(path))
    ecology("run", "predator_prey", *words)
    return path


def test_a_loaded_run_continues_bit_for_bit(folder, tmp_path):
    """What is lived after `agents.load` is what `--resume` lives, and the folder is not changed by it."""
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    env, learners, tick = agents.load(str(folder))
    assert [*learners] == [*env.groups]
    assert env.state_view.tick == 60
    loop.run(env, learners, tick, 40)
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before
    ecology("run", "--resume", str(folder), "--ticks", "100", "--quiet")
    parts = checkpoint.read(folder / "checkpoint")
    for name, array in env.snapshot()[0].items():
        assert np.array_equal(array, parts["world"][0][name], equal_nan=True), name
    for species, learner in learners.items():
        for name, array in learner.state()[0].items():
            assert np.array_equal(array, parts[f"learner_{species}"][0][name]), name


def test_a_frozen_learner_learns_nothing(tmp_path):
    """With `frozen`, all that a learner has become stays as it was, and it explores as an evaluation does."""
    words = ("--learner", "qvalue", "--ticks", "40", "--no-record", "--quiet", "--out", str(tmp_path / "mine"))
    ecology("run", "commons", *words)
    env, learners, tick = agents.load(tmp_path / "mine", frozen=True)
    before = {name: {key: array.copy() for key, array in mind.state()[0].items()} for name, mind in learners.items()}
    loop.run(env, learners, tick, 20)
    for name, learner in learners.items():
        assert not learner.learning
        for key, array in learner.state()[0].items():
            assert np.array_equal(array, before[name][key]), key
    assert inspect.signature(agents.load).parameters["epsilon"].default == lives.EPSILON


def test_what_cannot_be_loaded_is_one_clear_error(folder, tmp_path):
    """A folder without a run, one without a checkpoint and one that is damaged are told apart."""
    with pytest.raises(EcologyError, match="holds no run"):
        agents.load(tmp_path)
    (tmp_path / "config.toml").write_bytes((folder / "config.toml").read_bytes())
    with pytest.raises(EcologyError, match="there is no checkpoint"):
        agents.load(tmp_path)
    (tmp_path / "checkpoint").mkdir()
    (tmp_path / "checkpoint" / "checkpoint.json").write_text("{")
    with pytest.raises(EcologyError, match="damaged"):
        agents.load(tmp_path)
