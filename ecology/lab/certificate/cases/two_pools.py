"""B1: the ideal free distribution over two pools."""

# ruff: noqa: ARG001  (all policies and looks are of one form)

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.state import Floats, Ints

ORDER = 34
RATIOS = (1.0, 2.0, 4.0, 8.0)
AGENTS, TICKS = 48, 1_200
EPSILON = 0.125  # of agents that choose at random
MOVES = 0.02  # share of agents a tick that compare the pools
LEARNERS, LIVED = 24, 4_000


def look(env: Ecology, state: Any) -> tuple[float, float, float, float]:
    """Return the numbers of agents in the left and in the right pool, and the total that each pool gave so far."""
    inside = state.inside.sum(axis=0)
    return float(inside[0]), float(inside[1]), float(state.eaten[0]), float(state.eaten[1])


def measure_scripted(ratio: float, epsilon: float, seed: int = 0) -> dict[str, float]:
    """Return the distribution of agents that go where they would get more, or anywhere with `epsilon`, and intakes."""
    env, tick = answers.begin("two_pools", seed, ratio=ratio, n=AGENTS)
    rng, group = np.random.default_rng([seed, 1]), env.groups["agent"]
    flow = np.array([r.stock for r in env.scenario.resources])
    aim = rng.integers(0, 2, AGENTS)
    random = rng.permutation(AGENTS) < round(epsilon * AGENTS)  # agents that do not compare
    names = {a: i for i, a in enumerate(group.actions)}

    def policy(env: Ecology, tick: Tick) -> Ints:
        asks = rng.random(AGENTS) < MOVES
        aim[random & asks] = rng.integers(0, 2, int((random & asks).sum()))
        for i in np.flatnonzero(asks & ~random):  # one after the other, so that they do not overshoot together
            counts = np.bincount(np.delete(aim, i)[~np.delete(random, i)], minlength=2)
            aim[i] = int(np.argmax(flow / (counts + 1)))
        go = np.where(aim == 0, names["go_to_left"], names["go_to_right"])
        eat = np.where(aim == 0, names["consume_left"], names["consume_right"])
        mask = tick.masks["agent"]
        return answers.act(env, agent=np.where(mask[np.arange(AGENTS), eat], eat, go))

    rows = np.array(answers.play(env, tick, TICKS, policy, lambda e, _: look(e, e.state_view)))
    return summary(rows)


def summary(rows: Floats) -> dict[str, float]:
    """Return mean numbers in the pools over the second half, and the mean intake per agent and tick in each."""
    half = rows[len(rows) // 2 :]
    left, right = half[:, 0].mean(), half[:, 1].mean()
    got = (half[-1, 2:] - half[0, 2:]) / (len(half) - 1)
    return {"left": left, "right": right, "intake left": got[0] / max(left, 1e-9),
            "intake right": got[1] / max(right, 1e-9)}  # fmt: skip


def measure_learner(ratio: float, seed: int) -> dict[str, float]:
    """Return the distribution of learners."""
    _, _, _, rows = answers.learn("two_pools", seed, LIVED, look, ratio=ratio, n=LEARNERS)
    return summary(np.array(rows))


def leaning(life: Mapping[str, float]) -> float:
    """Return ln(N1 / N2), half an agent counted where a pool is empty."""
    return math.log(max(life["left"], 0.5) / max(life["right"], 0.5))


def slope(lives: Mapping[float, Mapping[str, float]]) -> float:
    """Return the slope of ln(N1 / N2) against ln(Q1 / Q2)."""
    return answers.fit_line([math.log(ratio) for ratio in lives], [leaning(life) for life in lives.values()])[0]


def slope_of(epsilon: float, n: int = AGENTS) -> float:
    """Return the slope of n agents if a share epsilon chooses at random and the others do not make up for it.

    No other gains by moving, which for whole agents is not quite the ratio of the inputs.
    """
    random = round(epsilon * n)
    ways: dict[float, float] = {}
    for r in RATIOS:
        left = next(k for k in range(n - random + 1) if r * (n - random - k) <= k + 1)
        ways[r] = math.log((left + random / 2) / (n - left - random / 2))
    return answers.fit_line([math.log(r) for r in ways], list(ways.values()))[0]


def _parts() -> list[Part]:
    parameters = answers.parameters("two_pools", ticks=TICKS, agents=AGENTS)
    found = []
    for epsilon in (0.0, EPSILON):
        for seed in range(answers.SEEDS):
            found += [
                Part(
                    f"scripted-{epsilon:g}-{r:g}-{seed}",
                    parameters,
                    2.0,
                    functools.partial(measure_scripted, r, epsilon, seed),
                )
                for r in RATIOS
            ]
    parameters = answers.parameters("two_pools", ticks=LIVED, agents=LEARNERS)
    for seed in range(answers.SEEDS):
        found += [
            Part(f"learned-{r:g}-{seed}", parameters, 5.0, functools.partial(measure_learner, r, seed)) for r in RATIOS
        ]
    return found


def slopes(done: Mapping[str, Any], kind: str) -> list[float]:
    """Return the slope of every seed whose lives at all ratios are done."""
    return [slope(lives) for lives in answers.complete_parts(done, kind, RATIOS)]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    free, noisy = slopes(done, "scripted-0"), slopes(done, f"scripted-{EPSILON:g}")
    if free:
        what = "slope of ln N1/N2 against ln Q1/Q2, ideal free (1 but for whole agents)"
        found.append(Row(what, free, closed=slope_of(0.0), tolerance=0.02))
        for r in RATIOS:
            of = answers.column(done, f"scripted-0-{r:g}-")
            ratio = [life["intake left"] / life["intake right"] for life in of]
            found.append(Row(f"intake per agent, left over right, at {r:g}:1", ratio, closed=1.0, tolerance=0.1))
    if noisy:
        what = f"slope, a share {EPSILON:g} goes anywhere"
        found.append(Row(what, noisy, closed=slope_of(EPSILON), tolerance=0.05))
    ours = slopes(done, "learned")
    if ours:
        what = f"f/J (lean, {LEARNERS}): slope of ln N1/N2 against ln Q1/Q2 (animals about .7)"
        found.append(Row(what, ours, closed=1.0))
        for r in RATIOS:
            of = answers.column(done, f"learned-{r:g}-")
            ratio = [life["intake left"] / max(life["intake right"], 1e-9) for life in of]
            found.append(Row(f"f/J: intake per agent, left over right, at {r:g}:1", ratio, closed=1.0))
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    ax = figure.add_subplot()
    x = np.log(RATIOS)
    ax.plot(x, x, color=answers.CLOSED, label="ideal free, slope 1")
    for kind, label, look in (
        ("scripted-0", "scripted", answers.SCRIPTED), ("learned", f"f/J, {LEARNERS} learners", answers.LEARNED),
    ):  # fmt: skip
        samples = [[leaning(life) for life in answers.column(done, f"{kind}-{r:g}-")] for r in RATIOS]
        if all(samples):
            answers.band(ax, x, samples, label, look)
    answers.finish(ax, "ln Q1 / Q2", "ln N1 / N2")


def case() -> Case:
    """Return the case."""
    return Case(
        "two_pools",
        "the ideal free distribution (Fretwell and Lucas 1970)",
        _parts,
        _rows,
        figure=_figure,
    )
