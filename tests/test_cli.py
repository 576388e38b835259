"""What a user types: every command, and every bad input with its one clear error."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from conftest import Command
from worlds import OPTIONAL

from ecology import __version__, agents, scenarios
from ecology.lab.cli.commands import list as list_command


def test_list_names_every_scenario_and_learner(ecology: Command) -> None:
    """`ecology list` has a line with words on it for each scenario and each learner."""
    worlds, archipelagos, learners = list_command.lines()  # read from files
    assert (list(worlds), list(archipelagos)) == (scenarios.names(), scenarios.archipelago_names())
    assert learners == {name: words[-1] for name, words in agents.LEARNERS.items()}
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
    outcome = world.no_effect()
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
    assert "FAIL  the same seed gives the same run\n      tick 1: with the same seed" in out
    assert "pass  every account closes" in out
    assert err == "mine.py fails 4 of 15 checks of the contract.\n"
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
