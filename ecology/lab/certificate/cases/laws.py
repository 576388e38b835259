"""B8: R*, Ornstein and Uhlenbeck, fixation, Euler and Lotka; equality and sustainability at a common pool."""
# ruff: noqa: ARG001  (all policies and looks are of one form)

from __future__ import annotations

import functools
import math
import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import optimize

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.laws import APPETITE, BEARS, COSTS, DIES, LEAK, MATURE, NOISE, POOL
from ecology.state import Ints

ORDER = 40
FEW, REPLICATES = 8, 60  # bodies that drift; worlds of them in a part
AT_POOL, LIVED = 12, 2_500
WIDE = 36  # letters of a line beside the figure


def competition(seed: int, ticks: int = 3_000) -> dict[str, float]:
    """Return the numbers of both species at the end, and the mean share of the pool in the last third."""
    env, tick = answers.begin("laws", seed, law="competition")

    def policy(env: Ecology, tick: Tick) -> Ints:
        return answers.act(env, thrifty="consume_pool", wasteful="consume_pool")

    seen = answers.play(env, tick, ticks, policy, lambda e, _: float(e.state_view.stock[0]) / POOL)
    alive = env.state_view.alive
    found = {name: float(alive[env.groups[name].slots].sum()) for name in COSTS}
    return {**found, "share": float(np.mean(seen[-ticks // 3 :]))}


def noise(seed: int) -> float:
    """Return the variance of the need over bodies and time."""
    env, tick = answers.begin("laws", seed, law="noise", n=100)
    rest = lambda env, _: np.zeros(env.size, np.int64)  # noqa: E731
    seen = answers.play(env, tick, 600, rest, lambda e, _: e.state_view.internal[:, 0].copy())
    return float(np.var(np.array(seen)[150:]))


def fixation(seed: int) -> float:
    """Return the share of worlds in which the marker of the first founder reaches fixation."""
    won = 0
    for k in range(REPLICATES):
        env, _ = answers.begin("laws", 1_000 * seed + k, law="drift", n=FEW)
        begun: Any = env.state_view
        first = float(begun.trait[0, 0])
        for _ in range(5_000):
            env.step_arrays(np.zeros(env.size, np.int64))
            now: Any = env.state_view
            left = np.unique(now.trait[now.alive, 0])
            if len(left) <= 1:
                break
        won += bool(len(left) and left[0] == first)
    return won / REPLICATES


def growth(seed: int) -> float:
    """Return the growth rate of the population once the age structure is stable."""
    env, tick = answers.begin("laws", seed, law="growth", n=20)
    rest = lambda env, _: np.zeros(env.size, np.int64)  # noqa: E731
    counts = np.array(answers.play(env, tick, 150, rest, lambda _, t: int(t.alive.sum())), float)
    time = np.arange(1, len(counts) + 1)
    late = (time > 60) & (counts < 0.9 * env.size)
    return answers.fit_line(time[late], np.log(counts[late]))[0]


def euler_lotka() -> float:
    """Return r of b exp(-(r + m) a) = r + m, for ticks of 1."""
    hazard, bears = DIES, BEARS
    return float(optimize.brentq(lambda r: bears * math.exp(-(r + hazard) * MATURE) - r - hazard, -0.1, 1.0))


def commons(seed: int) -> dict[str, float]:
    """Return equality, sustainability and yield of learners at a pool (Perolat et al. 2017)."""
    env, _, _, rows = answers.learn("commons", seed, LIVED, lambda _, s: s.ingested[:, 0].copy(), n=AT_POOL)
    eaten = np.diff(np.array(rows), axis=0)
    when = [float(np.average(np.arange(len(eaten)), weights=e)) if e.sum() else 0.0 for e in eaten.T]
    return {
        "equality": 1 - gini(np.array(rows)[-1]),
        "sustainability": float(np.mean(when)) / (len(eaten) / 2),
        "yield": float(rows[-1].sum() / LIVED / AT_POOL),
        "left": float(env.state_view.stock[0]) / float(env.scenario.resources[0].stock),
    }


def gini(x: np.ndarray) -> float:
    """Return the Gini coefficient of amounts (n,)."""
    return float(np.abs(x[:, None] - x).sum() / (2 * len(x) * max(x.sum(), 1e-300)))


def _parts() -> list[Part]:
    parameters = answers.parameters("laws")
    found = []
    for name, of, seconds in (("competition", competition, 3.0), ("noise", noise, 1.0), ("growth", growth, 1.0),
                              ("fixation", fixation, 4.0)):  # fmt: skip
        found += [
            Part(f"{name}-{seed}", parameters, seconds, functools.partial(of, seed)) for seed in range(answers.SEEDS)
        ]
    parameters = answers.parameters("commons", n=AT_POOL, ticks=LIVED)
    return found + [Part(f"learned-{s}", parameters, 6.0, functools.partial(commons, s)) for s in range(answers.SEEDS)]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    lives = answers.column(done, "competition-")
    if lives:
        alone = [float(life["thrifty"] > 0 and life["wasteful"] == 0) for life in lives]
        found.append(Row("competition: worlds in which the lower R* alone is left", alone, closed=1.0, tolerance=0.0))
        star = COSTS["thrifty"] / APPETITE
        found.append(Row("competition: share of the pool at the end, R*", [v["share"] for v in lives], closed=star,
                         tolerance=0.15 * star))  # fmt: skip
    if answers.column(done, "noise-"):
        found.append(Row("noise: variance, sigma^2 / (2 leak)", answers.column(done, "noise-"),
                         closed=NOISE**2 / (2 * LEAK), tolerance=0.05 * NOISE**2 / (2 * LEAK)))  # fmt: skip
    if answers.column(done, "fixation-"):
        found.append(
            Row(f"drift: probability of fixation, 1 / n, n {FEW}", answers.column(done, "fixation-"), closed=1 / FEW)
        )
    if answers.column(done, "growth-"):
        found.append(Row("growth: r of Euler and Lotka", answers.column(done, "growth-"), closed=euler_lotka(),
                         tolerance=0.15 * euler_lotka()))  # fmt: skip
    lives = answers.column(done, "learned-")
    for word, closed in (("equality", 1.0), ("sustainability", 1.0), ("left", None)) if lives else ():
        given = None if closed is not None else "no number to compare with"
        names = {"equality": "1 - Gini of what each ate", "sustainability": "mean time of a meal over half of the life",
                 "left": "share of the pool that is left"}  # fmt: skip
        found.append(
            Row(f"commons, {AT_POOL} f/J: {names[word]}", [v[word] for v in lives], closed=closed, verdict=given)
        )
    return found


def _short(row: Row) -> str:
    """Return what a row is about, without the formula."""
    what = row.what.partition(":")[2] if row.what.startswith("commons") else row.what.partition(",")[0]
    return f"commons: {what.strip()}" if row.what.startswith("commons") else what


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    ax = figure.add_subplot()
    rows = [row for row in _rows(done) if row.closed]
    ratio = [row.mean() / row.closed for row in rows if row.closed]
    ax.axvline(1.0, color="0.7")
    ax.plot(ratio, range(len(rows)), "o", color=answers.OURS)
    for i, row in enumerate(rows):
        between = row.interval()
        if between is not None and row.closed:
            ax.plot(np.array(between) / row.closed, [i, i], color=answers.OURS)
            ax.plot(np.array(row.ours) / row.closed, [i + 0.25] * len(row.ours), ".", color=answers.OURS, alpha=0.45)
    ax.set_yticks(range(len(rows)), [textwrap.fill(_short(row), WIDE) for row in rows], fontsize=7)
    answers.finish(ax, f"ours over the closed form\n{answers.INTERVAL}", "")


def case() -> Case:
    """Return the case."""
    return Case(
        "laws", "small laws: R*, variance, fixation, growth; equality at a common pool", _parts, _rows, figure=_figure
    )
