"""The only loop: a world, its learners and those who watch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from agents.base import Learner, Transition
from ecology import Ecology, Tick
from ecology.observers.base import Observer


def run(
    env: Ecology,
    learners: Mapping[str, Learner],
    tick: Tick,
    ticks: int,
    observers: Iterable[Observer] = (),
) -> Tick:
    """Live for `ticks` ticks from `tick` (as `env.reset_arrays` returned it) and return the last one."""
    observers = tuple(observers)
    groups = [(group, learners[group.name]) for group in env.groups.values()]
    actions = np.zeros(env.size, np.int64)
    for _ in range(ticks):
        before = tick
        for group, learner in groups:
            actions[group.slots] = learner.act(before.observations[group.name], before.masks[group.name])
        tick = env.step_arrays(actions)
        for group, learner in groups:
            if learner.learning:
                learner.learn(
                    Transition(
                        observations=before.observations[group.name],
                        masks=before.masks[group.name],
                        actions=tick.action[group.slots],
                        next_observations=tick.observations[group.name],
                        next_masks=tick.masks[group.name],
                        alive=tick.alive[group.slots],
                    )
                )
        if observers:
            state = env.state_view
            for observer in observers:
                observer.watch(state, tick, learners)
    return tick
