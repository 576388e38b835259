"""A7: agents that see only signs of what their partner feels."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.agents import loop
from ecology.lab.certificate import answers, episodes
from ecology.lab.certificate.case import Case, Part, Row
from ecology.state import Ints

ORDER = 33
NOISE, WEIGHT, CAP, TRAINED, LIVES = 0.1, 0.5, 2_000, 4_000, 4
KINDS = {
    "none": {"weight": 0.0, "senses": "nothing"},
    "signs": {"weight": WEIGHT, "senses": "signs"},
    "told": {"weight": WEIGHT, "senses": "energy"},
}
PUBLISHED = (1803.0, 267.0, 20)  # FoodShare under full inference, Man and Yoshida 2025


def _display(env: Ecology) -> int:
    """Return the column of the partner's sign."""
    return [need.name for need in env.scenario.species[1].needs].index("display")


def policy_of(inferring: bool) -> episodes.Policy:
    """Return the policy that passes where its energy is high and the partner is, or seems, low."""

    def policy(env: Ecology) -> Ints:
        state: Any = env.state_view
        own, other = env.groups["possessor"].slots, env.groups["partner"].slots
        low = state.internal[other, _display(env)] < 0.5 if inferring else state.internal[other, 0] <= 0
        return np.where((state.internal[own, 0] > 0) & low, 1, 0)

    return policy


def measure_scripted(inferring: bool, lives: int = answers.SEEDS, cap: int = CAP) -> list[float]:
    """Return the lengths of lives under that policy."""
    words = {"senses": "signs", "noise": NOISE}
    found, _ = episodes.run_scripted("inferred", words, policy_of(inferring), 1, lives, cap)
    return [float(n) for lengths in found for n in lengths]


def measure_learner(kind: str, seed: int) -> dict[str, Any]:
    """Return how long pairs with a trained learner survive, and how well it infers what the partner feels."""
    words = KINDS[kind]
    env, minds, tick = _train(words, seed)
    mind = minds["possessor"]
    found: dict[str, Any] = {}
    if kind == "signs":
        pairs = _infer(env, mind, tick)
        found["correlation"] = float(np.corrcoef(pairs.T)[0, 1])
        found["noise limit"] = float(np.corrcoef(pairs[:, 1], pairs[:, 2])[0, 1])
        found["pairs"] = pairs[:200].round(3).tolist()
    mind.evaluating(0.0)
    worlds = episodes.Worlds("inferred", {**words, "noise": NOISE}, 1, 100 + seed, CAP)
    mind.begin()
    lives = worlds.lives(lambda: mind.act(worlds.zeta, worlds.masks), LIVES)
    found["lives"] = [float(n) for n in lives[0]]
    return found


def _train(words: Mapping[str, Any], seed: int, ticks: int = TRAINED) -> tuple[Ecology, Any, Tick]:
    """Train a learner for `ticks`; an agent that dies starts again, and the learner keeps its knowledge."""
    env, tick = answers.begin("inferred", seed, noise=NOISE, **words)
    minds = answers.minds_of(env, env.scenario, seed, {})
    lived = 0
    while lived < ticks:
        tick = loop.run(env, minds, tick, 1)
        lived += 1
        if not tick.alive.all():
            env.reset_arrays(seed * 10_000 + lived)
            tick = env.step_arrays(np.zeros(env.size, np.int64))
            minds["possessor"].begin()
    return env, minds, tick


def _infer(env: Ecology, mind: Any, tick: Tick, ticks: int = 400) -> np.ndarray:
    """Return the inferred and the true drive of the partner, and its sign, over ticks of random actions, (k, 3)."""
    rng, found = np.random.default_rng(1), []
    for k in range(ticks):
        act = int(rng.integers(2))
        tick = env.step_arrays(answers.act(env, possessor=np.array([act])))
        if not tick.alive.all():
            env.reset_arrays(50_000 + k)
            tick = env.step_arrays(np.zeros(env.size, np.int64))
        partner = env.groups["partner"].slots.start
        state: Any = env.state_view
        inferred, sign = mind.infer(tick.observations["possessor"])[0], state.internal[partner, _display(env)]
        found.append((float(inferred), float(state.own_drive[partner]), float(sign)))
    return np.array(found)


def _parts() -> list[Part]:
    parameters = answers.parameters("inferred", noise=NOISE)
    found = [
        Part(f"scripted-{name}", parameters, 10.0, functools.partial(measure_scripted, inferring))
        for name, inferring in (("told", False), ("signs", True))
    ]
    parameters = answers.parameters("inferred", noise=NOISE, weight=WEIGHT, ticks=TRAINED)
    return found + [
        Part(f"{kind}-seed-{s}", parameters, 15.0, functools.partial(measure_learner, kind, s))
        for s in range(answers.SEEDS)
        for kind in KINDS
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    if "scripted-told" in done:
        found.append(
            Row("ticks lived, scripted, perceives the partner's energy", done["scripted-told"], closed=float(CAP))
        )
    if "scripted-signs" in done:
        what = f"ticks lived, scripted, acts by the sign alone (wrong in {NOISE:.0%})"
        found.append(Row(what, done["scripted-signs"], theirs=PUBLISHED))
    for kind, what in (
        ("none", "no empathy"),
        ("signs", "empathy, the partner's drive inferred from signs"),
        ("told", "empathy, the partner's drive perceived"),
    ):
        lives = answers.column(done, f"{kind}-seed-")
        if not lives:
            continue
        ours = [float(np.mean(life["lives"])) for life in lives]
        theirs = {"signs": PUBLISHED, "none": (25.0, 7.0, 20), "told": (2000.0, 0.0, 20)}[kind]
        found.append(Row(f"f/J, ticks lived, {what}", ours, theirs=theirs))
        if kind == "signs":
            got, limit = [life["correlation"] for life in lives], [life["noise limit"] for life in lives]
            closed = float(np.mean(np.abs(limit)))
            found.append(Row("f/J, correlation of what is inferred with what the partner feels", got, closed=closed))
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    left, right = figure.subplots(1, 2)
    kinds = [kind for kind in KINDS if answers.column(done, f"{kind}-seed-")]
    lengths = [[float(np.mean(life["lives"])) for life in answers.column(done, f"{kind}-seed-")] for kind in kinds]
    if kinds:
        answers.band(left, range(len(kinds)), lengths, "f/J")
    left.axhline(PUBLISHED[0], color=answers.THEIRS, ls="--", label="published decoder")
    left.set_xticks(range(len(kinds)), kinds)
    answers.finish(left, "what is sensed of the partner", "ticks lived")
    lives = answers.column(done, "signs-seed-")
    if lives:
        pairs = np.array(lives[0]["pairs"])
        jitter = np.random.default_rng(0).normal(0, 0.03, len(pairs))
        right.plot(pairs[:, 1] + jitter, pairs[:, 0], ".", color=answers.OURS)
        limit = math.ceil(max(pairs[:, :2].max(), 1.0))
        right.plot([0, limit], [0, limit], color="0.7")
    answers.finish(right, "what the partner feels", "what is inferred (seed 0)")


def case() -> Case:
    """Return the case."""
    return Case(
        "inferred",
        "empathy by signs alone (after Man and Yoshida 2025)",
        _parts,
        _rows,
        figure=_figure,
    )
