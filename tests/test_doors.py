"""Doors that open by time or by a rule: they stop bodies, sight and odours while they are closed, and only then."""

import numpy as np
import pytest
from worlds import ask, assert_refused, kind, square, start

from ecology import Arena, Door, EcologyError, Field, Resource, contract, move, parallel_env

WALLS = (((4.0, 0.0), (4.0, 3.0)), ((4.0, 5.0), (4.0, 8.0)))
DOOR = {"name": "door", "start": (4.0, 3.0), "end": (4.0, 5.0)}


def hall(rule=None, place=(3.0, 4.0), fields=(), count=1, **door):
    """Return two rooms with a door between them, a body in the left one and food in the right one."""
    arena = Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)), walls=WALLS, doors=(Door(**DOOR, **door),))
    species = kind("agent", move("east", 0.3, direction=0.0), position=place, sees=("food",), radius=0.2, count=count)
    return square(
        species, arena=arena, rule=rule, fields=fields, resources=(Resource(name="food", position=(7.0, 4.0)),)
    )


def lived(env, ticks, **wanted):
    """Let `ticks` pass and return the state."""
    for _ in range(ticks):
        env.step_arrays(ask(env, **wanted))
    return env.state_view


@pytest.mark.parametrize("is_open", [True, False])
def test_a_door_stops_bodies_and_sight_while_it_is_closed(is_open):
    """A body walks through an open door and sees through it; a closed one holds it back at its radius."""
    env = start(hall(open=is_open))
    assert env.state_view.seen.all() == is_open
    x = lived(env, 12, agent="east").position[0, 0]
    assert x == pytest.approx(3.0 + 12 * 0.3) if is_open else 3.7 < x < 3.85


def test_a_door_opens_by_time():
    """It is open in the first share of each period, whatever the tick, and bodies see through it then."""
    env = start(hall(period=10.0, open_for=0.3))
    seen = [bool(env.state_view.seen[0, 0])] + [bool(lived(env, 1).seen[0, 0]) for _ in range(19)]
    assert seen == ([True] * 3 + [False] * 7) * 2
    late = start(hall(period=10.0, open_for=0.3, phase=0.8))
    assert [bool(late.state_view.doors[0])] + [bool(lived(late, 1).doors[0]) for _ in range(5)] == [
        False, False, True, True, True, False,
    ]  # fmt: skip


def opener(world, rng):
    """Open the door in the third tick; close it in the sixth."""
    outcome = world.no_effect()
    if world.state.tick in (2, 5):
        outcome.doors["door"] = not world.doors["door"]
    return outcome


def test_a_rule_opens_and_closes_a_door():
    """From the tick that follows on, until it says otherwise."""
    env = start(hall(rule=opener))
    assert [bool(lived(env, 1).doors[0]) for _ in range(7)] == [False, False, True, True, True, False, False]


def test_a_door_waits_for_a_body_in_its_way():
    """It closes once the body has left; nobody is walled in."""
    env = start(hall(place=(4.0, 4.0), period=4.0, open_for=0.5))
    assert lived(env, 3).doors.all()
    assert lived(env, 1, agent="east").doors.all()
    state = lived(env, 1, agent="east")
    while state.tick % 4 < 2:
        state = lived(env, 1)
    assert not state.doors.any()


def test_an_odour_stays_behind_a_closed_door():
    """It flows through the open door alone."""
    smell = Field(name="smell", diffusion=0.2, sources={"agent": 1.0}, cells=16)
    through = {}
    for is_open in (True, False):
        env = start(hall(open=is_open, fields=(smell,)))
        grid = lived(env, 40).grid.reshape(16, 16)
        through[is_open] = grid[:, 8:].sum()
        assert grid.sum() * 0.25 == pytest.approx(40.0)
    assert through[True] > 1.0
    assert through[False] == 0.0


def test_a_world_with_doors_keeps_the_contract():
    """Bodies stay in, copies and snapshots go on, with the door open or closed."""
    scenario = hall(period=7.0, count=4, place=None)
    for holds in ("no body leaves the arena or goes through a wall", "a snapshot continues bit for bit",
                  "a copy continues bit for bit", "the same seed gives the same run"):  # fmt: skip
        contract.CHECKS[holds](scenario, 60)


def test_a_door_can_be_put_between_ticks():
    """`set_state` opens and closes doors, and walls follow at once."""
    env = start(hall())
    env.set_state(doors=np.array([True]))
    assert env.state_view.seen.all()
    assert lived(env, 4, agent="east").position[0, 0] == pytest.approx(4.2)
    twin = parallel_env(env.scenario)
    twin.restore(*env.snapshot())
    assert twin.state_view.doors.all()
    assert lived(twin, 2, agent="east").position[0, 0] == pytest.approx(4.8)


WRONG = {
    "a door without width": (lambda: Door(name="d", start=(1, 1), end=(1, 1)), ["starts and ends", "width"]),
    "a door of no name": (lambda: Door(name="a b", start=(1, 1), end=(1, 2)), ["'a b'", "word"]),
    "a share above 1": (lambda: hall(period=3.0, open_for=2.0), ["open_for", "2.0"]),
    "a period of 0": (lambda: hall(period=0.0), ["period", "positive"]),
    "a door outside": (
        lambda: Arena(vertices=((0, 0), (8, 0), (8, 8)), doors=(Door(name="d", start=(1, 5), end=(1, 6)),)),
        ["'d'", "outer walls"],
    ),
    "doors of a torus": (
        lambda: Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)), walls=False, doors=(Door(**DOOR),)),
        ["torus", "doors"],
    ),
    "two of one name": (
        lambda: Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)), doors=(Door(**DOOR), Door(**DOOR))),
        ["['door']", "twice"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_a_mistake_is_told(what):
    """The message names the rule and the value."""
    assert_refused(*WRONG[what])


def test_a_rule_that_opens_no_door_is_told():
    """The nearest name is said, and what the door is to be."""
    for doors, words in (({"dor": True}, "'dor'.*door"), ({"door": 1.0}, "open, True, or closed, False")):

        def rule(world, rng, doors=doors):
            outcome = world.no_effect()
            outcome.doors = doors
            return outcome

        env = start(hall(rule=rule))
        with pytest.raises(EcologyError, match=words):
            lived(env, 1)
