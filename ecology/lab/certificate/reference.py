"""The digest of a life, and of the reference life that published results name.

A seed gives the same run on every x86-64 processor. Where the digest of the reference life differs from
the published one, this machine computes with other arithmetic or other code, and results differ in detail.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np

import ecology
from ecology import agents, scenarios
from ecology.agents import loop

SCENARIO, LEARNER, TICKS, SEED = "paper", "hjb", 1_500, 7
PUBLISHED = "d3ad8bb22260042a"


def digest(scenario: str, settings: Mapping[str, Any], learner: str, ticks: int, seed: int = SEED) -> str:
    """Return a digest of a life: every array of the world after `ticks`, and what its learners have become.

    `settings` are those of the scenario; an `hjb` learner has the settings that its species names.
    """
    built = scenarios.load(scenario, **settings)
    env = ecology.parallel_env(built)
    learners = {}
    for i, group in enumerate(env.groups.values()):
        own = dict(built.species[i].learner_settings) if learner == "hjb" else {}
        learners[group.name] = agents.make(learner, group, np.random.SeedSequence([seed, i]), own)
    loop.run(env, learners, env.reset_arrays(seed), ticks)
    parts = dict(env.snapshot()[0])
    for name, each in learners.items():
        parts |= {f"{name}.{key}": values for key, values in each.state()[0].items()}
    total = hashlib.sha256()
    for key in sorted(parts):
        total.update(key.encode())
        total.update(np.ascontiguousarray(parts[key]).tobytes())
    return total.hexdigest()[:16]


@functools.cache
def here() -> str:
    """Return the digest of the reference life on this machine; it takes some seconds."""
    return digest(SCENARIO, {}, LEARNER, TICKS)


def line() -> str:
    """Return in words whether this machine gives the reference life."""
    what = f"Reference life ({SCENARIO}, {LEARNER}, seed {SEED}, {TICKS:,} ticks): {here()}"
    if here() == PUBLISHED:
        return f"{what}, as published."
    return f"{what}, published {PUBLISHED}. This machine computes other runs than the published ones."
