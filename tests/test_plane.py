"""Worlds without walls, and resources of many patches."""

import math

import numpy as np
import pytest
from worlds import SQUARE, ask, everything, kind, square, start

import ecology
from ecology import Arena, EcologyError, Growth, Relocation, Resource, bite, consume, go_to, move, turn

WEST = math.pi


# ---- a torus ---------------------------------------------------------------------------------


@pytest.mark.parametrize("solid", [False, True])
@pytest.mark.parametrize(
    ("direction", "place"), [(WEST, [7.75, 3.0]), (-math.pi / 2, [0.25, 7.75]), (0.0, [0.75, 3.0])]
)
def test_who_leaves_on_one_side_comes_in_on_the_other(direction, place, solid):
    """Half a unit over the seam, and once around to the same place; nobody is put back."""
    walker = kind("agent", move("go", 0.5, direction=direction), solid=solid)
    env = start(square(walker, walls=False), position=[[0.25, 3.0 if direction != -math.pi / 2 else 0.25]])
    env.step_arrays(ask(env, agent="go"))
    assert env.state_view.position[0] == pytest.approx(place)
    for _ in range(16):  # once around
        env.step_arrays(ask(env, agent="go"))
    env.step_arrays(np.zeros(1, np.int64))
    assert env.state_view.position[0] == pytest.approx(place)
    assert env.state_view.returned == 0


def test_sight_and_walks_go_over_the_seam():
    """A resource across the seam is seen there, walked to the short way, and eaten."""
    agent = kind("agent", go_to("food", 0.5), consume("food", {"food": 0.1}), turn("left", math.pi), view_angle=1.0)
    food = (Resource(name="food", position=(7.5, 4.0), radius=0.3),)
    env = start(square(agent, walls=False, resources=food), position=[[0.5, 4.0]], heading=[0.0])
    assert not env.state_view.seen[0, 0]
    env.step_arrays(ask(env, agent="left"))
    assert env.state_view.seen[0, 0]
    env.step_arrays(ask(env, agent="go_to_food"))
    assert env.state_view.position[0] == pytest.approx([0.0, 4.0])
    env.step_arrays(ask(env, agent="go_to_food"))
    assert env.state_view.position[0] == pytest.approx([7.5, 4.0])
    assert not env.step_arrays(ask(env, agent="consume_food")).closed[0]
    walled = start(square(agent, resources=food), position=[[0.5, 4.0]], heading=[-math.pi])
    assert not walled.state_view.seen[0, 0]


@pytest.mark.parametrize(("walls", "bitten"), [(False, 1), (True, -1)])
def test_bites_go_over_the_seam(walls, bitten):
    """In a torus one on the other side is in reach, in a walled square it is not."""
    wolf = kind("wolf", bite("sheep", reach=1.0))
    env = start(square(wolf, kind("sheep"), walls=walls), position=[[0.2, 0.2], [7.8, 7.8]])
    env.step_arrays(ask(env, wolf="bite_sheep"))
    assert env.state_view.bit[0] == bitten


def test_a_place_on_the_far_seam_is_the_near_one():
    """Who is born or put on the upper edge of a torus stands on the lower one, which is the same."""
    scenario = square(kind(position=(8.0, 3.0), neighbours=(ecology.Neighbours(),), view_range=1.0), walls=False)
    env = start(scenario)
    assert env.state_view.position.tolist() == [[0.0, 3.0]]
    env.set_state(position=[[8.0, 16.5]])
    assert env.state_view.position.tolist() == [[0.0, 0.5]]


def test_a_life_without_walls_stays_at_home():
    """In a torus in which everything happens all stay within [0, 8), and nobody is ever put back."""
    env = start(everything(walls=False), seed=8)
    rng = np.random.default_rng(8)
    for _ in range(150):
        asked = np.concatenate([rng.integers(len(g.actions), size=g.size) for g in env.groups.values()])
        env.step_arrays(asked)
        for places in (env.state_view.position, env.state_view.resource_position):
            assert (places >= 0).all()
            assert (places < 8).all()
    assert env.state_view.returned == 0


def test_only_a_rectangle_does_without_walls():
    """Anything else is refused."""
    Arena(vertices=SQUARE, walls=False)
    for vertices in (((0, 0), (4, 0), (2, 3)), ((0, 0), (2, 1), (1, 3), (-1, 2))):
        with pytest.raises(EcologyError, match="rectangle along the axes"):
            Arena(vertices=vertices, walls=False)


# ---- patches ---------------------------------------------------------------------------------


def patches(count=3, *, agents=1, **words):
    """Return a room with patches of berries and agents that eat 0.5 at a time, see and walk."""
    agent = kind("agent", consume("berries", {"food": 0.5}), go_to("berries", 0.5), count=agents, sees=("berries",))
    berries = Resource(**{"name": "berries", "count": count, "radius": 0.5, "stock": 1.0, **words})
    other = Resource(name="stone", position=(7.5, 7.5))
    return square(agent, resources=(other, berries))


def test_every_patch_has_a_stock_and_a_place_of_its_own():
    """Patches are scattered apart; what is eaten of one is missing in that one alone."""
    env = start(patches(3, agents=2))
    places = env.state_view.resource_position
    assert places.shape == (4, 2)
    assert len(np.unique(places, axis=0)) == 4
    places = [[7.5, 7.5], [1.0, 1.0], [4.0, 4.0], [6.0, 1.0]]
    env.set_state(resource_position=places, position=[[4.2, 4.0], [6.0, 1.0]], internal=[[0.0], [0.0]])
    env.step_arrays(ask(env, agent="consume_berries"))
    assert env.state_view.stock[1:].tolist() == [1.0, 0.5, 0.5]
    assert env.state_view.eaten[1:].tolist() == [0.0, 0.5, 0.5]


def test_the_nearest_patch_with_something_in_it_is_eaten_and_gone_to():
    """Of two circles one stands in, the nearer; when it is empty, the other; then the walk leads to the third."""
    env = start(patches(3))
    places = [[7.5, 7.5], [4.3, 4.0], [4.0, 4.4], [4.0, 6.0]]
    env.set_state(resource_position=places, position=[[4.0, 4.0]], internal=[[0.0]], heading=[0.0])
    left = []
    for _ in range(4):
        env.step_arrays(ask(env, agent="consume_berries"))
        left.append(env.state_view.stock[1:].tolist())
    assert left == [[0.5, 1.0, 1.0], [0.0, 1.0, 1.0], [0.0, 0.5, 1.0], [0.0, 0.0, 1.0]]
    tick = env.step_arrays(ask(env, agent="go_to_berries"))
    assert not tick.closed[0]
    assert env.state_view.bound_for[0] == 3
    assert env.state_view.position[0] == pytest.approx([4.0, 4.5])


def test_what_is_seen_of_a_kind_is_its_nearest_patch():
    """Distance, bearing and fullness are those of the nearest patch with something in it, or of nothing."""
    env = start(patches(2, stock=2.0, capacity=4.0, growth=Growth(rate=1e-9)))
    names = env.groups["agent"].layout.names
    put = {"position": [[4.0, 4.0]], "heading": [math.pi / 2]}
    for stock, seen in (
        ([2.0, 1.0], (1.0, -math.pi / 2, 0.5)),
        ([0.0, 1.0], (3.0, math.pi / 2, 0.25)),
        ([0.0, 0.0], (math.hypot(8, 8), 0.0, 0.0)),
    ):
        tick = env.set_state(
            resource_position=[[7.5, 7.5], [5.0, 4.0], [1.0, 4.0]],
            stock=[math.inf, *stock],
            available=[True] * 3,
            **put,
        )
        zeta = dict(zip(names, tick.observations["agent"][0], strict=True))
        found = tuple(zeta[f"berries_{what}"] for what in ("distance", "bearing", "fullness"))
        assert found == pytest.approx(seen, abs=1e-6)


def test_patches_share_grow_and_relocate_each_by_itself():
    """Two at one patch share it while a third has another for itself; only the empty one relocates, full again."""
    env = start(patches(2, agents=3, motion=Relocation()))
    places = [[7.5, 7.5], [2.0, 2.0], [6.0, 2.0]]
    env.set_state(resource_position=places, position=[[2.0, 2.1], [2.1, 2.0], [6.0, 2.0]], internal=[[0.0]] * 3)
    env.set_state(stock=[math.inf, 0.6, 1.0])
    env.step_arrays(ask(env, agent="consume_berries"))
    state = env.state_view
    assert state.internal[:, 0] == pytest.approx([0.3, 0.3, 0.5])
    assert state.stock[1:].tolist() == [1.0, 0.5]
    assert state.resource_position[2].tolist() == [6.0, 2.0]
    assert state.resource_position[1].tolist() != [2.0, 2.0]
