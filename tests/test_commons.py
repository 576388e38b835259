"""`commons` against its closed form: n eaters with a fixed appetite, one pool that regrows."""

import math

import numpy as np
import pytest

import ecology
from ecology import scenarios

GROWTH, CAPACITY, APPETITE = 0.01, 100.0, 0.08  # a full pool sustains growth E0 / q = 12.5 eaters
BEARS = GROWTH * CAPACITY / APPETITE


def crowd(middle, n):
    """Return n places (n, 2) around `middle` where bodies do not touch."""
    row = np.arange(n)
    return np.array(middle) + 0.25 * np.stack([row % 5 - 2.0, row // 5 - 2.0], axis=1)


def pool(n, ticks, **settings):
    """Return the stock (ticks + 1,) while n agents stand in the pool and eat whenever they can."""
    words = {"growth": GROWTH, "capacity": CAPACITY, "appetite": APPETITE} | settings
    env = ecology.parallel_env(scenarios.load("commons", n=n, **words))
    env.reset_arrays(seed=0)
    middle = env.scenario.resources[0].position
    env.set_state(position=crowd(middle, n))
    eat = np.full(n, env.groups["agent"].actions.index("consume_pool"))
    stock = [env.state_view.stock[0]]
    for _ in range(ticks):
        env.step_arrays(eat)
        stock.append(env.state_view.stock[0])
    return np.array(stock)


def by_hand(n, ticks):
    """Return the same from E' = min(E0, max(0, (1 + growth) E - n q))."""
    stock = [CAPACITY]
    for _ in range(ticks):
        left = max(0.0, (1 + GROWTH) * stock[-1] - n * APPETITE)
        stock.append(min(CAPACITY, left) if stock[-1] > n * APPETITE else 0.0)  # what is eaten up has no seed left
    return np.array(stock)


@pytest.mark.parametrize("n", [1, 6, 12, 13, 14, 25])
def test_the_pool_follows_its_closed_form(n):
    """Tick by tick the stock is min(E0, (1 + growth) E - n q), and it survives exactly when n q <= growth E0."""
    ticks = 600
    stock, expected = pool(n, ticks), by_hand(n, ticks)
    np.testing.assert_allclose(stock, expected, atol=1e-6)
    assert (stock[-1] > 0) == (n <= BEARS)
    if n <= BEARS:
        assert (stock == CAPACITY).all()


@pytest.mark.parametrize("n", [13, 20])
def test_a_pool_with_one_eater_too_many_is_empty_when_the_formula_says(n):
    """It lasts ln(n q / (n q - growth E0)) / ln(1 + growth) units of time, to the tick."""
    taken = n * APPETITE
    lasts = math.log(taken / (taken - GROWTH * CAPACITY)) / math.log1p(GROWTH)
    emptied = int(np.argmax(pool(n, 400) <= 0))
    assert abs(emptied - lasts) <= 1.0


def test_on_the_threshold_itself_the_pool_stays_full():
    """With n q = growth E0 exactly, what is eaten grows back in the same tick."""
    stock = pool(10, 400, appetite=0.1)
    np.testing.assert_allclose(stock, CAPACITY, rtol=1e-9)


def test_who_starts_below_the_threshold_stock_loses_the_pool():
    """n q / growth is the stock below which a pool is lost though a full one would bear the same eaters."""
    n = 10
    least = n * APPETITE / GROWTH  # 80 of 100
    for stock, survives in ((0.99 * least, False), (1.01 * least, True)):
        env = ecology.parallel_env(scenarios.load("commons", n=n, growth=GROWTH, capacity=CAPACITY, appetite=APPETITE))
        env.reset_arrays(seed=0)
        env.set_state(position=crowd(env.scenario.resources[0].position, n), stock=np.array([stock]))
        eat = np.full(n, env.groups["agent"].actions.index("consume_pool"))
        for _ in range(700):
            env.step_arrays(eat)
        assert (env.state_view.stock[0] > 0) == survives


@pytest.mark.parametrize("n", [10, 1000])
def test_the_world_grows_with_its_agents(n):
    """At any n there is a unit of area for each, and the pool's circle has room for all bodies."""
    scenario = scenarios.load("commons", n=n, walls=True, neighbours=8)
    (low, _), (high, _) = scenario.arena.extent
    assert (high - low) ** 2 == pytest.approx(n)
    pool, agent = scenario.resources[0], scenario.species[0]
    assert math.pi * pool.radius**2 > 2 * n * math.pi * agent.radius**2
    env = ecology.parallel_env(scenario)
    tick = env.reset_arrays(seed=0)
    assert sum("other" in name for name in env.groups["agent"].layout.names) == 16
    assert np.isfinite(tick.observations["agent"]).all()


def test_inner_walls_hide_what_lies_behind_them():
    """Two agents on both sides of an inner wall do not see each other; without it they do."""
    for walls in (True, False):
        env = ecology.parallel_env(scenarios.load("commons", n=16, walls=walls, neighbours=8))
        env.reset_arrays(seed=0)
        side = 4.0
        away = np.linspace(0.2, 3.8, 14)[:, None] * [1.0, 0.0] + [0.0, 3.8]  # the others, far off
        near = np.array([[side / 2 - 0.3, 0.3], [side / 2 + 0.3, 0.3]])
        tick = env.set_state(position=np.concatenate([near, away]))
        nearest = tick.observations["agent"][0][env.groups["agent"].layout.names.index("other_1_distance")]
        assert (nearest == pytest.approx(0.6, abs=1e-5)) == (not walls)
