"""When to leave a patch: it yields less and less, and the next one is a walk away.

A patch of A units gives A (1 - exp(-l t)) to an agent that eats there for a time t, and is full again when the agent
has left it. The other patch is `travel` away. Charnov's marginal value theorem (1976): the rate of intake is highest
for an agent that leaves when the patch yields no more than the mean rate, exp(l t) = 1 + l (t + travel).

An agent that discounts its future by gamma leaves at another time. A unit eaten at s is worth gamma^s, so its
best t is the one that maximises (1 - exp(-(l + rho) t)) / (1 - exp(-rho (t + travel))), rho = -ln(gamma).
"""

from __future__ import annotations

import math

import numpy as np

from ecology import Arena, Need, Outcome, Resource, Scenario, Species, World, consume, go_to, rest

A, WALK, RADIUS = 10.0, 0.25, 0.3  # units; length per unit of time; length
UNMET = 1000.0  # set point: far above all that is eaten


def refill(world: World, rng: np.random.Generator) -> Outcome:  # noqa: ARG001
    """Fill the patches in which no agent stands."""
    outcome, state = world.no_effect(), world.state
    left = ~(state.inside & state.alive[:, None]).any(axis=0)
    outcome.stock = np.where(left, A - state.stock, 0.0)
    return outcome


def build(
    travel: float = 20.0, rate: float = 0.05, gamma: float = 0.99, decay: float = 0.15, ticks: int = 20_000
) -> Scenario:
    """Return the corridor; `rate` is l per unit of time, `travel` the walk from patch to patch in units of time."""
    apart = (travel - 0.5) * WALK + 2 * RADIUS  # from edge to edge, half a step short: steps are whole
    share = 1 - math.exp(-rate)  # of what is there, in a tick of 1
    names = ("patch", "other")
    forager = Species(
        name="forager",
        needs=(Need(name="food", set_point=UNMET, start=UNMET - 10.0, decay=decay, bounds=(0.0, math.inf)),),
        actions=(
            rest(),
            *(consume(name, {"food": A * share}, by_stock=True) for name in names),
            *(go_to(name, WALK) for name in names),
        ),
        senses=("position",),
        sees=names,
        position=(1.0, 1.0),
        radius=0.2,
        learner_settings={"gamma": gamma},
    )
    patches = tuple(
        Resource(name=name, position=(x, 1.0), radius=RADIUS, stock=A)
        for name, x in ((names[0], 1.0), (names[1], 1.0 + apart))
    )
    return Scenario(
        name="patches",
        arena=Arena(vertices=((0, 0), (2.0 + apart, 0), (2.0 + apart, 2), (0, 2))),
        resources=patches,
        species=(forager,),
        rule=refill,
        ticks=ticks,
    )
