"""The set-ups of Man and Yoshida (2024): scripted policies, f/J and PPO under four conditions of empathy."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ecology import scenarios
from ecology.lab.certificate import episodes
from ecology.lab.certificate.case import Case, Part, Row
from ecology.scenarios.shared.conditions import CONDITIONS

WEIGHT = 0.5  # of affective empathy


@dataclass(frozen=True)
class Empathic:
    """How one of the set-ups of Man and Yoshida is learned and measured."""

    name: str
    cap: int
    scale: float  # of the reward
    ticks: int  # of f/J
    seeds: int
    seconds: float  # of one condition, all seeds
    steps: int  # of PPO, all worlds together
    worlds: int
    ppo_seeds: int
    ppo_seconds: float  # of one condition and seed
    settings: Mapping[str, Any]  # of PPO, as in the original
    closed: Mapping[str, float]  # ticks lived under the best policy, where it is known
    scripted: Callable[[], list[Part]]  # lives under policies that do not learn
    scripted_rows: Callable[[Mapping[str, Any]], list[Row]]
    theirs: Mapping[str, tuple[float, float, int]] = field(default_factory=dict)


def ppo_settings(n_steps: int, hidden: int, **changes: Any) -> dict[str, Any]:
    """Return the settings of PPO, as in the original but for `changes`."""
    usual = {
        "n_steps": n_steps,
        "batch_size": 4 * n_steps,
        "n_epochs": 4,
        "learning_rate": 1e-3,
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "clip_range": 0.1,
        "clip_range_vf": 0.1,
        "ent_coef": 0.001,
        "vf_coef": 0.5,
        "policy_kwargs": {"net_arch": [hidden, hidden]},
    }
    return {**usual, **changes}


def has_ppo() -> bool:
    """Return whether Stable-Baselines3 is installed."""
    return importlib.util.find_spec("stable_baselines3") is not None


def parts(e: Empathic) -> list[Part]:
    """Return the scripted policies, f/J and, where the library is, PPO, under each condition."""
    found = e.scripted()
    for condition in CONDITIONS:

        def learn(condition: str = condition) -> list[float]:
            words = {"condition": condition, "weight": WEIGHT}
            return _means(episodes.hjb(e.name, words, e.seeds, e.ticks, e.cap))

        settings = dict(scenarios.load(e.name).species[0].learner_settings)
        words = {"seeds": e.seeds, "ticks": e.ticks, "cap": e.cap, "weight": WEIGHT, **settings}
        found.append(Part(f"hjb-{condition}", words, e.seconds, learn))
    for seed in range(e.ppo_seeds if has_ppo() else 0):
        for condition in CONDITIONS:
            how = {"count": e.worlds, "steps": e.steps, "scale": e.scale, "cap": e.cap}

            def train(condition: str = condition, seed: int = seed, how: dict[str, Any] = how) -> list[float]:
                words = {"condition": condition, "weight": WEIGHT, "perceived": False}
                return _means([episodes.ppo(e.name, words, e.settings, seed=seed, **how)])

            words = {**how, "weight": WEIGHT, **e.settings}
            found.append(Part(f"ppo-{condition}-{seed}", words, e.ppo_seconds, train))
    return found


def _means(lives: Sequence[Sequence[float]]) -> list[float]:
    return [float(np.mean(lengths)) for lengths in lives]


def _against_idle(row: Row, idle: Sequence[float] | None) -> str:
    """Return the verdict on a row without a known answer, against agents that do nothing."""
    interval = row.interval()
    if idle is None or interval is None:
        return "no number to compare with"
    return "better than doing nothing" if interval[0] > np.mean(idle) else "not distinguishable from doing nothing"


def rows(e: Empathic, done: Mapping[str, Any]) -> list[Row]:
    """Return the rows of the scripted policies, of f/J and of PPO."""
    found = e.scripted_rows(done)
    for learner in ("hjb", "ppo"):
        for condition in CONDITIONS:
            keys = [key for key in done if f"{key}-".startswith(f"{learner}-{condition}-")]
            if not keys:
                continue
            ours = [value for key in keys for value in done[key]]
            theirs, closed = e.theirs.get(condition), e.closed.get(condition)
            what = f"ticks lived, {'f/J' if learner == 'hjb' else 'PPO'}, {condition}"
            row = Row(what, ours, theirs=theirs, closed=closed)
            if theirs is None and closed is None:
                row = replace(row, verdict=_against_idle(row, done.get("scripted-rests")))
            found.append(row)
    return found


def case_of(e: Empathic, about: str) -> Case:
    """Return the case of a set-up."""
    notes = [] if has_ppo() else ["Stable-Baselines3 is not installed (extra 'sb3'): PPO is left out."]
    return Case(e.name, about, lambda: parts(e), lambda done: rows(e, done), notes)


def scripted_lives(e: Empathic, policy: episodes.Policy, worlds: int, lives: int) -> tuple[list[float], list[float]]:
    """Return the lengths of `lives` lives in each world under a policy, and the share of its second action."""
    found, taken = episodes.run_scripted(e.name, {"condition": "none"}, policy, worlds, lives, e.cap)
    return [float(n) for lengths in found for n in lengths], (taken[:, 1] / taken.sum(axis=1)).tolist()
