"""Stocks are shared, grow, come, go and move as they say, and every quantity is accounted for."""

import dataclasses
import itertools
import json
import math

import numpy as np
import pytest
import shapely
from pettingzoo.test import parallel_api_test
from scipy import integrate

import ecology
from ecology import (
    Arena,
    Drift,
    EcologyError,
    Growth,
    Need,
    Oscillation,
    Relocation,
    Resource,
    Scenario,
    Season,
    Species,
    agents,
    consume,
    go_to,
    move,
    resources,
    rest,
    scenarios,
    turn,
)
from ecology.agents import loop
from ecology.ground import ground_of

SIDE = 4.0
SQUARE = Arena(vertices=((0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)))
HOOK = Arena(vertices=((0, 0), (4, 0), (4, 1), (1, 1), (1, 4), (0, 4)))
FOOD = Need(name="food", set_point=2.0, start=1.0)
CORNERS = np.array(SQUARE.vertices, float)


def berries(**words):
    """Return a resource in the middle that reaches all of the room, but for `words`."""
    return Resource(**{"name": "berries", "position": (2.0, 2.0), "radius": 3.0, **words})


def world(*resources, arena=SQUARE, dt=1.0, needs=(FOOD,), intake=None, count=1, more=(), **words):
    """Return the world of one species that eats `intake` of the first resource."""
    first = resources[0].name
    acts = (rest(), consume(first, intake or {"food": 0.1}), go_to(first, 0.1), *more)
    species = Species(**{"name": "agent", "needs": needs, "actions": acts, "count": count, **words})
    return ecology.parallel_env(Scenario(name="room", arena=arena, resources=resources, species=(species,), dt=dt))


def eat(env, ticks=1):
    """Make everyone consume for some ticks and return the last tick."""
    for _ in range(ticks):
        tick = env.step_arrays(np.ones(env.size, np.int64))
    return tick


def idle(env, ticks=1):
    """Make everyone rest for some ticks and return the last tick."""
    for _ in range(ticks):
        tick = env.step_arrays(np.zeros(env.size, np.int64))
    return tick


# ---- sharing -----------------------------------------------------------------------------


def test_a_short_stock_is_shared_in_proportion_to_what_is_asked():
    """Of 1.0 those who ask for 0.5 and 1.5 get 0.25 and 0.75; who asks elsewhere gets all."""
    part, eaten = resources.share(np.array([0.5, 1.5, 0.4]), np.array([0, 0, 1]), np.array([1.0, 9.0, 9.0]))
    assert part.tolist() == [0.5, 0.5, 1.0]
    assert eaten.tolist() == [1.0, 0.4, 0.0]


def test_an_empty_stock_gives_nothing_and_an_unlimited_one_everything():
    """The share of an empty stock is 0, that of an unlimited one 1."""
    part, eaten = resources.share(np.array([2.0, 3.0]), np.array([0, 1]), np.array([0.0, np.inf]))
    assert part.tolist() == [0.0, 1.0]
    assert eaten.tolist() == [0.0, 3.0]


def test_no_share_takes_more_than_there_is():
    """Whatever is asked, what leaves a stock is at most the stock and is what the eaters get."""
    rng = np.random.default_rng(0)
    for _ in range(500):
        n, r = int(rng.integers(1, 40)), int(rng.integers(1, 5))
        wanted, source = rng.exponential(1.0, n) * rng.integers(0, 2, n), rng.integers(0, r, n)
        stock = rng.exponential(5.0, r) * rng.integers(0, 2, r)
        part, eaten = resources.share(wanted, source, stock)
        assert (eaten <= stock).all()
        assert (part <= 1 + 2 * resources.CRUMB).all()
        got = np.bincount(source, wanted * part, minlength=r)
        assert got == pytest.approx(eaten, abs=1e-12)


def test_two_at_one_table_worked_by_hand():
    """Two agents ask for 0.1 each of a stock of 0.5: after 2 ticks 0.1 is left, then each gets 0.05."""
    env = world(berries(stock=0.5), count=2)
    env.reset_arrays(seed=0)
    eat(env, 2)
    assert env.state_view.stock == pytest.approx([0.1])
    assert env.state_view.internal[:, 0] == pytest.approx([1.2, 1.2])
    eat(env)
    assert env.state_view.stock.tolist() == [0.0]
    assert env.state_view.internal[:, 0] == pytest.approx([1.25, 1.25])
    tick = eat(env)
    assert tick.closed.all()
    assert env.state_view.internal[:, 0] == pytest.approx([1.25, 1.25])


def test_a_stock_is_eaten_up_in_as_many_ticks_as_it_holds():
    """Ten bites of 0.1 empty a stock of 1, although 0.1 has no exact binary form."""
    env = world(berries(stock=1.0))
    env.reset_arrays(seed=0)
    tick = eat(env, 10)
    assert env.state_view.stock.tolist() == [0.0]
    assert not tick.masks["agent"][0, 1]


def test_a_mixed_meal_counts_all_needs_that_it_feeds():
    """A meal of 0.1 food and 0.2 water takes 0.3; the fatigue of chewing takes nothing, and is scaled too."""
    needs = (
        FOOD,
        Need(name="water", set_point=1.0, start=0.0),
        Need(name="fatigue", set_point=0.0, bounds=(0.0, 9.0)),
    )
    meal = {"food": 0.1, "water": 0.2, "fatigue": 0.5}
    env = world(berries(stock=0.45), needs=needs, intake=meal)
    env.reset_arrays(seed=0)
    eat(env)
    assert env.state_view.stock == pytest.approx([0.15])
    eat(env)
    assert env.state_view.stock.tolist() == [0.0]
    assert env.state_view.internal[0] == pytest.approx([1.15, 0.3, 0.75])


def test_a_proportional_need_takes_u_times_x():
    """Where the control multiplies x, so does what leaves the stock: u x dt."""
    env = world(berries(stock=5.0), needs=(Need(name="food", set_point=2.0, start=1.5, proportional=True),), dt=0.5)
    env.reset_arrays(seed=0)
    eat(env)
    assert env.state_view.stock == pytest.approx([5.0 - 0.1 * 1.5 * 0.5])
    assert env.state_view.internal[0, 0] == pytest.approx(1.5 + 0.1 * 1.5 * 0.5)


# ---- when consuming and going there are open ------------------------------------------------


def test_empty_and_unavailable_close_consume_and_go_to():
    """A_zeta has consume inside and go_to outside only while there is some; sight does not change."""
    env = world(berries(radius=0.3, stock=1.0), position=(2.0, 2.0))
    tick = env.reset_arrays(seed=0)
    assert tick.masks["agent"][0].tolist() == [True, True, False]
    for gone in ({"stock": [0.0]}, {"stock": [1.0], "available": [False]}):
        assert env.put(position=[[2.0, 2.0]], **gone).masks["agent"][0].tolist() == [True, False, False]
        assert env.put(position=[[3.0, 2.0]], **gone).masks["agent"][0].tolist() == [True, False, False]
        assert env.state_view.seen.all()
    assert env.put(available=[True]).masks["agent"][0].tolist() == [True, False, True]


def test_an_unavailable_resource_gives_nothing_to_one_who_is_held_to_it():
    """A meal with a minimal duration goes on without food when the resource goes away."""
    env = ecology.parallel_env(
        Scenario(
            name="room",
            arena=SQUARE,
            resources=(berries(stock=1.0),),
            species=(
                Species(name="agent", needs=(FOOD,), actions=(rest(), consume("berries", {"food": 0.1}, duration=5.0))),
            ),
        )
    )
    env.reset_arrays(seed=0)
    eat(env)
    tick = env.put(available=[False])
    assert tick.masks["agent"][0].tolist() == [False, True]
    eat(env)
    assert env.state_view.internal[0, 0] == pytest.approx(1.1)
    assert env.state_view.stock == pytest.approx([0.9])


def test_a_committed_walk_ends_where_there_is_nothing_left():
    """Who is committed to a go_to is free again when the resource is eaten up meanwhile."""
    env = world(berries(radius=0.3, stock=1.0), position=(0.5, 0.5), commitment="committed")
    env.reset_arrays(seed=0)
    tick = env.step_arrays(np.array([2]))
    assert tick.masks["agent"][0].tolist() == [False, False, True]
    assert env.put(stock=[0.0]).masks["agent"][0].tolist() == [True, False, False]


# ---- growing -----------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.125])
def test_linear_growth_is_exact_and_stops_at_the_capacity(dt):
    """S(t) = min(S0 + rate t, K), whatever the tick."""
    env = world(berries(stock=1.0, capacity=3.0, growth=Growth(rate=0.25)), dt=dt)
    env.reset_arrays(seed=0)
    for k in range(1, int(12 / dt) + 1):
        idle(env)
        assert env.state_view.stock == pytest.approx([min(1.0 + 0.25 * k * dt, 3.0)], abs=1e-12)


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_logistic_growth_is_its_closed_form(dt):
    """S(t) = K / (1 + (K / S0 - 1) exp(-r t)), whatever the tick, while nobody eats."""
    env = world(berries(stock=0.5, capacity=8.0, growth=Growth(kind="logistic", rate=0.3)), dt=dt)
    env.reset_arrays(seed=0)
    for k in range(1, int(40 / dt) + 1):
        idle(env)
        exact = 8.0 / (1 + (8.0 / 0.5 - 1) * math.exp(-0.3 * k * dt))
        assert env.state_view.stock == pytest.approx([exact], rel=1e-12)


def test_logistic_growth_under_harvest_converges_as_dt_shrinks():
    """dS/dt = r S (1 - S / K) - h is met with an error in proportion to dt."""
    rate, most, harvest, until = 0.3, 8.0, 0.4, 20.0
    exact = integrate.solve_ivp(
        lambda _, s: rate * s * (1 - s / most) - harvest, (0, until), [3.0], rtol=1e-10, atol=1e-12
    ).y[0, -1]
    errors = []
    for dt in (1.0, 0.5, 0.25, 0.125):
        growth = Growth(kind="logistic", rate=rate)
        env = world(berries(stock=3.0, capacity=most, growth=growth), dt=dt, intake={"food": harvest})
        env.reset_arrays(seed=0)
        eat(env, int(until / dt))
        errors.append(abs(env.state_view.stock[0] - exact))
    assert errors[-1] < 0.01 * exact
    assert [a / b for a, b in itertools.pairwise(errors)] == pytest.approx([2.0] * 3, abs=0.35)


@pytest.mark.parametrize("kind", ["linear", "logistic"])
def test_a_season_multiplies_growth(kind):
    """Growth in a season is the integral of rate times 1 + A sin(2 pi t / P + phase)."""
    season = Season(amplitude=0.8, period=30.0, phase=0.4)
    rate, most = 0.1, 20.0
    env = world(berries(stock=1.0, capacity=most, growth=Growth(kind=kind, rate=rate, season=season)))
    env.reset_arrays(seed=0)
    idle(env, 50)

    def velocity(t, s):
        now = rate * (1 + 0.8 * math.sin(2 * math.pi * t / 30.0 + 0.4))
        return now if kind == "linear" else now * s * (1 - s / most)

    exact = integrate.solve_ivp(velocity, (0, 50), [1.0], rtol=1e-10, atol=1e-12, max_step=1.0).y[0, -1]
    assert env.state_view.stock == pytest.approx([exact], rel=1e-7)


def test_what_is_eaten_up_regrows_linearly_but_not_logistically():
    """A stock eaten up in a tick gets rate dt from linear growth, and nothing, ever, from logistic growth."""
    for growth, expected in ((Growth(rate=0.25), 0.25), (Growth(kind="logistic", rate=0.25), 0.0)):
        env = world(berries(stock=1.0, growth=growth), intake={"food": 1.0})
        env.reset_arrays(seed=0)
        eat(env)
        assert env.state_view.stock.tolist() == [expected]
        idle(env)
        assert env.state_view.stock.tolist() == [2 * expected]


def test_a_stock_eaten_as_fast_as_it_regrows_stays_full():
    """Growth and eating happen over the same tick: a full stock that regrows 0.1 bears a harvest of 0.1."""
    env = world(berries(stock=2.0, growth=Growth(rate=0.1)))
    env.reset_arrays(seed=0)
    eat(env, 30)
    assert env.state_view.stock == pytest.approx([2.0], abs=1e-12)
    assert env.state_view.grown == pytest.approx([3.0])


def test_smaller_ticks_eat_and_grow_the_same():
    """A crowd that empties a regrowing stock has eaten as much by time 40, up to the tick's error."""
    eaten = []
    for dt in (1.0, 0.5, 0.25, 0.125):
        env = world(berries(stock=3.0, growth=Growth(rate=0.2)), dt=dt, count=3)
        env.reset_arrays(seed=0)
        eat(env, int(40 / dt))
        eaten.append(env.state_view.eaten[0])
    assert eaten == pytest.approx([3.0 + 0.2 * 40] * 4, abs=0.21)
    assert abs(eaten[-1] - 11.0) < 0.03


# ---- coming and going ----------------------------------------------------------------------


def presence(availability, dt, units, seed=0):
    """Return whether the resource is available at every tick, (ticks,)."""
    env = world(berries(availability=availability), dt=dt)
    env.reset_arrays(seed=seed)
    found = [env.state_view.available[0]]
    for _ in range(round(units / dt) - 1):
        idle(env)
        found.append(env.state_view.available[0])
    return np.array(found)


def test_availability_is_its_probability_without_memory():
    """Over 4000 units of time the share is p, and one unit says nothing of the next, within 4 sigma."""
    p, n = 0.8, 4000
    there = presence(p, 1.0, n).astype(float)
    assert there.mean() == pytest.approx(p, abs=4 * math.sqrt(p * (1 - p) / n))
    assert np.corrcoef(there[:-1], there[1:])[0, 1] == pytest.approx(0.0, abs=4 / math.sqrt(n))


def test_ticks_of_any_length_see_one_course_of_availability():
    """The same seed gives the same course in time for every dt: a draw at each whole unit of time."""
    one = presence(0.5, 1.0, 60, seed=4)
    for parts in (2, 4, 10):
        assert np.array_equal(np.repeat(one, parts), presence(0.5, 1 / parts, 60, seed=4))
    assert np.array_equal(one[::2], presence(0.5, 2.0, 60, seed=4))
    third = presence(0.5, 0.3, 60, seed=4)
    assert np.array_equal(third, one[np.floor(0.3 * np.arange(200) + 1e-9).astype(int)])


def test_a_unit_of_time_begins_despite_rounding():
    """100 ticks of 0.29 are 29 units of time, although their product in floats is a little less."""
    assert 100 * 0.29 < 29
    assert resources.whole_units(100 * 0.29) == 29


def test_certain_and_impossible_availability():
    """With probability 1 a resource is always there, with 0 never."""
    assert presence(1.0, 1.0, 50).all()
    assert not presence(0.0, 1.0, 50).any()


# ---- moving ------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [50.0, 12.5])
def test_an_oscillation_is_a_triangle_wave(dt):
    """From 0.5 to 1.5 in a period of 1000: 0.5, 0.75, 1.0, 1.25, 1.5 and back, whatever the tick."""
    env = world(berries(position=(0.5, 3.0), motion=Oscillation(to=(1.5, 3.0), period=1000.0)), dt=dt)
    env.reset_arrays(seed=0)
    wave = {0: 0.5, 150: 0.8, 250: 1.0, 400: 1.3, 500: 1.5, 600: 1.3, 750: 1.0, 1000: 0.5, 1250: 1.0}
    for k in range(int(1250 / dt) + 1):
        if k:
            idle(env)
        if k * dt in wave:
            assert env.state_view.resource_position[0] == pytest.approx([wave.pop(k * dt), 3.0], abs=1e-12)
    assert not wave


def test_the_phase_of_an_oscillation():
    """Phase pi starts at the other end, pi / 2 half way there."""
    for phase, x in ((math.pi, 3.0), (math.pi / 2, 2.0), (-math.pi / 2, 2.0)):
        env = world(berries(position=(1.0, 1.0), motion=Oscillation(to=(3.0, 3.0), period=10.0, phase=phase)))
        env.reset_arrays(seed=0)
        assert env.state_view.resource_position[0] == pytest.approx([x, x])


def test_reach_follows_a_moving_resource():
    """Consume opens when the resource comes to the agent and closes when it has left."""
    motion = Oscillation(to=(3.5, 2.0), period=20.0)
    env = world(Resource(name="berries", position=(0.5, 2.0), motion=motion), position=(2.0, 3.0 - 0.75))
    tick = env.reset_arrays(seed=0)
    opened = [bool(tick.masks["agent"][0, 1])]
    opened += [bool(idle(env).masks["agent"][0, 1]) for _ in range(20)]
    assert [t for t, there in enumerate(opened) if there] == [5, 15]


def test_a_walk_mirrored_at_walls_worked_by_hand():
    """A step into a wall ends at its mirror image; into a corner, mirrored twice; in the free, as it is."""
    for start, step, end in (
        ((3.0, 2.0), (2.0, 1.0), (3.0, 3.0)),
        ((3.0, 3.0), (2.0, 1.5), (3.0, 3.5)),
        ((1.0, 1.0), (0.5, 0.25), (1.5, 1.25)),
        ((1.0, 2.0), (-8.0, 0.0), (1.0, 2.0)),  # to the left wall, the right one, and back
    ):
        assert ground_of(SQUARE).reflect(np.array(start), np.array(step)) == pytest.approx(end)


@pytest.mark.parametrize("arena", [SQUARE, HOOK])
def test_a_drift_stays_inside_and_gets_everywhere(arena):
    """However wide the steps, the circle's centre stays in the arena, and in the end is equally likely anywhere."""
    ground, rng = ground_of(arena), np.random.default_rng(2)
    place, path = np.array([0.5, 0.5]), []
    for _ in range(8000):
        place = ground.reflect(place, 0.6 * rng.standard_normal(2))
        path.append(place)
    polygon = shapely.Polygon(arena.vertices)
    assert polygon.contains(shapely.points(path)).all()
    share = shapely.box(0, 0, 2, 2).intersection(polygon).area / polygon.area
    assert shapely.box(0, 0, 2, 2).covers(shapely.points(path)).mean() == pytest.approx(share, abs=0.08)


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_a_drift_spreads_with_the_root_of_time(dt):
    """Far from walls the variance along each axis is spread^2 t, whatever the tick."""
    many = tuple(Resource(name=f"r{i}", position=(2.0, 2.0), motion=Drift(spread=0.05)) for i in range(400))
    env = world(*many, dt=dt)
    env.reset_arrays(seed=1)
    idle(env, int(16 / dt))
    moved = env.state_view.resource_position - 2.0
    assert moved.var(axis=0) == pytest.approx([0.05**2 * 16] * 2, rel=4 * math.sqrt(2 / 400))


def test_relocation_inside_the_arena_with_a_new_stock():
    """A stock that is eaten up reappears elsewhere, its circle inside the arena, as it was at the start."""
    env = world(
        Resource(name="berries", radius=0.4, stock=0.2, capacity=1.0, motion=Relocation()),
        arena=HOOK,
        senses=(),
        view_angle=1.0,
    )
    env.reset_arrays(seed=3)
    room = shapely.Polygon(HOOK.vertices).buffer(-0.4, join_style="mitre").buffer(1e-9)
    places = [env.state_view.resource_position[0].copy()]
    for _ in range(40):
        env.put(position=env.state_view.resource_position)
        eat(env)
        assert env.state_view.stock == pytest.approx([0.1])
        assert np.array_equal(env.state_view.resource_position[0], places[-1])
        eat(env)
        assert env.state_view.stock == pytest.approx([0.2])
        places.append(env.state_view.resource_position[0].copy())
    assert room.covers(shapely.points(places)).all()
    assert len(np.unique(places, axis=0)) == 41
    assert env.state_view.grown == pytest.approx([8.0])


def test_who_was_on_the_way_does_not_know_where_it_went():
    """A go_to under way to a resource that has relocated is open only if the new place is seen."""
    env = world(
        berries(radius=0.3, stock=0.1, motion=Relocation()),
        count=2,
        view_range=1.5,
        view_angle=2 * math.pi,
        radius=0.05,
    )
    lost = 0
    for seed in range(12):
        env.reset_arrays(seed=seed)
        env.put(position=[[2.0, 2.0], [2.0, 3.0]])
        env.step_arrays(np.array([1, 2]))
        state = env.state_view
        assert state.bound_for[1] == -1
        gap = np.hypot(*(state.resource_position[0] - state.position[1]))
        walks_on = bool(env.put().masks["agent"][1, 2])
        assert walks_on == (0.3 < gap <= 1.5)
        lost += not walks_on
    assert 0 < lost < 12


def test_scattered_resources_are_placed_anew_by_every_seed():
    """A resource without a position lies anywhere that its circle fits, the same for the same seed."""
    env = world(*(Resource(name=f"r{i}", radius=0.3) for i in range(30)), arena=HOOK)
    places = []
    for seed in (1, 2, 1):
        env.reset_arrays(seed=seed)
        places.append(env.state_view.resource_position.copy())
    assert np.array_equal(places[0], places[2])
    assert not np.isclose(places[0], places[1]).any()
    room = shapely.Polygon(HOOK.vertices).buffer(-0.3 + 1e-9, join_style="mitre")
    assert room.covers(shapely.points(places[0])).all()


# ---- the account -------------------------------------------------------------------------


def crowd(dt=1.0):
    """Return a crowded room in which everything happens: 30 hungry agents, 4 kinds of stock, deaths."""
    needs = (
        Need(name="food", set_point=2.0, start=1.0, decay=0.05, bounds=(0.0, 4.0), lethal=True),
        Need(name="water", set_point=1.0, leak=0.02, proportional=True, bounds=(0.1, 1.5)),
        Need(name="fatigue", set_point=0.0, decay=-0.01, noise=0.05, bounds=(0.0, 3.0)),
    )
    stocks = (
        Resource(name="pool", position=(1.0, 1.0), radius=1.0, stock=9.0, growth=Growth(kind="logistic", rate=0.1)),
        Resource(name="grass", radius=1.0, stock=1.0, growth=Growth(rate=0.2), motion=Drift(spread=0.1)),
        Resource(name="prey", radius=1.0, stock=0.7, motion=Relocation(), availability=0.7),
        Resource(name="spring", position=(1.0, 3.0), radius=1.0, motion=Oscillation(to=(3.0, 3.0), period=40.0)),
        Resource(
            name="moss",
            position=(3.0, 1.0),
            radius=1.0,
            stock=0.0,
            capacity=5.0,
            growth=Growth(rate=0.5, season=Season(amplitude=1.0, period=25.0)),
        ),
    )
    actions = (
        rest(),
        move("walk", 0.2, control={"fatigue": 0.02}),
        turn("turn", 1.0),
        *(
            consume(r.name, {"food": 0.15, "water": 0.1 * i, "fatigue": 0.01}, closes_at={"food": 3.5})
            for i, r in enumerate(stocks)
        ),
        *(go_to(r.name, 0.2) for r in stocks),
    )
    species = Species(name="agent", needs=needs, actions=actions, count=30, radius=0.05)
    return ecology.parallel_env(Scenario(name="crowd", arena=SQUARE, resources=stocks, species=(species,), dt=dt))


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
    env.put(position=env.state_view.resource_position[:1])
    act = env.groups["agent"].actions.index("consume_food_1")
    for _ in range(5):
        env.step_arrays(np.array([act]))
    state = env.state_view
    assert state.eaten.tolist() == state.grown.tolist() == pytest.approx([0.5, 0, 0, 0])
    assert state.ingested[0] == pytest.approx([0.5, 0, 0, 0, 0, 0])
    assert np.isinf(state.stock).all()


# ---- the world around ----------------------------------------------------------------------


def test_the_same_seed_gives_the_same_stocks(random_actions):
    """Growth, availability, drift, relocation and scattering follow from the seed, bit for bit."""
    ends = []
    for _ in range(2):
        env, rng = crowd(), np.random.default_rng(3)
        tick = env.reset_arrays(seed=8)
        for _ in range(150):
            tick = env.step_arrays(random_actions(env, tick, rng))
        ends.append(env.state_view.copy())
    for name, values in ends[0].arrays().items():
        assert np.array_equal(values, ends[1].arrays()[name]), name


def test_a_restored_crowd_lives_on_as_the_one_that_was_left(random_actions):
    """A snapshot holds stocks, availability, places, the account and their random streams."""
    env, other, rng = crowd(), crowd(), np.random.default_rng(6)
    tick = env.reset_arrays(seed=9)
    for _ in range(60):
        tick = env.step_arrays(random_actions(env, tick, rng))
    arrays, values = env.snapshot()
    assert {"stock", "available", "grown", "eaten", "ingested", "metabolised", "lost"} <= arrays.keys()
    again = other.restore(arrays, json.loads(json.dumps(values)))
    for _ in range(150):
        assert np.array_equal(tick.masks["agent"], again.masks["agent"])
        wanted = random_actions(env, tick, rng)
        tick, again = env.step_arrays(wanted), other.step_arrays(wanted)
    for name, array in env.state_view.arrays().items():
        assert np.array_equal(array, other.state_view.arrays()[name]), name


def test_resources_draw_from_streams_of_their_own():
    """Resources that come, go and move leave births and noise as they are."""
    lives = []
    for food in (berries(), berries(position=None, radius=0.5, availability=0.5, motion=Drift(spread=0.2))):
        env = world(food, needs=(Need(name="food", set_point=2.0, noise=0.1),), count=3)
        env.reset_arrays(seed=2)
        birth = env.state_view.position.copy()
        idle(env, 20)
        lives.append((birth, env.state_view.internal.copy()))
    assert np.array_equal(lives[0][0], lives[1][0])
    assert np.array_equal(lives[0][1], lives[1][1])


def test_the_streams_of_births_and_noise_are_the_first_two():
    """New concerns come after the old ones, so that lives known from before stay as they are."""
    env = world(berries(), needs=(Need(name="food", set_point=2.0, noise=0.1),), count=3)
    env.reset_arrays(seed=2)
    idle(env)
    noise = np.random.default_rng(np.random.SeedSequence(2).spawn(2)[1]).standard_normal(3)
    assert env.state_view.internal[:, 0] == pytest.approx(2.0 + 0.1 * noise)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_pettingzoo_accepts_a_crowd_around_stocks():
    """PettingZoo's own parallel_api_test passes, and the picture draws full, empty and absent stocks."""
    parallel_api_test(crowd(), num_cycles=60)
    env = crowd()
    env.render_mode = "rgb_array"
    env.reset_arrays(seed=0)
    full = env.render()
    env.put(stock=np.array([0.0, 1.0, 0.7, np.inf, 0.0]), available=np.array([True, True, False, True, True]))
    assert (full != env.render()).any()


def test_a_yardstick_that_counts_on_constant_resources_declines_others():
    """Planner and camping know worlds of unlimited fixed resources and say so elsewhere."""
    from ecology.agents.planner import know

    assert know(scenarios.load("paper"), ecology.parallel_env(scenarios.load("paper")).groups["agent"])
    env = crowd()
    with pytest.raises(EcologyError, match=r"unlimited.*'pool'.*Leave planner and camping out"):
        know(env.scenario, env.groups["agent"])


def test_a_learner_lives_around_stocks():
    """The f/J learner acts on the open actions of a world whose resources run out and move."""
    env = crowd()
    learner = agents.make("hjb", env.groups["agent"], np.random.SeedSequence(0), {})
    loop.run(env, {"agent": learner}, env.reset_arrays(seed=0), ticks=40)
    assert env.state_view.tick == 40


# ---- contradictions ------------------------------------------------------------------------

WRONG = {
    "more than it holds": (lambda: berries(stock=3.0, capacity=2.0), ["'berries'", "stock 3.0", "capacity 2.0"]),
    "unlimited in a bowl": (lambda: berries(capacity=2.0), ["stock inf", "capacity 2.0"]),
    "a negative stock": (lambda: berries(stock=-1.0), ["stock", "at least 0", "-1.0"]),
    "a stock of NaN": (lambda: berries(stock=math.nan), ["stock", "nan"]),
    "a stock of words": (lambda: berries(stock="much"), ["stock", "'much'"]),
    "more than unlimited": (lambda: berries(growth=Growth(rate=0.1)), ["finite stock", "inf"]),
    "growth without room": (lambda: berries(stock=0.0, growth=Growth(rate=0.1)), ["room", "capacity"]),
    "logistic from nothing": (
        lambda: berries(stock=0.0, capacity=3.0, growth=Growth(kind="logistic", rate=0.1)),
        ["logistic", "stock 0.0"],
    ),
    "logistic without end": (
        lambda: berries(stock=1.0, capacity=math.inf, growth=Growth(kind="logistic", rate=0.1)),
        ["logistic", "finite capacity", "inf"],
    ),
    "a growth of its own kind": (lambda: Growth(kind="cubic", rate=0.1), ["'linear'", "'cubic'"]),
    "shrinking": (lambda: Growth(rate=-0.1), ["rate", "positive", "-0.1"]),
    "a season below nothing": (
        lambda: Growth(rate=0.1, season=Season(amplitude=1.5, period=9.0)),
        ["amplitude", "[-1, 1]", "1.5"],
    ),
    "more than certain": (lambda: berries(availability=1.2), ["probability", "1.2"]),
    "a motion of words": (lambda: berries(motion="drift"), ["motion", "'drift'"]),
    "a wave from nowhere": (
        lambda: berries(position=None, motion=Oscillation(to=(1, 1), period=5.0)),
        ["position", "None"],
    ),
    "a wave without time": (lambda: Oscillation(to=(1, 1), period=0.0), ["period", "positive", "0.0"]),
    "a wave in space": (lambda: Oscillation(to=(1, 1, 1), period=5.0), ["(x, y)", "(1, 1, 1)"]),
    "a drift on the spot": (lambda: Drift(spread=0.0), ["spread", "positive", "0.0"]),
    "waiting for ever": (lambda: berries(motion=Relocation()), ["finite stock", "inf"]),
    "a wave out of the arena": (
        lambda: world(berries(motion=Oscillation(to=(5.0, 2.0), period=5.0))),
        ["'berries'", "(5.0, 2.0)", "leaves the arena"],
    ),
    "a wave through a wall": (
        lambda: world(berries(position=(0.5, 3.5), motion=Oscillation(to=(3.5, 0.5), period=5.0)), arena=HOOK),
        ["(3.5, 0.5)", "no wall between"],
    ),
    "no room to scatter": (lambda: world(berries(position=None)), ["radius 3.0", "no room"]),
    "no room to relocate": (lambda: world(berries(stock=1.0, motion=Relocation())), ["radius 3.0", "no room"]),
    "a meal that feeds nobody": (
        lambda: world(berries(stock=1.0), intake={"food": -0.1}),
        ["'consume_berries'", "finite stock", "raises no need"],
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_contradiction_is_named(what):
    """Words of a resource that contradict each other are refused with the rule and the value."""
    make, words = WRONG[what]
    with pytest.raises(EcologyError) as caught:
        make()
    for word in words:
        assert word in str(caught.value), str(caught.value)


def test_the_default_is_what_it_was():
    """Without further words a resource is unlimited, fixed and always available."""
    plain = Resource(name="berries", position=(1.0, 1.0))
    assert plain.constant
    for word in (
        {"stock": 1.0},
        {"availability": 0.9},
        {"motion": Drift(spread=0.1)},
        {"position": None},
    ):
        assert not Resource(**{"name": "berries", "position": (1.0, 1.0), **word}).constant


# ---- food that bodies can reach ----------------------------------------------------------------


def large(*foods, radius=0.8, arena=SQUARE, **words):
    """Return a room of `foods` and of one body of `radius` that eats them all."""
    eats = (consume(food.name, {"food": 0.1}) for food in foods)
    body = Species(name="agent", needs=(FOOD,), actions=(rest(), *eats), radius=radius, **words)
    return Scenario(name="large", arena=arena, resources=foods, species=(body,))


def reached(scenario, places):
    """Return in which circles at `places` (n, 2) the centre of the first species' body can lie, (n,)."""
    free = shapely.Polygon(scenario.arena.vertices).buffer(-scenario.species[0].radius)
    return free.distance(shapely.points(places)) <= scenario.resources[0].radius + 1e-9


@pytest.mark.parametrize("arena", [SQUARE, Arena(vertices=((0, 0), (6, 0), (6, 1.7), (3, 1.7), (3, 4), (0, 4)))])
def test_food_is_scattered_where_a_large_body_can_eat_it(arena):
    """None of sixty small patches lies where a large body cannot reach it, at the start and after a relocation."""
    food = Resource(name="food", count=60, radius=0.3, stock=1.0, motion=Relocation())
    scenario = large(food, arena=arena)
    env = ecology.parallel_env(scenario)
    env.reset_arrays(seed=0)
    assert reached(scenario, env.state_view.resource_position).all()
    table = resources.compile_resources(scenario.resources, arena, scenario.species)
    before = env.state_view.resource_position
    places, gone = resources.relocate(table, before, np.ones(60, bool), np.random.default_rng(1))
    assert gone.all()
    assert (places != before).any(axis=1).all()
    assert reached(scenario, places).all()
    alone = resources.compile_resources(scenario.resources, arena)  # which nobody eats
    assert not reached(scenario, resources.first_places(alone, np.random.default_rng(1))).all()


@pytest.mark.parametrize(
    ("food", "good"),
    [
        (Resource(name="food", position=(0.3, 2.0), radius=0.3), False),
        (Resource(name="food", position=(0.55, 2.0), radius=0.3), True),
        (Resource(name="food", position=(0.55, 0.55), radius=0.3), False),  # the corner is farther than the wall
        (Resource(name="food", position=(0.3, 2.0), radius=0.3, motion=Oscillation(to=(2.0, 2.0), period=9.0)), True),
        (Resource(name="food", position=(0.3, 1.0), radius=0.3, motion=Oscillation(to=(0.3, 2.0), period=9.0)), False),
        (Resource(name="food", position=(0.3, 2.0), radius=0.3, motion=Drift(spread=0.1)), True),
        (Resource(name="food", position=(0.3, 2.0), radius=0.3, stock=1.0, motion=Relocation()), False),
    ],
)
def test_food_that_no_body_can_reach_is_refused(food, good):
    """A patch that its eaters never come into is refused with its place and the body; one of many eaters is enough."""
    if good:
        large(food)
    else:
        with pytest.raises(EcologyError, match=r"'food': at \(0.*too near to a wall .* of 'agent', has the radius 0.8"):
            large(food)
    small = Species(name="small", needs=(FOOD,), actions=(rest(), consume("food", {"food": 0.1})), radius=0.1)
    onlooker = dataclasses.replace(small, name="onlooker", actions=(rest(),), radius=0.9)
    for species in ((*large(dataclasses.replace(food, position=(2.0, 2.0), motion=None)).species, small), (onlooker,)):
        Scenario(name="shared", arena=SQUARE, resources=(food,), species=species)
    torus = dataclasses.replace(SQUARE, walls=False)
    large(food, arena=torus)
