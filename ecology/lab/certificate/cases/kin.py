"""B5: Hamilton's rule for how much an agent feels of others."""
# ruff: noqa: ARG001  (all policies and looks are of one form)

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick, heredity
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.kin import LIFE
from ecology.state import Ints

ORDER = 38
GROUPS, GENERATIONS = 60, 50
RELATED = (0.0, 0.25, 0.5, 0.75, 1.0)
COSTS = (0.0, 0.3, 0.6)
SEEDS = 4
VARIED, LONGER = (0.25, 0.5, 0.75), 160


def evolve(
    relatedness: float, cost: float, seed: int, varied: bool = False, generations: int = GENERATIONS
) -> dict[str, Any]:
    """Return the share that gives, the mean weight by generation, and the largest error of the Price equation.

    Agents give where their weight is above the cost over the benefit, which is 1.
    """
    env, tick = answers.begin("kin", seed, relatedness=relatedness, cost=cost, varied=varied, groups=GROUPS, felt=False)
    mean, share, worst = [], [], 0.0
    before: dict[int, float] = {}

    def policy(env: Ecology, tick: Tick) -> Ints:
        state: Any = env.state_view
        gives = state.trait[:, 0] > state.internal[:, 1]
        return answers.act(env, agent=gives.astype(np.int64))

    for _ in range(generations):
        living = np.flatnonzero(tick.alive)
        now: Any = env.state_view
        before = dict(zip(now.serial[living].tolist(), now.trait[living, 0].tolist(), strict=True))
        gives = []
        for _ in range(LIFE):
            tick = env.step_arrays(policy(env, tick))
            gives.append(float((tick.action[tick.alive] == 1).mean()))
        now = env.state_view
        young = np.flatnonzero(tick.alive)
        after = {int(now.serial[i]): (float(now.trait[i, 0]), [int(now.parent[i])]) for i in young}
        parts = heredity.price(before, after)
        worst = max(worst, abs(parts.change - parts.selection - parts.transmission))
        mean.append(float(now.trait[young, 0].mean()))
        share.append(float((now.trait[young, 0] > cost).mean()))
    return {"mean": mean, "share": share, "price": worst}


def threshold(shares: Mapping[float, float]) -> float:
    """Return the relatedness at which half of the agents give, linear between the values tried; 0 where all give."""
    r, s = np.array(list(shares)), np.array(list(shares.values()))
    above = np.flatnonzero(s >= 0.5)
    if not above.size:
        return 1.0
    k = int(above[0])
    return float(r[k]) if k == 0 else float(r[k - 1] + (0.5 - s[k - 1]) / (s[k] - s[k - 1]) * (r[k] - r[k - 1]))


def _parts() -> list[Part]:
    parameters = answers.parameters("kin", groups=GROUPS, generations=GENERATIONS)
    found = [
        Part(f"fixed-{cost:g}-{r:g}-{seed}", parameters, 1.5, functools.partial(evolve, r, cost, seed))
        for cost in COSTS
        for r in (RELATED if cost else (0.0,))
        for seed in range(SEEDS)
    ]
    parameters = answers.parameters("kin", groups=GROUPS, generations=LONGER)
    return found + [
        Part(f"varied-{r:g}-{seed}", parameters, 4.0, functools.partial(evolve, r, 0.5, seed, True, LONGER))
        for r in VARIED
        for seed in range(SEEDS)
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    for cost in COSTS:
        if cost == 0:
            lives = answers.column(done, "fixed-0-0-")
            if lives:
                what = "positive control, c = 0, r = 0: share with a weight above c"
                found.append(Row(what, [life["share"][-1] for life in lives], closed=1.0, tolerance=0.15))
            continue
        ours = [
            threshold({r: float(np.mean(life["share"][-10:])) for r, life in lives.items()})
            for lives in answers.complete_parts(done, f"fixed-{cost:g}", RELATED, SEEDS)
        ]
        if ours:
            found.append(Row(f"relatedness from which giving spreads, c/b {cost:g}", ours, closed=cost, tolerance=0.12))
    for r in VARIED:
        lives = answers.column(done, f"varied-{r:g}-")
        if lives:
            ours = [float(np.mean(life["mean"][-LONGER // 4 :])) for life in lives]
            found.append(Row(f"stable weight where c/b varies, r {r:g}", ours, closed=r, tolerance=0.1))
    if done:
        worst = [life["price"] for life in done.values()]
        found.append(
            Row("largest error of the Price equation in any generation", [max(worst)], closed=0.0, tolerance=1e-12)
        )
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    left, right = figure.subplots(1, 2)
    for cost, look in zip(COSTS[1:], (answers.LEARNED, answers.PUBLISHED), strict=True):
        have = [r for r in RELATED if answers.column(done, f"fixed-{cost:g}-{r:g}-")]
        samples = [
            [float(np.mean(v["share"][-10:])) for v in answers.column(done, f"fixed-{cost:g}-{r:g}-")] for r in have
        ]
        if have:
            answers.band(left, have, samples, f"c/b {cost:g}", look)
        left.axvline(cost, color=look.colour, ls=look.line)
    answers.finish(left, "relatedness r", "share that gives", "one cost (vertical: r = c/b)")
    right.plot([0, 1], [0, 1], color=answers.CLOSED, label="w = r")
    have = [r for r in VARIED if answers.column(done, f"varied-{r:g}-")]
    if have:
        samples = [
            [float(np.mean(v["mean"][-LONGER // 4 :])) for v in answers.column(done, f"varied-{r:g}-")] for r in have
        ]
        answers.band(right, have, samples, "evolved")
    answers.finish(right, "relatedness r", "weight of what others feel", "costs vary")


def case() -> Case:
    """Return the case."""
    return Case(
        "kin",
        "Hamilton's rule for a weight of empathy (Hamilton 1964; Waibel, Floreano and Keller 2011)",
        _parts,
        _rows,
        figure=_figure,
        notes=["Robots of Waibel et al. have the transition at r = c/b in every treatment."],
    )
