"""What bodies carry: taken, put down, stored and lost; the sum of stocks and loads stays what it was."""

import math

import numpy as np
import pytest
from worlds import ask, assert_refused, kind, square, start

from ecology import Growth, Resource, consume, contract, drop, move, parallel_env, take


def nuts(**words):
    """Return a thing that lies about in patches that come and go."""
    return Resource(**{"name": "nuts", "count": 3, "present": 1, "stock": 2.0, "capacity": 3.0, "gone_below": 0.0,
                       "radius": 0.5, **words})  # fmt: skip


LARDER = Resource(name="larder", position=(6.0, 4.0), radius=0.5, stock=0.0, capacity=1.5)


def world(*things, count=1, rule=None, most=1.0, **words):
    """Return bodies that stand in a patch of nuts at (2, 4), and haul."""
    acts = (take("nuts", 0.4), drop("nuts", 0.3), drop("nuts", 0.5, into="larder", name="store"),
            move("east", 0.5, direction=0.0), consume("nuts", {"food": 0.5}),
            consume("larder", {"food": 0.5}))  # fmt: skip
    species = kind("agent", *acts, count=count, position=(2.0, 4.0), carries={"nuts": most}, senses=("load",), **words)
    env = start(square(species, resources=(*things, LARDER), rule=rule))
    place = env.state_view.resource_position.copy()
    place[0] = (2.0, 4.0)
    env.set_state(resource_position=place)
    return env


def lived(env, ticks, **wanted):
    """Let `ticks` pass and return the state."""
    for _ in range(ticks):
        env.step_arrays(ask(env, **wanted))
    return env.state_view


def is_open(env, action):
    """Return whether an action of the first agent is open."""
    group = env.groups["agent"]
    return bool(env.set_state().masks["agent"][0, group.actions.index(action)])


def test_what_is_taken_is_carried_up_to_the_most():
    """The stock loses what the load gains; nothing more fits into a full load, which is sensed as a share."""
    env = world(nuts())
    first = env.state_view.copy()
    assert not is_open(env, "drop_nuts")
    for ticks, load in ((1, 0.4), (1, 0.8), (1, 1.0), (1, 1.0)):
        state = lived(env, ticks, agent="take_nuts")
        assert state.load[0, 0] == pytest.approx(load)
        assert state.stock[0] == pytest.approx(2.0 - load)
        contract.account_closes(env, first)
    assert not is_open(env, "take_nuts")
    names = env.groups["agent"].layout.names
    assert env.set_state().observations["agent"][0, names.index("load_nuts")] == pytest.approx(1.0)


def test_a_short_stock_is_shared():
    """Of 1 unit, three that could take 0.4 get a third each, and the patch is gone."""
    env = world(nuts(stock=1.0), count=3)
    state = lived(env, 1, agent="take_nuts")
    np.testing.assert_allclose(state.load[:, 0], 1 / 3)
    assert state.stock[0] == 0.0
    assert not is_open(env, "take_nuts")


def test_what_is_dropped_lies_there_and_can_be_eaten():
    """Put down elsewhere it is a patch, into which more goes; eaten, it feeds as much as was carried."""
    env = world(nuts(), most=2.0)
    lived(env, 2, agent="take_nuts")
    lived(env, 4, agent="east")
    env.set_state(internal=np.array([[1.0]]))
    state = lived(env, 1, agent="drop_nuts")
    assert state.stock[1] == pytest.approx(0.3)
    assert state.resource_position[1] == pytest.approx([4.0, 4.0])
    state = lived(env, 2, agent="drop_nuts")
    assert state.stock[:3].tolist() == pytest.approx([1.2, 0.8, 0.0])
    assert state.load[0, 0] == pytest.approx(0.0)
    assert not is_open(env, "drop_nuts")
    state = lived(env, 3, agent="consume_nuts")
    assert state.internal[0, 0] == pytest.approx(1.8)
    assert state.stock[1] == 0.0


def test_a_store_holds_what_is_put_into_it_up_to_its_capacity():
    """It is open within its circle alone, an empty one too; what has no room stays with the body."""
    env = world(nuts(stock=3.0), most=2.0)
    lived(env, 5, agent="take_nuts")
    assert not is_open(env, "store")
    lived(env, 8, agent="east")
    assert is_open(env, "store")
    state = lived(env, 3, agent="store")
    assert state.stock[3] == pytest.approx(1.5)
    assert state.load[0, 0] == pytest.approx(0.5)
    assert not is_open(env, "store")
    assert is_open(env, "consume_larder")
    assert state.stock.sum() + state.load.sum() == pytest.approx(3.0)


def test_a_load_falls_where_its_body_dies():
    """It becomes a patch; without a free one it is lost; the dead carry nothing."""

    def kill(world, rng):
        outcome = world.no_effect()
        outcome.killed[:] = world.state.tick == 4
        return outcome

    for count, left in ((3, 0.8), (1, 0.0)):
        env = world(nuts(count=count, present=1), rule=kill)
        lived(env, 2, agent="take_nuts")
        state = lived(env, 3, agent="east")
        assert not state.alive.any()
        assert state.load.tolist() == [[0.0, 0.0]]
        assert state.stock[1:-1].sum() == pytest.approx(left)
        if left:
            assert state.resource_position[1] == pytest.approx(state.position[0])


def test_nothing_comes_of_nothing():
    """Over a long life of random hauling without meals, stocks and loads together stay what they were, to rounding."""
    env = world(nuts(stock=3.0), count=6, most=0.7)
    total = env.state_view.stock.sum()
    rng = np.random.default_rng(0)
    tick = env.set_state()
    hauls = [env.groups["agent"].actions.index(name) for name in ("take_nuts", "drop_nuts", "store", "east")]
    for t in range(150):
        mask = tick.masks["agent"][:, hauls]
        wanted = np.array([rng.choice(np.flatnonzero(row)) for row in mask])
        tick = env.step_arrays(np.array(hauls)[wanted])
        state = env.state_view
        assert state.stock.sum() + state.load.sum() == pytest.approx(total, abs=1e-12), t
    assert state.stock[-1] > 0.0


@pytest.mark.parametrize("holds", ["the action mask is honoured", "a snapshot continues bit for bit",
                                   "a copy continues bit for bit", "every account closes"])  # fmt: skip
def test_a_world_with_loads_keeps_the_contract(holds):
    """Masks, snapshots, copies and accounts are right with loads."""
    env = world(nuts(growth=Growth(rate=0.05)), count=5)
    contract.CHECKS[holds](env.scenario, 60)


def test_an_unlimited_source_gives_without_end():
    """It stays unlimited, and its account has nothing of what is carried away."""
    well = Resource(name="nuts", position=(2.0, 4.0), radius=0.5)
    env = parallel_env(
        square(kind("agent", take("nuts", 0.4), position=(2.0, 4.0), carries={"nuts": 1.0}), resources=(well,))
    )
    env.reset_arrays(seed=0)
    state = lived(env, 5, agent="take_nuts")
    assert state.load[0, 0] == 1.0
    assert state.stock[0] == math.inf
    assert state.grown[0] == state.eaten[0] == 0.0


WRONG = {
    "taking nothing": (lambda: take("nuts", 0.0), ["amount", "0.0"]),
    "an amount of a walk": (lambda: move("walk", 1.0, amount=1.0), ["amount", "1.0"]),
    "a long drop": (lambda: drop("nuts", 1.0, duration=2.0), ["duration", "2.0"]),
    "what is not carried": (
        lambda: square(kind("agent", take("nuts", 1.0)), resources=(nuts(),)), ["'nuts'", "carries"],
    ),
    "an unknown thing": (lambda: square(kind(carries={"nut": 1.0}), resources=(nuts(),)), ["'nut'", "nuts"]),
    "an unknown store": (
        lambda: square(kind("a", drop("nuts", 1.0, into="lard"), carries={"nuts": 1.0}), resources=(nuts(), LARDER)),
        ["'lard'", "larder"],
    ),
    "a load of nothing": (lambda: kind(carries={"nuts": 0.0}), ["positive", "0.0"]),
    "too much put": (lambda: world(nuts()).set_state(load=np.array([[9.0, 0.0]])), ["load[0]", "carries"]),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_a_mistake_is_told(what):
    """The message names the rule and the value."""
    assert_refused(*WRONG[what])


def test_metrics_have_the_load(tmp_path):
    """The recorder writes what each agent carries, a column for each thing that anybody carries."""
    from ecology.agents import loop, make
    from ecology.observers.recorder import Recorder, read

    env = world(nuts())
    minds = {"agent": make("random", env.groups["agent"], np.random.SeedSequence(0), {})}
    recorder = Recorder(tmp_path / "metrics.parquet", every=1)
    loop.run(env, minds, env.set_state(load=np.array([[0.25, 0.0]])), 3, [recorder])
    table = read(tmp_path / "metrics.parquet")
    assert [name for name in table.column_names if name.startswith("load.")] == ["load.nuts"]
    assert table["load.nuts"].to_pylist()[-1] == pytest.approx(env.state_view.load[0, 0])


def test_a_body_that_is_removed_carries_nothing():
    """An intervention that ends a life between two ticks loses the load with it."""
    env = world(nuts(), count=2)
    lived(env, 2, agent="take_nuts")
    env.set_state(alive=np.array([True, False]))
    assert env.state_view.load[:, 0].tolist() == pytest.approx([0.8, 0.0])
