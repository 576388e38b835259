"""Bodies: walls hold at any speed, free space is walked exactly, bodies do not pass through each other."""

import itertools

import numpy as np
import pytest
import shapely

import ecology
from ecology import Arena, move, physics, rest, scenarios
from ecology.ground import ground_of, scatter
from ecology.scenarios.paper import ARENA

SQUARE = Arena(vertices=((0, 0), (10, 0), (10, 10), (0, 10)))
# an arena of corners: a sharp one (17 degrees), notches, a gap as wide as two bodies
SHARP = Arena(vertices=((0, 0), (10, 0), (10, 3), (5.2, 2.9), (5.2, 3.3), (10, 3.4), (10, 6), (0, 9), (3, 4)))


def bodies(arena, position, radius=0.1, alive=None):
    """Return a Physics of circles at `position` (N, 2), and the position as an array."""
    position = np.array(position, float).reshape(-1, 2)
    alive = np.ones(len(position), bool) if alive is None else np.array(alive)
    solid = np.ones(len(position), bool)
    return physics.Physics(ground_of(arena), np.full(len(position), float(radius)), solid, position, alive), position


def inside(arena, position):
    """Return whether all points lie in the arena, as another library sees it."""
    return shapely.Polygon(arena.vertices).covers(shapely.points(position)).all()


@pytest.mark.parametrize("speed", [0.1, 0.3, 5.0, 100.0])
@pytest.mark.parametrize("arena", [SQUARE, ARENA, SHARP], ids=["square", "paper", "sharp"])
def test_nobody_leaves_the_arena(arena, speed):
    """At walking and at absurd speeds, pushed by others, on stubborn courses, all stay inside."""
    rng = np.random.default_rng(int(speed * 10))
    world, position = bodies(arena, scatter(arena, 0.1, 25, rng))
    rounds = int(np.clip(100 / speed, 12, 1000))
    course = rng.uniform(-np.pi, np.pi, 25)
    for k in range(rounds):
        if k % 40 == 0:
            course = rng.uniform(-np.pi, np.pi, 25)
        jitter = course + rng.normal(0, 0.2, 25)
        way = speed * np.stack([np.cos(jitter), np.sin(jitter)], axis=1)
        position, _ = world.move(position, way, 1.0)
        assert np.isfinite(position).all()
        assert inside(arena, position)


@pytest.mark.parametrize("corner", [(10, 10), (0, 0), (10, 0), (0, 10)])
@pytest.mark.parametrize("speed", [0.1, 3.0, 50.0])
def test_a_corner_holds(corner, speed):
    """A body that pushes into a corner for a long time ends there, about a radius from both walls."""
    world, position = bodies(SQUARE, [(5.0, 5.0)])
    aim = np.array(corner, float) - 5.0
    for _ in range(int(max(12, 12 / speed))):
        position, returned = world.move(position, speed * aim[None] / np.hypot(*aim), 1.0)
        assert inside(SQUARE, position)
        assert returned == 0
    assert np.abs(position[0] - np.array(corner)) == pytest.approx([0.1, 0.1], abs=0.02)


@pytest.mark.parametrize("goal", [(10.0, 10.0), (5.0, 5.0)], ids=["corner", "middle"])
def test_a_crowd_is_no_explosion(goal):
    """Sixty bodies that push to one place overlap, but none is thrown about, and they part when they rest."""
    rng = np.random.default_rng(3)
    world, position = bodies(SQUARE, 5 + 3 * rng.uniform(-1, 1, (60, 2)))
    for push in (0.1,) * 300 + (0.0,) * 100:
        before = position
        gap = np.array(goal) - position
        far = np.maximum(np.linalg.norm(gap, axis=1, keepdims=True), 0.1)
        position, _ = world.move(position, push * gap / far, 1.0)
        assert inside(SQUARE, position)
        assert np.linalg.norm(position - before, axis=1).max() < 0.3, "thrown by more than it walks"
    apart = np.linalg.norm(position[:, None] - position[None], axis=2)[np.triu_indices(60, 1)]
    assert apart.min() > 0.2 * 0.9


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1])
@pytest.mark.parametrize("speed", [0.03, 0.1, 0.3, 1.7])
def test_free_space_is_walked_exactly(speed, dt):
    """In free space a body moves by speed times dt along its course, to rounding."""
    world, position = bodies(SQUARE, [(2.0, 5.0)])
    angle, ticks = 0.3, int(4.0 / speed / dt)
    for k in range(1, min(ticks, 40) + 1):
        position, _ = world.move(position, speed * np.array([[np.cos(angle), np.sin(angle)]]), dt)
        way = k * speed * dt
        assert position[0] == pytest.approx([2.0 + way * np.cos(angle), 5.0 + way * np.sin(angle)], abs=1e-11)


def test_a_body_without_a_command_stands_still():
    """A body does not glide: with velocity 0 it stays where it is, to the last bit."""
    world, position = bodies(SQUARE, [(5.0, 5.0)])
    position, _ = world.move(position, np.array([[0.3, 0.1]]), 1.0)
    there = position.copy()
    for _ in range(5):
        position, _ = world.move(position, np.zeros((1, 2)), 1.0)
    assert np.array_equal(position, there)


@pytest.mark.parametrize("speed", [0.1, 0.3, 2.5])
def test_a_wall_stops_a_body_at_its_radius(speed):
    """Walking straight into a wall ends about a radius before it, and stays there."""
    world, position = bodies(SQUARE, [(9.0, 5.0)], radius=0.2)
    for _ in range(60):
        position, _ = world.move(position, np.array([[speed, 0.0]]), 1.0)
    assert position[0] == pytest.approx([9.8, 5.0], abs=0.01)


def test_a_body_glides_along_a_wall():
    """Walking obliquely into a wall keeps the part of the speed along the wall."""
    world, position = bodies(SQUARE, [(3.0, 9.85)])
    for _ in range(40):
        position, _ = world.move(position, 0.1 * np.array([[np.cos(0.8), np.sin(0.8)]]), 1.0)
    assert position[0, 0] == pytest.approx(3.0 + 40 * 0.1 * np.cos(0.8), abs=0.05)
    assert position[0, 1] == pytest.approx(9.9, abs=0.01)


@pytest.mark.parametrize("speed", [0.1, 0.3, 2.0])
def test_two_bodies_do_not_pass_through_each_other(speed):
    """Two bodies that walk at each other meet, overlap for a tick at most, keep their order and stop."""
    world, position = bodies(SQUARE, [(3.0, 5.0), (7.0, 5.0)], radius=0.2)
    way = speed * np.array([[1.0, 0.0], [-1.0, 0.0]])
    for _ in range(int(3 / speed) + 20):
        position, _ = world.move(position, way, 1.0)
        assert position[0, 0] < position[1, 0]
    assert position[:, 0].mean() == pytest.approx(5.0, abs=0.01)
    assert np.hypot(*(position[1] - position[0])) == pytest.approx(0.4, abs=0.02)


def test_one_body_pushes_another():
    """A body that stands in the way is pushed on; it does not vanish from the way."""
    world, position = bodies(SQUARE, [(3.0, 5.0), (4.0, 5.0)])
    for _ in range(30):
        position, _ = world.move(position, np.array([[0.1, 0.0], [0.0, 0.0]]), 1.0)
    assert position[1, 0] > 4.3
    assert position[1, 0] - position[0, 0] > 0.18


def test_the_dead_touch_nothing():
    """A living body walks through a dead one as through free space, until it lives again."""
    world, position = bodies(SQUARE, [(3.0, 5.0), (4.0, 5.0)], alive=[True, False])
    way = np.array([[0.1, 0.0], [0.0, 0.0]])
    for _ in range(20):
        position, _ = world.move(position, way, 1.0)
    assert position == pytest.approx(np.array([[5.0, 5.0], [4.0, 5.0]]), abs=1e-11)
    for _ in range(20):
        position, _ = world.move(position, -way, 1.0, alive=np.array([True, True]))
    assert position[1, 0] < 3.9, "alive again, it is pushed"


def test_the_dead_stay_where_they_died(room):
    """In a world, a dead body is walked through and keeps its place."""
    scenario = room(needs=(ecology.Need(name="food", set_point=2.0, bounds=(0.0, 4.0), lethal=True),), count=2)
    env = ecology.parallel_env(scenario)
    env.reset_arrays(seed=0)
    env.set_state(position=np.array([[3.0, 5.0], [4.0, 5.0]]), heading=np.zeros(2), alive=np.array([True, False]))
    walk = env.groups["agent"].actions.index("walk")
    for _ in range(20):
        env.step_arrays(np.array([walk, walk]))
    assert env.state_view.position == pytest.approx(np.array([[5.0, 5.0], [4.0, 5.0]]), abs=1e-11)


def test_a_life_at_an_absurd_speed_stays_inside(room):
    """A species as fast as a scenario allows, two room widths per tick, stays in its room, in the world as a whole."""
    env = ecology.parallel_env(room(actions=(rest(), move("dash", 20.0)), count=4))
    tick = env.reset_arrays(seed=2)
    for k in range(8):
        env.set_state(heading=np.linspace(-3, 3, 4) + k)
        tick = env.step_arrays(np.ones(4, np.int64))
        assert inside(SQUARE, env.state_view.position)
        assert np.isfinite(tick.observations["agent"]).all()


def test_thousands_of_ticks_in_the_papers_arena():
    """Whatever the paper's agent does for 3000 ticks, it stays inside; only at a corner is it ever put back."""
    env = ecology.parallel_env(scenarios.load("paper"))
    tick, rng = env.reset_arrays(seed=6), np.random.default_rng(6)
    moves = [i for i, kind in enumerate(env.groups["agent"].kinds) if kind in ("move", "turn", "go_to")]
    path, put_back = [], 0
    for _ in range(3000):
        mask = tick.masks["agent"][0]
        wanted = [i for i in moves if mask[i]] or np.flatnonzero(mask)
        tick = env.step_arrays(np.array([rng.choice(wanted)]))
        path.append(env.state_view.position[0].copy())
        if env.state_view.returned > put_back:
            assert np.hypot(*(np.array(ARENA.vertices) - path[-1]).T).min() <= env.scenario.species[0].radius + 1e-9
            put_back = env.state_view.returned
    path = np.array(path)
    assert inside(ARENA, path)
    assert np.ptp(path, axis=0).min() > 1.0, "it got about"


def test_inside_agrees_with_shapely():
    """The ray that decides what is inside gives shapely's answer for points at random."""
    rng = np.random.default_rng(0)
    for arena in (SQUARE, ARENA, SHARP):
        points = rng.uniform(-1, 11, (4000, 2))
        expected = shapely.Polygon(arena.vertices).contains(shapely.points(points))
        assert np.array_equal(ground_of(arena).inside(points), expected)


def test_births_are_scattered_over_the_arena():
    """Places of birth are uniform over the arena, a radius from every wall."""
    points = scatter(ARENA, 0.1, 4000, np.random.default_rng(1))
    room = shapely.Polygon(ARENA.vertices).buffer(-0.1, join_style="mitre")
    assert room.buffer(1e-9).covers(shapely.points(points)).all()
    for cell in itertools.product(range(0, 8, 2), range(0, 6, 2)):
        box = shapely.box(*cell, cell[0] + 2, cell[1] + 2)
        share = room.intersection(box).area / room.area
        found = box.covers(shapely.points(points)).mean()
        assert found == pytest.approx(share, abs=4 * np.sqrt(share / 4000) + 1e-9)
