"""Whether newborn predators learn in time in `predator_prey`."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.certificate.predation import ARRIVAL, SEEDS, newborns

ORDER = 14


def _parts() -> list[Part]:
    parameters = answers.parameters("predator_prey", ticks=10_000, arrival=ARRIVAL)
    return [
        Part(f"{name}-seed-{s}", parameters, 150.0, functools.partial(newborns, s, name))
        for name in ("lean", "random")
        for s in range(SEEDS)
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    lives = {name: [life for key, life in done.items() if key.startswith(name)] for name in ("lean", "random")}
    rows = [
        Row(f"ticks lived by predators, {name}", found, verdict="no number to compare with")
        for name, found in lives.items()
        if found
    ]
    if all(lives.values()):
        ratio = (np.array(lives["lean"][: len(lives["random"])]) / lives["random"][: len(lives["lean"])]).tolist()
        interval = Row("", ratio).interval()
        doubled = interval is not None and interval[0] > 2.0
        rows.append(Row("ticks lived, learned / random", ratio, verdict="doubled" if doubled else "not doubled"))
    return rows


def case() -> Case:
    """Return the case."""
    return Case(
        "newborns",
        "life span of predators that inherit nothing",
        _parts,
        _rows,
    )
