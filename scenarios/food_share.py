"""Food shared or eaten: one holds all the food, its partner starves unless its hunger is felt.

An exact copy of FoodShare (Man and Yoshida 2024). Energy is high or low, with the drives d(high) = -ln 0.95 and
d(low) = -ln 0.05. In every tick the possessor eats (its energy is high) or passes (its partner's is); an agent
that is not fed falls from high to low with probability 0.1. Both die when either has been low for ten ticks.
The first tick of a life draws whether each is high or low; a life is counted from the second.
"""

from __future__ import annotations

import math

import numpy as np

from ecology import Arena, Empathy, Need, Neighbours, Outcome, Scenario, Species, State, World, act, rest
from ecology.scenarios.shared.conditions import LEARNER, empathy, square

D_HIGH, D_LOW = -math.log(0.95), -math.log(0.05)  # drive at high and at low energy
HIGH = math.sqrt(D_LOW**2 - D_HIGH**2)  # x* of energy, so that x = x* and x = 0 have these drives
FALLS = 0.1  # probability that one who is not fed falls to low, per tick
LONGEST = 10  # ticks low in a row that kill
CAP = 2000  # ticks of a life at most, in the original
APART = 6.0  # length between pairs, which know nothing of each other


def rule(world: World, rng: np.random.Generator) -> Outcome:
    """Feed one of each pair, let the other fall; kill both when either was low for too long."""
    outcome, state = world.no_effect(), world.state
    possessor, partner = world.slots["possessor"], world.slots["partner"]
    x = state.internal
    energy, low = np.stack([x[possessor, 0], x[partner, 0]]), x[partner, 1:3].T  # (2, pairs)
    drawn, new = rng.random(energy.shape), state.age[possessor] == 0
    fed = np.stack([~world.does("possessor", "pass"), world.does("possessor", "pass")])
    after = np.where(fed, HIGH, np.where(drawn < FALLS, 0.0, energy))
    after = np.where(new, np.where(drawn < 0.5, 0.0, HIGH), after)
    count = np.where(new | (after > 0), 0, low + 1)
    change = -x
    change[possessor, 0] += after[0]
    change[partner, :3] += np.column_stack([after[1], *count])
    outcome.received, outcome.given = np.maximum(change, 0), np.maximum(-change, 0)
    outcome.killed[possessor] = outcome.killed[partner] = count.max(axis=0) >= LONGEST
    outcome.position = np.full(state.position.shape, 0.5)
    outcome.position[possessor, 0] = 1.0 + APART * np.arange(len(new))
    outcome.position[partner, 0] = 2.0 + APART * np.arange(len(new))
    return outcome


def props(state: State) -> dict[str, list[list[tuple[float, float]]]]:
    """Return the lines to draw: food in the hand of every living possessor, and the path along which it is passed."""
    pairs = len(state.alive) // 2
    hands = [i for i in range(pairs) if state.alive[i]]
    return {
        "food in hand": [square(state.position[i] + (0.0, 0.16), 0.05) for i in hands],
        "table": [[tuple(state.position[i]), tuple(state.position[pairs + i])] for i in hands],
    }


def build(
    condition: str = "full",
    weight: float = 0.5,
    perceived: bool = True,
    pairs: int = 1,
    ticks: int = 5_000,
    until_extinct: bool = True,
) -> Scenario:
    """Return the set-up under one condition of empathy: "none", "cognitive", "affective" or "full".

    Cognitive: the partner's energy is perceived. Affective: `weight` times its drive is added to the agent's own.
    `perceived` False leaves what is felt out of zeta, as in the original, where the reward alone tells; f/J
    know their drive from zeta and cannot learn what it hides.
    """
    cognitive, affective = empathy(condition)
    energy = Need(name="energy", set_point=HIGH, bounds=(0.0, HIGH))
    counts = (Need(name=f"{who}_low", set_point=0.0, bounds=(0.0, LONGEST), regulated=False) for who in ("its", "own"))
    possessor = Species(
        name="possessor",
        count=pairs,
        needs=(energy,),
        actions=(rest("eat"), act("pass")),  # who does nothing eats
        position=(1.0, 0.5),
        heading=0.0,
        senses=(),
        view_range=2.0,
        neighbours=(Neighbours(species=("partner",)),) if cognitive else (),
        empathy=Empathy(weight=weight, species=("partner",), within=2.0, perceived=perceived) if affective else None,
        solid=False,
        drive_epsilon=D_HIGH**2,
        learner_settings=LEARNER,
    )
    partner = Species(
        name="partner",
        count=pairs,
        needs=(energy, *counts),  # it carries both counts, which nobody perceives who acts
        actions=(rest(),),
        position=(2.0, 0.5),
        heading=0.0,
        senses=(),
        opens=("energy",),
        solid=False,
        drive_epsilon=D_HIGH**2,
        learner="rest",
    )
    wide = APART * pairs
    room = Arena(vertices=((0, 0), (wide, 0), (wide, 1), (0, 1)))
    return Scenario(
        name="food_share",
        arena=room,
        species=(possessor, partner),
        ticks=ticks,
        rule=rule,
        props=props,
        sample_every=1,
        until_extinct=until_extinct,
    )
