"""Food eaten or passed, under four conditions of empathy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.certificate.empathic import Empathic, case_of, ppo_settings, scripted_lives
from ecology.scenarios.food_share import CAP
from ecology.state import Ints

ORDER = 8


def eats(env: Ecology) -> Ints:
    """Return eat, always (food_share)."""
    return np.zeros(env.groups["possessor"].size, np.int64)


def helps(env: Ecology) -> Ints:
    """Return pass exactly when one's own energy is high and the partner's is low (food_share)."""
    own, partner = np.split(env.state_view.internal[:, 0], 2)
    return ((own > 0) & (partner == 0)).astype(np.int64)


def _scripted_parts() -> list[Part]:
    """Return the parts whose closed form is known: lives in 20 worlds under a scripted policy."""
    return [
        Part("scripted-eats", {"lives": 20 * 50}, 4.0, lambda: scripted_lives(SET_UP, eats, 20, 50)[0]),
        Part("scripted-passes", {"lives": 20, "cap": CAP}, 4.0, lambda: scripted_lives(SET_UP, helps, 20, 1)),
    ]


def _scripted_rows(done: Mapping[str, Any]) -> list[Row]:
    """Return the results of the scripted policies."""
    found = []
    if "scripted-eats" in done:
        found.append(Row("ticks lived, always eating, 1,000 lives", done["scripted-eats"], closed=14.5))
    if "scripted-passes" in done:
        lengths, rates = done["scripted-passes"]
        policy = "passing exactly when high and the partner low, 20 lives"
        found.append(Row(f"ticks lived, {policy}", lengths, closed=float(CAP), tolerance=0.0))
        found.append(Row(f"share of passes, {policy}", rates, closed=1 / 11))
    return found


SET_UP = Empathic(
    scripted=_scripted_parts,
    scripted_rows=_scripted_rows,
    name="food_share",
    cap=CAP,
    scale=1.0,
    ticks=2_000,
    seeds=10,
    seconds=25.0,
    steps=25_000,
    worlds=16,
    ppo_seeds=3,
    ppo_seconds=15.0,
    settings=ppo_settings(32, 16),
    closed={"none": 14.5, "cognitive": 14.5, "affective": CAP, "full": CAP},
    theirs={"none": (25, 7, 20), "cognitive": (31, 37, 20), "affective": (1987, 55, 20), "full": (2000, 0, 20)},
)


def case() -> Case:
    """Return the case."""
    return case_of(SET_UP, "food eaten or passed, four conditions of empathy (Man and Yoshida 2024)")
