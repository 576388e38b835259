"""The meadow: what a bite does, what the grass carries, and what a newborn knows."""

from __future__ import annotations

import numpy as np
import pytest

import ecology
from ecology import agents, scenarios
from ecology.agents import loop
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
    return env, env.set_state(position=position)


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


class Last(Observer):
    """Keeps the last tick."""

    def watch(self, state, tick, minds):
        """Keep it."""
        self.tick = tick


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
    assert CAUSES[env.state_view.cause[prey]] == "bitten"
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
def test_a_newborn_knows_what_its_parent_knows_or_nothing(inherit):
    """With `inherit` a newborn's deviation function is its parent's, without it that of an agent that never learned.

    Parents learn where nobody is born or dies; then everyone is fit and a birth is certain.
    """
    words = {"prey": 4, "predators": 4, "prey_mortality": 0.0, "predator_mortality": 0.0, "chance": 1e-9}
    words |= {"inherit": inherit, "mutation": 0.0}
    minds, _ = live(meadow(prey_birth=1e-9, predator_birth=1e-9, **words), "hjb", 150)
    env = meadow(prey_birth=1e3, predator_birth=1e3, **words)
    untaught, _ = live(env, "hjb", 0)
    fit = np.where(env.state_view.internal > 0, 1.0, 0.0)
    tick = env.set_state(internal=fit, age=np.full(env.size, 300.0))
    loop.run(env, minds, tick, 1, (seen := Last(),))
    for name, group in env.groups.items():
        children = np.flatnonzero(seen.tick.born[group.slots])
        assert children.size, f"no {name} was born"
        parents = seen.tick.parent[group.slots][children] - group.slots.start
        zeta = seen.tick.observations[name][children]
        for child, parent in zip(children, parents, strict=True):
            knows, taught = minds[name].deviation(child, zeta), minds[name].deviation(parent, zeta)
            nothing = untaught[name].deviation(child, zeta)
            assert not np.array_equal(taught, nothing), "the parent has learned nothing"
            np.testing.assert_array_equal(knows, taught if inherit else nothing)


def test_every_setting_reaches_the_world():
    """Another value of any setting gives another scenario."""
    plain = scenarios.load("predator_prey")
    words = ("species", "resources", "arena", "ticks")
    for name, value in scenarios.settings("predator_prey").items():
        other = scenarios.load("predator_prey", **{name: not value if isinstance(value, bool) else value * 2 or 0.5})
        assert any(getattr(other, word) != getattr(plain, word) for word in words), name
