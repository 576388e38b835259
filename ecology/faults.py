"""An exception in a user's own code: reported by its place there, without the project's frames around it.

A user's own code is a scenario file, what it imports, and a learner: whatever is neither a library's nor the
project's. Those of shipped scenarios and learners are reported in the same way.
"""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path

from ecology.errors import EcologyError

HOUSE = {str(Path(__file__).parent)}  # folders of the project; packages built on this one add theirs
SHIPPED: set[str] = set()  # files within them that are reported like a user's own: scenarios and learners
LIBRARIES = {sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")}
MOVED = ("agents", "scenarios")  # packages of the project that were imported by these names
FOREIGN = {"site-packages", "dist-packages"}  # folders of libraries, wherever they lie


class FaultError(EcologyError):
    """An exception in a user's own code; `frames` is its traceback from there on, as text."""

    def __init__(self, message: str, frames: str) -> None:
        super().__init__(message)
        self.frames = frames


def user_fault(error: BaseException) -> FaultError | None:
    """Return what `error` says and where in a user's own code it came from; None where it came from elsewhere."""
    if isinstance(error, FaultError):
        return error
    frames = traceback.extract_tb(error.__traceback__)
    own = [i for i, frame in enumerate(frames) if _is_own(frame.filename)]
    if not own:
        return None
    where = frames[own[-1]]
    place = f"{where.filename}, line {where.lineno}, in {where.name}"
    return FaultError(f"{place}: {_words(error)}", "".join(traceback.format_list(frames[own[0] :])))


def wrap(what: str, error: BaseException, then: str = "") -> EcologyError:
    """Return the error that says that `what` failed by `error`, where, and what to do `then`."""
    fault, message = user_fault(error), f"{what}: {describe(error)}. {then}".rstrip()
    return EcologyError(message) if fault is None else FaultError(message, fault.frames)


def describe(error: BaseException) -> str:
    """Return what `error` says, and where it came from if that is a user's own code."""
    return str(user_fault(error) or _words(error))


def _words(error: BaseException) -> str:
    said = str(error).strip()
    if isinstance(error, ModuleNotFoundError) and error.name in MOVED:
        said += f". It is ecology.{error.name} now: write `from ecology import {error.name}`"
    return said if isinstance(error, EcologyError) else f"{type(error).__name__}: {said}".removesuffix(": ")


def _is_own(file: str) -> bool:
    """Return whether `file` is a scenario, a learner, or neither of the project nor of a library."""
    return file in SHIPPED or not is_foreign(file)


def is_foreign(file: str) -> bool:
    """Return whether `file` is the project's or a library's, not a user's."""
    path = Path(file)
    above = set(map(str, path.parents))
    return file.startswith("<") or bool(above & (HOUSE | LIBRARIES)) or bool(FOREIGN & set(path.parts))
