"""Say that loops are being compiled: the first run on a machine waits for that, and later ones do not."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from numba.core import event

ABOUT = "compiling (once per machine)"
PATIENCE = 1.0  # seconds of compiling before anything is said
PAUSE = 10.0  # seconds between two lines of progress


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
def announced(*, quiet: bool = False) -> Iterator[None]:
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
