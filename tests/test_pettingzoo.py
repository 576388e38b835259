"""PettingZoo's conventions at the ends of an episode, where the mask is, and the space of the state."""

import numpy as np
import pytest
from pettingzoo.utils.conversions import parallel_to_aec
from worlds import kind, square

import ecology
from ecology import EcologyError, Hazard, scenarios
from ecology.fixed import FixedSlots
from ecology.steering import Steered

NOTHING = ({}, {}, {}, {}, {})
HORIZON = 30  # ticks
SURE = 1e3  # a hazard that kills in the first tick


def test_births_in_the_last_tick_pass_through_the_agent_cycle():
    """Newborns of the horizon's tick, who could never act, have no entry, so that `parallel_to_aec` ends well."""
    born = 0
    for seed in range(3):
        world = ecology.parallel_env(scenarios.load("well_mixed"), horizon=HORIZON)
        env = parallel_to_aec(world)
        env.reset(seed=seed)
        for agent in env.agent_iter(10**6):
            over = env.terminations[agent] or env.truncations[agent]
            env.step(None if over else int(np.argmax(env.observe(agent)["action_mask"])))
        assert env.agents == []
        now = world.state_view
        assert now.tick == HORIZON
        born += np.count_nonzero(now.alive & (now.age == 0))
    assert born > 0, "the last tick of one of these lives has births"


def test_the_last_tick_tells_of_those_who_acted():
    """In the horizon's tick the five dicts have an entry for every agent that acted, and for nobody else."""
    env = ecology.parallel_env(square(kind(capacity=300, arrival=50.0)), horizon=2)
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, 0))
    acted = list(env.agents)
    five = env.step(dict.fromkeys(acted, 0))
    assert np.count_nonzero(env.state_view.alive) > len(acted) > 1
    assert all(list(part) == acted for part in five)
    assert all(five[3].values())


def test_no_tick_passes_after_the_end():
    """After the horizon, and after the last death where nobody can arrive, `step({})` is empty and changes nothing."""
    short = ecology.parallel_env(square(kind()), horizon=1)
    extinct = ecology.parallel_env(square(kind(hazard=Hazard(rate=SURE))))
    for env in (short, extinct):
        env.reset(seed=0)
        env.step({"agent_0": 0})
        for _ in range(2):
            assert env.step({}) == NOTHING
        assert env.state_view.tick == 1
        with pytest.raises(EcologyError, match="is over"):
            env.step({"agent_0": 0})
        env.reset(seed=0)
        env.step({"agent_0": 0})
        assert env.state_view.tick == 1


def test_ticks_pass_where_somebody_can_arrive():
    """A world that is empty for now goes on by `step({})` until newcomers arrive."""
    env = ecology.parallel_env(square(kind(count=0, capacity=5, arrival=0.5)))
    env.reset(seed=0)
    assert env.agents == []
    for _ in range(50):
        env.step(dict.fromkeys(env.agents, 0))
    assert env.state_view.tick == 50
    assert env.agents


@pytest.mark.parametrize("flatten", [False, True])
def test_the_mask_is_in_one_place(flatten):
    """The mask is in the observation alone, for the world and for its slots."""
    world = ecology.parallel_env(scenarios.load("predator_prey", prey=3, predators=2))
    envs = [FixedSlots(world, flatten=flatten)] + [world] * (not flatten)
    for env in envs:
        observations, infos = env.reset(seed=0)
        *_, more = env.step(dict.fromkeys(env.agents, 0))
        for info in (*infos.values(), *more.values()):
            assert "action_mask" not in info
            assert {"drive", "closed"} <= info.keys()
        for name, seen in observations.items():
            mask = seen[-env.action_space(name).n :] if flatten else seen["action_mask"]
            assert set(np.unique(mask)) <= {0, 1}


@pytest.mark.parametrize("name", ["paper", "colony", "predator_prey", "well_mixed"])
def test_the_state_lies_in_its_space(name):
    """`state()` lies in `state_space`, bounds that are reached included, and no component is constant by its bounds."""
    env = ecology.parallel_env(scenarios.load(name))
    env.reset(seed=0)
    space = env.state_space
    assert space is env.state_space
    assert (space.low < space.high).all()
    rng = np.random.default_rng(0)
    for _ in range(100):
        state = env.state()
        assert space.contains(state), np.flatnonzero((state < space.low) | (state > space.high))
        env.step({agent: int(rng.integers(env.action_space(agent).n)) for agent in env.agents})
    assert FixedSlots(env).state_space is space


def test_a_wrapped_world_has_the_state_and_the_seed_of_its_world():
    """Centralised critics find `state()` and its space, and users the seed, whichever way the actions are given."""
    for wrap in (FixedSlots, Steered):
        env = ecology.parallel_env(scenarios.load("predator_prey"), horizon=5)
        wrapped = wrap(env)
        wrapped.reset(seed=3)
        assert wrapped.state_space is env.state_space
        assert wrapped.state_space.contains(wrapped.state())
        np.testing.assert_array_equal(wrapped.state(), env.state())
        assert wrapped.seed == 3
