"""A number of a scenario, named by a path: `prey.birth.rate`, `prey.energy.decay`, `prey.graze.control.energy`."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from ecology.errors import EcologyError, nearest
from ecology.scenario import Scenario


def with_change(scenario: Scenario, path: str, value: float) -> Scenario:
    """Return `scenario` with the number at `path` replaced by `value`; EcologyError where there is no such number.

    A path begins with the name of a species, a resource or a field and goes on with fields, names of needs and actions,
    and keys of mappings. The new scenario is checked as any other; its schedule stays as it is.
    """
    first, *rest = path.split(".")
    parts: dict[str, tuple[str, int]] = {s.name: ("species", i) for i, s in enumerate(scenario.species)}
    parts |= {r.name: ("resources", i) for i, r in enumerate(scenario.resources)}
    parts |= {f.name: ("fields", i) for i, f in enumerate(scenario.fields) if f.name not in parts}
    if first not in parts or not rest:
        raise EcologyError(
            f"a path begins with a species, a resource or a field, such as {next(iter(parts))}.radius, got {path!r}. "
            f"{nearest(first, parts)}"
        )
    kind, at = parts[first]
    several: list[Any] = list(getattr(scenario, kind))
    several[at] = _replace_in(several[at], rest, value, path)
    new: dict[str, Any] = {"schedule": (), "sessions": (), kind: tuple(several)}
    found = dataclasses.replace(scenario, **new)
    for name in ("schedule", "sessions"):  # the events do not check themselves again
        object.__setattr__(found, name, getattr(scenario, name))
    return found


def _replace_in(owner: Any, path: list[str], value: float, whole: str) -> Any:
    """Return `owner` with what lies at `path` below it replaced."""
    if not path:
        if isinstance(owner, bool) or not isinstance(owner, (int, float)):
            raise EcologyError(f"{whole!r} is no number but {owner!r}; only numbers can be changed.")
        return int(value) if isinstance(owner, int) and value == int(value) else value
    name, *rest = path
    if isinstance(owner, Mapping):
        if name not in owner:
            raise EcologyError(f"{whole!r}: there is no {name!r}. {nearest(name, owner)}")
        return {**owner, name: _replace_in(owner[name], rest, value, whole)}
    if not dataclasses.is_dataclass(owner) or isinstance(owner, type):
        raise EcologyError(f"{whole!r}: {name!r} is a part of nothing, {owner!r} stands before it.")
    fields = [field.name for field in dataclasses.fields(owner)]
    if name in fields:
        new = _replace_in(getattr(owner, name), rest, value, whole)
        return dataclasses.replace(owner, **{name: new})
    for field in ("needs", "actions"):
        named = {part.name: i for i, part in enumerate(getattr(owner, field, ()))}
        if name in named:
            several = list(getattr(owner, field))
            several[named[name]] = _replace_in(several[named[name]], rest, value, whole)
            return dataclasses.replace(owner, **{field: tuple(several)})
    known = fields + [part.name for field in ("needs", "actions") for part in getattr(owner, field, ())]
    raise EcologyError(f"{whole!r}: there is no {name!r}. {nearest(name, known)}")
