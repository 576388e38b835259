"""A run folder that came from somebody else runs none of its code, writes nowhere else and is not believed blindly."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from ecology import EcologyError, agents, scenarios
from ecology.lab.cli import main
from ecology.lab.runs import trust
from ecology.lab.runs.world_file import WORLD, read_world

CODE = """
from pathlib import Path
import beside
from ecology import Arena, Growth, Need, Resource, Scenario, Species, consume, move, rest, turn

(Path(__file__).parent / "ran").touch()

def rule(world, rng):
    return world.no_effect()

def build(ticks=20):
    need = Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0))
    agent = Species(name="agent", needs=(need,), count=beside.COUNT, learner="random",
                    actions=(rest(), move("walk", 0.1), turn("turn", 0.5), consume("berries", {"food": 0.1})))
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(agent,), rule=rule,
                    measures={"hunger": lambda state: float(state.internal.mean())},
                    resources=(Resource(name="berries", position=(1.0, 1.0)),), ticks=ticks)
"""
LEARNER = """
from pathlib import Path
from ecology.agents.baselines import Random
(Path(__file__).parent / "ran").touch()

class Mine(Random):
    "Act at random."
"""
Command = Callable[..., tuple[int, str]]


@pytest.fixture
def ecology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the command line in an empty folder: words -> exit code, stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "mine"))

    def type_(*words: str) -> tuple[int, str]:
        with pytest.raises(SystemExit) as left:
            main(words)
        return int(left.value.code or 0), capsys.readouterr().err

    return type_


@pytest.fixture
def stranger(ecology: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Command:
    """Return the command line of a user who has got the folder `run`, whose code lies in `theirs`."""
    for name, text in (("world", CODE), ("beside", "COUNT = 2"), ("mine", LEARNER)):
        path = Path(f"theirs/{name}.py")
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    words = ("--learner", "theirs/mine.py", "--ticks", "20", "--out", "run", "--record", "every=2")
    assert ecology("run", "theirs/world.py", *words, "--quiet")[0] == 0
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    forget()
    return ecology


def forget() -> None:
    """Let no module of the stranger's be loaded."""
    scenarios._loaded.clear()
    agents._classes.cache_clear()
    for ran in Path().rglob("ran"):
        ran.unlink()


def ran() -> list[str]:
    """Return the folders whose code has run."""
    return sorted(path.parent.as_posix() for path in Path().rglob("ran"))


LIVING_ON = (
    ("evaluate", "run", "--ticks", "20", "--places", "1"),
    ("fork", "run", "--at", "10", "--out", "forked"),
    ("run", "--resume", "run", "--ticks", "30"),
    ("run", "--config", "run/config.toml", "--out", "again"),
)


@pytest.mark.parametrize(
    ("words", "place"),
    [*((words, "in place") for words in LIVING_ON), (LIVING_ON[1], "current"), (LIVING_ON[2], "kept")],
    ids=lambda of: of if isinstance(of, str) else f"{of[0]} {of[1]}",
)
def test_what_lives_on_asks_first(
    stranger: Command, words: tuple[str, ...], place: str, quick_evaluation: None
) -> None:
    """Nothing is run, and every file is named with its digest; with --trust it is run, and known from then on."""
    words = (*words, *(("--source", place) if place != "in place" else ()))
    code, err = stranger(*words)
    assert (code, ran()) == (2, [])
    assert "--trust" in err
    home = "run/source" if place == "kept" else "theirs"
    assert f"{Path.cwd()}/{home}/world.py' (sha256 " in err
    assert f"{Path.cwd()}/{home}/beside.py' (sha256 " in err
    code, err = stranger(*words, "--trust")
    assert code == 0, err
    assert ran()
    assert f"runs the code of {Path.cwd()}/{home}/world.py (sha256 " in err
    shutil.rmtree("again", ignore_errors=True)
    shutil.rmtree("forked", ignore_errors=True)
    again = ("--ticks", "40") if "--resume" in words else ()
    assert stranger(*[word for word in words if word not in ("--ticks", "30") or not again], *again)[0] == 0


ISLES = """
from pathlib import Path
from ecology import Archipelago, Island, Migration

(Path(__file__).parent / "ran").touch()

def build(ticks=20):
    going = Migration(species="agent", rate=0.01)
    return Archipelago(name="isles", islands=(Island(scenario="world.py"),) * 2, every=10.0, migrations=(going,),
                       ticks=ticks)
"""


@pytest.mark.parametrize("words", [("--resume", "run", "--ticks", "30"), ("--fork", "run", "--at", "10")])
def test_an_archipelago_asks_first(
    ecology: Command, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Neither its file nor the scenarios of its islands are run unasked; with --trust all are named and run."""
    Path("theirs").mkdir()
    for name, text in (("world", CODE), ("beside", "COUNT = 2"), ("isles", ISLES)):
        Path(f"theirs/{name}.py").write_text(text)
    told = ("--workers", "1", "--keep-every", "10", "--no-record", "--quiet")
    assert ecology("archipelago", "theirs/isles.py", "--out", "run", *told)[0] == 0
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "another"))
    forget()
    code, err = ecology("archipelago", *words, "--workers", "1")
    assert (code, ran()) == (2, [])
    assert f"{Path.cwd()}/theirs/isles.py' (sha256 " in err
    assert "--trust" in err
    code, err = ecology("archipelago", *words, "--workers", "1", "--trust")
    assert (code, ran()) == (0, ["theirs"]), err
    for name in ("isles", "world", "beside"):
        assert f"runs the code of {Path.cwd()}/theirs/{name}.py (sha256 " in err


def test_from_python_it_asks_first(stranger: Command) -> None:
    """`agents.load` is no way around."""
    with pytest.raises(EcologyError, match="that you have not run before"):
        agents.load("run")
    assert not ran()
    assert agents.load("run", trust=True).env.size == 2


def test_the_learner_alone_is_asked_for(stranger: Command) -> None:
    """A scenario that ships and a learner that does not: the same."""
    assert stranger("run", "seasons", "--learner", "theirs/mine.py", "--ticks", "5", "--out", "r2", "--quiet")[0] == 0
    assert Path("theirs/ran").exists()
    forget()
    Path("theirs/mine.py").write_text(LEARNER + "\n")
    code, err = stranger("run", "--config", "r2/config.toml", "--source", "kept", "--out", "r3", "--quiet")
    assert code == 0, err  # the copy is what this user ran
    forget()
    told = Path("r2/config.toml")
    Path("other.py").write_text(LEARNER.replace("Act", "Do"))
    told.write_text(told.read_text().replace("theirs/mine.py", "other.py"))
    for choice in (("--source", "current"), ("--source", "kept")):
        code, err = stranger("run", "--config", "r2/config.toml", *choice, "--out", "r4", "--quiet")
        assert (code, ran()) == (2, [])
        assert "other.py" in err


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (("film", "run", "film.gif", "--from", "2"), "film.gif"),
        (("view", "run", "--focus", "agent_0"), None),
    ],
    ids=["film", "view --focus"],
)
def test_what_only_shows_needs_no_code(
    stranger: Command, words: tuple[str, ...], written: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither the stranger's files nor the copies of them have to be there."""
    from ecology.observers import viewer

    shown: list[Path] = []
    monkeypatch.setattr(viewer, "view", shown.append)
    shutil.rmtree("theirs")
    shutil.rmtree("run/source")
    code, err = stranger(*words)
    assert code == 0, err
    assert ran() == []
    assert Path(written).stat().st_size > 0 if written else len(shown) == 1


@pytest.mark.parametrize("name", scenarios.names())
def test_a_world_is_read_back_as_data(name: str, tmp_path: Path) -> None:
    """But for its functions and what it was made from, it is the scenario; JSON without infinities."""
    import dataclasses

    from ecology.lab.runs.world_file import write_world

    scenario = scenarios.load(name)
    write_world(tmp_path, scenario)
    json.loads((tmp_path / WORLD).read_text(), parse_constant=pytest.fail)
    found = read_world(tmp_path)
    assert found is not None
    assert list(found.measures) == list(scenario.measures)
    bare = [dataclasses.replace(species, learner_settings={}) for species in scenario.species]
    assert dataclasses.replace(found, measures={}) == dataclasses.replace(
        scenario, rule=None, props=None, measures={}, settings={}, species=tuple(bare)
    )


def test_a_damaged_world_is_one_error(stranger: Command) -> None:
    """Only the classes of a scenario are made of it, and those check themselves."""
    told = json.loads(Path("run", WORLD).read_text())
    for wrong in (
        "{",
        "[]",
        json.dumps({**told, "world": {**told["world"], "dt": -1}}),
        json.dumps({**told, "world": {**told["world"], "species": [{**told["world"]["species"][0], "count": 10**12}]}}),
        json.dumps({**told, "world": {**told["world"], "arena": {"type": "Path", "vertices": 3}}}),
        json.dumps({**told, "world": {**told["world"], "species": [3]}}),
    ):
        Path("run", WORLD).write_text(wrong)
        code, err = stranger("film", "run", "film.gif")
        assert (code, ran()) == (2, [])
        assert "is damaged" in err


def test_own_code_is_run_unasked(ecology: Command) -> None:
    """Who made a run with his own file is not asked; not after an edit that --source current confirms, either."""
    Path("world.py").write_text(CODE)
    Path("beside.py").write_text("COUNT = 2")
    assert ecology("run", "world.py", "--ticks", "10", "--out", "run", "--no-record", "--quiet") == (0, "")
    forget()
    assert ecology("run", "--resume", "run", "--ticks", "20", "--quiet") == (0, "")
    Path("world.py").write_text(CODE + "\n# mended\n")
    assert ecology("run", "--resume", "run", "--ticks", "30", "--quiet")[0] == 2
    assert ecology("run", "--resume", "run", "--ticks", "30", "--source", "current", "--quiet") == (0, "")
    Path("world.py").unlink()
    forget()
    assert ecology("run", "--resume", "run", "--ticks", "40", "--source", "kept", "--quiet") == (0, "")
    assert {Path(each.path).name for each in trust.read_list()} == {"world.py", "beside.py"}


def test_a_list_that_cannot_be_kept_stops_nothing(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file that is named is run; what a run folder names needs --trust every time."""
    Path("file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(Path("file").absolute()))
    Path("world.py").write_text(CODE)
    Path("beside.py").write_text("COUNT = 2")
    assert ecology("run", "world.py", "--ticks", "10", "--out", "run", "--no-record", "--quiet") == (0, "")
    assert ecology("run", "--resume", "run", "--ticks", "20", "--quiet")[0] == 2
    for ticks in ("20", "30"):
        assert ecology("run", "--resume", "run", "--ticks", ticks, "--trust", "--quiet") == (0, "")


def test_what_lies_beside_a_copy_is_not_run(ecology: Command) -> None:
    """Neither a file that was not copied nor what Python would take for a compiled copy."""
    Path("world.py").write_text(CODE)
    Path("beside.py").write_text("COUNT = 2")
    assert ecology("run", "world.py", "--ticks", "10", "--out", "run", "--no-record", "--quiet") == (0, "")
    cached = Path("run/source/__pycache__/beside.pyc")
    cached.parent.mkdir()
    cached.write_bytes(b"anything")
    words = ("run", "--resume", "run", "--ticks", "20", "--source", "kept", "--quiet")
    Path("run/source/decimal.py").write_text("raise SystemExit('ran')")
    code, err = ecology(*words)
    assert code == 2
    assert "decimal.py' is no copy" in err
    assert not cached.exists()
    listed = Path("run/source/origins.json")
    honest = listed.read_text()
    digest = hashlib.sha256(Path("run/source/decimal.py").read_bytes()).hexdigest()
    forged = {**json.loads(honest), "decimal.py": {"path": str(Path("decimal.py").absolute()), "sha256": digest}}
    listed.write_text(json.dumps(forged))
    code, err = ecology(*words)
    assert code == 2
    assert "run/source/decimal.py' (sha256" in err
    listed.write_text(honest)
    Path("run/source/decimal.py").unlink()
    assert ecology(*words) == (0, "")
    shutil.move("run/source", "away")
    Path("run/source").symlink_to("../away")
    code, err = ecology(*words[:4], "50", *words[5:])
    assert (code, "source' is a link" in err) == (2, True)


def test_a_file_by_another_name_is_asked_for(stranger: Command) -> None:
    """No way of writing a path hides that it is a file."""
    for name in ("theirs/world.py/", "theirs/world.py/.", "./theirs/../theirs/world.py"):
        Path("config.toml").write_text(f"scenario = {name!r}\nticks = 5")
        code, _ = stranger("run", "--config", "config.toml", "--out", "r5", "--quiet")
        assert (code, ran()) == (2, [])
