"""Predators and prey without learning, well mixed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ecology import Ecology, scenarios
from ecology.lab.certificate.case import Case, Part, Row

ORDER = 7
PREY, BEARS, DIES = 500, 0.03, 0.015  # at rest; alpha and gamma per unit of time
CYCLES = 3  # of small ones, lived per seed


def _cycles(seed: int) -> list[float]:
    """Return the mean prey, the mean predators and the turns per period of a life of `well_mixed`.

    d ln P / dt = beta N - gamma, so the mean of N is gamma / beta up to ln(P_T / P_0) / (beta T), which is zero over
    whole cycles and taken off here; likewise that of P.
    """
    env = Ecology(scenarios.load("well_mixed", prey=PREY, growth=BEARS, mortality=DIES))
    rows = [env.groups[name].slots for name in ("prey", "predator")]
    tick, beta = env.reset_arrays(seed), DIES / PREY
    ticks = round(CYCLES * _period())
    counts = np.zeros((ticks, 2))
    for k in range(ticks):
        actions = np.zeros(env.size, np.int64)
        actions[rows[1]] = tick.masks["predator"].argmax(axis=1)  # the rest, where no bite is open
        tick = env.step_arrays(actions)
        counts[k] = [np.count_nonzero(tick.alive[r]) for r in rows]
    change = np.log(counts[-1] / counts[0]) / (beta * ticks)
    mean = counts.mean(axis=0) + np.array([-change[1], change[0]])
    n, p = np.log(counts / mean).T
    angle = np.unwrap(np.arctan2(math.sqrt(BEARS) * p, math.sqrt(DIES) * n))
    return [float(mean[0]), float(mean[1]), float((angle[-1] - angle[0]) / (2 * math.pi) / ticks * _period())]


def _period() -> float:
    return 2 * math.pi / math.sqrt(BEARS * DIES)


def _parts() -> list[Part]:
    words = {"prey": PREY, "growth": BEARS, "mortality": DIES, "cycles": CYCLES}

    def live(seed: int) -> Callable[[], list[float]]:
        return lambda: _cycles(seed)

    return [Part(f"seed-{seed}", words, 12.0, live(seed)) for seed in range(4)] if _has_well_mixed() else []


def _has_well_mixed() -> bool:
    return "well_mixed" in scenarios.names()


def _rows(done: Mapping[str, Any]) -> list[Row]:
    if not done:
        return []
    prey, predators, turns = zip(*done.values(), strict=True)
    slack = BEARS + DIES  # share by which ticks of 1 move the numbers at rest
    hunters = PREY * BEARS / DIES
    return [
        Row("mean prey, gamma / beta", prey, closed=PREY, tolerance=slack * PREY),
        Row("mean predators, alpha / beta", predators, closed=hunters, tolerance=slack * hunters),
        Row("turns per 2 pi / sqrt(alpha gamma)", turns, closed=1.0),
    ]


def case() -> Case:
    """Return the case."""
    return Case(
        "lotka_volterra",
        "mean numbers and period of well-mixed predators and prey",
        _parts,
        _rows,
        [] if _has_well_mixed() else ["The scenario well_mixed is not here: left out."],
    )
