"""Worlds at their limits: nobody, one, everybody, nothing to eat, a crowd in a corner, ticks far too long."""

import json
import math

import numpy as np
import pytest
from worlds import BAY, SQUARE, ask, everything, kind, square, start

import ecology
from ecology import Arena, EcologyError, Hazard, Need, move
from ecology.ground import ground_of, scatter

NORTH_EAST = math.pi / 4


def same(one, other):
    """Raise unless two worlds are in the same state, bit for bit."""
    assert one.state_view.tick == other.state_view.tick
    for name, values in one.state_view.arrays().items():
        assert np.array_equal(values, other.state_view.arrays()[name]), name


def finite(env, tick):
    """Raise unless all that is perceived and felt of the living is finite and inside its space."""
    for group in env.groups.values():
        alive = tick.alive[group.slots]
        zeta = tick.observations[group.name][alive]
        box = env.observation_space(f"{group.name}_0")["observation"]
        assert np.isfinite(zeta).all()
        assert (zeta >= box.low).all()
        assert (zeta <= box.high).all()
    assert np.isfinite(tick.reward).all()
    assert np.isfinite(tick.drive).all()


def any_actions(env, rng):
    """Return actions at random, open or closed, those of dead slots included."""
    return np.concatenate([rng.integers(len(g.actions), size=g.size) for g in env.groups.values()])


def twin(env):
    """Return a world that is restored from the snapshot of `env`, through JSON."""
    arrays, values = env.snapshot()
    other = ecology.parallel_env(env.scenario)
    other.restore(arrays, json.loads(json.dumps(values)))
    return other


# ---- how many ----------------------------------------------------------------------------------


@pytest.mark.parametrize("walls", [True, False])
def test_a_world_goes_on_without_anybody(walls):
    """With all dead, time, growth and arrivals go on; who arrives finds the world as it is."""
    env = start(everything(walls=walls, hazard=Hazard(rate=1e3), arrival=0.3, birth=None))
    env.set_state(alive=np.zeros(env.size, bool))
    rng = np.random.default_rng(0)
    arrived = 0
    for _ in range(120):
        tick = env.step_arrays(any_actions(env, rng))
        finite(env, tick)
        arrived += tick.born.sum()
    assert arrived > 0
    assert env.state_view.tick == 120
    same(env, twin(env))


def test_dicts_of_nobody():
    """With nobody left PettingZoo's five dicts are empty, and a reset brings all back."""
    env = ecology.parallel_env(square(kind(count=3, hazard=Hazard(rate=1e3))))
    env.reset(seed=0)
    _, _, terminations, _, _ = env.step(dict.fromkeys(env.agents, 0))
    assert list(terminations.values()) == [True] * 3
    assert env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})
    env.reset(seed=0)
    assert len(env.agents) == 3


def test_one_alone_is_as_in_a_crowd_far_away():
    """A single agent among empty slots lives bit for bit as without those slots."""
    one, many = (
        start(square(kind("agent", move("walk", 0.2), capacity=capacity, position=(4.0, 4.0), heading=1.0)))
        for capacity in (1, 40)
    )
    for _ in range(30):
        a, b = (env.step_arrays(ask(env, agent="walk")) for env in (one, many))
        assert np.array_equal(a.observations["agent"][0], b.observations["agent"][0])
        assert a.reward[0] == b.reward[0]


def test_a_full_world_lives_and_is_left_and_entered():
    """With every slot taken, fed and pushed together, nothing overflows and a snapshot lives on."""
    words = {"capacity": 30, "arrival": 50.0, "hazard": None}
    env = start(everything(**words))
    rng = np.random.default_rng(1)
    for _ in range(40):
        tick = env.step_arrays(any_actions(env, rng))
        finite(env, tick)
    prey = env.groups["prey"].slots
    assert tick.alive[prey].mean() > 0.9
    other = twin(env)
    for _ in range(10):
        asked = any_actions(env, rng)
        env.step_arrays(asked), other.step_arrays(asked)
    same(env, other)


@pytest.mark.parametrize("walls", [True, False])
def test_all_resources_empty(walls):
    """With all stocks at zero nobody eats anything, and no stock goes below zero."""
    env = start(everything(walls=walls, arrival=0.0))
    empty = np.zeros(len(env.state_view.stock))
    rng = np.random.default_rng(2)
    for _ in range(150):
        env.set_state(stock=empty)
        tick = env.step_arrays(any_actions(env, rng))
        finite(env, tick)
        assert (env.state_view.stock >= 0).all()
    assert not env.state_view.ingested.any()
    assert not env.state_view.eaten.any()


# ---- in a corner -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "corner", [((8.0, 8.0), NORTH_EAST, SQUARE), ((0.0, 8.0), 3 * NORTH_EAST, BAY)], ids=["square", "bay"]
)
def test_one_wedged_in_a_corner_by_200(corner):
    """Pushed into a corner by 200 others, everyone stays inside, nobody is thrown about, and a snapshot lives on."""
    (x, y), way, vertices = corner
    pusher = kind("agent", move("push", 0.3, direction=way), count=201, radius=0.15, solid=True)
    env = start(square(pusher, arena=Arena(vertices=vertices)), seed=3)
    wedged = np.array([x, y]) - 0.16 * np.sign([x - 4, y - 4])
    places = scatter(Arena(vertices=((x, y), (4 + (x - 4) * 0.2, y), (x, 4))), 0.16, 201, np.random.default_rng(3))
    places[0] = wedged
    env.set_state(position=places)
    for t in range(60):
        before = env.state_view.position.copy()
        env.step_arrays(ask(env, agent="push"))
        now = env.state_view.position
        assert ground_of(Arena(vertices=vertices)).inside(now).all()
        assert np.hypot(*(now - before).T).max() < 3.0
        if t == 30:
            other = twin(env)
        if t > 30:
            other.step_arrays(ask(other, agent="push"))
    same(env, other)
    assert math.dist(env.state_view.position[0], (x, y)) < 1.0  # still wedged
    for _ in range(100):
        env.step_arrays(ask(env))
    assert np.isfinite(env.state_view.position).all()
    assert ground_of(Arena(vertices=vertices)).inside(env.state_view.position).all()


def test_a_crowd_that_was_put_is_left_and_entered():
    """Bodies put on top of each other by hand: a snapshot of that lives on bit for bit, too."""
    pusher = kind("agent", move("push", 0.3, direction=0.0), count=80, radius=0.2, solid=True)
    env = start(square(pusher), seed=4)
    env.set_state(position=np.random.default_rng(4).uniform(5.5, 7.5, (80, 2)))
    for ticks in (1, 7, 200):  # the solver is rebuilt on the way
        for _ in range(ticks):
            env.step_arrays(ask(env, agent="push"))
        other = twin(env)
        for _ in range(5):
            env.step_arrays(ask(env, agent="push")), other.step_arrays(ask(env, agent="push"))
        same(env, other)


@pytest.mark.parametrize("walls", [True, False])
def test_a_snapshot_at_any_tick_lives_on(walls):
    """Left and entered at every tick of its youth, amid births, deaths and handling, a world is the same as unleft."""
    env = start(everything(walls=walls), seed=5)
    other = twin(env)
    rng, handled, born, died = np.random.default_rng(5), 0, 0, 0
    for _ in range(60):
        tick = env.step_arrays(asked := any_actions(env, rng))
        other.step_arrays(asked)
        handled += (env.state_view.hold[env.groups["hunter"].slots] > 0).sum()
        born, died = born + tick.born.sum(), died + tick.died.sum()
        same(env, other)
        other = twin(other)
        same(env, other)
        assert other.agents == [other.name_of(slot) for slot in np.flatnonzero(tick.alive)]
    assert min(handled, born, died) > 3


# ---- time --------------------------------------------------------------------------------------


@pytest.mark.parametrize("walls", [True, False])
def test_ticks_ten_times_too_long_stay_finite(walls):
    """With dt = 10 everyone eats, starves and is bitten in leaps, inside the arena and never NaN."""
    env = start(everything(walls=walls, dt=10.0), seed=6)
    rng = np.random.default_rng(6)
    for _ in range(100):
        finite(env, env.step_arrays(any_actions(env, rng)))
        assert (env.state_view.position >= 0).all()
        assert (env.state_view.position <= 8).all()


@pytest.mark.parametrize(
    ("need", "control"),
    [
        (Need(name="food", set_point=2.0, leak=0.2), 0.0),
        (Need(name="food", set_point=2.0, leak=0.05, proportional=True), -0.06),
    ],
)
def test_a_tick_too_long_for_a_rate_is_refused(need, control):
    """A rate proportional to x that a tick would overshoot is refused, with the longest tick that follows it."""
    run = ecology.act("run", control={"food": control})
    fastest = need.leak - control
    longest = 1 / fastest
    square(kind("agent", run, needs=(need,)), dt=longest * 0.999)
    with pytest.raises(EcologyError, match=f"dt must be at most {longest:g}"):
        square(kind("agent", run, needs=(need,)), dt=longest * 1.001)


def test_a_speed_too_high_for_a_tick_is_refused():
    """Ten times the longest tick of a fast body is refused, with what to do."""
    square(kind("agent", move("run", 2.0)), dt=10.0)
    with pytest.raises(EcologyError, match="lower the speed or dt"):
        square(kind("agent", move("run", 2.0)), dt=100.0)
