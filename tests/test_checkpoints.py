"""Checkpoints: damaged, foreign, older and half-written ones."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PATIENCE
from runs import (
    cli,
    files_of,
    lived,
)

import ecology
from ecology import EcologyError, agents, scenarios
from ecology.agents import checkpoint
from ecology.lab.cli import main
from ecology.lab.runs.folder import CHECKPOINT, EVALUATION, check_evaluation
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import resolve, words_of, world_digest


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
    before = files_of(run.folder)
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(run.folder), "--ticks", "40"])
    err = capsys.readouterr().err
    assert str(run.folder) in err
    assert "Traceback" not in err
    assert files_of(run.folder) == before


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
    before = files_of(run.folder)
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(run.folder), "--ticks", "300"])
    assert f"`ecology run --resume {run.folder} --previous`" in capsys.readouterr().err
    assert files_of(run.folder) == before
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
