"""What a user types: every command, and every bad input with its one clear error."""

from __future__ import annotations

import errno
import http.client
import json
import os
import re
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from ecology import EcologyError, __version__, agents, errors, scenarios
from ecology.lab.cli import live, main
from ecology.lab.cli.commands import evaluate
from ecology.lab.values import read_value
from ecology.observers.wishes import Wishes

Command = Callable[..., tuple[int, str, str]]


@pytest.fixture
def ecology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the command line in an empty folder: words -> exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def type_(*words: str) -> tuple[int, str, str]:
        code = 0
        try:
            main(words)
        except SystemExit as left:
            code = int(left.code or 0)
        return code, *capsys.readouterr()

    return type_


@pytest.fixture
def short(ecology: Command) -> Command:
    """Return a short run with a learner that needs no time, and more words."""
    return lambda *words: ecology("run", "--ticks", "30", "--learner", "random", "--no-record", *words)


def test_list_names_every_scenario_and_learner(ecology: Command) -> None:
    """`ecology list` has a line with words on it for each scenario and each learner."""
    code, out, _ = ecology("list")
    assert code == 0
    told = dict(line.split(maxsplit=1) for line in out.splitlines() if line.startswith("  "))
    assert told.keys() == {*scenarios.names(), *agents.LEARNERS}
    assert not [name for name, line in told.items() if line.startswith("(")]


def test_help_shows_defaults_that_depend_on_others(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A default that is worked out is told too; what stands in brackets in a help text is taken for markup and lost."""
    monkeypatch.setenv("COLUMNS", "160")
    for command, defaults in {
        "run": ("the scenario's", "runs/SCENARIO-SEED", "cpu"),
        "sweep": ("runs/sweep-SCENARIO", "one per CPU"),
        "fork": ("RUN-at-TICK", "as the run"),
        "film": ("200 frames before the end", "RUN/film.gif"),
    }.items():
        code, out, _ = ecology(command, "--help")
        assert code == 0
        for default in defaults:
            assert f"[default: ({default})]" in out


def test_the_help_of_reproduce_names_every_result(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """What can be reproduced is read without starting it."""
    from ecology.lab.certificate.cases import all_cases

    monkeypatch.setenv("COLUMNS", "160")
    code, out, _ = ecology("reproduce", "--help")
    assert code == 0
    for case in all_cases().values():
        assert f"{case.name}: {case.about}" in out


def test_the_command_line_is_quick_to_start() -> None:
    """Asking for the list loads neither torch nor rerun nor matplotlib."""
    code = (
        "import sys; from ecology.lab.cli import main\n"
        "try: main(['list'])\nexcept SystemExit: pass\n"
        "print('loaded', {'torch', 'rerun', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("loaded set()\n")


def test_a_new_scenario_runs(ecology: Command, short: Command, tmp_path: Path) -> None:
    """`ecology new` writes a file that runs by its path, and never overwrites one."""
    assert ecology("new", "my_world")[0] == 0
    assert scenarios.load("my_world.py").name == "my_world"
    text = Path("my_world.py").read_text()
    assert "NAME" not in text
    code, out, err = short("my_world.py", "--set", "decay=0.01", "--quiet")
    assert (code, out, err) == (0, "", "")
    code, out, _ = short("my_world.py", "--set", "decay=0.01", "--out", "runs/second")
    assert code == 0
    assert Path("runs/my_world-0/config.toml").exists()
    assert str(Path("runs/second")) in out
    Path("my_world.py").write_text(text + "\n# mine\n")
    code, out, _ = ecology("check", "my_world.py", "--ticks", "60")
    assert code == 0
    assert out.count("pass  ") == out.count("\n") - 1
    code, _, err = ecology("new", "my_world")
    assert code == 2
    assert "my_world.py" in err
    assert Path("my_world.py").read_text().endswith("# mine\n")
    code, _, err = ecology("new", "my-world")
    assert code == 2
    assert "'my-world'" in err


def test_check_says_what_is_broken(ecology: Command) -> None:
    """A scenario that breaks the contract is told point by point, with reasons, and the exit code is 1."""
    rule = """
count = [0]


def rule(world, rng):
    count[0] += 1
    outcome = world.nothing()
    outcome.received[:] = count[0] / 1000
    return outcome
"""
    ecology("new", "mine")
    text = Path("mine.py").read_text()
    Path("mine.py").write_text(
        text.replace("\n\ndef build", rule + "\n\ndef build").replace("dt=dt,\n", "rule=rule,\n        dt=dt,\n")
    )
    code, out, err = ecology("check", "mine.py", "--ticks", "30")
    assert code == 1
    assert "FAIL  the same seed gives the same life\n      tick 1: with the same seed" in out
    assert "pass  every account closes" in out
    assert err == "mine.py breaks the contract in 4 of 15 points.\n"
    code, _, err = ecology("check", "papper")
    assert (code, "Did you mean 'paper'" in err) == (2, True)


def test_settings_go_to_the_scenario_and_to_learners(ecology: Command) -> None:
    """--set takes a scenario's setting, learner.KEY and SPECIES.learner.KEY, read as TOML."""
    code, _, err = ecology(
        "run", "paper", "--ticks", "5", "--seed", "3", "--no-record", "--quiet", "--out", "told",
        "--set", "decay=0.004", "--set", "set_points=[1, 1, 2, 2]", "--set", "commitment=committed",
        "--set", "learner.gamma=0.9", "--set", "agent.learner.width=8",
    )  # fmt: skip
    assert (code, err) == (0, "")
    config = tomllib.loads(Path("told/config.toml").read_text())
    assert config["settings"]["decay"] == 0.004
    assert config["settings"]["set_points"] == [1, 1, 2, 2]
    assert config["settings"]["commitment"] == "committed"
    assert config["learners"]["agent"]["settings"]["gamma"] == 0.9
    assert config["learners"]["agent"]["settings"]["width"] == 8
    assert config["learners"]["agent"]["settings"].keys() == agents.settings("hjb").keys()
    assert (config["seed"], config["ticks"], config["made_with"]["dt"]) == (3, 5, 1.0)


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


def test_evaluate_measures_and_draws(short: Command, ecology: Command) -> None:
    """`ecology evaluate` restores the learner, and writes evaluation.json and figures to the run's folder."""
    assert short("seasons", "--out", "mine")[0] == 0
    code, out, err = ecology("evaluate", "mine", "--ticks", "100", "--places", "1", "--quiet")
    assert (code, out, err) == (0, "", "")
    report = json.loads(Path("mine/evaluation.json").read_text())
    assert (report["scenario"], report["learner"], report["ticks"], report["skip"]) == (
        "seasons",
        "random",
        100,
        10,
    )
    assert report["mean_drive"].keys() >= {"learned", "planner", "camping", "greedy", "random", "rest"}
    drawn = {path.name for path in Path("mine/figures").iterdir()}
    assert drawn >= {"internal_states.png", "trajectory.png", "baselines.png"}
    code, _, err = ecology("evaluate", "mine", "--species", "agnt")
    assert code == 2
    assert "'agent'" in err


def test_an_evaluation_is_replaced_by_its_like_alone(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other ticks, places, seeds and devices are refused, with what is there; --again and the same words replace it."""
    monkeypatch.setattr("ecology.agents.evaluation.BASELINES", ())
    run = ("run", "predator_prey", "--ticks", "30", "--learner", "random", "--no-record", "--quiet", "--out", "mine")
    assert ecology(*run, "--set", "prey=3", "--set", "predators=2")[0] == 0
    evaluate = ("evaluate", "mine", "--quiet", "--places", "1", "--ticks")
    assert ecology(*evaluate, "50") == (0, "", "")

    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in Path("mine").rglob("*") if path.is_file()}

    before = files()
    for words, told in (
        (("40",), "ticks 50 instead of 40"),
        (("50", "--places", "2"), "places 1 instead of 2"),
        (("50", "--seed", "7", "--ticks", "60"), "seed 1000 instead of 7, ticks 50 instead of 60"),
    ):
        code, _, err = ecology(*evaluate, *words)
        assert code == 2
        assert f"the folder 'mine' holds an evaluation that was made with {told}; give --again" in err
        assert files() == before
    Path("mine/evaluation.json").write_text(before[Path("mine/evaluation.json")].decode().replace('"cpu"', '"cuda"'))
    assert "made with device 'cuda' instead of 'cpu'; " in ecology(*evaluate, "50")[2]
    Path("mine/evaluation.json").write_bytes(before[Path("mine/evaluation.json")])
    assert ecology(*evaluate, "50") == (0, "", "")
    assert ecology(*evaluate, "40", "--again") == (0, "", "")
    assert json.loads(Path("mine/evaluation.json").read_text())["ticks"] == 40
    Path("mine/evaluation.json").write_text("[]")
    assert "is damaged" in ecology(*evaluate, "40")[2]
    assert Path("mine/evaluation.json").read_text() == "[]"


def test_every_species_has_an_evaluation_of_its_own(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """That of a species other than the first lies in a folder of its name within the run's, in every world."""
    monkeypatch.setattr("ecology.agents.evaluation.BASELINES", ())
    run = ("run", "predator_prey", "--ticks", "30", "--learner", "random", "--no-record", "--quiet", "--out", "mine")
    assert ecology(*run, "--set", "prey=3", "--set", "predators=2")[0] == 0
    evaluate = ("evaluate", "mine", "--quiet", "--places", "1", "--ticks", "50")
    for words, folder, species in (
        ((), "mine", "prey"),
        (("--species", "prey"), "mine", "prey"),
        (("--species", "predator"), "mine/of-predator", "predator"),
        (
            ("--species", "predator", "--set", "wound=1.0"),
            "mine/of-predator-in-predator_prey-wound=1.0",
            "predator",
        ),
    ):
        assert ecology(*evaluate, *words) == (0, "", "")
        assert json.loads(Path(folder, "evaluation.json").read_text())["species"] == species
        assert Path(folder, "figures").is_dir()
    assert {path.parent.name for path in Path("mine").rglob("evaluation.json")} == {
        "mine", "of-predator", "of-predator-in-predator_prey-wound=1.0",
    }  # fmt: skip


def test_an_evaluation_is_there_when_it_is_whole(
    short: Command, ecology: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """evaluation.json is written last, names the learner as the plan does, and not where anything fails."""
    from ecology.agents import figures

    chance = {"chance": ("ecology.agents.baselines", "Random", None, "")}
    monkeypatch.setattr(agents, "LEARNERS", {**agents.LEARNERS, **chance})
    assert short("seasons", "--out", "mine", "--learner", "chance")[0] == 0
    evaluate = ("evaluate", "mine", "--ticks", "50", "--places", "1", "--quiet")

    def fail(*_: object) -> None:
        raise OSError("no space")

    with monkeypatch.context() as patch:
        patch.setattr(figures, "draw", fail)
        code, _, err = ecology(*evaluate)
    assert code == 2
    assert "'mine' cannot be written (no space)" in err
    assert "Traceback" not in err
    assert not Path("mine/evaluation.json").exists()
    Path("mine/metrics.parquet").write_bytes(b"PAR1")
    code, _, err = ecology(*evaluate)
    assert code == 2
    assert "metrics.parquet" in err
    assert "Traceback" not in err
    assert not Path("mine/evaluation.json").exists()
    Path("mine/metrics.parquet").unlink()
    assert ecology(*evaluate)[0] == 0
    assert json.loads(Path("mine/evaluation.json").read_text())["learner"] == "chance"


def test_an_evaluation_that_cannot_be_kept_is_not_begun(
    short: Command, ecology: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file in the place of the figures, and a folder in which no file can be made, are told before the measuring."""
    from ecology.agents import evaluation

    def never(*_: object, **__: object) -> None:
        raise AssertionError("it was measured")

    assert short("seasons", "--out", "mine")[0] == 0
    before = set(Path("mine").iterdir())
    monkeypatch.setattr(evaluation, "evaluate", never)
    Path("mine/figures").write_text("mine")
    code, _, err = ecology("evaluate", "mine", "--quiet")
    assert code == 2
    assert "'mine/figures' is a file" in err
    assert "Traceback" not in err
    assert Path("mine/figures").read_text() == "mine"
    Path("mine/figures").unlink()
    monkeypatch.setattr(errors.tempfile, "TemporaryFile", _refused)
    for more in ((), ("--in", "paper")):
        code, _, err = ecology("evaluate", "mine", "--quiet", *more)
        assert code == 2
        assert "Permission denied" in err
        assert "Traceback" not in err
    assert set(Path("mine").iterdir()) == before


def _refused(*_: object, **__: object) -> None:
    raise PermissionError(errno.EACCES, "Permission denied")


@pytest.mark.parametrize(("gap", "words"), [(-7.35, "worse than camping"), (0.5, "50% of the way")])
def test_worse_than_camping_is_said_plainly(capsys: pytest.CaptureFixture[str], gap: float, words: str) -> None:
    """A learner below the first yardstick is not said to be a share of the way to the second."""
    report = {
        "scenario": "paper",
        "ticks": 10,
        "device": "cpu",
        "mean_drive": {},
        "regulated": {"below": None, "of": "camping"},
        "as_lived": None,
        "worst_block": {"learned": None, "learned_epsilon_0": None},
        "stuck": {"learned": None, "learned_epsilon_0": None},
        "closed_gap": gap,
        "deviation_maps": None,
    }
    evaluate._say_findings({**report, "probe": {}, "deviation_check": None})
    out = capsys.readouterr().out
    assert words in out
    assert "-735" not in out


def test_view_saves_a_screenshot(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """--screenshot draws the tick that was asked for; --tick alone, and a file that exists, are errors."""
    from ecology.observers import screenshot

    run = ("run", "paper", "--ticks", "20", "--learner", "random", "--out", "mine", "--quiet")
    assert ecology(*run)[0] == 0
    code, _, err = ecology("view", "mine", "--tick", "5")
    assert code == 2
    assert "--screenshot" in err
    Path("there.png").write_text("mine")
    code, _, err = ecology("view", "mine", "--screenshot", "there.png")
    assert code == 2
    assert "'there.png'" in err
    assert Path("there.png").read_text() == "mine"
    drawn = []
    monkeypatch.setattr(screenshot, "screenshot", lambda *words, **more: drawn.append((words, more)))
    code, out, _ = ecology("view", "mine", "--screenshot", "new.png", "--tick", "5")
    assert (code, out) == (0, "written: new.png\n")
    assert drawn == [((Path("mine"), Path("new.png")), {"tick": 5})]


def test_serving_twice_takes_other_ports(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where the usual ports are taken by another run, free ones are used."""
    from ecology.observers import viewer

    with socket.socket() as taken:
        taken.bind((viewer.LOOPBACK, 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert viewer.preferred_port(viewer.LOOPBACK, port) not in (0, port)
        monkeypatch.setattr(viewer, "WEB_PORT", port)
        whom: Any = None
        audience = live.Audience(whom, whom, Wishes(tmp_path), view=False, serve=True, port=None)
        assert audience.port not in (None, 0, port)


def test_a_port_needs_something_to_serve(short: Command) -> None:
    """--port without --serve gives exit code 2."""
    code, _, err = short("paper", "--port", "9000")
    assert (code, err) == (2, "ecology: --port requires --serve.\n")


def test_a_port_for_browsers_that_is_taken_is_an_error(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A --port that is taken gives exit code 2, names the option, and leaves no folder."""
    from ecology.observers import viewer

    with socket.socket() as taken:
        taken.bind((viewer.LOOPBACK, 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        monkeypatch.setattr(viewer, "SERVE_PORT", 0)
        code, _, err = ecology(
            "run", "paper", "--ticks", "20", "--learner", "random", "--serve", "--port", port, "--out", "mine"
        )
    assert code == 2
    assert "cannot serve" in err
    assert "give another with --port" in err
    assert not Path("mine").exists()


def test_view_needs_a_recording(ecology: Command, short: Command) -> None:
    """`ecology view` of a run without a recording gives exit code 2 and says so."""
    assert short("paper", "--out", "mine")[0] == 0
    code, _, err = ecology("view", "mine")
    assert code == 2
    assert "recording" in err


@pytest.mark.parametrize(("size", "end"), [(0, 0), (3, 0), (100, 0), (20_000, 0), (100, 64)])
def test_a_recording_of_which_nothing_is_left_is_an_error(ecology: Command, size: int, end: int) -> None:
    """However one looks at a recording that lost its first tick, exit code 2 and one message name it."""
    from ecology.observers import viewer

    run = ("run", "paper", "--ticks", "20", "--learner", "random", "--out", "mine", "--quiet")
    assert ecology(*run)[0] == 0
    path = Path("mine/recording.rrd")
    data = path.read_bytes()
    path.write_bytes(data[:size] + data[len(data) - end :])
    before = path.read_bytes(), set(Path("mine").iterdir())
    looks = (("view", "mine", "--screenshot", "x.png"), ("view", "mine", "--serve"), ("film", "mine", "x.gif"))
    for words in looks:
        code, out, err = ecology(*words)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert "'mine/recording.rrd'" in err
    assert not Path("x.png").exists()
    assert not Path("x.gif").exists()
    with pytest.raises(EcologyError, match="recording"), viewer.complete(Path("mine")):
        pass
    assert (path.read_bytes(), set(Path("mine").iterdir())) == before


def test_view_shows_who_is_asked_for(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """--focus draws an agent's life, and --serve answers clicks with one; who was not there is an error."""
    from ecology.observers import page, readback, screenshot, viewer

    run = ("run", "predator_prey", "--ticks", "20", "--learner", "random", "--out", "mine", "--quiet")
    assert ecology(*run)[0] == 0
    drawn = []
    monkeypatch.setattr(screenshot, "screenshot", lambda run, *_, **__: drawn.append(readback.column(
        run, "/chosen/prey_3/drive", "Scalars:scalars").keys()))  # fmt: skip
    assert ecology("view", "mine", "--focus", "prey_3", "--screenshot", "new.png")[0] == 0
    assert drawn == [{0, 10, 20}]
    for words, told in (
        (("mine", "--focus", "prey_300"), "prey_300"),
        (("mine/recording.rrd", "--focus", "prey_3"), "the folder of the run"),
        (("mine", "--serve", "--screenshot", "new.png"), "one of them"),
    ):
        code, _, err = ecology("view", *words)
        assert code == 2
        assert told in err

    pages: list[page.Page] = []
    answers: list[tuple[int, bytes]] = []

    class Served(page.Page):
        def __init__(self, *words: Any, **more: Any) -> None:
            super().__init__(*words, **more)
            pages.append(self)

    def look() -> None:
        for method, path, entity in (
            ("POST", "/focus", "/world/agents/prey"),
            ("POST", "/focus", "/world/walls"),
            ("GET", "/recording.rrd", ""),
        ):
            link = http.client.HTTPConnection("127.0.0.1", pages[0].port)
            click = json.dumps({"entity": entity, "row": 5, "tick": 10})
            link.request(method, path, click if method == "POST" else None, {"X-Token": pages[0].token})
            answer = link.getresponse()
            answers.append((answer.status, answer.read()[:3]))
            link.close()
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "Page", Served)
    monkeypatch.setattr(viewer, "WEB_PORT", 0)
    monkeypatch.setattr(live, "wait", look)
    code, out, _ = ecology("view", "mine", "--serve")
    assert code == 0
    assert pages[0].url in out
    assert answers == [(200, b"RRF"), (200, b'{"s'), (200, b"RRF")]


def test_focus_turns_a_run_that_is_alive(ecology: Command) -> None:
    """`ecology focus` is answered by a run that lives; of one that does not, and of no run, it says so."""
    words = ["run", "predator_prey", "--ticks", "1000000", "--learner", "random", "--out", "mine", "--quiet"]
    run = subprocess.Popen([sys.executable, "-m", "ecology.lab.cli", *words])
    try:
        while not Path("mine/recording.rrd").exists():
            assert run.poll() is None
            time.sleep(0.1)
        code, out, _ = ecology("focus", "mine", "predator")
        assert code == 0
        assert out.startswith("predator is in focus from tick ")
        code, _, err = ecology("focus", "mine", "prey_999999")
        assert code == 2
        assert "no prey_999999 lives at tick" in err
    finally:
        run.terminate()
        run.wait()
    code, _, err = ecology("focus", "mine", "predator")
    assert code == 2
    assert "ecology view mine --focus predator" in err
    assert not Path("mine/focus.json").exists()
    code, _, err = ecology("focus", "nowhere", "predator")
    assert code == 2
    assert "holds no run" in err


def test_a_run_that_is_alive_can_be_changed(ecology: Command) -> None:
    """`ecology do` is answered by a run that lives, recorded or not; else it is refused."""
    words = ["run", "predator_prey", "--ticks", "1000000", "--learner", "random", "--out", "mine", "--no-record"]
    run = subprocess.Popen([sys.executable, "-m", "ecology.lab.cli", *words, "--quiet"])
    try:
        while not Path("mine/checkpoint").exists():
            assert run.poll() is None
            time.sleep(0.1)
        code, out, _ = ecology("do", "mine", "move grass.3 6.5 6.5")
        assert code == 0
        assert re.fullmatch(r"tick \d+: grass.3 was moved from .* to \(6.50, 6.50\)\n", out)
        code, _, err = ecology("do", "mine", "set", "prey", "enrgy", "0.2")
        assert code == 2
        assert "Did you mean 'energy'" in err
        code, _, err = ecology("do", "mine", "burn grass")
        assert (code, "no intervention 'burn'" in err) == (2, True)
    finally:
        run.terminate()
        run.wait()
    assert json.loads(Path("mine/interventions.jsonl").read_text())["do"] == "move grass.3 6.5 6.5"
    assert json.loads(Path("mine/summary.json").read_text())["interventions"] == 1
    assert not Path("mine/do.json").exists()
    code, _, err = ecology("do", "mine", "empty grass")
    assert code == 2
    assert "no run is alive in 'mine'" in err
    assert ecology("do", "nowhere", "empty grass")[0] == 2
    config = (
        "run",
        "--config",
        "mine/config.toml",
        "--replay",
        "mine/interventions.jsonl",
        "--out",
        "again",
        "--quiet",
    )
    tick = json.loads(Path("mine/interventions.jsonl").read_text())["tick"]
    assert ecology(*config, "--ticks", str(tick + 1))[0] == 0
    assert Path("again/interventions.jsonl").read_text() == Path("mine/interventions.jsonl").read_text()


def test_births_and_deaths_are_counted_on(ecology: Command) -> None:
    """What a resumed run, and a fork, say was born and has died so far goes on from where it was."""
    from ecology.observers import readback

    def flow(run: str) -> dict[int, list[float]]:
        found = readback.column(Path(run, "recording.rrd"), "/population/flow", "Scalars:scalars")
        return {tick: value.tolist() for tick, value in found.items()}

    run = ("run", "predator_prey", "--learner", "random", "--quiet")
    assert ecology(*run, "--ticks", "240", "--out", "whole")[0] == 0
    assert ecology(*run, "--ticks", "200", "--out", "mine")[0] == 0
    assert ecology("run", "--resume", "mine", "--ticks", "240", "--quiet")[0] == 0
    assert min(flow("whole")[200]) >= 0
    assert max(flow("whole")[200]) > 0
    assert flow("mine") == flow("whole")
    dead = readback.column(Path("whole", "recording.rrd"), "/world/agents/prey", "serial")[200][0]
    assert ecology("fork", "whole", "--at", "200", "--remove", f"prey_{dead}", "--out", "fork", "--quiet")[0] == 0
    assert flow("fork")[200] == flow("whole")[200]


def test_a_page_that_cannot_be_served_stops_no_run(
    ecology: Command, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Where Rerun's files for browsers are not to be had, --serve says so once and the run goes on."""
    from ecology.observers import page, viewer

    def fails(folder: Path) -> list[Path]:
        raise EcologyError("the viewer for browsers cannot be started (gone).")

    monkeypatch.setattr(viewer, "WEB_PORT", 0)
    monkeypatch.setattr(viewer, "SERVE_PORT", viewer.free_port(viewer.LOOPBACK, 0))
    monkeypatch.setattr(page, "_viewer_files", fails)
    code, out, _ = ecology("run", "paper", "--ticks", "20", "--learner", "random", "--serve", "--out", "mine")
    assert code == 0
    assert "rerun --connect" in out
    assert [record.getMessage() for record in caplog.records].count(
        "the viewer for browsers cannot be started (gone). The run goes on."
    ) == 1


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


OPTIONAL = """
from ecology import Arena, Need, Scenario, Species, rest

def build(n=None, heading=False, decay=0.01):
    agent = Species(name="agent", needs=(Need(name="food", set_point=2.0, decay=decay),), actions=(rest(),))
    assert n is None or n == 3, n
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4))), species=(agent,))
"""


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


def test_the_version_is_printed(ecology: Command) -> None:
    """`ecology --version` prints the version of the package."""
    assert ecology("--version") == (0, f"ecology {__version__}\n", "")


def test_the_package_is_the_command(tmp_path: Path) -> None:
    """`python -m ecology` is the command line, wherever it is started."""
    done = subprocess.run(
        [sys.executable, "-m", "ecology", "--version"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, f"ecology {__version__}\n", "")


def test_a_shell_completes_commands(tmp_path: Path) -> None:
    """The completion that a shell asks for names commands."""
    env = {**os.environ, "_ECOLOGY_COMPLETE": "complete_bash", "COMP_WORDS": "ecology sw", "COMP_CWORD": "1"}
    code = "import sys; sys.argv[0] = 'ecology'; from ecology.lab.cli import main; main([])"
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["sweep"], done.stderr


TWO = "from tools import DECAY\n" + OPTIONAL.replace("decay=0.01", "decay=DECAY")


def test_a_scenario_may_be_several_files(short: Command, tmp_path: Path) -> None:
    """A scenario imports from files beside it, wherever it is; two of them may use one name for different files."""
    for folder, decay in (("one", 0.25), ("two", 0.5)):
        Path(folder).mkdir()
        Path(folder, "mine.py").write_text(TWO)
        Path(folder, "tools.py").write_text(f"DECAY = {decay}\n")
    try:
        for folder, decay in (("one", 0.25), ("two", 0.5), ("one", 0.25)):
            assert scenarios.settings(f"{folder}/mine.py")["decay"] == decay
        assert short("two/mine.py", "--out", "run")[0] == 0
        assert tomllib.loads(Path("run/config.toml").read_text())["settings"]["decay"] == 0.5
    finally:
        sys.modules.pop("tools", None)
        sys.path[:] = [entry for entry in sys.path if not entry.startswith(str(tmp_path))]


def test_a_learner_may_be_several_files(short: Command, tmp_path: Path) -> None:
    """A learner imports from files beside it, too."""
    Path("own").mkdir()
    Path("own/tricks.py").write_text("CHOICE = 0\n")
    Path("own/mine.py").write_text(
        "import numpy as np\nfrom ecology.agents.base import Learner\nfrom tricks import CHOICE\n\n"
        "class Mine(Learner):\n    def act(self, observations, masks):\n"
        "        return np.full(self.size, CHOICE)\n"
    )
    try:
        code, _, err = short("paper", "--learner", "own/mine.py", "--quiet")
        assert (code, err) == (0, "")
    finally:
        sys.modules.pop("tricks", None)
        sys.path[:] = [entry for entry in sys.path if not entry.startswith(str(tmp_path))]
