"""Whole lives, not single ticks, follow from the seed."""

import json

import numpy as np
import pytest

import ecology
import scenarios

AGENT_TICKS = 2000  # of each life compared


def life(env, seed, random_actions, ticks=None):
    """Return the fields of the state at every tick of a life of random actions, open and closed."""
    rng = np.random.default_rng(7)
    tick = env.reset_arrays(seed=seed)
    told = []
    for _ in range(ticks or max(300, AGENT_TICKS // env.size)):
        tick = env.step_arrays(random_actions(env, tick, rng, open_only=rng.random() < 0.9))
        state = env.state_view
        told.append(
            np.concatenate(
                [
                    state.position.ravel(),
                    state.heading,
                    state.internal.ravel(),
                    state.action,
                    tick.reward,
                    *(values.ravel() for values in tick.observations.values()),
                    *(mask.ravel() for mask in tick.masks.values()),
                ]
            )
        )
    return np.array(told)


@pytest.mark.parametrize("name", scenarios.names())
def test_the_same_seed_gives_the_same_life(name, random_actions):
    """Two worlds with one seed, and one world reset to its seed, live the same life bit for bit."""
    scenario = scenarios.load(name)
    env = ecology.parallel_env(scenario)
    first = life(env, 11, random_actions)
    assert np.array_equal(first, life(ecology.parallel_env(scenario), 11, random_actions))
    assert np.array_equal(first, life(env, 11, random_actions)), "reset does not bring the world back"


def test_reset_without_a_seed_takes_the_next_one():
    """`reset()` after `reset(seed=s)` is `reset(seed=s + 1)`, so that a first reset alone fixes a series."""
    scenario = scenarios.load("seasons", weather=0.5)
    env, other = ecology.parallel_env(scenario), ecology.parallel_env(scenario)
    env.reset(seed=3)
    env.reset()
    other.reset(seed=4)
    for _ in range(50):
        one = env.step(dict.fromkeys(env.agents, 0))[0]
        two = other.step(dict.fromkeys(other.agents, 0))[0]
        for agent in one:
            assert np.array_equal(one[agent]["observation"], two[agent]["observation"])


def test_another_seed_gives_other_weather():
    """Another seed moves the need that has noise, and only that one."""
    env = ecology.parallel_env(scenarios.load("seasons"))
    ends = []
    for seed in (1, 2):
        env.reset_arrays(seed=seed)
        for _ in range(10):
            env.step_arrays(np.zeros(1, np.int64))
        ends.append(env.state_view.internal.copy())
    food, warmth = np.abs(ends[0] - ends[1])[0]
    assert food == 0
    assert warmth > 0


def test_another_seed_gives_other_births(room):
    """Places and headings that a species leaves open are drawn from the seed."""
    env = ecology.parallel_env(room(count=5))
    env.reset_arrays(seed=1)
    one = env.state_view.copy()
    env.reset_arrays(seed=2)
    assert not np.array_equal(one.position, env.state_view.position)
    assert not np.array_equal(one.heading, env.state_view.heading)
    env.reset_arrays(seed=1)
    assert np.array_equal(one.position, env.state_view.position)
    assert np.array_equal(one.heading, env.state_view.heading)


def test_noise_does_not_move_births(room):
    """Each concern has its own random stream: noise in a need leaves the places of birth as they are."""
    still = room(count=4, needs=(ecology.Need(name="food", set_point=2.0),))
    noisy = room(count=4, needs=(ecology.Need(name="food", set_point=2.0, noise=0.3),))
    places = []
    for scenario in (still, noisy):
        env = ecology.parallel_env(scenario)
        env.reset_arrays(seed=9)
        env.step_arrays(np.zeros(4, np.int64))
        env.reset_arrays(seed=9)
        places.append(env.state_view.position.copy())
    assert np.array_equal(*places)


@pytest.mark.parametrize("name", scenarios.names())
def test_a_restored_world_lives_on_as_the_one_that_was_left(name, random_actions):
    """A snapshot restored into a fresh world goes on bit for bit like the world it was taken of."""
    scenario = scenarios.load(name)
    env, other = ecology.parallel_env(scenario), ecology.parallel_env(scenario)
    life(env, 5, random_actions, ticks=300)
    arrays, values = env.snapshot()
    tick = env.put()
    again = other.restore(arrays, json.loads(json.dumps(values)))
    assert other.agents == [env.name_of(slot) for slot in np.flatnonzero(tick.alive)]
    rng = np.random.default_rng(1)
    for _ in range(300):
        for group in env.groups:
            assert np.array_equal(tick.observations[group], again.observations[group])
            assert np.array_equal(tick.masks[group], again.masks[group])
        actions = random_actions(env, tick, rng, open_only=False)
        tick, again = env.step_arrays(actions), other.step_arrays(actions)
        assert np.array_equal(tick.reward, again.reward)
    for field, values in env.state_view.arrays().items():
        assert np.array_equal(values, other.state_view.arrays()[field]), field
    assert env.state_view.tick == other.state_view.tick


def test_a_snapshot_of_another_world_is_refused():
    """Restoring a foreign snapshot says what differs and changes nothing."""
    env = ecology.parallel_env(scenarios.load("paper"))
    tick = env.reset_arrays(seed=1)
    foreign = ecology.parallel_env(scenarios.load("seasons"))
    foreign.reset_arrays(seed=1)
    with pytest.raises(ecology.EcologyError, match=r"another world than 'paper'.*internal"):
        env.restore(*foreign.snapshot())
    assert np.array_equal(env.put().observations["agent"], tick.observations["agent"])
