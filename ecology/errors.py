"""One family of errors for everything a user can get wrong."""

from __future__ import annotations

import contextlib
import difflib
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
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


def is_from_system(error: BaseException) -> bool:
    """Return whether the operating system refused something: no room, no permission, a broken disk.

    A file that is there but is not what it should be is no such thing: libraries raise OSError without a number then.
    """
    return isinstance(error, OSError) and error.errno is not None


def describe_refusal(error: OSError) -> str:
    """Return what the operating system refused and why, as "'FILE': No space left on device"."""
    reason = os.strerror(error.errno) if error.errno is not None else str(error)
    return reason if error.filename is None else f"{str(error.filename)!r}: {reason}"


@contextlib.contextmanager
def writable(folder: Path, then: Callable[[], str] = str) -> Iterator[None]:
    """Turn a failure to write into an EcologyError that names the folder, and says what to do `then`."""
    try:
        yield
    except OSError as error:
        raise EcologyError(
            f"the folder {str(folder)!r} cannot be written ({describe_refusal(error)}). Make room, allow writing "
            f"there, or give another. {then()}".rstrip()
        ) from error


@contextlib.contextmanager
def readable(what: str, path: Path) -> Iterator[None]:
    """Turn a refusal of the operating system to read `what` at `path` into an EcologyError with its cause.

    That something is missing is left to the caller.
    """
    try:
        yield
    except FileNotFoundError:
        raise
    except OSError as error:
        if not is_from_system(error):
            raise
        raise EcologyError(
            f"{what} {str(path)!r} cannot be read ({describe_refusal(error)}); it may be whole. Allow reading it, "
            "then run the same command again."
        ) from error


def check_writable(folder: Path) -> None:
    """Raise EcologyError unless files can be made in `folder`, or it can be made; nothing is left of the trial."""
    with writable(folder):
        existing = next(path for path in (folder, *folder.parents) if path.exists())
        if not existing.is_dir():
            raise EcologyError(f"{str(existing)!r} is a file where a folder is to be written; move it away.")
        with tempfile.TemporaryFile(dir=existing):
            pass
