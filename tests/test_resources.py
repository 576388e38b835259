"""Stocks are shared, grow, come, go and move as they say, and every quantity is accounted for."""

import itertools
import json
import math

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test
from scipy import integrate
from stocks import FOOD, HOOK, SQUARE, berries, crowd, eat, idle, world

import ecology
from ecology import (
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
    resources,
    rest,
    scenarios,
)
from ecology.agents import loop

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
        assert env.set_state(position=[[2.0, 2.0]], **gone).masks["agent"][0].tolist() == [True, False, False]
        assert env.set_state(position=[[3.0, 2.0]], **gone).masks["agent"][0].tolist() == [True, False, False]
        assert env.state_view.seen.all()
    assert env.set_state(available=[True]).masks["agent"][0].tolist() == [True, False, True]


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
    tick = env.set_state(available=[False])
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
    assert env.set_state(stock=[0.0]).masks["agent"][0].tolist() == [True, False, False]


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
    env.set_state(stock=np.array([0.0, 1.0, 0.7, np.inf, 0.0]), available=np.array([True, True, False, True, True]))
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
