"""The tables of commons and colony: worlds lived side by side are the worlds lived alone."""

import numpy as np
import pytest

import agents
import ecology
import scenarios
from agents import loop
from scenarios import _survival


@pytest.mark.parametrize(("name", "settings"), [("commons", {"n": 4}), ("colony", {"weight": 0.5})])
def test_one_world_is_the_ordinary_loop(name, settings):
    """With one seed, living side by side gives the life of agents.loop, number for number."""
    ticks = 150
    scenario = scenarios.load(name, **settings)
    (side,) = _survival.live(scenario, 1, ticks, lambda envs, at: None)
    env = ecology.parallel_env(scenario)
    learners = {}
    for i, s in enumerate(scenario.species):
        life = {"life": float(ticks)} if s.learner == "hjb" else {}
        stream = np.random.SeedSequence(0, spawn_key=(1000, i))
        learners[s.name] = agents.make(s.learner, env.groups[s.name], stream, {**s.learner_settings, **life})
    loop.run(env, learners, env.reset_arrays(0), ticks)
    for field, values in env.state_view.arrays().items():
        np.testing.assert_array_equal(values, side.state_view.arrays()[field], err_msg=field)


def test_seeds_are_worlds_of_their_own():
    """Two seeds side by side differ, and each starts as it does alone."""
    first, second = _survival.live(scenarios.load("commons", n=4), 2, 30, lambda envs, at: None)
    assert (first.state_view.position != second.state_view.position).any()
    seen = []
    _survival.live(scenarios.load("commons", n=4), 2, 1, lambda envs, at: seen.extend(envs))
    alone = ecology.parallel_env(scenarios.load("commons", n=4))
    alone.reset_arrays(1)
    assert np.abs(seen[1].state_view.position - alone.state_view.position).max() <= 0.1 + 1e-9


@pytest.mark.parametrize(
    "words", [["commons", "--values", "3"], ["colony", "--values", "0.5", "--set", "form=average"]]
)
def test_a_table_has_a_row_for_every_value(capsys, words):
    """The command prints a Markdown table with as many cells in a row as in its head."""
    _survival.main([*words, "--seeds", "2", "--ticks", "40"])
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(rows) == 3
    assert len({row.count("|") for row in rows}) == 1
    assert rows[-1].startswith(f"| {words[2]} |")
