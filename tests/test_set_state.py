"""Putting a world where one wants it: what no world can come to is refused, and names stay true."""

import math

import numpy as np
import pytest
from worlds import everything, kind, square, start

import ecology
from ecology import EcologyError, Hazard, Need, Oscillation, Resource, consume, contract, move, scenarios
from ecology.state import CAUSES


def one_of_each():
    """Return a world of two callers, a listener and four patches, all of them with a need of bounds 0 to 4."""
    patches = (
        Resource(name="berries", count=2, stock=1.0),
        Resource(name="pond", position=(4.0, 4.0)),
        Resource(name="fly", position=(2.0, 2.0), motion=Oscillation(to=(6.0, 2.0), period=50.0)),
    )
    two = kind("caller", move("walk", 0.3), count=2, needs=(Need(name="food", set_point=2.0, bounds=(0.0, 4.0)),))
    return square(two, kind("listener"), resources=patches)


@pytest.mark.parametrize(
    ("field", "row", "value", "said"),
    [
        ("position", 1, (50.0, 50.0), "position[1] must be inside the arena, got [50.0, 50.0]"),
        ("position", 0, (0.0, 4.0), "inside the arena"),  # on the wall
        ("position", 2, (math.nan, 4.0), "position[2] must be finite"),
        ("heading", 0, math.nan, "heading[0] must be finite, got nan"),
        ("heading", 0, math.inf, "must be finite"),
        ("internal", 1, math.nan, "internal[1] must be finite"),
        ("internal", 1, 4.5, "internal[1] must be within the bounds of the need, 0 to 4, got [4.5]"),
        ("internal", 0, -0.1, "within the bounds"),
        ("stock", 0, -1.0, "stock[0] must be from 0 to the capacity, 1, got -1.0"),
        ("stock", 1, 1.5, "stock[1] must be from 0 to the capacity"),
        ("stock", 1, math.inf, "stock[1] must be from 0 to the capacity"),
        ("stock", 2, math.nan, "stock[2] must be from 0 to the capacity"),
        ("resource_position", 3, (9.0, 4.0), "resource_position[3] must be inside the arena"),
        ("age", 1, -1.0, "age[1] must be at least 0"),
        ("hold", 1, math.nan, "hold[1] must be finite"),
        ("action", 0, 2, "action[0] must be a whole number from 0 to 1, got 2"),
        ("action", 2, 1, "action[2] must be a whole number from 0 to 0, got 1"),
        ("bound_for", 0, 4, "bound_for[0] must be a whole number from -1 to 3"),
        ("bit", 0, 3, "bit[0]"),
        ("gave", 0, -2, "gave[0]"),
        ("cause", 0, 1, "cause[0] must be 0 where alive"),
        ("cause", 0, len(CAUSES), "cause[0]"),
        ("killer", 0, 3, "killer[0]"),
        ("parent", 0, 3, "parent[0]"),
        ("serial", 0, 1, "serial[0] must be what it is"),
        ("eaten", 0, math.nan, "eaten[0] must be finite"),
    ],
)
def test_what_no_world_can_come_to_is_refused(field, row, value, said):
    """The field, the row, the rule and the value are named, and nothing has changed, other fields of the call too."""
    env = start(one_of_each())
    before = env.state_view.copy()
    wrong = before.arrays()[field].copy()
    wrong[row] = value
    with pytest.raises(EcologyError) as error:
        env.set_state(**{"heading": np.ones(3), field: wrong})
    assert said in str(error.value)
    for name, values in before.arrays().items():
        assert np.array_equal(values, env.state_view.arrays()[name]), name


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"alive": [0.3, 1.0, 1.0]}, "state 'alive' must be True or False"),
        ({"action": [0.5, 0.0, 0.0]}, "state 'action' must be whole numbers"),
        ({"action": [True, False, False]}, "state 'action' must be whole numbers"),
        ({"heading": ["north", "east", "west"]}, "state 'heading' must be numbers"),
        ({"heading": [[0.0], [1.0, 2.0], [0.0]]}, "state 'heading' has the shape (3,)"),
        ({"heading": [None, None, None]}, "state 'heading' must be numbers"),
        ({"headings": [0.0, 0.0, 0.0]}, "Did you mean 'heading'"),
    ],
)
def test_values_of_another_type_are_refused(fields, said):
    """Nothing is rounded or cut to the type of a field."""
    with pytest.raises(EcologyError) as error:
        start(one_of_each()).set_state(**fields)
    assert said in str(error.value)


def test_a_heading_is_wrapped():
    """As in a scenario any number of turns is a heading, and the state holds it in [-pi, pi)."""
    env = start(one_of_each(), heading=[7.0, math.pi, -3.0])
    assert env.state_view.heading.tolist() == [pytest.approx(7.0 - 2 * math.pi), -math.pi, -3.0]


def test_a_lethal_need_can_be_put_beyond_its_bounds():
    """The agent dies of it on the next tick."""
    lethal = Need(name="food", set_point=2.0, bounds=(0.0, 4.0), lethal=True)
    env = start(square(kind(count=2, needs=(lethal,))), internal=[[2.0], [-1.0]])
    assert env.step_arrays(np.zeros(2, np.int64)).died.tolist() == [False, True]


def test_the_dead_lie_anywhere():
    """What a slot holds in which nobody lives is checked for numbers only; it is checked when someone lives there."""
    env = start(square(kind(count=1, capacity=2, birth=ecology.Birth(rate=1e-9))))
    env.set_state(internal=[[2.0], [9.0]], position=[[4.0, 4.0], [0.0, 0.0]])
    with pytest.raises(EcologyError, match=r"internal\[1\] must be within"):
        env.set_state(alive=[True, True])
    with pytest.raises(EcologyError, match=r"position\[1\] must be inside"):
        env.set_state(alive=[True, True], internal=[[2.0], [1.0]])
    env.set_state(alive=[True, True], internal=[[2.0], [1.0]], position=[[4.0, 4.0], [5.0, 5.0]])


def test_a_state_can_be_put_back_as_it_is():
    """Whatever a world has come to, births, deaths and full stocks included, is allowed."""
    env, rng = start(everything()), np.random.default_rng(0)
    tick = env.reset_arrays(seed=0)
    for _ in range(300):
        tick = env.step_arrays(contract.choose(env, tick, rng, open_only=True))
        if env.state_view.tick > 60 and tick.died.any():
            break
    before = env.state_view.copy()
    assert (before.cause > 0).any()
    env.set_state(**before.arrays())
    for name, values in before.arrays().items():
        assert np.array_equal(values, env.state_view.arrays()[name]), name


def test_an_unlimited_stock_that_is_put_is_eaten_up():
    """It is as finite as any, also in a world that has no other, and in one that is restored."""
    agent = kind("agent", consume("pond", {"food": 0.5}), position=(4.0, 4.0))
    env = start(square(agent, resources=(Resource(name="pond", position=(4.0, 4.0)),)), internal=[[0.0]], stock=[0.75])
    other = ecology.parallel_env(env.scenario)
    other.restore(*env.snapshot())
    for world in (env, other):
        world.step_arrays(np.array([1]))
        assert world.state_view.stock.tolist() == [0.25]
        world.step_arrays(np.array([1]))
        assert world.state_view.stock.tolist() == [0.0]
        assert world.state_view.internal.tolist() == [[0.75]]


# ---- names ---------------------------------------------------------------------------------------


def names(env):
    """Return the names of the living, from the state."""
    return [env.name_of(slot) for slot in np.flatnonzero(env.state_view.alive)]


def test_names_follow_who_is_put_to_death_and_to_life():
    """The dead leave `agents` and have a cause; whoever lives in a slot where nobody did gets a name of its own."""
    env = ecology.parallel_env(square(kind(count=3, capacity=5, birth=ecology.Birth(rate=1e-9))))
    env.reset(seed=0)
    env.set_state(alive=[True, False, True, False, False])
    assert env.agents == names(env) == ["agent_0", "agent_2"]
    assert [CAUSES[c] for c in env.state_view.cause[:3]] == ["alive", "rule", "alive"]
    places = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0], [4.0, 4.0], [5.0, 5.0]])
    env.set_state(alive=[True, True, False, True, False], position=places, internal=np.full((5, 1), 2.0))
    assert env.agents == names(env) == ["agent_0", "agent_1", "agent_3"]
    assert env.state_view.next_serial == 4
    assert env.state_view.cause.tolist() == [0, 0, CAUSES.index("rule"), 0, 0]
    observations, *_ = env.step(dict.fromkeys(env.agents, 0))
    assert list(observations) == ["agent_0", "agent_1", "agent_3"]


def test_nobody_is_put_where_nobody_has_a_name():
    """In a world without births the names are those of the founders."""
    env = start(square(kind(count=1, capacity=2)))
    with pytest.raises(EcologyError, match=r"nobody can live in the slots \[1\].*Raise the count"):
        env.set_state(alive=[True, True], position=[[1.0, 1.0], [2.0, 2.0]])


@pytest.mark.parametrize("world", ["well_mixed", "everything"])
def test_names_are_true_after_steps_in_arrays(world):
    """Dicts and arrays can be mixed: every name is that of the body in its slot, and acts for it."""
    scenario = everything() if world == "everything" else scenarios.load(world)
    env, rng = ecology.parallel_env(scenario), np.random.default_rng(0)
    env.reset(seed=0)
    tick = env.reset_arrays(seed=0)
    first = names(env)
    assert env.agents == first
    for _ in range(50):
        tick = env.step_arrays(contract.choose(env, tick, rng, open_only=True))
    assert names(env) != first
    assert env.agents == names(env)
    slots = np.flatnonzero(tick.alive)
    wanted = contract.choose(env, tick, rng, open_only=True)
    serial = env.state_view.serial.copy()
    observations, *_ = env.step(dict(zip(env.agents, wanted[slots].tolist(), strict=True)))
    now = env.state_view
    same = slots[(now.serial[slots] == serial[slots]) & now.alive[slots]]
    assert same.size
    assert np.array_equal(now.action[same], wanted[same])
    for name in env.agents:
        assert name in observations
    assert env.agents == names(env)


def test_names_are_true_at_the_horizon_and_before_a_reset():
    """Nobody is left once the horizon is reached, by dicts or by arrays, and everyone is back after a reset."""
    env = ecology.parallel_env(square(kind(count=2, hazard=Hazard(rate=0.0))), horizon=3)
    assert env.agents == []
    env.reset_arrays(seed=0)
    assert env.agents == ["agent_0", "agent_1"]
    for _ in range(3):
        env.step_arrays(np.zeros(2, np.int64))
    assert env.agents == []
    env.reset(seed=0)
    assert env.agents == ["agent_0", "agent_1"]
