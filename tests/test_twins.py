"""A fork of a run that goes on: both futures side by side, each what it is alone."""

from __future__ import annotations

import json
import threading
import time
from functools import partial
from pathlib import Path

import pytest
from conftest import PATIENCE
from same_end import same_end
from test_fork import CROWD, SMALL, Command, ecology  # noqa: F401  (a fixture)

from ecology import EcologyError
from ecology.lab.runs.minds import decisions
from ecology.lab.runs.run import Run, load_world
from ecology.lab.runs.run_config import resolve
from ecology.observers.base import Observer
from ecology.observers.hindsight import Hindsight
from ecology.observers.readback import column
from ecology.observers.rerun import RerunObserver

CHANGE = "move berries 0.5 1.5"


class Forker(Observer):
    """Forks its run at a tick, and intervenes in both later."""

    def __init__(self, run: Run, at: int) -> None:
        self._run, self._at = run, at

    def watch(self, state, tick, minds) -> None:  # noqa: D102
        if state.tick == self._at:
            assert self._run.fork(do=[CHANGE]) is None
        if state.tick == self._at + 20:
            self._run.do("remove crowd_1")


def new_run(folder: str) -> Run:
    """Return a run of crowd.py that has begun."""
    run = Run(resolve("crowd.py", record=False), Path(folder))
    run.start()
    return run


def test_both_futures_are_what_they_are_alone(ecology: Command) -> None:  # noqa: F811
    """The run has the life that it has without its fork, and the fork that of `ecology fork` with the same line."""
    run = new_run("run")
    run.live([Forker(run, 40)])
    alone = new_run("alone")
    alone.live([type("Remover", (Forker,), {"watch": lambda self, state, tick, minds: (
        alone.do("remove crowd_1") if state.tick == 60 else None)})(alone, 0)])  # fmt: skip
    same_end("run", "alone")
    assert ecology("fork", "alone", "--at", "40", "--do", CHANGE, "--out", "other", "--quiet") == (0, "", "")
    same_end("run-at-40", "other")
    logs = [Path(each, "interventions.jsonl").read_text() for each in ("run", "run-at-40", "other")]
    assert logs == ['{"tick": 60, "do": "remove crowd_1"}\n'] + [f'{{"tick": 40, "do": "{CHANGE}"}}\n'] * 2
    summary = json.loads(Path("run-at-40/summary.json").read_text())
    assert (summary["ticks"], summary["forked_at"], summary["interventions"]) == (120, 40, 1)


def test_both_futures_are_in_one_recording(ecology: Command) -> None:  # noqa: F811
    """From the fork on, the recording of the run shows the other world too, tick by tick, and what differs."""
    run = new_run("run")
    run.live([RerunObserver(Path("both.rrd"), every=10), Forker(run, 40)])
    here, there = (column(Path("both.rrd"), f"{below}/world/agents/crowd", "serial") for below in ("", "/fork"))
    assert list(here) == list(range(0, 121, 10))
    assert list(there) == list(range(50, 121, 10))
    texts = column(Path("both.rrd"), "/futures/text", "TextDocument:text")
    assert f"**run-at-40** left **crowd** at tick 40: **{CHANGE}**" in texts[50][0]
    assert "| crowd alive | 7 | 8 |" in texts[120][0]
    apart = column(Path("both.rrd"), "/futures/apart", "Scalars:scalars")
    assert apart[50][0] < apart[120][0]


def test_a_fork_waits_with_its_run(ecology: Command) -> None:  # noqa: F811
    """While a run waits, its fork is asked too; a second fork is refused, and so is one of a run that is over."""
    from ecology.observers.control import Control

    run = new_run("run")
    run.control = control = Control(paused=True)
    living = threading.Thread(target=run.live)
    living.start()
    until = time.monotonic() + PATIENCE
    while not control.held and time.monotonic() < until:
        time.sleep(0.01)
    try:
        fork = run.fork()
        assert fork is not None
        assert fork.do(CHANGE)
        with pytest.raises(EcologyError, match="one fork at a time"):
            run.fork()
        with pytest.raises(EcologyError, match="there is no"):
            fork.do("move nobody 1 1")
        assert (run.now, fork.now) == (0, 0)
    finally:
        control.order("go")
        living.join()
    assert fork.now == run.now == 120
    with pytest.raises(EcologyError, match="no future"):
        run.fork(Path("late"))
    assert not Path("late").exists()


def test_an_intervention_that_does_not_fit_makes_no_fork(ecology: Command) -> None:  # noqa: F811
    """Nothing is written, and the run goes on."""
    run = new_run("run")
    with pytest.raises(EcologyError, match="nobody"):
        run.fork(do=["move nobody 1 1"])
    assert not Path("run-at-0").exists()
    run.live()
    assert run.now == 120


def test_decisions_are_worked_out_again(ecology: Command) -> None:  # noqa: F811
    """From a checkpoint, they are those that were recorded of the agent in focus, and those of anybody else."""
    crowd = CROWD.replace("count=8", "count=14")
    Path("crowd.py").write_text(crowd)
    words = ("--learner", "hjb", *SMALL, "--keep-every", "40", "--out", "run", "--quiet", "--record", "every=5")
    assert ecology("run", "crowd.py", *words) == (0, "", "")
    told = column(Path("run/recording.rrd"), "/focus/crowd/decision", "TextDocument:text")
    again = decisions(Path("run"), "crowd_0", 100)
    assert set(range(61, 121)) <= set(again) <= set(range(51, 121))
    shared = sorted(set(told) & set(again))
    assert len(shared) > 12

    def table(text: str) -> list[str]:
        lines = [line for line in text.partition("| after ")[0].splitlines() if line]
        return [line for line in lines if not line.startswith("plan:")]

    for tick in shared:
        assert table(told[tick][0]) == table(again[tick])
    assert all(text.startswith("**crowd_9**: ") for text in decisions(Path("run"), "crowd_9", 100).values())
    past = Hindsight(Path("run/recording.rrd"), load_world(Path("run")), "run", partial(decisions, Path("run")))
    Path("layer.rrd").write_bytes(past.layer("crowd_9", 100))
    drawn = column(Path("layer.rrd"), "/chosen/crowd_9/decision", "TextDocument:text")
    assert "to 120 were worked out again." in drawn[0][0]
    assert drawn[100][0].startswith("**crowd_9**: ")
