"""B2: residence in a patch that yields less and less, by the marginal value theorem."""

# ruff: noqa: ARG001  (all policies and looks are of one form)

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import optimize

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.patches import WALK, A
from ecology.state import Ints

ORDER = 35
RATE, GAMMA = 0.05, 0.99
TRAVELS = (5, 10, 20, 40, 80)
LIVED, ASKED = 10_000, (5, 20, 80)  # of learners: ticks, travels


def charnov(travel: float) -> float:
    """Return t* of exp(l t) = 1 + l (t + travel)."""
    return float(optimize.brentq(lambda t: math.exp(RATE * t) - 1 - RATE * (t + travel), 1e-3, 500))


def best_discounted_residence(travel: float, gamma: float = GAMMA) -> float:
    """Return the residence that maximises (1 - e^-(l+rho)t) / (1 - e^-rho(t+travel)), the discounted intake."""
    rho = -math.log(gamma)

    def worth(t: float) -> float:
        return -(1 - math.exp(-(RATE + rho) * t)) / (1 - math.exp(-rho * (t + travel)))

    return float(optimize.minimize_scalar(worth, bounds=(0.1, 300), method="bounded").x)


def measure_scripted(travel: float) -> dict[str, float]:
    """Return residence and rate of an agent that leaves where the patch yields no more than its mean rate so far."""
    env, tick = answers.begin("patches", 0, travel=float(travel), rate=RATE)
    home, at_start, mean = 0, 0.0, 0.2  # the mean is learned: total intake over total time, of the last cycles
    log: list[tuple[float, float]] = []
    began, share = 0, 1 - math.exp(-RATE)

    def policy(env: Ecology, tick: Tick) -> Ints:
        nonlocal home, at_start, mean, began
        now: Any = env.state_view
        names = ("patch", "other")
        if now.inside[0, home] and now.stock[home] * share > mean:
            return answers.act(env, forager=f"consume_{names[home]}")
        if now.inside[0, home]:  # it leaves
            took = float(now.ingested[0, 0]) - at_start
            if now.tick > began:
                log.append((now.tick - began, took))
                recent = np.array(log[-6:])
                mean = float(recent[:, 1].sum() / recent[:, 0].sum())
            at_start, began, home = float(now.ingested[0, 0]), now.tick, 1 - home
        return answers.act(env, forager=f"go_to_{names[home]}")

    stays: list[bool] = answers.play(
        env, tick, 40 * round(travel + charnov(travel)), policy, lambda e, _: bool(e.state_view.action[0] in (1, 2))
    )
    return residence(stays, float(env.state_view.ingested[0, 0]))


def residence(stays: list[bool], eaten: float) -> dict[str, float]:
    """Return mean lengths of meals and of the time between them in the second half, ticks, and the mean intake."""
    eats = np.array(stays[len(stays) // 2 :])
    edges = np.flatnonzero(np.diff(eats.astype(int)))
    lengths = np.diff(edges)
    on = eats[edges[:-1] + 1] if len(edges) > 1 else np.zeros(0, bool)
    meals, ways = lengths[on], lengths[~on]
    return {
        "stay": float(meals.mean()) if meals.size else math.nan,
        "way": float(ways.mean()) if ways.size else math.nan,
        "rate": eaten / len(stays),
    }


def best_rate(travel: float, stay: float) -> float:
    """Return the intake per unit of time of an agent that always stays for `stay`."""
    return A * (1 - math.exp(-RATE * stay)) / (stay + travel)


def measure_fixed(travel: float, stay: int) -> float:
    """Return the rate of intake, in the world, of an agent that leaves after `stay` ticks."""
    env, tick = answers.begin("patches", 0, travel=float(travel), rate=RATE)
    home, eaten = 0, 0
    names = ("patch", "other")

    def policy(env: Ecology, tick: Tick) -> Ints:
        nonlocal home, eaten
        if env.state_view.inside[0, home] and eaten < stay:
            eaten += 1
            return answers.act(env, forager=f"consume_{names[home]}")
        if eaten >= stay:
            home, eaten = 1 - home, 0
        return answers.act(env, forager=f"go_to_{names[home]}")

    ticks = round(10 * (travel + stay))
    answers.play(env, tick, ticks, policy)
    return float(env.state_view.ingested[0, 0]) / ticks


def measure_learner(travel: float, seed: int) -> dict[str, float]:
    """Return residence and rate of a learner."""
    _, _, _, rows = answers.learn(
        "patches", seed, LIVED, lambda _, s: (bool(s.action[0] in (1, 2)), float(s.ingested[0, 0])),
        travel=float(travel), rate=RATE, gamma=GAMMA,
    )  # fmt: skip
    eats = [row[0] for row in rows]
    half = len(rows) // 2
    found = residence(eats, 0.0)
    # meals with a short interruption are one stay: the time from arrival to departure counts
    return {**found, "rate": (rows[-1][1] - rows[half][1]) / (len(rows) - half)}


def _parts() -> list[Part]:
    parameters = answers.parameters("patches", rate=RATE)
    found = [Part(f"scripted-{t}", parameters, 2.0, functools.partial(measure_scripted, t)) for t in TRAVELS]
    found += [
        Part(f"fixed-20-{stay}", parameters, 1.0, functools.partial(_measure_fixed, 20, stay))
        for stay in (8, 15, 19, 23, 27, 34, 50)
    ]
    parameters = answers.parameters("patches", rate=RATE, gamma=GAMMA, ticks=LIVED)
    for t in ASKED:
        found += [
            Part(f"learned-{t}-{seed}", parameters, 8.0, functools.partial(measure_learner, t, seed))
            for seed in range(answers.SEEDS)
        ]
    return found


def _measure_fixed(travel: float, stay: int) -> list[float]:
    return [measure_fixed(travel, stay)]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    for t in TRAVELS:
        life = done.get(f"scripted-{t}")
        if life is not None:
            stay = charnov(t)
            found.append(Row(f"residence, travel {t}", [life["stay"]], closed=stay, tolerance=0.06 * stay + 0.5))
    rates = {int(key.rsplit("-", 1)[1]): value[0] for key, value in done.items() if key.startswith("fixed-20-")}
    if len(rates) == 7:
        best = max(rates, key=lambda stay: rates[stay])
        found.append(Row("stay of the highest rate of seven, travel 20", [best], closed=23.0, tolerance=0.0))
    for t in TRAVELS:
        lives = answers.column(done, f"learned-{t}-")
        if lives:
            ours = [life["stay"] for life in lives if not math.isnan(life["stay"])]
            if ours:
                what = f"f/J: residence, travel {t} (without discount {charnov(t):.1f})"
                found.append(Row(what, ours, closed=best_discounted_residence(t)))
            share = [life["rate"] / best_rate(t, charnov(t)) for life in lives]
            found.append(Row(f"f/J: intake over the best, travel {t}", share, closed=1.0))
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    left, right = figure.subplots(1, 2)
    x = np.linspace(2, 85, 60)
    left.plot(x, [charnov(t) for t in x], color=answers.CLOSED, label="Charnov")
    left.plot(x, [best_discounted_residence(t) for t in x], color=answers.CLOSED, ls="--", label=f"discounted, {GAMMA}")
    some = [t for t in TRAVELS if f"scripted-{t}" in done]
    left.plot(some, [done[f"scripted-{t}"]["stay"] for t in some], "s", color=answers.SCRIPTED.colour, label="scripted")
    have = [t for t in TRAVELS if answers.column(done, f"learned-{t}-")]
    if have:
        samples = [
            [v["stay"] for v in answers.column(done, f"learned-{t}-") if not math.isnan(v["stay"])] for t in have
        ]
        answers.band(left, have, samples, "f/J")
    answers.finish(left, "travel", "residence")
    stays = np.linspace(3, 60, 60)
    right.plot(stays, [best_rate(20, s) for s in stays], color=answers.CLOSED, label="closed form")
    for key, value in done.items():
        if key.startswith("fixed-20-"):
            right.plot([int(key.rsplit("-", 1)[1])], value, "o", color=answers.OURS, markersize=4)
    answers.finish(right, "residence, travel 20", "intake per tick (dots: the world)")


def case() -> Case:
    """Return the case."""
    return Case(
        "patches",
        "when to leave a patch: the marginal value theorem (Charnov 1976)",
        _parts,
        _rows,
        figure=_figure,
        notes=[f"An agent walks {WALK:g} per unit of time; travel is counted from the last meal to the next."],
    )
