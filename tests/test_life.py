"""Births, arrivals, deaths, slots and names."""

import math

import numpy as np
import pytest
import shapely
from worlds import BAY, ask, everything, kind, square, start

import ecology
from ecology import Arena, Birth, EcologyError, Hazard, Need, bite, life
from ecology.ground import ground_of, scatter
from ecology.state import CAUSES

SURE = 1e3  # a rate at which what can happen happens in every tick


def rest(env, ticks=1):
    """Make everyone rest for some ticks and return the last tick."""
    for _ in range(ticks):
        tick = env.step_arrays(np.zeros(env.size, np.int64))
    return tick


def cause(env, slot):
    """Return what the agent in `slot` died of."""
    return CAUSES[env.state_view.cause[slot]]


# ---- births ----------------------------------------------------------------------------------


def test_a_birth_worked_by_hand():
    """A fit parent pays its cost and bears into a free slot, beside itself, one whose needs are at their start."""
    needs = (Need(name="food", set_point=2.0, start=1.0, bounds=(0.0, 4.0)), Need(name="calm", set_point=1.0))
    birth = Birth(rate=SURE, threshold={"food": 1.5}, cost={"food": 0.5})
    env = start(square(kind(capacity=3, needs=needs, birth=birth)), internal=[[1.75, 0.5], [0, 0], [0, 0]])
    env.set_state(position=[[4.0, 4.0], [0.0, 0.0], [0.0, 0.0]])
    tick, state = rest(env), env.state_view
    assert tick.born.tolist() == [False, True, False]
    assert tick.parent.tolist() == [-1, 0, -1]
    assert state.internal[:2].tolist() == [[1.25, 0.5], [1.0, 1.0]]
    assert state.given[0].tolist() == [0.5, 0.0]
    assert state.received[1].tolist() == [1.0, 1.0]
    assert (state.serial[1], state.parent[1], state.age[1], state.next_serial) == (1, 0, 0.0, 2)
    assert math.dist(state.position[0], state.position[1]) == pytest.approx(2 * 0.1)
    assert tick.reward[0] == pytest.approx(math.hypot(0.25, 0.5) - math.hypot(0.75, 0.5), abs=1e-3)  # it is felt
    assert tick.reward[1] == 0.0
    rest(env, 20)
    assert env.state_view.alive.tolist() == [True, True, False]  # neither has 1.5 of food any more


@pytest.mark.parametrize(("food", "calm", "bears"), [(1.5, 1.0, True), (1.499, 1.0, False), (1.5, 0.999, False)])
def test_every_threshold_must_be_reached(food, calm, bears):
    """A parent is fit from its thresholds on, all of them."""
    needs = (Need(name="food", set_point=2.0), Need(name="calm", set_point=1.0))
    birth = Birth(rate=SURE, threshold={"calm": 1.0, "food": 1.5})
    env = start(square(kind(capacity=2, needs=needs, birth=birth)), internal=[[food, calm], [0, 0]])
    assert rest(env, 5).alive[1] == bears


@pytest.mark.parametrize("dt", [1.0, 0.5])
def test_one_is_fit_from_its_maturity_on(dt):
    """With maturity 5 the first is born at time 5, and the first grandchild at time 10."""
    env = start(square(kind(capacity=30, birth=Birth(rate=SURE, maturity=5.0)), dt=dt))
    born, generation = {}, {0: 0}
    for _ in range(round(11 / dt)):
        tick, state = rest(env), env.state_view
        for slot in np.flatnonzero(tick.born):
            generation[state.serial[slot]] = 1 + generation[state.parent[slot]]
            born.setdefault(generation[state.serial[slot]], state.time)
    assert born == {1: 5.0, 2: 10.0}


def test_without_a_free_slot_it_waits():
    """A full species bears nobody and pays nothing; a slot rests for the tick of the death, then it is taken."""

    def strike(world, rng):
        outcome = world.no_effect()
        outcome.killed[1] = world.state.tick == 5
        return outcome

    env = start(square(kind(count=2, birth=Birth(rate=SURE, cost={"food": 0.5}, threshold={"food": 1.0})), rule=strike))
    assert not rest(env, 5).born.any()
    assert not env.state_view.given.any()
    tick = rest(env)
    assert (tick.died.tolist(), tick.born.any()) == ([False, True], False)
    assert env.state_view.serial[1] == 1  # the row stays for that tick
    tick = rest(env)
    assert tick.born.tolist() == [False, True]
    assert env.state_view.serial[1] == 2
    assert env.state_view.internal[:, 0].tolist() == [1.5, 2.0]


def test_one_room_for_many_parents_goes_to_each_alike():
    """Of four fit parents and one slot, one bears, each in about a quarter of the cases (4 sigma)."""
    birth, rng = Birth(rate=SURE), np.random.default_rng(0)
    able, found = np.ones(4, bool), np.zeros(4)
    for _ in range(800):
        who = life.bearers(birth, able, 1, 1.0, rng)
        assert len(who) == 1
        found[who] += 1
    assert np.abs(found - 200).max() < 4 * math.sqrt(800 * 0.25 * 0.75)


@pytest.mark.parametrize("dt", [1.0, 0.1])
def test_births_come_at_their_rate(dt):
    """300 parents at 0.2 per unit of time bear 300 (1 - exp(-0.2 dt)) in each tick, within 4 sigma over 5 units."""
    birth = Birth(rate=0.2, maturity=100.0)
    env = start(square(kind(count=300, capacity=900, birth=birth), walls=False, dt=dt))
    env.set_state(age=np.where(env.state_view.alive, 100.0, 0.0))
    ticks = round(5 / dt)
    rest(env, ticks)
    p = -math.expm1(-0.2 * dt)
    assert abs(env.state_view.alive.sum() - 300 - 300 * ticks * p) < 4 * math.sqrt(300 * ticks * p * (1 - p))


def test_newborns_start_inside_and_clear_of_walls():
    """Whatever corner the parent stands in, its newborn lies in the arena and a radius from its walls, or where it is.

    Shapely says what is inside.
    """
    arena, rng, radius = Arena(vertices=BAY), np.random.default_rng(1), 0.3
    room = shapely.Polygon(BAY)
    parents = np.concatenate([scatter(arena, 1e-6, 300, rng), [[0.01, 0.01], [4.41, 7.99], [7.99, 0.01]]])
    places = life.beside(ground_of(arena), parents, radius, rng)
    free = room.buffer(-radius + 1e-9)
    stays = (places == parents).all(axis=1)
    assert stays.mean() < 0.2
    assert all(free.covers(shapely.Point(p)) for p in places[~stays])
    assert np.allclose(np.hypot(*(places - parents)[~stays].T), 2 * radius)


@pytest.mark.parametrize("dt", [1.0, 0.5])
def test_arrivals_are_poisson(dt):
    """Newcomers per tick have the mean and the variance arrival dt, within 4 sigma, and no parent."""
    ticks, mean = 300, 2.0 * dt
    env = start(square(kind(count=0, capacity=900, arrival=2.0), walls=False, dt=dt), seed=3)
    counts = []
    for _ in range(ticks):
        tick = rest(env)
        counts.append(tick.born.sum())
        assert (tick.parent == -1).all()
    assert abs(np.mean(counts) - mean) < 4 * math.sqrt(mean / ticks)
    assert abs(np.var(counts) - mean) < 4 * math.sqrt((mean + 2 * mean**2) / ticks)  # of a Poisson variable's variance


def test_arrivals_stop_at_the_capacity():
    """However many come, no more live than there are slots, and every slot is taken in time."""
    env = start(square(kind(count=1, capacity=4, arrival=50.0)))
    assert rest(env).alive.sum() == 4
    assert rest(env, 5).alive.sum() == 4
    assert env.state_view.next_serial == 4


# ---- deaths ----------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [1.0, 0.25, 10.0])
@pytest.mark.parametrize(("rate", "ageing"), [(0.02, 0.0), (0.002, 0.1), (0.05, -0.05)])
def test_survival_is_gompertz(rate, ageing, dt):
    """After 30 units S = exp(-rate (exp(ageing t) - 1) / ageing) are left, or exp(-rate t), whatever the tick."""
    n, t = 2000, 30.0
    env = start(square(kind(count=n, hazard=Hazard(rate=rate, ageing=ageing)), walls=False, dt=dt), seed=4)
    rest(env, round(t / dt))
    share = math.exp(-rate * (math.expm1(ageing * t) / ageing if ageing else t))
    assert abs(env.state_view.alive.mean() - share) < 4 * math.sqrt(share * (1 - share) / n)
    assert {cause(env, slot) for slot in np.flatnonzero(~env.state_view.alive)} == {"hazard"}


def test_every_death_has_its_cause():
    """Of a lethal need, a bite, by chance and by the rule; who is bitten while it starves was eaten.

    The need is named, and the killer; a newborn has neither.
    """
    lethal = (Need(name="food", set_point=2.0, decay=1.0, bounds=(0.0, 4.0), lethal=True),)

    def strike(world, rng):
        outcome = world.no_effect()
        outcome.killed[world.slots["struck"]] = True
        return outcome

    scenario = square(
        kind("wolf", bite("bitten", reach=1.0), count=1, position=(2.0, 2.0)),
        kind("bitten", count=1, position=(2.0, 2.5), needs=lethal),
        kind("starved", needs=lethal, capacity=2, arrival=SURE),
        kind("failed", hazard=Hazard(rate=SURE)),
        kind("struck"),
        rule=strike,
    )
    env = start(scenario, internal=[[2.0], [0.5], [0.5], [0.0], [2.0], [2.0]])
    tick, now = env.step_arrays(ask(env, wolf="bite_bitten")), env.state_view
    assert tick.died.tolist() == [False, True, True, False, True, True]
    assert [cause(env, slot) for slot in (0, 1, 2, 4, 5)] == ["alive", "eaten", "need", "hazard", "rule"]
    assert now.fatal_need.tolist() == [-1, -1, 0, -1, -1, -1]
    assert now.killer.tolist() == tick.killer.tolist() == [-1, 0, -1, -1, -1, -1]
    tick = rest(env)
    assert not tick.died[[0, 1, 4, 5]].any()  # one dies once
    assert (tick.killer == -1).all()
    assert tick.born[2]
    assert (env.state_view.fatal_need[2], env.state_view.killer[2]) == (-1, -1)


def test_a_dead_row_stays_as_it_was():
    """After its death nothing of an agent changes, until a newborn has its slot: then all is the newborn's."""
    birth = Birth(rate=0.5, maturity=3.0)
    env = start(square(kind("agent", ecology.move("walk", 0.3), count=2, birth=birth)), alive=[True, False])
    before = {name: values[1].copy() for name, values in env.state_view.arrays().items() if len(values) == 2}
    while not (tick := env.step_arrays(ask(env, agent="walk"))).born.any():
        for name, values in env.state_view.arrays().items():
            if len(values) == 2 and name not in ("bit", "gave"):
                assert np.array_equal(values[1], before[name]), name
    state = env.state_view
    assert (state.age[1], state.cause[1], state.hold[1], state.bound_for[1]) == (0.0, 0, 0.0, -1)
    assert tick.action[1] == 0  # rest: it did nothing yet


# ---- names -----------------------------------------------------------------------------------


@pytest.mark.parametrize("walls", [True, False])
def test_names_never_return_and_entries_come_once(walls):
    """A newborn is in all five dicts at its birth, a dead one for a last time at its death, nobody lives twice."""
    env = ecology.parallel_env(everything(walls=walls))
    rng = np.random.default_rng(5)
    observations, infos = env.reset(seed=5)
    alive, dead, born = set(observations), set(), 0
    assert alive == set(infos) == set(env.agents)
    for _ in range(250):
        asked = {name: int(rng.choice(np.flatnonzero(observations[name]["action_mask"]))) for name in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(asked)
        names = set(observations)
        for other in (rewards, terminations, truncations, infos):
            assert list(other) == list(observations)
        assert alive <= names
        assert not names & dead
        born += len(names - alive)
        for name in names - alive:
            assert rewards[name] == 0.0
            assert not terminations[name]
            assert infos[name]["closed"] is False
        dead |= {name for name in names if terminations[name]}
        alive = names - dead
        assert alive == set(env.agents)
        assert env.agents == [env.name_of(slot) for slot in np.flatnonzero(env.state_view.alive)]
    assert born > 20
    assert len(dead) > 20


def test_a_life_that_is_over_cannot_act():
    """To act for the dead is refused, and for one who never was."""
    env = ecology.parallel_env(square(kind(count=2, hazard=Hazard(rate=SURE))))
    env.reset(seed=0)
    env.step({"agent_0": 0, "agent_1": 0})
    assert env.agents == []
    with pytest.raises(EcologyError, match="is over"):
        env.step({"agent_0": 0})
    assert env.step({}) == ({}, {}, {}, {}, {})


def test_actions_of_dead_slots_are_ignored():
    """Whatever stands in a dead slot's place of the actions, the living act."""
    env = start(square(kind("agent", ecology.move("walk", 0.3), capacity=3)))
    assert env.step_arrays(np.array([1, -7, 99])).action.tolist() == [1, 0, 0]
    with pytest.raises(EcologyError, match="from 0 to 1, got 99"):
        env.step_arrays(np.array([99, 0, 0]))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"birth": Birth(rate=1.0, cost={"food": 1.0}), "capacity": 2}, "raise the threshold or lower the cost"),
        ({"birth": Birth(rate=1.0, cost={"fod": 1.0}), "capacity": 2}, "names the need 'fod'"),
        ({"count": 0, "arrival": 1.0}, "give a capacity above 0"),
        ({"count": 3, "capacity": 2}, "capacity must be"),
    ],
)
def test_a_population_that_cannot_be_is_refused(words, message):
    """Births and arrivals that contradict themselves are named, with what to do."""
    with pytest.raises(EcologyError, match=message):
        square(kind(**words))
