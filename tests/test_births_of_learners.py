"""Births and deaths as learners see them, and the drive that they know, felt components included."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from worlds import from_python, kind, square, start

from ecology import Ecology, EcologyError, Group, Need, Neighbours, Tick, agents, bite, scenarios, senses
from ecology.agents import loop
from ecology.agents.base import Learner, Transition, drive_terms
from ecology.agents.baselines import Greedy
from ecology.agents.hjb import HJB
from ecology.agents.hjb.devices.cpu.encoding import drive

SEED = np.random.SeedSequence(5)
SMALL = {"width": 16, "batch": 16, "batch_f": 16, "place_cells": 8, "memory": 200, "inherit": True}


class Deathly(Ecology):
    """The world of the scenario, in which slot 1 dies at tick 300 and is born again, child of slot 2, at 310."""

    def step_arrays(self, actions: np.ndarray) -> Tick:
        """Advance one tick, with a death and a birth on the way."""
        tick = super().step_arrays(actions)
        now = self.state_view.tick
        there = np.ones(self.size, bool)
        there[1] = not 300 <= now < 310
        flags = np.arange(self.size) == 1
        masks = {"agent": tick.masks["agent"] & there[:, None]}
        return dataclasses.replace(
            tick,
            masks=masks,
            alive=there,
            died=flags & (now == 300),
            born=flags & (now == 310),
            parent=np.where(flags & (now == 310), 2, -1),
        )


def lived(ticks: int = 300, **settings: object) -> tuple[Deathly, HJB, Tick]:
    """Return three agents that have lived and learned for a while."""
    scenario = scenarios.load("paper")
    three = dataclasses.replace(scenario.species[0], count=3, position=None)
    env = Deathly(dataclasses.replace(scenario, species=(three,)))
    learner = agents.make("hjb", env.groups["agent"], SEED, {**SMALL, **settings})
    assert isinstance(learner, HJB)
    return env, learner, loop.run(env, {"agent": learner}, env.reset_arrays(0), ticks)


def everything(learner: HJB) -> dict[str, np.ndarray]:
    """Return a copy of all that has a row per slot."""
    return {name: array.copy() for name, array in learner.state()[0].items() if name != "generator"}


def test_a_newborn_without_parent_starts_from_nothing() -> None:
    """Its networks answer zero, its optimiser, cells and memory are empty; the other slots are as they were."""
    _, learner, _ = lived()
    where = {name: array.__array_interface__["data"][0] for name, array in learner.state()[0].items()}
    before = everything(learner)
    learner.born(np.array([1]), np.array([-1]))
    after = everything(learner)
    for name in before:
        assert np.array_equal(np.delete(before[name], 1, 0), np.delete(after[name], 1, 0), equal_nan=True), name
    assert {name: a.__array_interface__["data"][0] for name, a in learner.state()[0].items() if name in before} == {
        name: at for name, at in where.items() if name in before
    }
    started = lived(0)[1].state()[0]
    for name in learner._life():
        assert np.array_equal(after[name][1], started[name][1], equal_nan=True), name
    for name in after:
        if name.startswith(("adam", "cell")):
            assert not after[name][1].any(), name
            assert before[name][[0, 2]].any(), name
    for name in ("f", "J"):
        assert np.mean(after[name][1, :100] == before[name][1, :100]) < 0.01, name
    assert learner.epsilon()[1] > learner.epsilon()[0]
    assert np.abs(learner.predict(1, np.zeros((1, learner.components)))["change"]).max() == 0
    assert np.array_equal(learner.target[1], learner.J.weights[1])


def test_a_newborn_inherits_what_its_parent_knows_and_none_of_its_life() -> None:
    """f, J, target and place cells are the parent's; memory, optimiser and age are a newborn's."""
    _, learner, _ = lived()
    parent = everything(learner)
    learner.born(np.array([1]), np.array([2]))
    child = everything(learner)
    for name in child:
        if name in ("f", "J", "target", "cell_centre", "cell_count"):
            assert np.array_equal(child[name][1], parent[name][2]), name
        if name.startswith("adam"):
            assert not child[name][1].any(), name
    assert child["memory.count"][1] == child["age"][1] == child["decisions"][1] == 0
    assert child["cell_count"][1] > 0


def test_mutation_is_relative_to_the_size_of_a_layer() -> None:
    """Inherited weights differ by Gaussian noise of the given share of each layer's root mean square."""
    _, learner, _ = lived(mutation=0.1, width=64)
    learner.born(np.array([1]), np.array([2]))
    for network in (learner.f, learner.J):
        start = 0
        for fan_in in (network.sizes[0], 64):
            layer = slice(start, start + fan_in * 64)
            change = network.weights[1, layer] - network.weights[2, layer]
            share = np.sqrt(np.mean(change**2) / np.mean(network.weights[2, layer] ** 2))
            assert share == pytest.approx(0.1, rel=0.1)
            start = layer.stop + 64
    mutation = learner.J.weights[1] - learner.J.weights[2]
    assert np.allclose(learner.target[1] - learner.target[2], mutation, atol=1e-6)


def test_without_inheritance_a_parent_makes_no_difference() -> None:
    """With `inherit` off a child draws its weights itself."""
    _, learner, _ = lived(inherit=False)
    learner.born(np.array([1]), np.array([2]))
    assert learner.cell_count[1] == 0
    assert np.mean(learner.f.weights[1, :100] == learner.f.weights[2, :100]) < 0.01


def test_a_life_goes_on_through_deaths_and_births() -> None:
    """While a slot is empty nothing of it changes but its streams; the newborn lives and learns from its own life."""
    env, learner, tick = lived(300)
    assert learner.execution.movement[1] == -1
    empty = everything(learner)
    tick = loop.run(env, {"agent": learner}, tick, 9)
    for name in ("age", "decisions", "memory.count"):
        assert everything(learner)[name][1] == empty[name][1], name
    assert np.array_equal(everything(learner)["f"][1], empty["f"][1])
    tick = loop.run(env, {"agent": learner}, tick, 1)
    assert learner.age.tolist() == [310, 0, 310]
    loop.run(env, {"agent": learner}, tick, 400)
    assert learner.age.tolist() == [710, 400, 710]
    assert np.isfinite(learner.loss_f).all()
    assert 0 < learner.memory.count[1] < learner.memory.count[0]
    assert not np.array_equal(everything(learner)["f"][1], empty["f"][1])


def test_the_loop_tells_of_births_by_rows_of_the_species() -> None:
    """Slots become rows, a parent of another species or none is -1, and nobody born or dead is in a transition."""
    told: list[tuple[str, list[int], list[int]]] = []
    alive: list[list[bool]] = []

    class Listener(Learner):
        def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
            return np.zeros(self.size, np.int64)

        def learn(self, transition: Transition) -> None:
            alive.append(transition.alive.tolist())

        def died(self, slots: np.ndarray) -> None:
            told.append(("died", slots.tolist(), []))

        def born(self, slots: np.ndarray, parents: np.ndarray) -> None:
            told.append(("born", slots.tolist(), parents.tolist()))

    scenario = scenarios.load("paper")
    first = dataclasses.replace(scenario.species[0], name="first", count=2, position=None)
    second = dataclasses.replace(first, name="second", count=3)

    class Bearing(Ecology):
        def step_arrays(self, actions: np.ndarray) -> Tick:
            tick = super().step_arrays(actions)
            return dataclasses.replace(
                tick,
                alive=np.array([True, True, False, True, True]),
                died=np.array([False, False, True, False, False]),
                born=np.array([False, True, False, True, True]),
                parent=np.array([-1, -1, -1, 2, 0]),
            )

    env = Bearing(dataclasses.replace(scenario, species=(first, second)))
    learners = {name: Listener(env.groups[name], SEED) for name in ("first", "second")}
    loop.run(env, learners, env.reset_arrays(0), 1)
    assert told == [("born", [1], [-1]), ("died", [0], []), ("born", [1, 2], [0, -1])]
    assert alive == [[True, False], [False, False, False]]


class Notes(Learner):
    """An agent that always takes its action of the given index and keeps every transition."""

    def __init__(self, group: Group, action: int) -> None:
        super().__init__(group, SEED)
        self.action, self.kept = action, list[Transition]()

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return the action for everyone."""
        return np.full(self.size, self.action)

    def learn(self, transition: Transition) -> None:
        """Keep the transition."""
        self.kept.append(transition)


def hunted(sheep: int = 2, **bites: object) -> tuple[Ecology, Notes, Tick]:
    """Return a wolf that bites, and sheep that rest, see it and starve at 0; the last sheep is out of its reach."""
    food = Need(name="food", set_point=2.0, decay=0.25, bounds=(0.0, 4.0), lethal=True)
    words = {"needs": (food,), "neighbours": (Neighbours(species=("wolf",)),)}
    act = bite("sheep", reach=1.0, **bites)
    env = start(
        square(kind("sheep", count=sheep, **words), kind("wolf", act)),
        position=[[2.0, 2.0 + i] for i in range(sheep - 1)] + [[7.0, 7.0], [2.0, 2.5]],
    )
    notes = Notes(env.groups["sheep"], env.groups["sheep"].actions.index("rest"))
    wolf = Notes(env.groups["wolf"], env.groups["wolf"].actions.index("bite_sheep"))
    return env, notes, loop.run(env, {"sheep": notes, "wolf": wolf}, env.set_state(), 1)


def test_a_fatal_tick_reaches_the_learner() -> None:
    """A bite takes 5 of 2 units: the dead agent's needs stand at their bound, and it still sees what killed it."""
    env, notes, tick = hunted(damage={"food": 5.0})
    (fatal,) = notes.kept
    assert fatal.died.tolist() == tick.died[:2].tolist() == [True, False]
    assert fatal.alive.tolist() == [False, True]
    names = env.groups["sheep"].layout.names
    assert names[:2] == ("food", "x")
    assert fatal.next_observations[:, 0].tolist() == [-2.0, -0.25]
    assert notes.drive(fatal.next_observations)[0] == pytest.approx(2.0, abs=1e-3)
    seen = names.index("wolf_1_distance")
    assert fatal.observations[0, seen] == fatal.next_observations[0, seen] == 0.5
    assert np.array_equal(fatal.next_observations[1], tick.observations["sheep"][1])
    assert tick.reward[0] == 0.0  # the account and the reward of a death are as they were
    loop.run(env, {"sheep": notes, "wolf": Notes(env.groups["wolf"], 0)}, tick, 1)
    assert not notes.kept[1].died.any()  # one dies once
    assert notes.kept[1].alive.tolist() == [False, True]


@pytest.mark.parametrize(("damage", "left"), [(None, -0.25), ({"food": 2.5}, -2.0)])
def test_the_needs_at_death_are_those_of_the_fatal_tick(damage, left) -> None:
    """A kill without damage leaves the tick's decay alone; a wound stops at the bound."""
    _, notes, _ = hunted(damage=damage)
    assert notes.kept[0].next_observations[0, 0] == pytest.approx(left)


def test_a_need_that_is_not_finite_at_death_is_shown_as_before() -> None:
    """What a body ran away to is no observation: the need before the tick stands in its place."""
    env, _, tick = hunted(damage={"food": 5.0})
    world = env.world
    senses.show_fatal_needs(world.model, world.state, np.full((3, 1), np.nan), tick.died, tick.observations)
    assert tick.observations["sheep"][0, 0] == 0.0


def test_a_starving_agent_sees_its_last_tick() -> None:
    """Starved after eight ticks of a quarter of a unit, its last observation stands at the bound."""
    env, notes, tick = hunted(sheep=3, chance=0.0)
    loop.run(env, {"sheep": notes, "wolf": Notes(env.groups["wolf"], 0)}, tick, 9)
    died = np.array([t.died for t in notes.kept])
    assert died.sum(axis=0).tolist() == [1, 1, 1]
    at = int(died[:, 0].argmax())
    assert notes.kept[at].observations[0, 0] == -2.0
    assert notes.kept[at].next_observations[:, 0].tolist() == [-2.0] * 3


def test_a_newborn_greedy_agent_has_met_nothing(room) -> None:
    """The mean changes of the last agent of a slot are forgotten."""
    env = Ecology(room(count=2))
    learner = Greedy(env.groups["agent"], SEED)
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 20)
    learner.born(np.array([0]), np.array([1]))
    assert learner.met.sum(axis=1).tolist() == [0, 20]


# ---- the drive that an agent knows ------------------------------------------------------------


def felt_layout(**fields: object) -> SimpleNamespace:
    """Return two regulated needs, one that is not, a place, and two felt components."""
    return SimpleNamespace(
        kinds=("deviation", "deviation", "deviation", "plain", "felt", "felt"),
        regulated=np.array([True, True, False, False, False, False]),
        epsilon=0.5,
        **fields,
    )


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, np.sqrt(0.5 + 9 + 16) + 0.3),
        ({"exponent": 2.0}, 0.5 + 9 + 16 + 0.3),
        (
            {"exponent": 3.0, "own": np.full(6, 0.5), "felt_to": np.array([-1, -1, -1, -1, 0, 1])},
            (0.5 + (1.5 + 0.1) ** 2 + (-2.0 + 0.2) ** 2) ** 1.5,
        ),
    ],
)
def test_drive_as_an_agent_knows_it(fields: dict[str, object], expected: float) -> None:
    """d = (epsilon + sum (own delta + felt)^2)^(p/2) + felt, worked out by hand for the three forms."""
    zeta = np.array([3.0, -4.0, 7.0, 9.0, 0.1, 0.2], np.float32)
    mix, felt, exponent = drive_terms(felt_layout(**fields))  # type: ignore[arg-type]
    own = np.square(zeta @ mix).sum() + 0.5
    assert own ** (exponent / 2) + zeta @ felt == pytest.approx(expected, rel=1e-6)
    mix_from, mix_to = np.nonzero(mix)
    encoding = lived(0)[1].encoding._replace(
        mix_from=mix_from,
        mix_to=mix_to,
        mix_weight=mix[mix_from, mix_to],
        felt=felt,
        epsilon=np.float32(0.5),
        exponent=np.float32(exponent),
        root=np.float32(exponent / 2),
    )
    known = from_python(drive)
    assert known(encoding, zeta, np.empty_like(zeta)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("name", "value"), [("mutation", -0.1), ("inherit", 1), ("mutation", float("nan"))])
def test_bad_inheritance_is_refused(name: str, value: object) -> None:
    """A mutation below zero or an inherit that is no truth value is one clear error."""
    env = Ecology(scenarios.load("paper"))
    with pytest.raises(EcologyError, match=name):
        agents.make("hjb", env.groups["agent"], SEED, {name: value})
