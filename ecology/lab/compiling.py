"""Compiling loops, which the first run on a machine waits for: report it, and share it with a second process.

Later runs load what the first one has kept on disk.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from numba.core import event

from ecology.compiler_cache import is_kept

ABOUT = "compiling (once per machine)"
PATIENCE = 1.0  # seconds of compiling before anything is said
PAUSE = 10.0  # seconds between two lines of progress
BESIDE = "from ecology.lab import compiling; compiling.compile_update()"


class Compiling(event.Listener):
    """Counts the functions that are compiled, and says so; a function that was kept from before is not counted."""

    def __init__(self, say: Callable[[str], None] = lambda _: None) -> None:
        self.say = say  # is told of progress, often
        self.count = 0  # functions compiled so far
        self._depth, self._began = 0, 0.0

    def on_start(self, event: Any) -> None:
        """Note that a function is about to be compiled; one that it calls is compiled within."""
        if not self._depth and not self.count:
            self._began = time.monotonic()
        self._depth += 1
        self._tell()

    def on_end(self, event: Any) -> None:
        """Count a function."""
        self._depth -= 1
        self.count += 1
        self._tell()

    def _tell(self) -> None:
        if time.monotonic() - self._began >= PATIENCE:
            self.say(f"{ABOUT}: {self.count} functions")


class Lines:
    """Prints progress as lines, a few at most."""

    def __init__(self, print_: Callable[[str], None]) -> None:
        self._print, self._then = print_, -float("inf")

    def __call__(self, words: str) -> None:
        """Print `words` unless something was printed a moment ago."""
        if time.monotonic() - self._then >= PAUSE:
            self._then = time.monotonic()
            self._print(words)


notice = Compiling()  # of this process; a command decides where it is said


@contextlib.contextmanager
def announce_compiling(*, quiet: bool = False) -> Iterator[None]:
    """Print lines on stderr while functions are compiled, unless `quiet`."""
    notice.say = _ignore if quiet else Lines(_print_error)
    with event.install_listener("numba:compile", notice):
        yield


def _ignore(words: str) -> None:
    """Print nothing."""


def _print_error(words: str) -> None:
    """Print a line on stderr; a terminal that hung up stops nothing."""
    with contextlib.suppress(OSError):
        print(words, file=sys.stderr, flush=True)


@contextlib.contextmanager
def share_compiling(learners: Iterable[Any]) -> Iterator[None]:
    """Compile the update of the f/J learner in a second process, while this one compiles what the first ticks need.

    The first update waits for it. Nothing happens if the update is on disk, if no learner needs it, or if there is one
    processor only.
    """
    from ecology.machine import count_cpus

    cpu = sys.modules.get("ecology.agents.hjb.devices.cpu.device")  # the f/J learner loads it
    if cpu is None or not any(isinstance(getattr(each, "device", None), cpu.Cpu) for each in learners):
        yield
        return
    if count_cpus() < 2 or is_kept(cpu.update):
        yield
        return
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", BESIDE],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C reaches this process alone
    )

    def wait() -> None:
        process.wait()  # if it failed, it has kept nothing, and this process compiles the update
        notice.count += 1

    cpu.before_update.append(wait)
    try:
        yield
    finally:
        cpu.before_update[:] = [each for each in cpu.before_update if each is not wait]
        process.kill()
        process.wait()


def compile_update() -> None:
    """Compile the update of the f/J learner; its types are the same in every world."""
    import numpy as np

    from ecology import Ecology, agents, scenarios

    group = Ecology(scenarios.load("paper")).groups["agent"]
    agents.make("hjb", group, np.random.SeedSequence(0), {}).compile_update()  # type: ignore[attr-defined]
