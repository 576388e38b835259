"""Values as a user types them after KEY=: numbers, true or false, lists, None, quoted text, or plain words."""

from __future__ import annotations

import ast
import contextlib
import tomllib
import warnings
from typing import Any

OPENING, CLOSING, QUOTES = "[({", "])}", "\"'"


def read_value(text: str) -> Any:
    """Return the value of `text`: what TOML or else Python makes of it, or the text itself where it is neither.

    So `true` and `True`, `.003` and `0.003`, `[1, 2]` and `(1, 2)` are the same, and `None` is None.
    """
    for read in (_as_toml, _as_python):
        value = read(text)
        if value is not NEITHER:
            return value
    return text


def split_values(text: str) -> list[str]:
    """Return the parts of `text` between its commas; a comma in quotes or in brackets is part of a value."""
    parts, start, depth, quote = [], 0, 0, ""
    for i, sign in enumerate(text):
        if quote:
            if sign == quote and not (quote == '"' and text[:i].endswith("\\")):
                quote = ""
        elif sign in QUOTES and (depth or not text[start:i].strip()):  # one within a word is an apostrophe
            quote = sign
        elif sign in OPENING:
            depth += 1
        elif sign in CLOSING:
            depth -= 1
        elif sign == "," and depth <= 0:
            parts.append(text[start:i])
            start = i + 1
    parts.append(text[start:])
    if quote or depth > 0:  # not closed: commas alone count
        parts = text.split(",")
    return [part.strip() for part in parts]


def as_key(value: Any) -> Any:
    """Return a key that is the same for values that mean the same: 1 and 1.0, a list and a tuple; not 1 and True."""
    if isinstance(value, dict):
        return ("table", tuple(sorted((str(key), as_key(each)) for key, each in value.items())))
    if isinstance(value, (list, tuple)):
        return ("list", tuple(map(as_key, value)))
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return ("number", repr(float(value)) if abs(value) < 2**53 else repr(value))
    return (type(value).__name__, repr(value))


NEITHER = object()


def _as_toml(text: str) -> Any:
    with contextlib.suppress(tomllib.TOMLDecodeError, RecursionError):
        read = tomllib.loads(f"value = {text}")
        if set(read) == {"value"} and _is_plain(read["value"]):
            return read["value"]
    return NEITHER


def _as_python(text: str) -> Any:
    with (
        contextlib.suppress(ValueError, SyntaxError, TypeError, RecursionError, MemoryError),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")
        value = ast.literal_eval(text.strip())
        is_bare = isinstance(value, tuple) and not text.strip().startswith("(")  # "1,2" is a word
        if not is_bare and _is_plain(value):
            return value
    return NEITHER


def _is_plain(value: Any) -> bool:
    """Return whether `value` is of a kind that a setting can have."""
    if isinstance(value, dict):
        return all(isinstance(key, str) and _is_plain(each) for key, each in value.items())
    if isinstance(value, (list, tuple)):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, (bool, int, float, str))
