"""Patches that come and go: what spoils, what a body leaves, seeds, and what a rule brings, against closed forms."""

import math

import numpy as np
import pytest
from worlds import ask, assert_refused, kind, square, start

from ecology import (
    Arena,
    Birth,
    Growth,
    Hazard,
    Need,
    Remains,
    Resource,
    Seeding,
    consume,
    contract,
    go_to,
    move,
    parallel_env,
    scenarios,
)


def berries(**words):
    """Return a resource whose patches come and go."""
    return Resource(**{"name": "berries", "count": 4, "stock": 1.0, "gone_below": 0.1, **words})


def lived(env, ticks, **wanted):
    """Let `ticks` pass and return the state."""
    for _ in range(ticks):
        env.step_arrays(ask(env, **wanted))
    return env.state_view


# ---- what spoils -------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_a_stock_spoils_exponentially(dt):
    """After t units of time exp(-decay t) of the stock is left, whatever the tick; unlimited stocks stay."""
    rotten = Resource(name="berries", position=(1.0, 1.0), stock=3.0, decay=0.05)
    env = start(square(kind(), resources=(rotten, Resource(name="pond", position=(5.0, 5.0))), dt=dt))
    state = lived(env, round(8 / dt))
    assert state.stock[0] == pytest.approx(3.0 * math.exp(-0.05 * 8), rel=1e-12)
    assert state.stock[1] == math.inf


def test_a_patch_is_gone_below_its_threshold():
    """It goes in the first tick in which less is left, all of it is spoiled, and nothing grows where it was."""
    env = start(square(kind(), resources=(berries(decay=0.1),)))
    last = math.floor(math.log(10) / 0.1)  # ticks after which more than a tenth is left
    assert (lived(env, last).stock > 0.1).all()
    state = lived(env, 1)
    assert (state.stock == 0).all()
    np.testing.assert_allclose(state.grown, -1.0, rtol=1e-12)
    assert (lived(env, 5).stock == 0).all()


def test_a_patch_that_is_eaten_up_is_gone_though_its_kind_grows():
    """A patch that stays regrows linearly from nothing; one that goes does not."""
    for gone, left in ((None, True), (0.0, False)):
        food = Resource(
            name="berries",
            count=1,
            position=(4.0, 4.0),
            stock=0.1,
            capacity=2.0,
            gone_below=gone,
            growth=Growth(rate=0.01),
        )
        env = start(square(kind("agent", consume("berries", {"food": 1.0}), position=(4.0, 4.0)), resources=(food,)))
        env.set_state(internal=np.full((1, 1), 1.0))
        state = lived(env, 3, agent="consume_berries")
        assert bool(state.stock[0] > 0) is left
        assert bool(state.inside[0, 0]) is left


# ---- what a body leaves --------------------------------------------------------------------------


def mortal(**words):
    """Return a species that lives off 3 units of fat and 1 of water, and dies when the rule says so."""
    needs = (
        Need(name="fat", set_point=3.0, bounds=(1.0, 5.0)),
        Need(name="water", set_point=1.0, bounds=(0.0, 5.0)),
    )
    return kind("agent", needs=needs, **words)


def killer(world, rng):
    """Kill everybody in the second tick."""
    outcome = world.no_effect()
    outcome.killed[:] = world.state.tick == 1
    return outcome


@pytest.mark.parametrize(
    ("remains", "capacity", "stock"),
    [
        ({"needs": {"fat": 0.5}}, 9.0, 0.5 * (3 - 1)),
        ({"needs": {"fat": 1.0, "water": 0.5}, "body": 0.25}, 9.0, 2.0 + 0.5 + 0.25),
        ({"needs": {"fat": 1.0}, "body": 2.0}, 1.0, 1.0),  # of which half is fat
        ({"body": 0.5, "causes": ("hazard",)}, 9.0, 0.0),
    ],
)
def test_a_body_leaves_what_it_stored(remains, capacity, stock):
    """Its patch lies where it died and holds the shares of its stores, which leave it, up to the capacity."""
    carcass = Resource(name="carcass", count=2, stock=0.0, capacity=capacity, gone_below=0.0)
    species = mortal(position=(3.0, 2.0), remains=Remains(resource="carcass", **remains))
    env = start(square(species, resources=(carcass,), rule=killer))
    first = env.state_view.copy()
    tick = [env.step_arrays(ask(env)) for _ in range(2)][-1]
    state = env.state_view
    assert tick.died.all()
    assert state.stock.tolist() == pytest.approx([stock, 0.0])
    if stock:
        assert state.resource_position[0].tolist() == [3.0, 2.0]
    body = 0.0 if not stock else remains.get("body", 0.0) * min(1.0, capacity / 4.0 if capacity == 1.0 else 1.0)
    assert (first.internal - state.internal).sum() == pytest.approx(stock - body)
    assert tick.reward.tolist() == [0.0]  # to leave something is neither a relief nor a pain
    contract.account_closes(env, first)


def test_without_a_free_patch_what_is_left_is_lost():
    """Three die, one patch is free: it holds one body's, and the others keep what they had, to be lost with them."""
    carcass = Resource(name="carcass", count=1, stock=0.0, capacity=9.0, gone_below=0.0)
    env = start(square(mortal(count=3, remains=Remains(resource="carcass", needs={"fat": 1.0})), resources=(carcass,),
                       rule=killer))  # fmt: skip
    state = lived(env, 2)
    assert state.stock.tolist() == [2.0]
    assert state.internal[:, 0].tolist() == [1.0, 3.0, 3.0]


def test_a_carcass_feeds_as_much_as_the_body_had():
    """What one body stored, another eats: nothing comes and nothing goes on the way."""
    carcass = Resource(name="carcass", count=3, stock=0.0, capacity=9.0, gone_below=0.0, radius=0.5)
    prey = mortal(position=(4.0, 4.0), remains=Remains(resource="carcass", needs={"fat": 1.0}))
    eater = kind("eater", consume("carcass", {"food": 0.25}), go_to("carcass", 0.6), position=(5.0, 4.0))

    def kill_prey(world, rng):
        outcome = world.no_effect()
        outcome.killed[world.slots["agent"]] = True
        return outcome

    env = start(square(prey, eater, resources=(carcass,), rule=kill_prey))
    lived(env, 1)
    lived(env, 1, eater="go_to_carcass")
    env.set_state(internal=np.array([[1.0, 1.0], [0.0, 0.0]]))
    before = env.state_view.internal[1, 0]
    state = lived(env, 20, eater="consume_carcass")
    assert state.internal[1, 0] - before == pytest.approx(2.0)
    assert state.stock.tolist() == [0.0, 0.0, 0.0]


# ---- seeds -------------------------------------------------------------------------------------


def test_seeds_come_at_their_rate():
    """Seeds from anywhere are a Poisson process: their number over many places and ticks is rate t, to 5 deviations."""
    env = start(square(kind(), resources=(berries(count=600, present=0, seeding=Seeding(rate=0.5)),)), seed=3)
    state = lived(env, 800)
    there = int((state.stock > 0).sum())
    assert abs(there - 400) < 5 * math.sqrt(400)
    assert np.ptp(state.resource_position[state.stock > 0], axis=0).min() > 6.0  # all over


def test_seeds_multiply_and_land_near_their_parents():
    """On a torus 40 patches become 40 (1 + b)^t, within 5 deviations of a branching process, none beyond the reach."""
    b, t, n = 0.05, 20, 40
    food = berries(count=600, present=n, seeding=Seeding(offspring=b, reach=0.2))
    env = start(square(kind(), walls=False, side=50.0, resources=(food,)), seed=5)
    first = env.state_view.resource_position[:n].copy()
    state = lived(env, t)
    grown = (1 + b) ** t
    spread = math.sqrt(n * grown * (grown - 1))
    assert abs((state.stock > 0).sum() - n * grown) < 5 * spread
    for place in state.resource_position[state.stock > 0]:
        gap = env.world.model.plane.gap(first, place)
        assert np.hypot(*gap.T).min() <= 0.2 * t


def test_no_seed_lands_behind_a_wall():
    """Patches stay in the arena, and none is on the other side of a wall from all others."""
    arena = Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)), walls=(((4.0, 0.0), (4.0, 7.9)),))
    food = berries(count=200, present=1, radius=0.05, seeding=Seeding(offspring=0.5, reach=0.5))
    env = start(square(kind(radius=0.01), arena=arena, resources=(food,)))
    place = env.state_view.resource_position.copy()
    place[0] = (3.9, 1.0)
    env.set_state(resource_position=place)
    state = lived(env, 12)
    places = state.resource_position[state.stock > 0]
    assert len(places) > 20
    assert (places[:, 0] < 4.0).all()
    assert env.world.model.ground.inside(places).all()


# ---- a rule ------------------------------------------------------------------------------------


def rule_of(change):
    """Return a rule that lets `change(outcome, world)` write into its outcome."""

    def rule(world, rng):
        outcome = world.no_effect()
        change(outcome, world)
        return outcome

    return rule


def test_a_rule_adds_to_stocks_and_places_patches():
    """Stocks stay within 0 and their capacity, patches appear where it says, and the account has both."""

    def change(outcome, world):
        outcome.stock = np.array([0.5, -0.5, 0.0, 0.0])
        if world.state.tick == 2:
            outcome.patches["berries"] = np.array([[2.0, 3.0, 0.5]])

    pool = Resource(name="pool", position=(1.0, 1.0), stock=1.0, capacity=2.0)
    well = Resource(name="well", position=(7.0, 7.0), stock=1.0)
    env = start(square(kind(), resources=(pool, well, berries(count=2, present=0)), rule=rule_of(change)))
    first = env.state_view.copy()
    assert lived(env, 1).stock.tolist() == [1.5, 0.5, 0.0, 0.0]
    state = lived(env, 2)
    assert state.stock.tolist() == [2.0, 0.0, 0.5, 0.0]
    assert state.resource_position[2].tolist() == [2.0, 3.0]
    contract.account_closes(env, first)


def test_a_rule_brings_about_births():
    """A newborn starts where the rule says, has the parent that it names, and waits for nobody: no slot, no birth."""

    def change(outcome, world):
        outcome.births["agent"] = np.array([[2.0, 3.0], [5.0, 5.0]])
        outcome.parents["agent"] = np.array([0, -1])

    env = start(square(kind(count=1, capacity=4, birth=Birth(rate=0.0)), rule=rule_of(change)))
    tick = env.step_arrays(ask(env))
    state = env.state_view
    assert tick.born.tolist() == [False, True, True, False]
    assert tick.parent.tolist() == [-1, 0, -1, -1]
    assert state.parent[:3].tolist() == [-1, 0, -1]
    assert state.position[1:3].tolist() == [[2.0, 3.0], [5.0, 5.0]]
    assert lived(env, 2).alive.all()


def test_a_rule_acts_on_speed_and_sight():
    """A body moves at the share of its speed, and sees to the share of its range, from the next tick on."""

    def change(outcome, world):
        outcome.pace, outcome.sight = np.array([0.25]), np.array([0.5])

    food = Resource(name="berries", position=(4.0, 1.0))
    walker = kind("agent", move("walk", 0.4, direction=0.0), go_to("berries", 0.4), position=(1.0, 1.0), view_range=4.0,
                  sees=("berries",))  # fmt: skip
    env = start(square(walker, resources=(food,), rule=rule_of(change)))
    assert env.state_view.seen.all()
    assert lived(env, 1, agent="walk").position[0, 0] == pytest.approx(1.4)
    assert not env.state_view.seen.any()  # 2.6 away, and 2 is what it sees
    assert lived(env, 1, agent="walk").position[0, 0] == pytest.approx(1.5)
    assert lived(env, 6, agent="walk").seen.all()
    assert lived(env, 1, agent="go_to_berries").position[0, 0] == pytest.approx(2.2)


def test_a_rule_remembers_in_the_snapshot():
    """What it keeps is in the state: a world that is left and entered, and a copy, go on with it."""

    def change(outcome, world):
        count = float(world.memory["count"]) + 1
        outcome.memory["count"] = count
        outcome.received[0, 0] = 0.01 * count + world.memory["grid"][1, 0]

    scenario = square(kind(), rule=rule_of(change), memory={"count": 0, "grid": ((0.0, 0.0), (0.5, 0.0))})
    env = start(scenario)
    env.set_state(internal=np.zeros((1, 1)))
    lived(env, 2)
    other = parallel_env(scenario)
    other.restore(*env.snapshot())
    for world in (env, other):
        assert lived(world, 1).internal[0, 0] == pytest.approx(0.06 + 3 * 0.5)
        assert world.state_view.memory.tolist() == [3.0, 0.0, 0.0, 0.5, 0.0]


WRONG = {
    "a stock that is none": (lambda o, w: setattr(o, "stock", np.zeros(9)), ["stock", "(4,)"]),
    "a pace beyond 1": (lambda o, w: setattr(o, "pace", np.full(2, 2.0)), ["pace", "from 0 to 1"]),
    "a sight of NaN": (lambda o, w: setattr(o, "sight", np.full(2, np.nan)), ["sight", "nan"]),
    "patches of nothing": (lambda o, w: o.patches.update(bery=np.zeros((1, 3))), ["'bery'", "berries"]),
    "patches outside": (lambda o, w: o.patches.update(berries=np.array([[9.0, 1, 1]])), ["outside", "[9.0, 1.0]"]),
    "a patch too full": (lambda o, w: o.patches.update(berries=np.array([[1.0, 1, 7]])), ["at most 1", "7.0"]),
    "a patch of two numbers": (lambda o, w: o.patches.update(berries=np.zeros((1, 2))), ["(k, 3)", "x, y and stock"]),
    "births of nobody": (lambda o, w: o.births.update(agnt=np.zeros((1, 2))), ["'agnt'", "agent"]),
    "births without birth": (lambda o, w: o.births.update(stone=np.ones((1, 2))), ["'stone'", "Birth(rate=0.0)"]),
    "parents without births": (lambda o, w: o.parents.update(agent=np.array([0])), ["parents", "0 slots"]),
    "memory of nothing": (lambda o, w: o.memory.update(cont=1), ["'cont'", "count"]),
    "memory of another shape": (lambda o, w: o.memory.update(count=np.ones(2)), ["'count'", "shape ()"]),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_a_rule_cannot_do_is_told(what):
    """The message says what is wrong, and what would be right."""
    change, words = WRONG[what]
    species = (kind(birth=Birth(rate=0.0)), kind("stone"))
    env = start(square(*species, resources=(berries(),), rule=rule_of(change), memory={"count": 0}))
    assert_refused(lambda: env.step_arrays(ask(env)), words)


MISTAKES = {
    "decay of the unlimited": (lambda: Resource(name="a", decay=0.1), ["spoils", "inf"]),
    "gone though unlimited": (lambda: Resource(name="a", gone_below=0.1), ["finite stock", "inf"]),
    "present without gone_below": (lambda: berries(present=1, gone_below=None), ["present", "gone_below"]),
    "more present than there are": (lambda: berries(present=5), ["present", "5", "4"]),
    "seeds of nothing": (lambda: berries(stock=0.0, capacity=1.0, seeding=Seeding(rate=0.1)), ["seeding", "0.0"]),
    "seeding without a rate": (lambda: Seeding(), ["positive", "0.0"]),
    "remains of nothing": (lambda: Remains(resource="a"), ["nothing is left"]),
    "a share above 1": (lambda: Remains(resource="a", needs={"fat": 2.0}), ["'fat'", "2.0"]),
    "remains of an unknown resource": (
        lambda: square(mortal(remains=Remains(resource="bery", body=1.0)), resources=(berries(),)),
        ["'bery'", "berries"],
    ),
    "remains that stay": (
        lambda: square(mortal(remains=Remains(resource="a", body=1.0)), resources=(Resource(name="a", stock=1.0),)),
        ["come and go", "gone_below"],
    ),
    "remains of an unknown need": (
        lambda: square(mortal(remains=Remains(resource="berries", needs={"fet": 1.0})), resources=(berries(),)),
        ["'fet'", "fat"],
    ),
    "memory without a rule": (lambda: square(kind(), memory={"count": 0}), ["memory", "no rule"]),
    "memory of words": (lambda: square(kind(), memory={"count": "no"}, rule=killer), ["'count'", "'no'"]),
}  # fmt: skip


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_told(what):
    """The message names the rule and the value."""
    assert_refused(*MISTAKES[what])


# ---- a scenario --------------------------------------------------------------------------------


def test_scavengers_live_on_what_the_grazers_leave():
    """All that scavengers eat was flesh or stores of grazers; without deaths of grazers they starve."""
    for mortality, live in ((0.004, True), (0.0, False)):
        env = parallel_env(scenarios.load("scavengers", mortality=mortality, rot=0.0, side=6.0, regrowth=1.0))
        tick = env.reset_arrays(seed=1)
        rows, first = env.world.model.patches["carcass"], env.state_view.copy()
        for _ in range(900):
            wanted = np.zeros(env.size, np.int64)
            for group in env.groups.values():
                wanted[group.slots] = tick.masks[group.name][:, :3].argmax(axis=1)  # eat, go there, walk
            tick = env.step_arrays(wanted)
        now = env.state_view
        assert tick.alive[env.groups["scavenger"].slots].any() == live
        eaten, left = now.eaten[rows].sum(), now.grown[rows].sum()
        assert (eaten > 1.0) == live
        assert now.stock[rows].sum() == pytest.approx(left - eaten, abs=1e-9)
        contract.account_closes(env, first)


def test_worlds_without_it_have_nothing_of_it():
    """No array is added to a world that does not use it."""
    env = start(square(kind(hazard=Hazard(rate=0.1))))
    assert env.world.model.appearing is None
    assert {"memory", "pace", "sight"}.isdisjoint(env.state_view.arrays())
