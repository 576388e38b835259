"""GymEnv: a world of one agent under Gymnasium's interface."""

import copy
import pickle
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from worlds import kind, square

import ecology
from ecology import EcologyError, Hazard, scenarios

ONE_AGENT = [name for name in scenarios.names() if sum(s.slots for s in scenarios.load(name).species) == 1]
MANY = [name for name in scenarios.names() if name not in ONE_AGENT]
SURE = 1e3  # a hazard that kills in the first tick


@pytest.mark.parametrize("name", ONE_AGENT)
def test_gymnasium_accepts_it(name):
    """Gymnasium's check_env passes, and warns of nothing but the bounds that a body does not have."""
    env = gymnasium.make(f"ecology/{name}-v0", render_mode="rgb_array")
    with warnings.catch_warnings():
        for words in (".*infinity. This is probably too", ".*alternative render modes"):
            warnings.filterwarnings("ignore", message=words)
        check_env(env.unwrapped)


@pytest.mark.parametrize("name", ONE_AGENT)
def test_stable_baselines3_accepts_it(name):
    """Stable-Baselines3's check_env passes."""
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        checker.check_env(gymnasium.make(f"ecology/{name}-v0").unwrapped)


@pytest.mark.parametrize("name", MANY)
def test_a_world_of_many_is_refused(name):
    """A world of several agents is one error that says what to use instead."""
    with pytest.raises(EcologyError, match=r"has one agent.*FixedSlots"):
        gymnasium.make(f"ecology/{name}-v0")


def test_settings_are_passed_on():
    """`make` takes the scenario's settings, which can make a world of many one of one agent, and the horizon."""
    assert gymnasium.make("ecology/commons-v0", n=1).unwrapped.world.size == 1
    env = gymnasium.make("ecology/paper-v0", decay=0.02, horizon=7).unwrapped
    assert env.world.scenario.settings["decay"] == 0.02
    assert env.world.horizon == 7
    with pytest.raises(EcologyError, match="Did you mean 'decay'"):
        gymnasium.make("ecology/paper-v0", decai=0.02)


def test_no_setting_is_hidden():
    """No scenario has a setting that `make` or Gymnasium takes for itself."""
    taken = {"name", "horizon", "render_mode", "max_episode_steps", "disable_env_checker", "id"}
    assert all(taken.isdisjoint(scenarios.settings(name)) for name in scenarios.names())


def test_it_is_the_same_world():
    """Observations, rewards, masks, drives and what is closed are those of the arrays, number for number."""
    scenario = scenarios.load("seasons", weather=0.5)
    env, world = ecology.gym_env(scenario), ecology.parallel_env(scenario)
    rng = np.random.default_rng(0)
    (zeta, info), tick = env.reset(seed=5), world.reset_arrays(seed=5)
    asked_closed = 0
    for t in range(200):
        (name,) = tick.masks
        np.testing.assert_array_equal(zeta, tick.observations[name][0])
        np.testing.assert_array_equal(env.action_masks(), tick.masks[name][0])
        np.testing.assert_array_equal(info["action_mask"], tick.masks[name][0])
        assert info["drive"] == tick.drive[0]
        assert info["closed"] == tick.closed[0]
        asked_closed += info["closed"]
        action = rng.integers(env.action_space.n)
        zeta, reward, terminated, truncated, info = env.step(action if t % 2 else np.array(action))
        tick = world.step_arrays(np.array([action]))
        assert (reward, terminated, truncated) == (tick.reward[0], False, False)
    assert asked_closed > 0


def test_an_episode_ends():
    """Death terminates, the horizon truncates, and a step after the end is refused; the dead may rest."""
    dies = ecology.gym_env(square(kind(hazard=Hazard(rate=SURE))))
    dies.reset(seed=0)
    _, _, terminated, truncated, info = dies.step(0)
    assert (terminated, truncated) == (True, False)
    assert info["action_mask"].tolist() == [1]
    short = ecology.gym_env(square(kind()), horizon=2)
    short.reset(seed=0)
    assert short.step(0)[2:4] == (False, False)
    assert short.step(0)[2:4] == (False, True)
    for env in (dies, short, ecology.gym_env(square(kind()))):
        with pytest.raises(EcologyError, match="call reset"):
            env.step(0)
    with pytest.raises(EcologyError, match="call reset"):
        ecology.gym_env(square(kind())).action_masks()


@pytest.mark.parametrize("action", [1, -1, 0.0, "rest", None, [0]])
def test_an_impossible_action_is_refused(action):
    """An action outside the space is one error that says which there are."""
    env = ecology.gym_env(square(kind()))
    env.reset(seed=0)
    with pytest.raises(EcologyError, match="whole number from 0 to 0"):
        env.step(action)


def test_resets_without_a_seed_differ_and_are_recorded():
    """Two environments that get no seed have episodes of their own, and `np_random_seed` repeats each."""
    scenario = scenarios.load("seasons", weather=0.5)
    one, other = ecology.gym_env(scenario), ecology.gym_env(scenario)
    one.reset()
    other.reset()
    assert one.np_random_seed == one.world.seed != other.np_random_seed
    again = ecology.gym_env(scenario)
    again.reset(seed=one.np_random_seed)
    for _ in range(20):
        np.testing.assert_array_equal(one.step(0)[0], again.step(0)[0])


@pytest.mark.parametrize("twin", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_continues(twin):
    """A copy in the middle of an episode goes on as the original does."""
    env = ecology.gym_env(scenarios.load("paper"))
    env.reset(seed=1)
    for _ in range(20):
        env.step(int(env.action_masks().nonzero()[0][-1]))
    other = twin(env)
    for _ in range(50):
        action = int(env.action_masks().nonzero()[0][-1])
        for one, two in zip(env.step(action)[:4], other.step(action)[:4], strict=True):
            np.testing.assert_array_equal(one, two)


def test_many_at_once():
    """Gymnasium's vector environments take it, and have the masks of all in their infos."""
    envs = gymnasium.make_vec("ecology/paper-v0", num_envs=3, vectorization_mode="sync")
    envs.reset(seed=0)
    *_, infos = envs.step(np.zeros(3, np.int64))
    assert infos["action_mask"].shape == (3, envs.single_action_space.n)
    assert len({each.unwrapped.world.seed for each in envs.envs}) == 3
    envs.close()
