"""B5: Hamilton's rule for how much an agent feels of others."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick, agents, heredity, scenarios
from ecology.agents import loop
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.kin import LIFE
from ecology.state import Ints

ORDER = 38
GROUPS, GENERATIONS = 60, 50
RELATED = (0.0, 0.25, 0.5, 0.75, 1.0)
COSTS = (0.0, 0.3, 0.6)
VARIED, LONGER = (0.25, 0.5, 0.75), 160
LEARNED, SIZE, FAMILIES, SPAN, BRED = (0.3, 0.6), 4, 30, 21, 40  # learners: costs, group, groups, ticks, generations
OWN: Mapping[str, Any] = {  # settings of learners that live for 21 ticks: an heir knows what its parent knew
    "inherit": True, "pause": 1.0, "update_every": 2.0, "width": 16, "batch": 16, "batch_f": 64, "memory": 100,
    "warm_up": 4, "epsilon": 0.1, "epsilon_final": 0.1, "learning_rate": 1e-3, "learning_rate_final": 1e-4,
    "gamma": 0.9, "imagined": 0.0, "imagined_f": 0.0, "recent_share": 0.0,
}  # fmt: skip


def evolve(
    relatedness: float, cost: float, seed: int, varied: bool = False, generations: int = GENERATIONS
) -> dict[str, Any]:
    """Return the share that gives, the mean weight by generation, and the largest error of the Price equation.

    Agents give where their weight is above the cost over the benefit, which is 1.
    """
    env, tick = answers.begin("kin", seed, relatedness=relatedness, cost=cost, varied=varied, groups=GROUPS, felt=False)

    def policy(env: Ecology) -> Ints:
        state: Any = env.state_view
        gives = state.trait[:, 0] > state.internal[:, 1]
        return answers.act(env, agent=gives.astype(np.int64))

    return _breed(env, tick, lambda _: env.step_arrays(policy(env)), cost, (generations, LIFE))


def evolve_learners(relatedness: float, cost: float, seed: int) -> dict[str, Any]:
    """Return the same of learners, which feel what they care for and have to find out what a gift does."""
    world = scenarios.load("kin", relatedness=relatedness, cost=cost, groups=FAMILIES, size=SIZE, life=SPAN)
    env = Ecology(world)
    minds = {"agent": agents.make("lean", env.groups["agent"], np.random.SeedSequence([seed, 0]), OWN)}
    tick = env.reset_arrays(seed)
    return _breed(env, tick, lambda last: loop.advance(env, minds, last, 1), cost, (BRED, SPAN))


def _breed(
    env: Ecology, tick: Tick, step: Callable[[Tick], Tick], cost: float, lengths: tuple[int, int]
) -> dict[str, Any]:
    """Return what `evolve` does, of agents that `step` lets act; `lengths` are generations, and ticks of each."""
    generations, life = lengths
    mean, share, given, worst = [], [], [], 0.0
    before: dict[int, float] = {}
    for _ in range(generations):
        living = np.flatnonzero(tick.alive)
        now: Any = env.state_view
        before = dict(zip(now.serial[living].tolist(), now.trait[living, 0].tolist(), strict=True))
        gives = []
        for _ in range(life):
            tick = step(tick)
            gives.append(float((tick.action[tick.alive] == 1).mean()))
        now = env.state_view
        young = np.flatnonzero(tick.alive)
        after = {int(now.serial[i]): (float(now.trait[i, 0]), [int(now.parent[i])]) for i in young}
        parts = heredity.price(before, after)
        worst = max(worst, abs(parts.change - parts.selection - parts.transmission))
        mean.append(float(now.trait[young, 0].mean()))
        share.append(float((now.trait[young, 0] > cost).mean()))
        given.append(float(np.mean(gives[1:-1])))
    return {"mean": mean, "share": share, "given": given, "price": worst}


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
        for seed in range(answers.SEEDS)
    ]
    parameters = answers.parameters("kin", groups=GROUPS, generations=LONGER)
    found += [
        Part(f"varied-{r:g}-{seed}", parameters, 4.0, functools.partial(evolve, r, 0.5, seed, True, LONGER))
        for r in VARIED
        for seed in range(answers.SEEDS)
    ]
    parameters = answers.parameters("kin", groups=FAMILIES, size=SIZE, life=SPAN, generations=BRED, **OWN)
    return found + [
        Part(f"learned-{cost:g}-{r:g}-{seed}", parameters, 9.0, functools.partial(evolve_learners, r, cost, seed))
        for cost in reversed(LEARNED)
        for seed in range(answers.SEEDS)
        for r in RELATED
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
            for lives in answers.complete_parts(done, f"fixed-{cost:g}", RELATED)
        ]
        if ours:
            found.append(Row(f"relatedness from which giving spreads, c/b {cost:g}", ours, closed=cost, tolerance=0.12))
    for r in VARIED:
        lives = answers.column(done, f"varied-{r:g}-")
        if lives:
            ours = [float(np.mean(life["mean"][-LONGER // 4 :])) for life in lives]
            found.append(Row(f"stable weight where c/b varies, r {r:g}", ours, closed=r, tolerance=0.1))
    found += _rows_of_learners(done)
    if done:
        worst = [life["price"] for life in done.values()]
        found.append(
            Row("largest error of the Price equation in any generation", [max(worst)], closed=0.0, tolerance=1e-12)
        )
    return found


def _late(life: Mapping[str, Any], what: str) -> float:
    """Return the mean of the last ten generations."""
    return float(np.mean(life[what][-10:]))


def _rows_of_learners(done: Mapping[str, Any]) -> list[Row]:
    """Return from which relatedness on learners give, and their weights are above the cost."""
    found = []
    for cost in LEARNED:
        families = answers.complete_parts(done, f"learned-{cost:g}", RELATED)
        for what, name in (("given", "half of all acts are gifts"), ("share", "half of the weights are above c/b")):
            if families:
                ours = [threshold({r: _late(life, what) for r, life in lives.items()}) for lives in families]
                found.append(Row(f"f/J: relatedness from which {name}, c/b {cost:g}", ours, closed=cost))
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
