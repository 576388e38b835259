"""Those the learner is measured against: what they know, that they keep to the mask, that they are good."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ecology import Arena, Ecology, EcologyError, Need, agents, consume, rest, scenarios
from ecology.agents import loop, planner
from ecology.agents.base import Transition
from ecology.agents.baselines import Greedy, Random, Rest
from ecology.agents.lives import mean_drive
from ecology.agents.movements import adaptive
from ecology.agents.planner import Camping, Exploring, Paths, Planner, gauge, rounds

SEED = np.random.SeedSequence(3)


@pytest.fixture
def quick(monkeypatch):
    """Make the search of plans short: rough plans will do here."""
    for name, value in {
        "GENERATIONS": 3,
        "SAMPLES": 24,
        "SHORT": 1500.0,
        "LONG": 1500.0,
        "ORDERS": 4,
    }.items():
        monkeypatch.setattr(planner, name, value)
    monkeypatch.setattr(Planner, "longest", 4)


# ---- baselines without knowledge ---------------------------------------------------------


def test_random_is_uniform_over_the_open_actions(room):
    """Random takes every open action equally often and never a closed one."""
    group = Ecology(room(count=3000)).groups["agent"]
    masks = np.tile([True, False, True, True, False], (group.size, 1))
    actions = Random(group, SEED).act(np.zeros((group.size, 4)), masks)
    share = np.bincount(actions, minlength=5) / group.size
    assert share[[1, 4]].sum() == 0
    assert np.abs(share[[0, 2, 3]] - 1 / 3).max() < 0.04


@pytest.mark.parametrize("name", ["random", "rest", "greedy"])
def test_baselines_ask_for_no_closed_action(name):
    """In the paper's world no baseline ever asks for a closed action, dead slots or not."""
    env = Ecology(scenarios.load("paper"))
    learner = agents.make(name, env.groups["agent"], SEED, {})
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 400)
    assert env.state_view.closed.sum() == 0
    nobody = learner.act(np.zeros((1, 9), np.float32), np.zeros((1, len(learner.group.actions)), bool))
    assert nobody.shape == (1,)


def test_rest_sleeps_when_nothing_else_is_open():
    """Rest rests, and takes the only open action where its body closes rest."""
    group = Ecology(scenarios.load("paper")).groups["agent"]
    sleep = group.kinds.index("sleep")
    mask = np.ones((1, len(group.actions)), bool)
    assert Rest(group, SEED).act(np.zeros((1, 9)), mask)[0] == group.kinds.index("rest")
    assert Rest(group, SEED).act(np.zeros((1, 9)), np.arange(mask.size)[None] == sleep)[0] == sleep


def test_greedy_learns_to_eat_when_hungry_and_to_stop_when_full(room):
    """Greedy in the drive eats below the set point and rests above it, from its own experience alone."""
    scenario = room(
        needs=(Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0)),),
        actions=(rest(), consume("berries", {"food": 0.1})),
        position=(5.0, 5.0),
    )
    env = Ecology(scenario)
    learner = Greedy(env.groups["agent"], SEED)
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 100)
    np.testing.assert_allclose(learner.mean[0, :, 0], [-0.01, 0.09], atol=1e-5)
    learner.evaluating(0.0)
    masks = np.ones((1, 2), bool)
    assert learner.act(np.array([[-1.0, 5, 5, 0]], np.float32), masks)[0] == 1
    assert learner.act(np.array([[1.0, 5, 5, 0]], np.float32), masks)[0] == 0


def test_greedy_becomes_what_its_state_says(room):
    """A greedy agent restored from its state acts as the one that was saved."""
    group = Ecology(room(count=4)).groups["agent"]
    first, second = Greedy(group, SEED), Greedy(group, np.random.SeedSequence(9))
    zeta, masks = np.zeros((4, 4), np.float32), np.ones((4, 5), bool)
    after = zeta + np.array([0.1, 0, 0, 0], np.float32)
    first.learn(Transition(zeta, masks, np.arange(4), after, masks, np.arange(4) < 3, np.arange(4) == 3))
    assert first.met.sum() == 3  # the dead learn nothing
    second.restore(*first.state())
    for _ in range(20):
        np.testing.assert_array_equal(first.act(zeta, masks), second.act(zeta, masks))


@pytest.mark.parametrize("settings", [{"epsilom": 0.1}, {"epsilon": 1.5}, {"epsilon": "much"}])
def test_greedy_refuses_bad_settings(room, settings):
    """An unknown setting or a value out of range is one clear error."""
    with pytest.raises(EcologyError, match="epsilon"):
        agents.make("greedy", Ecology(room()).groups["agent"], SEED, settings)


# ---- the map -----------------------------------------------------------------------------

BEND = Arena(vertices=((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)))  # an L


def test_walking_distance_around_the_corner_of_an_l():
    """Around the inner corner, a body of radius 0.1 walks by (0.9, 0.9): worked by hand."""
    paths = Paths(BEND, 0.1)
    np.testing.assert_allclose(paths.corners, [[0.9, 0.9]])
    ways = paths.distance(np.array([[1.5, 0.5], [0.5, 0.5], [1.8, 0.2]]), (0.5, 1.5))
    by_hand = [2 * math.hypot(0.6, 0.4), 1.0, math.hypot(0.9, 0.7) + math.hypot(0.4, 0.6)]
    np.testing.assert_allclose(ways, by_hand, rtol=1e-6)


def test_gauge_of_four_directions_is_the_city_block():
    """Who walks in four directions walks |dx| + |dy|; five headings cost 1 / cos 36 degrees at worst."""
    ways = np.random.default_rng(0).normal(size=(50, 2))
    four = gauge(np.array([0, math.pi / 2, math.pi, -math.pi / 2]))
    np.testing.assert_allclose(four(ways), np.abs(ways).sum(axis=1), rtol=1e-6)
    five = gauge(0.3 + 2 * math.pi / 5 * np.arange(5))
    angle = 0.3 + math.pi / 5 * np.arange(10)
    cost = five(np.stack([np.cos(angle), np.sin(angle)], axis=1))
    np.testing.assert_allclose(cost[::2], 1.0, rtol=1e-6)
    np.testing.assert_allclose(cost[1::2], 1 / math.cos(math.pi / 5), rtol=1e-6)


def test_rounds_are_each_counted_once():
    """Three resources give 3 + 3 + 2 rounds of up to three stays, whatever their beginning."""
    found = rounds([0, 1, 2], 3)
    assert found == [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2), (0, 2, 1)]


# ---- yardsticks --------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{}, {"heading": False}, {"dt": 0.5}])
def test_planner_reaches_every_resource_from_random_places(quick, changes):
    """From random places and headings, the walk to each resource takes little more than its geodesic."""
    scenario = scenarios.load("paper", **changes)
    env = Ecology(scenario)
    traveller = Camping(env.groups["agent"], SEED, scenario)
    rng = np.random.default_rng(0)
    env.reset_arrays(0)
    for trial in range(12):
        goal = trial % 4
        place = planner_place(scenario, rng)
        tick = env.set_state(position=place[None], heading=rng.uniform(-3, 3, 1))
        traveller.begin()
        way = traveller.paths.distance(place[None], traveller.places[goal])[0] - traveller.radii[goal]
        budget = 1.5 * max(way, 0.0) / 0.1 + 12
        for _ in range(math.ceil(budget / scenario.dt)):
            if env.state_view.inside[0, goal]:
                break
            action = traveller.walk_to(0, goal, tick.observations["agent"][0], tick.masks["agent"][0])
            tick = env.step_arrays(np.array([action]))
        assert env.state_view.inside[0, goal], (goal, place, way)


def planner_place(scenario, rng):
    """Return one random place in the arena."""
    from ecology.ground import scatter

    return scatter(scenario.arena, 0.1, 1, rng)[0]


def test_planner_beats_camping_beats_rest(quick):
    """In the paper's world, from birth: planner, then camping, then resting; and the model foretells it."""
    scenario = scenarios.load("paper")
    group = Ecology(scenario).groups["agent"]
    making, camping = Planner(group, SEED, scenario), Camping(group, SEED, scenario)
    lived = {
        name: mean_drive(scenario, learner, 1500, 0, skip=0).mean()
        for name, learner in {"planner": making, "camping": camping, "rest": Rest(group, SEED)}.items()
    }
    assert lived["planner"] < 0.7 < lived["camping"] < lived["rest"]
    assert lived["planner"] == pytest.approx(making.expected, rel=0.2)
    assert lived["camping"] == pytest.approx(camping.expected, rel=0.05)


def test_yardsticks_keep_to_the_mask(quick):
    """Neither the planner nor camping asks for a closed action, forced sleep and all."""
    scenario = scenarios.load("paper_reference", arena="EASY")
    env = Ecology(scenario)
    learner = Planner(env.groups["agent"], SEED, scenario)
    tick = env.reset_arrays(0)
    tick = env.set_state(internal=np.array([[1.0, 2.0, 0.1, 9.99]]))
    loop.run(env, {"agent": learner}, tick, 1200)
    assert env.state_view.closed.sum() == 0


def test_camping_holds_its_need_near_the_set_point(quick, room):
    """Where one resource serves the one need, camping keeps the drive near nothing."""
    scenario = room(needs=(Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0)),), position=(2.0, 2.0))
    learner = Camping(Ecology(scenario).groups["agent"], SEED, scenario)
    assert mean_drive(scenario, learner, 600, 0, skip=200).mean() < 0.12


def test_a_species_that_cannot_make_rounds_is_refused(room):
    """A planner for a species that does not move says so."""
    scenario = room(actions=(rest(), consume("berries", {"food": 0.1})), position=(5.0, 5.0))
    with pytest.raises(EcologyError, match="planner needs a species that moves"):
        Planner(Ecology(scenario).groups["agent"], SEED, scenario)


# ---- exploring ---------------------------------------------------------------------------


def test_a_planner_that_never_explores_is_the_planner(quick):
    """With epsilon 0 every action is that of the planner itself."""
    scenario = scenarios.load("paper")
    inner = Planner(Ecology(scenario).groups["agent"], SEED, scenario)
    bare = mean_drive(scenario, inner, 1500, 0, skip=0)
    exploring = Exploring(inner, adaptive(inner.group, bearings=True), 0.0)
    np.testing.assert_array_equal(mean_drive(scenario, exploring, 1500, 0, skip=0), bare)


class Waits(Rest):
    """Stand in for a yardstick: rests, and notes whose way was lost."""

    def lose_way(self, slots):
        """Count the explored movements that ended."""
        self.lost = getattr(self, "lost", 0) + len(slots)


def test_an_exploring_yardstick_explores_as_a_learner_does(room):
    """Of decisions a share of epsilon is explored, each for the length of its movement, all with the same time."""
    scenario = room(count=12_000)  # the rarest movement is begun 1,400 times: a standard deviation of 3 %
    env = Ecology(scenario)
    group = env.groups["agent"]
    moves = adaptive(group, bearings=True)
    masks = np.tile(~np.isin(group.kinds, ("go_to", "sleep")), (group.size, 1))  # others last as long as they say
    open_ = moves.open(masks)[0]
    mind = Exploring(Waits(group, SEED), moves, 0.2, SEED)
    explored, ticks = np.zeros(len(moves.names)), 400
    for _ in range(ticks):
        actions = mind.act(np.zeros((group.size, 4), np.float32), masks)
        under_way = mind.movement >= 0
        explored += np.bincount(mind.movement[under_way], minlength=len(moves.names))
        assert (actions[under_way] == moves.action[mind.movement, mind.stage][under_way]).all()
    # a decision of its own is a rest: time shares are 0.2 l and 0.8 rest, l the mean length of what is explored
    length = open_.sum() / np.sum(1 / moves.length[open_])
    pause = moves.length[list(moves.names).index("rest")]
    expected = 0.2 * length / (0.2 * length + 0.8 * pause)
    assert explored.sum() / (ticks * group.size) == pytest.approx(expected, rel=0.1)
    assert explored[~open_].sum() == 0
    np.testing.assert_allclose(explored[open_] / explored.sum(), 1 / open_.sum(), rtol=0.15)
    assert mind.inner.lost > 0


def test_movements_are_explored_for_the_same_time():
    """The chance of an open movement is inverse to its length; one that is closed is never drawn."""
    moves = adaptive(Ecology(scenarios.load("paper")).groups["agent"], bearings=True)
    open_ = np.ones((40_000, len(moves.names)), bool)
    open_[:, 3] = False
    drawn = moves.explore(open_, np.random.default_rng(0).random(40_000))
    time = np.bincount(drawn, minlength=len(moves.names)) * moves.length
    assert time[3] == 0
    np.testing.assert_allclose(np.delete(time, 3) / time.sum(), 1 / (len(moves.names) - 1), rtol=0.12)
