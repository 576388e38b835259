"""What is seen and reached: view field, walls, and the go_to that depends on them."""

import dataclasses
import math

import numpy as np
import pytest
import shapely

import ecology
from ecology import Need, scenarios
from ecology.ground import ground_of
from ecology.scenarios.paper import ARENA, PLACES, WALK_UP_TO
from ecology.senses import Component, Sense, zeta


def look(position, heading=0.0, name="paper", **settings):
    """Return which resources, from 1, are seen and reached by an agent put at a place."""
    env = ecology.parallel_env(scenarios.load(name, **settings))
    env.reset_arrays(seed=0)
    env.set_state(position=np.array([position], float), heading=np.array([heading]))
    state = env.state_view
    return {i + 1 for i in np.flatnonzero(state.seen[0])}, {i + 1 for i in np.flatnonzero(state.inside[0])}


ALL_ROUND = {"view_angle": 2 * math.pi, "view_range": 20.0}


@pytest.mark.parametrize(
    ("position", "seen"),
    [
        ((3.0, 2.0), {2}),  # food_1: the wall x = 1 stands at y = 3.8; food_3: x = 5 at y = 3.75
        ((0.9, 2.5), {1, 2}),  # up its own corridor, and along the hall
        ((1.5, 2.5), {2}),  # food_1: at x = 1 the line is at y = 3.375, on the wall from 3 to 5
        ((2.5, 3.5), {2}),  # out of the notch
        ((4.5, 5.5), {2, 3}),  # food_2: at y = 2 the line is at x = 3.63, left of the corner (4, 2)
        ((5.5, 5.5), {3}),  # food_4 straight below: the walls y = 5 and y = 3
        ((5.5, 2.5), {4}),
        ((4.5, 3.5), {2, 4}),  # through the gap from (5, 2) to (5, 3), at y = 2.125
        ((4.5, 3.0), {2}),  # below the gap, at y = 1.875
    ],
)
def test_walls_hide_resources(position, seen):
    """In the paper's arena a resource is seen exactly along a line free of walls, worked out by hand."""
    assert look(position, **ALL_ROUND)[0] == seen


def test_sight_agrees_with_shapely():
    """At random places a line is clear exactly when shapely finds the segment within the arena."""
    rng = np.random.default_rng(0)
    polygon = shapely.Polygon(ARENA.vertices)
    points = rng.uniform([0, 0], [8, 6], (6000, 2))
    points = points[polygon.contains(shapely.points(points))]
    start, end = points[: len(points) // 2], points[len(points) // 2 : len(points) // 2 * 2]
    expected = polygon.covers(shapely.linestrings(np.stack([start, end], axis=1)))
    assert 0.2 < expected.mean() < 0.8
    assert np.array_equal(ground_of(ARENA).clear(start, end), expected)


@pytest.mark.parametrize(
    ("heading", "seen"),
    [
        # food_2 lies at -45 degrees from (3, 2); the view field of 120 degrees reaches 60 to either side
        (0.0, True),
        (math.radians(14.9), True),
        (math.radians(15.1), False),
        (math.radians(-104.9), True),
        (math.radians(-105.1), False),
        (math.pi, False),
    ],
)
def test_the_view_field_has_an_angle(heading, seen):
    """A resource is seen within half the view angle to either side of the heading, and no farther."""
    assert (2 in look((3.0, 2.0), heading)[0]) == seen


def test_the_view_field_wraps_round():
    """A resource just across the direction pi is seen by an agent that looks just this side of it."""
    # food_2 from (3.9, 1.52) lies at -177.1 degrees
    for heading in (math.pi - 0.1, -math.pi + 0.1, math.pi - 0.9, -math.pi + 0.9):
        assert 2 in look((3.9, 1.52), heading)[0]
    assert 2 not in look((3.9, 1.52), 0.0)[0]


@pytest.mark.parametrize(("x", "seen"), [(0.52, True), (0.48, False)])
def test_the_view_field_has_a_range(x, seen):
    """A resource is seen up to the view range, 3: food_2 at (3.5, 1.5) from 2.98 but not from 3.02 away."""
    assert (2 in look((x, 1.5))[0]) == seen


@pytest.mark.parametrize(("dx", "inside"), [(0.0, True), (0.2999, True), (0.3001, False), (-0.3001, False)])
def test_the_circle_is_reached_at_its_radius(dx, inside):
    """A resource is within reach at a distance of at most its radius, 0.3, seen or not."""
    assert look((3.5 + dx, 1.5), heading=1.0)[1] == ({2} if inside else set())


def test_the_dead_see_and_reach_nothing(room):
    """A dead agent is in no circle, sees nothing and has no open action."""
    env = ecology.parallel_env(room(position=(5.0, 5.0), heading=0.0))
    env.reset_arrays(seed=0)
    assert env.state_view.inside.all()
    tick = env.set_state(alive=np.array([False]))
    assert not env.state_view.inside.any()
    assert not env.state_view.seen.any()
    assert not tick.masks["agent"].any()


def test_zeta_is_what_the_layout_says():
    """The components of an observation stand where the layout names them."""
    env = ecology.parallel_env(scenarios.load("paper"))
    env.reset_arrays(seed=0)
    tick = env.set_state(position=np.array([[2.5, 3.25]]), heading=np.array([-0.75]))
    layout = env.groups["agent"].layout
    zeta = dict(zip(layout.names, tick.observations["agent"][0].tolist(), strict=True))
    assert (zeta["x"], zeta["y"], zeta["heading"]) == (2.5, 3.25, -0.75)
    assert layout.needs == 6
    assert layout.kinds == (*["deviation"] * 6, "position", "position", "angle")


def test_the_clock_turns_once_a_day():
    """The sense "clock" is (cos, sin) of the time of day."""
    env = ecology.parallel_env(scenarios.load("seasons", day=8.0, weather=0.0))
    tick = env.reset_arrays(seed=0)
    hours = [tick.observations["agent"][0, -2:]]
    for _ in range(8):
        tick = env.step_arrays(np.array([0]))
        hours.append(tick.observations["agent"][0, -2:])
    assert hours[0] == pytest.approx([1, 0])
    assert hours[2] == pytest.approx([0, 1], abs=1e-6)
    assert hours[4] == pytest.approx([-1, 0], abs=1e-6)
    assert hours[8] == pytest.approx([1, 0], abs=1e-6)


# ---- go_to -------------------------------------------------------------------------------


def open_actions(env, tick):
    """Return the names of the open actions of the only agent."""
    (group,) = env.groups.values()
    return {name for name, is_open in zip(group.actions, tick.masks[group.name][0], strict=True) if is_open}


def test_go_to_opens_with_sight_and_closes_at_the_circle():
    """A go_to is open while its resource is seen, closed when it is not, and closed inside the circle."""
    env = ecology.parallel_env(scenarios.load("paper"))
    env.reset_arrays(seed=0)

    def at(position, heading):
        return open_actions(env, env.set_state(position=np.array([position]), heading=np.array([heading])))

    assert "go_to_food_2" in at((3.0, 2.0), 0.0)
    assert "go_to_food_2" not in at((3.0, 2.0), math.pi)
    assert "go_to_food_1" not in at((3.0, 2.0), 0.0)
    assert "go_to_food_1" in at((0.9, 2.5), math.pi / 2)
    inside = at((3.4, 1.5), 0.0)
    assert "go_to_food_2" not in inside
    assert "consume_food_2" in inside
    assert "consume_food_1" not in inside


def test_go_to_carries_on_until_it_arrives(act, index):
    """Under way, go_to walks straight at its speed, stays open unseen, and ends at the circle."""
    env = ecology.parallel_env(scenarios.load("paper"))
    env.reset_arrays(seed=0)
    env.set_state(position=np.array([[0.6, 1.5]]), heading=np.array([0.5]))
    gap = 2.9 - 0.3  # to the circle of food_2, straight to the east
    for k in range(1, math.ceil(gap / 0.1 - 1e-9)):
        tick = act(env, "go_to_food_2")
        assert not tick.closed[0]
        assert env.state_view.bound_for[0] == 1
        assert env.state_view.position[0] == pytest.approx([0.6 + 0.1 * k, 1.5], abs=1e-9)
        assert env.state_view.heading[0] == pytest.approx(0.0, abs=1e-9)
        # even with its back to the resource, the way it is on stays open
        assert "go_to_food_2" in open_actions(env, env.set_state(heading=np.array([math.pi])))
        assert not env.state_view.seen[0, 1]
    tick = act(env, "go_to_food_2")
    assert env.state_view.inside[0, 1]
    assert env.state_view.bound_for[0] == -1
    assert "go_to_food_2" not in open_actions(env, tick)
    assert "consume_food_2" in open_actions(env, tick)


def test_who_stands_in_a_patch_has_arrived(room, act):
    """Among patches that are all seen, go_to ends in the first one and stays closed until that one is empty."""
    plain = room()
    grass = dataclasses.replace(plain.resources[0], count=8, position=None, stock=0.2)
    agent = dataclasses.replace(plain.species[0], needs=(Need(name="food", set_point=2.0, start=1.0),))
    env = ecology.parallel_env(dataclasses.replace(plain, resources=(grass,), species=(agent,)))
    env.reset_arrays(seed=0)
    env.set_state(position=env.state_view.resource_position[:1] + np.array([[0.45, 0.0]]))
    assert env.state_view.seen.all()
    for _ in range(2):  # to the circle of radius 0.3
        tick = act(env, "go_to_berries")
    (patch,) = np.flatnonzero(env.state_view.inside[0])
    assert "go_to_berries" not in open_actions(env, tick)
    tick = act(env, "consume_berries", 2)
    assert env.state_view.stock[patch] == 0.0
    assert "go_to_berries" in open_actions(env, tick)
    assert "consume_berries" not in open_actions(env, tick)


def test_a_free_go_to_may_be_left_at_any_tick(act):
    """With commitment "free" the other actions stay open under way; once left unseen, the go_to is closed."""
    env = ecology.parallel_env(scenarios.load("paper", commitment="free"))
    env.reset_arrays(seed=0)
    tick = act(env, "go_to_food_2", 2)
    assert {"rest", "walk", "run", "turn_left", "sleep"} <= open_actions(env, tick)
    env.set_state(heading=np.array([math.pi]))
    tick = act(env, "rest")
    assert not tick.closed[0]
    assert "go_to_food_2" not in open_actions(env, tick)
    assert env.state_view.bound_for[0] == -1


def test_a_committed_go_to_leaves_no_choice(act, index):
    """With commitment "committed" the go_to is the only open action until it arrives, whatever is asked."""
    env = ecology.parallel_env(scenarios.load("paper", commitment="committed"))
    env.reset_arrays(seed=0)
    tick = act(env, "go_to_food_2")
    ticks = 1
    while env.state_view.bound_for[0] == 1:
        assert open_actions(env, tick) == {"go_to_food_2"}
        tick = act(env, "rest")
        ticks += 1
        assert tick.closed[0]
        assert tick.action[0] == index(env, "go_to_food_2")
    assert ticks == math.ceil((math.hypot(0.5, 0.5) - 0.3) / 0.1)
    assert env.state_view.inside[0, 1]
    assert {"rest", "walk", "consume_food_2"} <= open_actions(env, tick)


def test_exhaustion_ends_even_a_committed_go_to(act):
    """A go_to that the body can no longer walk is closed, and the agent may rest."""
    env = ecology.parallel_env(scenarios.load("paper", commitment="committed"))
    env.reset_arrays(seed=0)
    act(env, "go_to_food_2")
    internal = env.state_view.internal.copy()
    internal[0, 4] = WALK_UP_TO
    names = open_actions(env, env.set_state(internal=internal))
    assert "go_to_food_2" not in names
    assert "rest" in names


def test_every_resource_of_the_paper_can_be_reached_by_go_to():
    """From wherever a resource is seen, go_to arrives: no corner on a line of sight holds a body up."""
    env = ecology.parallel_env(scenarios.load("paper", **ALL_ROUND))
    rng = np.random.default_rng(4)
    env.reset_arrays(seed=0)
    names, tired = env.groups["agent"].actions, env.state_view.internal.copy()
    room = shapely.Polygon(ARENA.vertices).buffer(-0.1)
    arrived = 0
    while arrived < 60:
        place = rng.uniform([0, 0], [8, 6])
        if not room.contains(shapely.Point(place)):
            continue
        env.set_state(position=place[None], internal=tired, bound_for=np.array([-1]))
        for i in np.flatnonzero(env.state_view.seen[0] & ~env.state_view.inside[0]):
            env.set_state(position=place[None], internal=tired, bound_for=np.array([-1]))
            gap = math.dist(place, PLACES[i]) - 0.3
            for _ in range(math.ceil(gap / 0.1) + 15):  # a corner costs a few ticks
                env.step_arrays(np.array([names.index(f"go_to_food_{i + 1}")]))
                if env.state_view.inside[0, i]:
                    break
            assert env.state_view.inside[0, i], (place, i + 1)
            arrived += 1


class Age(Sense):
    """Sense how old one is."""

    def __init__(self, whose):
        """Have one component, of the slots of one species."""
        self.components = (Component("age", "plain", 100.0, 0.0, np.inf),)
        self._rows = whose.rows

    def write(self, zeta, column, model, state, seen):
        """Write the ages."""
        zeta[:, column] = state.age[self._rows]


def test_a_sense_is_one_class(monkeypatch, room):
    """A class under a name is a sense: its component has its place, its bounds and its value in zeta."""
    monkeypatch.setitem(zeta.SENSES, "age", Age)
    scenario = room(senses=("heading", "age", "position"), count=3, heading=0.5)
    env = ecology.parallel_env(scenario)
    tick = env.reset_arrays(0)
    layout = env.groups["agent"].layout
    assert layout.names == ("food", "heading", "age", "x", "y")
    assert (layout.low[2], layout.high[2], layout.kinds[2], layout.scale[2]) == (0.0, np.inf, "plain", 100.0)
    for t in range(3):
        assert tick.observations["agent"][:, 2].tolist() == [t] * 3
        assert tick.observations["agent"][:, 1] == pytest.approx([0.5] * 3)
        tick = env.step_arrays(np.zeros(3, np.int64))
    with pytest.raises(ecology.EcologyError, match="unknown sense 'agge'"):
        room(senses=("agge",))
