"""What the command line refuses, and how it says so."""

from __future__ import annotations

import errno
import json
import os
import tomllib
from pathlib import Path
from typing import Any

import pytest
from conftest import Command
from worlds import OPTIONAL

from ecology.lab.values import read_value

BAD = {
    "scenario": (["papr"], "'paper'"),
    "no scenario": ([], "paper"),
    "scenario file": (["nowhere.py"], "nowhere.py"),
    "learner": (["paper", "--learner", "randon"], "'random'"),
    "species of a learner": (["paper", "--learner", "agnt=rest"], "'agent'"),
    "setting": (["paper", "--set", "decy=1"], "'decay'"),
    "setting's kind": (["paper", "--set", "decay=much"], "'much'"),
    "setting without a value": (["paper", "--set", "decay"], "KEY=VALUE"),
    "setting told twice": (
        ["paper", "--set", "decay=0.1", "--set", "decay=0.2"],
        "got '0.1' and '0.2'; write --set decay=0.2 alone",
    ),
    "setting of nobody": (["paper", "--set", "body.decay=1"], "'body.decay'"),
    "learner's setting": (["paper", "--learner", "hjb", "--set", "learner.gama=1"], "'gamma'"),
    "learner's setting of a species": (["paper", "--set", "agnt.learner.gamma=1"], "'agent'"),
    "learner without settings": (["paper", "--set", "learner.gamma=0.9"], "'gamma'"),
    "learner's value": (["paper", "--learner", "hjb", "--set", "learner.gamma=2"], "gamma"),
    "ticks": (["paper", "--ticks", "0"], "--ticks"),
    "out": (["paper", "--out", ""], "got '' after --out"),
    "out in one word": (["paper", "--out="], "got '' after --out"),
    "empty scenario": ([""], "no word is empty"),
    "seed": (["paper", "--seed", "-1"], "--seed"),
    "device": (["paper", "--device", "gpu"], "'gpu'"),
    "device of no use": (["paper", "--device", "cuda"], "'random' computes on the CPU alone"),
    "device that is not here": (["paper", "--learner", "hjb", "--device", "cuda:99"], "there is cpu"),
    "need named like a number that its mind reports": (["clash.py", "--learner", "hjb"], "'epsilon'"),
    "setting of --record": (["paper", "--record", "often=3"], "'often'"),
    "value of --record": (["paper", "--record", "every=x"], "every=x"),
    "key of --record told twice": (["paper", "--record", "every=2,every=3"], "write --record every=3 alone"),
    "detail of --record": (["paper", "--record", "detail=most"], "'most'"),
    "focus": (["paper", "--focus", "wolf_3", "--record", "every=5"], "'wolf_3'"),
    "viewer's address": (["paper", "--connect", "nowhere"], "'nowhere'"),
    "config": (["paper", "--config", "nowhere.toml"], "nowhere.toml"),
}


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("record", ["--record", "--no-record"])
def test_bad_words_are_one_clear_error(short: Command, case: str, record: str) -> None:
    """A bad word gives exit code 2, a message that names it, no traceback, and no folder."""
    words, named = BAD[case]
    if "clash.py" in words:
        Path("clash.py").write_text(FILE.format(change="").replace("food", "epsilon"))
    code, out, err = short(*words, record)
    Path("clash.py").unlink(missing_ok=True)
    assert code == 2
    assert named in err
    assert "Traceback" not in err
    assert out == ""
    assert list(Path().iterdir()) == []


BAD_FILES = {
    "does not parse": ("def build(:", "world.py"),
    "fails": ("1 / 0", "ZeroDivisionError"),
    "builds nothing": ("", "build"),
    "overlapping walls": ("ARENA = ((0, 0), (4, 4), (4, 0), (0, 4))", "walls"),
    "resource outside": ("PLACE = (9.0, 9.0)", "outside"),
    "set point outside its bounds": ("SET_POINT = 7.0", "bounds"),
    "unknown need in an action": ("EATS = 'foood'", "'food'"),
    "unwritable setting": ("EXTRA = ', rule=max'", "rule"),
}


FILE = """
from ecology import Arena, Need, Resource, Scenario, Species, consume, rest
ARENA, PLACE, SET_POINT, EATS, EXTRA = ((0, 0), (4, 0), (4, 4), (0, 4)), (1.0, 1.0), 2.0, 'food', ''
{change}
exec(f'''def build(decay=0.01{{EXTRA}}):
    need = Need(name="food", set_point=SET_POINT, decay=decay, bounds=(0.0, 4.0))
    agent = Species(name="agent", needs=(need,), actions=(rest(), consume("berries", {{{{EATS: 0.1}}}})))
    return Scenario(name="world", arena=Arena(vertices=ARENA), species=(agent,),
                    resources=(Resource(name="berries", position=PLACE),))''')
"""


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_scenario_file_is_one_clear_error(short: Command, case: str) -> None:
    """A scenario file that does not run or contradicts itself gives exit code 2 and says why."""
    change, named = BAD_FILES[case]
    whole = case in ("does not parse", "fails", "builds nothing")
    Path("world.py").write_text(change if whole else FILE.format(change=change))
    code, _, err = short("world.py")
    assert code == 2
    assert named in err
    assert "Traceback" not in err
    assert not Path("runs").exists()


def test_the_scenario_file_of_these_tests_is_good_unchanged(short: Command) -> None:
    """The file that the tests of bad files start from runs."""
    Path("world.py").write_text(FILE.format(change=""))
    assert short("world.py", "--quiet") == (0, "", "")


def test_a_run_is_never_overwritten(short: Command) -> None:
    """A folder that holds a run is refused by name, and left as it was."""
    assert short("paper", "--out", "mine")[0] == 0
    before = {path: path.read_bytes() for path in Path("mine").rglob("*") if path.is_file()}
    code, _, err = short("paper", "--seed", "5", "--out", "mine")
    assert code == 2
    assert "'mine'" in err
    assert "Traceback" not in err
    assert {path: path.read_bytes() for path in Path("mine").rglob("*") if path.is_file()} == before


def test_an_out_that_is_no_folder_is_an_error(short: Command) -> None:
    """--out at a file gives exit code 2."""
    Path("file").write_text("mine")
    code, _, err = short("paper", "--out", "file")
    assert code == 2
    assert "'file'" in err
    assert Path("file").read_text() == "mine"


def test_a_config_repeats_its_run(short: Command, ecology: Command) -> None:
    """A run from the config.toml of another comes to the same."""
    assert short("paper", "--out", "first", "--seed", "7", "--set", "decay=0.01")[0] == 0
    assert ecology("run", "--config", "first/config.toml", "--out", "second")[0] == 0
    first, second = (json.loads(Path(name, "summary.json").read_text()) for name in ("first", "second"))
    for figures in (first, second):
        for key in ("wall_seconds", "cpu_seconds", "learner_cpu_seconds", "agent_steps_per_second"):
            del figures[key]
    assert first == second
    assert Path("first/config.toml").read_text() == Path("second/config.toml").read_text()


def test_flags_go_before_the_config(short: Command, ecology: Command) -> None:
    """What is typed beside --config changes that, and nothing else."""
    assert short("paper", "--out", "first", "--set", "decay=0.01")[0] == 0
    words = ("--ticks", "11", "--seed", "4", "--learner", "rest", "--set", "intake=0.2")
    assert ecology("run", "--config", "first/config.toml", "--out", "second", *words)[0] == 0
    config = tomllib.loads(Path("second/config.toml").read_text())
    assert (config["ticks"], config["seed"], config["learners"]["agent"]["name"]) == (11, 4, "rest")
    assert (config["settings"]["decay"], config["settings"]["intake"]) == (0.01, 0.2)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("scenario = ", "TOML"),
        ("scenaro = 'paper'", "'scenario'"),
        ("scenario = 3", "scenario"),
        ("scenario = 'seasons'", "'seasons'"),
        ("record_every = 0", "record_every"),
        ("[settings]\ndecy = 1", "'decay'"),
        ("[learners.agnt]\nname = 'rest'", "'agent'"),
        ("[learners]\nagent = 'rest'", "learners.agent"),
    ],
)
def test_a_bad_config_is_one_clear_error(ecology: Command, text: str, named: str) -> None:
    """A config that is not TOML, or has unknown keys or values, gives exit code 2 and says where."""
    Path("config.toml").write_text(text)
    code, _, err = ecology("run", "paper", "--ticks", "5", "--config", "config.toml")
    assert code == 2
    assert named in err
    assert "Traceback" not in err
    assert not Path("runs").exists()


@pytest.mark.parametrize("command", [("run", "--resume"), ("view",), ("evaluate",)])
def test_a_folder_without_a_run_is_an_error(ecology: Command, command: tuple[str, ...]) -> None:
    """Going on with, viewing or evaluating a folder that is not there gives exit code 2 and names it."""
    code, _, err = ecology(*command, "nowhere")
    assert code == 2
    assert "nowhere" in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("True", True),
        ("false", False),
        (".003", 0.003),
        ("5.", 5.0),
        ("-.5e3", -500.0),
        ("None", None),
        ("[.5, True]", [0.5, True]),
        ("(1, 2)", (1, 2)),
        (" 3 ", 3),
        ("'3'", "3"),
        ("committed", "committed"),
        ("1,2", "1,2"),
        ("2026-11-28", "2026-11-28"),
        ("1+2j", "1+2j"),
        ("a\nother = 2", "a\nother = 2"),
        ("[" * 5000, "[" * 5000),
        ("", ""),
    ],
)
def test_a_value_is_read_as_toml_or_python(text: str, value: object) -> None:
    """Numbers, truth values, lists and None are read in either spelling; whatever else there is is a word."""
    assert repr(read_value(text)) == repr(value)


def test_settings_in_the_spelling_of_python(short: Command) -> None:
    """Of a run, --set takes True, .003 and None; None for a number is refused, that of a learner too."""
    Path("world.py").write_text(OPTIONAL)
    words = ("--set", "n=None", "--set", "heading=True", "--set", "decay=.003")
    assert short("world.py", *words, "--out", "a")[0] == 0
    settings = tomllib.loads(Path("a/config.toml").read_text())["settings"]
    assert settings == {"heading": True, "decay": 0.003}
    code, _, err = short("world.py", "--set", "decay=None", "--out", "b")
    assert (code, "got None" in err) == (2, True)
    code, _, err = short("world.py", "--learner", "hjb", "--set", "learner.gamma=None", "--out", "b")
    assert (code, "got None" in err) == (2, True)


LONG = "x" * 300


PATHS = {
    "out of run": ("run", "paper", "--ticks", "5", "--learner", "random", "--out", LONG),
    "scenario of run": ("run", f"{LONG}.py"),
    "scenario by name": ("run", LONG),
    "learner of run": ("run", "paper", "--learner", f"{LONG}.py"),
    "config of run": ("run", "--config", LONG),
    "run to resume": ("run", "--resume", LONG),
    "scenario of check": ("check", f"{LONG}.py"),
    "new scenario": ("new", LONG),
    "out of sweep": ("sweep", "paper", "--ticks", "5", "--learner", "random", "--out", LONG),
    "scenario of sweep": ("sweep", f"{LONG}.py"),
    "run to evaluate": ("evaluate", LONG),
    "run to view": ("view", LONG),
    "run to film": ("film", LONG),
    "run to fork": ("fork", LONG, "--at", "5"),
    "run to focus": ("focus", LONG, "prey_1"),
    "out of bench": ("bench", "--agents", "1", "--out", LONG),
    "out of reproduce": ("reproduce", "theory", "--out", LONG),
}


@pytest.mark.parametrize("case", PATHS)
def test_a_path_that_no_system_takes_is_one_clear_error(ecology: Command, case: str) -> None:
    """A name of 300 characters gives exit code 2 and one message wherever a path is given."""
    code, _, err = ecology(*PATHS[case])
    assert code == 2
    assert LONG in err
    assert "Traceback" not in err


def test_a_folder_that_nobody_may_enter_is_one_clear_error(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the system forbids to look into a folder, the message names it and the cause."""
    real = os.stat

    def refuse(path: Any, *words: Any, **more: Any) -> os.stat_result:
        if "closed" in str(path).split(os.sep)[:-1]:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return real(path, *words, **more)

    monkeypatch.setattr(os, "stat", refuse)
    for words in (
        ("run", "paper", "--ticks", "5", "--learner", "random", "--out", "closed/mine"),
        ("run", "closed/mine.py"),
        ("run", "--resume", "closed/mine"),
        ("evaluate", "closed/mine"),
        ("view", "closed/mine"),
        ("sweep", "paper", "--ticks", "5", "--learner", "random", "--out", "closed/mine"),
    ):
        code, _, err = ecology(*words)
        assert (code, "Permission denied" in err, "Traceback" in err) == (2, True, False), (words, err)
