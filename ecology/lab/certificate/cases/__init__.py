"""The cases, a file each: `case` returns one, ORDER is its place in the certificate."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Sequence

from ecology.errors import EcologyError, nearest
from ecology.lab.certificate.case import Case


def all_cases() -> dict[str, Case]:
    """Return all cases by name, in their order."""
    found = [importlib.import_module(f"{__name__}.{each.name}") for each in pkgutil.iter_modules(__path__)]
    cases = [module.case() for module in sorted(found, key=lambda module: module.ORDER)]
    return {case.name: case for case in cases}


def choose_cases(names: Sequence[str]) -> list[Case]:
    """Return the cases named, all without names; EcologyError for an unknown one."""
    known = all_cases()
    for name in names:
        if name not in known:
            raise EcologyError(f"there is no case {name!r} to reproduce. {nearest(name, known)}")
    return [known[name] for name in dict.fromkeys(names)] if names else list(known.values())
