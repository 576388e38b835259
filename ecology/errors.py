"""One family of errors for everything a user can get wrong."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


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
