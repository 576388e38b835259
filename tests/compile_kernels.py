"""Compile what the tests use, once, before workers start: `python compile_kernels.py worlds|learners`.

Numba keeps what it has compiled on the disk. Without this, every process that a test starts would compile the same
functions at the same time.
"""

import sys

import numpy as np

import ecology
from ecology import agents, scenarios
from ecology.agents import loop

LIVES = {
    "worlds": [(name, "random", 3) for name in scenarios.names()],
    "learners": [("paper", "hjb", 200), ("paper", "algorithm1", 60), ("commons", "lean", 200)],
}


def live(name: str, learner: str, ticks: int) -> None:
    """Run a few ticks of a scenario."""
    env = ecology.parallel_env(scenarios.load(name))
    seed = np.random.SeedSequence(0)
    learners = {group.name: agents.make(learner, group, seed, {}) for group in env.groups.values()}
    loop.run(env, learners, env.reset_arrays(0), ticks)


if __name__ == "__main__":
    for life in LIVES[sys.argv[1]]:
        live(*life)
