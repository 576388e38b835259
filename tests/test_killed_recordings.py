"""A recording of a run that was killed and resumed: it shows the same ticks as that of a run left alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
from same_end import recorded

from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers.census import Expectations, afterwards
from ecology.observers.rerun import Recorded, RerunObserver

TICKS, BETWEEN = 200, (25, 75, 125)  # checkpoints that lie between two samples
AFTER, AGAIN = 13, 16  # ticks after a checkpoint at which a run is killed, and killed again


def watcher(folder: Path, *, resume: bool = False) -> RerunObserver:
    """Return a recorder of the run in `folder`."""
    return RerunObserver(folder / "recording.rrd", every=10, maps_every=70, run=Recorded(resume=resume))


def test_a_recording_that_was_killed_between_two_samples_lacks_nothing(tmp_path: Path) -> None:
    """What is noted between the last sample and a checkpoint is in the file, and rhythms follow the tick."""
    whole = tmp_path / "whole"
    run = Run(resolve("paper", seed=3, ticks=TICKS, checkpoint_every=25), whole)
    run.start()
    for tick in run.living([watcher(whole)], 1):
        if tick - AFTER in BETWEEN:
            shutil.copytree(whole, tmp_path / f"left-{tick - AFTER}")
    one = recorded(whole / "recording.rrd")
    decisions = one["/focus/agent/decision taken"]
    tested = [at for at in BETWEEN if any(at - 5 < tick < at for tick in decisions)]
    assert tested, "no decision was made between a sample and the checkpoint after it"
    left = tmp_path / f"left-{tested[0]}"
    for tick in (tested[0] + 50 + AGAIN, TICKS):
        again = Run(resolve("paper", seed=3, ticks=TICKS, checkpoint_every=25), left)
        again.resume()
        living = again.living([watcher(left, resume=True)], 1)
        killed = tmp_path / f"killed-{tick}"
        for now in living:
            if now == tick < TICKS:
                shutil.copytree(left, killed)
        left = killed if tick < TICKS else left
    other = recorded(left / "recording.rrd")
    assert decisions == other["/focus/agent/decision taken"]
    maps = next(name for name in one if name.startswith("/world/maps"))
    assert sorted(one[maps]) == [0, 70, 140, 200]
    assert set(other[maps]) >= set(one[maps])
    assert one.keys() == other.keys()
    dense = [name for name, found in one.items() if len(found) >= TICKS // 10]
    assert len(dense) > 8
    assert not [name for name in dense if other[name] != one[name] and not name.startswith("/learning/agent/met")]


def test_what_is_shown_twice_is_felt_once() -> None:
    """A tick that is looked at again, while the run waits, counts once in the drive that J is compared with."""
    drives, past = np.random.default_rng(0).random(60), Expectations()
    met = []
    for tick, drive in enumerate(drives.tolist()):
        for _ in range(1 + tick % 3):
            past.follow(1, tick, drive)
        met += past.judge(tick, 0.8, 1.0)
    span = len(drives) - len(met)
    for tick, value in met:
        np.testing.assert_allclose(value, afterwards(drives[tick + 1 : tick + 1 + span], 0.8, 1.0))
