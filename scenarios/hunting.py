"""Number of prey that a hunter takes, by the density of prey: Holling's disc equation (1959).

Prey of density N are searched for at the rate a = 2 R v, reach times speed, and each takes the time h to handle:
a hunter takes f = a N / (1 + a h N) per unit of time. A bitten prey is moved elsewhere, so the density stays the same.
Prey do not move, and hunters walk straight on through a square without walls.
"""

from __future__ import annotations

import math

import numpy as np

from ecology import Arena, Need, Neighbours, Outcome, Scenario, Species, World, bite, move, rest, turn

SIDE, REACH, WALK = 20.0, 0.1, 0.1  # lengths, and length per unit of time
NEAR = 3.0  # how far hunters see, length


def scatter(world: World, rng: np.random.Generator) -> Outcome:
    """Move bitten prey to random places."""
    outcome, state = world.no_effect(), world.state
    bitten = state.bit[state.bit >= 0]
    if bitten.size:
        outcome.position = state.position.copy()
        outcome.position[bitten] = SIDE * rng.random((len(bitten), 2))
    return outcome


def build(
    density: float = 1.0, handling: float = 60.0, hunters: int = 20, sight: float = NEAR, ticks: int = 5_000
) -> Scenario:
    """Return the square; `density` is prey per unit of area, `handling` h in units of time, `sight` a length."""
    prey = Species(
        name="prey",
        needs=(Need(name="ease", set_point=1.0),),
        actions=(rest(),),
        count=max(round(density * SIDE**2), 1),
        solid=False,
        senses=(),
        learner="rest",
    )
    hunter = Species(
        name="hunter",
        needs=(Need(name="energy", set_point=10.0, start=5.0, decay=0.005, bounds=(0.0, math.inf)),),
        actions=(
            rest(),
            bite("prey", reach=REACH, damage={}, gain={"energy": 1.0}, duration=handling),
            move("walk", WALK),
            turn("turn_left", math.pi / 4),
            turn("turn_right", -math.pi / 4),
        ),
        count=hunters,
        solid=False,
        view_range=sight,
        senses=(),
        neighbours=(Neighbours(species=("prey",)),),
        learner="lean",
    )
    torus = Arena(vertices=((0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)), walls=False)
    return Scenario(name="hunting", arena=torus, species=(prey, hunter), rule=scatter, ticks=ticks)
