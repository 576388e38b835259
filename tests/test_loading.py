"""A scenario file is run once per process, whatever a command does with it, and finds what lies beside it."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from ecology import EcologyError, scenarios
from ecology.lab.cli import main
from ecology.lab.runs.run_config import words_of

WORLD = """
import pathlib
from ecology import Arena, Need, Resource, Scenario, Species, consume, go_to, move, rest

with open(pathlib.Path(__file__).with_name("loaded"), "a") as file:
    file.write("once\\n")

def hunger(state):
    return float(state.internal[0, 0])

def build(decay=0.01, ticks=20):
    need = Need(name="food", set_point=2.0, decay=decay, bounds=(0.0, 4.0))
    agent = Species(name="agent", needs=(need,), learner="random", position=(1.0, 1.0),
                    actions=(rest(), move("walk", 0.1), consume("berries", {"food": 0.1}), go_to("berries", 0.1)))
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(agent,),
                    resources=(Resource(name="berries", position=(1.0, 1.0)),), measures={"hunger": hunger},
                    ticks=ticks)
"""


@pytest.fixture
def loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Return how often `ecology WORDS`, in a folder with world.py, runs that file; as a new process would."""
    monkeypatch.chdir(tmp_path)
    Path("world.py").write_text(WORLD)

    def command(*words: str) -> int:
        Path("loaded").unlink(missing_ok=True)
        scenarios._loaded.clear()
        with pytest.raises(SystemExit, match=r"^0$"):
            main([*words, "--quiet"])
        return len(Path("loaded").read_text().split())

    return command


def test_a_command_runs_a_scenario_file_once_per_process(loads: Callable[..., int], quick_evaluation: None) -> None:
    """`run`, `evaluate` and `fork` are one process; a sweep of one run is two."""
    assert loads("run", "world.py", "--out", "run", "--no-record") == 1
    assert loads("evaluate", "run", "--ticks", "20", "--places", "1") == 1
    assert loads("fork", "run", "--at", "10", "--out", "forked") == 1
    assert loads("sweep", "world.py", "--seeds", "0", "--out", "sweep") == 2


def test_a_file_is_run_again_after_it_has_changed(tmp_path: Path) -> None:
    """What decides is the content of the file, not its time or size."""
    world = tmp_path / "world.py"
    world.write_text(WORLD)
    found = [scenarios.load(str(world), decay=decay).species[0].needs[0].decay for decay in (0.01, 0.02)]
    assert found == [0.01, 0.02]
    assert (tmp_path / "loaded").read_text() == "once\n"
    world.write_text(WORLD.replace("decay=0.01", "decay=0.05"))
    assert scenarios.settings(str(world)) == {"decay": 0.05, "ticks": 20}
    assert (tmp_path / "loaded").read_text() == "once\n" * 2


def test_files_of_one_name_stay_apart(tmp_path: Path) -> None:
    """Two files of one name in two folders, each with a module of its own beside it, take turns."""
    for name, decay in (("one", 0.01), ("other", 0.03)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "numbers_beside.py").write_text(f"DECAY = {decay}")
        text = WORLD.replace("def build(decay=0.01", "from numbers_beside import DECAY\n\ndef build(decay=DECAY")
        (tmp_path / name / "world.py").write_text(text)
    for _ in range(2):
        assert scenarios.settings(str(tmp_path / "one" / "world.py"))["decay"] == 0.01
        assert scenarios.settings(str(tmp_path / "other" / "world.py"))["decay"] == 0.03
    assert (tmp_path / "one" / "loaded").read_text() == "once\n"


def test_a_file_that_fails_is_tried_again(tmp_path: Path) -> None:
    """A file that does not run is not kept: once what it needs is there, it is loaded."""
    world = tmp_path / "world.py"
    world.write_text("import numbers_to_come\n" + WORLD)
    with pytest.raises(EcologyError, match="numbers_to_come"):
        scenarios.load(str(world))
    (tmp_path / "numbers_to_come.py").write_text("")
    assert scenarios.load(str(world)).name == "world"


@pytest.mark.parametrize("name", ["world.py", "predator_prey"])
def test_a_pickled_scenario_opens_in_a_fresh_process(tmp_path: Path, name: str) -> None:
    """A process that has loaded neither the file nor the project unpickles a scenario, its measures included."""
    (tmp_path / "world.py").write_text(WORLD)
    world = scenarios.load(str(tmp_path / name) if name.endswith(".py") else name)
    (tmp_path / "pickled").write_bytes(pickle.dumps(world))
    (tmp_path / "world.py").unlink()
    code = (
        "import pickle, pathlib\nworld = pickle.loads(pathlib.Path('pickled').read_bytes())\n"
        "import ecology\nenv = ecology.parallel_env(world)\nenv.reset(seed=0)\n"
        "print(world.name, len(world.measure(env.state_view)))"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout.split() == [world.name, str(len(world.measures))], done.stderr


def test_runs_of_older_versions_are_still_of_the_same_world(tmp_path: Path) -> None:
    """The digest of a world names the module of a scenario file as it did when the package was called scenarios."""
    text = "class Rule:\n    def __call__(self, world, rng):\n        return world.no_effect()\n"
    (tmp_path / "world.py").write_text(text + WORLD.replace('name="world",', 'name="world", rule=Rule(),'))
    assert words_of(scenarios.load(str(tmp_path / "world.py")).rule) == "<scenarios._loaded_world.Rule object>"


@pytest.mark.parametrize("name", ["agents", "scenarios"])
def test_an_old_import_says_what_to_write(tmp_path: Path, name: str) -> None:
    """A file that imports the packages by their former names is told the new ones."""
    (tmp_path / "world.py").write_text(f"import {name}\n{WORLD}")
    with pytest.raises(EcologyError, match=f"from ecology import {name}"):
        scenarios.load(str(tmp_path / "world.py"))
