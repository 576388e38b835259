"""The set-ups of Man and Yoshida: closed forms under scripted policies, and the rules one by one."""

import math

import numpy as np
import pytest

import ecology
from ecology import EcologyError, scenarios
from ecology.lab.certificate import episodes
from ecology.lab.certificate.cases.food_share import eats, helps
from ecology.lab.certificate.cases.grid_rooms import ALONE, feeds_itself
from ecology.scenarios import food_share, grid_rooms, trap

NAMES = ("food_share", "grid_rooms", "trap")
Z = 3.29  # standard errors of an interval that fails one time in a thousand


def begun(name, seed=0, **settings):
    """Return a world after the first tick, which draws how a life starts, and that tick."""
    env = ecology.parallel_env(scenarios.load(name, **settings))
    env.reset_arrays(seed)
    return env, env.step_arrays(np.zeros(env.size, np.int64))


def act(env, *names):
    """Let the first actors do as named, the others rest; return the tick."""
    group = next(iter(env.groups.values()))
    actions = np.zeros(env.size, np.int64)
    actions[: len(names)] = [group.actions.index(name) for name in names]
    return env.step_arrays(actions)


def with_state(env, **changes):
    """Put a world; a change is a mapping of (row, column) or row to a value."""
    fields = {}
    for name, values in changes.items():
        fields[name] = getattr(env.state_view, name).copy()
        for at, value in values.items():
            fields[name][at] = value
    return env.set_state(**fields)


# ---- food_share ------------------------------------------------------------------------------


def test_the_drives_are_those_of_the_original():
    """d(high) = -ln 0.95, d(low) = -ln 0.05, and what is felt of the partner is lambda times its drive."""
    env, _ = begun("food_share", condition="full", weight=0.3)
    high, low = food_share.HIGH, 0.0
    for own, other in ((high, high), (high, low), (low, high), (low, low)):
        tick = with_state(env, internal={(0, 0): own, (1, 0): other})
        d = {high: -math.log(0.95), low: -math.log(0.05)}
        assert tick.drive[0] == pytest.approx(d[own] + 0.3 * d[other], rel=1e-12)
        assert tick.drive[1] == pytest.approx(d[other], rel=1e-12)


def test_who_always_eats_lives_14_and_a_half_ticks():
    """Mean life (10 + 19) / 2: half of the partners start low, the others fall after 10 ticks on average."""
    lives = np.concatenate(episodes.run_scripted("food_share", {"condition": "none"}, eats, 30, 20, 2000)[0])
    assert abs(lives.mean() - 14.5) < Z * lives.std() / math.sqrt(len(lives))
    assert lives.std() < 10
    assert (lives >= 10).all()
    share = (lives == 10).mean()  # low at once, or fallen in the first tick: 0.5 + 0.5 * 0.1
    assert abs(share - 0.55) < Z * math.sqrt(0.55 * 0.45 / len(lives))


def test_who_passes_when_the_partner_is_low_lives_to_the_cap():
    """Passing exactly when high and the partner low: a pass in 1 of 11 ticks, and nobody ever dies."""
    lives, taken = episodes.run_scripted("food_share", {"condition": "none"}, helps, 40, 1, 2000)
    assert all(found == [2000] for found in lives)
    rates = taken[:, 1] / taken.sum(axis=1)
    assert abs(rates.mean() - 1 / 11) < Z * rates.std(ddof=1) / math.sqrt(len(rates))
    assert rates.std() < 0.02


@pytest.mark.parametrize(("weight", "pays"), [(0.05, False), (0.15, True)])
def test_passing_pays_at_once_from_a_weight_of_a_tenth(weight, pays):
    """High with a low partner, passing lowers the next drive by (lambda - 0.1) (d(low) - d(high)) on average."""
    pairs, gains = 500, {}
    for action in (0, 1):
        env, _ = begun("food_share", condition="affective", weight=weight, pairs=pairs)
        energy = env.state_view.internal.copy()
        energy[:, 0] = np.repeat([food_share.HIGH, 0.0], pairs)
        env.set_state(internal=energy)
        actions = np.concatenate([np.full(pairs, action), np.zeros(pairs, np.int64)])
        gains[action] = env.step_arrays(actions).reward[:pairs]
    gap = gains[1] - gains[0]
    expected = (weight - 0.1) * (food_share.D_LOW - food_share.D_HIGH)
    error = Z * gap.std() / math.sqrt(pairs)
    assert abs(gap.mean() - expected) < error
    assert abs(expected) > error, "the sample must be large enough to tell the sign"
    assert (gap.mean() > 0) == pays


def test_ten_ticks_low_in_a_row_kill_both():
    """A possessor that passes on, low, dies at its tenth tick low; one meal starts the count over."""
    env, _ = begun("food_share")
    with_state(env, internal={(0, 0): 0.0, (1, 0): food_share.HIGH, (1, 1): 0, (1, 2): 0})
    assert all(act(env, "pass").alive.all() for _ in range(9))
    act(env, "eat")
    with_state(env, internal={(0, 0): 0.0, (1, 0): food_share.HIGH})
    assert all(act(env, "pass").alive.all() for _ in range(9))
    tick = act(env, "pass")
    assert tick.died.all()
    assert env.state_view.internal[0, 0] == 0.0


# ---- the four conditions ---------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("perceived", [True, False])
def test_what_each_condition_perceives_and_feels(name, perceived):
    """Cognitive: the partner's energy is in zeta. Affective: it is in the drive; and in zeta, if perceived."""
    for condition in ("none", "cognitive", "affective", "full"):
        env, tick = begun(name, condition=condition, perceived=perceived)
        names = next(iter(env.groups.values())).layout.names
        cognitive, affective = condition in ("cognitive", "full"), condition in ("affective", "full")
        assert any(word.endswith("_1_energy") for word in names) == cognitive
        assert ("felt" in names) == (affective and perceived)
        own = env.state_view.own_drive
        assert tick.drive[0] == pytest.approx(own[0] + 0.5 * own[1] * affective, rel=1e-9)


def test_an_unknown_condition_is_refused():
    """A condition that is none of the four is refused by name."""
    with pytest.raises(EcologyError, match="condition is one of"):
        scenarios.load("food_share", condition="empathic")


# ---- grid_rooms ------------------------------------------------------------------------------


def test_a_partner_that_is_not_fed_dies_of_hunger_on_time():
    """It lives floor((1 + e) / 0.003) + 1 ticks with e uniform in +-0.3: 333.8 on average, 234 to 434."""
    lives = np.concatenate(episodes.run_scripted("grid_rooms", {"condition": "none"}, feeds_itself, 60, 1, 3000)[0])
    assert abs(lives.mean() - ALONE) < Z * lives.std() / math.sqrt(len(lives))
    assert lives.min() >= 234
    assert lives.max() <= 434


def test_a_walk_brings_a_meal_to_the_partner():
    """Get in the first cell, four steps right, pass: 0.1 of energy arrives, and 0.003 is lost per tick."""
    env, _ = begun("grid_rooms")
    with_state(env, internal={(0, 0): 1.0, (0, 1): 0.0, (1, 0): 0.8}, position={0: (0.5, 0.5)})
    x = env.state_view.position[0, 0]
    for name, cell in (("left", 0), ("get", 0), *(("right", c) for c in (1, 2, 3, 4, 4))):
        act(env, name)
        assert math.floor(env.state_view.position[0, 0]) == cell, (name, x)
    assert env.state_view.internal[0, 1] == 1.0
    tick = act(env, "pass")
    assert env.state_view.internal[:, 0] == pytest.approx([1.0 - 8 * 0.003, 0.8 + 0.1 - 8 * 0.003], rel=1e-12)
    assert env.state_view.internal[0, 1] == 0.0
    assert tick.drive[1] == pytest.approx((0.9 - 8 * 0.003 - 1.0) ** 2, rel=1e-6)


def test_food_is_got_and_passed_at_its_places_only():
    """Away from the first cell nothing is got, away from the last nothing is passed; eating takes what is carried."""
    env, _ = begun("grid_rooms")
    with_state(env, internal={(0, 0): 1.0, (0, 1): 0.0, (1, 0): 1.0}, position={0: (2.5, 0.5)})
    tick = act(env, "get")
    assert env.state_view.internal[0, 1] == 0.0
    assert not tick.masks["possessor"][0][[4, 5]].any()
    with_state(env, internal={(0, 1): 1.0})
    act(env, "pass")
    assert env.state_view.internal[0, 1] == 1.0
    act(env, "eat")
    assert env.state_view.internal[0] == pytest.approx([1.1 - 3 * 0.003, 0.0], rel=1e-12)


def test_who_is_left_alone_dies_too():
    """When one of a pair starves, the other follows a tick later, in grid_rooms and in trap."""
    for name in ("grid_rooms", "trap"):
        env, _ = begun(name)
        with_state(env, internal={(1, 0): 0.0005})
        tick = act(env, "rest")
        assert tick.died.tolist() == [False, True]
        assert act(env, "rest").died.tolist() == [True, False]


# ---- trap ------------------------------------------------------------------------------------


def test_moves_stay_in_the_plane_and_end_when_trapped():
    """A step of 0.15 that would leave [-1, 1]^2 is not taken; below x = 0.3 no move is open."""
    env, _ = begun("trap")
    with_state(env, position={0: (0.9, 0.0), 1: (-0.5, -0.95)}, internal={(0, 0): 1.0, (1, 0): 0.3})
    act(env, "right", "down")
    assert env.state_view.position == pytest.approx(np.array([[0.9, 0.0], [-0.5, -0.95]]), abs=1e-12)
    tick = act(env, "up", "rest")
    assert env.state_view.position[0] == pytest.approx([0.9, 0.15], abs=1e-12)
    assert not tick.masks["agent"][1, 1:5].any()
    assert tick.masks["agent"][0, 1:5].all()


def test_food_is_picked_up_moved_elsewhere_and_passed_within_reach():
    """Food within 0.3 goes to the first who reaches for it and is elsewhere then; it is passed within 0.4."""
    env, _ = begun("trap")
    places = {0: (0.1, 0.0), 1: (-0.1, 0.0)}
    with_state(env, position=places, internal={(0, 0): 1.0, (0, 1): 0.0, (1, 0): 0.2, (1, 1): 0.0})
    act(env, "consume_food", "consume_food")
    assert env.state_view.internal[:, 1].tolist() == [1.0, 0.0]
    assert (np.abs(env.state_view.resource_position) <= 1).all()
    assert np.hypot(*env.state_view.resource_position[0]) > 0.01
    act(env, "pass")
    assert env.state_view.internal[:, 1].tolist() == [0.0, 1.0]
    before = env.state_view.internal[1, 0]
    act(env, "rest", "eat")
    assert env.state_view.internal[1, 0] == pytest.approx(before + 0.3 - 0.001, rel=1e-12)
    with_state(env, position={0: (0.25, 0.0), 1: (-0.2, 0.0)}, internal={(0, 1): 1.0})
    act(env, "pass")
    assert env.state_view.internal[:, 1].tolist() == [1.0, 0.0]


def test_accidents_come_once_in_two_thousand_ticks():
    """An accident sets x to 0.3, with probability 0.0005 per agent and tick."""
    world, ticks = begun("trap")[0], 6_000
    rule, rng, hits = world.scenario.rule, np.random.default_rng(3), 0
    with_state(world, internal={(0, 0): 1.0, (1, 0): 1.0})
    shown = ecology.World(
        world.state_view,
        1.0,
        {"agent": slice(0, 2)},
        {"agent": ("energy", "carried")},
        {"agent": world.groups["agent"].actions},
    )
    for _ in range(ticks):
        outcome = rule(shown, rng)
        hits += int((outcome.given[:, 0] > 0).sum())
        assert set(outcome.given[:, 0].round(12).tolist()) <= {0.0, 0.7}
    expected = 2 * ticks * trap.ACCIDENT
    assert abs(hits - expected) < Z * math.sqrt(expected) + 1


def test_lives_begin_anew_one_by_one():
    """When a pair dies its next life starts from a fresh draw, the other pairs live on."""
    worlds = episodes.Worlds("grid_rooms", {"condition": "none"}, 3, 0, 3000)
    env = worlds.envs[0]
    with_state(env, internal={(4, 0): 0.001})
    _, dead, _, _ = worlds.step(np.zeros(3, np.int64))
    assert dead.tolist() == [False, True, False]
    kept = env.state_view.internal[[0, 2, 3, 5]].copy()
    worlds.begin(np.array([1]))
    assert env.state_view.alive.all()
    assert np.array_equal(env.state_view.internal[[0, 2, 3, 5]], kept)
    assert (np.abs(env.state_view.internal[[1, 4], 0] - 1) <= grid_rooms.SPREAD).all()
    assert env.state_view.position[[1, 4], 1] == pytest.approx([8.5, 8.5])
    assert worlds.lived.tolist() == [1, 0, 1]
