"""A request to a run from another process: a file in the run's folder that the run answers in."""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

from ecology.errors import EcologyError

PATIENCE, PAUSE = 60.0, 0.1  # seconds granted to a run to answer, and between two looks


class Mailbox:
    """The requests of one kind to one run, one at a time; the file is there while somebody waits for an answer."""

    def __init__(self, folder: Path, kind: str) -> None:
        """Take requests that `request` leaves in `folder` from now on."""
        self._kind, self._file = kind, folder / f"{kind}.json"
        with contextlib.suppress(OSError):  # of a run before, whose asker was killed
            self._file.unlink()

    def waiting(self) -> str | None:
        """Return the request that waits for an answer, None without one."""
        if not os.path.exists(self._file):
            return None
        message = _read(self._file)
        word = message.get(self._kind)
        return word if isinstance(word, str) and "answer" not in message else None

    def answer(self, word: str, said: str, *, done: bool) -> None:
        """Answer the request `word`: whether it was `done`, and what to tell."""
        with contextlib.suppress(OSError):  # the requester may be gone
            _write(self._file, {self._kind: word, "answer": said, "done": done})


def request(
    folder: Path,
    kind: str,
    word: str,
    lives: Callable[[], bool],
    *,
    ended: str,
    silent: str,
    patience: float | None = None,
    pause: float | None = None,
) -> str:
    """Make a request of a `kind` to the run in `folder`, which `lives`; return its answer.

    Raises EcologyError where the run refuses, has `ended` or stays `silent`: what to say then.
    """
    file = folder / f"{kind}.json"
    patience = PATIENCE if patience is None else patience
    try:
        _write(file, {kind: word})
        until = time.monotonic() + patience
        while time.monotonic() < until:
            message = _read(file)
            if message.get(kind) == word and "answer" in message:
                if message.get("done"):
                    return str(message["answer"])
                raise EcologyError(str(message["answer"]))
            if not lives():
                raise EcologyError(f"no run is alive in {str(folder)!r}; {ended}")
            time.sleep(PAUSE if pause is None else pause)
    except OSError as error:
        raise EcologyError(f"the folder {str(folder)!r} cannot be written ({error.strerror or error}).") from error
    finally:
        with contextlib.suppress(OSError):
            file.unlink()
    raise EcologyError(f"the run in {str(folder)!r} did not answer within {patience:.0f} seconds: {silent}")


def _read(file: Path) -> dict[str, object]:
    """Return what the file says, nothing where it is not there or garbage."""
    try:
        message = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def _write(file: Path, message: dict[str, object]) -> None:
    beside = file.with_name(f"{file.name}.{os.getpid()}")
    beside.unlink(missing_ok=True)  # it may be a link
    with beside.open("x", encoding="utf-8") as opened:
        opened.write(json.dumps(message))
    beside.replace(file)
