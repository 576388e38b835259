"""The world of a run as data, for viewing it without running its code: `world.json` in the run's folder.

It holds the scenario but for its functions: the rule is left out, and of the measures only the names are kept.
"""

from __future__ import annotations

import dataclasses
import json
import math
import typing
from collections.abc import Mapping
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union

from ecology import EcologyError, Scenario, State
from ecology.errors import readable
from ecology.lab.runs.folder import replace_text

WORLD = "world.json"  # in a run's folder
LEFT_OUT = ("rule", "measures", "props", "settings", "learner_settings")  # functions, and what nothing shown depends on
MOST = 10**7  # agents and patches: no recording has as many rows
TYPE = "type"  # key of the name of a dataclass


def write_world(folder: Path, scenario: Scenario) -> None:
    """Write the scenario of a run to its folder, as data."""
    content = {"world": _encode(scenario), "measures": list(scenario.measures)}
    replace_text(folder / WORLD, json.dumps(content, allow_nan=False) + "\n")


def read_world(folder: Path) -> Scenario | None:
    """Return the scenario of the run in `folder` without running any code of it; None where none was written.

    It has no rule, and its measures are not known: each is NaN. Raises EcologyError where the file is damaged.
    """
    path = folder / WORLD
    try:
        with readable("the world of the run", path):
            content = json.loads(path.read_text(encoding="utf-8"))
        world = _decode(Scenario, content["world"])
        if (rows := sum(s.slots for s in world.species) + sum(r.count for r in world.resources)) > MOST:
            raise ValueError(f"a world of {rows} agents and patches")
        return dataclasses.replace(world, measures={str(name): _unknown for name in content["measures"]})
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError, AttributeError, IndexError, RecursionError) as error:
        raise EcologyError(
            f"the world of the run, {str(path)!r}, is damaged ({str(error) or type(error).__name__}); resume the run "
            "to write it again, or view the recording without --focus and --serve."
        ) from error


def _unknown(_: State) -> float:
    """Be a measure of which only the name is known."""
    return math.nan


def _encode(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value) if field.name not in LEFT_OUT]
        return {TYPE: type(value).__name__, **{name: _encode(getattr(value, name)) for name in names}}
    if isinstance(value, Mapping):
        return {str(key): _encode(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_encode(each) for each in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value  # JSON has no infinity


def _decode(kind: Any, value: Any) -> Any:
    """Return what `_encode` made `value` of, which is of the annotated type `kind`; only known classes are built."""
    origin, parts = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, UnionType):
        if value is None:
            return None
        allowed = {part: _classes(part) for part in parts}
        classes = {each.__name__: each for found in allowed.values() for each in found}
        if isinstance(value, dict) and classes:
            return _decode(classes[value[TYPE]], value)
        others = [part for part, found in allowed.items() if part is not NoneType and not found]
        return _decode(others[0], value) if len(others) == 1 else _plain(value)
    if dataclasses.is_dataclass(kind):
        cls: Any = kind
        hints = typing.get_type_hints(cls)
        given = {name: part for name, part in value.items() if name != TYPE and name not in LEFT_OUT}
        return cls(**{name: _decode(hints[name], part) for name, part in given.items()})
    if origin is tuple:
        kinds = [parts[0]] * len(value) if parts[-1] is Ellipsis else parts
        return tuple(_decode(each, part) for each, part in zip(kinds, value, strict=True))
    if isinstance(value, dict):
        return {name: _decode(parts[1], part) for name, part in value.items()}
    return float(value) if kind is float and isinstance(value, str) else _plain(value)


def _classes(kind: Any) -> list[Any]:
    """Return the dataclasses that an annotation allows: itself, or those of a base class such as `SenseSpec`."""
    if dataclasses.is_dataclass(kind):
        return [kind]
    kinds: list[Any] = type.__subclasses__(kind) if isinstance(kind, type) else []
    return [each for each in kinds if dataclasses.is_dataclass(each)]


def _plain(value: Any) -> Any:
    return tuple(map(_plain, value)) if isinstance(value, list) else value
