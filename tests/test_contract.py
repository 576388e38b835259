"""The contract that every scenario in the folder keeps; a new file is found by itself."""

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

import ecology
import scenarios

TICKS = 400


@pytest.fixture(params=scenarios.names())
def scenario(request):
    """Return every scenario in turn, with its default settings."""
    return scenarios.load(request.param)


@pytest.fixture
def env(scenario):
    """Return the world of every scenario in turn."""
    return ecology.parallel_env(scenario)


def by_name(env, tick, actions):
    """Return the actions of the living by their names."""
    return {env.name_of(slot): int(actions[slot]) for slot in np.flatnonzero(tick.alive)}


def test_pettingzoo_accepts_it(scenario):
    """PettingZoo's own parallel_api_test passes, with and without a horizon."""
    parallel_api_test(ecology.parallel_env(scenario), num_cycles=150)
    parallel_api_test(ecology.parallel_env(scenario, horizon=20), num_cycles=50)


def test_it_is_named_as_its_file_and_says_what_it_is(scenario):
    """A scenario bears the name of its file, keeps its settings, and its file begins with a sentence."""
    assert scenario.name in scenarios.names()
    assert dict(scenario.settings) == scenarios.settings(scenario.name)
    assert scenarios.module(scenario.name).__doc__.strip()


def test_observations_lie_in_their_space(env):
    """What an agent perceives is finite and inside its observation space, whatever it asks for."""
    rng = np.random.default_rng(1)
    env.reset(seed=1)
    for _ in range(TICKS):
        living = {name: int(rng.integers(env.action_space(name).n)) for name in env.agents}
        observations, rewards, *_ = env.step(living)
        for name in living:
            seen, space = observations[name], env.observation_space(name)
            assert np.isfinite(seen["observation"]).all()
            assert np.isfinite(rewards[name])
            assert space.contains(seen), (name, seen, space)
        if not env.agents:
            break


def test_the_mask_is_honoured(env, random_actions):
    """What is executed was open; a closed action becomes rest, or what is open without it, and is counted."""
    rng = np.random.default_rng(2)
    tick = env.reset_arrays(seed=2)
    asked_closed, something_closes = np.zeros(env.size, np.int64), False
    for _ in range(TICKS):
        before, alive = {name: mask.copy() for name, mask in tick.masks.items()}, tick.alive.copy()
        wanted = random_actions(env, tick, rng, open_only=rng.random() < 0.5)
        tick = env.step_arrays(wanted)
        for group in env.groups.values():
            rest = group.kinds.index("rest")
            for row in np.flatnonzero(alive[group.slots]):
                slot, mask = group.slots.start + row, before[group.name][row]
                something_closes |= not mask.all()
                assert mask.any()
                assert mask[tick.action[slot]]
                if mask[wanted[slot]]:
                    assert tick.action[slot] == wanted[slot]
                elif mask[rest]:
                    assert tick.action[slot] == rest
                assert tick.closed[slot] == (not mask[wanted[slot]])
                asked_closed[slot] += tick.closed[slot]
    assert (asked_closed.sum() > 0) == something_closes
    assert np.array_equal(env.state_view.closed, asked_closed)


def test_infos_report_closed_actions_and_masks(env):
    """`infos` holds the mask, the drive and whether the last action was closed."""
    observations, infos = env.reset(seed=3)
    for name in env.agents:
        assert infos[name]["closed"] is False
        assert np.array_equal(infos[name]["action_mask"], observations[name]["action_mask"])
    # a closed action, where there is one: a consumption far from its resource
    wanted = {name: int(np.argmin(infos[name]["action_mask"])) for name in env.agents}
    closed = {name: not infos[name]["action_mask"][wanted[name]] for name in env.agents}
    *_, after = env.step(wanted)
    assert {name: after[name]["closed"] for name in wanted} == closed
    for slot, name in enumerate(wanted):
        assert after[name]["drive"] == env.state_view.drive[slot]


def test_dicts_and_arrays_give_one_trajectory(scenario, random_actions):
    """Stepping with dicts and stepping with arrays is the same world, number for number."""
    of_dicts, of_arrays = ecology.parallel_env(scenario), ecology.parallel_env(scenario)
    rng = np.random.default_rng(4)
    observations, _ = of_dicts.reset(seed=4)
    tick = of_arrays.reset_arrays(seed=4)
    for _ in range(TICKS):
        actions = random_actions(of_arrays, tick, rng, open_only=False)
        living = by_name(of_arrays, tick, actions)
        assert set(living) == set(of_dicts.agents)
        tick = of_arrays.step_arrays(actions)
        observations, rewards, terminations, truncations, infos = of_dicts.step(living)
        assert not any(truncations.values())
        for group in of_arrays.groups.values():
            for row in range(group.size):
                slot = group.slots.start + row
                name = of_arrays.name_of(slot)
                if name not in observations:
                    continue
                assert np.array_equal(observations[name]["observation"], tick.observations[group.name][row])
                assert np.array_equal(observations[name]["action_mask"], tick.masks[group.name][row])
                assert np.array_equal(infos[name]["action_mask"], tick.masks[group.name][row])
                assert rewards[name] == tick.reward[slot]
                assert terminations[name] == (not tick.alive[slot])
        if not of_dicts.agents:
            break
    for name, values in of_dicts.state_view.arrays().items():
        assert np.array_equal(values, of_arrays.state_view.arrays()[name]), name


def test_what_was_handed_out_stays_as_it_was(env, random_actions):
    """Later ticks do not write into observations, masks, rewards and drives handed out before."""
    rng = np.random.default_rng(5)
    tick = env.reset_arrays(seed=5)
    kept = []
    for _ in range(20):
        parts = {
            "reward": tick.reward,
            "drive": tick.drive,
            "alive": tick.alive,
            "closed": tick.closed,
            "action": tick.action,
            **{f"observations {name}": values for name, values in tick.observations.items()},
            **{f"masks {name}": values for name, values in tick.masks.items()},
        }
        kept.append([(name, values, values.copy()) for name, values in parts.items()])
        tick = env.step_arrays(random_actions(env, tick, rng))
    for parts in kept:
        for name, values, as_handed_out in parts:
            assert np.array_equal(values, as_handed_out), name


def test_the_state_cannot_be_written(env):
    """The state shown to watchers refuses to be written."""
    env.reset_arrays(seed=0)
    with pytest.raises(ValueError, match="read-only"):
        env.state_view.position[0] = 0.0


def test_a_horizon_truncates_everyone(scenario):
    """After `horizon` ticks every agent left is truncated and none remains."""
    env = ecology.parallel_env(scenario, horizon=3)
    env.reset(seed=0)
    for left in (2, 1, 0):
        *_, truncations, _ = env.step(dict.fromkeys(env.agents, 0))
        assert all(over == (left == 0) for over in truncations.values())
    assert env.agents == []
