"""Two pools that are filled at two rates, and agents that share them: the ideal free distribution.

Q1 and Q2 flow into the pools per unit of time, and the agents at a pool share its inflow. Agents that cannot be sated,
and know what they would get at either pool, distribute themselves so that it is the same: N1 / N2 = Q1 / Q2, a line of
slope 1 in logarithms. If each agent chooses a pool at random with probability epsilon, and the others do not make up
for it, N1 / N is (1 - epsilon) Q1 / Q + epsilon / 2.
"""

from __future__ import annotations

import math

from ecology import Arena, EcologyError, Growth, Need, Resource, Scenario, Species, consume, go_to, rest

APART, POOL, WALK = 4.0, 1.0, 0.5  # lengths, and length per unit of time
APPETITE = 4.0  # of one agent, times the whole inflow per agent: nobody is sated, everybody shares
UNMET = 1000.0  # set point: far above all that is eaten


def build(ratio: float = 4.0, n: int = 24, inflow: float = 1.0, lean: bool = True, ticks: int = 4_000) -> Scenario:
    """Return a hall with a pool at either end; the left one gets `ratio` times the inflow of the right one.

    `inflow` is units per agent and unit of time, both pools together, and is also what an agent needs.
    """
    if ratio <= 0:
        raise EcologyError(f"ratio is the inflow of the left pool over that of the right one, above 0, got {ratio!r}.")
    total = inflow * n

    def pool(name: str, x: float, flow: float) -> Resource:
        return Resource(name=name, position=(x, 1.5), radius=POOL, stock=flow, capacity=flow, growth=Growth(rate=flow))

    appetite = APPETITE * total
    agent = Species(
        name="agent",
        needs=(Need(name="food", set_point=UNMET, start=UNMET - 10.0, decay=inflow, bounds=(0.0, math.inf)),),
        actions=(
            rest(),
            consume("left", {"food": appetite}),
            consume("right", {"food": appetite}),
            go_to("left", WALK),
            go_to("right", WALK),
        ),
        count=n,
        radius=0.1,
        solid=False,
        senses=("position",),
        learner="lean" if lean else "hjb",
    )
    return Scenario(
        name="two_pools",
        arena=Arena(vertices=((0, 0), (2 * POOL + APART, 0), (2 * POOL + APART, 3), (0, 3))),
        resources=(
            pool("left", POOL + 0.01, total * ratio / (1 + ratio)),
            pool("right", POOL + APART - 0.01, total / (1 + ratio)),
        ),
        species=(agent,),
        ticks=ticks,
    )
