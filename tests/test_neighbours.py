"""Who is near whom, and what is sensed of others, against brute force."""

import itertools
import math

import numpy as np
import pytest
import shapely
from worlds import BAY, SQUARE, everything, kind, square, start

from ecology import Arena, Hazard, Need, Neighbours, neighbours
from ecology.ground import Plane, plane_of, scatter

FREE, TORUS = Arena(vertices=SQUARE), Arena(vertices=SQUARE, walls=False)


def shortest(arena, here, there):
    """Return the shortest way from here to there, (2,): of nine images in a torus."""
    if arena.walls:
        return there - here
    (left, bottom), (right, top) = arena.extent
    images = [
        there + np.array([i * (right - left), j * (top - bottom)]) - here
        for i, j in itertools.product((-1, 0, 1), repeat=2)
    ]
    return min(images, key=lambda way: math.hypot(*way))


def wrapped(angle):
    """Return the angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


# ---- the plane -------------------------------------------------------------------------------


def test_the_way_over_the_seam_is_the_shortest_of_nine_images():
    """In a torus the gap is that to the nearest image, in a plane with walls the straight one."""
    rng = np.random.default_rng(0)
    arena = Arena(vertices=((-1.0, 2.0), (5.0, 2.0), (5.0, 11.0), (-1.0, 11.0)), walls=False)
    plane = plane_of(arena)
    for a, b in rng.uniform([-1, 2], [5, 11], (200, 2, 2)):
        assert plane.gap(a, b) == pytest.approx(shortest(arena, a, b))
        assert math.hypot(*plane.gap(a, b)) <= plane.diagonal
    assert plane_of(FREE).gap(np.array([1.0, 1.0]), np.array([7.0, 7.0])).tolist() == [6.0, 6.0]


def test_home_is_inside_and_stays():
    """Points come home into [low, high), on the same point of the torus, and are then at home."""
    plane = Plane(np.array([-1.0, 2.0]), np.array([6.0, 9.0]), True)
    points = np.random.default_rng(0).uniform(-60, 60, (500, 2))
    points = np.concatenate([points, [[5.0, 11.0], [-1.0, 2.0], [-1.0 - 1e-17, 2.0 - 1e-17], [5.0 - 1e-16, 2.0]]])
    home = plane.home(points)
    assert (home >= plane.low).all()
    assert (home < plane.low + plane.size).all()
    turns = (points - home) / plane.size
    assert np.allclose(turns, np.round(turns))
    assert np.array_equal(plane.home(home), home)


# ---- pairs -----------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [0.3, 1.5, 3.9, 4.0, 4.1, 20.0])
@pytest.mark.parametrize("arena", [FREE, TORUS])
def test_pairs_are_those_of_brute_force(arena, radius):
    """All living pairs within the radius, both ways, each one's nearest first."""
    rng, n = np.random.default_rng(int(10 * radius)), 60
    position, alive = rng.uniform(0, 8, (n, 2)), rng.random(n) < 0.8
    pairs = neighbours.find(plane_of(arena), position, alive, radius)
    found = {(i, j): (gap, d) for i, j, gap, d in zip(pairs.who, pairs.other, pairs.gap, pairs.distance, strict=True)}
    for i, j in itertools.permutations(range(n), 2):
        way = shortest(arena, position[i], position[j])
        near = alive[i] and alive[j] and math.hypot(*way) <= radius
        assert ((i, j) in found) == near
        if near:
            assert found[i, j][0] == pytest.approx(way)
            assert found[i, j][1] == pytest.approx(math.hypot(*way))
    assert len(found) == len(pairs.who)
    mine = [pairs.distance[a:b] for a, b in itertools.pairwise(pairs.starts)]
    assert [len(part) for part in mine] == [np.count_nonzero(pairs.who == i) for i in range(n)]
    assert all((np.diff(part) >= 0).all() for part in mine)


def test_nobody_and_one_alone_have_no_pairs():
    """Without two living there are no pairs."""
    for arena, alive, radius in itertools.product((FREE, TORUS), (0, 1), (1.0, 50.0)):
        pairs = neighbours.find(plane_of(arena), np.full((3, 2), 4.0), np.arange(3) < alive, radius)
        assert len(pairs.who) == 0
        assert pairs.starts.tolist() == [0] * 4


# ---- what is sensed --------------------------------------------------------------------------


def expected(env, arena, slot, sensed):
    """Return what `slot` senses, by names of zeta: from the state, one other at a time, sight by shapely."""
    state, scenario = env.state_view, env.scenario
    species_of = [s for s in scenario.species for _ in range(s.slots)]
    me = species_of[slot]
    kinds = [s for s in scenario.species if not sensed.species or s.name in sensed.species]
    far = min(me.view_range, plane_of(arena).diagonal)
    room = shapely.Polygon(arena.vertices).buffer(1e-9)
    seen = []
    for other, theirs in enumerate(species_of):
        if other == slot or theirs not in kinds or not state.alive[other]:
            continue
        way = shortest(arena, state.position[slot], state.position[other])
        distance = math.hypot(*way)
        bearing = wrapped(math.atan2(way[1], way[0]) - state.heading[slot])
        if distance > me.view_range or abs(bearing) > me.view_angle / 2:
            continue
        if arena.walls and not room.covers(shapely.LineString([state.position[slot], state.position[other]])):
            continue
        seen.append((distance, bearing, other))
    label, found = "_".join(sensed.species) or "other", {}
    opened = list(dict.fromkeys(name for s in kinds for name in s.opens))
    for i, one in enumerate([*sorted(seen)[: sensed.count], *[None] * sensed.count][: sensed.count]):
        name, (distance, bearing, other) = f"{label}_{i + 1}", one or (far, 0.0, None)
        found |= {f"{name}_distance": distance, f"{name}_bearing": bearing}
        if sensed.heading:
            found[f"{name}_heading"] = 0.0 if one is None else wrapped(state.heading[other] - state.heading[slot])
        if len(kinds) > 1:
            found |= {f"{name}_is_{s.name}": float(one is not None and species_of[other] is s) for s in kinds}
        for need in opened:
            names = [n.name for n in species_of[other].needs] if one is not None else []
            opens = one is not None and need in species_of[other].opens
            column = names.index(need) if opens else 0
            set_point = species_of[other].needs[column].set_point if opens else 0.0
            found[f"{name}_{need}"] = state.internal[other, column] - set_point if opens else 0.0
    return found


@pytest.mark.parametrize("sensed", [Neighbours(count=3, heading=True), Neighbours(count=2, species=("b",))])
@pytest.mark.parametrize("arena", [FREE, TORUS, Arena(vertices=BAY)], ids=["free", "torus", "bay"])
def test_the_senses_agree_with_brute_force(arena, sensed):
    """The k nearest in the view field with no wall between: all components, in their order and at a fixed length."""
    needs = (Need(name="calm", set_point=1.0), Need(name="food", set_point=0.5))
    one = kind("a", count=12, neighbours=(sensed,), view_angle=4.0, view_range=3.0, opens=("food",), senses=())
    two = kind("b", count=10, needs=needs, opens=("calm", "food"), view_range=9.0, neighbours=(sensed,))
    three = kind("c", count=5)
    env = start(square(one, two, three, arena=arena))
    rng = np.random.default_rng(3)
    others = np.r_[env.groups["a"].slots, env.groups["c"].slots]  # have one need of the two
    for _ in range(12):
        internal = rng.uniform(0, 2, (env.size, 2))
        internal[others, 1] = 0.0
        tick = env.set_state(
            position=scatter(arena, 0.1, env.size, rng),
            heading=rng.uniform(-3.1, 3.1, env.size),
            internal=internal,
            alive=rng.random(env.size) < 0.8,
        )
        for group in (env.groups["a"], env.groups["b"]):
            names = group.layout.names
            for slot in range(group.slots.start, group.slots.stop):
                if not tick.alive[slot]:
                    continue
                zeta = dict(zip(names, tick.observations[group.name][slot - group.slots.start], strict=True))
                wanted = expected(env, arena, slot, sensed)
                assert {name: zeta[name] for name in wanted} == pytest.approx(wanted, abs=1e-5)
                assert list(names)[-len(wanted) :] == list(wanted)


def test_who_is_absent_is_as_far_as_can_be():
    """Without a neighbour the distance is the view range, or the arena's diagonal, and all else is 0."""
    for view_range, arena, far in ((3.0, FREE, 3.0), (99.0, FREE, math.hypot(8, 8)), (99.0, TORUS, math.hypot(4, 4))):
        sensed = (Neighbours(count=2, heading=True),)
        env = start(square(kind(count=1, neighbours=sensed, view_range=view_range, senses=()), arena=arena))
        names, zeta = env.groups["agent"].layout.names, env.set_state().observations["agent"][0]
        assert dict(zip(names, zeta, strict=True)) == pytest.approx(
            {"food": 0.0}
            | {
                f"other_{i}_{what}": far if what == "distance" else 0.0
                for i in (1, 2)
                for what in ("distance", "bearing", "heading")
            }
        )


def test_the_dead_are_not_sensed():
    """Who dies is absent from the next observation on."""
    scenario = square(
        kind("a", neighbours=(Neighbours(),), position=(4.0, 4.0), heading=0.0),
        kind("b", position=(5.0, 4.0), hazard=Hazard(rate=1e3)),
    )
    env = start(scenario)
    column = env.groups["a"].layout.names.index("other_1_distance")
    assert env.set_state().observations["a"][0, column] == 1.0
    assert env.step_arrays(np.zeros(2, np.int64)).observations["a"][0, column] == np.float32(math.hypot(8, 8))


@pytest.mark.parametrize("empty", ["a", "b"])
def test_a_species_that_nobody_is_of_is_sensed_as_absent(empty):
    """A species with no slots at all, first or last, is sensed like any other that is not there."""
    scenario = square(
        *(kind(name, count=int(name != empty), neighbours=(Neighbours(count=2),), senses=()) for name in ("a", "b"))
    )
    env = start(scenario)
    tick = env.step_arrays(np.zeros(1, np.int64))
    for group in env.groups.values():
        assert tick.observations[group.name].shape == (group.size, 9)
        assert (tick.observations[group.name][:, 1] == np.float32(math.hypot(8, 8))).all()


def test_an_empty_species_that_alone_would_sense():
    """Where only a species with no slots senses others, the rest live on unhindered."""
    env = start(square(kind("a", count=2), kind("b", count=0, neighbours=(Neighbours(),))))
    assert env.step_arrays(np.zeros(2, np.int64)).observations["b"].shape == (0, 8)


def test_zeta_keeps_its_length():
    """Through births and deaths, with many and with few about, zeta of a species is as long as its layout."""
    env = start(everything())
    rng = np.random.default_rng(0)
    for _ in range(60):
        asked = np.concatenate([rng.integers(len(g.actions), size=g.size) for g in env.groups.values()])
        tick = env.step_arrays(asked)
        for group in env.groups.values():
            assert tick.observations[group.name].shape == (group.size, len(group.layout.names))
