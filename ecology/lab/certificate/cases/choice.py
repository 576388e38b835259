"""A4 to A6: deprivation, dose and risk from the drive alone; the published gamble; curvature and spread."""

# ruff: noqa: ARG001  (all policies and looks are of one form)

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.agents.base import Learner
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.state import Floats, Ints

ORDER = 32
BODIES = 800  # that gamble at once; a smaller crowd at one place is faster
OTHER = (0.0, 0.5, 1.0, 2.0)  # deviation of the other need
MIDDLE = 4.0  # set point of both
PAIRS = 200  # states in which a choice is asked for
LIVED = 10_000
BETA, WALKS, STEP, REACH = 0.06, 1_500, 1.0, 60  # softmax of the random walk, ticks, size of a step, bounds
POWERS = {2.0: 4.1, 4 / 3: 8.3, 1.0: 16.6}  # n / m -> SD of h in the published task


def gamble(other: float, seed: int = 0) -> dict[str, float]:
    """Return the mean drive after a sure and after a risky meal at delta_1 = -1 and delta_2 = `other`, in the world."""
    found = {}
    for meal in ("sure", "risky"):
        env, tick = answers.begin("choice", seed, count=BODIES, decay=0.0)  # crowds at one place are slow
        tick = env.set_state(internal=np.tile([MIDDLE - 1.0, MIDDLE - other], (BODIES, 1)))
        (found[meal],) = answers.play(env, tick, 1, _always(meal), lambda _, t: float(t.drive.mean()))
    return found


def _always(action: str) -> answers.Policy:
    return lambda env, _: answers.act(env, body=action)


def preferences(m1: float, m2: float, seed: int = 0) -> dict[str, float]:
    """Return the preferences of a body that tries both meals for a tick, at 200 random pairs of deviations."""
    rng = np.random.default_rng([seed, 3])
    pairs = -rng.uniform(0.0, 3.0, (PAIRS, 2))
    after = {}
    for action in ("sure", "drink"):
        env, tick = answers.begin("choice", seed, count=PAIRS, decay=0.0, meal=m1, drink=m2)
        tick = env.set_state(internal=MIDDLE + pairs)
        (after[action],) = answers.play(env, tick, 1, _always(action), lambda _, t: t.drive.copy())
    return boundary(pairs, after["sure"] < after["drink"], m1, m2)


def boundary(pairs: Floats, first: np.ndarray, m1: float, m2: float) -> dict[str, float]:
    """Return the share of choices (k,) that are right at `pairs` (k, 2), and the slope that separates them best.

    The rule is m_1 |delta_1| > m_2 |delta_2|; its slope |delta_2| / |delta_1| is m_1 / m_2.
    """
    size = np.abs(pairs)
    right = float((first == (m1 * size[:, 0] > m2 * size[:, 1])).mean())
    ratio = np.log(size[:, 1] / size[:, 0])
    cuts = np.sort(ratio)
    correct = [float(((ratio < cut) == first).mean()) for cut in cuts]
    best = np.flatnonzero(np.array(correct) >= max(correct) - 1e-9)
    return {"right": right, "slope": float(np.exp(cuts[best].mean()))}


def meals(seed: int = 0, meal: float = 0.05) -> dict[str, float]:
    """Return slope and intercept of the size of a meal against the deviation at its start: eaten while d falls."""
    rng = np.random.default_rng([seed, 4])
    hungry = rng.uniform(0.2, 3.0, 100)
    env, tick = answers.begin("choice", seed, count=100, decay=0.0, meal=meal)
    tick = env.set_state(internal=np.column_stack([MIDDLE - hungry, np.full(100, MIDDLE - 1.0)]))

    def policy(env: Ecology, tick: Tick) -> Ints:
        lacks = MIDDLE - env.state_view.internal[:, 0]
        return answers.act(env, body=np.where(lacks > meal / 2, 1, 0))

    answers.play(env, tick, 100, policy)
    slope, intercept = answers.fit_line(hungry, env.state_view.ingested[:, 0])
    return {"slope": slope, "intercept": intercept}


def spread(exponent: float, seed: int = 0) -> float:
    """Return the SD of h of bodies that step up or down by a softmax of the drive after it, in the world."""
    rng = np.random.default_rng([seed, 5])
    env, tick = answers.begin(
        "choice", seed, count=100, decay=STEP, meal=2 * STEP, water=False, exponent=exponent, wide=float(REACH)
    )

    def policy(env: Ecology, tick: Tick) -> Ints:
        h = env.state_view.internal[:, 0] - REACH
        gap = np.abs(h + STEP) ** exponent - np.abs(h - STEP) ** exponent
        return answers.act(env, body=np.where(rng.random(len(h)) < 1 / (1 + np.exp(BETA * gap)), 1, 0))

    seen = answers.play(env, tick, WALKS, policy, lambda e, _: e.state_view.internal[:, 0].copy())
    return float(np.std(np.array(seen)[WALKS // 4 :]))


def stationary(exponent: float, reach: int = REACH) -> float:
    """Return the SD of the same walk by detailed balance, within the bounds of the need."""
    h = np.arange(-reach, reach + 1, dtype=float)
    up = 1 / (1 + np.exp(BETA * (np.abs(h + 1) ** exponent - np.abs(h - 1) ** exponent)))
    weight = np.ones(len(h))
    for k in range(1, len(h)):
        weight[k] = weight[k - 1] * up[k - 1] / (1 - up[k])
    # at a bound the step beyond it stays where it is, which leaves detailed balance as it is
    weight /= weight.sum()
    return float(math.sqrt((weight * h**2).sum() - (weight * h).sum() ** 2))


def measure_learner(seed: int, ticks: int = LIVED) -> dict[str, float]:
    """Return the preferences of a learner trained on both foods: for deprivation, for dose, and for risk by deficit."""
    env, minds, _, rows = answers.learn(
        "choice", seed, ticks, lambda _, s: (int(s.action[0]), float(s.own_drive[0])), noise=0.1
    )
    mind = minds["body"]
    mind.evaluating(0.0)
    rng = np.random.default_rng([seed, 6])
    pairs = -rng.uniform(0.0, 3.0, (PAIRS, 2))
    chosen = np.array([ask(env, mind, MIDDLE + pair, ("sure", "drink")) for pair in pairs])
    found = boundary(pairs, chosen == 0, 0.5, 0.5)
    for other in OTHER:
        states = [(MIDDLE - 1.0 + d, MIDDLE - other) for d in np.linspace(-0.4, 0.4, 9)]
        found[f"risky at {other:g}"] = float(np.mean([ask(env, mind, x, ("sure", "risky")) for x in states]))
    stops = [first_rest(env, mind, hungry) for hungry in np.linspace(0.3, 3.0, 10)]
    found["meal slope"], found["meal intercept"] = answers.fit_line(np.linspace(0.3, 3.0, 10), stops)
    table = np.array(rows[len(rows) // 2 :])
    found["share risky"] = float((table[:, 0] == 2).sum() / max(np.isin(table[:, 0], (1, 2)).sum(), 1))
    found["drive"] = float(table[:, 1].mean())
    return found


def ask(env: Ecology, mind: Learner, internal: Any, among: tuple[str, ...]) -> int:
    """Return which of the actions `among` a frozen learner takes at an internal state, by its scores."""
    tick = env.set_state(internal=np.array([internal], float))
    names = env.groups["body"].actions
    mask = np.isin(np.array(names), among)[None] & tick.masks["body"]
    mind.begin()
    return among.index(names[int(mind.act(tick.observations["body"], mask)[0])])


def first_rest(env: Ecology, mind: Learner, hungry: float, most: int = 12) -> float:
    """Return how much a frozen learner that lacks only `hungry` of food eats until it does something else."""
    tick = env.set_state(internal=np.array([[MIDDLE - hungry, MIDDLE]]))
    mind.begin()
    start = env.state_view.ingested[0, 0]
    for _ in range(most):
        action = int(mind.act(tick.observations["body"], tick.masks["body"])[0])
        if action not in (1, 2):
            break
        tick = env.step_arrays(answers.act(env, body=np.array([1])))
    return float(env.state_view.ingested[0, 0] - start)


def _parts() -> list[Part]:
    parameters = answers.parameters("choice")
    found = [Part(f"gamble-{x:g}", parameters, 1.0, functools.partial(gamble, x)) for x in OTHER]
    found += [
        Part(f"deprivation-{m2:g}", parameters, 1.0, functools.partial(preferences, 0.02, m2)) for m2 in (0.02, 0.04)
    ]
    found += [Part("dose", parameters, 1.0, meals)]
    found += [Part(f"spread-{n:.3g}", parameters, 2.0, functools.partial(_measure_bounded_spread, n)) for n in POWERS]
    parameters = answers.parameters("choice", ticks=LIVED)
    return found + [
        Part(f"seed-{s}", parameters, 20.0, functools.partial(measure_learner, s)) for s in range(answers.SEEDS)
    ]


def _measure_bounded_spread(exponent: float) -> list[float]:
    return [spread(exponent, seed) for seed in range(answers.SEEDS)]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    for x in OTHER:
        if f"gamble-{x:g}" in done:
            life = done[f"gamble-{x:g}"]
            sure, risky = math.hypot(0.5, x), (math.hypot(1.0, x) + x) / 2
            found.append(Row(f"E d after a sure meal, other need {x:g}", [life["sure"]], closed=sure, tolerance=0.001))
            found.append(
                Row(f"E d after a risky meal, other need {x:g}", [life["risky"]], closed=risky, tolerance=0.05)
            )
    for m2 in (0.02, 0.04):
        life = done.get(f"deprivation-{m2:g}")
        if life is not None:
            found.append(
                Row(f"deprivation, m2/m1 {m2 / 0.02:g}: share right", [life["right"]], closed=1.0, tolerance=0.03)
            )
            found.append(
                Row(f"deprivation, m2/m1 {m2 / 0.02:g}: slope of the boundary", [life["slope"]], closed=0.02 / m2,
                    tolerance=0.05)
            )  # fmt: skip
    if "dose" in done:
        found.append(Row("dose: slope of meal against deviation", [done["dose"]["slope"]], closed=1.0, tolerance=0.01))
        found.append(Row("dose: intercept", [done["dose"]["intercept"]], closed=0.0, tolerance=0.03))
    for n, theirs in POWERS.items():
        if f"spread-{n:.3g}" in done:
            what = f"SD of h of a softmax walk, n/m {n:.3g} (published task {theirs:g})"
            found.append(Row(what, done[f"spread-{n:.3g}"], closed=stationary(n)))
    lives = answers.column(done, "seed-")
    if lives:
        given = "no number to compare with"
        found += [
            Row("f/J, deprivation: share right", [life["right"] for life in lives], closed=1.0),
            Row("f/J, deprivation: slope of the boundary", [life["slope"] for life in lives], closed=1.0),
            Row("f/J, dose: slope of meal against deviation", [life["meal slope"] for life in lives], closed=1.0),
            Row("f/J, dose: intercept", [life["meal intercept"] for life in lives], verdict=given),
            Row("f/J, share of risky meals as lived", [life["share risky"] for life in lives], verdict=given),
        ]  # fmt: skip
        for x in OTHER:
            ours = [life[f"risky at {x:g}"] for life in lives]
            closed = None if x == 0 else 0.0
            found.append(Row(f"f/J, share of states in which it gambles, other need {x:g}", ours, closed=closed,
                             verdict="the closed form is indifferent" if x == 0 else None))  # fmt: skip
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    lives = answers.column(done, "seed-")
    left, *middle, right = figure.subplots(1, 3 if lives else 2)
    x = np.linspace(0, 2, 50)
    left.plot(x, np.hypot(0.5, x), color=answers.CLOSED, label="sure")
    left.plot(x, (np.hypot(1.0, x) + x) / 2, color=answers.THEIRS, ls="--", label="risky")
    for other in OTHER:
        life = done.get(f"gamble-{other:g}")
        if life is not None:
            left.plot([other] * 2, [life["sure"], life["risky"]], "o", color=answers.OURS, markersize=4)
    answers.finish(left, "other need unmet", "expected drive", "risk (dots: the world)")
    for ax in middle:
        answers.band(ax, OTHER, [[life[f"risky at {o:g}"] for life in lives] for o in OTHER], "f/J")
        ax.axhline(0.5, color="0.8")
        ax.set_ylim(-0.05, 1.05)
        answers.finish(ax, "other need unmet", "share that gambles", "learned")
    have = [n for n in POWERS if f"spread-{n:.3g}" in done]
    if have:
        right.plot(have, [np.mean(done[f"spread-{n:.3g}"]) for n in have], "o", color=answers.OURS)
        right.plot(have, [stationary(n) for n in have], "x", color=answers.CLOSED, markersize=8)
    answers.finish(right, "n / m of the drive", "SD of h", "spread (x: closed form)")


def case() -> Case:
    """Return the case."""
    return Case(
        "choice",
        "choice from the drive: deprivation, dose, risk (Laurencon et al. 2021, section 3.2; Keramati and Gutkin 2014)",
        _parts,
        _rows,
        figure=_figure,
    )
