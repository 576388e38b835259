"""A1: shivering at the cue, an hour before ethanol cools the body, and overheating when it does not come."""

# ruff: noqa: ARG001, ARG005  (all policies and looks are of one form)

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Tick
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.anticipation import BLOCKS, DAY, ETHANOL, FAST, LATER, SLOW, WANES, WARMTH
from ecology.state import Floats, Ints

ORDER = 29
AT = (30, 60, 90, 120)  # minutes after the ethanol
DT, GAMMA = 10.0, 0.995
# block of three days -> change of temperature at AT: rats, and the published learner (500 animals)
RATS = {
    "block 1": (-1.17, -1.44, -1.33, -1.27),
    "block 4": (-0.62, -0.85, -0.74, -0.64),
    "block 8": (-0.37, -0.45, -0.37, -0.20),
    "extinction": (0.29, 0.44, 0.55, 0.62),
    "reacquisition": (-0.69, -0.83, -0.82, -0.56),
}
PUBLISHED = {
    "block 1": (-1.10, -1.32, -1.27, -1.15),
    "block 4": (-0.84, -1.02, -0.94, -0.81),
    "block 8": (-0.51, -0.63, -0.52, -0.37),
    "extinction": (0.72, 0.83, 0.90, 0.94),
    "reacquisition": (-0.86, -1.04, -0.97, -0.84),
}
# first day of each block; the days of the habituation come first
DAYS = {"block 1": 24, "block 4": 33, "block 8": 45, "extinction": 48, "reacquisition": 60}


def closed_form(minute: float, shivers: bool, ethanol: bool) -> float:
    """Return h at a minute after the light, from the kinetics."""
    found, since = 0.0, minute - LATER
    if shivers:
        found += WARMTH * minute * float(np.exp(-WANES * minute))
    if ethanol and since >= 0:
        found += ETHANOL * float(np.exp(-FAST * since) - np.exp(-SLOW * since))
    return found


def threshold(cold: Floats, warmed: Floats, step: float) -> float:
    """Return the discount per minute above which shivering pays, from h without and with it, both (n,)."""
    low, high = 0.9, 0.999
    time = step * np.arange(len(cold))
    for _ in range(60):
        gamma = (low + high) / 2
        pays = float((gamma**time * (np.abs(cold) - np.abs(warmed))).sum()) > 0
        low, high = (low, gamma) if pays else (gamma, high)
    return high


def day(shivers: bool, ethanol: bool) -> list[float]:
    """Return h every ten minutes of a day of a scripted rat, from the light on."""
    env, tick = answers.begin("anticipation", 0, dt=DT)
    first = 24 * round(DAY / DT)  # the first day of the acquisition
    away = 0 if not ethanol else first

    def policy(env: Ecology, tick: Tick) -> Ints:
        now = env.state_view.tick
        return answers.act(env, rat="shiver" if shivers and now == away else "rest")

    ticks = away + round(DAY / DT) - 1
    rows = answers.play(env, tick, ticks, policy, lambda e, _: float(e.state_view.internal[0, 0]))
    return [0.0, *rows[away:]]


def measure_learner(seed: int) -> dict[str, Any]:
    """Return the change of temperature of a learner at AT in every block, and how often it shivered in each."""
    look = lambda e, s: (float(s.internal[0, 0]), bool(s.action[0] == 1))  # noqa: E731
    days = sum(trials for _, trials, _ in BLOCKS)
    _, _, _, rows = answers.learn("anticipation", seed, round(days * DAY / DT) - 1, look, dt=DT, gamma=GAMMA)
    h = np.array([0.0] + [row[0] for row in rows]).reshape(days, -1)  # every ten minutes from the light on
    did = np.array([row[1] for row in rows] + [0]).reshape(days, -1)[:, 0]
    at = [round((LATER + minute) / DT) for minute in AT]
    return {
        **{name: h[first : first + 3][:, at].mean(axis=0).tolist() for name, first in DAYS.items()},
        "shivers": did.tolist(),
        "first of extinction": h[DAYS["extinction"], at].tolist(),
    }


def _parts() -> list[Part]:
    parameters = answers.parameters("anticipation", dt=DT)
    found = [
        Part(f"scripted-{shivers:d}-{ethanol:d}", parameters, 2.0, functools.partial(day, bool(shivers), bool(ethanol)))
        for shivers, ethanol in ((0, 1), (1, 1), (1, 0))
    ]
    parameters = answers.parameters("anticipation", dt=DT, gamma=GAMMA)
    return found + [
        Part(f"seed-{s}", parameters, 20.0, functools.partial(measure_learner, s)) for s in range(answers.SEEDS)
    ]


def _rows(done: Mapping[str, Any]) -> list[Row]:
    found = []
    for (shivers, ethanol), what in (
        ((0, 1), "ethanol alone"), ((1, 1), "shivering and ethanol"), ((1, 0), "shivering alone: it overheats"),
    ):  # fmt: skip
        path = done.get(f"scripted-{shivers}-{ethanol}")
        if path is None:
            continue
        for minute in AT:
            h = path[round((LATER + minute) / DT)]
            answer = closed_form(LATER + minute, bool(shivers), bool(ethanol))
            found.append(Row(f"{what}, h after {minute} min", [h], closed=answer, tolerance=0.01))
    if "scripted-0-1" in done and "scripted-1-1" in done:
        ours = threshold(np.array(done["scripted-0-1"]), np.array(done["scripted-1-1"]), DT)
        minutes = np.arange(0, DAY, DT)
        cold, warmed = [np.array([closed_form(t, shivers, True) for t in minutes]) for shivers in (False, True)]
        what = "discount per minute above which shivering at the light pays"
        found.append(Row(what, [ours], closed=threshold(cold, warmed, DT), tolerance=1e-3))
    lives = answers.column(done, "seed-")
    for name in DAYS if lives else ():
        for i, minute in enumerate(AT):
            mine = [life[name][i] for life in lives]
            what = f"f/J, {name}, h after {minute} min (rats {RATS[name][i]:+.2f})"
            found.append(Row(what, mine, theirs=(PUBLISHED[name][i], None, None)))
    if lives:
        overheats = [life["first of extinction"][1] for life in lives]
        row = Row("", overheats)
        low, _ = row.bounds()
        found.append(
            Row("f/J, first day without ethanol, h after 60 min", overheats,
                verdict="overheats" if low > 0 else "does not overheat in all seeds")
        )  # fmt: skip
    return found


def _figure(done: Mapping[str, Any], figure: Any) -> None:
    lives = answers.column(done, "seed-")
    axes = figure.subplots(1, len(DAYS), sharey=True)
    for ax, name in zip(axes, DAYS, strict=True):
        ax.axhline(0, color="0.85")
        ax.plot(AT, RATS[name], "s:", color=answers.SCRIPTED.colour, markersize=4, label="rats")
        ax.plot(AT, PUBLISHED[name], **answers.PUBLISHED.words, markersize=4, label="published learner")
        if lives:
            answers.band(ax, AT, [[life[name][i] for life in lives] for i in range(len(AT))], "f/J")
        answers.finish(ax, "min", "change of temperature" if ax is axes[0] else "", name)
        if ax is not axes[0] and ax.get_legend():
            ax.get_legend().remove()


def case() -> Case:
    """Return the case."""
    return Case(
        "anticipation",
        "tolerance to ethanol-induced cooling (Keramati and Gutkin 2014; rats: Mansfield and Cunningham 1980)",
        _parts,
        _rows,
        figure=_figure,
    )
