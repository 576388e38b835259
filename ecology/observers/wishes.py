"""Whom those who watch a run wish to see in focus: clicks in a browser, and the words of `ecology focus`.

A run takes its wishes at its samples, so whoever wishes never waits on it nor disturbs it. Clicks come
from another thread of the same process; words from another process, by a file in the run's folder that
the run answers in.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ecology.errors import EcologyError

AGENTS = "/world/agents"  # below it every species is an entity whose instances are its slots
FILE = "focus.json"  # in the run's folder, while somebody waits for an answer
KEPT = 16  # clicks that may wait for a sample; of more, the last
PATIENCE, PAUSE = 60.0, 0.1  # seconds granted to a run to answer, and between two looks


@dataclass(frozen=True)
class Click:
    """What was selected in a viewer."""

    entity: str  # path, as /world/agents/prey
    row: int  # of the entity's instances, at least 0
    tick: float | None = None  # that was shown; None where it is not known


class Wishes:
    """What is wished of one run; `click` may be called from any thread."""

    def __init__(self, folder: Path | None = None) -> None:
        """Take clicks, and with a `folder` the words that `ask` leaves there from now on."""
        self._clicks: deque[Click] = deque(maxlen=KEPT)
        self._file = None if folder is None else folder / FILE
        if self._file is not None:
            with contextlib.suppress(OSError):  # of a run before, whose asker was killed
                self._file.unlink()

    def click(self, click: Click) -> None:
        """Wish for who was clicked."""
        self._clicks.append(click)

    def clicks(self) -> list[Click]:
        """Return the clicks since the last time."""
        found = []
        while self._clicks:
            found.append(self._clicks.popleft())
        return found

    def word(self) -> str | None:
        """Return the word that waits for an answer, None without one."""
        if self._file is None or not os.path.exists(self._file):
            return None
        told = _read(self._file)
        word = told.get("focus")
        return word if isinstance(word, str) and "answer" not in told else None

    def answer(self, word: str, said: str, *, done: bool) -> None:
        """Tell who asked for `word` what has become of it."""
        if self._file is not None:
            with contextlib.suppress(OSError):  # who asked may be gone
                _write(self._file, {"focus": word, "answer": said, "done": done})


def ask(folder: Path, word: str, lives: Callable[[], bool], patience: float = PATIENCE) -> str:
    """Wish for `word` of the run in `folder`, which `lives`; return what it says.

    Raises EcologyError where the run refuses, has ended or does not answer.
    """
    file = folder / FILE
    try:
        _write(file, {"focus": word})
        until = time.monotonic() + patience
        while time.monotonic() < until:
            told = _read(file)
            if told.get("focus") == word and "answer" in told:
                if told.get("done"):
                    return str(told["answer"])
                raise EcologyError(str(told["answer"]))
            if not lives():
                raise EcologyError(
                    f"no run is alive in {str(folder)!r}; of one that was recorded, look by "
                    f"`ecology view {folder} --focus {word}`."
                )
            time.sleep(PAUSE)
    except OSError as error:
        raise EcologyError(f"the folder {str(folder)!r} cannot be written ({error.strerror or error}).") from error
    finally:
        with contextlib.suppress(OSError):
            file.unlink()
    raise EcologyError(
        f"the run in {str(folder)!r} did not answer within {patience:.0f} seconds: it is slow, or neither recorded "
        "nor watched; ask again, or start it with --view or --serve."
    )


def _read(file: Path) -> dict[str, object]:
    """Return what the file says, nothing where it is not there or garbage."""
    try:
        told = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return told if isinstance(told, dict) else {}


def _write(file: Path, told: dict[str, object]) -> None:
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    beside.write_text(json.dumps(told), encoding="utf-8")
    beside.replace(file)
