"""Bites, gifts, crowding and a scenario's own rule."""

import math

import numpy as np
import pytest
from worlds import BAY, ask, kind, square, start

import ecology
from ecology import Arena, Crowding, EcologyError, Need, Outcome, Resource, act, bite, give, meetings, move, scenarios
from ecology.actions import compile_actions
from ecology.state import CAUSES


def opened(env, action, species="wolf"):
    """Return which slots of a species may do `action`, as a list."""
    group = env.groups[species]
    return env.set_state().masks[species][:, group.actions.index(action)].tolist()


def wolves(count=1, /, prey=1, *, arena=None, dt=1.0, walls=True, victims=None, **words):
    """Return a world of wolves, that bite sheep with `words`, and sheep."""
    words = {"reach": 1.0, "gain": {"food": 0.5}, **words}
    scenario = {} if arena is None else {"arena": arena}
    sheep = kind("sheep", count=prey, **(victims or {}))
    return square(kind("wolf", bite("sheep", **words), count=count), sheep, dt=dt, walls=walls, **scenario)


# ---- bites -----------------------------------------------------------------------------------


def test_a_kill_worked_by_hand():
    """A bite with chance 1 kills the one in reach, adds the gain, and is written down; then nobody is in reach."""
    env = start(wolves(), position=[[4.0, 4.0], [4.6, 4.8]])
    assert opened(env, "bite_sheep") == [True]
    tick, state = env.step_arrays(ask(env, wolf="bite_sheep")), env.state_view
    assert tick.died.tolist() == [False, True]
    assert CAUSES[state.cause[1]] == "eaten"
    assert state.internal[:, 0].tolist() == [2.5, 2.0]
    assert state.received[:, 0].tolist() == [0.5, 0.0]
    assert state.bit.tolist() == [1, -1]
    tick = env.step_arrays(ask(env, wolf="bite_sheep"))
    assert tick.closed[0]
    assert env.state_view.bit.tolist() == [-1, -1]


@pytest.mark.parametrize(("distance", "open_"), [(1.0, True), (1.0 + 1e-9, False), (0.0, True)])
def test_reach_is_between_the_centres(distance, open_):
    """One is bitten up to the reach, that included."""
    env = start(wolves(), position=[[3.0, 4.0], [3.0 + distance, 4.0]])
    assert opened(env, "bite_sheep") == [open_]


def test_damage_has_the_columns_of_the_bitten():
    """The table of a biter has room for the needs of who has more, and tells what it does to them."""
    scenario = scenarios.load("predator_prey", wound=0.25)
    prey, predator = scenario.species
    assert len(predator.needs) < len(prey.needs)
    table = compile_actions(predator, scenario.resources, scenario.species)
    hurt = [need.name for need in prey.needs].index("health")
    assert table.control.shape[1] == len(prey.needs)
    assert table.damage[table.bites, hurt].tolist() == [0.25]


def test_a_wall_between_protects():
    """Across the wall of a bay one is near, but neither bitten nor given to."""
    env = start(wolves(arena=Arena(vertices=BAY)), position=[[3.5, 5.0], [4.5, 5.0]])
    assert opened(env, "bite_sheep") == [False]
    env.set_state(position=[[3.5, 2.5], [4.5, 2.5]])  # below it the way is free
    assert opened(env, "bite_sheep") == [True]


def test_the_nearest_of_its_species_is_bitten():
    """Not the nearest of all, not the dead one, not itself."""
    scenario = square(kind("wolf", bite("sheep", reach=2.0), count=2), kind("sheep", count=3), kind("stone"))
    places = [[4.0, 4.0], [4.1, 4.0], [5.0, 4.0], [4.0, 4.9], [4.3, 4.0], [4.0, 4.2]]
    env = start(scenario, position=places, alive=[True, True, True, True, False, True])
    env.step_arrays(np.array([1, 0, 0, 0, 0, 0]))
    assert env.state_view.bit[0] == 3


@pytest.mark.parametrize("dt", [1.0, 0.25])
@pytest.mark.parametrize("chance", [0.3, 0.9, 0.0, 1.0])
def test_a_chance_is_per_unit_of_time(chance, dt):
    """Of 400 pairs that bite for a unit of time, the share `chance` has killed, whatever the tick (4 sigma)."""
    n = 400
    places = np.stack(np.meshgrid(np.arange(20.0), np.arange(20.0)), -1).reshape(-1, 2) * 2 + 1
    pairs = np.concatenate([places, places + 0.1])
    wolf, sheep = kind("wolf", bite("sheep", reach=0.5, chance=chance), count=n), kind("sheep", count=n)
    env = start(square(wolf, sheep, side=40.0, dt=dt), seed=6, position=pairs)
    for _ in range(round(1 / dt)):
        env.step_arrays(ask(env, wolf="bite_sheep"))
    killed = 1 - env.state_view.alive[n:].mean()
    assert abs(killed - chance) <= 4 * math.sqrt(chance * (1 - chance) / n)


@pytest.mark.parametrize(("duration", "dt", "period"), [(4.0, 1.0, 4.0), (4.0, 0.5, 4.0), (0.0, 0.5, 0.5)])
def test_handling_takes_its_time(duration, dt, period):
    """From one success to the next passes the handling time, or a tick; meanwhile nothing else is open."""
    env = start(wolves(duration=duration, damage={"food": 0.0}, dt=dt), position=[[4.0, 4.0], [4.5, 4.0]])
    times = []
    for _ in range(round(20 / dt)):
        env.step_arrays(ask(env, wolf="bite_sheep"))
        state = env.state_view
        if state.bit[0] >= 0:
            times.append(state.time)
        if state.hold[0] > 0:
            assert env.set_state().masks["wolf"].tolist() == [[False, True]]
    assert np.allclose(np.diff(times), period)
    assert len(times) == 20 / period


def test_a_failed_bite_needs_no_handling():
    """Only a success immobilises."""
    env = start(wolves(duration=10.0, chance=0.0), position=[[4.0, 4.0], [4.5, 4.0]])
    env.step_arrays(ask(env, wolf="bite_sheep"))
    assert env.state_view.hold[0] == 0.0
    assert opened(env, "rest") == [True]


def test_one_winner_for_each_victim():
    """Of five wolves on one sheep one gets it; each about as often, and never two (4 sigma)."""
    rng, found = np.random.default_rng(0), np.zeros(5)
    for _ in range(1000):
        won = meetings.succeed(np.arange(5), np.full(5, 5), np.ones(5), 1.0, 6, rng)
        assert won.sum() == 1
        found += won
    assert np.abs(found - 200).max() < 4 * math.sqrt(1000 * 0.2 * 0.8)
    env = start(wolves(5), position=[[4.0, 4.0]] * 5 + [[4.5, 4.0]])
    env.step_arrays(ask(env, wolf="bite_sheep"))
    assert sorted(env.state_view.internal[:5, 0]) == [2.0, 2.0, 2.0, 2.0, 2.5]


def test_who_succeeds_does_not_depend_on_who_else_bites():
    """The numbers are drawn per slot: a wolf far away changes nothing for this one."""
    bitten = []
    for other in ("rest", "bite_sheep"):
        env = start(wolves(2, 2, chance=0.5, damage={"food": 0.0}))
        env.set_state(position=[[2.0, 2.0], [6.0, 6.0], [2.5, 2.0], [6.5, 6.0]])
        both = ask(env, wolf="bite_sheep")
        both[1] = env.groups["wolf"].actions.index(other)
        bitten.append([env.step_arrays(both).alive.all() and int(env.state_view.bit[0]) for _ in range(40)])
    assert bitten[0] == bitten[1]
    assert {-1, 2} == set(bitten[0])


def test_a_wound_takes_by_the_name_of_the_need():
    """Damage takes its units from the bitten, whose needs stand in another order; it lives on."""
    needs = (Need(name="calm", set_point=1.0), Need(name="food", set_point=2.0, bounds=(0.5, 4.0)))
    env = start(wolves(victims={"needs": needs}, damage={"food": 0.7}), position=[[4.0, 4.0], [4.5, 4.0]])
    env.step_arrays(ask(env, wolf="bite_sheep"))
    assert env.state_view.internal[1].tolist() == [1.0, pytest.approx(1.3)]
    assert env.state_view.given[1].tolist() == [0.0, 0.7]
    for _ in range(3):
        tick = env.step_arrays(ask(env, wolf="bite_sheep"))
    assert tick.alive[1]
    assert env.state_view.internal[1, 1] == 0.5  # its bound
    assert env.state_view.lost[1, 1] == pytest.approx(-(4 * 0.7 - 1.5))  # what the bound held up


def test_a_wound_beyond_a_lethal_bound_kills():
    """It dies of the bite, on its tick; the need and the killer are named, as they are when the bite itself kills."""
    needs = (Need(name="food", set_point=2.0, bounds=(0.0, 4.0), lethal=True),)
    env = start(wolves(victims={"needs": needs}, damage={"food": 2.5}), position=[[4.0, 4.0], [4.5, 4.0]])
    tick, state = env.step_arrays(ask(env, wolf="bite_sheep")), env.state_view
    assert tick.died.tolist() == [False, True]
    assert CAUSES[state.cause[1]] == "bitten"
    assert (state.fatal_need.tolist(), state.killer.tolist(), tick.killer.tolist()) == ([-1, 0], [-1, 0], [-1, 0])


def test_a_bite_is_no_cause_of_a_death_that_comes_without_it():
    """An agent that starves in the tick of a bite died of its need, and nobody killed it."""
    needs = (
        Need(name="warmth", set_point=1.0),
        Need(name="food", set_point=2.0, decay=1.0, bounds=(0.0, 4.0), lethal=True),
    )
    env = start(wolves(victims={"needs": needs}, damage={"warmth": 0.1}), position=[[4.0, 4.0], [4.5, 4.0]])
    internal = env.state_view.internal.copy()
    internal[1] = 1.0, 0.5
    env.set_state(internal=internal)
    tick, state = env.step_arrays(ask(env, wolf="bite_sheep")), env.state_view
    assert state.bit[0] == 1
    assert (CAUSES[state.cause[1]], state.fatal_need[1], state.killer[1], tick.killer[1]) == ("need", 1, -1, -1)


def test_two_can_kill_each_other():
    """Bites of one tick are at the same time: both die, both are booked their gain."""
    scenario = square(kind("cat", bite("cat", reach=1.0, gain={"food": 0.5}), count=2))
    env = start(scenario, position=[[4.0, 4.0], [4.5, 4.0]])
    assert env.step_arrays(ask(env, cat="bite_cat")).died.all()
    assert env.state_view.received[:, 0].tolist() == [0.5, 0.5]


# ---- gifts -----------------------------------------------------------------------------------


def givers(**words):
    """Return a giver of food and one, with its needs the other way round, that may be given to."""
    words = {"gives": {"food": 0.4}, "reach": 1.0, **words}
    needs = (Need(name="calm", set_point=1.0), Need(name="food", set_point=2.0, bounds=(0.0, 4.0)))
    dt = words.pop("dt", 1.0)
    return square(kind("giver", give("taker", **words)), kind("taker", needs=needs), dt=dt)


@pytest.mark.parametrize("dt", [1.0, 0.5])
def test_a_gift_worked_by_hand(dt):
    """0.4 per unit of time leave the giver's food, three quarters of it arrive in the other's food."""
    places = [[4.0, 4.0], [4.5, 4.0]]
    env = start(givers(efficiency=0.75, dt=dt), position=places, internal=[[2.0, 0.0], [1.0, 1.0]])
    for _ in range(round(2 / dt)):
        env.step_arrays(ask(env, giver="give_taker"))
    state = env.state_view
    assert state.internal[0, 0] == pytest.approx(1.2)
    assert state.internal[1].tolist() == [1.0, pytest.approx(1.6)]
    assert (state.given[0, 0], state.received[1, 1]) == (pytest.approx(0.8), pytest.approx(0.6))
    assert state.gave.tolist() == [1, -1]


@pytest.mark.parametrize(("bounds", "floor", "held"), [((0.5, 4.0), -math.inf, 0.1), ((0.0, 4.0), 0.55, 0.05)])
def test_one_gives_what_one_holds(bounds, floor, held):
    """Of 0.4 asked, what lies above the lower bound or the floor is given, and then nothing."""
    needs = (Need(name="food", set_point=2.0, bounds=bounds, floor=floor),)
    scenario = square(kind("giver", give("taker", {"food": 0.4}, reach=1.0), needs=needs), kind("taker"))
    env = start(scenario, position=[[4.0, 4.0], [4.5, 4.0]], internal=[[0.6], [1.0]])
    for _ in range(3):
        env.step_arrays(ask(env, giver="give_taker"))
        assert env.state_view.internal[:, 0] == pytest.approx([0.6 - held, 1.0 + held])


def test_gifts_add_up_and_spill_over():
    """Two gifts to one are added; what goes beyond its upper bound is lost, not kept by the givers."""
    scenario = square(kind("giver", give("taker", {"food": 0.4}, reach=1.0), count=2), kind("taker"))
    env = start(scenario, position=[[4.0, 4.0]] * 3, internal=[[2.0], [2.0], [3.5]])
    env.step_arrays(ask(env, giver="give_taker"))
    assert env.state_view.internal[:, 0] == pytest.approx([1.6, 1.6, 4.0])
    assert env.state_view.lost[2, 0] == pytest.approx(0.3)


def test_nobody_near_nothing_given():
    """Without one in reach the gift is closed."""
    env = start(givers(), position=[[4.0, 4.0], [5.5, 4.0]])
    assert opened(env, "give_taker", "giver") == [False]
    assert env.step_arrays(ask(env, giver="give_taker")).closed[0]
    assert not env.state_view.given.any()


# ---- crowding --------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [1.0, 0.5])
def test_crowding_counts_the_living_around(dt):
    """Each other within the distance, of any species, takes 0.1 per unit of time; the dead and the far do not."""
    crowd = kind("agent", count=4, crowding=Crowding(within=1.0, control={"food": -0.1}))
    places = [[4.0, 4.0], [5.0, 4.0], [5.0, 4.5], [6.0, 7.0], [4.0, 4.5]]
    env = start(square(crowd, kind("stone"), dt=dt), position=places, alive=[True, True, True, True, True])
    for _ in range(round(1 / dt)):
        env.step_arrays(ask(env))
    assert env.state_view.internal[:, 0] == pytest.approx([1.8, 1.8, 1.8, 2.0, 2.0])
    env.set_state(alive=[True, False, True, True, True], internal=[[2.0]] * 5)
    for _ in range(round(1 / dt)):
        env.step_arrays(ask(env))
    assert env.state_view.internal[:, 0] == pytest.approx([1.9, 2.0, 1.9, 2.0, 2.0])


def test_crowding_can_count_some_species_alone():
    """Where species are named, the others around do not count."""
    for named, left in ((("agent",), 1.9), (("stone",), 1.8), ((), 1.7)):
        crowd = kind("agent", count=2, crowding=Crowding(within=1.0, control={"food": -0.1}, species=named))
        places = [[4.0, 4.0], [4.0, 4.5], [4.5, 4.0], [4.3, 4.3]]
        env = start(square(crowd, kind("stone", count=2)), position=places)
        env.step_arrays(ask(env))
        assert env.state_view.internal[0, 0] == pytest.approx(left)


# ---- a scenario's own rule -------------------------------------------------------------------


def ruled(rule, **words):
    """Return a world of two callers and a listener under `rule`."""
    return square(kind("caller", act("call"), move("walk", 0.5), count=2, **words), kind("listener"), rule=rule)


def test_a_rule_sees_the_middle_of_a_tick_in_words():
    """Bodies have moved, needs are as they were; who does what is asked by name."""
    shown = []

    def rule(world, rng):
        shown.append((world.state.position.copy(), world.state.internal.copy(), world.does("caller", "call").tolist()))
        outcome = world.no_effect()
        outcome.received[world.slots["listener"], world.column("listener", "food")] = 0.25
        outcome.given[0, 0] = 0.5
        return outcome

    env = start(ruled(rule), position=[[2.0, 2.0], [4.0, 4.0], [6.0, 6.0]], heading=[0.0, 0.0, 0.0])
    env.step_arrays(np.array([1, 2, 0]))
    places, internal, calls = shown[0]
    assert places[1].tolist() == [pytest.approx(4.5), 4.0]
    assert (internal == 2.0).all()
    assert calls == [True, False]
    assert env.state_view.internal[:, 0].tolist() == [1.5, 2.0, 2.25]
    env.set_state(alive=[False, True, True])
    env.step_arrays(np.array([1, 1, 0]))
    assert shown[-1][2] == [False, True]  # the dead do nothing
    assert env.state_view.internal[0, 0] == 1.5


@pytest.mark.parametrize("field", ["position", "internal", "alive", "stock", "serial", "heading"])
@pytest.mark.parametrize("whole", [False, True], ids=["rows", "field"])
def test_a_rule_cannot_write_into_the_state(field, whole):
    """What it is shown is read-only, its arrays and its fields."""

    def rule(world, rng):
        if whole:
            setattr(world.state, field, getattr(world.state, field).copy())
        else:
            getattr(world.state, field)[:] = 0
        return world.no_effect()

    with pytest.raises(ValueError, match="read-only"):
        start(ruled(rule)).step_arrays(np.zeros(3, np.int64))


@pytest.mark.parametrize(("walls", "x"), [(True, 1.0), (False, 9.0)])
def test_a_rule_puts_bodies_but_not_the_dead(walls, x):
    """A body is where the rule puts it, across the seam of a torus too; a dead body stays where it is."""

    def rule(world, rng):
        outcome = world.no_effect()
        outcome.position = np.array([[x, 4.0], [5.0, 5.0], [70.0, 7.0]])
        assert world.inside(outcome.position).tolist() == [True, True, not walls]
        return outcome

    bodies = kind("caller", count=2), kind("listener")
    env = start(square(*bodies, rule=rule, walls=walls), position=[[2.0, 2.0], [4.0, 4.0], [6.0, 6.0]])
    env.set_state(alive=[True, True, False])
    env.step_arrays(np.zeros(3, np.int64))
    assert env.state_view.position.tolist() == [[1.0, 4.0], [5.0, 5.0], [6.0, 6.0]]
    assert env.state_view.returned == 0


def test_a_rule_asks_for_resources_by_name():
    """The rows of a resource are those of its patches."""
    shown = []

    def rule(world, rng):
        shown.append([world.state.stock[world.resource(name)].tolist() for name in ("grass", "pond", "berries")])
        world.resource("gras")

    patches = (
        Resource(name="grass", count=2, stock=3.0),
        Resource(name="pond"),
        Resource(name="berries", count=3, stock=1.0),
    )
    with pytest.raises(EcologyError, match=r"asks for the resource 'gras'. Did you mean 'grass'"):
        start(square(kind(), resources=patches, rule=rule)).step_arrays(np.zeros(1, np.int64))
    assert shown == [[[3.0, 3.0], [np.inf], [1.0, 1.0, 1.0]]]


def test_a_rule_draws_from_a_stream_of_its_own():
    """A rule that draws numbers moves neither noise nor births nor deaths."""
    lives = []
    for many in (0, 7):

        def rule(world, rng, many=many):
            rng.random(many)
            return world.no_effect()

        words = {
            "needs": (Need(name="food", set_point=2.0, noise=0.1, bounds=(0.0, 4.0)),),
            "birth": ecology.Birth(rate=0.1),
            "hazard": ecology.Hazard(rate=0.05),
            "arrival": 0.5,
            "capacity": 8,
        }
        env = start(ruled(rule, **words))
        for _ in range(60):
            env.step_arrays(np.zeros(9, np.int64))
        lives.append(env.state_view.copy())
    assert lives[0].next_serial > 4
    assert np.array_equal(lives[0].internal, lives[1].internal)
    assert np.array_equal(lives[0].serial, lives[1].serial)


def outcome_with(**words):
    """Return a rule whose outcome has `words` instead of zeros."""

    def rule(world, rng):
        outcome = world.no_effect()
        for word, value in words.items():
            setattr(outcome, word, value)
        return outcome

    return rule


@pytest.mark.parametrize(
    ("rule", "message"),
    [
        (lambda world, rng: None, "must return an Outcome"),
        (lambda world, rng: Outcome, "must return an Outcome"),
        (outcome_with(received=np.zeros((3, 2))), "received must be"),
        (outcome_with(received=np.full((3, 1), np.nan)), "received must be"),
        (outcome_with(received=[[0.0]] * 3), "received must be an array"),
        (outcome_with(given=np.full((3, 1), np.inf)), "given must be"),
        (outcome_with(given=np.array([["a"], ["b"], ["c"]])), "given must be"),
        (outcome_with(position=np.full((3, 2), np.nan)), "position must be"),
        (outcome_with(position=np.zeros(2)), "position must be"),
        (outcome_with(killed=np.zeros(3)), "killed must be"),
        (outcome_with(killed=[False] * 3), "killed must be an array"),
        (outcome_with(killed=np.zeros(2, bool)), "killed must be"),
        (outcome_with(recieved=np.zeros((3, 1))), "no field 'recieved'. Did you mean 'received'"),
        (outcome_with(stock=np.zeros(1)), r"stock must be an array of finite numbers of shape \(0,\)"),
        (outcome_with(drive=np.zeros(1)), "no field 'drive'. Did you mean"),
        (outcome_with(position=np.array([[4.0, 4.0], [-1.0, 4.0], [5.0, 5.0]])), r"caller_1 at \[-1.0, 4.0\], outside"),
        (outcome_with(position=np.full((3, 2), 50.0)), "caller_0 at .*world.inside"),
        (lambda world, rng: world.does("caller", "cal"), "asks for the action 'cal'. Did you mean 'call'"),
        (lambda world, rng: world.does("calle", "call"), "asks for the species 'calle'. Did you mean 'caller'"),
        (lambda world, rng: world.column("caller", "foot"), "asks for the need 'foot'. Did you mean 'food'"),
    ],
)
def test_a_wrong_outcome_is_named(rule, message):
    """What a rule must not return, or asks for in vain, is one clear error."""
    with pytest.raises(EcologyError, match=message):
        start(ruled(rule)).step_arrays(np.zeros(3, np.int64))


@pytest.mark.parametrize("word", ["received", "given"])
def test_units_of_a_need_that_a_species_does_not_have_are_refused(word):
    """The columns beyond a species' own needs stay at zero."""

    def rule(world, rng):
        outcome = world.no_effect()
        getattr(outcome, word)[:, 1] = 0.1
        return outcome

    needs = (Need(name="food", set_point=2.0), Need(name="calm", set_point=1.0))
    env = start(square(kind("two", needs=needs), kind("one"), rule=rule))
    with pytest.raises(EcologyError, match=f"{word} .*'one'.*food"):
        env.step_arrays(np.zeros(2, np.int64))
