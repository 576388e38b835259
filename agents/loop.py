"""The only loop: a world, its learners and those who watch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from agents.base import Learner, Transition
from ecology import Ecology, EcologyError, Group, Tick
from ecology.observers.base import Observer


def run(
    env: Ecology,
    learners: Mapping[str, Learner],
    tick: Tick,
    ticks: int,
    observers: Iterable[Observer] = (),
    clock: Callable[[], float] = float,
) -> Tick:
    """Live for `ticks` ticks from `tick` (as `env.reset_arrays` returned it) and return the last one.

    What acting and learning take by `clock`, seconds, is added to `learner.seconds`; by default it stands still.
    """
    observers = tuple(observers)
    groups = [(group, learners[group.name]) for group in env.groups.values()]
    actions = np.zeros(env.size, np.int64)
    for _ in range(ticks):
        before = tick
        for group, learner in groups:
            began = clock()
            chosen = learner.act(before.observations[group.name], before.masks[group.name])
            learner.seconds += clock() - began
            try:
                actions[group.slots] = chosen
            except (TypeError, ValueError) as error:
                raise EcologyError(
                    f"the learner of {group.name!r}, {type(learner).__name__}, must return {group.size} actions, an "
                    f"index for every slot, got {chosen!r}."
                ) from error
        tick = env.step_arrays(actions)
        alive = tick.alive & ~tick.born
        changed = bool((tick.died | tick.born).any())
        for group, learner in groups:
            if learner.learning:
                began = clock()
                learner.learn(
                    Transition(
                        observations=before.observations[group.name],
                        masks=before.masks[group.name],
                        actions=tick.action[group.slots],
                        next_observations=_outcome(group, before, tick) if changed else tick.observations[group.name],
                        next_masks=tick.masks[group.name],
                        alive=alive[group.slots],
                        died=tick.died[group.slots],
                    )
                )
                learner.seconds += clock() - began
            if changed:
                _pass_on(group, learner, tick)
        if observers:
            state = env.state_view
            for observer in observers:
                observer.watch(state, tick, learners)
    return tick


def _outcome(group: Group, before: Tick, tick: Tick) -> np.ndarray:
    """Return the observations after a tick (n, D); an agent that died keeps all but its needs as it last sensed them.

    The dead sense nothing, so `tick` says of their surroundings that nothing is in sight.
    """
    after, died = tick.observations[group.name], tick.died[group.slots]
    sensed = np.array(group.layout.kinds) != "deviation"
    return np.where(died[:, None] & sensed, before.observations[group.name], after)


def _pass_on(group: Group, learner: Learner, tick: Tick) -> None:
    """Tell a learner who of its species died and who was born in `tick`."""
    died, born = np.flatnonzero(tick.died[group.slots]), np.flatnonzero(tick.born[group.slots])
    if died.size:
        learner.died(died)
    if born.size:
        parent = tick.parent[group.slots][born]
        own = (parent >= group.slots.start) & (parent < group.slots.stop)
        learner.born(born, np.where(own, parent - group.slots.start, -1))
