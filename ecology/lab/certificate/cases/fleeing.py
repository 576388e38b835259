"""Whether fleeing pays in `predator_prey`."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.certificate.predation import SEEDS, pays

ORDER = 12


def _parts() -> list[Part]:
    parameters = answers.parameters("predator_prey", ticks=10_000)
    return [Part(f"seed-{s}", parameters, 12.0, functools.partial(pays, s)) for s in range(SEEDS)]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    given = "no number to compare with"
    lives = list(done.values())
    rows = [Row(f"scripted prey: {name}", [life[name] for life in lives], verdict=given) for name in (lives or [{}])[0]]
    if lives:
        ratio = [life["wounds fleeing"] / max(life["wounds"], 1e-9) for life in lives]
        interval = Row("", ratio).interval()
        halved = interval is not None and interval[1] < 0.5
        rows.append(Row("deaths by wound, fleeing / not", ratio, verdict="halved" if halved else "not halved"))
    return rows


def case() -> Case:
    """Return the case."""
    return Case(
        "fleeing",
        "whether fleeing pays in predator_prey, scripted prey and predators",
        _parts,
        _rows,
    )
