"""Lotka and Volterra's assumptions as a world: no learning, no walls, and all bodies moved at random in every tick.

Per head and unit of time prey reproduce at `growth` (alpha) and predators die at `mortality` (gamma). A
predator bites the prey in its reach r, and every kill becomes a predator. With N prey and P predators

    dN/dt = alpha N - beta N P,    dP/dt = beta N P - gamma P,    beta = pi r^2 / (area dt),

with the equilibrium N = gamma / beta and P = alpha / beta. The arena has the area at which N is `prey` there. That
two things can happen to one body in a tick moves the equilibrium by about the share growth dt + mortality dt.
"""

from __future__ import annotations

import math

import numpy as np

from ecology import Arena, Birth, Hazard, Need, Outcome, Scenario, Species, World, bite, rest

REACH = 1.0  # r, length; of bodies too: a newborn, two radii from its parent, is in the reach of other bodies than it
AT_ONCE = 100.0  # rate at which a birth that is due does not wait, per unit of time
ROOM = 3  # slots per body at rest: far more than are taken


def build(
    prey: int = 100,
    growth: float = 0.02,
    mortality: float = 0.02,
    culling: float = 0.0,
    displacement: float = 1.2,
    dt: float = 1.0,
    ticks: int = 2_000,
) -> Scenario:
    """Return the world; `displacement` is the number of prey at the start over that of the equilibrium without culling.

    `culling` is an extra mortality of prey and predators alike, per unit of time.
    """
    predators = round(prey * growth / mortality)  # at rest
    side = math.sqrt(math.pi * REACH**2 * prey / (mortality * dt))

    def scatter(world: World, rng: np.random.Generator) -> Outcome:
        """Put everybody alive anywhere."""
        outcome, state = world.no_effect(), world.state
        anywhere = side * rng.random(state.position.shape)
        outcome.position = np.where(state.alive[:, None], anywhere, state.position)
        return outcome

    hunted = Species(
        name="prey",
        needs=(Need(name="ease", set_point=1.0),),
        actions=(rest(),),
        count=round(prey * displacement),
        capacity=ROOM * prey,
        birth=Birth(rate=growth),
        hazard=Hazard(rate=culling),
        radius=REACH,
        solid=False,
        senses=(),
        learner="rest",
    )
    hunter = Species(
        name="predator",
        needs=(Need(name="meals", set_point=0.0),),
        actions=(
            rest(closes_at={"meals": 0.0}),  # open only where nothing else is: who can bite bites
            bite("prey", reach=REACH, gain={"meals": 1.0}),
        ),
        count=predators,
        capacity=ROOM * predators,
        birth=Birth(rate=AT_ONCE, threshold={"meals": 1.0}, cost={"meals": 1.0}),
        hazard=Hazard(rate=mortality + culling),
        radius=REACH,
        solid=False,
        senses=(),
        learner="rest",
    )
    torus = Arena(vertices=((0, 0), (side, 0), (side, side), (0, side)), walls=False)
    return Scenario(name="well_mixed", arena=torus, species=(hunted, hunter), rule=scatter, dt=dt, ticks=ticks)
