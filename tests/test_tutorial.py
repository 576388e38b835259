"""The tutorial and the page about learners, followed literally."""

import re
from pathlib import Path

import numpy as np
import pytest

from ecology import Arena, Ecology, Need, Resource, Scenario, Species, act, contract, rest, scenarios
from ecology.agents import checkpoint, learner_class, settings
from ecology.lab.cli import main

DOCS = Path(__file__).parent.parent / "docs"
TUTORIAL = (DOCS / "tutorial.md").read_text(encoding="utf-8")
LEARNER = (DOCS / "guides" / "learner.md").read_text(encoding="utf-8")


def tutorial() -> str:
    """Return the file that the tutorial builds: its Python blocks, one after the other."""
    section = TUTORIAL.partition("## Run it")[0]
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


def test_the_ruins_that_are_shown_keep_the_contract(tmp_path):
    """The meadow among holes and inner walls is a world that keeps the contract."""
    section = TUTORIAL.partition("## Holes and inner walls")[2].partition("## More")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL)
    path = tmp_path / "ruins.py"
    path.write_text(tutorial().replace("arena=MEADOW", "arena=RUINS") + code, encoding="utf-8")
    scenario = scenarios.load(str(path))
    assert len(scenario.arena.holes) == 2
    assert [str(error) for _, error in contract.check(scenario, 30) if error] == []


def test_the_fields_and_doors_that_are_shown_keep_the_contract():
    """A fly lives among the odour, the mud and the doors of the page."""
    section = TUTORIAL.partition("## Odours, mud and doors")[2].partition("## A rule")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL)
    words = {}
    exec(code, words)
    energy = Need(name="energy", set_point=1.0)
    fly = Species(
        name="fly", needs=(energy,), actions=(rest(),), senses=words["senses"], exposures=words["exposures"], count=3
    )
    meadow = Arena(vertices=((0, 0), (9, 0), (9, 6), (0, 6)), doors=words["doors"])
    fields = (words["smell"], words["mud"])
    carcass = Resource(name="carcass", count=3)
    flies = Scenario(name="flies", arena=meadow, resources=(carcass,), species=(fly,), fields=fields)
    assert [str(error) for _, error in contract.check(flies, 20) if error] == []


def test_the_rule_that_is_shown_takes_what_it_gives():
    """Children near a helper that calls get what it loses; the others get nothing."""
    section = TUTORIAL.partition("## A rule")[2]
    (code,) = re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL)
    words = {}
    exec(code, words)
    energy = Need(name="energy", set_point=1.0)
    helper = Species(name="helper", needs=(energy,), actions=(rest(), act("call")), position=(1.0, 1.0), count=1)
    child = Species(name="child", needs=(energy,), actions=(rest(),), count=40, solid=False)
    room = Arena(vertices=((0, 0), (9, 0), (9, 9), (0, 9)))
    env = Ecology(Scenario(name="nursery", arena=room, resources=(), species=(helper, child), rule=words["share"]))
    env.reset_arrays(seed=0)
    env.step_arrays(np.array([1] + [0] * 40))
    state = env.state_view
    near = np.linalg.norm(state.position[1:] - state.position[0], axis=1) < 2.0
    assert 0 < near.sum() < 40
    np.testing.assert_allclose(state.received[1:, 0], 0.01 * near)
    np.testing.assert_allclose(state.given[0, 0], 0.01 * near.sum())


def own_learner() -> str:
    """Return the file with a learner that the page shows."""
    (found,) = re.findall(r"```python\n(.*?)```", LEARNER, flags=re.DOTALL)
    return found


def test_a_learner_of_ones_own_runs_and_goes_on(tmp_path, monkeypatch, capsys):
    """The page's learner is run by its path, takes a setting, learns, and goes on as if it had not been stopped."""
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(own_learner(), encoding="utf-8")

    def type_(*words):
        with pytest.raises(SystemExit) as left:
            main(words)
        assert left.value.code in (0, None), capsys.readouterr().err

    words = (
        "run",
        "predator_prey",
        "--learner",
        "prey=mine.py",
        "--learner",
        "predator=mine.py:Softmax",
        "--no-record",
    )
    words += ("--set", "prey.learner.temperature=0.5", "--quiet")
    type_(*words, "--ticks", "200", "--out", "whole")
    type_(*words, "--ticks", "120", "--out", "parts")
    monkeypatch.chdir(tmp_path / "parts")
    type_("run", "--resume", ".", "--ticks", "200", "--quiet")
    whole, parts = (checkpoint.read(tmp_path / name / "checkpoint") for name in ("whole", "parts"))
    for name, array in whole["learner_prey"][0].items():
        assert np.array_equal(array, parts["learner_prey"][0][name]), name
    assert whole["learner_prey"][0]["met"].sum() > 1_000
    assert whole["world"][0]["serial"].max() > 60  # slots were used again
    config = (tmp_path / "whole" / "config.toml").read_text()
    assert f'name = "{tmp_path / "mine.py"}"' in config
    assert "temperature = 0.5" in config


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [
        ("gone.py", None, "there is no learner file"),
        ("mine.py", "x = 1", "defines none"),
        ("mine.py:Other", own_learner(), "defines Softmax, and Other is named"),
        (
            "mine.py",
            own_learner() + "\n\nclass Second(Softmax):\n    pass\n",
            "defines Softmax, Second, and none is named",
        ),
        ("mine.py", "x = (", "is no Python"),
        ("mine.py", "x = y", "mine.py"),
        ("mine", own_learner(), "as my_learner.py"),
    ],
)
def test_a_file_that_holds_no_learner_is_one_clear_error(name, code, said, tmp_path, monkeypatch, capsys):
    """A user's error is one message and exit code 2, and nothing is written."""
    monkeypatch.chdir(tmp_path)
    if code:
        Path("mine.py").write_text(code, encoding="utf-8")
    with pytest.raises(SystemExit) as left:
        main(["run", "paper", "--learner", name, "--ticks", "10", "--out", "run"])
    assert left.value.code == 2
    assert said in capsys.readouterr().err.replace("\n", " ")
    assert not Path("run").exists()
