"""B3: Holling's functional response, and what learning does to it."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import optimize

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.hunting import REACH, SIDE, WALK
from ecology.state import Ints

ORDER = 36
DENSITIES = (0.25, 0.5, 1.0, 2.0, 4.0)
HANDLING, HUNTERS, TICKS = 60.0, 40, 3_000
SEARCH = 2 * REACH * WALK  # area that a hunter searches per unit of time on a straight path
LEARNERS, LIVED, AMONG = 8, 12_000, (0.5, 1.0, 4.0)  # agents, ticks, densities
BLOCK = 1_500  # ticks over which what learners take is counted
SHOWN = (1, LIVED // BLOCK - 1)  # blocks that are compared: after one, and the last


def measure_scripted(density: float, seed: int, handling: float = HANDLING) -> float:
    """Return the prey that a hunter takes per unit of time: it walks straight on, and bites what is in its reach."""
    env, tick = answers.begin("hunting", seed, density=density, handling=handling, hunters=HUNTERS, sight=2 * REACH)
    names = {a: i for i, a in enumerate(env.groups["hunter"].actions)}

    def policy(env: Ecology, tick: Tick) -> Ints:
        bites = tick.masks["hunter"][:, names["bite_prey"]]
        return answers.act(env, hunter=np.where(bites, names["bite_prey"], names["walk"]))

    seen = answers.play(env, tick, TICKS, policy, lambda e, _: int((e.state_view.bit >= 0).sum()))
    skip = TICKS // 10
    return sum(seen[skip:]) / (TICKS - skip) / HUNTERS


def measure_learner(density: float, seed: int) -> list[float]:
    """Return the prey that a learner takes per unit of time, in every block of its life."""
    _, _, _, rows = answers.learn(
        "hunting", seed, LIVED, lambda _, s: int((s.bit >= 0).sum()), density=density, handling=HANDLING,
        hunters=LEARNERS,
    )  # fmt: skip
    return [sum(rows[t : t + BLOCK]) / BLOCK / LEARNERS for t in range(0, LIVED, BLOCK)]


def fit(rates: Mapping[float, float]) -> tuple[float, float]:
    """Return a and h of f = a N / (1 + a h N), least squares of 1 / f against 1 / N weighted by f^2."""
    n, f = np.array(list(rates), float), np.array(list(rates.values()), float)
    start = (SEARCH, HANDLING)
    (a, h), _ = optimize.curve_fit(lambda n, a, h: a * n / (1 + a * h * n), n, f, p0=start, sigma=np.maximum(f, 1e-6))
    return float(a), float(h)


def _parts() -> list[Part]:
    parameters = answers.parameters("hunting", handling=HANDLING, hunters=HUNTERS, ticks=TICKS)
    found = []
    for seed in range(answers.SEEDS):
        found += [
            Part(f"scripted-{d:g}-{seed}", parameters, 3.0, functools.partial(measure_scripted, d, seed))
            for d in DENSITIES
        ]
    parameters = answers.parameters("hunting", handling=HANDLING, hunters=LEARNERS, ticks=LIVED)
    for seed in range(answers.SEEDS):
        found += [
            Part(f"learned-{d:g}-{seed}", parameters, 20.0, functools.partial(measure_learner, d, seed)) for d in AMONG
        ]
    return found


def response(density: Any) -> Any:
    """Return the prey that a hunter takes per unit of time if it walks straight on, by Holling's disc equation."""
    return SEARCH * density / (1 + SEARCH * HANDLING * density)


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    if ours := [fit(rates) for rates in answers.complete_parts(done, "scripted", DENSITIES)]:
        a, h = zip(*ours, strict=True)
        found.append(Row("handling time h", h, closed=HANDLING, tolerance=0.05 * HANDLING))
        what = "rate of search a, still prey, straight paths: 2 R v"
        found.append(Row(what, a, closed=SEARCH, tolerance=0.1 * SEARCH))
    for density in AMONG:  # of learners a fit says nothing: their rates do not saturate
        lives = answers.column(done, f"learned-{density:g}-")
        for block in SHOWN if lives else ():
            when = f"ticks {block * BLOCK:,} to {(block + 1) * BLOCK:,}"
            what = f"f/J (lean): prey taken per tick at density {density:g}, {when} (closed form: straight paths)"
            found.append(Row(what, [life[block] for life in lives], closed=response(density)))
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    ax = figure.add_subplot()
    x = np.linspace(0, max(DENSITIES) * 1.05, 100)
    ax.plot(x, response(x), color=answers.CLOSED, label="Holling, a = 2 R v")
    for kind, label, look in (("scripted", "scripted", answers.SCRIPTED), ("learned", "f/J (lean)", answers.LEARNED)):
        have = [d for d in DENSITIES if answers.column(done, f"{kind}-{d:g}-")]
        samples = [answers.column(done, f"{kind}-{d:g}-") for d in have]
        if kind == "learned":  # at the end of their lives
            samples = [[life[-1] for life in lives] for lives in samples]
        if have:
            answers.band(ax, have, samples, label, look)
    ax.axhline(1 / HANDLING, color="0.8", ls=":")
    answers.finish(ax, f"prey per unit of area ({SIDE:g} x {SIDE:g})", "prey taken per tick")


def case() -> Case:
    """Return the case."""
    return Case(
        "hunting",
        "the functional response (Holling 1959)",
        _parts,
        _rows,
        figure=_figure,
    )
