"""One family of errors for everything a user can get wrong."""

from __future__ import annotations

import contextlib
import difflib
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path


class EcologyError(ValueError):
    """Bad input: the message states the rule, shows the value and says what to do.

    The command line prints the message alone and exits with code 2.
    """


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a sentence that names the known words nearest to `name`."""
    words = sorted(known)
    close = difflib.get_close_matches(str(name), words, n=3, cutoff=0.5)
    if close:
        return f"Did you mean {' or '.join(repr(word) for word in close)}?"
    return f"Known: {', '.join(words) if words else '(none)'}."


@contextlib.contextmanager
def writable(folder: Path) -> Iterator[None]:
    """Turn a failure to write into an EcologyError that names the folder."""
    try:
        yield
    except OSError as error:
        raise EcologyError(
            f"the folder {str(folder)!r} cannot be written ({error.strerror or error}). Make room, allow writing "
            "there, or give another."
        ) from error


def check_writable(folder: Path) -> None:
    """Raise EcologyError unless files can be made in `folder`, or it can be made; nothing is left of the trial."""
    with writable(folder):
        there = next(path for path in (folder, *folder.parents) if path.exists())
        if not there.is_dir():
            raise EcologyError(f"{str(there)!r} is a file where a folder is to be written; move it away.")
        with tempfile.TemporaryFile(dir=there):
            pass
