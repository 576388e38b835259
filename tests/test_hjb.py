"""The f/J learner: its parts against plain versions, and what it learns against known answers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import agents
import scenarios
from agents import loop
from agents.base import DivergedError
from agents.hjb import ALGORITHM1, HJB
from agents.memory import Memory
from agents.movements import adaptive, single_ticks
from agents.networks import Adam, Perceptrons
from ecology import Arena, Ecology, EcologyError, Need, Resource, Scenario, Species, consume, move, rest

SEED = np.random.SeedSequence(3)
SMALL = {"width": 24, "batch": 32, "batch_f": 32, "place_cells": 16, "memory": 500}


def toy(**words: object) -> Scenario:
    """Return a room where food is within reach everywhere: one need, eat or rest, nothing else to sense."""
    need = Need(name="energy", set_point=2.0, decay=0.02, bounds=(0.0, 4.0))
    species = Species(
        name="eater",
        needs=(need,),
        actions=(rest(), consume("food", {"energy": 0.1}, closes_at={"energy": 4.0})),
        senses=(),
        position=(1.0, 1.0),
        heading=0.0,
        **words,  # type: ignore[arg-type]
    )
    room = Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2)))
    food = Resource(name="food", position=(1.0, 1.0), radius=3.0)
    return Scenario(name="toy", arena=room, resources=(food,), species=(species,))


def best_deviation(gamma: float, holds: dict[str, int], grid: np.ndarray) -> np.ndarray:
    """Return -ln(gamma) J* of the toy on a grid of x by value iteration, movements held as the learner holds them.

    The discounted drive within a movement is summed tick by tick (trapezoid), not by its ends.
    """

    def step(x: np.ndarray, eats: bool) -> np.ndarray:
        return np.clip(x + (0.1 * eats - 0.02), 0.0, 4.0)

    def drive(x: np.ndarray) -> np.ndarray:
        return np.sqrt(0.001 + (x - 2.0) ** 2)

    paths = []
    for action, ticks in holds.items():
        x, cost = grid, np.zeros_like(grid)
        for k in range(ticks):
            after = step(x, action == "consume_food")
            cost += gamma**k * (1 - gamma) * 0.5 * (drive(x) + drive(after))
            x = after
        paths.append((x, cost, gamma**ticks))
    value = np.full_like(grid, 1.0)
    for _ in range(4000):
        value = np.min([cost + keep * np.interp(x, grid, value) for x, cost, keep in paths], axis=0)
    return value


def test_learned_deviation_function_converges_to_the_best_one() -> None:
    """In a world small enough for value iteration, -ln(gamma) J comes within 5 % of J* all over its range."""
    scenario = toy()
    env = Ecology(scenario)
    group = env.groups["eater"]
    settings = {"gamma": 0.97, "life": 8_000.0, "width": 32, "pause": 3.0, "meal": 2.0, "update_every": 1.0}
    learner = agents.make("hjb", group, SEED, settings)
    loop.run(env, {"eater": learner}, env.reset_arrays(0), 8_000)
    grid = np.linspace(0.0, 4.0, 801)
    best = best_deviation(0.97, {"rest": 3, "consume_food": 2}, grid)
    lived = (grid > 0.2) & (grid < 2.8)  # where needs are imagined: -x* to 0.4 x*
    learned = learner.deviation(0, (grid[lived] - 2.0)[:, None])
    error = np.abs(learned - best[lived])
    assert best[lived].max() > 5 * best[lived].min()  # there is something to learn
    assert error.mean() < 0.05 * best[lived].mean()


def test_it_walks_to_the_food_from_either_side() -> None:
    """In a corridor with food in the middle, a hungry agent's best movement leads to it from both ends."""
    species = Species(
        name="walker",
        needs=(Need(name="energy", set_point=2.0, decay=0.01, bounds=(0.0, 4.0)),),
        actions=(
            rest(),
            move("east", 0.1, direction=0.0),
            move("west", 0.1, direction=math.pi),
            consume("food", {"energy": 0.1}, closes_at={"energy": 4.0}),
        ),
        senses=("position",),
        heading=0.0,
    )
    scenario = Scenario(
        name="corridor",
        arena=Arena(vertices=((0, 0), (6, 0), (6, 1), (0, 1))),
        resources=(Resource(name="food", position=(3.0, 0.5), radius=0.5),),
        species=(species,),
    )
    env = Ecology(scenario)
    learner = agents.make("hjb", env.groups["walker"], SEED, {"life": 8000.0, "update_every": 4.0, "gamma": 0.98})
    loop.run(env, {"walker": learner}, env.reset_arrays(1), 8000)
    learner.evaluating(0.0)
    chosen = {}
    for x in (0.6, 1.6, 4.4, 5.4):
        internal = np.array([[0.2]])
        tick = env.put(position=np.array([[x, 0.5]]), internal=internal)
        learner.begin()
        action = learner.act(tick.observations["walker"], tick.masks["walker"])[0]
        chosen[x] = env.groups["walker"].actions[action]
    assert chosen == {0.6: "east", 1.6: "east", 4.4: "west", 5.4: "west"}
