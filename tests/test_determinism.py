"""Whole lives, not single ticks, follow from the seed."""

import dataclasses

import numpy as np
import pytest
from worlds import everything, kind, signal, square, start

import ecology
from ecology import contract, scenarios


def episode(env, ticks=3):
    """Return what one does in the coming ticks, as bytes."""
    return b"".join(env.step_arrays(np.zeros(env.size, np.int64)).observations["agent"].tobytes() for _ in range(ticks))


@pytest.mark.parametrize("how", ["reset", "reset_arrays"])
def test_a_first_reset_without_a_seed_draws_one(how):
    """Copies that are reset without a seed have episodes of their own, and `env.seed` repeats each."""
    scenario = scenarios.load("seasons", weather=0.5)
    envs = [ecology.parallel_env(scenario) for _ in range(4)]
    assert {env.seed for env in envs} == {None}
    for env in envs:
        getattr(env, how)()
    lives = [episode(env) for env in envs]
    assert len({env.seed for env in envs}) == len(set(lives)) == 4
    again = ecology.parallel_env(scenario)
    for env, life in zip(envs, lives, strict=True):
        getattr(again, how)(seed=env.seed)
        assert episode(again) == life


def test_series_of_neighbouring_seeds_share_no_episode():
    """`reset(seed=s)` and the resets after it are one series; that of s + 1 has other episodes."""
    env = ecology.parallel_env(scenarios.load("seasons"))
    seen = []
    for first in range(4):
        env.reset(seed=first)
        for _ in range(4):
            seen.append(env.seed)
            env.reset()
    assert len(set(seen)) == len(seen)
    assert all(0 <= seed < 2**53 for seed in seen)


def test_a_first_reset_fixes_a_series():
    """After `reset(seed=s)`, resets without a seed repeat the same series of episodes."""
    scenario = scenarios.load("seasons", weather=0.5)
    env, other = ecology.parallel_env(scenario), ecology.parallel_env(scenario)
    for each in (env, other):
        each.reset(seed=3)
        each.reset()
    assert env.seed == other.seed != 3
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


def test_what_was_handed_out_never_changes():
    """Views of the state, and what a rule is shown in the middle of a tick, stay as they were."""
    kept = []

    def keep(world, rng):
        kept.append((world.state, world.state.copy()))
        return signal(world, rng)

    def lives(scenario, ticks):
        env, rng = ecology.parallel_env(scenario), np.random.default_rng(0)
        tick = env.reset_arrays(seed=0)
        for _ in range(ticks):
            kept.append((env.state_view, env.state_view.copy()))
            tick = env.step_arrays(contract.choose(env, tick, rng, open_only=rng.random() < 0.8))
        env.set_state(**env.state_view.arrays())
        return env.state_view

    now = lives(dataclasses.replace(everything(), rule=keep), 120)
    assert now.closed.any()
    assert now.next_serial > 30
    growing = kind(count=4, capacity=9, birth=ecology.Birth(rate=0.1, threshold={"food": 1.0}), arrival=0.05)
    lives(square(growing), 60)  # nobody meets anybody
    for seen, as_handed_out in kept:
        for name, values in as_handed_out.arrays().items():
            assert np.array_equal(getattr(seen, name), values), name


def test_a_view_refuses_what_would_be_lost():
    """A field of a view cannot be set, which would change nothing; a copy can."""
    env = start(square(kind()))
    with pytest.raises(ecology.EcologyError, match=r"env.set_state\(internal="):
        env.state_view.internal = np.zeros((1, 1))
    mine = env.state_view.copy()
    mine.internal = np.zeros((1, 1))
    mine.heading[0] = 1.0
    later = dataclasses.replace(env.state_view, tick=5)
    later.tick += 1
    assert (env.state_view.internal[0, 0], env.state_view.tick, later.tick) == (2.0, 0, 6)


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


def test_a_snapshot_of_another_world_is_refused():
    """Restoring a foreign snapshot says what differs and changes nothing."""
    env = ecology.parallel_env(scenarios.load("paper"))
    tick = env.reset_arrays(seed=1)
    foreign = ecology.parallel_env(scenarios.load("seasons"))
    foreign.reset_arrays(seed=1)
    with pytest.raises(ecology.EcologyError, match=r"another world than 'paper'.*internal"):
        env.restore(*foreign.snapshot())
    assert np.array_equal(env.set_state().observations["agent"], tick.observations["agent"])
