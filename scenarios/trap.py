"""Two foragers and rare accidents that trap one of them: it starves unless the other brings food.

Trap of Man and Yoshida (2024): the plane [-1, 1]^2, steps of 0.15, one piece of food that is somewhere else once
it is picked up. Here x = 1 + the original's energy e, so that the set point is 1, the drive is e^2 (their
reward is 100 times its decrease), accidents leave x at 0.3, below that no agent moves, and death comes below 0. What
differs: one more action, rest; an agent that holds food cannot pick up another; both act on the state at the tick's
start, while in the original the first acts before the second. The first tick of a life draws energies and places; a
life is counted from the second.
"""

from __future__ import annotations

import math

import numpy as np

from ecology import (
    Arena,
    Empathy,
    Need,
    Neighbours,
    Outcome,
    Relocation,
    Resource,
    Scenario,
    Species,
    State,
    World,
    act,
    consume,
    rest,
)
from ecology.scenarios.shared.conditions import LEARNER, empathy, square

STEP, REACH, HAND = 0.15, 0.3, 0.4  # lengths: of a move, to the food, to the other
WAYS = {"left": (-1, 0), "right": (1, 0), "up": (0, 1), "down": (0, -1)}
LOSS, MEAL = 0.001, 0.3  # of energy per tick; gain of one food eaten
ACCIDENT, TRAPPED = 0.0005, 0.3  # probability per agent and tick; x after it, and from which one moves
SPREAD, NEAR = 0.2, 0.1  # half widths of the energies and of the places at the start
CAP = 5000  # ticks of a life at most, in the original
REWARD = 100.0  # the original's reward per fall of the drive


def rule(world: World, rng: np.random.Generator) -> Outcome:
    """Move both, trap one now and then, hand food over; who is left alone dies too."""
    outcome, state = world.no_effect(), world.state
    x, carried = state.internal.T
    drawn, place = rng.uniform(-1, 1, (2, 3)), state.position.copy()
    if state.age[0] == 0:
        outcome.received[:, 0], outcome.given[:, 0] = 1.0 + SPREAD * drawn[:, 0] + LOSS * world.dt, x
        outcome.position = NEAR * drawn[:, 1:]
        return outcome
    for name, way in WAYS.items():
        after = place + STEP * np.outer(world.does("agent", name), way)
        place = np.where(np.abs(after) < 1, after, place)
    outcome.position = place
    accident = (rng.random(2) < ACCIDENT) & (x > TRAPPED).any()
    outcome.received[:, 0] = accident * np.maximum(TRAPPED - x, 0)
    outcome.given[:, 0] = accident * np.maximum(x - TRAPPED, 0)
    # food in hand: one that both reach for at once is the first one's
    both = world.does("agent", "consume_food").all() * np.array([0.5, -0.5])
    close = np.hypot(*(state.position[0] - state.position[1])) < HAND
    passes = (world.does("agent", "pass") & close & (carried[::-1] == 0)).astype(float)
    change = both - passes + passes[::-1]
    outcome.received[:, 1], outcome.given[:, 1] = np.maximum(change, 0), np.maximum(-change, 0)
    outcome.killed[:] = not state.alive.all()
    return outcome


def props(state: State) -> dict[str, list[list[tuple[float, float]]]]:
    """Return the lines to draw: the reach of the feet, food in hand, and bars before a trapped agent."""
    living = [i for i in range(len(state.alive)) if state.alive[i]]
    trapped = [i for i in living if state.internal[i, 0] < TRAPPED]
    bars = [-0.08, -0.03, 0.03, 0.08]
    return {
        "reach": [square((0.0, 0.0), 1.0)],
        "food in hand": [square(state.position[i] + (0.0, 0.1), 0.03) for i in living if state.internal[i, 1] > 0],
        "trap": [
            *(square(state.position[i], 0.1) for i in trapped),
            *([(x + d, y - 0.1), (x + d, y + 0.1)] for i in trapped for x, y in [state.position[i]] for d in bars),
        ],
    }


def build(
    condition: str = "full",
    weight: float = 0.5,
    perceived: bool = True,
    ticks: int = 60_000,
    until_extinct: bool = True,
) -> Scenario:
    """Return the set-up under one condition of empathy; the settings are those of `food_share`."""
    cognitive, affective = empathy(condition)
    has_food, moves = {"opens_from": {"carried": 1.0}}, {"opens_from": {"energy": TRAPPED}}
    agent = Species(
        name="agent",
        count=2,
        needs=(
            Need(name="energy", set_point=1.0, decay=LOSS, bounds=(0.0, math.inf), lethal=True),
            Need(name="carried", set_point=1.0, start=0.0, bounds=(0.0, 1.0), regulated=False),
        ),
        actions=(
            rest(),
            *(act(way, **moves) for way in WAYS),
            consume("food", {"carried": 1.0}, closes_at={"carried": 1.0}),  # their "get"
            act("eat", control={"energy": MEAL, "carried": -1.0}, **has_food),
            act("pass", **has_food),
        ),
        position=(0.0, 0.0),
        heading=0.0,
        senses=("position",),
        sees=("food",),
        neighbours=(Neighbours(),),  # where the other is, always; how it is, in cognitive empathy
        opens=("energy",) if cognitive else (),
        empathy=Empathy(weight=weight, perceived=perceived) if affective else None,
        solid=False,
        drive_epsilon=1e-12,
        drive_exponent=2.0,
        learner_settings={
            **LEARNER,
            "gamma": 0.97,
            "youth": 4000.0,
            "place_cells": 32,
            "place_spacing": 0.3,
            "place_width": 0.25,
        },
    )
    field = Arena(vertices=((-1.3, -1.3), (1.3, -1.3), (1.3, 1.3), (-1.3, 1.3)))  # food lies within [-1, 1]^2
    food = Resource(name="food", position=(0.0, 0.0), radius=REACH, stock=1.0, motion=Relocation())
    return Scenario(
        name="trap",
        arena=field,
        resources=(food,),
        species=(agent,),
        ticks=ticks,
        rule=rule,
        props=props,
        sample_every=5,
        until_extinct=until_extinct,
    )
