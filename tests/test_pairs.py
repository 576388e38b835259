"""Who is near whom and who sees whom, against a plain loop over all pairs."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

import ecology
from ecology import neighbours, scenarios
from ecology.ground import Plane, wrap


@pytest.mark.parametrize("torus", [False, True])
@pytest.mark.parametrize("radius", [0.3, 1.0, 2.5, 20.0])
def test_the_pairs_are_those_of_a_plain_loop(torus, radius):
    """All living pairs within the radius are found, by who and the nearest first, however much room there is."""
    rng = np.random.default_rng(0)
    plane = Plane(np.array([-1.0, 2.0]), np.array([9.0, 7.0]), torus)
    position = plane.low + plane.size * rng.random((120, 2))
    position[3] = position[4]  # one upon another
    alive = rng.random(120) < 0.9
    gap = plane.gap(position[:, None], position)
    distance = np.sqrt((gap**2).sum(-1))
    expected = [
        (i, j)
        for i in range(120)
        for j in np.lexsort((np.arange(120), distance[i])).tolist()
        if i != j and alive[i] and alive[j] and distance[i, j] <= radius
    ]
    roomy = neighbours.find(plane, position, alive, radius)
    tight = neighbours.find(plane, position, alive, radius, neighbours.find(plane, position, alive, 1e-3))
    for pairs in (roomy, tight):
        assert list(zip(pairs.who.tolist(), pairs.other.tolist(), strict=True)) == expected
        assert np.array_equal(pairs.gap, gap[pairs.who, pairs.other])
        assert np.array_equal(pairs.distance, distance[pairs.who, pairs.other])
        assert np.array_equal(np.diff(pairs.starts), np.bincount(pairs.who, minlength=120))


@pytest.mark.parametrize("angle", [math.pi / 2, math.pi * 4 / 3, 2 * math.pi])
def test_who_sees_whom_is_what_angle_range_and_walls_say(angle):
    """One is seen exactly within the angle and the range, and where the line lies within the arena."""
    settings = {"n": 80, "walls": True, "neighbours": 3, "view_range": 3.0}
    scenario = scenarios.load("commons", **settings)
    species = replace(scenario.species[0], view_angle=angle)
    env = ecology.parallel_env(replace(scenario, species=(species,)))
    env.reset_arrays(seed=2)
    state = env.state_view
    pairs = neighbours.find(env.world.model.plane, state.position, state.alive, 4.0)
    looks = np.arange(80) != 7
    seen = env.world.model.vision.sees_others(pairs, state.position, state.heading, looks)
    turn = wrap(np.arctan2(pairs.gap[:, 1], pairs.gap[:, 0]) - state.heading[pairs.who])
    lines = shapely.linestrings(np.stack([state.position[pairs.who], state.position[pairs.other]], axis=1))
    clear = shapely.Polygon(scenario.arena.vertices).covers(lines)
    expected = clear & (np.abs(turn) <= angle / 2) & (pairs.distance <= 3.0) & looks[pairs.who]
    assert 0.02 < expected.mean() < 0.9
    assert not clear.all()
    assert np.array_equal(seen, expected)
    # and an agent senses the nearest three of them
    zeta = env.set_state().observations["agent"]
    first = env.groups["agent"].layout.names.index("other_1_distance")
    for i in range(80):
        mine = (pairs.who == i) & clear & (np.abs(turn) <= angle / 2) & (pairs.distance <= 3.0)
        wanted = np.full((3, 2), [3.0, 0.0])
        wanted[: mine.sum()] = np.stack([pairs.distance[mine], turn[mine]], axis=1)[:3]
        assert np.allclose(zeta[i, first : first + 6].reshape(3, 2), wanted, atol=1e-5)
