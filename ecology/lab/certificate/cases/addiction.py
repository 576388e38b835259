"""A3: intake escalates with six hours of access a day, not with one."""

# ruff: noqa: ARG001  (all policies and looks are of one form)

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.addiction import DAY, DOSE, ENTERS, HOUR, LEAVES, MOST, RECOVERY, RISE, START
from ecology.state import Ints

ORDER = 31
DAYS, ACQUISITION, HURRY = 12, 12, 30.0  # days of access, days of one hour before for learners, haste of the night
WHOLE = 1 + LEAVES / ENTERS  # in brain and buffer, of what is in the brain, where it is held level
COARSE, FINE = 4.0, 2.0  # trials in a tick: scripted, learned
SWEEP = (1.0, 2.0, 2.75, 3.5, 4.5, 6.0)  # hours of access a day


def closed_form(hours: float, days: int = DAYS) -> tuple[float, float]:
    """Return h* after days of access, and the infusions of the last session, from the recurrence."""
    level, taken = START, 0.0
    for _ in range(days):
        taken = level * (LEAVES * HOUR * hours + WHOLE) / DOSE  # it fills the brain once, then makes up for the loss
        level = min(max(level + RISE * DOSE * taken - RECOVERY * DAY, START), MOST)
    return level, taken


def most_without() -> float:
    """Return the hours of access a day above which h* rises from its initial value."""
    return (RECOVERY * DAY / (RISE * START) - WHOLE) / (LEAVES * HOUR)


def _sessions(rows: list[Any], hours: float, dt: float, acquisition: int = 1) -> dict[str, Any]:
    """Return infusions by session and h* after each night, from rows (h*, pressed) of every tick.

    Of the sessions of `acquisition`, only the last is returned.
    """
    table, first = np.array(rows), 0
    found: dict[str, Any] = {"infusions": [], "set_point": []}
    for open_for, days in ((1.0, acquisition), (hours, DAYS)):
        access = round(HOUR * open_for / dt)
        length = (HOUR * open_for + (DAY - HOUR * open_for) / HURRY) / dt
        for day in range(days):
            at = first + round(day * length)
            found["infusions"].append(float(table[at : at + access, 1].sum()))
            found["set_point"].append(float(table[min(at + round(length), len(table)) - 1, 0]))
        first += round(days * length)
    return {name: values[acquisition - 1 :] for name, values in found.items()}


def _look(env: Ecology, state: Any) -> tuple[float, bool]:
    return float(state.set_point[0, 0]), bool(state.action[0] == 1)


def measure_scripted(hours: float) -> dict[str, Any]:
    """Return the sessions of a body that presses when brain and buffer together lack half a dose."""
    env, tick = answers.begin("addiction", 0, hours=hours, hurry=HURRY, dt=COARSE)

    def policy(env: Ecology, tick: Tick) -> Ints:
        now: Any = env.state_view
        short = now.set_point[0, 0] * WHOLE - now.internal[0].sum() >= DOSE / 2
        return answers.act(env, user="press" if short and tick.masks["user"][0, 1] else "rest")

    rows = answers.play(env, tick, env.scenario.ticks, policy, lambda e, _: _look(e, e.state_view))
    return _sessions(rows, hours, COARSE)


def measure_learner(hours: float, seed: int) -> dict[str, Any]:
    """Return the sessions of a learner."""
    words: dict[str, Any] = {"hours": hours, "hurry": HURRY, "dt": FINE, "acquisition": ACQUISITION}
    ticks = answers.begin("addiction", 0, **words)[0].scenario.ticks
    return _sessions(answers.learn("addiction", seed, ticks, _look, **words)[3], hours, FINE, ACQUISITION)


def rises_from(lives: Mapping[float, Any]) -> float:
    """Return the access above which h* rises: the point of no change on a line through the runs that escalated."""
    gains = {hours: life["set_point"][-1] - life["set_point"][0] for hours, life in lives.items()}
    some = sorted(hours for hours, gain in gains.items() if gain > 2.0)[:2]
    first = [lives[h]["set_point"][2] - lives[h]["set_point"][1] for h in some]
    slope, intercept = answers.fit_line(some, first)
    return -intercept / slope


def _parts() -> list[Part]:
    parameters = answers.parameters("addiction")
    found = [
        Part(f"scripted-{hours:g}", parameters, 10.0, functools.partial(measure_scripted, hours)) for hours in SWEEP
    ]
    for hours in (1.0, 6.0):
        words = answers.parameters("addiction", hours=hours)
        found += [
            Part(f"learned-{hours:g}-seed-{s}", words, 20.0, functools.partial(measure_learner, hours, s))
            for s in range(answers.SEEDS)
        ]
    return found


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    for hours in (1.0, 6.0):
        life = done.get(f"scripted-{hours:g}")
        level, taken = closed_form(hours)
        if life is not None:
            theirs = (114.0, None, None) if hours == 6 else (14.0, None, None)
            what = f"infusions in the last of 12 sessions of {hours:g} h"
            found.append(Row(what, [life["infusions"][-1]], theirs=theirs, closed=taken, tolerance=0.05 * taken))
            what = f"set point after 12 days of {hours:g} h"
            found.append(Row(what, [life["set_point"][-1]], closed=level, tolerance=0.03 * level))
    sweep = {hours: done[f"scripted-{hours:g}"] for hours in SWEEP if f"scripted-{hours:g}" in done}
    if len(sweep) == len(SWEEP):
        what = "hours of access a day from which intake escalates, from the sweep"
        found.append(Row(what, [rises_from(sweep)], theirs=(2.9, None, None), closed=most_without(), tolerance=0.15))
    for hours in (1.0, 6.0):
        lives = answers.column(done, f"learned-{hours:g}-")
        if lives:
            level, _ = closed_form(hours)
            last = [life["infusions"][-1] / max(life["infusions"][1], 1.0) for life in lives]
            first = closed_ratio(hours)
            found.append(Row(f"f/J, infusions in the last session of {hours:g} h over the first", last, closed=first))
            found.append(
                Row(f"f/J, set point after 12 days of {hours:g} h", [life["set_point"][-1] for life in lives],
                    closed=level)
            )  # fmt: skip
    return found


def closed_ratio(hours: float) -> float:
    """Return the infusions of the last session over those of the first, from the recurrence."""
    return closed_form(hours)[1] / closed_form(hours, 1)[1]


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    left, right = figure.subplots(1, 2)
    for hours, look in ((6.0, answers.LEARNED), (1.0, answers.PUBLISHED)):
        taken = [closed_form(hours, day)[1] for day in range(1, DAYS + 1)]
        left.plot(range(1, DAYS + 1), taken, color="0.7", lw=3)
        life = done.get(f"scripted-{hours:g}")
        if life is not None:
            left.plot(
                range(1, DAYS + 1), life["infusions"][1:], color=look.colour, linestyle=look.line,
                label=f"scripted, {hours:g} h a day",
            )  # fmt: skip
        lives = answers.column(done, f"learned-{hours:g}-")
        if lives:
            samples = [[life["infusions"][1 + day] for life in lives] for day in range(DAYS)]
            answers.band(left, np.arange(1, DAYS + 1), samples, f"f/J, {hours:g} h a day", look)
    answers.finish(left, "day (grey: the recurrence)", "infusions in a session")
    sweep = {hours: done[f"scripted-{hours:g}"] for hours in SWEEP if f"scripted-{hours:g}" in done}
    right.axvline(most_without(), color="0.6", ls=":", label="closed form, 2.9 h")
    right.plot(list(sweep), [life["set_point"][-1] for life in sweep.values()], "o-", color=answers.OURS,
               label="scripted")  # fmt: skip
    answers.finish(right, "hours of access a day", "set point after 12 days")


def case() -> Case:
    """Return the case."""
    return Case(
        "addiction",
        "escalation of intake with long access (Keramati et al. 2017)",
        _parts,
        _rows,
        figure=_figure,
    )
