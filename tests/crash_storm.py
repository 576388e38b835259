"""Kill runs at random moments and resume them: none may be lost, and all must end bit for bit as runs left alone.

`python crash_storm.py [KILLS] [FOLDER] [SEED]` (`make storm`): KILLS over four scenarios, 200 by default. A run lives
in a process that is forked from this one, which has everything loaded, and is ended by SIGKILL after a time drawn
between 0 and what the run left alone took. A run that is killed is resumed; one that comes to its end is compared,
and another is begun. Compared are the last checkpoint, the metrics, the ticks of all that the recording samples, and
which files the folder holds.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from same_end import recorded, same_end

from ecology.lab.cli import live as _live  # noqa: F401  (what a run needs is loaded before it is forked)
from ecology.lab.cli import main
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers import recorder as _recorder  # noqa: F401
from ecology.observers import rerun as _rerun  # noqa: F401

SCENARIOS: dict[str, dict[str, Any]] = {  # ticks, and what else the run is told
    "paper": {"ticks": 1_500},
    "predator_prey": {"ticks": 250},
    "commons": {"ticks": 500},
    "seasons": {"ticks": 1_500},
}
CHECKPOINTS = 12  # of a run
RESUMES = 50  # of one life, in which it must come to its end once its kills are used up


def begin(scenario: str, folder: Path, seed: int) -> None:
    """Write the folder of a run that has not lived yet."""
    shutil.rmtree(folder, ignore_errors=True)
    words = dict(SCENARIOS[scenario])
    every = words["ticks"] // CHECKPOINTS
    Run(resolve(scenario, seed=seed, checkpoint_every=every, record_every=10, **words), folder).start()


def resume(folder: Path, seconds: float | None) -> int | None:
    """Resume a run in a process of its own, which is killed after `seconds`; return its exit code, None if killed."""
    child = os.fork()
    if not child:
        code = 1
        try:
            os.setsid()
            with (folder.parent / "storm.log").open("a") as log:
                os.dup2(log.fileno(), 1)
                os.dup2(log.fileno(), 2)
            main(["run", "--resume", str(folder), "--quiet"])
        except SystemExit as left:
            code = int(left.code or 0)
        finally:
            os._exit(code)
    end = None if seconds is None else time.monotonic() + seconds
    while True:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        if end is not None and time.monotonic() >= end:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return None
        time.sleep(0.002)


def compare(alone: Path, folder: Path) -> None:
    """Raise AssertionError where a run that was killed differs from the one that was left alone."""
    same_end(str(alone), str(folder))
    assert pq.read_table(alone / "metrics.parquet").equals(pq.read_table(folder / "metrics.parquet")), "metrics"
    one, other = recorded(alone / "recording.rrd"), recorded(folder / "recording.rrd")
    samples = max(map(len, one.values()))  # what is drawn only when it changes is drawn again after a resume
    differ = sorted(name for name, ticks in one.items() if len(ticks) >= samples - 1 and ticks != other.get(name))
    assert not differ, f"recording: {differ[:5]}"
    left = sorted(files(folder) ^ files(alone))
    assert not left, f"files: {left[:5]}"


def is_over(folder: Path, ticks: int) -> bool:
    """Return whether a run has written its summary, which it does last."""
    path = folder / "summary.json"
    return path.exists() and json.loads(path.read_text())["ticks"] == ticks


def files(folder: Path) -> set[str]:
    """Return the paths in a folder of all that it holds."""
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def storm(scenario: str, kills: int, out: Path, rng: np.random.Generator) -> tuple[int, int, list[str]]:
    """Kill runs of a scenario `kills` times; return how many were killed, how many lives ended, and what differed."""
    seed = int(rng.integers(1_000))
    alone = out / f"{scenario}-alone"
    began = time.monotonic()
    begin(scenario, alone, seed)
    assert resume(alone, None) == 0, "the run that is left alone failed"
    took, killed, ended, differ, life = time.monotonic() - began, 0, 0, [], 0
    while killed < kills or life:
        if not life:
            folder = out / f"{scenario}-{ended}"
            begin(scenario, folder, seed)
        life += 1
        code = resume(folder, took * rng.random() if killed < kills else None)
        killed += code is None
        if code is None and is_over(folder, SCENARIOS[scenario]["ticks"]):
            code = 0  # it was killed when all was written, and there is nothing to resume
        if code not in (None, 0) or life > RESUMES + kills:
            differ.append(f"{folder}: exit code {code} at the {life}th resume")
        elif code == 0:
            try:
                compare(alone, folder)
                shutil.rmtree(folder)
            except AssertionError as error:
                differ.append(f"{folder}: {error}")
        if code is not None:
            ended, life = ended + 1, 0
    return killed, ended, differ


def run(kills: int, out: Path, seed: int) -> bool:
    """Run the storm, print what it came to, and return whether nothing differed."""
    out.mkdir(parents=True, exist_ok=True)
    share, good = -(-kills // len(SCENARIOS)), True
    for i, scenario in enumerate(SCENARIOS):
        began = time.monotonic()
        killed, ended, differ = storm(scenario, share, out, np.random.default_rng([seed, i]))
        good &= not differ
        print(
            f"{scenario}: {killed} kills, {ended} lives, {len(differ)} differ, {time.monotonic() - began:.0f} s",
            flush=True,
        )
        print("".join(f"  {each}\n" for each in differ), end="", flush=True)
    return good


if __name__ == "__main__":
    told = sys.argv[1:]
    sys.exit(
        not run(
            int(told[0]) if told else 200, Path(told[1] if told[1:] else "runs/storm"), int(told[2]) if told[2:] else 0
        )
    )
