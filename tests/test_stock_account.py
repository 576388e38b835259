"""Every quantity is accounted for in every tick."""

import numpy as np
import pytest
from stocks import berries, crowd, eat, idle, world

import ecology
from ecology import (
    Need,
    scenarios,
)


def hungry(env, tick, rng):
    """Return actions of agents that eat where they can, or else do anything, now and then what is closed."""
    eats = np.array(env.groups["agent"].kinds) == "consume"
    mask = tick.masks["agent"] | (rng.random() < 0.1)
    return np.argmax(rng.random(mask.shape) * mask * np.where(eats, 3.0, 1.0), axis=1)


@pytest.mark.parametrize("dt", [1.0, 0.4])
def test_every_quantity_is_accounted_for_in_every_tick(dt):
    """In a hungry crowd: stored = in - out for every stock and every body, and what leaves stocks enters bodies."""
    env, rng = crowd(dt), np.random.default_rng(1)
    tick = env.reset_arrays(seed=5)
    start, short = env.state_view.copy(), np.zeros(5, int)
    before = start
    finite = np.isfinite(start.stock)
    for _ in range(300):
        tick = env.step_arrays(hungry(env, tick, rng))
        now = env.state_view.copy()
        assert (now.stock >= 0).all()
        assert (now.stock[finite] <= [9.0, 1.0, 0.7, 5.0]).all()
        for old in (start, before):  # since the start, and in this tick alone
            stored = now.stock[finite] - old.stock[finite]
            grown, eaten = now.grown - old.grown, now.eaten - old.eaten
            assert np.abs(stored - (grown - eaten)[finite]).max() < 1e-9
            assert np.abs(grown - eaten)[~finite].max() < 1e-9
            came, went = now.ingested - old.ingested, now.metabolised - old.metabolised + now.lost - old.lost
            assert np.abs(now.internal - old.internal - came + went).max() < 1e-9
            assert abs(came.sum() - eaten.sum()) < 1e-9
        assert (now.eaten >= before.eaten).all()
        assert (now.ingested >= before.ingested).all()
        assert (now.ingested[:, 2] == 0).all(), "a fatigue is not fed"
        went = (now.metabolised - before.metabolised)[before.alive, :2]
        own = np.stack([np.full(len(went), 0.05), 0.02 * before.internal[before.alive, 1]], axis=1)
        assert np.abs(went - own * dt).max(initial=0.0) < 1e-9, "food and water go by self-regulation alone"
        for field in ("ingested", "metabolised", "lost"):
            dead = ~before.alive
            assert np.array_equal(getattr(now, field)[dead], getattr(before, field)[dead])
        short += np.isclose(before.stock, now.eaten - before.eaten) & (now.eaten > before.eaten)
        before = now
    assert (short[finite] > 0).all(), "every finite stock was eaten up at times"
    assert (now.eaten > 1).all()
    assert 0 < now.alive.sum() < 30


def test_the_account_worked_by_hand():
    """Resting metabolises the decay; eating at the upper bound is lost; a floor gives what it holds up."""
    needs = (
        Need(name="food", set_point=2.0, start=1.9, decay=0.03, bounds=(0.0, 2.0)),
        Need(name="warmth", set_point=1.0, start=0.55, decay=0.1, floor=0.5),
    )
    env = world(berries(stock=1.0), needs=needs)
    env.reset_arrays(seed=0)
    idle(env)
    state = env.state_view
    assert state.metabolised[0] == pytest.approx([0.03, 0.1])
    assert state.lost[0] == pytest.approx([0.0, -0.05])
    eat(env, 2)  # 1.87, 1.94, 2.01 held at 2
    state = env.state_view
    assert state.ingested[0] == pytest.approx([0.2, 0.0])
    assert state.metabolised[0] == pytest.approx([0.09, 0.3])
    assert state.lost[0] == pytest.approx([0.01, -0.25])
    assert state.eaten == pytest.approx([0.2])
    assert state.stock == pytest.approx([0.8])


def test_an_unlimited_resource_is_accounted_for_too():
    """In the paper's world what is eaten of an unlimited resource is booked, and its stock stays infinite."""
    env = ecology.parallel_env(scenarios.load("paper"))
    env.reset_arrays(seed=0)
    env.set_state(position=env.state_view.resource_position[:1])
    act = env.groups["agent"].actions.index("consume_food_1")
    for _ in range(5):
        env.step_arrays(np.array([act]))
    state = env.state_view
    assert state.eaten.tolist() == state.grown.tolist() == pytest.approx([0.5, 0, 0, 0])
    assert state.ingested[0] == pytest.approx([0.5, 0, 0, 0, 0, 0])
    assert np.isinf(state.stock).all()
