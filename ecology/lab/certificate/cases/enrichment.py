"""B4: the paradox of enrichment, in a well-mixed world."""
# ruff: noqa: ARG005  (all policies and looks are of one form)

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.enrichment import BORN, DIES, FINDS, HANDLES, K_CRITICAL, N_REST, p_rest
from ecology.state import Ints

ORDER = 37
GROWTH, SCALE, DT = 0.05, 4.0, 0.5
CAPACITIES = (100.0, 150.0, 220.0, 300.0)
SEEDS, TICKS = 2, 5_000


def measure_scripted(capacity: float, seed: int, ticks: int = TICKS) -> dict[str, Any]:
    """Return the variability of numbers in the last two thirds, and prey at rest, of predators that bite at once."""
    env, tick = answers.begin("enrichment", seed, capacity=capacity, growth=GROWTH, scale=SCALE, dt=DT)
    rows = [env.groups[name].slots for name in ("prey", "predator")]

    def policy(env: Ecology, tick: Tick) -> Ints:
        return answers.act(env, predator=np.where(tick.masks["predator"][:, 1], 1, 0))

    seen = answers.play(env, tick, ticks, policy, lambda e, t: [int(np.count_nonzero(t.alive[r])) for r in rows])
    counts = np.array(seen, float)
    late = counts[ticks // 3 :]
    out = bool((counts[-1] == 0).any())
    prey = late[:, 0]
    return {
        "cv": float(prey.std() / prey.mean()) if prey.mean() > 0 else math.nan,
        "prey": float(prey.mean() / SCALE),
        "period": _period(prey),
        "extinct": out,
        "path": (counts[:: max(ticks // 400, 1)] / SCALE).round(2).tolist(),
    }


def _period(x: np.ndarray) -> float:
    """Return the period of the strongest cycle of a series, units of time; infinite where it does not vary."""
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), 8 * len(x))) ** 2
    k = int(power[8:].argmax()) + 8  # at least one cycle in the series
    return 8 * len(x) / k * DT if power.max() > 0 else math.inf


def solve(capacity: float, growth: float = GROWTH, time: float = 4_000.0, step: float = 0.1) -> tuple[float, float]:
    """Return the variability of prey and the period, of the differential equations after the same start."""
    n, p, path = 1.1 * N_REST, p_rest(max(capacity, 1.2 * N_REST), growth), []
    for _ in range(round(time / step)):
        eaten = FINDS * n * p / (1 + FINDS * HANDLES * n)
        n, p = n + step * (growth * n * (1 - n / capacity) - eaten), p + step * (BORN * eaten - DIES * p)
        path.append(n)
    late = np.array(path[len(path) // 2 :])
    cv = float(late.std() / late.mean())
    turns = np.flatnonzero((late[1:] > late.mean()) & (late[:-1] <= late.mean()))
    return cv, float(np.diff(turns).mean() * step) if len(turns) > 2 and cv > 0.01 else math.inf


def frequency(capacity: float, growth: float = GROWTH) -> float:
    """Return the period 2 pi / omega of small deviations at rest."""
    n, a, h = N_REST, FINDS, HANDLES
    p = p_rest(capacity, growth)
    slope = a / (1 + a * h * n) ** 2
    f = a * n / (1 + a * h * n)
    return 2 * math.pi / math.sqrt(f * BORN * p * slope)


def _parts() -> list[Part]:
    parameters = answers.parameters("enrichment", growth=GROWTH, scale=SCALE, dt=DT, ticks=TICKS)
    return [
        Part(f"scripted-{k:g}-{seed}", parameters, 8.0, functools.partial(measure_scripted, k, seed))
        for k in CAPACITIES
        for seed in range(SEEDS)
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found, level = [], {}
    for k in CAPACITIES:
        lives = answers.column(done, f"scripted-{k:g}-")
        if not lives:
            continue
        level[k] = float(np.mean([life["cv"] for life in lives]))
        where = "below" if k < K_CRITICAL else "above"
        alone = f"coefficient of variation of prey, K {k:g}, {where} K_c (equations without chance: {solve(k)[0]:.2f})"
        calm = [life["cv"] for life in lives]
        ok = max(calm) < 0.35 if k < K_CRITICAL else min(calm) > 0.5
        found.append(Row(alone, calm, verdict="agrees" if ok else "differs from the closed form"))
        if k < K_CRITICAL:
            found.append(
                Row(f"prey at rest, K {k:g}", [life["prey"] for life in lives], closed=N_REST, tolerance=0.12 * N_REST)
            )
        elif k < 1.4 * K_CRITICAL:
            what = f"period, K {k:g} (2 pi / omega at rest: {frequency(k):.0f})"
            period = solve(k)[1]
            found.append(Row(what, [life["period"] for life in lives], closed=period, tolerance=0.2 * period))
    if len(level) == len(CAPACITIES):
        ks = list(level)
        jump = max(range(len(ks) - 1), key=lambda i: level[ks[i + 1]] - level[ks[i]])
        what = f"K between which the variability jumps, middle of {ks[jump]:g} and {ks[jump + 1]:g}"
        found.append(
            Row(what, [(ks[jump] + ks[jump + 1]) / 2], closed=K_CRITICAL, tolerance=(ks[jump + 1] - ks[jump]) / 2)
        )
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    left, right = figure.subplots(1, 2)
    have = [k for k in CAPACITIES if answers.column(done, f"scripted-{k:g}-")]
    grid = np.linspace(80, 310, 12)
    left.plot(grid, [solve(k)[0] for k in grid], color=answers.CLOSED, label="equations")
    left.axvline(K_CRITICAL, color="0.6", ls=":", label=f"K_c {K_CRITICAL:.0f}")
    for k in have:
        values = [life["cv"] for life in answers.column(done, f"scripted-{k:g}-")]
        left.plot([k] * len(values), values, "o", color=answers.OURS, markersize=4)
    answers.finish(left, "K", "CV of prey (dots: the world, one per seed)")
    for k, look in zip((have[0], have[-1]), (answers.LEARNED, answers.PUBLISHED), strict=True) if have else ():
        path = np.array(answers.column(done, f"scripted-{k:g}-")[0]["path"])
        right.plot(path[:, 0], path[:, 1], color=look.colour, linestyle=look.line, lw=0.8, label=f"K {k:g}")
    answers.finish(right, "prey", "predators")


def case() -> Case:
    """Return the case."""
    return Case(
        "enrichment",
        "the paradox of enrichment (Rosenzweig and MacArthur 1963; Rosenzweig 1971)",
        _parts,
        _rows,
        figure=_figure,
    )
