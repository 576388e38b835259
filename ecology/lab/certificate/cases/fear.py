"""Whether prey learn to flee in `predator_prey`, and fear."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.certificate.predation import SEEDS, fear, flight, train_both

ORDER = 13
TICKS, WOUNDS = 20_000, (0.0, 0.25, 0.5, 1.0)


def _measure_fear(wound: float, seed: int) -> dict[str, Any]:
    """Return flight and fear of prey that learned for TICKS ticks under `wound`."""
    env, minds, tick = train_both(seed, TICKS, wound=wound)
    before, fled = env.snapshot(), flight(env, minds["prey"], tick, seed=seed)
    return {"flight": fled, "fear": fear(env, minds["prey"], env.restore(*before))}


def _parts() -> list[Part]:
    words = answers.parameters("predator_prey", ticks=TICKS)
    return [
        Part(f"{wound:g}-seed-{s}", words, 300.0, functools.partial(_measure_fear, wound, s))
        for wound in WOUNDS
        for s in range(SEEDS)
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    rows = []
    for wound in WOUNDS:
        lives = [life for key, life in done.items() if key.startswith(f"{wound:g}-")]
        for what, values in (
            ("distance after a sighting, learned - random", [d["flight"]["difference"] for d in lives if d["flight"]]),
            ("slope of J toward a predator", [d["fear"] for d in lives if d["fear"] is not None]),
        ):
            if values:
                row = Row(f"{what}, wound {wound:g}", values)
                low, high = row.interval() or (-math.inf, math.inf)
                verdict = "above 0" if low > 0 else "below 0" if high < 0 else "not distinguishable from 0"
                rows.append(replace(row, verdict=verdict))
    return rows


def case() -> Case:
    """Return the case."""
    return Case(
        "fear",
        "learned flight, and J toward a predator by wound",
        _parts,
        _rows,
    )
