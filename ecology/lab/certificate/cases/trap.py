"""A trapped partner, under four conditions of empathy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ecology import Ecology
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.certificate.empathic import Empathic, case_of, ppo_settings, scripted_lives
from ecology.lab.certificate.episodes import Policy
from ecology.scenarios import trap
from ecology.scenarios.trap import CAP, REWARD
from ecology.state import Ints

ORDER = 10


def rests(env: Ecology) -> Ints:
    """Return rest, always (trap)."""
    group = env.groups["agent"]
    return np.full(group.size, group.actions.index("rest"))


def forages(env: Ecology) -> Ints:
    """Return what fetches food, keeps it in hand and eats it when it is due, each for itself (trap)."""
    return _trap(env, helps_=False)


def rescues(env: Ecology) -> Ints:
    """Return the same, but an agent that holds food brings it to a partner that is trapped and has none (trap)."""
    return _trap(env, helps_=True)


def _trap(env: Ecology, *, helps_: bool) -> Ints:
    state, names = env.state_view, env.groups["agent"].actions
    x, carried = state.internal.T
    eat, get, pass_ = (names.index(name) for name in ("eat", "consume_food", "pass"))
    calls = helps_ & (x[::-1] <= trap.TRAPPED) & (carried[::-1] == 0) & (x > trap.TRAPPED) & (carried > 0)
    gap = np.where((carried > 0)[:, None], state.position[::-1], state.resource_position[0]) - state.position
    ways = np.array([list(trap.WAYS).index(name) for name in ("left", "right", "down", "up")])
    axis = np.abs(gap).argmax(axis=1)
    toward = names.index(next(iter(trap.WAYS))) + ways[2 * axis + (gap[np.arange(2), axis] > 0)]
    far = np.hypot(*gap.T)
    fetches = np.where(far < trap.REACH, get, toward)
    keeps = np.where(x <= 1 - trap.MEAL, eat, names.index("rest"))
    return np.where(calls, np.where(far < trap.HAND, pass_, toward), np.where(carried > 0, keeps, fetches))


def _scripted_parts() -> list[Part]:
    """Return lives of three scripted policies."""

    def trapped(policy: Policy) -> Callable[[], list[float]]:
        return lambda: scripted_lives(SET_UP, policy, 1, 10)[0]

    parameters = {"lives": 10, "cap": CAP}
    return [
        Part(f"scripted-{policy.__name__}", parameters, 25.0, trapped(policy)) for policy in (rests, forages, rescues)
    ]


def _scripted_rows(done: Mapping[str, Any]) -> list[Row]:
    """Return the results of the scripted policies."""
    found = []
    for policy, what in (
        ("rests", "doing nothing"),
        ("forages", "foraging, each for itself"),
        ("rescues", "foraging and feeding who is trapped"),
    ):
        if f"scripted-{policy}" in done:
            lives = done[f"scripted-{policy}"]
            found.append(Row(f"ticks lived, {what}, {len(lives)} lives", lives, verdict="scripted"))
    return found


SET_UP = Empathic(
    scripted=_scripted_parts,
    scripted_rows=_scripted_rows,
    name="trap",
    cap=CAP,
    scale=REWARD,
    ticks=20_000,
    seeds=4,
    seconds=120.0,
    steps=100_000,
    worlds=1,
    ppo_seeds=1,
    ppo_seconds=80.0,
    settings=ppo_settings(1024, 64, batch_size=1024, ent_coef=0.0, vf_coef=0.3),
    closed={},
)


def case() -> Case:
    """Return the case."""
    return case_of(SET_UP, "a trapped partner, four conditions (Man and Yoshida 2024)")
