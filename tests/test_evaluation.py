"""The evaluation, held to minds whose J, f and choices are known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ecology import Arena, Ecology, EcologyError, Need, agents, move, rest, scenarios
from ecology.agents import evaluation, figures, lives, planner
from ecology.agents.base import Learner
from ecology.agents.baselines import Random, Rest
from ecology.agents.evaluation import (
    ABOUT,
    Extent,
    Trained,
    closed_gap,
    compare_deviation,
    discount,
    evaluate,
    maps_of,
    maps_report,
    probe,
    random_starts,
    transition_check,
)
from ecology.agents.lives import fresh_life, interval, mean_drive
from ecology.agents.movements import single_ticks
from ecology.agents.planner import Paths

SEED = np.random.SeedSequence(0)


class Known(Learner):
    """A mind made for tests: goes to the resource of its lowest need, with any J and f that it is given."""

    def __init__(self, group, *, J=None, f=None, gamma=0.9):  # noqa: N803
        super().__init__(group, SEED)
        self.J, self.f, self.settings, self.moves = J, f, SimpleNamespace(gamma=gamma), single_ticks(group)

    def act(self, observations, masks):
        """Eat or go to what is needed most, else rest."""
        names, chosen = self.group.actions, []
        for zeta, mask in zip(observations, masks, strict=True):
            need = int(np.argmin(zeta[:4]))
            wanted = [f"consume_food_{need + 1}", f"go_to_food_{need + 1}"]
            open_ = [names.index(w) for w in wanted if w in names and mask[names.index(w)]]
            chosen.append((open_ or [0])[0])
        return np.array(chosen)

    def deviation(self, slot, zeta):
        """Return the J that it was given."""
        return None if self.J is None else self.J(zeta)

    def predict(self, slot, zeta):
        """Return the f that it was given."""
        return self.f(zeta, self.moves)


@pytest.fixture
def world():
    """Return the paper's world and its group."""
    scenario = scenarios.load("paper")
    return scenario, Ecology(scenario).groups["agent"]


# ---- numbers -----------------------------------------------------------------------------


def test_interval_contains_the_mean_and_shrinks_with_the_series():
    """The bootstrap interval holds the mean; ten times the ticks narrow it."""
    rng = np.random.default_rng(0)
    short, long = interval(rng.normal(3, 1, 5000)), interval(rng.normal(3, 1, 50_000))
    for found in (short, long):
        assert found["low"] < found["mean"] < found["high"]
    assert long["high"] - long["low"] < short["high"] - short["low"]
    assert (short["blocks"], long["blocks"]) == (10, 100)


def test_interval_of_what_does_not_vary_is_a_point():
    """A constant series has no width, an empty one no mean."""
    assert interval(np.full(900, 2.0)) == {"mean": 2.0, "low": 2.0, "high": 2.0, "blocks": 2}
    assert interval(np.zeros(0))["mean"] is None


def test_one_block_has_a_mean_and_no_interval():
    """Fewer than two blocks say nothing of the spread: the interval is null, and its bar is drawn without one."""
    series = np.random.default_rng(0).normal(3, 1, 700)
    assert interval(series) == {"mean": pytest.approx(series.mean()), "low": None, "high": None, "blocks": 1}
    (axis,) = figures.baselines({"learned": interval(series), "rest": interval(np.full(900, 2.0))}, None).axes
    assert len(axis.patches) == 2
    assert len(axis.containers) == 2 + 1  # the bars, and one with an interval


def test_discounted_drive_of_an_exponential():
    """-ln(gamma) int gamma^s e^(-k s) ds = -ln(gamma) / (k - ln(gamma)); of a constant, the constant."""
    gamma, k, dt = 0.99, 0.02, 0.1
    drive = np.exp(-k * dt * np.arange(20_000))
    expected = -math.log(gamma) / (k - math.log(gamma))
    assert discount(drive, gamma, dt)[0] == pytest.approx(expected, rel=1e-3)
    np.testing.assert_allclose(discount(np.full(50, 1.7), gamma, dt), 1.7)


def test_closed_gap_is_a_share_of_the_way_from_camping_to_the_planner():
    """Camping closes nothing, the planner all; without a difference there is no gap."""
    told = {"learned": {"mean": 2.0}, "camping": {"mean": 4.0}, "planner": {"mean": 1.0}}
    assert closed_gap(told) == pytest.approx(2 / 3)
    assert closed_gap({**told, "planner": {"mean": 4.0}}) is None
    assert closed_gap({"learned": {"mean": 2.0}}) is None


def test_mean_drive_of_resting_is_the_closed_form(room):
    """One who rests drifts off by decay t: its drive is sqrt(eps + (decay t)^2)."""
    scenario = room(needs=(Need(name="food", set_point=2.0, decay=0.01),))
    series = mean_drive(scenario, Rest(Ecology(scenario).groups["agent"], SEED), 100, 0, skip=40)
    np.testing.assert_allclose(series, np.sqrt(0.001 + (0.01 * np.arange(41, 101)) ** 2))


def test_a_learner_of_another_world_is_refused(world, room):
    """A learner whose species the scenario does not have is one clear error."""
    scenario = room(name="fish")
    with pytest.raises(EcologyError, match="evaluate it in the world"):
        mean_drive(scenario, Rest(world[1], SEED), 10, 0, skip=0)


# ---- the course of a life ----------------------------------------------------------------


def test_regulated_is_the_first_tick_from_which_the_running_mean_stays_below():
    """A late relapse puts the tick off; a mean that ends above the bound gives none; blocks count in ticks."""
    drive = np.repeat([5.0, 1.0], [3000, 7000])
    assert lives.running_mean(drive, 4)[2997:3002].tolist() == [4.0, 3.0, 2.0, 1.0, 1.0]
    # 5 a + 1 (2000 - a) < 2 * 2000 where a < 500: from 1,501 ticks after the fall on
    assert lives.find_regulation(drive, 2.0) == 4501
    drive[8000:9000] = 5.0
    assert lives.find_regulation(drive, 2.0) is None
    assert lives.find_regulation(drive[:8000], 2.0) == 4501
    assert lives.find_regulation(np.ones(3000), 2.0) == 2000
    assert lives.find_regulation(np.ones(1999), 2.0) is None
    blocks = np.repeat([5.0, 1.0], [750, 1750])
    assert lives.find_regulation(blocks, 2.0, span=4) == 4504


def test_the_worst_block_is_the_highest_of_whole_blocks():
    """Blocks are counted from the first tick that is measured; a rest of less than a block does not count."""
    drive = np.concatenate([np.full(1000, 1.0), np.full(1000, 3.0), np.full(1000, 2.0), np.full(500, 9.0)])
    assert lives.worst_block(drive, skip=100) == {"mean": 3.0, "from": 1100}
    assert lives.worst_block(drive[:999]) is None


def recorded(place, actions, drive, born=()):
    """Return the life of one agent, of which these are known in every tick."""
    count = len(actions)
    ones = np.ones((count + 1, 1), bool)
    newborn = ~ones
    newborn[list(born)] = True
    return lives.Life(
        zeta=np.zeros((count + 1, 1, 9)),
        masks=np.ones((count + 1, 1, 13), bool),
        drive=np.append(drive[:1], drive)[:, None],
        own_drive=np.asarray(drive, float)[:, None],
        alive=ones,
        born=newborn,
        position=np.concatenate([place[:1], place])[:, None],
        actions=np.asarray(actions)[:, None],
    )


def test_a_sink_is_found_where_it_lies(world):
    """A walk against a wall is a sink, with ticks, place, action and drive; a meal, a low drive or a way on is none."""
    _, group = world
    walk, eat = group.actions.index("walk"), group.actions.index("consume_food_1")
    ticks = np.arange(2000)
    way = np.stack([0.01 * ticks, np.zeros(2000)], axis=1)  # 10 lengths in 1,000 ticks
    wall = way.copy()
    wall[700:1500] = (3.9, 1.1)
    actions, drive = np.full(2000, walk), np.full(2000, 3.0)
    actions[::400] = group.actions.index("rest")
    (sink,) = lives.stuck(recorded(wall, actions, drive), group, 2.0)
    assert sink["place"] == pytest.approx([3.9, 1.1], abs=0.05)
    assert (sink["action"], sink["mean_drive"], sink["slot"]) == ("walk", 3.0, 0)
    assert sink["share_of_action"] > 0.99
    assert abs(sink["from"] - 700) < 5 + 100  # and what was walked just before, within a length
    assert abs(sink["to"] - 1500) < 5
    assert lives.sinks(recorded(wall, actions, drive), group, 2.0) == [sink]
    assert not lives.stuck(recorded(way, actions, drive), group, 2.0)
    assert not lives.stuck(recorded(wall, actions, drive), group, 3.5)
    assert not lives.stuck(recorded(wall, actions, drive, born=[1100]), group, 2.0)
    fed = actions.copy()
    fed[1100] = eat
    assert not lives.stuck(recorded(wall, fed, drive), group, 2.0)
    (turns,) = lives.stuck(recorded(way, np.full(2000, walk), drive), group, 2.0)  # the same action for ever
    assert (turns["from"], turns["to"]) == (0, 2000)


def test_who_sleeps_is_not_stuck(world):
    """Ticks in which the world leaves no choice do not make a sink."""
    _, group = world
    life = recorded(np.zeros((1000, 2)), np.full(1000, group.actions.index("sleep")), np.full(1000, 3.0))
    assert lives.stuck(life, group, 2.0)
    life.masks[:, :, 1:] = False
    assert not lives.stuck(life, group, 2.0)


def test_figures_draw_the_whole_life_and_its_tenants(world):
    """Curves reach the last tick whatever the length, a short peak included; deaths and new tenants are marked."""
    scenario = world[0]
    ticks = 9000
    place = np.random.default_rng(0).uniform(3, 5, (ticks, 2))
    drive = np.ones(ticks)
    drive[8200] = 7.0
    life = recorded(place, np.zeros(ticks, np.int64), drive, born=[6000])
    life.alive[8500:] = False
    died, born = figures.changes_of_tenant(life, 0)
    assert (died.tolist(), born.tolist()) == ([6000, 8500], [6000])
    species = scenario.species[0]
    axes = figures.internal_states(life, scenario, species).axes
    assert axes[-1].get_xlim() == (0, ticks)
    curve = next(line for line in axes[-1].lines if line.get_label() == "drive")
    assert np.nanmax(curve.get_ydata()) == 7.0
    assert len(curve.get_xdata()) <= figures.POINTS + 2
    marks = [line.get_xdata()[0] for line in axes[0].lines if len(line.get_xdata()) == 2 and line.get_xdata()[0] > 0]
    assert sorted(marks) == [6000, 6000, 8500]
    axis = figures.trajectory(life, scenario, species).axes[0]
    labels = {text.get_text() for text in axis.get_legend().get_texts()}
    assert {"death", "new tenant", "birth"} <= labels
    (path,) = [each for each in axis.collections if type(each).__name__ == "LineCollection"]
    assert len(path.get_segments()) == 8500 - 2  # all but the two that end in a death


# ---- maps and choices --------------------------------------------------------------------


def test_maps_of_a_mind_that_knows_the_way(world):
    """Where J is the walking distance to what is needed, the minimum lies there and the ranks agree."""
    scenario, group = world
    paths, places = Paths(scenario.arena, 0.1), [r.position for r in scenario.resources]

    def distance(zeta):
        need = zeta[:, :4].argmin(axis=1)
        ways = np.array([paths.distance(zeta[:, 6:8], place) for place in places])
        return ways[need, np.arange(len(zeta))]

    maps = maps_of(scenario, Known(group, J=distance))
    told = maps_report(maps, scenario, group)
    assert [row["resource"] for row in told.values()] == [f"food_{i}" for i in range(1, 5)]
    for row in told.values():
        assert row["minimum_within_1"]
        assert row["spearman_with_walking_distance"] > 0.99
    assert np.isfinite(maps.value[:, maps.grid.inside]).all()
    assert np.isnan(maps.value[:, ~maps.grid.inside]).all()


def test_maps_of_a_mind_that_knows_nothing(world):
    """A flat J has no rank correlation; a mind without a J has no maps."""
    scenario, group = world
    maps = maps_of(scenario, Known(group, J=lambda zeta: np.ones(len(zeta))))
    assert all(row["spearman_with_walking_distance"] is None for row in maps_report(maps, scenario, group).values())
    assert maps_of(scenario, Known(group)) is None


def test_probe_tells_who_goes_where_it_should():
    """One who goes to what it needs is always right; one who rests eats nothing."""
    paper = scenarios.load("paper", decay=0.0, view_angle=2 * math.pi, view_range=50.0)
    scenario = replace(paper, arena=Arena(vertices=((0, 0), (10, 0), (10, 10), (0, 10))))
    group = Ecology(scenario).groups["agent"]
    for told in probe(scenario, Known(group), 0, places=5).values():
        assert told["trials"] == 5
        assert told["share_right"] == 1.0
        assert told["median_ticks_when_right"] > 0
    for told in probe(scenario, Rest(group, SEED), 0, places=2, limit=30).values():
        assert told["first_eaten"]["nothing"] == 2


# ---- J and f -----------------------------------------------------------------------------


@pytest.mark.parametrize(("species", "eaten"), [("prey", {"energy"}), ("predator", set())])
def test_a_species_is_probed_among_others_that_need_more_or_less(species, eaten):
    """A predator has one need and bites what has two: each is measured by the needs of its own."""
    scenario = scenarios.load("predator_prey")
    learner = agents.make("lean", Ecology(scenario).groups[species], np.random.SeedSequence(0), {"memory": 10})
    assert set(evaluation.probe(scenario, learner, 0, places=1, limit=3)) == eaten
    assert evaluation.maps_of(scenario, learner) is None  # without a sense of place


def test_deviation_check_of_a_true_j(room):
    """Where nothing changes, J = d: bias 0, correlation 1; a J twice as large is seen to be."""
    scenario = room(actions=(rest(),), position=(2.0, 2.0))
    group = Ecology(scenario).groups["agent"]

    def drive(zeta):
        return np.sqrt(0.001 + zeta[:, 0].astype(float) ** 2)

    mind = Known(group, J=drive)
    lives = [(life, 0, 0) for life in random_starts(scenario, mind, 0, 12, 80)]
    told = compare_deviation(mind, lives, 0.9, 40, np.random.default_rng(0)).report()
    assert told["states"] >= 40
    assert told["correlation"] == pytest.approx(1.0)
    assert told["bias"] == pytest.approx(0.0, abs=1e-6)
    twice = Known(group, J=lambda zeta: 2 * drive(zeta))
    told = compare_deviation(twice, lives, 0.9, 40, np.random.default_rng(0)).report()
    assert told["bias"] == pytest.approx(told["mean_measured"])


def test_transition_check_of_a_true_f_and_of_none(room):
    """An f that is true explains all change, one that predicts none explains nothing."""
    scenario = room(
        needs=(Need(name="food", set_point=2.0, decay=0.01),),
        actions=(rest(), move("walk", 0.1)),
        position=(2.0, 2.0),
    )
    group = Ecology(scenario).groups["agent"]

    def true(zeta, moves):
        change = np.zeros((len(zeta), 2, 4))
        change[:, :, 0] = -0.01
        change[:, 1, 1:3] = 0.1 * np.stack([np.cos(zeta[:, 3]), np.sin(zeta[:, 3])], axis=1)
        return {"change": change, "duration": np.ones((len(zeta), 2))}

    def none(zeta, moves):
        return {"change": np.zeros((len(zeta), 2, 4)), "duration": np.full((len(zeta), 2), 3.0)}

    life = fresh_life(scenario, Known(group), 50, 0)
    for told in transition_check(scenario, Known(group, f=true), [life], 0).values():
        assert told["share_explained"] == pytest.approx(1.0, abs=1e-4)
        assert told["duration_error"] == 0
    for told in transition_check(scenario, Known(group, f=none), [life], 0).values():
        assert told["share_explained"] == pytest.approx(0.0)
        assert told["duration_error"] == 2
    assert transition_check(scenario, Rest(group, SEED), [life], 0) is None


# ---- everything --------------------------------------------------------------------------


def test_evaluation_is_whole_plain_and_drawn(world, monkeypatch, tmp_path):
    """The report holds every documented key, is JSON, and its figures are written."""
    for name, value in {"GENERATIONS": 1, "SAMPLES": 8, "SHORT": 300.0, "ORDERS": 2}.items():
        monkeypatch.setattr(planner, name, value)
    monkeypatch.setattr(evaluation, "STARTS", 3)
    scenario, group = world

    def still(zeta, moves):
        return {"change": np.zeros((len(zeta), len(moves.names), 9)), "duration": np.ones((len(zeta), 14))}

    mind = Known(group, J=lambda zeta: 1.0 + zeta[:, 6] / 10, f=still)
    heard = []
    lived = evaluation.Lived(np.repeat([1e6, 0.0], [750, 1250]), span=4)
    found = evaluate(scenario, mind, Extent(ticks=400, skip=100, places=1), Trained(lived=lived), tell=heard.append)
    assert set(ABOUT) <= set(found.report)
    added = {"learned", "learned_epsilon_0", "planner_exploring"}
    assert set(found.report["mean_drive"]) == {*added, *evaluation.BASELINES}
    assert set(found.report["worst_block"]) == set(found.report["stuck"]) == {"learned", "learned_epsilon_0"}
    below = found.report["regulated"]["below"]
    assert below == pytest.approx(0.5 * found.report["mean_drive"]["camping"]["mean"])
    lived = found.report["as_lived"]
    assert (lived["mean_drive_last_tenth"], lived["regulated_from"]) == (0.0, 4 * 750 + 2000)
    assert heard
    json.dumps(found.report, allow_nan=False)
    paths = figures.draw_evaluation(tmp_path, scenario, found, group.layout.names)
    assert {p.name for p in paths} == {
        "deviation_maps.png", "internal_states.png", "trajectory.png", "baselines.png", "deviation_check.png",
    }  # fmt: skip
    assert all(p.read_bytes()[:4] == b"\x89PNG" for p in paths)


def test_an_evaluation_needs_ticks_beyond_those_it_skips(world):
    """Skipping all ticks is one clear error."""
    with pytest.raises(EcologyError, match="more ticks than it skips"):
        evaluate(world[0], Random(world[1], SEED), Extent(ticks=500, skip=500))
