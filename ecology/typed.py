"""The types of a scenario's words: what their annotations say is held of every field, in one place."""

from __future__ import annotations

import functools
import operator
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from numbers import Real
from types import NoneType, UnionType
from typing import Any, Literal, Union

import numpy as np

from ecology.errors import EcologyError

LONGEST = 100  # characters of a value in a message
PLAIN = {
    float: "a number",
    int: "a whole number",
    str: "a string",
    bool: "True or False",
    object: "anything",
    NoneType: "None",
}


def check_types(word: Any) -> None:
    """Raise EcologyError where a field of the dataclass `word` is not of its annotated type.

    A list does for a tuple, and a NumPy scalar for a number, which the field then holds as Python's own. How long a
    pair is, and how large a number, the word checks itself.
    """
    cls: Any = type(word)
    owner = f"{cls.__name__.lower()} {word.name!r}" if hasattr(word, "name") else cls.__name__
    hints = _hints(cls)
    for field in fields(word):
        kind, given = hints[field.name], getattr(word, field.name)
        value = plain(given)
        if value is not given:
            object.__setattr__(word, field.name, value)  # the words are frozen
        for where, wanted, found in _wrong(field.name, kind, value):
            write = _to_write(field.name, kind, value)
            raise EcologyError(f"{owner}: {where} must be {_describe_type(wanted)}{write}, got {_show(found)}.")


def plain(value: Any) -> Any:
    """Return `value` with the NumPy scalars in it, at any depth of tuples, lists and mappings, as Python's numbers."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        return value.item()
    if type(value) in (tuple, list):
        if set(map(type, value)) <= {float, int, str}:
            return value  # soon told: the matrix of a thousand slots has a million of them
        parts = [plain(part) for part in value]
        return value if all(map(operator.is_, parts, value)) else type(value)(parts)
    if isinstance(value, Mapping):
        named = {key: plain(part) for key, part in value.items()}
        return value if all(named[key] is part for key, part in value.items()) else named
    return value


@functools.cache
def _hints(cls: type) -> dict[str, Any]:
    return typing.get_type_hints(cls)


def _wrong(where: str, kind: Any, value: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield place, type and value of every part of `value` that is not of the type `kind`."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, UnionType):
        others = [part for part in parts if part is not NoneType]
        if value is None and len(others) < len(parts):
            return
        if len(others) == 1:
            found = list(_wrong(where, others[0], value))
            yield from [(at, kind if at == where else wanted, found_value) for at, wanted, found_value in found]
        elif all(any(_wrong(where, part, value)) for part in others):
            yield where, kind, value
    elif origin is tuple and isinstance(value, (tuple, list)):
        if parts[0] is float and set(map(type, value)) <= {float, int}:
            return  # soon told: the matrix of a thousand slots has a million of them
        for i, part in enumerate(value):
            yield from _wrong(f"{where}[{i}]", parts[0], part)
    elif origin is Mapping and isinstance(value, Mapping):
        for key, part in value.items():
            if isinstance(key, parts[0]):
                yield from _wrong(f"{where}[{key!r}]", parts[1], part)
            else:
                yield f"a key of {where}", parts[0], key
    elif not _is_one(value, kind, origin, parts):
        yield where, kind, value


def _is_one(value: Any, kind: Any, origin: Any, parts: tuple[Any, ...]) -> bool:
    """Return whether `value` is of a type that has no parts of its own."""
    if origin is Literal:
        return isinstance(value, str) and value in parts
    if origin is Callable:
        return callable(value)
    if origin in (tuple, Mapping):
        return False
    if kind in (int, float):  # to Python a bool is a number, to whoever wrote count=True it is a slip
        return isinstance(value, Real if kind is float else int) and not isinstance(value, bool)
    return isinstance(value, kind)


def _describe_type(kind: Any) -> str:
    """Return what is of the type `kind`, in words."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, UnionType):
        return " or ".join(map(_describe_type, parts))
    if origin is tuple:
        return f"a tuple of {_many(parts[0])}" if parts[-1] is Ellipsis else f"a pair of {_many(parts[0])}"
    if origin is Mapping:
        return "a dict by name" if parts[1] is object else f"a dict of {_many(parts[1])} by name"
    if origin is Literal:
        return " or ".join(map(repr, parts))
    if origin is Callable:
        return "a function"
    if kind not in PLAIN and not is_dataclass(kind) and (kinds := kind.__subclasses__()):
        return " or ".join(map(_describe_type, kinds))  # a base class, such as `SenseSpec`
    return PLAIN.get(kind) or f"{'an' if kind.__name__[0] in 'AEIO' else 'a'} {kind.__name__}"


def _many(kind: Any) -> str:
    """Return what several of the type `kind` are, in words."""
    said = _describe_type(kind).removeprefix("an ").removeprefix("a ")
    if typing.get_origin(kind) is tuple:
        return said.replace("pair of", "pairs of").replace("tuple of", "tuples of")
    return said if kind not in PLAIN and not typing.get_args(kind) else f"{said}s"


def _to_write(name: str, kind: Any, value: Any) -> str:
    """Return what to write where a single one stands for a tuple: a comma was forgotten."""
    parts = typing.get_args(kind)
    if typing.get_origin(kind) is not tuple or parts[-1] is not Ellipsis or any(_wrong(name, parts[0], value)):
        return ""
    one = _show(value) if parts[0] in PLAIN else f"{type(value).__name__}(...)"
    return f": write {name}=({one},)"


def _show(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
