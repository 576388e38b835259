"""The meadow: what a bite does, what the grass carries, and that its learners live, bear and inherit."""

from __future__ import annotations

import numpy as np
import pytest

import agents
import ecology
import scenarios
from agents import loop
from ecology.observers.base import Observer
from ecology.state import CAUSES


def meadow(**changes):
    """Return the world with `changes` to its settings."""
    return ecology.parallel_env(scenarios.load("predator_prey", **changes))


def face_to_face(**changes):
    """Return a world in which one predator stands beside one prey and every bite succeeds, and its first tick."""
    env = meadow(prey=1, predators=1, prey_mortality=0.0, predator_mortality=0.0, chance=1.0, **changes)
    env.reset_arrays(seed=0)
    position = np.full((env.size, 2), 6.5)
    position[env.groups["predator"].slots] += [0.3, 0.0]
    return env, env.put(position=position)


def live(env, learner, ticks, seed=0, also=lambda tick, minds: None):
    """Return the learners by species and what there was in each tick: prey, predators and grass eaten, (ticks, 3)."""
    minds = {}
    for i, (name, group) in enumerate(env.groups.items()):
        settings = env.scenario.species[i].learner_settings if learner == "hjb" else {}
        minds[name] = agents.make(learner, group, np.random.SeedSequence([seed, i]), settings)
    found = []

    class Count(Observer):
        def watch(self, state, tick, minds):
            numbers = [np.count_nonzero(tick.alive[group.slots]) for group in env.groups.values()]
            found.append([*numbers, state.eaten.sum()])
            also(tick, minds)

    loop.run(env, minds, env.reset_arrays(seed), ticks, (Count(),))
    return minds, np.array(found)


def bites(env, tick, times):
    """Make the predator bite as soon as it can, `times` times, while the prey rests; return the health left."""
    act = {name: group.actions.index for name, group in env.groups.items()}
    prey = env.groups["prey"].slots.start
    left = []
    while len(left) < times:
        wanted = np.full(env.size, act["prey"]("rest"))
        wanted[env.groups["predator"].slots] = act["predator"]("bite_prey")
        tick = env.step_arrays(np.where(tick.alive, wanted, 0))
        if env.state_view.bit.max() >= 0:
            left.append(env.state_view.internal[prey, 1])
    return left, tick


def test_a_bite_hurts_and_feeds():
    """One bite takes `wound` of health, raises the drive of the bitten, and brings `gain` of energy to the biter."""
    env, tick = face_to_face(wound=0.4, gain=0.3, predator_decay=0.001)
    prey, predator = (group.slots.start for group in env.groups.values())
    before = tick.drive[prey], env.state_view.internal[predator, 0]
    (health,), tick = bites(env, tick, 1)
    assert health == pytest.approx(0.6, abs=1e-9)
    assert tick.drive[prey] > before[0] + 0.1
    assert env.state_view.internal[predator, 0] - before[1] == pytest.approx(0.3 - 0.001, abs=1e-9)
    assert tick.alive[prey]


def test_the_wounded_die_of_the_next_bites_and_heal_without():
    """Of wounds of 0.4, dealt every `handling` time, the third kills; left alone a wound heals."""
    env, tick = face_to_face(wound=0.4, gain=0.0, handling=10.0)
    prey = env.groups["prey"].slots.start
    _, tick = bites(env, tick, 2)
    assert tick.alive[prey]
    _, tick = bites(env, tick, 1)
    assert not tick.alive[prey]
    assert CAUSES[env.state_view.cause[prey]] == "need"
    env, tick = face_to_face(wound=0.4, prey_decay=0.0)
    (health,), tick = bites(env, tick, 1)
    rest = [env.groups[name].actions.index("rest") for name in ("prey", "predator")]
    wanted = np.repeat(rest, [group.size for group in env.groups.values()])
    for _ in range(100):
        tick = env.step_arrays(np.where(tick.alive, wanted, 0))
    assert health < 0.61
    assert env.state_view.internal[prey, 1] == pytest.approx(1 - 0.4 * (1 - 0.002) ** 100, abs=1e-9)


def test_the_grass_carries_as_many_prey_as_it_feeds():
    """Without predators the prey eat at most what grows, and in the end about all of it: patches * regrowth a tick.

    With the slots never full, that is what they live on: numbers times decay stay below it.
    """
    growth, decay = 8 * 0.01, 0.002  # feeds 40
    env = meadow(prey=40, predators=1, predator_mortality=10.0, patches=8, regrowth=0.01, prey_decay=decay)
    _, found = live(env, "random", 3_000)
    numbers, eaten = found[1_000:, 0], (found[-1, 2] - found[1_000, 2]) / (len(found) - 1_000)
    assert numbers.min() > 0
    assert numbers.max() < env.groups["prey"].size
    stored = 8 * 2.0 / len(numbers)  # the most that the patches can hold
    assert 0.5 * growth < eaten < growth + stored
    assert numbers.mean() * decay < eaten + stored


@pytest.mark.parametrize("inherit", [True, False])
def test_learners_live_and_bear(inherit):
    """Learners of both kinds live through their first hundreds of ticks; a child knows what its parent does, or not."""
    env = meadow(inherit=inherit, mutation=0.0)
    alike = []

    def compare(tick, minds):
        for name, group in env.groups.items():
            child = np.flatnonzero(tick.born[group.slots])
            parent = tick.parent[group.slots][child] - group.slots.start
            known = minds[name].f.weights  # a row per agent
            alike.extend((known[child] == known[parent]).all(axis=1).tolist())

    _, found = live(env, "hjb", 350, also=compare)
    assert found[-1, :2].min() > 0
    assert alike, "nobody was born"
    assert set(alike) == {inherit}


def test_every_setting_reaches_the_world():
    """Another value of any setting gives another scenario."""
    plain = scenarios.load("predator_prey")
    words = ("species", "resources", "arena", "ticks")
    for name, value in scenarios.settings("predator_prey").items():
        other = scenarios.load("predator_prey", **{name: not value if isinstance(value, bool) else value * 2 or 0.5})
        assert any(getattr(other, word) != getattr(plain, word) for word in words), name
