"""Meals by chance and by stock, compartments, actions that drain or wait for a cue, the limit of births."""

import math

import numpy as np
import pytest
from worlds import ask, kind, square, start

from ecology import (
    Birth,
    Cue,
    EcologyError,
    Event,
    Exposure,
    Field,
    Need,
    Resource,
    act,
    bite,
    consume,
    give,
    move,
    rest,
)

MIDDLE = (4.0, 4.0)
FOOD = Need(name="food", set_point=100.0, start=0.0, bounds=(0.0, 1000.0))


def eater(*acts, resource=None, **words):
    """Return a world of 400 bodies of one need that stand in the circle of one food."""
    species = kind("eater", *acts, needs=(FOOD,), position=MIDDLE, count=words.pop("count", 400), radius=0.1)
    return square(species, resources=(resource or Resource(name="dish", position=MIDDLE, radius=1.0),), **words)


@pytest.mark.parametrize("dt", [0.5, 1.0])
def test_a_risky_meal_succeeds_with_its_chance(dt):
    """Its mean intake is u chance, its standard deviation that of a coin; a tick of dt has 1 - (1 - chance)^dt."""
    env = start(eater(consume("dish", {"food": 1.0}, chance=0.3), dt=dt))
    for _ in range(50):
        env.step_arrays(ask(env, eater="consume_dish"))
    got, p = env.state_view.internal[:, 0] / dt, 1 - (1 - 0.3) ** dt
    assert got.mean() == pytest.approx(50 * p, abs=4 * math.sqrt(50 * p * (1 - p) / len(got)))
    assert got.std() == pytest.approx(math.sqrt(50 * p * (1 - p)), rel=0.2)
    assert np.allclose(env.state_view.internal, env.state_view.ingested)


def test_a_meal_that_fails_leaves_the_stock():
    """What leaves a finite stock is what was ingested, and a meal without luck costs nothing but its other controls."""
    dish = Resource(name="dish", position=MIDDLE, radius=1.0, stock=1e6)
    env = start(eater(consume("dish", {"food": 1.0}, chance=0.5), resource=dish))
    env.step_arrays(ask(env, eater="consume_dish"))
    now = env.state_view
    assert set(np.unique(now.internal)) == {0.0, 1.0}
    assert now.stock[0] == 1e6 - now.internal.sum()


def test_a_meal_by_stock_gains_less_and_less():
    """Alone in a patch of A it has A (1 - (1 - l)^t) after t ticks; with a full patch it asks for l A."""
    dish = Resource(name="dish", position=MIDDLE, radius=1.0, stock=80.0)
    env = start(eater(consume("dish", {"food": 4.0}, by_stock=True), resource=dish, count=1))
    got = []
    for _ in range(30):
        env.step_arrays(ask(env, eater="consume_dish"))
        got.append(env.state_view.internal[0, 0])
    assert got == pytest.approx(80 * (1 - 0.95 ** np.arange(1, 31)))
    assert env.state_view.stock[0] == pytest.approx(80 - got[-1])


def test_compartments_hand_on_what_leaks_out_of_them():
    """A gut empties into the blood, which the kidneys empty: Bateman's two exponentials, but for the Euler step."""
    gut = Need(name="gut", set_point=0.0, start=10.0, leak=0.04, regulated=False, feeds={"blood": 0.5})
    blood = Need(name="blood", set_point=0.0, leak=0.01)
    env = start(square(kind("body", needs=(blood, gut)), dt=0.1))
    for _ in range(600):
        env.step_arrays(ask(env, body="rest"))
    t = 60.0
    expected = 0.5 * 10.0 * 0.04 / (0.01 - 0.04) * (math.exp(-0.04 * t) - math.exp(-0.01 * t))
    assert env.state_view.internal[0] == pytest.approx([expected, 10 * math.exp(-0.04 * t)], rel=5e-3)


def test_an_action_waits_for_its_cue():
    """It is open while the cue is shown and at no other time; the rest is always open."""
    species = kind("rat", act("press", cue="light"), cues=("light",))
    lit = (Event(do="show light on", at=3.0), Event(do="show light off", at=5.0))
    env = start(square(species, cues=(Cue(name="light"),), schedule=lit))
    press, found = env.groups["rat"].actions.index("press"), []
    for _ in range(7):
        tick = env.step_arrays(ask(env, rat="rest"))
        found.append(bool(tick.masks["rat"][0, press]))
    assert found == [False, False, True, True, False, False, False]
    assert env.step_arrays(ask(env, rat="press")).closed[0]


@pytest.mark.parametrize(("limit", "most"), [(50.0, 50), (math.inf, 200)])
def test_births_stop_at_their_limit(limit, most):
    """Numbers grow as n' = r n (1 - n / K) and end at K; without a limit the slots end it."""
    species = kind("cell", count=10, capacity=200, birth=Birth(rate=0.05, limit=limit))
    env = start(square(species, side=60.0))
    counts = []
    for _ in range(300):
        env.step_arrays(ask(env, cell="rest"))
        counts.append(env.state_view.alive.sum())
    assert counts[-1] == most
    if limit < math.inf:
        half = np.flatnonzero(np.array(counts) >= limit / 2)[0] + 1
        assert half == pytest.approx(math.log(4) / math.log1p(0.05), rel=0.5)  # (K - 10) / 10 = e^{rt}


def test_a_field_is_changed_between_ticks():
    """The schedule can change the number that a field has everywhere."""
    species = kind(exposures=(Exposure(field="heat", control={"food": 0.1}),), needs=(FOOD,))
    hot = Event(do="change heat.values 4", at=2.0)
    env = start(square(species, fields=(Field(name="heat", values=1.0),), schedule=(hot,)))
    warmed = [env.step_arrays(ask(env, agent="rest")) and env.state_view.internal[0, 0] for _ in range(4)]
    assert warmed == pytest.approx([0.1, 0.2, 0.6, 1.0])
    with pytest.raises(EcologyError, match="heta"):
        square(kind(), fields=(Field(name="heat", values=1.0),), schedule=(Event(do="change heta.values 4"),))


@pytest.mark.parametrize(
    ("make", "rule"),
    [
        (lambda: move("walk", 0.1, chance=0.5), "a move always succeeds"),
        (lambda: give("agent", {"food": 0.1}, reach=1.0, by_stock=True), "by_stock is of consume"),
        (lambda: rest(cue="light"), "waits for no cue"),
        (lambda: square(kind("rat", act("press", cue="light"))), "waits for the cue 'light'"),
        (lambda: eater(consume("dish", {"food": 1.0}, by_stock=True)), "has no end"),
        (lambda: Birth(rate=0.1, limit=0.0), "limit must be positive"),
        (lambda: Need(name="gut", set_point=0.0, feeds={"blood": 1.0}), "give it a leak"),
        (lambda: Need(name="gut", set_point=0.0, leak=0.1, feeds={"gut": 1.0}), "feeds itself"),
        (
            lambda: square(kind(needs=(Need(name="gut", set_point=0.0, leak=0.1, feeds={"blod": 1.0}),))),
            "the need 'blod'",
        ),
        (lambda: bite("agent", reach=1.0, chance=1.5), "from 0 to 1"),
    ],
)
def test_mistakes_are_told(make, rule):
    """What cannot be is refused with the rule and the value."""
    with pytest.raises(EcologyError, match=rule):
        make()
