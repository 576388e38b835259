"""A run keeps the user's own code, and never continues with other code unless told so."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from same_end import same_end

from ecology import EcologyError, agents
from ecology.lab.cli import main
from ecology.lab.runs import source
from ecology.lab.runs.run import read_plan

WORLD = """
import math
from pathlib import Path
from ecology import Arena, Need, Resource, Scenario, Species, consume, move, rest
import rates

def rule(world, rng):
    from late.amounts import amount
    outcome = world.no_effect()
    outcome.received[:] = amount * rng.random()
    return outcome

def build(ticks=40):
    need = Need(name="food", set_point=2.0, decay=rates.DECAY, noise=0.01, bounds=(0.0, 4.0))
    agent = Species(name="agent", needs=(need,), count=2, position=(1.0, 1.0),
                    learner=str(Path(__file__).parent / "other.py"),
                    actions=(rest(), move("walk", 0.1), consume("berries", {"food": 0.1})))
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(agent,), rule=rule,
                    resources=(Resource(name="berries", position=(1.0, 1.0)),), ticks=ticks)
"""
LEARNER = """
from ecology.agents.baselines import Random
from rates import NAME

class Mine(Random):
    __doc__ = NAME
"""
FILES = {
    "home/world.py": WORLD,
    "home/rates.py": "DECAY = 0.01",
    "home/other.py": "from ecology.agents.baselines import Random\nclass Other(Random):\n    'Act at random.'",
    "home/late/__init__.py": "",
    "home/late/amounts.py": "from . import base\namount = base.AMOUNT",
    "home/late/base.py": "AMOUNT = 0.001",
    "home/unused.py": "",
    "away/mine.py": LEARNER,
    "away/rates.py": "NAME = 'Act at random.'",
}
Command = Callable[..., tuple[int, str]]


@pytest.fixture
def ecology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the command line in a folder with FILES: words -> exit code, stderr."""
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).write_text(text)

    def type_(*words: str) -> tuple[int, str]:
        with pytest.raises(SystemExit) as left:
            main([*words, "--quiet"])
        return int(left.value.code or 0), capsys.readouterr().err

    return type_


def start(ecology: Command, out: str, ticks: int, *words: str) -> None:
    """Start a run of world.py with the learner of mine.py."""
    command = ("run", "home/world.py", "--learner", "away/mine.py:Mine", "--ticks", str(ticks), "--out", out)
    assert ecology(*command, *(words or ("--no-record",))) == (0, "")


def contents(folder: str) -> dict[Path, bytes]:
    """Return what the files in a folder hold, but for what Python keeps beside its modules."""
    paths = [path for path in Path(folder).rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    return {path.relative_to(folder): path.read_bytes() for path in paths}


def test_a_run_keeps_the_files_that_it_was_started_from(ecology: Command, tmp_path: Path) -> None:
    """The scenario, the learner and the modules that each imports from beside it, and no other file."""
    start(ecology, "run", 2)
    wanted = {
        "world.py": "home/world.py",
        "rates.py": "home/rates.py",
        "late/__init__.py": "home/late/__init__.py",
        "late/amounts.py": "home/late/amounts.py",
        "late/base.py": "home/late/base.py",
        "2/mine.py": "away/mine.py",
        "2/rates.py": "away/rates.py",
    }
    kept = contents("run/source")
    origins = json.loads(kept.pop(Path("origins.json")))
    assert {name: told["path"] for name, told in origins.items()} == {
        name: str(tmp_path / path) for name, path in wanted.items()
    }
    assert {path.as_posix(): text.decode() for path, text in kept.items()} == {
        name: FILES[path] for name, path in wanted.items()
    }


def test_a_run_whose_files_moved_resumes_from_its_copies(
    ecology: Command, tmp_path: Path, quick_evaluation: None
) -> None:
    """The error says where the file was and what to do; resumed from the copies, the run equals one never stopped."""
    start(ecology, "whole", 40)
    start(ecology, "part", 20, "--record", "every=1")
    Path("elsewhere").mkdir()
    shutil.move("home", "elsewhere/home")
    shutil.move("away", "elsewhere/away")
    before = contents("part")
    commands = [
        ("run", "--resume", "part", "--ticks", "40"),
        ("fork", "part", "--at", "20", "--ticks", "40", "--out", "fork", "--no-record"),
        ("evaluate", "part", "--ticks", "10", "--places", "1"),
        ("run", "--config", "part/config.toml", "--out", "again", "--no-record"),
    ]
    for words in commands:
        assert ecology(*words) == (
            2,
            f"ecology: the run 'part' was started from {str(tmp_path / 'home/world.py')!r}, which is no longer there. "
            "Put the file back, or pass --source kept to use the copy in 'part/source'.\n",
        )
    with pytest.raises(EcologyError, match="--source kept"):
        agents.load("part")
    assert contents("part") == before
    assert [path for path in ("fork", "film.gif", "again") if Path(path).exists()] == []
    assert ecology("film", "part", "film.gif", "--from", "19", "--to", "20") == (0, "")  # it needs no code
    assert agents.load("part", source="kept").env.state_view.tick == 20
    for words in (*commands[1:], commands[0]):
        code, err = ecology(*words, "--source", "kept")
        assert code == 0, err
    same_end("part", "whole")
    same_end("fork", "whole")
    assert contents("part/source") == contents("fork/source") == contents("again/source") == contents("whole/source")
    assert Path("film.gif").is_file()
    assert read_plan(Path("part"), choice="kept").scenario == str(tmp_path / "home/world.py")
    assert ecology("run", "--resume", "part", "--ticks", "50")[0] == 2  # the choice is for one command
    shutil.move("elsewhere/home", "home")
    shutil.move("elsewhere/away", "away")
    assert ecology("run", "--resume", "part", "--ticks", "50") == (0, "")


def test_a_changed_file_is_refused_until_the_user_chooses(ecology: Command, tmp_path: Path) -> None:
    """Either code can be chosen; the copies are those of the code that ran last, and the former ones stay."""
    start(ecology, "whole", 40)
    start(ecology, "run", 20)
    shutil.copytree("run", "twin")
    path, before = Path("home/world.py"), contents("run")
    path.write_text(WORLD.replace("amount * rng", "100 * amount * rng"))
    code, err = ecology("run", "--resume", "run", "--ticks", "40")
    assert (code, contents("run")) == (2, before)
    assert err == (
        f"ecology: {str(tmp_path / path)!r} has changed since the run 'run' used it. Undo the change, pass --source "
        "kept to use the copy in 'run/source', or pass --source current to use the file as it is now.\n"
    )
    assert ecology("run", "--resume", "run", "--ticks", "40", "--source", "kept") == (0, "")
    same_end("run", "whole")
    assert contents("run/source") == contents("whole/source")
    assert ecology("run", "--resume", "twin", "--ticks", "40", "--source", "current") == (0, "")
    assert Path("twin/source/world.py").read_text() == path.read_text()
    assert contents("twin/source-until-20") == contents("run/source")
    with pytest.raises(AssertionError):
        same_end("twin", "whole")
    assert ecology("run", "--resume", "twin", "--ticks", "50") == (0, "")
    path.write_text(WORLD)
    Path("away/rates.py").write_text("NAME = 'Act otherwise.'")
    code, err = ecology("run", "--resume", "run", "--ticks", "50")
    assert (code, "away/rates.py" in err) == (2, True)


def test_a_copy_that_was_edited_is_refused(ecology: Command) -> None:
    """--source kept loads what was copied, or nothing."""
    start(ecology, "run", 5)
    Path("run/source/late/base.py").write_text("AMOUNT = 1.0")
    code, err = ecology("run", "--resume", "run", "--ticks", "10", "--source", "kept")
    assert (code, "'run/source/late/base.py' is no longer the copy of" in err) == (2, True)
    Path("run/source/origins.json").write_text("[]")
    for words in (["--source", "kept"], []):
        code, err = ecology("run", "--resume", "run", "--ticks", "10", *words)
        assert (code, "'run/source/origins.json' is damaged" in err) == (2, True)
    assert ecology("run", "--resume", "run", "--ticks", "10", "--source", "current") == (0, "")


def test_a_sweep_is_not_continued_with_other_code(ecology: Command) -> None:
    """An edited file is refused by `sweep` too, unless the user chooses."""
    words = ("sweep", "home/world.py", "--learner", "away/mine.py", "--ticks", "5", "--out", "out", "--workers", "1")
    assert ecology(*words, "--seeds", "0:1")[0] == 0
    Path("home/world.py").write_text(WORLD + "\n")
    code, err = ecology(*words, "--seeds", "0:2")
    assert (code, "has changed since the run" in err, "--source current" in err) == (2, True, True)
    assert ecology(*words, "--seeds", "0:2", "--source", "current")[0] == 0
    assert Path("out/runs/seed=0/source/world.py").read_text() == WORLD
    assert Path("out/runs/seed=1/source/world.py").read_text() == WORLD + "\n"


def test_bad_choices_are_one_clear_error(ecology: Command) -> None:
    """A choice needs a run, and a run with copies to take them."""
    assert ecology("run", "paper", "--learner", "random", "--ticks", "2", "--no-record", "--out", "run") == (0, "")
    assert not Path("run/source").exists()
    for words, said in [
        (["run", "paper", "--source", "kept"], "--source requires --resume RUN or --config FILE"),
        (["run", "--resume", "run", "--source", "kept"], "the run 'run' has no copy of its source"),
        (["run", "--resume", "run", "--source", "mine"], "kept or current, got 'mine'"),
    ]:
        code, err = ecology(*words)
        assert (code, said in err) == (2, True), err
    Path("mine/source").mkdir(parents=True)
    code, err = ecology("run", "home/world.py", "--out", "mine")
    assert (code, "already holds a run (source)" in err) == (2, True)


def test_imports_are_found_wherever_they_are_written(tmp_path: Path) -> None:
    """Modules of packages, relative and late imports; neither libraries nor the project's own modules."""
    for name, text in {
        "world.py": "import numpy, ecology.scenarios\nfrom deep import er\ndef f():\n    import late, numbers",
        "late.py": "def broken(:",
        "deep/__init__.py": "",
        "deep/er/__init__.py": "from .. import side\nfrom .own import x",
        "deep/er/own.py": "",
        "deep/side.py": "from deep.er import own",
        "numpy.txt": "",
        "other.py": "",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    found = {path.relative_to(tmp_path).as_posix() for path in source.modules(tmp_path / "world.py")}
    assert found == {"world.py", "late.py", "deep/__init__.py", "deep/er/__init__.py", "deep/er/own.py", "deep/side.py"}
