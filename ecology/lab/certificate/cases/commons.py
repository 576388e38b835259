"""The most that a common pool sustains."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ecology import Ecology, scenarios
from ecology.lab.certificate.case import Case, Part, Row

ORDER = 4
POOL, GROWTH, APPETITE = 100.0, 0.02, 0.1  # E0, delta per tick, q per tick: sustainable up to n = 20


def _pool_left(n: int, ticks: int = 500) -> float:
    """Return the share of the pool of `commons` that is left by n agents that stand in it and eat q in every tick."""
    settings = {"n": n, "growth": GROWTH, "capacity": POOL, "appetite": APPETITE, "decay": APPETITE}
    env = Ecology(scenarios.load("commons", **settings))
    env.reset_arrays(0)
    pool, rng = env.scenario.resources[0], np.random.default_rng(n)
    angle, far = rng.uniform(0, 2 * math.pi, n), 0.8 * pool.radius * np.sqrt(rng.random(n))
    env.set_state(position=np.array(pool.position) + np.column_stack([np.cos(angle), np.sin(angle)]) * far[:, None])
    eat = env.groups["agent"].actions.index("consume_pool")
    for _ in range(ticks):
        env.step_arrays(np.full(n, eat))
    return float(env.state_view.stock[0] / POOL)


def _measure_pool(n: int) -> Callable[[], list[float]]:
    return lambda: [_pool_left(n)]


def _parts() -> list[Part]:
    most = round(GROWTH * POOL / APPETITE)
    return [
        Part(f"n-{n}", {"growth": GROWTH, "pool": POOL, "appetite": APPETITE}, 1.0, _measure_pool(n))
        for n in (most // 2, most - 1, most, most + 1, most + most // 2)
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    if not done:
        return []
    kept = [int(key[2:]) for key, value in done.items() if value[0] > 0.5]
    lost = [int(key[2:]) for key, value in done.items() if value[0] == 0.0]
    if len(kept) + len(lost) < len(done) or not kept:
        return [Row("pools neither kept nor lost", [float(len(done) - len(kept) - len(lost))], verdict="differs")]
    threshold = GROWTH * POOL / APPETITE
    what = "most eaters with a fixed appetite that a full pool sustains, 500 ticks"
    return [Row(what, [float(max(kept))], closed=threshold, tolerance=0.0)] + [
        Row("fewest that empty it", [float(min(lost))], closed=threshold + 1, tolerance=0.0) for _ in lost[:1]
    ]


def case() -> Case:
    """Return the case."""
    return Case(
        "commons",
        "the most that a common pool sustains, n q <= delta E0",
        _parts,
        _rows,
    )
