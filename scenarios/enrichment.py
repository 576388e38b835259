"""The paradox of enrichment: a richer world makes prey and predators cycle (Rosenzweig and MacArthur).

Prey N reproduce at r (1 - N / K) per head. A predator finds prey at the rate a and handles each for the time h. Every
prey taken yields e newborn predators; predators die at m:

    dN/dt = r N (1 - N / K) - a N P / (1 + a h N),    dP/dt = e a N P / (1 + a h N) - m P

The equilibrium N = m / (a (e - m h)) is stable up to K_c = (e + m h) / (a h (e - m h)), with a limit cycle above it.
All agents are placed at random in every tick, as the equations assume. With `hungry`, predators have a reason to hunt,
which learners need: energy that a kill gives. Numbers are `scale` times those of the equations
with a = .001, h = 10, e = .5, m = .015: the larger `scale`, the smaller the role of chance.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ecology import Arena, Birth, Hazard, Need, Outcome, Scenario, Species, World, bite, rest

FINDS, HANDLES, BORN, DIES = 0.001, 10.0, 0.5, 0.015  # a, h, e, m
REACH = 1.0  # length
HUNGER = 0.005  # energy that predators lose per unit of time; a kill gives 1
N_REST = DIES / (FINDS * (BORN - DIES * HANDLES))
K_CRITICAL = (BORN + DIES * HANDLES) / (FINDS * HANDLES * (BORN - DIES * HANDLES))


def p_rest(capacity: float, growth: float) -> float:
    """Return the number of predators at equilibrium, from the equations."""
    return growth / FINDS * (1 - N_REST / capacity) * (1 + FINDS * HANDLES * N_REST)


def build(
    capacity: float = 150.0,
    growth: float = 0.05,
    scale: float = 4.0,
    dt: float = 0.5,
    hungry: bool = False,
    ticks: int = 6_000,
) -> Scenario:
    """Return the world; `capacity` is K and `growth` r of the equations, `hungry` lets predators gain by a kill."""
    side = math.sqrt(scale * math.pi * REACH**2 / (FINDS * dt))
    predators = max(round(scale * p_rest(max(capacity, 1.2 * N_REST), growth)), 1)

    def rule(world: World, rng: np.random.Generator) -> Outcome:
        """Place all living agents at random, and let a predator be born of a share e of the kills."""
        outcome, state = world.no_effect(), world.state
        anywhere = side * rng.random(state.position.shape)
        outcome.position = np.where(state.alive[:, None], anywhere, state.position)
        killers = np.flatnonzero(state.bit >= 0)
        bearing = killers[rng.random(len(killers)) < BORN]
        outcome.births = {"predator": side * rng.random((len(bearing), 2))}
        outcome.parents = {"predator": bearing}
        return outcome

    ease = Need(name="ease", set_point=1.0)
    energy = Need(name="energy", set_point=10.0, start=5.0, decay=HUNGER, bounds=(0.0, math.inf))
    common: dict[str, Any] = {
        "radius": REACH,
        "solid": False,
        "senses": (),
    }
    prey = Species(
        name="prey",
        needs=(ease,),
        actions=(rest(),),
        count=round(scale * N_REST * 1.1),
        capacity=round(scale * capacity * 1.1),
        birth=Birth(rate=growth, limit=scale * capacity),
        learner="rest",
        **common,
    )
    predator = Species(
        name="predator",
        needs=(energy if hungry else ease,),
        actions=(rest(), bite("prey", reach=REACH, duration=HANDLES, gain={"energy": 1.0} if hungry else {})),
        count=predators,
        capacity=5 * predators,
        birth=Birth(rate=0.0),
        hazard=Hazard(rate=DIES),
        learner="greedy",
        **common,
    )
    torus = Arena(vertices=((0, 0), (side, 0), (side, side), (0, side)), walls=False)
    return Scenario(name="enrichment", arena=torus, species=(prey, predator), rule=rule, dt=dt, ticks=ticks)
