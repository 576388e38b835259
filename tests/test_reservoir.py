"""The replay memory that is a sample of a whole life."""

from __future__ import annotations

import numpy as np

import ecology
from ecology import agents, scenarios
from ecology.agents import loop

N, CAPACITY, RECENT, LIVED = 400, 60, 20, 600


def test_a_full_memory_holds_the_recent_decisions_and_a_sample_of_all_before() -> None:
    """Each of the older decisions is kept with the same probability, whatever its age (algorithm R of Vitter 1985)."""
    env = ecology.parallel_env(scenarios.load("commons", n=N))
    words = {"memory": CAPACITY, "recent": RECENT, "reservoir": True}
    mind = agents.make("lean", env.groups["agent"], np.random.SeedSequence(0), words)
    memory, rng, slots = mind.memory, np.random.default_rng(2), np.arange(N)
    state = np.zeros((N, mind.components), np.float32)
    open_ = np.ones((N, mind.count), bool)
    for decision in range(LIVED):
        memory.spare(slots, rng.random(N), RECENT)
        memory.add(slots, state, np.zeros(N, int), state, np.full(N, decision, np.float32), open_)
    kept = np.asarray(memory.duration).astype(int)  # which decisions, (N, CAPACITY)
    last = (LIVED - 1 - np.arange(RECENT)) % CAPACITY
    np.testing.assert_array_equal(kept[:, last], np.tile(LIVED - 1 - np.arange(RECENT), (N, 1)))
    old = kept[kept < LIVED - RECENT].reshape(N, CAPACITY - RECENT)
    assert all(len(set(row)) == CAPACITY - RECENT for row in old.tolist())
    share = np.bincount(old.ravel() * 5 // (LIVED - RECENT), minlength=5) / old.size  # by fifths of the life
    np.testing.assert_allclose(share, 0.2, atol=0.02)  # 16,000 kept: 6 standard errors


def test_a_learner_with_a_reservoir_resumes_bit_for_bit() -> None:
    """What survives is drawn from the learner's own random numbers, which a checkpoint holds."""
    env = ecology.parallel_env(scenarios.load("commons", n=4))
    ends = []
    for _ in range(2):
        minds = [
            agents.make(
                "lean", env.groups["agent"], np.random.SeedSequence(1), {"memory": 40, "recent": 10, "reservoir": True}
            )
            for _ in range(2)
        ]
        tick = loop.run(env, {"agent": minds[0]}, env.reset_arrays(3), 150)
        minds[1].restore(*minds[0].state())
        loop.run(env, {"agent": minds[len(ends)]}, tick, 150)
        ends.append(minds[len(ends)].state())
    assert ends[0][1] == ends[1][1]
    for name, array in ends[0][0].items():
        np.testing.assert_array_equal(array, ends[1][0][name], err_msg=name)
