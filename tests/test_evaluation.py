"""The evaluation, held to minds whose J, f and choices are known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import agents
import scenarios
from agents import evaluation, figures, planner
from agents.base import Learner
from agents.baselines import Random, Rest
from agents.evaluation import (
    ABOUT,
    closed_gap,
    compare_deviation,
    discounted,
    evaluate,
    fresh_life,
    interval,
    maps_of,
    maps_report,
    mean_drive,
    probe,
    random_starts,
    transition_check,
)
from agents.movements import single_ticks
from agents.planner import Paths
from ecology import Arena, Ecology, EcologyError, Need, move, rest

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
    assert discounted(drive, gamma, dt)[0] == pytest.approx(expected, rel=1e-3)
    np.testing.assert_allclose(discounted(np.full(50, 1.7), gamma, dt), 1.7)


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
    found = evaluate(scenario, mind, 0, ticks=400, skip=100, places=1, tell=heard.append)
    assert set(ABOUT) <= set(found.report)
    assert set(found.report["mean_drive"]) == {"learned", *evaluation.BASELINES}
    assert heard
    json.dumps(found.report, allow_nan=False)
    paths = figures.draw(tmp_path, scenario, found, group.layout.names)
    assert {p.name for p in paths} == {
        "deviation_maps.png", "internal_states.png", "trajectory.png", "baselines.png", "deviation_check.png",
    }  # fmt: skip
    assert all(p.read_bytes()[:4] == b"\x89PNG" for p in paths)


def test_an_evaluation_needs_ticks_beyond_those_it_skips(world):
    """Skipping all ticks is one clear error."""
    with pytest.raises(EcologyError, match="more ticks than it skips"):
        evaluate(world[0], Random(world[1], SEED), ticks=500, skip=500)
