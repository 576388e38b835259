"""Settings of learners as heritable traits: an agent learns and acts by its own, and selection finds the better one."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import Command
from test_devices import SMALL, VARIANTS, computes, learned, update  # noqa: F401  (a fixture among them)
from worlds import kind, square, start

from ecology import Birth, Ecology, EcologyError, Hazard, Need, Scenario, Trait, act, agents, heredity
from ecology.agents import loop
from ecology.agents.base import Learner
from ecology.agents.hjb import HJB
from ecology.agents.hjb.settings import HERITABLE
from ecology.observers.base import Observer
from ecology.observers.recorder import read

SEED = np.random.SeedSequence(3)
OWN: dict[str, tuple[float, float, float]] = {  # a value for each of three agents
    "gamma": (0.9, 0.99, 0.999),
    "youth": (10.0, 100.0, 3000.0),
    "epsilon": (0.0, 0.4, 1.0),
    "epsilon_final": (0.0, 0.3, 0.9),
    "settling": (10.0, 100.0, 1000.0),
    "learning_rate": (1e-4, 1e-3, 1e-2),
    "learning_rate_final": (5e-3, 2e-4, 2e-2),
    "optimism": (0.05, 0.2, 0.6),
    "optimism_young": (0.0, 0.1, 0.5),
    "polyak": (0.01, 0.1, 0.9),
    "mutation": (0.0, 0.1, 0.5),
}
AGE = 50  # ticks learned, at which the young and the adult settings both count
QUIET = {
    "width": 8,
    "batch": 4,
    "batch_f": 4,
    "memory": 20,
    "warm_up": 10_000,
    "tries": 0,
    "pause": 1.0,
}  # never learns


def all_of(learner: HJB) -> dict[str, np.ndarray]:
    """Return what three agents do and become in some updates, (3, ...) by name."""
    learner.age[:] = AGE
    rng = np.random.default_rng(1)
    zeta = rng.uniform(learner.group.layout.low, learner.group.layout.high, (3, learner.components)).astype(np.float32)
    found = {"rate": learner.rate(), "epsilon": learner.epsilon()}
    for _ in update(learner):
        pass
    found["losses"] = np.column_stack([learner.loss_f, learner.loss_j])
    found["scores"] = learner.scores(np.arange(3), zeta, np.ones((3, learner.count), bool))
    return found | learner.state()[0]


def compare_with_uniform(variant: str, device: str = "cpu") -> None:
    """Hold each of three agents with settings of its own to agents that all have its settings, bit for bit."""
    mixed = learned(VARIANTS[variant], device=device)
    mixed.adopt({name: np.array(values) for name, values in OWN.items()})
    found = all_of(mixed)
    for i in range(3):
        same = {name: values[i] for name, values in OWN.items()}
        for name, expected in all_of(learned({**VARIANTS[variant], **same}, device=device)).items():
            assert np.array_equal(found[name][i], expected[i], equal_nan=True), (name, i)


@pytest.mark.parametrize("variant", ["default", "lean", "algorithm1 from batches, with place cells"])
def test_an_agent_learns_and_scores_by_its_own_settings(variant: str, computes: str) -> None:  # noqa: F811
    """On kernels and torch, agent i is one of agents that all have its settings: weights, losses, scores, rates."""
    compare_with_uniform(variant)


def test_so_it_does_on_the_plain_device() -> None:
    """The reference, too, has settings of every agent's own; other tests hold the devices together."""
    compare_with_uniform("default", "plain")


@pytest.mark.parametrize("name", [name for name in HERITABLE if name != "mutation"])
def test_every_heritable_setting_changes_something(name: str) -> None:
    """The agents that adopt another value are others than before, and those whose value is the old one are not."""
    before = learned(SMALL)
    usual = float(before.number(name))
    own = learned(SMALL)
    own.adopt({name: np.array([OWN[name][0], usual, OWN[name][2]])})
    one, other = all_of(before), all_of(own)
    differs = [any(not np.array_equal(one[key][i], other[key][i], equal_nan=True) for key in one) for i in range(3)]
    assert differs == [True, False, True]


def test_an_heir_mutates_by_its_own_rate() -> None:
    """With `mutation` as a trait, a newborn's weights differ from its parent's by the newborn's own rate."""
    learner = agents.make("hjb", Ecology(population(MUTATES)).groups["body"], SEED, {**QUIET, "inherit": True})
    assert isinstance(learner, HJB)
    rates = np.zeros(learner.size)
    rates[10:20], rates[20:30] = 0.1, 0.5
    learner.adopt({"mutation": rates})
    heirs = np.arange(10, 40)
    learner.born(heirs, np.zeros(30, np.int64))
    hidden = slice(0, learner.f.weights.shape[1] - learner.f.last)
    size = np.sqrt(np.mean(learner.f.weights[0, hidden] ** 2))
    spread = np.sqrt(np.mean((learner.f.weights[heirs, hidden] - learner.f.weights[0, hidden]) ** 2, axis=1)) / size
    assert spread[20:].max() == 0.0
    assert np.mean(spread[:10]) == pytest.approx(0.1, rel=0.1)
    assert np.mean(spread[10:20]) == pytest.approx(0.5, rel=0.1)


# ---- in a population ---------------------------------------------------------------------------


def curiosity(**words: Any) -> Trait:
    """Return the exploration of adults as a trait."""
    found = {"name": "curiosity", "of": "learner.epsilon_final", "bounds": (0.0, 1.0), "start": 0.5, "spread": 0.3}
    return Trait(**{**found, **words})


MUTATES = Trait(name="drift", of="learner.mutation", bounds=(0.0, 1.0), start=0.1)


def population(*traits: Trait, count: int = 60, **words: Any) -> Scenario:
    """Return bodies that can rest, or waste food, which costs fitness; one that does not explore rests."""
    food = Need(name="food", set_point=2.0, decay=-0.1, bounds=(0.0, 2.0))
    birth = Birth(rate=0.1, threshold={"food": 1.0})
    waste = act("waste", control={"food": -0.6})
    settings = {**QUIET, "epsilon": 0.5, "youth": 1e-3}  # adults at once
    body = kind(
        "body", waste, needs=(food,), count=count, capacity=2 * count, birth=birth, hazard=Hazard(rate=0.05),
        traits=traits, senses=(), learner="hjb", learner_settings=settings, **words,
    )  # fmt: skip
    return square(body)


def learners(env: Ecology, **settings: Any) -> dict[str, Learner]:
    """Return the learners that the scenario names."""
    own = {**env.scenario.species[0].learner_settings, **settings}
    return {"body": agents.make("hjb", env.groups["body"], SEED, own)}


class Explorers(Observer):
    """An observer that counts decisions and those at random, by slot, and holds the learner to the world's traits."""

    def __init__(self, size: int) -> None:
        self.decided, self.explored = np.zeros(size), np.zeros(size)

    def watch(self, state: Any, tick: Any, minds: Any) -> None:
        """Look at one tick, in which every movement takes one."""
        alive = tick.alive & ~tick.born
        self.decided += alive
        self.explored += alive & (minds["body"].explores == 1)
        assert np.array_equal(minds["body"].number("epsilon_final")[tick.alive], state.trait[tick.alive, 0])
        assert np.array_equal(minds["body"].report()["epsilon"][alive], state.trait[alive, 0])


def test_agents_explore_at_their_own_rates() -> None:
    """The share of decisions at random is each agent's trait, and the learner's numbers are the world's at any tick."""
    env = Ecology(population(curiosity(mutation=0.1)))
    rates = np.linspace(0.0, 1.0, env.size)
    env.reset_arrays(1)
    watch = Explorers(env.size)
    loop.run(env, learners(env), env.set_state(trait=rates[:, None]), 60, [watch])
    assert (env.state_view.serial >= 60).any()  # newborns too
    body = dataclasses.replace(env.scenario.species[0], birth=None, hazard=None, capacity=60)
    calm = Ecology(dataclasses.replace(env.scenario, species=(body,)))
    calm.reset_arrays(1)
    minds, rates = learners(calm), np.linspace(0.0, 1.0, calm.size)
    tick = loop.run(calm, minds, calm.set_state(trait=rates[:, None]), 1)  # after it all are adults
    loop.run(calm, minds, tick, 200, [watch := Explorers(calm.size)])
    sd = np.sqrt(rates * (1 - rates) / 200)
    assert (np.abs(watch.explored / watch.decided - rates) <= 5 * sd + 1e-9).all()


def bred(env: Ecology, minds: dict[str, Learner], tick: Any, ticks: int) -> tuple[Any, dict[int, tuple[int, ...]]]:
    """Run for `ticks`; return the last tick, and of whom before everybody alive descends."""
    sources = {int(s): (int(s),) for s in env.state_view.serial[tick.alive]}
    for _ in range(ticks):
        tick = loop.advance(env, minds, tick, 1)
        now = env.state_view
        for slot in np.flatnonzero(tick.born).tolist():
            sources[int(now.serial[slot])] = sources[int(now.parent[slot])]
    return tick, {int(s): sources[int(s)] for s in env.state_view.serial[tick.alive]}


def traits_of(env: Ecology) -> dict[int, float]:
    """Return the trait of everybody who is alive, by serial."""
    now = env.state_view
    assert now.trait is not None
    return dict(zip(now.serial[now.alive].tolist(), now.trait[now.alive, 0].tolist(), strict=True))


@pytest.mark.parametrize("mutation", [0.0, 0.02])
def test_exploration_that_costs_fitness_is_selected_against(mutation: float) -> None:
    """Exploration falls, in the median of seeds, by selection; the Price equation closes, and bounds hold."""
    falls = []
    for seed in range(5):
        env = Ecology(population(curiosity(mutation=mutation)))
        minds, tick = learners(env), env.reset_arrays(seed)
        first, selected = float(np.mean(list(traits_of(env).values()))), 0.0
        for _ in range(8):
            before = traits_of(env)
            tick, sources = bred(env, minds, tick, 25)
            after = {serial: (value, sources[serial]) for serial, value in traits_of(env).items()}
            parts = heredity.price(before, after)
            assert abs(parts.change - parts.selection - parts.transmission) < 1e-12
            assert mutation or abs(parts.transmission) < 1e-12
            assert all(0.0 <= value <= 1.0 for value in before.values())
            selected += parts.selection
        falls.append((float(np.mean(list(traits_of(env).values()))) - first, selected))
    change, selection = np.median(falls, axis=0)
    assert change < -0.1
    assert selection < -0.1


def test_a_baseline_in_the_same_world_ignores_the_trait() -> None:
    """An evaluation measures baselines in the learner's world; they have no such setting, and run."""
    from ecology.agents.baselines import Random

    env = Ecology(population(curiosity()))
    loop.run(env, {"body": Random(env.groups["body"], SEED)}, env.reset_arrays(0), 5)


def test_worlds_without_such_traits_ask_nothing_of_their_learners(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop adopts nothing where no setting is inherited."""
    marker = Trait(name="mark", of="none", bounds=(0.0, 1.0))
    env = Ecology(population(marker))
    assert env.groups["body"].inherited == ()

    def refuse(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(HJB, "adopt", refuse)
    loop.run(env, learners(env), env.reset_arrays(0), 3)


@pytest.mark.parametrize(
    ("trait", "learner", "rule"),
    [
        (curiosity(of="learner.width", start=8.0, bounds=(1.0, 64.0)), "hjb", "learner.width, which cannot be a trait"),
        (curiosity(of="learner.nonsense"), "hjb", "learner.nonsense, which cannot be a trait"),
        (curiosity(), "random", "no setting of it can be"),
        (curiosity(of="learner.gamma"), "hjb", r"has bounds \(0.0, 1.0\): learner setting gamma must be between"),
    ],
)
def test_what_no_learner_can_inherit_is_refused(trait: Trait, learner: str, rule: str) -> None:
    """Of a setting that shapes arrays, of none at all, of another learner, and beyond the limits of the setting."""
    env = Ecology(population(trait))
    with pytest.raises(EcologyError, match=rule):
        agents.make(learner, env.groups["body"], SEED, {})


def test_a_start_that_nobody_knows_is_refused() -> None:
    """Without a start it is the species' own setting; the learner's default is not the world's to know."""
    assert start(population(curiosity(of="learner.epsilon", start=None, spread=0.0))).state_view.trait[0, 0] == 0.5
    with pytest.raises(EcologyError, match="needs a start"):
        population(curiosity(of="learner.gamma", start=None, bounds=(0.5, 0.9)))
    with pytest.raises(EcologyError, match="cannot be inherited"):
        population(curiosity(of="learner."))


# ---- in a run ----------------------------------------------------------------------------------

FILE = """
from ecology import Arena, Birth, Hazard, Need, Scenario, Species, Trait, rest, act

def build(of="epsilon_final", start=0.3, ticks=60):
    food = Need(name="food", set_point=2.0, decay=0.02, bounds=(0.0, 4.0))
    body = Species(
        name="body", needs=(food,), actions=(rest(), act("eat", control={"food": 0.1})), count=6, capacity=12,
        birth=Birth(rate=0.05), hazard=Hazard(rate=0.02), solid=False, senses=(), learner="lean",
        learner_settings={"width": 8, "memory": 50, "update_every": 1.0, "warm_up": 4, "pause": 1.0},
        traits=(Trait(name="own", of="learner." + of, bounds=(0.0, 0.9), start=start, spread=0.2, mutation=0.05),),
    )
    return Scenario(name="own", arena=Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4))), species=(body,), ticks=ticks)
"""


@pytest.fixture
def world(tmp_path: Path) -> Iterator[Path]:
    """Return a scenario file in which a learner's setting is inherited."""
    (tmp_path / "own.py").write_text(FILE, encoding="utf-8")
    return tmp_path / "own.py"


def test_a_run_records_and_resumes_them(world: Path, tmp_path: Path, ecology: Command) -> None:
    """Metrics have a column, the summary a mean, and a resumed run is the run that was never stopped."""
    options = ["--seed", "2", "--record", "every=5"]
    assert ecology("run", str(world), "--out", str(tmp_path / "a"), *options)[0] == 0
    assert ecology("run", str(world), "--out", str(tmp_path / "b"), "--ticks", "35", *options)[0] == 0
    assert ecology("run", "--resume", str(tmp_path / "b"), "--ticks", "60")[0] == 0
    tables = [read(tmp_path / name / "metrics.parquet").to_pydict() for name in "ab"]
    assert tables[0] == tables[1]
    assert len(set(tables[0]["traits.own"])) > 5
    assert '"traits"' in (tmp_path / "a" / "summary.json").read_text()


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["--set", "of=width"], "which cannot be a trait of the learner lean"),
        (["--set", "of=nonsense"], "which cannot be a trait of the learner lean"),
        (["--learner", "random"], "no setting of it can be"),
        (["--set", "learner.epsilon_final=0.2"], "is inherited"),
    ],
)
def test_commands_refuse_what_cannot_be(
    world: Path, tmp_path: Path, ecology: Command, words: list[str], rule: str
) -> None:
    """With exit code 2, and nothing is written."""
    code, _, said = ecology("run", str(world), "--out", str(tmp_path / "run"), *words)
    assert code == 2
    assert rule in " ".join(said.split())
    assert not (tmp_path / "run").exists()
