"""Patches that move: oscillation, drift, relocation, and places that bodies can reach."""

import dataclasses
import math

import numpy as np
import pytest
import shapely
from stocks import FOOD, HOOK, SQUARE, berries, eat, idle, world

import ecology
from ecology import (
    Arena,
    Drift,
    EcologyError,
    Oscillation,
    Relocation,
    Resource,
    Scenario,
    Species,
    consume,
    resources,
    rest,
)
from ecology.ground import ground_of

# ---- moving ------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [50.0, 12.5])
def test_an_oscillation_is_a_triangle_wave(dt):
    """From 0.5 to 1.5 in a period of 1000: 0.5, 0.75, 1.0, 1.25, 1.5 and back, whatever the tick."""
    env = world(berries(position=(0.5, 3.0), motion=Oscillation(to=(1.5, 3.0), period=1000.0)), dt=dt)
    env.reset_arrays(seed=0)
    wave = {0: 0.5, 150: 0.8, 250: 1.0, 400: 1.3, 500: 1.5, 600: 1.3, 750: 1.0, 1000: 0.5, 1250: 1.0}
    for k in range(int(1250 / dt) + 1):
        if k:
            idle(env)
        if k * dt in wave:
            assert env.state_view.resource_position[0] == pytest.approx([wave.pop(k * dt), 3.0], abs=1e-12)
    assert not wave


def test_the_phase_of_an_oscillation():
    """Phase pi starts at the other end, pi / 2 half way there."""
    for phase, x in ((math.pi, 3.0), (math.pi / 2, 2.0), (-math.pi / 2, 2.0)):
        env = world(berries(position=(1.0, 1.0), motion=Oscillation(to=(3.0, 3.0), period=10.0, phase=phase)))
        env.reset_arrays(seed=0)
        assert env.state_view.resource_position[0] == pytest.approx([x, x])


def test_reach_follows_a_moving_resource():
    """Consume opens when the resource comes to the agent and closes when it has left."""
    motion = Oscillation(to=(3.5, 2.0), period=20.0)
    env = world(Resource(name="berries", position=(0.5, 2.0), motion=motion), position=(2.0, 3.0 - 0.75))
    tick = env.reset_arrays(seed=0)
    opened = [bool(tick.masks["agent"][0, 1])]
    opened += [bool(idle(env).masks["agent"][0, 1]) for _ in range(20)]
    assert [t for t, there in enumerate(opened) if there] == [5, 15]


def test_a_walk_mirrored_at_walls_worked_by_hand():
    """A step into a wall ends at its mirror image; into a corner, mirrored twice; in the free, as it is."""
    for start, step, end in (
        ((3.0, 2.0), (2.0, 1.0), (3.0, 3.0)),
        ((3.0, 3.0), (2.0, 1.5), (3.0, 3.5)),
        ((1.0, 1.0), (0.5, 0.25), (1.5, 1.25)),
        ((1.0, 2.0), (-8.0, 0.0), (1.0, 2.0)),  # to the left wall, the right one, and back
    ):
        assert ground_of(SQUARE).reflect(np.array(start), np.array(step)) == pytest.approx(end)


@pytest.mark.parametrize("arena", [SQUARE, HOOK])
def test_a_drift_stays_inside_and_gets_everywhere(arena):
    """However wide the steps, the circle's centre stays in the arena, and in the end is equally likely anywhere."""
    ground, rng = ground_of(arena), np.random.default_rng(2)
    place, path = np.array([0.5, 0.5]), []
    for _ in range(8000):
        place = ground.reflect(place, 0.6 * rng.standard_normal(2))
        path.append(place)
    polygon = shapely.Polygon(arena.vertices)
    assert polygon.contains(shapely.points(path)).all()
    share = shapely.box(0, 0, 2, 2).intersection(polygon).area / polygon.area
    assert shapely.box(0, 0, 2, 2).covers(shapely.points(path)).mean() == pytest.approx(share, abs=0.08)


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_a_drift_spreads_with_the_root_of_time(dt):
    """Far from walls the variance along each axis is spread^2 t, whatever the tick."""
    many = tuple(Resource(name=f"r{i}", position=(2.0, 2.0), motion=Drift(spread=0.05)) for i in range(400))
    env = world(*many, dt=dt)
    env.reset_arrays(seed=1)
    idle(env, int(16 / dt))
    moved = env.state_view.resource_position - 2.0
    assert moved.var(axis=0) == pytest.approx([0.05**2 * 16] * 2, rel=4 * math.sqrt(2 / 400))


def test_relocation_inside_the_arena_with_a_new_stock():
    """A stock that is eaten up reappears elsewhere, its circle inside the arena, as it was at the start."""
    env = world(
        Resource(name="berries", radius=0.4, stock=0.2, capacity=1.0, motion=Relocation()),
        arena=HOOK,
        senses=(),
        view_angle=1.0,
    )
    env.reset_arrays(seed=3)
    room = shapely.Polygon(HOOK.vertices).buffer(-0.4, join_style="mitre").buffer(1e-9)
    places = [env.state_view.resource_position[0].copy()]
    for _ in range(40):
        env.set_state(position=env.state_view.resource_position)
        eat(env)
        assert env.state_view.stock == pytest.approx([0.1])
        assert np.array_equal(env.state_view.resource_position[0], places[-1])
        eat(env)
        assert env.state_view.stock == pytest.approx([0.2])
        places.append(env.state_view.resource_position[0].copy())
    assert room.covers(shapely.points(places)).all()
    assert len(np.unique(places, axis=0)) == 41
    assert env.state_view.grown == pytest.approx([8.0])


def test_who_was_on_the_way_does_not_know_where_it_went():
    """A go_to under way to a resource that has relocated is open only if the new place is seen."""
    env = world(
        berries(radius=0.3, stock=0.1, motion=Relocation()),
        count=2,
        view_range=1.5,
        view_angle=2 * math.pi,
        radius=0.05,
    )
    lost = 0
    for seed in range(12):
        env.reset_arrays(seed=seed)
        env.set_state(position=[[2.0, 2.0], [2.0, 3.0]])
        env.step_arrays(np.array([1, 2]))
        state = env.state_view
        assert state.bound_for[1] == -1
        gap = np.hypot(*(state.resource_position[0] - state.position[1]))
        walks_on = bool(env.set_state().masks["agent"][1, 2])
        assert walks_on == (0.3 < gap <= 1.5)
        lost += not walks_on
    assert 0 < lost < 12


def test_scattered_resources_are_placed_anew_by_every_seed():
    """A resource without a position lies anywhere that its circle fits, the same for the same seed."""
    env = world(*(Resource(name=f"r{i}", radius=0.3) for i in range(30)), arena=HOOK)
    places = []
    for seed in (1, 2, 1):
        env.reset_arrays(seed=seed)
        places.append(env.state_view.resource_position.copy())
    assert np.array_equal(places[0], places[2])
    assert not np.isclose(places[0], places[1]).any()
    room = shapely.Polygon(HOOK.vertices).buffer(-0.3 + 1e-9, join_style="mitre")
    assert room.covers(shapely.points(places[0])).all()


# ---- food that bodies can reach ----------------------------------------------------------------


def large(*foods, radius=0.8, arena=SQUARE, **words):
    """Return a room of `foods` and of one body of `radius` that eats them all."""
    eats = (consume(food.name, {"food": 0.1}) for food in foods)
    body = Species(name="agent", needs=(FOOD,), actions=(rest(), *eats), radius=radius, **words)
    return Scenario(name="large", arena=arena, resources=foods, species=(body,))


def reached(scenario, places):
    """Return in which circles at `places` (n, 2) the centre of the first species' body can lie, (n,)."""
    free = shapely.Polygon(scenario.arena.vertices).buffer(-scenario.species[0].radius)
    return free.distance(shapely.points(places)) <= scenario.resources[0].radius + 1e-9


@pytest.mark.parametrize("arena", [SQUARE, Arena(vertices=((0, 0), (6, 0), (6, 1.7), (3, 1.7), (3, 4), (0, 4)))])
def test_food_is_scattered_where_a_large_body_can_eat_it(arena):
    """None of sixty small patches lies where a large body cannot reach it, at the start and after a relocation."""
    food = Resource(name="food", count=60, radius=0.3, stock=1.0, motion=Relocation())
    scenario = large(food, arena=arena)
    env = ecology.parallel_env(scenario)
    env.reset_arrays(seed=0)
    assert reached(scenario, env.state_view.resource_position).all()
    table = resources.compile_resources(scenario.resources, arena, scenario.species)
    before = env.state_view.resource_position
    places, gone = resources.relocate(table, before, np.ones(60, bool), np.random.default_rng(1))
    assert gone.all()
    assert (places != before).any(axis=1).all()
    assert reached(scenario, places).all()
    alone = resources.compile_resources(scenario.resources, arena)  # which nobody eats
    assert not reached(scenario, resources.first_places(alone, np.random.default_rng(1))).all()


@pytest.mark.parametrize(
    ("food", "good"),
    [
        (Resource(name="food", position=(0.3, 2.0), radius=0.3), False),
        (Resource(name="food", position=(0.55, 2.0), radius=0.3), True),
        (Resource(name="food", position=(0.55, 0.55), radius=0.3), False),  # the corner is farther than the wall
        (Resource(name="food", position=(0.3, 2.0), radius=0.3, motion=Oscillation(to=(2.0, 2.0), period=9.0)), True),
        (Resource(name="food", position=(0.3, 1.0), radius=0.3, motion=Oscillation(to=(0.3, 2.0), period=9.0)), False),
        (Resource(name="food", position=(0.3, 2.0), radius=0.3, motion=Drift(spread=0.1)), True),
        (Resource(name="food", position=(0.3, 2.0), radius=0.3, stock=1.0, motion=Relocation()), False),
    ],
)
def test_food_that_no_body_can_reach_is_refused(food, good):
    """A patch that its eaters never come into is refused with its place and the body; one of many eaters is enough."""
    if good:
        large(food)
    else:
        with pytest.raises(EcologyError, match=r"'food': at \(0.*too near to a wall .* of 'agent', has the radius 0.8"):
            large(food)
    small = Species(name="small", needs=(FOOD,), actions=(rest(), consume("food", {"food": 0.1})), radius=0.1)
    onlooker = dataclasses.replace(small, name="onlooker", actions=(rest(),), radius=0.9)
    for species in ((*large(dataclasses.replace(food, position=(2.0, 2.0), motion=None)).species, small), (onlooker,)):
        Scenario(name="shared", arena=SQUARE, resources=(food,), species=species)
    torus = dataclasses.replace(SQUARE, walls=False)
    large(food, arena=torus)
