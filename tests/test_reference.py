"""`paper_reference` against the authors' rule dx = (c + u) x dt, worked out by hand tick by tick."""

import math

import numpy as np
import pytest

import ecology
from ecology import scenarios

NEEDS = {"need_1": 0, "need_2": 1, "need_3": 2, "need_4": 3, "muscle_fatigue": 4, "sleep_fatigue": 5}


def start(internal=None, position=None, **settings):
    """Return the reference world, started, with the internal state and position asked for."""
    env = ecology.parallel_env(scenarios.load("paper_reference", **settings))
    env.reset_arrays(seed=0)
    fields = {}
    if internal is not None:
        fields["internal"] = np.array([internal], float)
    if position is not None:
        fields["position"] = np.array([position], float)
    env.set_state(**fields)
    return env


def do(env, *names):
    """Do the actions named, one tick each, all of them open, and return the internal state after each."""
    actions = env.groups["agent"].actions
    levels = []
    for name in names:
        tick = env.step_arrays(np.array([actions.index(name)]))
        assert not tick.closed[0], name
        levels.append(env.state_view.internal[0].copy())
    return np.array(levels)


def open_actions(env):
    """Return the names of the open actions."""
    mask = env.set_state().masks["agent"][0]
    return {name for name, is_open in zip(env.groups["agent"].actions, mask, strict=True) if is_open}


def test_the_start():
    """The life begins at (3, 2), at the set point, both fatigues 0.1: d = sqrt(0.001 + 2 * 0.01)."""
    env = start()
    state = env.state_view
    assert state.position[0] == pytest.approx([3.0, 2.0])
    assert state.internal[0] == pytest.approx([1, 2, 3, 4, 0.1, 0.1])
    assert state.drive[0] == pytest.approx(math.sqrt(0.001 + 0.02), rel=1e-14)


def test_zeta_has_the_nine_numbers_of_the_paper():
    """zeta = (delta of four needs and two fatigues, x, y, heading), and fourteen actions."""
    env = start()
    group = env.groups["agent"]
    assert group.layout.names == (*NEEDS, "x", "y", "heading")
    assert len(group.actions) == 14


def test_three_ticks_of_rest():
    """c = -0.05 on resources, +0.0005 on sleep fatigue; muscle fatigue's -0.008 stops at the floor 0.1."""
    levels = do(start([2.0, 2.0, 3.0, 4.0, 1.0, 2.0]), "rest", "rest", "rest")
    # 2 -> 1.9 -> 1.805 -> 1.71475
    assert levels[:, 0] == pytest.approx([1.9, 1.805, 1.71475], rel=1e-14)
    # 4 -> 3.8 -> 3.61 -> 3.4295
    assert levels[:, 3] == pytest.approx([3.8, 3.61, 3.4295], rel=1e-14)
    # 1 -> .992 -> .984064 -> .976191488
    assert levels[:, 4] == pytest.approx([0.992, 0.984064, 0.976191488], rel=1e-14)
    # 2 -> 2.001 -> 2.0020005 -> 2.00300150025
    assert levels[:, 5] == pytest.approx([2.001, 2.0020005, 2.00300150025], rel=1e-14)
    assert do(start(), "rest")[0, 4] == 0.1


def test_three_ticks_of_consuming():
    """Consuming u = +0.1: x grows by (0.1 - 0.05) x a tick, the other needs fall as at rest."""
    levels = do(start([1.0, 2.0, 3.0, 4.0, 0.1, 0.1], (3.5, 1.5)), *["consume_food_2"] * 3)
    # 2 -> 2.1 -> 2.205 -> 2.31525
    assert levels[:, 1] == pytest.approx([2.1, 2.205, 2.31525], rel=1e-14)
    # 1 -> .95 -> .9025 -> .857375
    assert levels[:, 0] == pytest.approx([0.95, 0.9025, 0.857375], rel=1e-14)


def test_walking_running_and_turning():
    """Walk 0.1 at +0.01 on muscle fatigue, run 0.3 at +0.05, turn 2 pi / 5 at +0.001, each less 0.008."""
    env = start([1.0, 2.0, 3.0, 4.0, 1.0, 0.1])
    levels = do(env, "walk", "run", "turn_left", "walk", "turn_right")
    # 1 * 1.002 * 1.042 * .993 * 1.002 * .993
    by_hand = [1.002, 1.044084, 1.036775412, 1.038848962824, 1.031577020084232]
    assert levels[:, 4] == pytest.approx(by_hand, rel=1e-14)
    # 0.1 + 0.3 eastward, then 0.1 at 72 degrees
    angle = 2 * math.pi / 5
    by_hand = [3.4 + 0.1 * math.cos(angle), 2.0 + 0.1 * math.sin(angle)]
    assert env.state_view.position[0] == pytest.approx(by_hand, rel=1e-12)
    assert env.state_view.heading[0] == pytest.approx(0.0, abs=1e-12)


def test_the_night():
    """Sleep is open from sleep fatigue 1, takes 1000 ticks and multiplies it by (1 - 0.0005)^1000."""
    assert "sleep" not in open_actions(start([1, 2, 3, 4, 0.1, 0.9999]))
    env = start([1, 2, 3, 4, 5.0, 4.0])
    levels = do(env, *["sleep"] * 1000)
    assert "walk" in open_actions(env)
    assert levels[998, 5] > levels[999, 5] == pytest.approx(4.0 * 0.9995**1000, rel=1e-11)
    # the one jump of the authors' code, exp(-0.0005 * 1000), lies within the error of a tick
    assert levels[999, 5] == pytest.approx(4.0 * math.exp(-0.5), rel=2e-4)
    # meanwhile every stock falls to the floor, and the muscles rest
    assert levels[999, :4] == pytest.approx([0.1] * 4)
    assert levels[999, 4] == 0.1


def test_sleep_cannot_be_reached_before_tick_4606():
    """From 0.1 at +0.05 % a tick, sleep fatigue passes 1 after ln 10 / ln 1.0005 = 4606.3 ticks."""
    env = start()
    rest = env.groups["agent"].actions.index("rest")
    sleep = env.groups["agent"].actions.index("sleep")
    tick = None
    for _ in range(4606):
        tick = env.step_arrays(np.array([rest]))
        assert not tick.masks["agent"][0, sleep]
    assert env.step_arrays(np.array([rest])).masks["agent"][0, sleep]


@pytest.mark.parametrize(
    ("muscle", "sleepiness", "closed"),
    [
        (2.999, 0.1, set()),
        (3.0, 0.1, {"run"}),
        (6.0, 0.1, {"run", "walk", "turn_left", "turn_right", "go_to_food_2"}),
        (0.1, 10.0, {"rest", "run", "walk", "turn_left", "turn_right", "go_to_food_2"}),
    ],
)
def test_thresholds(muscle, sleepiness, closed):
    """Run closes at muscle fatigue 3, all motion at 6; at sleep fatigue 10 only sleep is left."""
    env = start([1, 2, 3, 4, muscle, sleepiness])
    always = {"rest", "run", "walk", "turn_left", "turn_right", "go_to_food_2"}
    assert open_actions(env) & always == always - closed
    assert (open_actions(env) == {"sleep"}) == (sleepiness >= 10)


def test_consuming_closes_eight_above_the_set_point():
    """Consuming is closed from x - x* = 8; the ceiling beyond is never reached."""
    assert "consume_food_2" in open_actions(start([1, 9.999, 3, 4, 0.1, 0.1], (3.5, 1.5)))
    assert "consume_food_2" not in open_actions(start([1, 10.0, 3, 4, 0.1, 0.1], (3.5, 1.5)))
    for need in start().scenario.species[0].needs[:4]:
        assert (need.set_point + 8) * 1.05 < need.bounds[1]


def test_go_to_follows_the_straight_line_at_walking_speed():
    """From (3, 2) food_2 lies sqrt(0.5) away: 5 ticks of 0.1 reach its circle of 0.3, none other is open."""
    env = start()
    levels = do(env, "go_to_food_2")
    assert open_actions(env) == {"go_to_food_2"}, "a go_to is committed to"
    levels = np.concatenate([levels, do(env, *["go_to_food_2"] * 4)])
    assert levels[:, 4] == pytest.approx([0.1 * 1.002**n for n in range(1, 6)], rel=1e-12)
    gone = 0.5 / math.sqrt(0.5) * 0.5  # 5 * 0.1 along the diagonal, on each axis
    assert env.state_view.position[0] == pytest.approx([3 + gone, 2 - gone], rel=1e-12)
    assert "consume_food_2" in open_actions(env)
    assert "go_to_food_2" not in open_actions(env)
    assert "walk" in open_actions(env)


@pytest.mark.parametrize(
    ("position", "seen"),
    [
        ((3.0, 2.0), {2}),
        ((0.5, 2.0), {1, 2}),
        (
            (4.5, 4.0),
            {2, 4},
        ),  # to food_4 through the gap at (5, 2.375); to food_3 the wall stands at (5, 4.3)
        ((5.5, 2.5), {4}),  # to food_2 the wall stands at (4.5, 2), to food_3 at (5.75, 3)
        ((3.5, 5.5), {2, 3}),
    ],
)
def test_a_resource_is_seen_all_round_along_a_free_line(position, seen):
    """A go_to is open exactly where the straight segment to the resource meets no wall, at any distance."""
    names = open_actions(start(position=position))
    assert {i for i in range(1, 5) if f"go_to_food_{i}" in names} == seen


def test_the_easy_square():
    """EASY is a square of 10 with the first two resources and needs, and sees all over."""
    env = start(arena="EASY")
    species = env.scenario.species[0]
    assert [need.set_point for need in species.needs] == [1, 2, 0, 0]
    assert [r.position for r in env.scenario.resources] == [(0.5, 4.25), (3.5, 1.5)]
    assert env.scenario.arena.vertices == ((0, 0), (10, 0), (10, 10), (0, 10))
    assert {"go_to_food_1", "go_to_food_2"} <= open_actions(env)


def test_four_directions():
    """Without heading the walks lead east, north, west and south, and zeta has no heading."""
    env = start(heading=False, arena="EASY", start=(5.0, 5.0))
    assert env.groups["agent"].layout.names == (
        "need_1",
        "need_2",
        "muscle_fatigue",
        "sleep_fatigue",
        "x",
        "y",
    )
    places = [env.state_view.position[0].copy()]
    for way in ("east", "north", "west", "south"):
        do(env, f"walk_{way}")
        places.append(env.state_view.position[0].copy())
    assert np.diff(places, axis=0) == pytest.approx(np.array([[0.1, 0], [0, 0.1], [-0.1, 0], [0, -0.1]]), abs=1e-12)


def test_two_needs_cannot_be_held_at_once():
    """Holding one need takes half of all time: x at rest falls by 5 % a tick, consuming lifts it by 5 %."""
    env = start(position=(3.5, 1.5))
    levels = do(env, *["consume_food_2", "rest"] * 10)
    assert levels[-1, 1] == pytest.approx(2.0 * (1.05 * 0.95) ** 10, rel=1e-12)
    assert math.log(1 / 0.95) / math.log(1.05 / 0.95) == pytest.approx(0.51, abs=0.005)
