"""A fork: two futures of one world, which are the same where nothing was changed."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from same_end import same_end

from ecology.agents import checkpoint
from ecology.lab.cli import main
from ecology.lab.runs.run import open_run
from ecology.state import CAUSES

CROWD = """
'''Wide bodies in a small room: they touch each other and the walls at every tick.'''
from ecology import Arena, Drift, Need, Oscillation, Resource, Scenario, Species, consume, go_to, move, rest, turn

def build(decay=0.01, noise=0.02, count=8, width=4.0, dt=1.0, place=1.0, herds=3, lost=False):
    need = Need(name="food", set_point=2.0, decay=decay, noise=noise, bounds=(0.0, 4.0))
    actions = (rest(), move("walk", 0.3), turn("left", 0.7), turn("right", -0.7),
               consume("berries", {"food": 0.1}), go_to("berries", 0.2))
    crowd = Species(name="crowd", needs=(need,), actions=actions, count=count, radius=0.2, learner="random")
    resources = (Resource(name="berries", position=(place, 1.0)), Resource(name="herds", count=herds),
                 Resource(name="swing", position=(0.5, 0.5), motion=Oscillation(to=(1.0, 0.5), period=9.0)))
    return Scenario(name="crowd", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(crowd,),
                    resources=resources[: 2 if lost else 3], dt=dt, ticks=120)
"""
SMALL = ("--set", "learner.width=4", "--set", "learner.memory=50")
Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def ecology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the command line in a folder that holds crowd.py: words -> exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    Path("crowd.py").write_text(CROWD)

    def type_(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as left:
            main(words)
        return int(left.value.code or 0), *capsys.readouterr()

    return type_


@pytest.fixture(scope="module")
def lived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with crowd.py and ./run, which has lived 120 ticks, states kept at 40, 80 and 120."""
    folder = tmp_path_factory.mktemp("lived")
    (folder / "crowd.py").write_text(CROWD)
    with contextlib.chdir(folder), pytest.raises(SystemExit, match=r"^0$"):
        main(["run", "crowd.py", "--keep-every", "40", "--out", "run", "--no-record", "--quiet"])
    return folder


@pytest.fixture
def original(ecology: Command, lived: Path) -> Command:
    """Return the same command line where ./run has lived."""
    shutil.copytree(lived, ".", dirs_exist_ok=True)
    return ecology


@pytest.mark.parametrize("at", ["0", "40", "57", "80", "119"])
def test_a_fork_without_a_change_is_the_original(original: Command, at: str) -> None:
    """From any tick, kept or lived up to, world, learners, memories and random streams end bit for bit the same."""
    assert original("fork", "run", "--at", at, "--quiet") == (0, "", "")
    same_end("run", f"run-at-{at}")


def test_a_fork_of_those_who_learn_is_the_original(ecology: Command) -> None:
    """The same holds for networks, their optimisers and memories, and with metrics and recording."""
    Path("crowd.py").write_text(CROWD.replace("count=8", "count=2"))
    words = ("--learner", "hjb", *SMALL, "--keep-every", "50", "--out", "run", "--quiet")
    assert ecology("run", "crowd.py", *words) == (0, "", "")
    assert ecology("fork", "run", "--at", "70", "--out", "other", "--quiet") == (0, "", "")
    same_end("run", "other")
    assert Path("other/recording.rrd").stat().st_size > 0
    metrics = [pq.read_table(f"{folder}/metrics.parquet") for folder in ("run", "other")]
    late = metrics[0].filter(np.array(metrics[0]["tick"]) > 70)
    assert late.num_rows == 5 * 2
    assert late.equals(metrics[1])


def test_what_is_changed_is_changed_from_then_on(original: Command) -> None:
    """A setting, an agent that is gone and a resource elsewhere: the past is the original's, the future is not."""
    assert original("fork", "run", "--at", "60", "--set", "decay=0.5", "--out", "hungry", "--quiet")[0] == 0
    words = ("--remove", "crowd_3", "--remove", "crowd_5", "--move", "berries=0.5,1.5", "--move", "herds.1=1,1")
    assert original("fork", "run", "--at", "60", *words, "--out", "fewer", "--quiet")[0] == 0
    was, hungry, fewer = (checkpoint.read(Path(each, "checkpoint")) for each in ("run", "hungry", "fewer"))
    drive = {name: parts["tally"][0]["drive"] for name, parts in (("was", was), ("hungry", hungry), ("fewer", fewer))}
    assert (drive["was"][:60] == drive["hungry"][:60]).all()
    assert (drive["was"][:60] == drive["fewer"][:60]).all()
    assert drive["hungry"][-1] > 2 * drive["was"][-1]
    world = fewer["world"][0]
    assert np.flatnonzero(~world["alive"]).tolist() == [3, 5]
    assert {CAUSES[i] for i in world["cause"][[3, 5]]} == {"rule"}
    assert (fewer["tally"][0]["living"][:, 0] == [8] * 60 + [6] * 60).all()
    assert world["resource_position"][[0, 2]].tolist() == [[0.5, 1.5], [1.0, 1.0]]
    assert (world["resource_position"][[1, 3]] == was["world"][0]["resource_position"][[1, 3]]).all()
    summary = json.loads(Path("hungry/summary.json").read_text())
    assert summary["forked_at"] == 60
    assert summary["mean_drive_since_fork"] == pytest.approx(drive["hungry"][60:].mean() / 8)


def test_a_fork_is_a_run_like_any_other(original: Command) -> None:
    """It says whose it is, is gone on with and is forked again, but is not begun from its config alone."""
    assert (
        original("fork", "run", "--at", "60", "--set", "decay=0.5", "--ticks", "90", "--out", "new", "--quiet")[0] == 0
    )
    assert 'run = "' in Path("new/config.toml").read_text()
    assert original("run", "--resume", "new", "--ticks", "120", "--quiet")[0] == 0
    assert original("fork", "run", "--at", "60", "--set", "decay=0.5", "--out", "whole", "--quiet")[0] == 0
    same_end("new", "whole")
    assert original("fork", "new", "--at", "75", "--out", "again", "--quiet")[0] == 0
    same_end("new", "again")
    code, _, err = original("run", "--config", "new/config.toml", "--out", "nowhere")
    assert code == 2
    assert "ecology fork" in err
    code, _, err = original("fork", "new", "--at", "50", "--out", "nowhere")
    assert code == 2
    assert "known at tick 60, 80, 90, 120" in err
    assert "from 60 to 120" in err
    assert not Path("nowhere").exists()


def test_a_damaged_state_is_passed_over(original: Command) -> None:
    """Where kept states are damaged or gone, an earlier one is lived on from, to the same."""
    for path in Path("run").rglob("world.safetensors"):
        path.write_bytes(b"")
    assert original("fork", "run", "--at", "90", "--out", "other", "--quiet")[0] == 0
    shutil.rmtree("run/checkpoints")
    assert original("fork", "run", "--at", "90", "--out", "third", "--quiet")[0] == 0
    same_end("other", "third")
    assert checkpoint.read(Path("other/checkpoint"))["tally"][1]["tick"] == 120


ISLAND = """
from ecology import Arena, Need, Resource, Scenario, Species, consume, go_to, move, rest

def build(arrival=0.0):
    need = Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0))
    actions = (rest(), move("walk", 0.3), consume("berries", {"food": 0.1}), go_to("berries", 0.2))
    crowd = Species(name="crowd", needs=(need,), actions=actions, solid=False, count=4, capacity=4, arrival=arrival)
    return Scenario(name="island", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(crowd,),
                    resources=(Resource(name="berries", position=(1.0, 1.0)),), ticks=120)
"""


@pytest.mark.parametrize("arrival", ["0.0", "9.0"])
def test_who_is_removed_dies_to_its_learner_too(ecology: Command, arrival: str) -> None:
    """What was under way ends, and of the removed one's mind nothing is left in who takes its slot."""
    Path("island.py").write_text(ISLAND)
    words = ("--learner", "hjb", *SMALL, "--set", "learner.batch=4", "--set", "learner.inherit=true", "--no-record")
    assert ecology("run", "island.py", *words, "--ticks", "60", "--out", "run", "--quiet") == (0, "", "")
    change = ("--remove", "crowd_2", "--set", f"arrival={arrival}", "--ticks", "61", "--out", "new")
    assert ecology("fork", "run", "--at", "60", *change, "--quiet")[0] == 0
    was, new = (checkpoint.read(Path(where, "checkpoint"))["learner_crowd"][0] for where in ("run", "new"))
    world = checkpoint.read(Path("new/checkpoint"))["world"][0]
    assert was["movement"][2] >= 0
    assert was["memory.count"][2] > 0
    assert new["movement"][2] == -1
    assert (new["age"][[0, 1, 3]] == was["age"][[0, 1, 3]] + 1).all()
    if arrival == "0.0":
        assert world["alive"].tolist() == [True, True, False, True]
        assert new["memory.count"][2] == was["memory.count"][2]  # being gone is no experience
    else:
        assert world["serial"].tolist() == [0, 1, 4, 3]
        assert new["memory.count"][2] == new["age"][2] == new["cell_count"][2] == new["adam_f.steps"][2].max() == 0
        for network in ("f", "J"):
            drawn = was[network][2] != 0  # biases begin at 0
            assert (new[network][2] != was[network][2])[drawn].all()


def test_births_are_counted_on_in_forks_of_forks(ecology: Command) -> None:
    """Who was removed from a world, or from one before it, was no newcomer there."""
    Path("island.py").write_text(ISLAND)
    words = ("--learner", "random", "--no-record", "--set", "arrival=9.0", "--quiet")
    assert ecology("run", "island.py", *words, "--ticks", "10", "--out", "run")[0] == 0
    for before, at, gone in (("run", "10", "crowd_2"), ("first", "15", "crowd_0"), ("second", "20", "crowd_4")):
        out = {"run": "first", "first": "second", "second": "third"}[before]
        change = ("--remove", gone, "--ticks", str(int(at) + 5), "--out", out, "--quiet")
        assert ecology("fork", before, "--at", at, *change)[0] == 0
    assert open_run(Path("third"), 25).born_and_died() == ([0], [0])  # before it is restored: nothing has happened
    it = open_run(Path("third"), 26)
    it.resume()
    assert it.born_and_died() == ([3], [0])
    assert json.loads(Path("third/summary.json").read_text())["births"] == 3


BAD = {
    "beyond its end": (["--at", "130", "--ticks", "200"], "from 0 to 120"),
    "no future": (["--at", "120"], "--ticks"),
    "an unknown setting": (["--set", "decy=1"], "'decay'"),
    "another tick": (["--set", "dt=0.5"], "length of a tick"),
    "another number of agents": (["--set", "count=9"], "how many slots there are: 'crowd' has 8, got 9"),
    "another number of patches": (["--set", "herds=4"], "how many patches there are: 'herds' has 3, got 4"),
    "another world": (["--set", "lost=true"], "cannot add or remove"),
    "a setting told twice": (["--set", "decay=0.1", "--set", "decay=0.2"], "write --set decay=0.2 alone"),
    "a place told twice": (["--move", "berries=1,1", "--move", "berries=1,1.5"], "write --move berries=1,1.5 alone"),
    "a place of the start": (["--set", "place=0.5"], "--move berries=x,y"),
    "nobody": (["--remove", "crowd_9"], "'crowd_7'"),
    "no resource": (["--move", "bery=1,1"], "'berries'"),
    "no place": (["--move", "berries=1"], "RESOURCE=x,y"),
    "outside": (["--move", "berries=3,1"], "outside"),
    "a place of NaN": (["--move", "berries=nan,1"], "RESOURCE=x,y"),
    "which patch": (["--move", "herds=1,1"], "herds.0=x,y"),
    "no such patch": (["--move", "herds.3=1,1"], "3 patches"),
    "on its own way": (["--move", "swing=1,1"], "oscillates"),
    "itself": (["--out", "run"], "already holds a run"),
    "nothing to fork": (["nothing"], "unexpected"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_words_are_one_clear_error(original: Command, case: str) -> None:
    """What cannot be forked gives exit code 2, says why, and leaves all as it was."""
    words, named = BAD[case]
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    code, _, err = original("fork", "run", "--quiet", *(() if "--at" in words else ("--at", "60")), *words)
    assert code == 2
    assert named in err
    assert "Traceback" not in err
    assert {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()} == before


def test_an_evaluation_is_told_a_setting_once(original: Command) -> None:
    """`evaluate` refuses a setting that is told twice, as `fork` does, and writes nothing."""
    before = list(Path("run").iterdir())
    code, _, err = original("evaluate", "run", "--set", "decay=0.1", "--set", "decay=0.2")
    assert code == 2
    assert "write --set decay=0.2 alone" in err
    assert list(Path("run").iterdir()) == before


def test_kept_states_are_those_of_their_ticks(original: Command) -> None:
    """`--keep-every` keeps a whole checkpoint under its tick; a resumed run cannot change it."""
    assert sorted(path.name for path in Path("run/checkpoints").iterdir()) == ["120", "40", "80"]
    for tick in (40, 80, 120):
        assert checkpoint.read(Path(f"run/checkpoints/{tick}"))["tally"][1]["tick"] == tick
    code, _, err = original("run", "--resume", "run", "--ticks", "200", "--keep-every", "10")
    assert code == 2
    assert "--keep-every" in err
