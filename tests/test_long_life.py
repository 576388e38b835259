"""A long life: what a recorded run takes of memory and disk does not grow, no name returns, every account closes.

`ECOLOGY_LONG=1000000` lives that many ticks (half an hour to an hour) instead of some hundred.
"""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from ecology import contract
from ecology.lab.cli import main
from ecology.lab.runs.run import Run
from ecology.observers import viewer

LONG = int(os.environ.get("ECOLOGY_LONG", "0"))  # ticks of the life in the long setting
TICKS, EVERY = (LONG, 100) if LONG else (300, 1)
MARKS = 10  # times that memory is looked at; at the second, the run is warm
MEMORY = 16.0  # MiB by which a warm run may grow; with an index of the recording in memory some 50
SAMPLE = 20_000  # bytes that a sample of these few agents may take on disk
WORDS = {
    **{"prey": 4, "predators": 2, "patches": 3, "side": 4, "arrival": 0.01},
    **{"learner.width": 8, "learner.update_every": 30.0},
    **({} if LONG else {"prey_mortality": 0.01}),  # so that some die
}


def resident() -> float:
    """Return what this process holds in memory, MiB."""
    told = Path("/proc/self/status").read_text()
    return int(re.search(r"VmRSS:\s*(\d+) kB", told)[1]) / 1024


class Witness:
    """Watches every tick: names, accounts, and now and then memory."""

    def begin(self, env, minds):
        """Remember the start."""
        self.env, self.first = env, env.state_view.copy()
        self.next, self.born, self.memory = env.state_view.next_serial, 0, []

    def watch(self, state, tick, minds):
        """Hold newborns to the next serials, each given once; the accounts to close."""
        given = sorted(state.serial[tick.born].tolist())
        assert given == list(range(self.next, state.next_serial))
        self.next, self.born = state.next_serial, self.born + len(given)
        if state.tick % EVERY == 0:
            contract.account_closes(self.env, self.first)
        if state.tick % (TICKS // MARKS) == 0:
            self.memory.append(resident())

    def end(self):
        """Nothing to close."""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_a_long_life_takes_no_more_memory(tmp_path, monkeypatch):
    """A recorded run is flat in memory after its first fifth; its files are in proportion to its samples."""
    from ecology.observers import rerun

    witness, live = Witness(), Run.live
    monkeypatch.setattr(Run, "live", lambda self, observers: live(self, [*observers, witness]))
    if not LONG:  # every sample is sent alone, as many chunks as in minutes, and waited for: a queue takes memory too
        send = rerun.RerunObserver._send
        monkeypatch.setattr(rerun, "SECONDS_FILE", 0.0)
        monkeypatch.setattr(rerun.RerunObserver, "_send", lambda self: (send(self), self._rec.flush(timeout_sec=60.0)))
    words = [word for key, value in WORDS.items() for word in ("--set", f"{key}={value}")]
    out = tmp_path / "run"
    with pytest.raises(SystemExit) as left:
        main(["run", "predator_prey", "--ticks", str(TICKS), "--record", f"every={EVERY}", *words, "--out", str(out)])
    assert not left.value.code
    print("memory in MiB", np.round(witness.memory, 1).tolist())
    assert max(witness.memory[1:]) - witness.memory[1] < MEMORY

    summary = json.loads((out / "summary.json").read_text())
    assert summary["births"] == witness.born > 0
    assert summary["deaths"] > 0
    metrics = pq.read_table(out / "metrics.parquet", columns=["tick", "agent"])
    lives = metrics.group_by("agent").aggregate([("tick", "min"), ("tick", "max"), ("tick", "count")]).to_pydict()
    spans = [np.array(lives[f"tick_{word}"]) for word in ("min", "max", "count")]
    assert ((spans[1] - spans[0]) // EVERY + 1 == spans[2]).all()  # who is gone does not return
    assert viewer.is_complete(out / "recording.rrd")
    for file in ("recording.rrd", "metrics.parquet"):
        size = (out / file).stat().st_size
        print(file, size, "bytes", size / (TICKS // EVERY), "per sample")
        assert size < SAMPLE * TICKS // EVERY
