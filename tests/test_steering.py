"""Continuous actions: any speed and turn rate within what a body can do, in a Box, and a grid of them."""

import math

import numpy as np
import pytest
from gymnasium.spaces import Box
from pettingzoo.test import parallel_api_test
from worlds import ask, kind, square, start

from ecology import Ecology, EcologyError, Resource, bite, consume, move, scenarios, steer_grid, steered, turn

MIDDLE = (4.0, 4.0)


def walker(**words):
    """Return a world of one body that walks, runs at a cost, turns and eats."""
    acts = (
        move("walk", 0.1),
        move("run", 0.3, control={"food": -0.05}),
        turn("left", 0.5),
        consume("dish", {"food": 0.1}),
    )
    species = kind("body", *acts, position=MIDDLE, heading=0.0, **words)
    return square(species, resources=(Resource(name="dish", position=(4.0, 4.0), radius=1.0),))


def test_a_body_goes_where_it_is_steered():
    """Position and heading are those of the speed and turn rate given, at every tick."""
    env = steered(walker())
    env.reset(seed=0)
    name, heading, place = env.agents[0], 0.0, np.array(MIDDLE)
    rng = np.random.default_rng(0)
    for _ in range(20):
        speed, rate = rng.uniform(0, 0.1), rng.uniform(-0.5, 0.5)
        env.step({name: np.array([speed, rate, -1.0, -1.0])})
        heading += rate
        place = place + speed * np.array([math.cos(heading), math.sin(heading)])
        state = env.env.state_view
        assert state.position[0] == pytest.approx(place, abs=1e-6)
        assert math.cos(state.heading[0] - heading) == pytest.approx(1.0)


def test_speed_is_paid_for_and_bounded():
    """The slowest move that is as fast is paid for; beyond the fastest nothing is gained."""
    env = steered(walker())
    for speed, cost, far in ((0.1, 0.0, 0.1), (0.15, 0.05, 0.15), (9.0, 0.05, 0.3)):
        env.reset(seed=0)
        env.step({env.agents[0]: np.array([speed, 0.0, -1.0, -1.0])})
        state = env.env.state_view
        assert 2.0 - state.internal[0, 0] == pytest.approx(cost)
        assert state.position[0, 0] - 4.0 == pytest.approx(far, abs=1e-6)


def test_a_score_chooses_what_is_open():
    """The open action of the highest score above 0 is executed; a closed one is none."""
    env = steered(walker())
    env.reset(seed=0)
    assert env.others("body") == ("rest", "consume_dish")
    assert env.action_space(env.agents[0]) == Box(
        np.array([0, -0.5, -1, -1], np.float32), np.array([0.3, 0.5, 1, 1], np.float32), dtype=np.float32
    )
    env.step({env.agents[0]: np.array([0.1, 0.0, 0.2, 0.9])})
    assert env.env.groups["body"].actions[env.env.state_view.action[0]] == "consume_dish"
    env.env.set_state(position=np.array([[1.0, 1.0]]))
    env.step({env.agents[0]: np.array([0.1, 0.0, 0.2, 0.9])})
    assert env.env.groups["body"].actions[env.env.state_view.action[0]] == "rest"


def test_it_is_a_parallel_environment():
    """PettingZoo's own test passes, and a world with births and deaths goes on with vectors at random."""
    parallel_api_test(steered(walker(count=3), horizon=50), num_cycles=20)
    env = steered(scenarios.load("predator_prey"))
    observations, infos = env.reset(seed=0)
    for _ in range(20):
        observations, *_, infos = env.step({name: env.action_space(name).sample() for name in env.agents})
    name = env.agents[0]
    assert env.observation_space(name).contains(observations[name])
    assert infos[name]["action_mask"].sum() > 0


def test_without_steering_nothing_changes():
    """NaN everywhere is the world of discrete actions, bit for bit."""
    worlds = [Ecology(scenarios.load("predator_prey")) for _ in range(2)]
    for env in worlds:
        env.reset_arrays(3)
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.integers(0, 4, worlds[0].size)
        worlds[0].step_arrays(actions)
        worlds[1].step_arrays(actions, np.full((worlds[1].size, 2), np.nan))
    one, other = (env.snapshot()[0] for env in worlds)
    assert all(np.array_equal(one[key], other[key]) for key in one)


def test_a_grid_of_steering_is_moves():
    """Each has its speed and turn rate, which f/J choose among."""
    grid = steer_grid(0.2, 0.4, speeds=2, turns=3)
    assert [(a.speed, a.turn) for a in grid] == [
        (0.1, -0.4), (0.1, 0.0), (0.1, 0.4), (0.2, -0.4), (0.2, 0.0), (0.2, 0.4),
    ]  # fmt: skip
    env = start(square(kind("body", *grid, position=MIDDLE, heading=0.0)))
    env.step_arrays(ask(env, body="steer_2_3"))
    assert env.state_view.heading[0] == pytest.approx(0.4)
    assert env.state_view.position[0] == pytest.approx([4 + 0.2 * math.cos(0.4), 4 + 0.2 * math.sin(0.4)])


def test_one_thing_is_eaten_and_bitten_in_several_ways():
    """Two meals of a dish and two bites of one species are actions of their own, with their own u and damage."""
    prey = kind("prey", position=(4.0, 4.2))
    acts = (
        consume("dish", {"food": 0.1}, name="nibble"),
        consume("dish", {"food": 0.4}, name="gorge"),
        bite("prey", reach=1.0, damage={"food": 0.1}, name="nip"),
        bite("prey", reach=1.0, damage={"food": 0.7}, name="maul"),
    )
    hunter = kind("hunter", *acts, position=MIDDLE)
    world = square(hunter, prey, resources=(Resource(name="dish", position=MIDDLE, radius=1.0),))
    found = {}
    for act in ("nibble", "gorge", "nip", "maul"):
        env = start(world)
        env.set_state(internal=np.full_like(env.state_view.internal, 1.0))
        env.step_arrays(ask(env, hunter=act, prey="rest"))
        found[act] = env.state_view.internal[:, 0] - 1.0
    assert [found[a][0] for a in ("nibble", "gorge")] == pytest.approx([0.1, 0.4])
    assert [found[a][1] for a in ("nip", "maul")] == pytest.approx([-0.1, -0.7])


def test_mistakes_are_told():
    """A world without moves along the heading, vectors of another length, and steering of another shape."""
    with pytest.raises(EcologyError, match="none has a move along its heading"):
        steered(square(kind()))
    env = steered(walker())
    env.reset(seed=0)
    with pytest.raises(EcologyError, match="4 finite numbers"):
        env.step({env.agents[0]: np.zeros(2)})
    with pytest.raises(EcologyError, match="missing: body_0"):
        env.step({})
    with pytest.raises(EcologyError, match=r"shape \(1, 2\)"):
        env.env.step_arrays(np.zeros(1, np.int64), np.zeros(2))
