"""The follow-up's three experiments: what the test changes, who can be measured there, what the baselines are."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

import ecology
from ecology import EcologyError, Need, consume, rest, scenarios
from ecology.agents import evaluation, lives, planner
from ecology.agents.base import Transition
from ecology.agents.baselines import QValue, Random
from ecology.agents.planner import Camping
from ecology.lab import cli

SEED = np.random.SeedSequence(3)
THREE = ("shifted", "probabilistic", "oscillating")
FIRST, SECOND = (0.5, 4.25), (3.5, 1.5)


@pytest.fixture
def quick(monkeypatch):
    """Make the search of plans short: rough plans will do here."""
    for name, value in {"GENERATIONS": 2, "SAMPLES": 16, "SHORT": 1000.0, "LONG": 1000.0, "ORDERS": 2}.items():
        monkeypatch.setattr(planner, name, value)
    monkeypatch.setattr(planner.Planner, "longest", 2)


def places(name, at=0, **settings):
    """Return where the two resources are after `at` ticks, (2, 2)."""
    env = ecology.parallel_env(scenarios.load(name, **settings))
    env.reset_arrays(seed=0)
    for _ in range(at):
        env.step_arrays(np.zeros(1, np.int64))
    return env.state_view.resource_position


def test_shifted_lies_elsewhere_in_the_test():
    """R1 and R2 are where the authors have them, and in the test at (1.0, 4.25) and (3.5, 2.0)."""
    np.testing.assert_allclose(places("shifted"), [FIRST, SECOND])
    np.testing.assert_allclose(places("shifted", test=True), [(1.0, 4.25), (3.5, 2.0)])


@pytest.mark.parametrize(("test", "share"), [(False, 0.9), (True, 0.8)])
def test_probabilistic_is_there_as_often_as_it_says(test, share):
    """Each resource is available in 90 % of the units of time, 80 % in the test, each by itself."""
    env = ecology.parallel_env(scenarios.load("probabilistic", test=test))
    env.reset_arrays(seed=1)
    there = []
    for _ in range(2000):
        env.step_arrays(np.zeros(1, np.int64))
        there.append(env.state_view.available.copy())
    error = math.sqrt(share * (1 - share) / 2000)
    assert np.abs(np.mean(there, axis=0) - share).max() < 4 * error
    assert np.mean(np.all(there, axis=1)) == pytest.approx(share**2, abs=5 * error)


@pytest.mark.parametrize(("settings", "period"), [({}, 1000), ({"test": True}, 500)])
def test_oscillating_swings_in_its_period(settings, period):
    """R1's x is a triangle wave between 0.5 and 1.5, R2's y one between 1.5 and 2.5."""
    half, quarter = period // 2, period // 4
    np.testing.assert_allclose(places("oscillating", 0, **settings), [FIRST, SECOND], atol=1e-9)
    np.testing.assert_allclose(places("oscillating", half, **settings), [(1.5, 4.25), (3.5, 2.5)], atol=1e-9)
    np.testing.assert_allclose(places("oscillating", quarter, **settings), [(1.0, 4.25), (3.5, 2.0)], atol=1e-9)
    np.testing.assert_allclose(places("oscillating", period, **settings), [FIRST, SECOND], atol=1e-9)


@pytest.mark.parametrize("name", THREE)
def test_training_and_test_have_one_body(name):
    """Zeta and actions are the same in training and test, so that one learner fits both; the text's differ."""
    train, test, text = (
        ecology.parallel_env(scenarios.load(name, **settings)).groups["agent"]
        for settings in ({}, {"test": True}, {"numbers": "text"})
    )
    assert (train.layout.names, train.actions) == (test.layout.names, test.actions)
    assert set(text.actions) - set(train.actions) == {f"run_{way}" for way in ("east", "north", "west", "south")}
    with pytest.raises(EcologyError, match="'code' or the paper's 'text', got 'other'"):
        scenarios.load(name, numbers="other")


# ---- the baselines -----------------------------------------------------------------------


def test_qvalue_takes_the_action_after_which_the_drive_was_least(room):
    """It keeps the mean of the drive after each action, by hand sqrt(0.001 + delta^2), and takes the least."""
    env = ecology.parallel_env(
        room(
            needs=(Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0)),),
            actions=(rest(), consume("berries", {"food": 0.1})),
            position=(5.0, 5.0),
        )
    )
    learner, tick = QValue(env.groups["agent"], SEED, epsilon=0.0), env.reset_arrays(seed=0)
    drives = {0: [], 1: []}
    for action in (0, 1, 1, 0):
        before = tick
        tick = env.step_arrays(np.array([action]))
        drives[action].append(tick.drive[0])
        learner.learn(
            evaluation_transition(before, tick, action),
        )
    means = [np.mean(drives[0]), np.mean(drives[1])]
    np.testing.assert_allclose(learner.mean[0, :, 0], means, rtol=1e-5)
    masks = np.ones((1, 2), bool)
    assert learner.act(tick.observations["agent"], masks)[0] == np.argmin(means)
    masks[0, np.argmin(means)] = False
    assert learner.act(tick.observations["agent"], masks)[0] == np.argmax(means)


def evaluation_transition(before, after, action):
    """Return the transition of one tick of one agent."""
    return Transition(
        before.observations["agent"],
        before.masks["agent"],
        np.array([action]),
        after.observations["agent"],
        after.masks["agent"],
        np.array([True]),
        np.array([False]),
    )


@pytest.mark.parametrize("name", THREE)
def test_camping_holds_its_need_where_the_resource_swings_or_comes_and_goes(quick, name):
    """In every test world, one who camps keeps the need of its resource nearer to its set point than resting does."""
    scenario = scenarios.load(name, test=True, numbers="text")
    group = ecology.parallel_env(scenario).groups["agent"]
    camping = Camping(group, SEED, scenario)
    need = camping.known.need[camping.plan.order[0, 0]]
    life = lives.fresh_life(scenario, camping, 2500, 0)
    assert np.abs(life.zeta[500:, 0, need]).mean() < 0.25  # resting: the set point itself, at least 1
    assert life.drive[500:].mean() < lives.mean_drive(scenario, Random(group, SEED), 2500, 0, 500).mean()


# ---- measured in another world -----------------------------------------------------------


def test_a_learner_is_measured_only_where_it_fits():
    """A learner is refused in a world where its species senses or does something else, with what differs."""
    group = ecology.parallel_env(scenarios.load("shifted")).groups["agent"]
    lives.check_fits(Random(group, SEED), scenarios.load("oscillating", test=True))
    with pytest.raises(EcologyError, match=r"does not fit.*actions and senses"):
        lives.check_fits(Random(group, SEED), scenarios.load("paper"))
    with pytest.raises(EcologyError, match="differs in species"):
        lives.check_fits(Random(group, SEED), scenarios.load("colony"))


def test_baselines_that_learn_do_so_where_the_learner_did():
    """Greedy and qvalue live in `home` before they are measured; the others know no home."""
    home, away = (scenarios.load("probabilistic", test=test, available_in_test=0.0) for test in (False, True))
    group = ecology.parallel_env(home).groups["agent"]
    at_home = evaluation.baseline("qvalue", away, group, 0, 600, home)
    there = evaluation.baseline("qvalue", away, group, 0, 600)
    again = evaluation.baseline("qvalue", home, group, 0, 600)
    np.testing.assert_array_equal(at_home.mean, again.mean)
    assert (at_home.mean != there.mean).any()


def type_(*words):
    """Type a command as a user does, and return its exit code."""
    with pytest.raises(SystemExit) as left:
        cli.main(words)
    return left.value.code


def test_evaluate_in_another_world_writes_beside_the_run(quick, tmp_path, monkeypatch):
    """`ecology evaluate RUN --set test=true` measures there, and leaves the run's own evaluation alone."""
    monkeypatch.chdir(tmp_path)
    run = Path("runs/shifted-0")
    assert type_("run", "shifted", "--ticks", "300", "--no-record", "--quiet", "--learner", "random") == 0
    assert type_("evaluate", str(run), "--ticks", "300", "--places", "1", "--set", "test=true", "--quiet") == 0
    told = json.loads((run / "in-shifted-test=true" / "evaluation.json").read_text())
    assert told["settings"]["test"] is True
    assert told["trained_in"]["settings"]["test"] is False
    assert told["mean_drive"].keys() == {"learned", "learned_epsilon_0", *evaluation.BASELINES}
    assert not (run / "evaluation.json").exists()
    assert type_("evaluate", str(run), "--ticks", "300", "--places", "1", "--in", "oscillating", "--quiet") == 0
    told = json.loads((run / "in-oscillating" / "evaluation.json").read_text())
    assert told["scenario"] == "oscillating"


@pytest.mark.parametrize("words", [["--set", "tests=true"], ["--in", "paper"], ["--in", "shiftet"]])
def test_a_world_that_is_none_or_does_not_fit_is_one_message(tmp_path, monkeypatch, capsys, words):
    """A misspelled setting, an unknown world and one of another body are told in one message, exit code 2."""
    monkeypatch.chdir(tmp_path)
    assert type_("run", "shifted", "--ticks", "50", "--no-record", "--quiet", "--learner", "random") == 0
    assert type_("evaluate", "runs/shifted-0", "--quiet", *words) == 2
    assert capsys.readouterr().err.count("ecology: ") == 1
