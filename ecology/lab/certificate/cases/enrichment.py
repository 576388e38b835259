"""B4: the paradox of enrichment, in a well-mixed world."""
# ruff: noqa: ARG005  (all policies and looks are of one form)

from __future__ import annotations

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ecology import Ecology, Tick, agents, scenarios
from ecology.agents import loop
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.observers.base import Observer
from ecology.scenarios.enrichment import BORN, DIES, FINDS, HANDLES, K_CRITICAL, N_REST, p_rest
from ecology.state import Ints

ORDER = 37
GROWTH, SCALE, DT = 0.05, 4.0, 0.5
CAPACITIES = (100.0, 150.0, 220.0, 300.0)
TICKS = 5_000
AMONG, LIVED = (150.0, 220.0, 300.0, 360.0), 4_000  # capacities and ticks of learners
VARIES = 0.6  # variability of prey from which numbers count as cycling
OWN: Mapping[str, Any] = {  # settings of learners that live for some 130 ticks: an heir knows what its parent knew
    "inherit": True, "pause": DT, "update_every": 2.0, "width": 16, "batch": 16, "batch_f": 32, "memory": 200,
    "warm_up": 4, "youth": 100.0,
}  # fmt: skip


def measure_scripted(capacity: float, seed: int, ticks: int = TICKS) -> dict[str, Any]:
    """Return the variability of numbers in the last two thirds, and prey at rest, of predators that bite at once."""
    env, tick = answers.begin("enrichment", seed, capacity=capacity, growth=GROWTH, scale=SCALE, dt=DT)
    rows = [env.groups[name].slots for name in ("prey", "predator")]

    def policy(env: Ecology, tick: Tick) -> Ints:
        return answers.act(env, predator=np.where(tick.masks["predator"][:, 1], 1, 0))

    seen = answers.play(env, tick, ticks, policy, lambda e, t: [int(np.count_nonzero(t.alive[r])) for r in rows])
    return _describe(np.array(seen, float))


class Bites(Observer):
    """An observer that counts prey, predators, predators that could bite in a tick, and those of them that did."""

    def __init__(self, env: Ecology) -> None:
        self.prey, self.predators = (env.groups[name].slots for name in ("prey", "predator"))
        self.could = np.zeros(env.groups["predator"].size, bool)
        self.rows: list[list[int]] = []

    def watch(self, state: Any, tick: Tick, minds: Mapping[str, Any]) -> None:
        """Count one tick."""
        alive, did = tick.alive, state.bit[self.predators] >= 0
        seen = alive[self.prey], alive[self.predators], self.could, self.could & did
        self.rows.append([int(np.count_nonzero(each)) for each in seen])
        self.could = alive[self.predators] & tick.masks["predator"].all(axis=1)  # while it handles, it cannot rest


def measure_learner(capacity: float, seed: int, ticks: int = LIVED) -> dict[str, Any]:
    """Return the same of predators that learn to hunt, and which share of their opportunities they take."""
    env = Ecology(scenarios.load("enrichment", capacity=capacity, growth=GROWTH, scale=SCALE, dt=DT, hungry=True))
    minds = {
        name: agents.make(learner, env.groups[name], np.random.SeedSequence([seed, i]), own)
        for i, (name, learner, own) in enumerate((("prey", "rest", {}), ("predator", "lean", OWN)))
    }
    bites = Bites(env)
    loop.run(env, minds, env.reset_arrays(seed), ticks, (bites,))
    rows = np.array(bites.rows, float)
    could, did = rows[ticks // 3 :, 2:].sum(axis=0)
    return {**_describe(rows[:, :2]), "taken": float(did / max(could, 1))}


def _describe(counts: np.ndarray) -> dict[str, Any]:
    """Return the variability of prey in the last two thirds of `counts` (ticks, 2), or until a species is extinct."""
    ticks, gone = len(counts), np.flatnonzero((counts == 0).any(axis=1))
    last = int(gone[0]) if gone.size else ticks
    prey = counts[min(ticks, last) // 3 : last, 0]
    return {
        "cv": float(prey.std() / prey.mean()),
        "prey": float(prey.mean() / SCALE),
        "period": _period(prey),
        "extinct": bool(gone.size),
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
    learning = answers.parameters("enrichment", growth=GROWTH, scale=SCALE, dt=DT, ticks=LIVED, **OWN)
    return [
        Part(f"scripted-{k:g}-{seed}", parameters, 8.0, functools.partial(measure_scripted, k, seed))
        for k in CAPACITIES
        for seed in range(answers.SEEDS)
    ] + [
        Part(f"learned-{k:g}-{seed}", learning, 15.0, functools.partial(measure_learner, k, seed))
        for seed in range(answers.SEEDS)
        for k in AMONG
    ]


def crossing(levels: Mapping[float, float]) -> float:
    """Return the capacity at which the variability passes `VARIES`, linear between those tried; their edge without."""
    ks, cv = np.array(list(levels)), np.array(list(levels.values()))
    above = np.flatnonzero(cv >= VARIES)
    if not above.size or above[0] == 0:
        return float(ks[-1 if not above.size else 0])
    k = int(above[0])
    return float(ks[k - 1] + (VARIES - cv[k - 1]) / (cv[k] - cv[k - 1]) * (ks[k] - ks[k - 1]))


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
    return found + _rows_of_learners(done, level)


def _share(lives: Sequence[Mapping[str, Any]]) -> float:
    """Return the share of the possible bites that learned predators take; where they died out there is none."""
    return float(np.mean([life["taken"] for life in lives if not life["extinct"]]))


def _rows_of_learners(done: Mapping[str, Any], level: Mapping[float, float]) -> list[Row]:
    """Return what learners do: a share p of the bites is a rate of search of p a, so K_c and prey at rest are 1 / p."""
    found: list[Row] = []
    if all(life["extinct"] for life in answers.column(done, "learned-")):
        return found
    p = _share(answers.column(done, "learned-"))
    given = "no number to compare with"
    found.append(Row("f/J: share p of the possible bites that predators take", [p], verdict=given))
    for k in AMONG:
        lives = answers.column(done, f"learned-{k:g}-")
        if lives:
            gone = sum(life["extinct"] for life in lives)
            what = f"f/J: coefficient of variation of prey, K {k:g} (K_c / p {K_CRITICAL / p:.0f}; {gone} extinct)"
            found.append(Row(what, [life["cv"] for life in lives], verdict=given))
        if lives and k < K_CRITICAL and not all(life["extinct"] for life in lives):
            prey, here = [life["prey"] for life in lives], _share(lives)
            what = f"f/J: prey at rest, K {k:g}: N* / p, p {here:.2f} there"
            found.append(Row(what, prey, closed=N_REST / here, tolerance=0.12 * N_REST))
    seeds = answers.complete_parts(done, "learned", AMONG)
    if seeds and len(level) == len(CAPACITIES):
        scripted = crossing(level)
        ours = [crossing({k: life["cv"] for k, life in lives.items()}) / scripted for lives in seeds]
        what = f"f/J: K from which prey vary by {VARIES:g}, over that of scripted predators ({scripted:.0f}): 1 / p"
        found.append(Row(what, ours, closed=1 / p))
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    left, right = figure.subplots(1, 2)
    have = [k for k in CAPACITIES if answers.column(done, f"scripted-{k:g}-")]
    grid = np.linspace(80, 370, 15)
    left.plot(grid, [solve(k)[0] for k in grid], color=answers.CLOSED, label="equations")
    left.axvline(K_CRITICAL, color="0.6", ls=":", label=f"K_c {K_CRITICAL:.0f}")
    for k in have:
        values = [life["cv"] for life in answers.column(done, f"scripted-{k:g}-")]
        left.plot([k] * len(values), values, "o", color=answers.OURS, markersize=4)
    for k in AMONG:
        values = [life["cv"] for life in answers.column(done, f"learned-{k:g}-")]
        left.plot([k] * len(values), values, answers.PUBLISHED.marker, color=answers.THEIRS, markersize=4)
    if not all(life["extinct"] for life in answers.column(done, "learned-")):
        p = _share(answers.column(done, "learned-"))
        left.axvline(K_CRITICAL / p, color=answers.THEIRS, ls=":", label=f"K_c / p of learners {K_CRITICAL / p:.0f}")
    answers.finish(left, "K", "CV of prey (round: scripted, else f/J; one per seed)")
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
