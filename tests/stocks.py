"""Worlds around stocks."""

import numpy as np

import ecology
from ecology import (
    Arena,
    Drift,
    Growth,
    Need,
    Oscillation,
    Relocation,
    Resource,
    Scenario,
    Season,
    Species,
    consume,
    go_to,
    move,
    rest,
    turn,
)

SIDE = 4.0


SQUARE = Arena(vertices=((0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)))


HOOK = Arena(vertices=((0, 0), (4, 0), (4, 1), (1, 1), (1, 4), (0, 4)))


FOOD = Need(name="food", set_point=2.0, start=1.0)


CORNERS = np.array(SQUARE.vertices, float)


def berries(**words):
    """Return a resource in the middle that reaches all of the room, but for `words`."""
    return Resource(**{"name": "berries", "position": (2.0, 2.0), "radius": 3.0, **words})


def world(*resources, arena=SQUARE, dt=1.0, needs=(FOOD,), intake=None, count=1, more=(), **words):
    """Return the world of one species that eats `intake` of the first resource."""
    first = resources[0].name
    acts = (rest(), consume(first, intake or {"food": 0.1}), go_to(first, 0.1), *more)
    species = Species(**{"name": "agent", "needs": needs, "actions": acts, "count": count, **words})
    return ecology.parallel_env(Scenario(name="room", arena=arena, resources=resources, species=(species,), dt=dt))


def eat(env, ticks=1):
    """Make everyone consume for some ticks and return the last tick."""
    for _ in range(ticks):
        tick = env.step_arrays(np.ones(env.size, np.int64))
    return tick


def idle(env, ticks=1):
    """Make everyone rest for some ticks and return the last tick."""
    for _ in range(ticks):
        tick = env.step_arrays(np.zeros(env.size, np.int64))
    return tick


def crowd(dt=1.0):
    """Return a crowded room in which everything happens: 30 hungry agents, 4 kinds of stock, deaths."""
    needs = (
        Need(name="food", set_point=2.0, start=1.0, decay=0.05, bounds=(0.0, 4.0), lethal=True),
        Need(name="water", set_point=1.0, leak=0.02, proportional=True, bounds=(0.1, 1.5)),
        Need(name="fatigue", set_point=0.0, decay=-0.01, noise=0.05, bounds=(0.0, 3.0)),
    )
    stocks = (
        Resource(name="pool", position=(1.0, 1.0), radius=1.0, stock=9.0, growth=Growth(kind="logistic", rate=0.1)),
        Resource(name="grass", radius=1.0, stock=1.0, growth=Growth(rate=0.2), motion=Drift(spread=0.1)),
        Resource(name="prey", radius=1.0, stock=0.7, motion=Relocation(), availability=0.7),
        Resource(name="spring", position=(1.0, 3.0), radius=1.0, motion=Oscillation(to=(3.0, 3.0), period=40.0)),
        Resource(
            name="moss",
            position=(3.0, 1.0),
            radius=1.0,
            stock=0.0,
            capacity=5.0,
            growth=Growth(rate=0.5, season=Season(amplitude=1.0, period=25.0)),
        ),
    )
    actions = (
        rest(),
        move("walk", 0.2, control={"fatigue": 0.02}),
        turn("turn", 1.0),
        *(
            consume(r.name, {"food": 0.15, "water": 0.1 * i, "fatigue": 0.01}, closes_at={"food": 3.5})
            for i, r in enumerate(stocks)
        ),
        *(go_to(r.name, 0.2) for r in stocks),
    )
    species = Species(name="agent", needs=needs, actions=actions, count=30, radius=0.05)
    return ecology.parallel_env(Scenario(name="crowd", arena=SQUARE, resources=stocks, species=(species,), dt=dt))
