"""Runs that stop, or are killed, and are resumed."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from conftest import PATIENCE, hearing
from runs import (
    cli,
    files_of,
    lived,
)

from ecology.agents import checkpoint
from ecology.lab.cli import main
from ecology.lab.runs.folder import CHECKPOINT
from ecology.lab.runs.run import Run
from ecology.lab.runs.stopping import Interrupt


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_stopped_run_is_readable_and_goes_on(tmp_path: Path, signum: signal.Signals) -> None:
    """Ctrl-C, SIGTERM and a terminal that is closed leave a whole folder that says where it stopped."""
    out = tmp_path / "mine"
    config = tmp_path / "config.toml"
    config.write_text("checkpoint_every = 100")
    with hearing(signum):
        process = subprocess.Popen(
            [sys.executable, "-m", "ecology.lab.cli", "run", "paper", "--learner", "random", "--ticks", "10000000",
             "--config", str(config), "--out", str(out)],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    until = time.monotonic() + PATIENCE
    while not lived(out) and process.poll() is None and time.monotonic() < until:
        time.sleep(0.05)
    process.send_signal(signum)
    try:
        said, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
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


@pytest.mark.one_seed("a part of the run is lived by another process")
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
    before = files_of(out)
    with pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", str(out), "--ticks", "40"])
    err = capsys.readouterr().err
    assert "metrics.parquet" in err
    assert "Traceback" not in err
    assert files_of(out) == before
    assert not (out / "metrics.parquet.parts").exists()
