"""The README's tutorial, followed literally."""

import re
from pathlib import Path

import numpy as np

import scenarios
from agents import learner_class, settings
from ecology import Ecology, contract

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


def tutorial() -> str:
    """Return the file that the tutorial builds: its Python blocks, one after the other."""
    section = README.partition("## A scenario of your own")[2].partition("Check it, run it")[0]
    return "".join(re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL))


def test_the_tutorial_builds_predators_and_prey(tmp_path):
    """Its blocks are one scenario file that keeps the contract, and in which prey are bitten and young are born."""
    path = tmp_path / "meadow.py"
    path.write_text(tutorial(), encoding="utf-8")
    assert len(path.read_text().splitlines()) < 75
    scenario = scenarios.load(str(path))
    for species in scenario.species:
        learner_class(species.learner)
        assert species.learner_settings.keys() <= settings(species.learner).keys()
    assert [str(error) for _, error in contract.check(scenario, 50) if error] == []
    env, rng = Ecology(scenario), np.random.default_rng(0)
    tick, bitten, born = env.reset_arrays(seed=0), 0, 0
    for _ in range(600):
        tick = env.step_arrays(contract.choose(env, tick, rng))
        bitten += np.count_nonzero(env.state_view.bit >= 0)
        born += np.count_nonzero(tick.born)
    assert bitten > 0
    assert born > 0


def test_every_command_is_in_the_readme():
    """The table of commands names all that there are."""
    from scenarios.cli import app

    names = {command.name or command.callback.__name__ for command in app.registered_commands if command.callback}
    for name in names:
        assert f"`ecology {name}" in README, name


def test_every_scenario_is_in_the_readme():
    """The table of scenarios names all that there are."""
    for name in scenarios.names():
        assert f"`{name}`" in README, name
