"""Walls of any thickness hold bodies on their way: thin walls, spikes, obstacles that a slit joins to a wall."""

import math

import numpy as np
import pytest
import shapely
from worlds import ask, kind, start

import ecology
from ecology import Arena, Birth, EcologyError, Scenario, contract, life, move, physics, scenarios
from ecology.ground import ground_of, scatter

RADIUS = 0.1


def with_wall(width, tip=2.0, left=2.0):
    """Return a room of 4 by 3 with a wall of `width` from below, as high as `tip`, its left side straight."""
    return Arena(
        vertices=((0, 0), (left, 0), (left, tip), (left + width, tip), (left + width, 0), (4, 0), (4, 3), (0, 3))
    )


POINTED = Arena(vertices=((0, 0), (1.8, 0), (2, 2), (2.2, 0), (4, 0), (4, 3), (0, 3)))
JOINED = Arena(  # an obstacle in the middle of the room, and the slit that joins it to the wall on the right
    vertices=(
        (0, 0), (4, 0), (4, 1.4), (2.5, 1.4), (2.5, 1), (1.5, 1), (1.5, 2), (2.5, 2), (2.5, 1.4001), (4, 1.4001),
        (4, 3), (0, 3),
    )
)  # fmt: skip


def bodies(arena, position, radius=RADIUS, solid=False):
    """Return a Physics of circles at `position` (N, 2), and the position as an array."""
    position = np.array(position, float).reshape(-1, 2)
    n = len(position)
    return physics.Physics(
        ground_of(arena), np.full(n, radius), np.full(n, solid), position, np.ones(n, bool)
    ), position


def jagged(rng):
    """Return a room of 6 by 6 with thin walls, spikes and an obstacle that a slit joins to a wall, at random."""
    room = shapely.box(0, 0, 6, 6)
    for _ in range(3):
        foot, width = rng.uniform(0.5, 5.5), 10 ** rng.uniform(-4, -1)
        line = shapely.LineString([(foot, -1), (foot, 0.01), rng.uniform(1, 5, 2)])
        room = room.difference(line.buffer(width / 2, cap_style="flat", join_style="mitre"))
    for _ in range(2):
        foot, half = rng.uniform(0.5, 5), rng.uniform(0.01, 0.2)
        room = room.difference(
            shapely.Polygon(
                [(-1, foot), (0, foot - half), (rng.uniform(1, 3), foot + rng.uniform(-1, 1)), (0, foot + half)]
            )
        )
    slit = shapely.LineString([(4.9, 3), (7, 3.1)]).buffer(10 ** rng.uniform(-4, -1) / 2, cap_style="flat")
    room = room.difference(shapely.box(4.2, 2.2, 5, 3.3)).difference(slit)
    room = max(getattr(room, "geoms", [room]), key=lambda part: part.area)
    corners = list(room.exterior.coords)[:-1]
    return Arena(vertices=tuple(corners if rng.random() < 0.5 else corners[::-1]))


def hold(arena, before, after):
    """Hold all ways from before to after (N, 2) to stay in the arena, as shapely sees it."""
    inside = shapely.Polygon(arena.vertices).covers(shapely.linestrings(np.stack([before, after], axis=1)))
    assert inside.all(), (before[~inside], after[~inside])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("speed", [0.12, 4.0])
def test_no_way_leaves_a_jagged_room(seed, speed):
    """No straight way of any tick crosses a wall, bodies that push each other included, and at rest all have room."""
    rng = np.random.default_rng(seed)
    arena = jagged(rng)
    for solid in (False, True):
        world, position = bodies(arena, scatter(arena, RADIUS, 40, rng), solid=solid)
        for k in range(40 if speed < 1 else 10):
            if k % 10 == 0:
                course = rng.uniform(-np.pi, np.pi, 40)
            before = position
            position, _ = world.move(before, speed * np.stack([np.cos(course), np.sin(course)], axis=1), 1.0)
            hold(arena, before, position)
        for _ in range(60):
            before = position
            position, _ = world.move(before, np.zeros((40, 2)), 1.0)
            hold(arena, before, position)
        room = shapely.Polygon(arena.vertices).exterior.distance(shapely.points(position))
        assert room.min() > 0.95 * RADIUS


@pytest.mark.parametrize("speed", [0.03, 0.12, 1.0, 30.0])
@pytest.mark.parametrize("width", [1e-6, 0.02, 0.0999, 0.1, 0.3])
def test_a_wall_of_any_width_stops_a_body(width, speed):
    """Walking straight at a wall ends a radius before it."""
    world, position = bodies(with_wall(width), [(1.0, 1.0)])
    for _ in range(60):
        position, _ = world.move(position, np.array([[speed, 0.0]]), 1.0)
    assert position[0] == pytest.approx([2.0 - RADIUS, 1.0], abs=0.01)


@pytest.mark.parametrize("speed", [0.12, 3.0])
def test_bodies_glide_along_a_thin_wall_and_past_its_tip(speed):
    """A body that walks obliquely into a thin wall is led along it, goes over its tip, and on."""
    arena = with_wall(0.02)
    world, position = bodies(arena, [(1.5, 0.5)])
    course = speed * np.array([[math.cos(1.2), math.sin(1.2)]])
    for _ in range(60):
        before = position
        position, _ = world.move(before, course, 1.0)
        hold(arena, before, position)
    assert position[0] == pytest.approx([4 - RADIUS, 3 - RADIUS], abs=0.01)


@pytest.mark.parametrize("height", [0.5, 1.0, 1.6, 1.85, 1.97])
def test_a_pointed_wall_keeps_its_tip(height):
    """A body that walks at a wall 0.4 wide and 2 high, at any height, does not come to its other side."""
    world, position = bodies(POINTED, [(1.0, height)])
    for _ in range(8):
        before = position
        position, _ = world.move(before, np.array([[0.12, 0.0]]), 1.0)
        hold(POINTED, before, position)
    face = 1.8 + 0.1 * position[0, 1]  # x of the wall's left side at this height
    assert position[0, 0] < face - 0.5 * RADIUS


@pytest.mark.parametrize("direction", [0.0, math.pi / 2, math.pi, -math.pi / 2])
def test_an_obstacle_that_a_slit_joins_to_a_wall_has_walls(direction):
    """A body that walks at the obstacle from any side ends a radius before it."""
    toward = np.array([math.cos(direction), math.sin(direction)])
    middle = np.array([2.0, 1.7])
    begin = np.where(np.abs(toward) > 0.5, middle - [1.2, 1.0] * toward, middle)
    world, position = bodies(JOINED, begin)
    for _ in range(40):
        position, _ = world.move(position, 0.12 * toward[None], 1.0)
    obstacle = shapely.box(1.5, 1, 2.5, 2)
    assert obstacle.distance(shapely.Point(position[0])) == pytest.approx(RADIUS, abs=0.01)


@pytest.mark.parametrize("pressed", [(1.9, 1.0), (2.0, 2.2)], ids=["face", "tip"])
def test_a_crowd_does_not_push_anyone_through_a_thin_wall(pressed):
    """Forty bodies that press against a thin wall stay on their side, none is thrown about, and all part at rest."""
    arena = with_wall(0.001)
    rng = np.random.default_rng(4)
    world, position = bodies(arena, rng.uniform([0.2, 0.2], [1.8, 1.8], (40, 2)), solid=True)
    for push in (0.1,) * 120 + (0.0,) * 120:
        before = position
        gap = np.array(pressed) - position
        far = np.maximum(np.linalg.norm(gap, axis=1, keepdims=True), 0.1)
        position, _ = world.move(before, push * gap / far, 1.0)
        hold(arena, before, position)
        assert np.linalg.norm(position - before, axis=1).max() < 0.3, "thrown by more than it walks"
    apart = np.linalg.norm(position[:, None] - position[None], axis=2)[np.triu_indices(40, 1)]
    assert apart.min() > 2 * RADIUS * 0.9
    assert shapely.Polygon(arena.vertices).exterior.distance(shapely.points(position)).min() > 0.9 * RADIUS


@pytest.mark.parametrize("n", [1, 10, 20, 24, 25])
def test_the_walls_of_commons_hold(n):
    """Whatever its number of agents and the width of its walls, nobody walks through the inner walls."""
    env = ecology.parallel_env(scenarios.load("commons", n=n, walls=True, ticks=10))
    env.reset_arrays(seed=n)
    arena, side = env.scenario.arena, max(math.sqrt(n), 2.0)
    env.set_state(position=np.tile([0.4 * side, 0.15 * side], (n, 1)) + 0.01 * np.arange(n)[:, None] / n)
    for way in ("walk_east",) * 20 + ("walk_west",) * 5 + ("walk_east",) * 10:
        before = env.state_view.position.copy()
        env.step_arrays(ask(env, agent=way))
        hold(arena, before, env.state_view.position)


def test_no_one_is_born_behind_a_wall():
    """Beside a parent that stands at a thin wall is its own side of it."""
    arena = with_wall(1e-6)
    parents = np.tile([1.85, 1.0], (200, 1))
    born = life.beside(ground_of(arena), parents, RADIUS, np.random.default_rng(0))
    assert (born[:, 0] < 2.0).all()
    env = start(
        Scenario(
            name="nursery",
            arena=arena,
            species=(kind(count=1, capacity=60, birth=Birth(rate=5.0), position=(1.85, 1.0)),),
        )
    )
    for _ in range(20):
        env.step_arrays(np.zeros(60, np.int64))
    assert env.state_view.alive.all()
    assert (env.state_view.position[:, 0] < 2.0).all()


def test_nobody_sees_through_the_thinnest_wall():
    """A wall whose area is next to nothing hides what lies behind it."""
    walker = kind("agent", move("go", 0.1), neighbours=(ecology.Neighbours(),), count=2)
    env = start(Scenario(name="two", arena=with_wall(1e-12), species=(walker,)), position=[[1.5, 1.0], [2.5, 1.0]])
    column = env.groups["agent"].layout.names.index("other_1_distance")
    far = env.groups["agent"].layout.high[column]
    assert env.set_state().observations["agent"][:, column] == pytest.approx([far, far])


def test_ways_that_stay_are_those_that_shapely_covers():
    """For ways at random in jagged rooms, the compiled test gives shapely's answer; a way to a corner leaves."""
    rng = np.random.default_rng(1)
    for _ in range(6):
        arena = jagged(rng)
        room = shapely.Polygon(arena.vertices)
        start_, end = rng.uniform(-0.2, 6.2, (2, 3000, 2))
        inside = room.contains(shapely.points(start_))
        start_, end = start_[inside], end[inside]
        expected = room.covers(shapely.linestrings(np.stack([start_, end], axis=1)))
        assert np.array_equal(ground_of(arena).stays(start_, end), expected)
        assert 0.1 < expected.mean() < 0.9
        corners = ground_of(arena).walls.end
        assert not ground_of(arena).stays(np.repeat(start_[:1], len(corners), axis=0), corners).any()


def test_a_way_through_a_wall_breaks_the_contract(monkeypatch):
    """Bodies that end inside the arena, but beyond a thin wall, are found, in a world with a rule too."""
    leaky = physics.Physics.move

    def without_the_wall(self, position, velocity, dt, alive=None):
        return np.clip(position + velocity * dt, [0.1, 0.1], [3.9, 2.9]), 0

    walker = kind("agent", *(move(f"go_{k}", 0.3, direction=k * math.pi / 2) for k in range(4)), count=8)
    for rule in (None, lambda world, rng: world.no_effect()):
        scenario = Scenario(name="leaky", arena=with_wall(0.02), species=(walker,), rule=rule)
        monkeypatch.setattr(physics.Physics, "move", leaky)
        contract.bodies_stay_inside(scenario, 80)
        monkeypatch.setattr(physics.Physics, "move", without_the_wall)
        with pytest.raises(EcologyError, match="goes through a wall"):
            contract.bodies_stay_inside(scenario, 80)


def test_a_vertex_that_is_repeated_is_refused():
    """A wall of no length has no direction."""
    with pytest.raises(EcologyError, match=r"the vertex \(4, 0\) at 1 is repeated at 2"):
        Arena(vertices=((0, 0), (4, 0), (4, 0), (4, 4)))
