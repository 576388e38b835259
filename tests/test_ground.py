"""Holes and inner walls: seen, avoided, placed around, planned around, drawn and checked."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from worlds import SQUARE, ask, kind, square, start

import ecology
from ecology import (
    Arena,
    Birth,
    Drift,
    EcologyError,
    Growth,
    Need,
    Neighbours,
    Relocation,
    Resource,
    Scenario,
    Species,
    bite,
    consume,
    contract,
    go_to,
    move,
    rest,
    turn,
)
from ecology.ground import ground_of, scatter
from ecology.ground.outline import drawn_lines, polygon_of
from ecology.ground.ways import Paths
from ecology.observers import picture
from ecology.physics import Physics

RADIUS = 0.1
BOX = ((3.0, 3.0), (5.0, 3.0), (5.0, 5.0), (3.0, 5.0))
WALL = ((4.0, 0.0), (4.0, 6.0))  # from the lower wall of the square, two thirds up
FREE = ((4.0, 2.0), (4.0, 6.0))  # touches nothing


def room(**words):
    """Return the square of 8 by 8 with holes and walls."""
    return Arena(vertices=SQUARE, **words)


def bodies(arena, position, radius=RADIUS, solid=False):
    """Return a Physics of circles at `position` (N, 2), and the position as an array."""
    position = np.array(position, float).reshape(-1, 2)
    n = len(position)
    world = Physics(ground_of(arena), np.full(n, radius), np.full(n, solid), position, np.ones(n, bool))
    return world, position


def world_of(arena, *species, **words):
    """Return a scenario in `arena`."""
    return Scenario(**{"name": "room", "arena": arena, "species": species, **words})


# ---- any polygons --------------------------------------------------------------------------------


def star(rng, middle, least, most, corners):
    """Return a polygon around `middle`, its corners `least` to `most` away."""
    angle = np.sort(rng.uniform(-math.pi, math.pi, corners))
    far = rng.uniform(least, most, corners)
    return [tuple(middle + r * np.array([math.cos(a), math.sin(a)])) for a, r in zip(angle, far, strict=True)]


def any_arena(seed):
    """Return an arena of random rings, holes and thin inner walls, some of which touch the ring, or None if refused."""
    rng = np.random.default_rng(seed)
    ring = star(rng, np.zeros(2), 3.0, 8.0, int(rng.integers(4, 12)))
    holes = [star(rng, rng.uniform(-3, 3, 2), 0.3, 1.2, int(rng.integers(3, 7))) for _ in range(rng.integers(0, 4))]
    lines = [rng.uniform(-3.5, 3.5, (int(rng.integers(2, 5)), 2)) for _ in range(rng.integers(0, 4))]
    walls = [[tuple(point) for point in line] for line in lines]
    corner = ring[int(rng.integers(len(ring)))]
    if rng.random() < 0.5:
        walls.append([corner, tuple(0.5 * np.array(corner))])
    if rng.random() < 0.5:
        ring = ring[::-1]
    try:
        return Arena(vertices=ring, holes=holes, walls=walls)
    except EcologyError:
        return None


def solid(arena):
    """Return what blocks, by shapely alone: the outside and the holes as a polygon, the walls as lines."""
    free = shapely.Polygon(arena.vertices).difference(shapely.union_all([shapely.Polygon(h) for h in arena.holes]))
    return free, shapely.MultiLineString([list(wall) for wall in arena.inner_walls])


def hold_ways(arena, before, after):
    """Hold straight ways (n, 2) to stay in the arena and to cross no wall, as shapely sees it."""
    free, walls = solid(arena)
    ways = shapely.linestrings(np.stack([before, after], axis=1))
    good = free.buffer(1e-6).covers(ways) & ~walls.intersects(ways)
    assert good.all(), (before[~good], after[~good])


any_seed = settings(
    max_examples=60, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck)
)


@any_seed
@given(st.integers(0, 10**9))
def test_places_ways_and_looks_are_those_of_shapely(seed):
    """In any arena: what is inside, which ways stay in it, and which looks are free, but within 1e-5 of a wall."""
    arena = any_arena(seed)
    assume(arena is not None)
    ground, (free, walls) = ground_of(arena), solid(arena)
    edge = shapely.union_all([free.boundary, walls])
    rng = np.random.default_rng(seed)
    here, there = rng.uniform(-8, 8, (2, 600, 2))
    sure = edge.distance(shapely.points(here)) > 1e-5
    assert np.array_equal(ground.inside(here)[sure], free.contains(shapely.points(here))[sure])
    inside = sure & free.contains(shapely.points(here))
    here, there = here[inside], there[inside]
    ways = shapely.linestrings(np.stack([here, there], axis=1))
    expected = ~edge.intersects(ways)
    sure = expected == ~edge.buffer(1e-5).intersects(ways)  # and does not just pass by
    assert np.array_equal(ground.stays(here, there)[sure], expected[sure])
    sure &= free.contains(shapely.points(there))  # looks are between two points of the arena
    assert np.array_equal(ground.clear(here, there)[sure], expected[sure])
    near = edge.distance(shapely.points(here))
    assert ground.room(here) == pytest.approx(near, abs=1e-5)


@any_seed
@given(st.integers(0, 10**9), st.sampled_from([0.03, 0.12, 2.0, 15.0]), st.booleans())
def test_no_body_leaves_any_arena(seed, speed, touch):
    """At any speed no way crosses a wall, bodies that push each other included; at rest all have room."""
    arena = any_arena(seed)
    assume(arena is not None)
    rng = np.random.default_rng(seed)
    try:
        places = scatter(arena, RADIUS, 20, rng)
    except ValueError:
        assume(False)
    free, walls = solid(arena)
    world, position = bodies(arena, places, solid=touch)
    for k in range(16):
        if k % 8 == 0:
            course = rng.uniform(-np.pi, np.pi, 20)
        before = position
        position, _ = world.move(before, speed * np.stack([np.cos(course), np.sin(course)], axis=1), 1.0)
        hold_ways(arena, before, position)
    if not touch:
        edge = shapely.union_all([free.boundary, walls])
        for _ in range(40):
            position, _ = world.move(position, np.zeros((20, 2)), 1.0)
        pointed = edge.distance(shapely.points(position)) < 0.4 * RADIUS  # wedged where two walls meet
        assert pointed.mean() < 0.2


@any_seed
@given(st.integers(0, 10**9))
def test_places_at_random_have_room(seed):
    """Scattered places are at least the margin from every wall, and get into every part that has room."""
    arena = any_arena(seed)
    assume(arena is not None)
    free, walls = solid(arena)
    edge = shapely.union_all([free.boundary, walls])
    places = scatter(arena, RADIUS, 200, np.random.default_rng(seed))
    assert free.contains(shapely.points(places)).all()
    assert edge.distance(shapely.points(places)).min() > RADIUS - 1e-6


@any_seed
@given(st.integers(0, 10**9))
def test_shortest_ways_go_around(seed):
    """A way is as long as the straight line where a body of 1.5 radii walks that, and longer where a wall is in it."""
    arena = any_arena(seed)
    assume(arena is not None)
    reached = polygon_of(arena).buffer(-RADIUS, join_style="mitre", mitre_limit=1.5)
    assume(reached.geom_type == "Polygon")
    places = scatter(arena, RADIUS, 12, np.random.default_rng(seed))
    paths, goal = Paths(arena, RADIUS), places[0]
    length = paths.distance(places[1:], goal)
    straight = np.hypot(*(places[1:] - goal).T)
    free, walls = solid(arena)
    ways = shapely.linestrings(np.stack([places[1:], np.broadcast_to(goal, places[1:].shape)], axis=1))
    apart = shapely.union_all([free.boundary, walls]).distance(ways)
    assert np.isfinite(length).all()
    assert (length >= straight - 1e-9).all()
    clear = apart > 1.5 * RADIUS
    assert length[clear] == pytest.approx(straight[clear])
    assert (length[apart == 0] > straight[apart == 0]).all()


# ---- bodies --------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [0.03, 0.12, 1.0, 30.0])
@pytest.mark.parametrize("wall", [WALL, FREE])
@pytest.mark.parametrize("heading", [0.0, math.pi])
def test_an_inner_wall_stops_a_body_on_either_side(wall, speed, heading):
    """Walking straight at a wall without thickness ends a radius before it."""
    side = math.cos(heading)
    world, position = bodies(room(walls=[wall]), [(4.0 - 2 * side, 3.0)])
    for _ in range(100):
        position, _ = world.move(position, np.array([[side * speed, 0.0]]), 1.0)
    assert position[0] == pytest.approx([4.0 - side * RADIUS, 3.0], abs=0.01)


@pytest.mark.parametrize("speed", [0.12, 3.0])
def test_bodies_slide_along_an_inner_wall_and_past_its_end(speed):
    """A body that walks obliquely into a wall is led along it, around its end, and on."""
    world, position = bodies(room(walls=[WALL]), [(3.0, 2.0)])
    for _ in range(150):
        before = position
        position, _ = world.move(before, speed * np.array([[math.cos(1.2), math.sin(1.2)]]), 1.0)
        hold_ways(room(walls=[WALL]), before, position)
    assert position[0] == pytest.approx([8 - RADIUS, 8 - RADIUS], abs=0.01)


@pytest.mark.parametrize("speed", [0.05, 0.5, 7.0])
def test_the_end_of_a_wall_stops_a_body_head_on(speed):
    """A body that walks along the line of a free wall is held by its end, and is never on the wall."""
    world, position = bodies(room(walls=[FREE]), [(4.0, 0.5)])
    for _ in range(80):
        before = position
        position, _ = world.move(before, np.array([[0.0, speed]]), 1.0)
        hold_ways(room(walls=[FREE]), before, position)
        away = shapely.LineString(FREE).distance(shapely.Point(position[0]))
        assert away > 0.4 * RADIUS


@pytest.mark.parametrize("speed", [0.12, 4.0])
@pytest.mark.parametrize("direction", [0.0, math.pi / 2, math.pi, -math.pi / 2])
def test_a_hole_stops_a_body_from_every_side(direction, speed):
    """A body that walks at a hole ends a radius before it."""
    toward = np.array([math.cos(direction), math.sin(direction)])
    world, position = bodies(room(holes=[BOX]), 4.0 - 2.0 * toward)
    for _ in range(60):
        position, _ = world.move(position, speed * toward[None], 1.0)
    assert shapely.Polygon(BOX).distance(shapely.Point(position[0])) == pytest.approx(RADIUS, abs=0.01)


# ---- sight and meetings --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words", [{"holes": [BOX]}, {"walls": [FREE]}, {"walls": [((4, 2), (4, 4)), ((4, 4), (4, 6))]}]
)
def test_what_lies_behind_is_not_seen_nor_met(words):
    """A hole or a wall hides resources and others, and nobody bites through it; beside it all is as in the open."""
    wolf = kind(
        "wolf",
        go_to("food", 0.1),
        bite("sheep", reach=3.0),
        sees=("food",),
        neighbours=(Neighbours(species=("sheep",)),),
    )
    food = Resource(name="food", position=(5.5, 4.0), radius=0.2)
    scenario = world_of(room(**words), wolf, kind("sheep"), resources=(food,))
    env = start(scenario, position=[[2.5, 4.0], [5.4, 4.0]])
    names = env.groups["wolf"].layout.names
    for position, seen in (([[2.5, 4.0], [5.4, 4.0]], False), ([[5.5, 6.5], [5.5, 7.5]], True)):
        tick = env.set_state(position=position)
        zeta, far = tick.observations["wolf"][0], env.groups["wolf"].layout.high
        sheep, berries = names.index("sheep_1_distance"), names.index("food_distance")
        assert (zeta[sheep] < far[sheep] - 1e-6) == seen
        assert (zeta[berries] < far[berries] - 1e-6) == seen
        actions = env.groups["wolf"].actions
        assert tick.masks["wolf"][0, actions.index("bite_sheep")] == seen
        assert tick.masks["wolf"][0, actions.index("go_to_food")] == seen


# ---- placement -----------------------------------------------------------------------------------


def test_nothing_is_placed_in_a_hole():
    """Founders, newborns, newcomers, scattered, drifting and relocated patches are outside of the hole."""
    hole = ((1.0, 1.0), (7.0, 1.0), (7.0, 7.0), (1.0, 7.0))
    grass = Resource(name="grass", count=30, radius=0.3, stock=0.2, growth=Growth(rate=0.01), capacity=1.0)
    berry = Resource(name="berry", radius=0.3, stock=0.05, motion=Relocation())
    fly = Resource(name="fly", position=(0.5, 0.5), motion=Drift(spread=0.4))
    food = Need(name="food", set_point=2.0, bounds=(0.0, 4.0))
    eats = (consume("berry", {"food": 0.1}), consume("grass", {"food": 0.1}))
    agent = kind(
        "agent", *eats, count=40, capacity=120, birth=Birth(rate=0.05), arrival=0.5, radius=RADIUS, needs=(food,)
    )
    env = start(world_of(room(holes=[hole]), agent, resources=(grass, berry, fly)))
    tick, rng = env.reset_arrays(0), np.random.default_rng(0)
    inside, polygon = shapely.Polygon(hole), polygon_of(env.scenario.arena)
    moved = set()
    for _ in range(60):
        place = env.state_view.position.copy()
        place[0] = env.state_view.resource_position[30]  # eats up the berry in every tick
        tick = env.set_state(position=place)
        chosen = contract.choose(env, tick, rng)
        chosen[0] = env.groups["agent"].actions.index("consume_berry")
        tick = env.step_arrays(chosen)
        state = env.state_view
        assert not inside.intersects(shapely.points(state.position[state.alive])).any()
        assert polygon.contains(shapely.points(state.resource_position)).all()
        assert inside.distance(shapely.points(state.resource_position[:31])).min() > 0.3 - 1e-9
        moved.add(tuple(state.resource_position[30]))
    assert env.state_view.next_serial > 60
    assert len(moved) == 60


def test_a_place_in_a_hole_is_refused():
    """By `set_state`, `settle`, an intervention's place, and a rule."""
    env = start(world_of(room(holes=[BOX]), kind(count=1, capacity=2)), position=[[1.0, 1.0], [1.0, 1.0]])
    with pytest.raises(EcologyError, match="inside the arena"):
        env.set_state(position=[[4.0, 4.0], [1.0, 1.0]])
    with pytest.raises(EcologyError, match="outside the arena"):
        env.settle("agent", (4.0, 4.0), 0.0)

    def rule(world, rng):
        outcome = world.no_effect()
        outcome.position = np.full((1, 2), 4.0)
        assert world.inside(np.array([[1.0, 1.0], [4.0, 4.0]])).tolist() == [True, False]
        return outcome

    env = start(world_of(room(holes=[BOX]), kind(position=(1.0, 1.0)), rule=rule))
    with pytest.raises(EcologyError, match="outside the arena"):
        env.step_arrays(np.zeros(1, np.int64))


# ---- planning ------------------------------------------------------------------------------------


def test_shortest_ways_worked_by_hand():
    """Around the end of a wall, and around the corner of a box, a radius away."""
    paths = Paths(room(walls=[WALL]), 0.5)
    around = 2 * math.hypot(1.5, 1.5) + 1.0  # to (3.5, 6.5), over to (4.5, 6.5), and down again
    assert paths.distance([[2.0, 5.0]], (6.0, 5.0))[0] == pytest.approx(around, abs=1e-5)
    paths = Paths(room(holes=[BOX]), 0.5)
    around = 2 * math.hypot(1.5, 1.5) + 3.0
    assert paths.distance([[1.0, 4.0]], (7.0, 4.0))[0] == pytest.approx(around, abs=1e-5)


def test_the_planner_walks_around_a_wall():
    """Between two foods on either side of a wall the planner goes round its end, and eats both."""
    needs = [Need(name=n, set_point=1.0, decay=0.002, bounds=(0.0, 2.0)) for n in ("thirst", "hunger")]
    acts = (
        rest(), move("walk", 0.2), turn("left", math.pi / 8), turn("right", -math.pi / 8),
        consume("water", {"thirst": 0.1}), consume("grass", {"hunger": 0.1}),
    )  # fmt: skip
    agent = Species(name="agent", needs=tuple(needs), actions=acts, position=(2.0, 2.0), heading=0.0)
    foods = (
        Resource(name="water", position=(2.0, 3.0), radius=0.5),
        Resource(name="grass", position=(6.0, 3.0), radius=0.5),
    )
    scenario = world_of(room(walls=[WALL], holes=[((2.2, 6.4), (3.0, 6.4), (3.0, 7.0))]), agent, resources=foods)
    env = ecology.parallel_env(scenario)
    from ecology.agents.planner import Planner

    planner = Planner(env.groups["agent"], np.random.SeedSequence(0), scenario)
    walls = shapely.LineString(WALL)
    tick = env.reset_arrays(0)
    for _ in range(900):
        before = env.state_view.position[0].copy()
        tick = env.step_arrays(planner.act(tick.observations["agent"], tick.masks["agent"]))
        assert not walls.intersects(shapely.LineString([before, env.state_view.position[0]]))
    assert (env.state_view.ingested[0, :2] > 0.3).all()
    assert np.isfinite(planner.travel[-1]).all()


# ---- drawing -------------------------------------------------------------------------------------


def test_a_picture_shows_holes_and_walls():
    """A hole is as dark as the outside, an inner wall is black, and the free floor is white."""
    scenario = world_of(room(walls=[((6.5, 1.0), (6.5, 7.0))], holes=[BOX]), kind(position=(1.0, 1.0)))
    env = ecology.parallel_env(scenario, render_mode="rgb_array")
    env.reset_arrays(0)
    with_walls = env.render()
    plain = picture.draw_picture(world_of(room(), kind(position=(1.0, 1.0))), env.state_view)
    changed = (with_walls != plain).any(axis=2)
    rows, columns = np.nonzero(changed)
    colours = {tuple(c) for c in with_walls[rows, columns].tolist()}
    assert (209, 209, 209) in colours
    assert (0, 0, 0) in colours
    lines = drawn_lines(scenario.arena)
    assert [len(line) for line in lines] == [5, 5, 2]
    assert lines[1][0].tolist() == lines[1][-1].tolist() == [3.0, 3.0]


# ---- checks --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"holes": [((3, 3), (5, 3))]}, r"holes\[0\] needs at least 3 vertices, got 2"),
        ({"holes": [((3, 3), (5, 3), (5, math.nan))]}, "must be a finite number"),
        ({"holes": [((3, 3), (5, 5), (5, 3), (3, 5))]}, r"holes\[0\] must not cross"),
        ({"holes": [((3, 3), (9, 3), (9, 5))]}, r"holes\[0\] reaches beyond the outer walls, at \(9.0, [35].0\)"),
        ({"holes": [BOX, ((4, 4), (6, 4), (6, 6))]}, r"holes\[1\] overlaps holes\[0\]"),
        ({"walls": [((3, 3),)]}, r"walls\[0\] needs at least 2 points, got 1"),
        ({"walls": [((3, 3), (3, 3))]}, r"the point \(3, 3\) at 0 is repeated at 1"),
        ({"walls": [((3, 3), (9, 3))]}, r"walls\[0\] reaches beyond the outer walls, at \(9.0, 3.0\)"),
        ({"walls": [((4, 0), (4, 8))]}, r"cut it into 2 parts.*an area of 32 around \(\d.*Leave a gap"),
        ({"walls": [((2, 2), (6, 2), (4, 6), (2, 2))]}, r"cut it into 2 parts"),
        ({"walls": [((0, 4), (3, 4)), ((5, 4), (8, 4))], "holes": [BOX]}, r"cut it into 2 parts"),
        ({"walls": False, "holes": [BOX]}, "a torus has no holes, got 1"),
        ({"walls": ((4, 0), (4, 8))}, "walls must be"),
        ({"walls": "yes"}, "walls must be True or False or a tuple of"),
    ],
)
def test_bad_holes_and_walls_are_refused(words, said):
    """Each is one error that says what is wrong and where."""
    with pytest.raises(EcologyError, match=said):
        room(**words)


def test_no_inner_walls_are_no_torus():
    """`walls=[]` has outer walls; NumPy arrays and lists do for tuples."""
    assert not room(walls=[]).torus
    assert room(walls=[]).inner_walls == []
    assert room(walls=False).torus
    listed = room(walls=[[[4.0, 0.0], [4.0, 6.0]]], holes=[[[5.0, 5.0], [6.0, 5.0], [6.0, 6.0]]])
    assert polygon_of(listed).area == pytest.approx(63.5, abs=1e-4)


def test_walls_that_touch_are_one():
    """Walls that end on a slanted ring, on a hole, or cross each other leave no gap and no error."""
    ring = ((0, 0), (9, 1), (7, 8), (1, 7))
    foot = (0.3 * 9, 0.3 * 1)  # on the slanted lower wall, but for rounding
    arena = Arena(
        vertices=ring,
        walls=[(foot, (3.0, 3.0)), ((2.0, 2.0), (4.0, 2.5)), ((5.0, 4.0), (6.0, 4.0))],
        holes=[((6, 3), (7, 4), (6, 5))],
    )
    ground = ground_of(arena)
    beside = np.array([[foot[0] - 0.05, foot[1] + 0.02]])
    assert ground.inside(beside).all()
    assert not ground.clear(beside, np.array([[foot[0] + 0.05, foot[1] + 0.03]]))[0]
    assert not ground.clear(np.array([[5.5, 3.5]]), np.array([[5.5, 4.5]]))[0]
    assert len(ground.rings) == 2  # the ring with two walls on it, the hole with one


def test_a_door_too_narrow_for_every_body_breaks_the_contract():
    """The check says what is cut off; a door for the smallest body is enough."""
    arena = room(walls=[((4.0, 0.0), (4.0, 3.9)), ((4.0, 4.1), (4.0, 8.0))])
    wide, narrow = kind("wide", radius=0.3), kind("narrow", radius=0.05)
    contract.bodies_reach_everything(world_of(arena, wide, narrow), 1)
    with pytest.raises(EcologyError, match=r"an area of 2\d.* around \(.*cut off for a body of radius 0.3; widen"):
        contract.bodies_reach_everything(world_of(arena, wide), 1)
    contract.bodies_reach_everything(square(wide, walls=False), 1)


def test_species_and_resources_keep_out_of_holes():
    """A position in a hole, or nearer to it than the radius, is refused, and a way through a wall too."""
    with pytest.raises(EcologyError, match="lies outside the arena"):
        world_of(room(holes=[BOX]), kind(position=(4.0, 4.0)))
    with pytest.raises(EcologyError, match="nearer than its radius"):
        world_of(room(walls=[FREE]), kind(position=(4.05, 4.0)))
    with pytest.raises(EcologyError, match="lies outside the arena"):
        world_of(room(holes=[BOX]), kind(), resources=(Resource(name="food", position=(4.0, 4.0)),))
    swing = Resource(name="food", position=(2.0, 4.0), motion=ecology.Oscillation(to=(6.0, 4.0), period=10.0))
    with pytest.raises(EcologyError, match="leaves the arena"):
        world_of(room(walls=[FREE]), kind(), resources=(swing,))


def test_a_walk_in_a_world_with_an_inner_wall_ends_at_it():
    """The same through the whole world, by its actions."""
    walker = kind("agent", move("east", 0.5, direction=0.0), position=(1.0, 3.0))
    env = start(world_of(room(walls=[WALL]), walker))
    for _ in range(20):
        env.step_arrays(ask(env, agent="east"))
    assert env.state_view.position[0] == pytest.approx([4.0 - RADIUS, 3.0], abs=0.01)


def test_a_world_without_holes_keeps_its_digest():
    """Checkpoints from before there were holes open: the words of such an arena are those of then."""
    from ecology.lab.runs.run_config import words_of

    assert words_of(room()) == {"vertices": [list(corner) for corner in SQUARE], "walls": True}
    assert words_of(room(holes=[BOX]))["holes"] == [[list(corner) for corner in BOX]]
    assert words_of(room(walls=[WALL]))["walls"] == [[list(point) for point in WALL]]
