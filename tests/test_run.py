"""What a run leaves: its folder, whether it ends, is stopped, goes on or diverges."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import PATIENCE

import ecology
from ecology import EcologyError, agents, scenarios
from ecology.agents import checkpoint
from ecology.agents.base import DivergedError, Learner, Transition
from ecology.lab.cli import main
from ecology.lab.runs import tally
from ecology.lab.runs.folder import CHECKPOINT, EVALUATION, check_evaluation
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import Plan, read_config, resolve, words_of, world_digest
from ecology.lab.runs.stopping import Interrupt
from ecology.observers.base import Observer

CROWD = """
'''Twelve wide bodies in a small room: they touch each other and the walls at every tick.'''
from ecology import Arena, Need, Resource, Scenario, Species, consume, go_to, move, rest, turn

def build(decay=0.01, noise=0.02):
    need = Need(name="food", set_point=2.0, decay=decay, noise=noise, bounds=(0.0, 4.0))
    actions = (rest(), move("walk", 0.3), turn("left", 0.7), turn("right", -0.7),
               consume("berries", {"food": 0.1}), go_to("berries", 0.2))
    crowd = Species(name="crowd", needs=(need,), actions=actions, count=12, radius=0.2)
    return Scenario(name="crowd", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(crowd,),
                    resources=(Resource(name="berries", position=(1.0, 1.0)),))
"""


def lived(folder: Path) -> int:
    """Return the tick of the checkpoint in `folder`, 0 where there is none."""
    with contextlib.suppress(EcologyError):
        return int(checkpoint.read(folder / CHECKPOINT)["tally"][1]["tick"])
    return 0


def cli(*words: str) -> None:
    """Type a command that is expected to succeed."""
    with pytest.raises(SystemExit) as left:
        main(words)
    assert not left.value.code


def _files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file() and path.name != ".lock"}


@pytest.fixture
def crowd(tmp_path: Path) -> Callable[..., Run]:
    """Return a maker of runs of a crowd that touches all the time, not yet begun."""
    (tmp_path / "crowd.py").write_text(CROWD)

    def make(folder: str, ticks: int, every: int = 100, learner: str = "random") -> Run:
        plan = resolve(
            str(tmp_path / "crowd.py"), learners=[learner], ticks=ticks, checkpoint_every=every, record=False
        )
        return Run(plan, tmp_path / folder)

    return make


def test_births_are_counted_where_there_is_room_for_more(tmp_path: Path) -> None:
    """The summary counts the born, whatever the number of slots; slots that were never taken are no births."""
    text = CROWD.replace("count=12", "count=3, capacity=12, birth=Birth(rate=0.1)").replace("Arena,", "Arena, Birth,")
    (tmp_path / "growing.py").write_text(text)
    run = Run(resolve(str(tmp_path / "growing.py"), learners=["random"], ticks=100, record=False), tmp_path / "out")
    run.start()
    summary = run.live()
    assert summary["births"] - summary["deaths"] == run.tick.alive.sum() - 3
    assert summary["births"] > 0


def test_a_run_has_ended_when_all_that_is_recorded_is_on_disk(tmp_path: Path) -> None:
    """The summary comes last: a run that is killed or fails while its observers end can be resumed."""

    class Failing(Observer):
        def end(self) -> None:
            assert not (tmp_path / "out" / "summary.json").exists()
            raise OSError("no room")

    (tmp_path / "crowd.py").write_text(CROWD)
    run = Run(resolve(str(tmp_path / "crowd.py"), learners=["random"], ticks=20, record=False), tmp_path / "out")
    run.start()
    with pytest.raises(EcologyError, match="no room"):
        run.live([Failing()])
    told = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert told["ticks"] == 20
    assert "no room" in told["stopped_by"]
    again = open_run(tmp_path / "out")
    again.resume()
    assert "stopped_at" not in again.live()


PREY = """
from ecology import Arena, Need, Scenario, Species, bite, rest

def build():
    calm = Need(name="calm", set_point=1.0)
    def kind(name, place, *acts, decay=0.0):
        food = Need(name="food", set_point=1.0, decay=decay, bounds=(0.0, 4.0), lethal=decay != 0 or name == "wounded")
        return Species(name=name, needs=(calm, food), actions=(rest(), *acts), position=place, count=2, solid=False)
    return Scenario(
        name="prey", arena=Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8))),
        species=(kind("wolf", (2.0, 2.0), bite("wounded", reach=1.0, damage={"food": 0.3})),
                 kind("fox", (6.0, 6.0), bite("killed", reach=1.0)),
                 kind("wounded", (2.0, 2.5)), kind("killed", (6.0, 6.5)), kind("starved", (2.0, 6.0), decay=0.1)))
"""


def test_the_summary_says_of_what_and_by_whom_they_died(tmp_path: Path) -> None:
    """By species: the causes of death, the lethal needs and the species of the killers; also of a resumed run."""
    (tmp_path / "prey.py").write_text(PREY)
    for ticks in (5, 60):
        plan = resolve(str(tmp_path / "prey.py"), learners=["random"], ticks=ticks, record=False)
        run = Run(plan, tmp_path / "run")
        run.start() if ticks == 5 else run.resume()
        found = run.live()["population"]
    told = {name: [found[name][word] for word in ("died_of", "fatal_needs", "killed_by")] for name in found}
    assert told == {
        "wolf": [{}, {}, {}],
        "fox": [{}, {}, {}],
        "wounded": [{"bitten": 2}, {"food": 2}, {"wolf": 2}],
        "killed": [{"eaten": 2}, {}, {"fox": 2}],
        "starved": [{"need": 2}, {"food": 2}, {}],
    }


def test_a_long_run_is_summed_up_in_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often two blocks became one, also after resuming, the summary is that of every tick."""
    text = CROWD.replace("count=12", "count=3, capacity=12, birth=Birth(rate=0.01), hazard=Hazard(rate=0.01)")
    (tmp_path / "growing.py").write_text(text.replace("Arena,", "Arena, Birth, Hazard,"))

    def plan(ticks: int) -> Plan:
        return resolve(str(tmp_path / "growing.py"), learners=["random"], ticks=ticks, record=False)

    whole = Run(plan(160), tmp_path / "whole")
    whole.start()
    expected = whole.live()
    assert whole.tally.span == 1
    assert expected["population"]["crowd"]["least"] < expected["population"]["crowd"]["most"]
    monkeypatch.setattr(tally, "BLOCKS", 16)
    part = Run(plan(50), tmp_path / "parts")
    part.start()
    part.live()
    again = Run(plan(160), tmp_path / "parts")
    again.resume()
    found = again.live()
    for key in [key for key in expected if "drive" in key]:  # sums of sums differ by rounding
        assert found.pop(key) == pytest.approx(expected.pop(key), rel=1e-12)
    for key in ("wall_seconds", "cpu_seconds", "learner_cpu_seconds", "agent_steps_per_second"):
        del found[key], expected[key]
    assert found == expected
    assert (again.tally.span, len(again.tally.drive), again.tally.state()[0]["drive"].shape) == (16, 16, (10, 1))
    (fine, one), (coarse, many) = whole.tally.drives("crowd"), again.tally.drives("crowd")
    assert (len(fine), one, len(coarse), many) == (160, 1, 10, 16)
    living = whole.tally.living[:160, 0]  # a block weighs each tick by the living
    expected_drive = (fine * living).reshape(10, 16).sum(axis=1) / living.reshape(10, 16).sum(axis=1)
    np.testing.assert_allclose(coarse, expected_drive)
    assert again.tally.mean_drive(152) == pytest.approx(again.tally.mean_drive(144))  # half of the last block
    assert again.tally.mean_drive(160) is None


def test_a_species_that_died_out_is_told_with_its_tick(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The tick after which none of a species lived is told, also by a run that went on; where some live it is null."""
    text = CROWD.replace("Arena,", "Arena, Hazard,").replace("radius=0.2)", "radius=0.2, hazard=Hazard(rate=0.02))")
    (tmp_path / "dying.py").write_text(text)
    words = ("run", str(tmp_path / "dying.py"), "--learner", "random", "--no-record")
    cli(*words, "--ticks", "20", "--out", str(tmp_path / "parts"))
    assert "died out" not in capsys.readouterr().out

    def told(folder: str) -> dict[str, Any]:
        return json.loads((tmp_path / folder / "summary.json").read_text())["population"]["crowd"]

    assert told("parts")["end"] > 0
    assert told("parts")["died_out"] is None
    cli(*words, "--ticks", "1500", "--out", str(tmp_path / "whole"))
    died_out = told("whole")["died_out"]
    assert f"crowd: 0 alive (died out at tick {died_out:,}), " in capsys.readouterr().out
    for ticks in (died_out - 1, died_out, 1500):
        cli("run", "--resume", str(tmp_path / "parts"), "--ticks", str(ticks), "--quiet")
        assert told("parts")["end"] == (ticks < died_out)
        assert told("parts")["died_out"] == (None if ticks < died_out else died_out)
    assert told("parts") == told("whole")


def test_a_species_that_came_back_has_not_died_out(crowd: Callable[..., Run]) -> None:
    """Only the last death counts: newcomers undo it, and one who never lived has not died."""
    run = crowd("out", 10)
    tally, tick, state = run.tally, run.tick, run.env.state_view
    for at, living in enumerate((12, 0, 0, 3, 0, 0), start=1):
        alive = np.arange(12) < living
        tally.watch(replace(state, tick=at), replace(tick, alive=alive), {})
        assert tally.gone.tolist() == [{2: 2, 3: 2, 5: 5, 6: 5}.get(at, 0)]


def test_a_run_leaves_one_folder(tmp_path: Path) -> None:
    """Config, summary, metrics, recording and checkpoint are written, and nothing else."""
    out = tmp_path / "mine"
    cli("run", "paper", "--learner", "random", "--ticks", "200", "--out", str(out), "--quiet")
    assert {path.name for path in out.iterdir()} == {
        "config.toml", "summary.json", "metrics.parquet", "recording.rrd", "checkpoint", "checkpoint.previous", ".lock",
        "world.json",
    }  # fmt: skip
    summary = json.loads((out / "summary.json").read_text())
    assert summary["scenario"] == "paper"
    assert summary["learner"] == {"agent": "random"}
    assert (summary["seed"], summary["ticks"], summary["deaths"], summary["births"]) == (0, 200, 0, 0)
    assert "stopped_at" not in summary
    assert summary["wall_seconds"] > 0
    assert 0 < summary["learner_cpu_seconds"] < summary["cpu_seconds"]
    assert summary["agent_steps_per_second"] == pytest.approx(200 / summary["wall_seconds"], rel=0.05)
    assert sum(summary["action_shares"]["agent"].values()) == pytest.approx(1.0)
    assert summary["mean_abs_deviation"]["agent"].keys() >= {"need_1", "muscle_fatigue", "sleep_fatigue"}
    metrics = pq.read_table(out / "metrics.parquet")
    assert metrics["tick"].to_pylist() == list(range(10, 201, 10))
    assert (out / "recording.rrd").read_bytes()[:3] == b"RRF"
    config = tomllib.loads((out / "config.toml").read_text())
    assert {"ecology", "python", "numpy", "torch", "pymunk", "dt"} <= config["made_with"].keys()


def test_the_summary_is_what_metrics_say(tmp_path: Path) -> None:
    """Mean drive, its last tenth and the needs' mean deviations agree with a recording of every tick."""
    config = tmp_path / "config.toml"
    config.write_text("record_every = 1")
    out = tmp_path / "mine"
    words = ["--config", str(config), "--learner", "random", "--ticks", "300", "--out", str(out), "--quiet"]
    cli("run", "seasons", *words)
    summary = json.loads((out / "summary.json").read_text())
    metrics = pq.read_table(out / "metrics.parquet").to_pydict()
    drive = np.array(metrics["drive"])
    assert summary["mean_drive"] == pytest.approx(drive.mean(), rel=1e-5)
    assert summary["mean_drive_last_tenth"] == pytest.approx(drive[-30:].mean(), rel=1e-5)
    delta = np.abs(np.array(metrics["warmth"]) - 2.0)
    assert summary["mean_abs_deviation"]["agent"]["warmth"] == pytest.approx(delta.mean(), rel=1e-5)
    rests = metrics["action"].count("rest") / 300
    assert summary["action_shares"]["agent"]["rest"] == pytest.approx(rests)


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stopped_run_is_readable_and_goes_on(tmp_path: Path, signum: signal.Signals) -> None:
    """Ctrl-C, SIGTERM and a terminal that is closed leave a whole folder that says where it stopped."""
    out = tmp_path / "mine"
    config = tmp_path / "config.toml"
    config.write_text("checkpoint_every = 100")
    process = subprocess.Popen(
        [sys.executable, "-m", "ecology.lab.cli", "run", "paper", "--learner", "random", "--ticks", "10000000",
         "--config", str(config), "--out", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    until = time.monotonic() + PATIENCE
    while not lived(out) and process.poll() is None and time.monotonic() < until:
        time.sleep(0.05)
    process.send_signal(signum)
    said, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 128 + signum, errors
    assert "Traceback" not in errors
    assert f"--resume {out}" in said
    summary = json.loads((out / "summary.json").read_text())
    stopped = summary["stopped_at"]
    assert stopped == summary["ticks"] > 0
    assert summary["stopped_by"] == signum.name
    metrics = pq.read_table(out / "metrics.parquet")["tick"].to_pylist()
    assert metrics == list(range(10, stopped + 1, 10))
    assert (out / "recording.rrd").stat().st_size > 0

    before = summary
    cli("run", "--resume", str(out), "--ticks", str(stopped + 1025), "--quiet")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["ticks"] == stopped + 1025
    assert "stopped_at" not in summary
    assert all(summary[key] > before[key] for key in ("wall_seconds", "cpu_seconds", "learner_cpu_seconds"))
    metrics = pq.read_table(out / "metrics.parquet")["tick"].to_pylist()
    assert metrics == list(range(10, stopped + 1026, 10))


def test_a_run_that_goes_on_equals_one_that_was_never_left(crowd: Callable[..., Run]) -> None:
    """A resumed life is the uninterrupted one, bit for bit: contacts, noise and choices included."""
    whole = crowd("whole", 300)
    whole.start()
    whole.live()
    first = crowd("parts", 100)
    first.start()
    first.live()
    rest = crowd("parts", 300)
    rest.resume()
    assert rest.now == 100
    rest.live()
    one, other = (checkpoint.read(run.folder / CHECKPOINT) for run in (whole, rest))
    one["tally"][1].pop("seconds"), other["tally"][1].pop("seconds")  # type: ignore[attr-defined]
    for name, (arrays, values) in one.items():
        assert values == other[name][1], name
        for key, array in arrays.items():
            np.testing.assert_array_equal(array, other[name][0][key], err_msg=f"{name} {key}")


def test_resuming_needs_more_ticks(crowd: Callable[..., Run], capsys: pytest.CaptureFixture[str]) -> None:
    """Going on with a run that has lived its ticks gives exit code 2 and says what to do."""
    run = crowd("mine", 50)
    run.start()
    run.live()
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(run.folder)])
    assert "--ticks" in capsys.readouterr().err
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(run.folder), "--ticks", "90", "--seed", "3"])
    assert "--seed" in capsys.readouterr().err


def test_a_killed_run_goes_on_whenever_it_was_killed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What is left at any time can be gone on with, to the same end: config alone, tick 0, no summary."""
    words = ("--learner", "random", "--ticks", "40", "--quiet")

    def end(folder: Path) -> tuple[object, object]:
        summary = json.loads((folder / "summary.json").read_text())
        assert summary["ticks"] == 40
        assert "stopped_at" not in summary
        assert (folder / "recording.rrd").stat().st_size > 0
        assert not (folder / "metrics.parquet.parts").exists()
        return summary["mean_drive"], pq.read_table(folder / "metrics.parquet").to_pydict()

    whole = tmp_path / "whole"
    cli("run", "paper", *words, "--out", str(whole))
    # killed when only the config was there
    early = tmp_path / "early"
    early.mkdir()
    (early / "config.toml").write_text((whole / "config.toml").read_text())
    cli("run", "--resume", str(early), "--quiet")
    assert end(early) == end(whole)
    # killed after the first rows, before a checkpoint of a lived tick
    code = (
        "import os\nfrom ecology.lab import cli\n"
        "from ecology.lab.runs.stopping import Interrupt\nfrom ecology.observers import recorder, rerun\n"
        "recorder.SECONDS = rerun.SECONDS_FILE = 0.0\n"
        "Interrupt.watch = lambda self, state, *_: os.kill(os.getpid(), 9) if state.tick == 25 else None\n"
    )
    killed = tmp_path / "killed"
    live = f"cli.main(['run', 'paper', '--out', {str(killed)!r}, *{words!r}])"
    assert subprocess.run([sys.executable, "-c", code + live], capture_output=True).returncode == -signal.SIGKILL
    assert checkpoint.read(killed / "checkpoint")["tally"][1]["tick"] == 0
    assert (killed / "metrics.parquet.parts").exists()
    cli("run", "--resume", str(killed), "--quiet")
    assert end(killed) == end(whole)
    # killed after a checkpoint of a lived tick: nothing of what was recorded up to it is missing
    (tmp_path / "often.toml").write_text("checkpoint_every = 20")
    code = code.replace("SECONDS = rerun.SECONDS_FILE = 0.0", "SECONDS = 1e9")
    late = tmp_path / "late"
    live = (
        f"cli.main(['run', 'paper', '--out', {str(late)!r}, *{(*words, '--config', str(tmp_path / 'often.toml'))!r}])"
    )
    assert subprocess.run([sys.executable, "-c", code + live], capture_output=True).returncode == -signal.SIGKILL
    assert checkpoint.read(late / "checkpoint")["tally"][1]["tick"] == 20
    cli("run", "--resume", str(late), "--quiet")
    assert end(late) == end(whole)
    # killed after the last checkpoint, before the summary
    (killed / "summary.json").unlink()
    cli("run", "--resume", str(killed), "--quiet")
    assert end(killed) == end(whole)
    # a run that has ended, and one that lost its checkpoints, are not begun again
    for lost, named in (((), "--ticks"), (("checkpoint", "checkpoint.previous"), "no checkpoint")):
        for name in lost:
            shutil.rmtree(killed / name)
        with pytest.raises(SystemExit, match="2"):
            main(["run", "--resume", str(killed)])
        assert named in capsys.readouterr().err


def test_nohup_is_respected() -> None:
    """A run that was told to ignore SIGHUP goes on ignoring it."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    interrupt = Interrupt()
    try:
        interrupt.begin(None, {})  # type: ignore[arg-type]
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        interrupt.end()
        signal.signal(signal.SIGHUP, before)


def test_going_on_writes_nothing_where_it_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A resumed run whose metrics are damaged gives exit code 2 and leaves the folder as it was, config too."""
    out = tmp_path / "mine"
    cli("run", "paper", "--learner", "random", "--ticks", "20", "--out", str(out), "--quiet")
    (out / "metrics.parquet").write_bytes(b"PAR1 no more")
    before = _files(out)
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(out), "--ticks", "40"])
    err = capsys.readouterr().err
    assert "metrics.parquet" in err
    assert "Traceback" not in err
    assert _files(out) == before
    assert not (out / "metrics.parquet.parts").exists()


def _truncate(folder: Path) -> None:
    path = folder / "world.safetensors"
    path.write_bytes(path.read_bytes()[:-8])


def _flip(folder: Path) -> None:
    path = folder / "world.safetensors"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)


def _change(key: str, value: object) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        index = json.loads((folder / "checkpoint.json").read_text())
        index[key] = value
        (folder / "checkpoint.json").write_text(json.dumps(index))

    return change


def _other_tick(folder: Path) -> None:
    index = json.loads((folder / "checkpoint.json").read_text())
    index["values"]["tally"]["closed"] += 1
    (folder / "checkpoint.json").write_text(json.dumps(index))


DAMAGE: dict[str, Callable[[Path], object]] = {
    "arrays cut short": _truncate,
    "a bit flipped": _flip,
    "arrays missing": lambda folder: (folder / "tally.safetensors").unlink(),
    "no index": lambda folder: (folder / "checkpoint.json").unlink(),
    "not an index": lambda folder: (folder / "checkpoint.json").write_bytes(b"\xff\x00"),
    "a list for an index": lambda folder: (folder / "checkpoint.json").write_text("[]"),
    "another format": _change("format", 99),
    "no parts": _change("values", {}),
    "foreign values": _change("values", 3),
    "a number changed": _other_tick,
    "a digest of another kind": _change("digest", []),
    "digests of another kind": _change("digests", 3),
    "brackets without end": lambda folder: (folder / "checkpoint.json").write_text("[" * 100_000),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_checkpoint_is_one_clear_error(
    crowd: Callable[..., Run], capsys: pytest.CaptureFixture[str], damage: str
) -> None:
    """A damaged checkpoint gives exit code 2, names the folder, and leaves the run as it was."""
    run = crowd("mine", 20)
    run.start()
    run.live()
    DAMAGE[damage](run.folder / CHECKPOINT)
    before = _files(run.folder)
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(run.folder), "--ticks", "40"])
    err = capsys.readouterr().err
    assert str(run.folder) in err
    assert "Traceback" not in err
    assert _files(run.folder) == before


def test_a_foreign_checkpoint_is_refused(crowd: Callable[..., Run], tmp_path: Path) -> None:
    """A checkpoint of another scenario, or of other learners, is an error and not a silent mixture."""
    run = crowd("mine", 20)
    run.start()
    run.live()
    for plan in (
        resolve("paper", learners=["random"], ticks=40),
        resolve(str(tmp_path / "crowd.py"), learners=["rest"], ticks=40),
    ):
        with pytest.raises(EcologyError, match="another world"):
            Run(plan, run.folder).resume()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 1}, "seed"),
        ({"changes": {"decay": 0.02}}, "scenario"),
        ({"learners": ["greedy"]}, "learners"),
        ({"edit": ("radius=0.2", "radius=0.19")}, "scenario"),
    ],
)
def test_a_checkpoint_of_another_run_is_refused(
    crowd: Callable[..., Run], tmp_path: Path, change: dict[str, Any], named: str
) -> None:
    """Another seed, setting, learner or edited file is refused by name, though all names are the same."""
    run = crowd("mine", 20)
    run.start()
    run.live()
    file = tmp_path / "crowd.py"
    file.write_text(file.read_text().replace(*change.pop("edit", ("", ""))))
    words: dict[str, Any] = {"learners": ["random"], "ticks": 40} | change
    with pytest.raises(EcologyError, match=f"another world: it differs in {named}\\."):
        Run(resolve(str(file), **words), run.folder).resume()


def test_a_checkpoint_of_other_settings_of_the_learner_is_refused(tmp_path: Path) -> None:
    """An hjb learner of another gamma is refused; a longer life of the same is gone on with."""
    out = tmp_path / "mine"
    small = [word for key in ("width=4", "memory=50") for word in ("--set", f"learner.{key}")]
    cli("run", "paper", "--ticks", "20", "--out", str(out), "--no-record", "--quiet", *small)
    cli("run", "--resume", str(out), "--ticks", "30", "--quiet")
    config = out / "config.toml"
    config.write_text(config.read_text().replace("gamma = 0.995", "gamma = 0.9"))
    with pytest.raises(EcologyError, match="learners"):
        open_run(out, 50).resume()


def test_worlds_that_have_not_changed_open_older_checkpoints() -> None:
    """A field that is younger than a checkpoint is left out of the world's digest where it has its default (LATER)."""
    known = {
        "paper": "22c7d40e5849",
        "seasons": "6913d7312e5d",
        "well_mixed": "f3a96265f9c0",
        "scavengers": "c36b11624054",
    }
    assert {name: world_digest(scenarios.load(name))[:12] for name in known} == known


@pytest.mark.parametrize(("written", "power"), [(True, 2), (False, 0)])
def test_settings_are_read_as_older_runs_wrote_them(written: bool, power: int) -> None:
    """The relative loss weight was 1 / d^2 or none; its power is a setting since."""
    plan = resolve("paper", learners=["hjb"], changes={"learner.width": 8}, record=False)
    settings = {**plan.learners["agent"].settings, "relative_weight": written}
    group = ecology.parallel_env(scenarios.load("paper")).groups["agent"]
    made = agents.make("hjb", group, np.random.SeedSequence(0), settings)
    assert made.encoding.weight_power == power


def test_the_words_of_a_checkpoint_are_the_same_in_every_process() -> None:
    """Neither the order of a mapping nor an address in memory counts."""
    one, other = {"a": 1, "b": (1.0, np.int64(2))}, {"b": [1.0, 2], "a": 1}
    assert json.dumps(words_of(one), sort_keys=True) == json.dumps(words_of(other), sort_keys=True)
    assert words_of(object()) == words_of(object())


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ({"changes": {"learner.memory": 10**15}}, "hjb of 1 agent (memory 1000000000000000)"),
        ({"changes": {"learner.memory": 10**30}}, "memory 1000000"),
    ],
)
def test_what_no_memory_holds_is_one_clear_error(words: dict[str, Any], named: str) -> None:
    """A run that cannot be allocated says what of it was too large."""
    with pytest.raises(EcologyError, match="too large for the memory") as told:
        Run(resolve("paper", **words), Path(os.devnull))
    assert named in str(told.value)
    assert "\n" not in str(told.value)


def test_a_checkpoint_outlives_a_failure_while_it_is_written(tmp_path: Path) -> None:
    """Where the new checkpoint cannot be written, the old one is still there, also between renames."""
    folder = tmp_path / "checkpoint"
    checkpoint.write(folder, {"part": ({"x": np.arange(3)}, {"y": 1})})
    with pytest.raises(TypeError):
        checkpoint.write(folder, {"part": ({"x": np.arange(4)}, {"y": object()})})
    assert checkpoint.read(folder)["part"][1] == {"y": 1}
    folder.rename(tmp_path / "checkpoint.previous")
    arrays, _ = checkpoint.read(folder)["part"]
    np.testing.assert_array_equal(arrays["x"], np.arange(3))
    arrays["x"][0] = 7  # what is read can be written


KILLED = """
import os, pathlib, random, shutil, signal, sys, time
import numpy as np
from ecology.agents import checkpoint
folder = pathlib.Path(sys.argv[1])

def write(n):
    checkpoint.write(folder, {"part": ({"x": np.full(50_000, n)}, {"n": n}), "other": ({}, {"n": n})})

def opens():
    parts = checkpoint.read(folder)
    n = parts["part"][1]["n"]
    assert parts["other"][1]["n"] == n and (parts["part"][0]["x"] == n).all()
    return n

def child(life):
    pid = os.fork()
    if not pid:
        life()
        os._exit(0)
    return pid

left = [signal.SIGKILL]
def kill(event, _):  # an audit event comes before every operation on files
    if event.split(".")[0] in ("open", "os", "shutil"):
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)

def killed_at(operation):
    left[0] = operation
    sys.addaudithook(kill)
    write(3)

seen, operation, status = set(), 0, 1
while status:  # until the write outlives its operations
    operation += 1
    shutil.rmtree(folder.parent, ignore_errors=True)
    write(1), write(2)
    status = os.waitpid(child(lambda: killed_at(operation)), 0)[1]
    seen.add(opens())
print("operations", operation - 1, "left", sorted(seen))

def on_and_on():
    n = opens()
    while True:
        n += 1
        write(n)

rng, moments = random.Random(0), 0
while moments < 60 or opens() <= 20:  # on a busy machine a writer may not come to its first write
    moments += 1
    pid = child(on_and_on)
    time.sleep(rng.uniform(0.002, 0.02))
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    opens()
print("lived to", opens())
"""


def test_a_checkpoint_opens_whenever_its_writer_was_killed(tmp_path: Path) -> None:
    """SIGKILL before every single operation on files, and at 60 random moments or more, leaves a whole checkpoint."""
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path / "run/checkpoint")],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    told = done.stdout.split()
    assert int(told[1]) >= 8  # make, write thrice, remove the previous, rename twice
    assert "left [2, 3]" in done.stdout
    assert int(told[-1]) > 20


def test_the_previous_checkpoint_is_used_on_request(
    crowd: Callable[..., Run], capsys: pytest.CaptureFixture[str]
) -> None:
    """Where the last checkpoint is damaged, the error names the one before it, and `--previous` lives on from there.

    The end is the same as that of a run whose checkpoints were whole; the damaged one is kept aside.
    """
    whole = crowd("whole", 300)
    whole.start()
    whole.live()
    run = crowd("mine", 200)
    run.start()
    run.live()
    assert lived(run.folder) == 200
    _flip(run.folder / "checkpoint")
    before = _files(run.folder)
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(run.folder), "--ticks", "300"])
    assert f"`ecology run --resume {run.folder} --previous`" in capsys.readouterr().err
    assert _files(run.folder) == before
    cli("run", "--resume", str(run.folder), "--previous", "--ticks", "300", "--quiet")
    assert lived(run.folder) == 300
    one, other = (checkpoint.read(each.folder / CHECKPOINT) for each in (whole, run))
    for name, (arrays, _) in one.items():
        for key, array in arrays.items():
            np.testing.assert_array_equal(array, other[name][0][key], err_msg=f"{name} {key}")
    with pytest.raises(EcologyError, match="damaged"):
        checkpoint.read(run.folder / "checkpoint.aside")


def test_a_run_without_a_previous_checkpoint_says_so(
    crowd: Callable[..., Run], capsys: pytest.CaptureFixture[str]
) -> None:
    """`--previous` where there is none, or without `--resume`, gives exit code 2 and says so."""
    run = crowd("mine", 20)
    run.start()
    run.live()
    shutil.rmtree(run.folder / "checkpoint.previous")  # of tick 0
    for words, named in (
        (["--resume", str(run.folder), "--ticks", "40"], "no previous checkpoint"),
        (["paper"], "--resume"),
    ):
        with pytest.raises(SystemExit, match="2"):
            main(["run", *words, "--previous"])
        assert named in capsys.readouterr().err


@pytest.mark.parametrize(("key", "value"), [("format", 1), ("ecology", "0.0.9")])
def test_a_checkpoint_of_another_version_names_both(crowd: Callable[..., Run], key: str, value: object) -> None:
    """Another format, or another version of ecology, is refused with what wrote it and what reads it."""
    run = crowd("mine", 20)
    run.start()
    run.live()
    _change(key, value)(run.folder / "checkpoint")
    written = {"format": checkpoint.FORMAT, "ecology": ecology.__version__} | {key: value}
    with pytest.raises(EcologyError) as told:
        run.restore()
    assert f"by ecology {written['ecology']} in format {written['format']}" in str(told.value)
    assert f"this is ecology {ecology.__version__}, which reads its own in format {checkpoint.FORMAT}" in str(
        told.value
    )


def test_a_full_disk_is_one_clear_error(crowd: Callable[..., Run], monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkpoint that finds no room is an EcologyError, and the one before it is still there."""
    run = crowd("mine", 200)
    run.start()
    real = Path.write_bytes

    def full(path: Path, data: bytes) -> int:
        if run.now == 200:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(path, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(EcologyError, match="No space left on device"):
        run.live()
    assert lived(run.folder) == 100


def test_a_checkpoint_that_may_not_be_read_is_not_called_damaged(
    crowd: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without permission the error names that, and advises no new run."""
    run = crowd("mine", 100)
    run.start()
    run.live()

    def refuse(path: Path, *_: object, **__: object) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    for method in ("read_text", "read_bytes"):
        with monkeypatch.context() as closed:
            closed.setattr(Path, method, refuse)
            with pytest.raises(EcologyError, match="Permission denied") as told:
                checkpoint.read(run.folder / CHECKPOINT)
        assert "damaged" not in str(told.value)
        assert "Start" not in str(told.value)
    assert lived(run.folder) == 100


def test_an_evaluation_that_may_not_be_read_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without permission to read an evaluation the error names that, and does not advise to replace it."""
    (tmp_path / EVALUATION).write_text("{}")

    def refuse(path: Path, *_: object, **__: object) -> str:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "read_text", refuse)
    with pytest.raises(EcologyError, match="Permission denied") as told:
        check_evaluation(tmp_path, {})
    assert "--again" not in str(told.value)


class Diverging(Learner):
    """Lives for a while, then finds that a network of its third agent is no longer finite."""

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Rest."""
        return np.zeros(self.size, np.int64)

    def learn(self, transition: Transition) -> None:
        """Diverge after 30 ticks."""
        self.ticks = getattr(self, "ticks", 0) + 1
        if self.ticks == 30:
            raise DivergedError("the deviation function J", self.group.slots.start + 2, "Lower it.")


def test_a_network_that_diverges_stops_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The error names tick, agent and what to do; the folder keeps the run and the last good checkpoint."""
    monkeypatch.setattr(agents, "LEARNERS", {**agents.LEARNERS, "diverging": (__name__, "Diverging", None, "")})
    (tmp_path / "crowd.py").write_text(CROWD)
    (tmp_path / "config.toml").write_text("checkpoint_every = 20\nrecord_every = 1")
    words = [
        "--learner",
        "diverging",
        "--config",
        str(tmp_path / "config.toml"),
        "--out",
        str(tmp_path / "out"),
    ]
    with pytest.raises(SystemExit, match="2"):
        main(["run", str(tmp_path / "crowd.py"), "--ticks", "100", *words])
    err = capsys.readouterr().err
    assert "tick 30, crowd_2: the deviation function J is no longer finite. Lower it." in err
    assert "Traceback" not in err
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert summary["stopped_at"] == 29
    assert "crowd_2" in summary["stopped_by"]
    assert pq.read_table(tmp_path / "out/metrics.parquet").num_rows == 29 * 12
    assert checkpoint.read(tmp_path / "out/checkpoint")["tally"][1]["tick"] == 20


def test_a_plan_is_what_its_config_says(tmp_path: Path) -> None:
    """Writing a plan and reading it back gives the same plan."""
    plan = resolve("paper", learners=["hjb"], changes={"learner.gamma": 0.9, "heading": False}, seed=4)
    path = tmp_path / "config.toml"
    path.write_text(plan.to_toml())
    again = resolve(config=read_config(path))
    assert again.to_toml() == plan.to_toml()
    assert again.settings["set_points"] == (1.0, 2.0, 3.0, 4.0)


def test_runs_differ_by_their_seed() -> None:
    """Learners and world of different seeds draw different numbers, of one seed the same."""

    def first(seed: int) -> list[int]:
        plan = resolve("seasons", learners=["random"], seed=seed)
        run = Run(plan, Path(os.devnull))
        tick, chosen = run.tick, []
        for _ in range(20):
            action = run.learners["agent"].act(tick.observations["agent"], tick.masks["agent"])
            chosen.append(int(action[0]))
            tick = run.env.step_arrays(action)
        return chosen

    assert first(1) == first(1)
    assert first(1) != first(2)
