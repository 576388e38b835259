"""B6 and B7: sleep by two processes, and the energy budget rule."""
# ruff: noqa: ARG001  (all policies and looks are of one form)

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.agents import loop
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.night import DAY, DUSK, FALLS, LOWER, PATCHY, RISES, STEADY, UPPER
from ecology.state import Ints

ORDER = 39
FINE = 0.1  # hours in a tick, of sleep
SWING = 0.1  # of the thresholds with the day
NIGHT, MEAN = 5.0, 0.25  # R, and what foraging brings per hour
STARTS = (0.0, 0.5, 0.8, 1.2, 1.5, 2.0)  # energy at dawn: mu is 4 more
BODIES, NIGHTS = 250, 12  # at once, and how many times
PAPER = 1 / 11  # share of the time asleep that holds sleep fatigue level in `paper`
LIVED = 6_000


def sleeps(swing: float, dt: float = FINE, days: int = 12) -> dict[str, Any]:
    """Return hours awake and asleep per cycle, when sleep begins, and S, of a body that sleeps by two thresholds."""
    env, tick = answers.begin("night", 0, dt=dt, start=10.0, night=0.1)
    asleep = False

    def policy(env: Ecology, tick: Tick) -> Ints:
        nonlocal asleep
        now: Any = env.state_view
        s, wave = now.internal[0, 1], swing * math.sin(2 * math.pi * now.time / DAY)
        asleep = s > LOWER + wave if asleep else s >= UPPER + wave
        return answers.act(env, body="sleep" if asleep else "rest")

    rows = answers.play(
        env,
        tick,
        round(days * DAY / dt),
        policy,
        lambda e, t: (int(t.action[0] == 1), float(e.state_view.internal[0, 1])),
    )
    table = np.array(rows)
    change = np.flatnonzero(np.diff(table[:, 0])) + 1
    lengths, on = np.diff(change) * dt, table[change[:-1], 0] == 1
    onsets = change[:-1][on] * dt % DAY
    return {
        "asleep": float(lengths[on][-4:].mean()),
        "awake": float(lengths[~on][-4:].mean()),
        "hour": float(onsets[-1]),
        "drift": float(np.ptp(onsets[-4:])),
        "path": table[-round(3 * DAY / dt) :: 3, 1].tolist(),
    }


def two_processes(swing: float) -> dict[str, float]:
    """Return the same of the exact exponentials, in steps of a thousandth of an hour."""
    s, asleep, step, log = LOWER, False, 0.002, []
    for k in range(round(14 * DAY / step)):
        wave = swing * math.sin(2 * math.pi * k * step / DAY)
        now = s > LOWER + wave if asleep else s >= UPPER + wave
        if now != asleep:
            log.append((k * step, now))
            asleep = now
        s = s * math.exp(-step / FALLS) if asleep else 1 - (1 - s) * math.exp(-step / RISES)
    spans = [(b[0] - a[0], a[1]) for a, b in itertools.pairwise(log)]
    return {
        "asleep": float(np.mean([x for x, on in spans[-8:] if on])),
        "awake": float(np.mean([x for x, on in spans[-8:] if not on])),
        "hour": [t % DAY for t, on in log if on][-1],
    }


def survives(start: float, meal: str, seed: int = 0) -> float:
    """Return the share of bodies that are alive at dawn after taking `meal` all day."""
    env, tick = answers.begin("night", seed, start=start, mean=MEAN, night=NIGHT, count=BODIES)

    def policy(env: Ecology, tick: Tick) -> Ints:
        return answers.act(env, body=meal if env.state_view.time < DUSK else "rest")

    answers.play(env, tick, round(DAY), policy)
    return float(env.state_view.alive.mean())


def chance(start: float, meal: str) -> float:
    """Return the same exactly: enough successes in the hours of the day."""
    p = STEADY if meal == "steady" else PATCHY
    hours = round(DUSK)
    got = start + MEAN / p * np.arange(hours + 1)
    return float(answers.binomial(hours, p)[got >= NIGHT - 1e-9].sum())


def score(start: float, meal: str) -> float:
    """Return z = (mu - R) / sigma."""
    p = STEADY if meal == "steady" else PATCHY
    return (start + MEAN * DUSK - NIGHT) / (MEAN / p * math.sqrt(DUSK * p * (1 - p)))


def measure_learner(seed: int) -> dict[str, float]:
    """Return how often learners take patchy meals in a rich and in a poor world, and what share they sleep."""
    found: dict[str, float] = {}
    for name, start in (("poor", 0.5), ("rich", 1.5)):
        env, tick = answers.begin("night", seed, start=start, mean=MEAN, night=NIGHT, count=4)
        minds = answers.minds_of(env, env.scenario, seed, {})
        took, alive, slept, ticks = np.zeros(2), [], 0, 0
        watch = answers.Watch(lambda _, s: (s.action[s.alive].tolist(), float(s.alive.mean())))
        for _ in range(LIVED // round(DAY)):  # every day the dead return with initial needs and all that they learned
            tick = loop.run(env, minds, tick, round(DAY), (watch,))
            alive.append(watch.rows[-1][1])
            internal = env.state_view.internal.copy()
            internal[:, 0] = start
            tick = env.set_state(internal=internal, alive=np.ones(env.size, bool))
            minds["body"].begin()
        for actions, _ in watch.rows[LIVED // 2 :]:
            took += [actions.count(2), actions.count(3)]
            slept, ticks = slept + actions.count(1), ticks + len(actions)
        found |= {name: float(took[1] / max(took.sum(), 1)), f"{name} alive": float(np.mean(alive[len(alive) // 2 :]))}
        found[f"{name} asleep"] = slept / max(ticks, 1)
    return found


def _parts() -> list[Part]:
    parameters = answers.parameters("night")
    found = [Part(f"sleep-{swing:g}", parameters, 2.0, functools.partial(sleeps, swing)) for swing in (0.0, SWING)]
    for start in STARTS:
        found += [
            Part(f"budget-{start:g}-{meal}", parameters, 1.0, functools.partial(_survives, start, meal))
            for meal in ("steady", "patchy")
        ]
    parameters = answers.parameters("night", ticks=LIVED)
    return found + [
        Part(f"seed-{s}", parameters, 10.0, functools.partial(measure_learner, s)) for s in range(answers.SEEDS)
    ]


def _survives(start: float, meal: str) -> list[float]:
    return [survives(start, meal, seed) for seed in range(NIGHTS)]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    for swing, what in ((0.0, "constant thresholds"), (SWING, "thresholds that swing with the day")):
        life = done.get(f"sleep-{swing:g}")
        if life is not None:
            exact = two_processes(swing)
            found.append(Row(f"hours awake, {what}", [life["awake"]], closed=exact["awake"], tolerance=0.3))
            found.append(Row(f"hours asleep, {what}", [life["asleep"]], closed=exact["asleep"], tolerance=0.3))
            if swing:
                found.append(Row("hour at which sleep begins", [life["hour"]], closed=exact["hour"], tolerance=0.4))
    right = []
    for start in STARTS:
        pair: dict[str, Any] = {meal: done.get(f"budget-{start:g}-{meal}") for meal in ("steady", "patchy")}
        if None in pair.values():
            continue
        for meal, ours in pair.items():
            spare, normal = start + MEAN * DUSK - NIGHT, answers.phi(score(start, meal))
            what = f"alive at dawn, {meal} meals, mu - R {spare:+.1f} (Phi(z) {normal:.2f})"
            found.append(Row(what, ours, closed=chance(start, meal), tolerance=0.03))
        better = np.mean(pair["patchy"]) > np.mean(pair["steady"])
        right.append(float(better == (start + MEAN * DUSK < NIGHT)))
    if len(right) == len(STARTS):
        what = "share of budgets at which the meal with the larger z does better"
        found.append(Row(what, [float(np.mean(right))], closed=1.0, tolerance=0.0))
    lives = answers.column(done, "seed-")
    if lives:
        poor, rich = [life["poor"] for life in lives], [life["rich"] for life in lives]
        given = "no number to compare with"
        found += [
            Row("f/J: share of patchy meals, mu < R", poor, closed=1.0),
            Row("f/J: share of patchy meals, mu > R", rich, closed=0.0),
            Row(
                "f/J: share alive at dawn, mu < R", [life["poor alive"] for life in lives], closed=chance(0.5, "patchy")
            ),
            Row(
                "f/J: share alive at dawn, mu > R", [life["rich alive"] for life in lives], closed=chance(1.5, "steady")
            ),
            Row("f/J: share of the time asleep", [life["rich asleep"] for life in lives], verdict=given),
        ]
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    left, right = figure.subplots(1, 2)
    for swing, look in ((0.0, answers.SCRIPTED), (SWING, answers.LEARNED)):
        life = done.get(f"sleep-{swing:g}")
        if life is not None:
            x = np.arange(len(life["path"])) * 3 * FINE
            left.plot(
                x,
                life["path"],
                color=look.colour,
                linestyle=look.line,
                label="thresholds swing" if swing else "constant",
            )
    left.set_ylim(0.0, 1.3 * UPPER)  # room for the legend
    answers.finish(left, "hours", "sleepiness S")
    x = np.linspace(min(STARTS), max(STARTS), 60) + MEAN * DUSK - NIGHT
    for meal, look in (("steady", answers.LEARNED), ("patchy", answers.PUBLISHED)):
        right.plot(
            x, [answers.phi(score(v - MEAN * DUSK + NIGHT, meal)) for v in x], color=look.colour, linestyle=look.line,
            label=f"{meal}, Phi(z)",
        )  # fmt: skip
        have = [s for s in STARTS if f"budget-{s:g}-{meal}" in done]
        right.plot(
            [s + MEAN * DUSK - NIGHT for s in have],
            [np.mean(done[f"budget-{s:g}-{meal}"]) for s in have],
            look.marker,
            color=look.colour,
        )
    answers.finish(right, "mu - R", f"alive at dawn (markers: {BODIES:,} bodies of the world)")


def case() -> Case:
    """Return the case."""
    return Case(
        "night",
        "sleep by two processes (Borbely 1982), and the energy budget rule (Stephens 1981)",
        _parts,
        _rows,
        figure=_figure,
    )
