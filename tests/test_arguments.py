"""Nobody changes what it is given: one seed object makes the same learner and the same world as often as it is used."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import FunctionType, MethodType
from typing import Any

import numpy as np
import pytest

from ecology import agents, contract, parallel_env, scenarios
from ecology.agents.base import Transition
from ecology.agents.hjb import HJB
from ecology.agents.planner import Camping, Planner
from ecology.fixed import FixedSlots

EVERY = scenarios.names()
LIVED = ("paper", "predator_prey", "food_share")  # one agent; births and deaths; empathy
TICKS = 12


def content(value: Any) -> Any:
    """Return all that `value` holds, down to the bytes of its arrays, as something that `==` compares."""
    if isinstance(value, np.ndarray):
        return (value.dtype.str, value.shape, value.tobytes())
    if isinstance(value, np.generic):
        return (value.dtype.str, value.tobytes())
    if isinstance(value, np.random.SeedSequence):
        return (value.entropy, value.spawn_key, value.pool_size, value.n_children_spawned, content(value.pool))
    if isinstance(value, np.random.Generator):
        return content(value.bit_generator.state)
    if isinstance(value, Mapping):
        return [(content(key), content(each)) for key, each in value.items()]
    if isinstance(value, (list, tuple)):
        return [type(value).__name__, *map(content, value)]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return [(f.name, content(getattr(value, f.name))) for f in dataclasses.fields(value)]
    if isinstance(value, FunctionType):  # what a scenario's rule or measure was built with
        return (value.__qualname__, [content(cell.cell_contents) for cell in value.__closure__ or ()])
    if isinstance(value, MethodType):
        return (value.__qualname__, content(value.__self__))
    if isinstance(value, float):
        return value.hex()
    assert value is None or isinstance(value, (bool, int, str, type, slice, set, frozenset)), value
    return value


class Given:
    """Arguments as they were handed over, and the check that they are still that."""

    def __init__(self, **values: Any) -> None:
        self.values, self.before = values, {name: content(value) for name, value in values.items()}

    def stays(self) -> None:
        """Check that nothing has changed."""
        for name, value in self.values.items():
            assert content(value) == self.before[name], f"{name} was changed"


def test_the_comparison_sees_a_change() -> None:
    """What `Given` holds is noticed when it changes: an array, a seed, a stream, a mapping, deep inside too."""
    rows, seed, rng, words = np.zeros((2, 2)), np.random.SeedSequence(1), np.random.default_rng(1), {"a": [{"b": 1.0}]}

    def write() -> None:
        rows[1, 1] = -0.0

    changes = {
        "rows": write,
        "seed": lambda: seed.spawn(1),
        "rng": rng.random,
        "words": lambda: words["a"][0].update(b=2.0),
    }
    for name, change in changes.items():
        given = Given(rows=rows, seed=seed, rng=rng, words=words)
        given.stays()
        change()
        with pytest.raises(AssertionError, match=f"{name} was changed"):
            given.stays()


# ---- worlds ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", EVERY)
def test_a_world_leaves_what_it_is_given_as_it_was(name: str) -> None:
    """Building, resetting, stepping, putting and restoring change no argument; two worlds of one seed are the same."""
    changes = {}
    scenario = scenarios.load(name, **changes)
    given = Given(changes=changes, scenario=scenario)
    env, twin = parallel_env(scenario), parallel_env(scenario)
    rng, seed = np.random.default_rng(2), np.int64(5)
    tick, other = env.reset_arrays(seed), twin.reset_arrays(seed)
    given.stays()
    for k in range(TICKS):
        assert content(tick) == content(other)
        assert content(env.state_view) == content(twin.state_view)
        actions = contract.choose(env, tick, rng)
        step = Given(seed=seed, actions=actions)
        tick = env.step_arrays(actions)
        step.stays()
        other = twin.step_arrays(actions)
        if k == TICKS // 2:
            fields = {"internal": env.state_view.internal.copy(), "position": env.state_view.position.copy()}
            arrays, values = env.snapshot()
            put = Given(fields=fields, arrays=arrays, values=values)
            tick = env.set_state(**fields)
            twin.restore(arrays, values)
            other = twin.set_state(**fields)
            put.stays()
    given.stays()
    put.stays()  # nor is it written into later


def mask_of(seen: Any, count: int) -> np.ndarray:
    """Return the mask of `count` actions in an observation, be it a dict or a vector that ends with it."""
    return seen["action_mask"] if isinstance(seen, dict) else seen[-count:]


@pytest.mark.parametrize("name", EVERY)
def test_the_dicts_leave_what_they_are_given_as_it_was(name: str) -> None:
    """`reset` and `step` change neither options nor actions, in a world and in one of fixed slots."""
    scenario = scenarios.load(name)
    for env in (parallel_env(scenario), FixedSlots(parallel_env(scenario))):
        options: dict[str, Any] = {"any": [1]}
        given = Given(options=options, scenario=scenario)
        seen, infos = env.reset(seed=4, options=options)
        for _ in range(3):
            count = {agent: env.action_space(agent).n for agent in env.agents}
            actions = {agent: int(np.argmax(mask_of(seen[agent], count[agent]))) for agent in env.agents}
            step = Given(actions=actions, infos=infos)
            seen, *_, infos = env.step(actions)
            step.stays()
        given.stays()


# ---- learners ----------------------------------------------------------------------------


def lives(env: Any, learner: Any, start: Any, ticks: int = TICKS) -> list[Any]:
    """Return what `learner` did in each tick of a life from `start`, having checked that it changed no argument.

    The others rest. Every call that a loop makes is made, births and deaths too.
    """
    group, tick, did = learner.group, start, []
    for _ in range(ticks):
        zeta, masks = tick.observations[group.name], tick.masks[group.name]
        given = Given(zeta=zeta, masks=masks)
        chosen = learner.act(zeta, masks)
        given.stays()
        actions = np.zeros(env.size, np.int64)
        for each in env.groups.values():
            actions[each.slots] = each.kinds.index("rest")
        actions[group.slots] = np.where(tick.alive[group.slots], chosen, 0)
        did.append(np.array(chosen))
        before, tick = tick, env.step_arrays(actions)
        rows = group.slots
        alive = before.alive[rows] & tick.alive[rows] & ~tick.born[rows]
        met = Transition(
            zeta, masks, tick.action[rows], tick.observations[group.name], tick.masks[group.name], alive,
            tick.died[rows],
        )  # fmt: skip
        # there is always one who dies and one who is born, as a child of the last or of nobody
        died, born, parents = np.array([0]), np.array([0]), np.array([group.size - 1 if group.size > 1 else -1])
        given = Given(transition=met, died=died, born=born, parents=parents, before=before, after=tick)
        learner.learn(met)
        learner.died(died)
        learner.born(born, parents)
        given.stays()
    zeta, mask = tick.observations[group.name], tick.masks[group.name]
    given = Given(zeta=zeta, mask=mask)
    learner.report()
    learner.deviation(0, zeta)
    learner.follow([0])
    learner.decision(0)
    if isinstance(learner, HJB):
        learner.weigh(0, zeta[0], mask[0])
    given.stays()
    return did


def twins(make: Any, seed: np.random.SeedSequence, scenario: Any, group: str) -> None:
    """Check that two learners of one seed object are and do the same, and that neither changes what it is given."""
    env = parallel_env(scenario)
    given = Given(seed=seed, scenario=scenario, group=env.groups[group])
    one, other = make(env.groups[group], seed), make(env.groups[group], seed)
    given.stays()
    assert content(one.state()) == content(other.state())
    did = [lives(env, learner, env.reset_arrays(1)) for learner in (one, other)]
    np.testing.assert_array_equal(*did)
    assert content(one.state()) == content(other.state())
    # the state that it was restored from is not lived in
    arrays, values = one.state()
    arrays = {name: np.array(array) for name, array in arrays.items()}
    kept = Given(arrays=arrays, values=values)
    other.restore(arrays, values)
    kept.stays()
    other.begin()
    lives(env, other, env.reset_arrays(2), 3)
    kept.stays()
    given.stays()


@pytest.mark.parametrize("name", LIVED)
@pytest.mark.parametrize("learner", sorted(agents.LEARNERS))
def test_a_learner_leaves_what_it_is_given_as_it_was(learner: str, name: str) -> None:
    """Two learners built from one seed object are identical and live identically; seed, settings and group stay."""
    scenario = scenarios.load(name)
    group = scenario.species[0].name
    settings = agents.settings(learner)
    if "batch" in settings:
        settings = {**settings, "batch": 2}  # so that it learns within a few ticks
    given = Given(settings=settings)
    twins(lambda group, seed: agents.make(learner, group, seed, settings), np.random.SeedSequence(3), scenario, group)
    given.stays()


@pytest.mark.parametrize("yardstick", [Planner, Camping])
def test_a_yardstick_leaves_what_it_is_given_as_it_was(yardstick: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planners keep to it too, the scenario that they know included."""
    for word in ("GENERATIONS", "SAMPLES", "ELITE", "ORDERS"):
        monkeypatch.setattr("ecology.agents.planner." + word, 2)
    monkeypatch.setattr("ecology.agents.planner.SHORT", 200.0)
    monkeypatch.setattr("ecology.agents.planner.LONG", 200.0)
    scenario = scenarios.load("paper")
    twins(lambda group, seed: yardstick(group, seed, scenario), np.random.SeedSequence(3), scenario, "agent")


def test_a_seed_that_was_used_before_gives_the_same_learner() -> None:
    """A seed that has had children, and a child of it, are as good as new ones."""
    group = parallel_env(scenarios.load("paper")).groups["agent"]
    used = np.random.SeedSequence(3)
    child = used.spawn(4)[2]
    for name in agents.LEARNERS:
        fresh = agents.make(name, group, np.random.SeedSequence(3), {}).state()
        assert content(agents.make(name, group, used, {}).state()) == content(fresh)
        same = np.random.SeedSequence(3, spawn_key=(2,))
        assert content(agents.make(name, group, child, {}).state()) == content(
            agents.make(name, group, same, {}).state()
        )
    assert used.n_children_spawned == 4


@pytest.mark.parametrize("name", [name for name in sorted(agents.LEARNERS) if not agents.learner_class(name).devices])
def test_a_state_that_was_handed_out_stays_as_it_was(name: str) -> None:
    """What `state` returned is not written into by what the learner does afterwards."""
    env = parallel_env(scenarios.load("predator_prey"))
    learner = agents.make(name, env.groups["prey"], np.random.SeedSequence(3), {})
    lives(env, learner, env.reset_arrays(0), 3)
    arrays, values = learner.state()
    given = Given(arrays=arrays, values=values)
    lives(env, learner, env.reset_arrays(1), 3)
    given.stays()
