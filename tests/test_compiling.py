"""A first run says what it waits for."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numba
import pytest
from numba.core import event

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
    tally = SimpleNamespace(tick=0, mean_drive=lambda start, own=False: None)
    progress = Progress(tally, 60_000)  # type: ignore[arg-type]
    progress.begin(None, {})  # type: ignore[arg-type]
    progress._then -= 300.0  # the first tick took minutes
    monkeypatch.setattr(compiling.notice, "count", compiling.notice.count + 30)
    tally.tick = 1
    progress.watch(None, None, {})  # type: ignore[arg-type]
    assert capsys.readouterr().err == ""
    progress._then = time.monotonic() - 10.0
    tally.tick = 1001
    progress.watch(None, None, {})  # type: ignore[arg-type]
    assert capsys.readouterr().err.startswith("tick 1,001 of 60,000  100 ticks/s")
