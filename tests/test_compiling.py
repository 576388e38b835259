"""A first run says what it waits for."""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import event

from ecology import Ecology, agents, scenarios
from ecology.agents import hjb
from ecology.agents.hjb.devices.cpu import device as cpu
from ecology.lab import compiling
from ecology.lab.cli.options import announces_compiling
from ecology.lab.cli.progress import Progress
from ecology.lab.compiling import Compiling, Lines


@pytest.fixture
def doubled() -> Any:
    """Return a function that is not compiled yet, and calls another."""

    @numba.njit
    def inner(x):
        return x + x

    @numba.njit
    def outer(x):
        return inner(x)

    return outer


def test_compiling_is_said_once_per_function(monkeypatch: pytest.MonkeyPatch, doubled: Any) -> None:
    """While functions are compiled that is said; a call of a compiled one says nothing."""
    monkeypatch.setattr(compiling, "PATIENCE", 0.0)
    said: list[str] = []
    listener = Compiling(said.append)
    with event.install_listener("numba:compile", listener):
        assert doubled(2) == 4
        assert said[0] == "compiling (once per machine): 0 functions"
        assert said[-1] == "compiling (once per machine): 2 functions"
        said.clear()
        assert doubled(3) == 6
    assert (said, listener.count) == ([], 2)


def test_what_is_compiled_at_once_is_not_said(monkeypatch: pytest.MonkeyPatch, doubled: Any) -> None:
    """Nothing is said of less than a second."""
    monkeypatch.setattr(compiling, "PATIENCE", 3600.0)
    said: list[str] = []
    with event.install_listener("numba:compile", Compiling(said.append)):
        doubled(2)
    assert said == []


def test_lines_are_few() -> None:
    """Where there is no bar, progress within a moment is one line."""
    lines: list[str] = []
    say = Lines(lines.append)
    for words in ("first", "second", "third"):
        say(words)
    assert lines == ["first"]


@pytest.mark.parametrize("quiet", [True, False])
def test_a_command_says_it_unless_it_is_quiet(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], doubled: Any, quiet: bool
) -> None:
    """Whatever command compiles says so on stderr; with --quiet it does not."""
    monkeypatch.setattr(compiling, "PATIENCE", 0.0)
    announces_compiling(lambda quiet: doubled(2))(quiet=quiet)
    assert ("compiling (once per machine)" in capsys.readouterr().err) is not quiet


def test_a_tick_that_compiled_is_no_measure_of_speed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first line of progress counts from the end of compiling: no run starts at 0 ticks per second."""
    totals = SimpleNamespace(tick=0, mean_drive=lambda start, own=False: None)
    progress = Progress(totals, 60_000)  # type: ignore[arg-type]
    progress.begin(None, {})  # type: ignore[arg-type]
    progress._then -= 300.0  # the first tick took minutes
    monkeypatch.setattr(compiling.notice, "count", compiling.notice.count + 30)
    totals.tick = 1
    progress.watch(None, None, {})  # type: ignore[arg-type]
    assert capsys.readouterr().err == ""
    progress._then = time.monotonic() - 100.0
    totals.tick = 1001
    progress.watch(None, None, {})  # type: ignore[arg-type]
    assert capsys.readouterr().err.startswith("tick 1,001 of 60,000  10 ticks/s")


@pytest.fixture
def learner(monkeypatch: pytest.MonkeyPatch) -> hjb.HJB:
    """Return a learner on a machine of two processors where no update was ever compiled."""
    monkeypatch.setattr("ecology.machine.count_cpus", lambda: 2)
    monkeypatch.setattr(compiling, "is_kept", lambda function: False)
    group = Ecology(scenarios.load("paper")).groups["agent"]
    made = agents.make("hjb", group, np.random.SeedSequence(0), {"width": 4})
    assert isinstance(made, hjb.HJB)
    return made


def test_the_first_update_waits_for_the_process_that_compiles_it(
    monkeypatch: pytest.MonkeyPatch, learner: hjb.HJB, tmp_path: Path
) -> None:
    """A second process is at work until the first update, which waits for it once."""
    done, counted = tmp_path / "done", compiling.notice.count
    monkeypatch.setattr(compiling, "BESIDE", f"import time; time.sleep(0.5); open({str(done)!r}, 'w')")
    with compiling.share_compiling([learner]):
        assert not done.exists()
        learner.compile_update()
        assert done.exists()
        assert cpu.before_update == []
        assert compiling.notice.count > counted


def test_the_second_process_ends_with_the_run(
    monkeypatch: pytest.MonkeyPatch, learner: hjb.HJB, tmp_path: Path
) -> None:
    """A run that ends before its first update leaves no process, and nothing to wait for."""
    pid = tmp_path / "pid"
    code = f"import os, time; open({str(pid)!r}, 'w').write(str(os.getpid())); time.sleep(600)"
    monkeypatch.setattr(compiling, "BESIDE", code)
    with compiling.share_compiling([learner]):
        while not pid.exists() or not pid.read_text():
            time.sleep(0.01)
    assert cpu.before_update == []
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid.read_text()), 0)


@pytest.mark.parametrize("without", ["learner", "processors", "need"])
def test_no_process_is_started_without_need(
    monkeypatch: pytest.MonkeyPatch, learner: hjb.HJB, tmp_path: Path, without: str
) -> None:
    """Not for learners without an update, on one processor, or where the update is on disk."""
    monkeypatch.setattr(compiling, "BESIDE", f"open({str(tmp_path / 'done')!r}, 'w')")
    if without == "processors":
        monkeypatch.setattr("ecology.machine.count_cpus", lambda: 1)
    elif without == "need":
        monkeypatch.setattr(compiling, "is_kept", lambda function: True)
    with compiling.share_compiling([object()] if without == "learner" else [learner]):
        assert cpu.before_update == []
        learner.compile_update()
    assert not (tmp_path / "done").exists()


def test_what_was_compiled_is_on_disk(learner: hjb.HJB, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the update has been compiled, its code is found on disk."""
    monkeypatch.undo()
    learner.compile_update()
    assert compiling.is_kept(cpu.update)
    monkeypatch.setattr(cpu.update._cache._cache_file, "_source_stamp", "of other sources")
    assert not compiling.is_kept(cpu.update)


@pytest.mark.parametrize(("scenario", "name"), [("predator_prey", "hjb"), ("colony", "lean"), ("paper", "algorithm1")])
def test_the_update_is_compiled_once_for_all_worlds_and_learners(learner: hjb.HJB, scenario: str, name: str) -> None:
    """Its types are the same everywhere, so a second process can compile it without knowing the run."""
    learner.compile_update()
    for group in Ecology(scenarios.load(scenario)).groups.values():
        other = agents.make(name, group, np.random.SeedSequence(0), {})
        assert isinstance(other, hjb.HJB)
        other.compile_update()
    assert len(cpu.update.signatures) == 1
