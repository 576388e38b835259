"""A2: cooling ahead of a heat load that kills an agent that only reacts."""

# ruff: noqa: ARG001, ARG005  (all policies and looks are of one form)

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.heat import COUPLING, INERTIA, MOST, ROOM
from ecology.state import Ints

ORDER = 30
REST, LOAD, LEAD, LASTS, AFTER = 36.27, 10.0, 20, 50, 60  # temperature held, load, ticks
AHEAD = (0, 5, 10, 15, 16, 20)  # ticks before the load at which cooling begins
DEADLY = 42.0
TRAINED, GAP, EPISODES = 20_000, 150.0, 8


def closed_form(ahead: int, load: float = LOAD) -> tuple[float, float, int | None]:
    """Return the peak, the mean drive and the tick of the load at which T passes 42, from the equation alone."""
    t, path = REST, []
    for k in range(-LEAD, LASTS + AFTER):
        push = load if 0 <= k < LASTS else 0.0
        u = -MOST if -ahead <= k < LASTS else float(np.clip((REST - t) * INERTIA + (t - ROOM) / COUPLING, -MOST, MOST))
        t += (u + push - (t - ROOM) / COUPLING) / INERTIA
        path.append(t)
    dead = next((k - LEAD + 1 for k, x in enumerate(path) if x > DEADLY), None)
    return max(path), float(np.mean(np.square(np.array(path) - 36.0))), dead


def measure_scripted(ahead: int, load: float = LOAD) -> dict[str, Any]:
    """Return the temperatures of a body that holds 36.27 and cools from `ahead` ticks before the load until its end."""
    world = {"load": load, "gap": 1e4, "levels": 101, "trials": 1, "lethal": False}
    env, tick = answers.begin("heat", 0, **world)
    tick = env.set_state(internal=np.array([[REST]]))
    group = env.groups["body"]
    efforts = np.array([a.control.get("temperature", 0.0) for a in env.scenario.species[0].actions]) * INERTIA

    def policy(env: Ecology, tick: Tick) -> Ints:
        t, k = float(env.state_view.internal[0, 0]), env.state_view.tick - LEAD
        held = float(np.clip((REST - t) * INERTIA + (t - ROOM) / COUPLING, -MOST, MOST))
        u = -MOST if -ahead <= k < LASTS else held
        return answers.act(env, **{group.name: np.array([np.abs(efforts - u).argmin()])})

    path = [x for (x,) in answers.play(env, tick, LEAD + LASTS + AFTER, policy, lambda e, _: e.state_view.internal[0])]
    dead = next((k - LEAD + 1 for k, x in enumerate(path) if x >= DEADLY), None)
    return {"path": path, "peak": max(path), "drive": float(np.mean(np.square(np.array(path) - 36.0))), "dead": dead}


def measure_learner(seed: int, ticks: int = TRAINED) -> dict[str, Any]:
    """Return the results of a learner trained with the load in `EPISODES` more trials, without learning."""
    _, minds, _, _ = answers.learn("heat", seed, ticks, lethal=False, gap=GAP, trials=ticks // 100)
    found = []
    for omits in (False, True):
        words = {"lethal": False, "gap": GAP, "trials": EPISODES, "load": 0.0 if omits else LOAD}
        test, tick = answers.begin("heat", 1000 + seed, **words)
        look = lambda e, s: (float(s.internal[0, 0]), float(s.cue[0]))  # noqa: E731
        rows = answers.run_frozen(test, minds, tick, int(EPISODES * (LEAD + LASTS + GAP)), 0.0, look)
        found.append(_episodes(np.array(rows)))
    loaded, spared = found
    mean = loaded.mean(axis=0)
    return {
        "survives": float((loaded.max(axis=1) < DEADLY).mean()),
        "peak": float(loaded.max(axis=1).mean()),
        "onset": float(loaded[:, LEAD - 1].mean()),
        "lowest": float(spared[:, LEAD:].min(axis=1).mean()),
        "ahead": _begins(mean),
        "drive": float(np.square(loaded - 36.0).mean()),
        "path": mean.tolist(),
    }


def _episodes(rows: np.ndarray) -> np.ndarray:
    """Return the temperatures of the trials (k, ticks) from rows of temperature and light: from the light on."""
    length = LEAD + LASTS + AFTER
    lit = np.flatnonzero((rows[1:, 1] > 0) & (rows[:-1, 1] == 0)) + 1
    return np.array([rows[k : k + length, 0] for k in lit if k + length <= len(rows)])


def _begins(path: np.ndarray) -> float:
    """Return how many ticks before the load the mean temperature was last highest; 0: it falls by less than .5."""
    before = path[:LEAD]
    highest = np.flatnonzero(before >= before.max() - 0.01)[-1]
    return float(LEAD - 1 - highest) if before.max() - before[-1] >= 0.5 else 0.0


def _parts() -> list[Part]:
    found = [
        Part(f"ahead-{k}", answers.parameters("heat", ahead=k, load=LOAD), 1.0, functools.partial(measure_scripted, k))
        for k in AHEAD
    ]
    parameters = answers.parameters("heat", ticks=TRAINED, gap=GAP)
    return found + [
        Part(f"seed-{s}", parameters, 25.0, functools.partial(measure_learner, s)) for s in range(answers.SEEDS)
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    for k in AHEAD:
        life = done.get(f"ahead-{k}")
        if life is None:
            continue
        peak, drive, dead = closed_form(k)
        if dead is not None:
            what = "tick of the load at which an agent that only reacts is at 42"
            found.append(Row(what, [life["dead"] or math.inf], theirs=(48.0, None, None), closed=dead, tolerance=1.0))
        else:
            found.append(Row(f"peak, cooling {k} ticks ahead", [life["peak"]], closed=peak, tolerance=0.05))
            found.append(Row(f"mean drive, cooling {k} ticks ahead", [life["drive"]], closed=drive, tolerance=0.05))
    lives = answers.column(done, "seed-")
    if lives:
        best = min(closed_form(k)[1] for k in range(LEAD + 1))
        alive = [life["survives"] for life in lives]
        found += [
            Row("f/J: share of loads survived", alive, closed=1.0),
            Row("f/J: ticks ahead at which it cools", [life["ahead"] for life in lives], closed=16.0),
            Row("f/J: temperature at the onset", [life["onset"] for life in lives], theirs=(33.75, None, None)),
            Row("f/J: peak", [life["peak"] for life in lives], theirs=(40.18, None, None)),
            Row("f/J: lowest, load left out", [life["lowest"] for life in lives], theirs=(32.25, None, None)),
            Row("f/J: mean drive over the best", [life["drive"] / best for life in lives], closed=1.0),
        ]
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    ax = figure.add_subplot()
    time = np.arange(-LEAD, LASTS + AFTER) + 1
    ax.axvspan(0, LASTS, color="#eeeeee")
    for k, shade, line in ((0, "0.7", ":"), (10, "0.5", "--"), (16, answers.CLOSED, "-")):
        if f"ahead-{k}" in done:
            ax.plot(time, done[f"ahead-{k}"]["path"], line, color=shade, label=f"scripted, cools {k} ticks ahead")
    for i, life in enumerate(answers.column(done, "seed-")):
        ax.plot(time, life["path"], color=answers.OURS, lw=0.8, label="f/J, one line per seed" if i == 0 else None)
    ax.axhline(DEADLY, color=answers.THEIRS, ls="--", label="dies")
    ax.axvline(-LEAD, color="0.6", ls=":")
    ax.set_ylim(top=DEADLY + 2)  # room for the legend
    answers.finish(ax, "ticks since the load began (light at -20)", "temperature")


def case() -> Case:
    """Return the case."""
    return Case(
        "heat",
        "cooling ahead of a heat load (Yoshida, Sprekeler and Gutkin 2025)",
        _parts,
        _rows,
        figure=_figure,
    )
