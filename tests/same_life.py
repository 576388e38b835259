"""Print a digest of whole lives, learners included: the same on every processor. `python same_life.py [LIFE ...]`."""

import hashlib
import sys

import numpy as np

import ecology
from ecology import agents, scenarios
from ecology.agents import loop

LIVES = {  # scenario, its settings, learner and ticks
    "paper": ("paper", {}, "hjb", 1_500),
    "commons": ("commons", {"n": 300, "walls": True}, "lean", 60),
    "predator_prey": ("predator_prey", {}, "hjb", 150),
    "seasons": ("seasons", {}, "algorithm1", 300),
    "well_mixed": ("well_mixed", {}, "random", 300),
}


def digest(life: str) -> str:
    """Return a digest of a life: every array of the world, and what its learners have become."""
    name, settings, learner, ticks = LIVES[life]
    env = ecology.parallel_env(scenarios.load(name, **settings))
    learners = {}
    for i, group in enumerate(env.groups.values()):
        own = dict(scenarios.load(name).species[i].learner_settings) if learner == "hjb" else {}
        learners[group.name] = agents.make(learner, group, np.random.SeedSequence([7, i]), own)
    loop.run(env, learners, env.reset_arrays(7), ticks)
    parts = dict(env.snapshot()[0])
    for group, each in learners.items():
        parts |= {f"{group}.{key}": values for key, values in each.state()[0].items()}
    total = hashlib.sha256()
    for key in sorted(parts):
        total.update(key.encode())
        total.update(np.ascontiguousarray(parts[key]).tobytes())
    return total.hexdigest()[:16]


if __name__ == "__main__":
    for each in sys.argv[1:] or LIVES:
        print(each, digest(each), flush=True)
