"""The command line. What is slow to load (numba, torch, rerun, matplotlib) is loaded by the command that needs it."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

from ecology import faults
from ecology.errors import EcologyError, describe_refusal, is_from_system
from ecology.lab.cli.app import app
from ecology.lab.cli.options import spell_out
from ecology.lab.runs.stopping import StoppedError

__all__ = ["app", "main"]


def main(words: Sequence[str] | None = None) -> None:
    """Run the command line; a user's error is one message on stderr and exit code 2.

    Before the message of an exception in a user's own code stand the frames from there on.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # torch reads it; on small networks threads only cost
    given = list(sys.argv[1:] if words is None else words)
    try:
        app(args=spell_out(given))
    except StoppedError as stopped:
        sys.exit(128 + stopped.signum)
    except Exception as error:
        cause = error if isinstance(error, EcologyError) else faults.user_fault(error) or _describe_refused(error)
        if cause is None:
            raise
        frames = cause.frames if isinstance(cause, faults.FaultError) else ""
        print(f"{frames}ecology: {cause}", file=sys.stderr)
        sys.exit(2)


def _describe_refused(error: Exception) -> EcologyError | None:
    """Return what to say where the operating system refused a path that the user gave; else None."""
    if not isinstance(error, OSError) or not is_from_system(error) or error.filename is None:
        return None
    return EcologyError(f"{describe_refusal(error)}. Give another path, or allow using this one.")
