"""Food carried to a partner, under four conditions of empathy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.certificate.empathic import Empathic, case_of, ppo_settings, scripted_lives
from ecology.scenarios.grid_rooms import CAP, LOSS, REWARD
from ecology.state import Ints

ORDER = 9
ALONE = 1.0 / LOSS + 0.5  # mean of floor((1 + e) / LOSS) + 1 over e uniform about 0: a partner not fed


def feeds_itself(env: Ecology) -> Ints:
    """Return the policy that keeps the agent's own energy near the set point, not its partner's (grid_rooms)."""
    group = env.groups["possessor"]
    x, carried = env.state_view.internal[group.slots].T
    rest_, left, get, eat = (group.actions.index(name) for name in ("rest", "left", "get", "eat"))
    cell = np.floor(env.state_view.position[group.slots, 0])
    return np.where(carried > 0, np.where(x < 1, eat, rest_), np.where(cell > 0, left, get))


def _scripted_parts() -> list[Part]:
    """Return the parts whose closed form is known: lives in 20 worlds under a scripted policy."""
    return [Part("scripted-alone", {"lives": 20 * 10}, 8.0, lambda: scripted_lives(SET_UP, feeds_itself, 20, 10)[0])]


def _scripted_rows(done: Mapping[str, Any]) -> list[Row]:
    """Return the results of the scripted policies."""
    if "scripted-alone" not in done:
        return []
    return [Row("ticks lived, feeding itself alone, 200 lives", done["scripted-alone"], closed=ALONE)]


SET_UP = Empathic(
    scripted=_scripted_parts,
    scripted_rows=_scripted_rows,
    name="grid_rooms",
    cap=CAP,
    scale=REWARD,
    ticks=12_000,
    seeds=4,
    seconds=60.0,
    steps=300_000,
    worlds=16,
    ppo_seeds=3,
    ppo_seconds=60.0,
    settings=ppo_settings(100, 32),
    closed={"none": ALONE, "cognitive": ALONE, "affective": CAP, "full": CAP},
)


def case() -> Case:
    """Return the case."""
    return case_of(SET_UP, "food carried to a partner, four conditions (Man and Yoshida 2024)")
