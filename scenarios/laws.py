"""Four laws in as few components as each needs, for bodies that do one thing all the time.

competition  two species eat from one pool; each gets appetite times the share S / K that the pool holds. Species i
             keeps its energy where S / K = cost / appetite; the one with the lower R* wins (Tilman 1982)
noise        a need with a leak and a noise has the variance noise^2 / (2 leak) (Ornstein and Uhlenbeck)
drift        in a population of constant size n, a neutral marker is fixed with the probability 1 / n
growth       births at the rate b from the age a on and deaths at m: numbers grow at r with
             b exp(-(r + m) a) = r + m (Euler and Lotka)
"""

from __future__ import annotations

import math
from typing import Any

from ecology import Arena, Birth, EcologyError, Growth, Hazard, Need, Resource, Scenario, Species, Trait, consume, rest

LAWS = ("competition", "noise", "drift", "growth")
SIDE = 10.0
COSTS = {"thrifty": 0.02, "wasteful": 0.03}  # energy lost per unit of time; R* is that over the appetite
APPETITE, POOL, INFLOW = 0.1, 100.0, 1.5
LEAK, NOISE = 0.05, 0.3
BEARS, MATURE, DIES = 0.05, 20.0, 0.005
AT_ONCE = 100.0  # rate of births that do not wait


def _eaters(name: str, cost: float, n: int) -> Species:
    """Return a species that eats all the time."""
    return Species(
        name=name,
        needs=(Need(name="energy", set_point=4.0, start=1.0, decay=cost, bounds=(0.0, 8.0), lethal=True),),
        actions=(rest(), consume("pool", {"energy": APPETITE}, by_stock=True)),
        count=n,
        capacity=8 * n,
        birth=Birth(rate=0.02, threshold={"energy": 2.0}, cost={"energy": 1.0}),
        hazard=Hazard(rate=0.001),
        solid=False,
        senses=(),
        learner="random",
    )


def build(law: str = "competition", n: int = 12, ticks: int = 4_000) -> Scenario:
    """Return the world of a law: "competition", "noise", "drift" or "growth"; `n` bodies per species at the start."""
    if law not in LAWS:
        raise EcologyError(f"law is one of {', '.join(map(repr, LAWS))}, got {law!r}.")
    idle: dict[str, Any] = {"actions": (rest(),), "count": n, "solid": False, "senses": (), "learner": "rest"}
    still = (Need(name="ease", set_point=0.0, bounds=(-1.0, 1.0)),)
    pools: tuple[Resource, ...] = ()
    if law == "competition":
        pools = (
            Resource(name="pool", position=(SIDE / 2, SIDE / 2), radius=SIDE, stock=POOL, growth=Growth(rate=INFLOW)),
        )
        species = tuple(_eaters(name, cost, n) for name, cost in COSTS.items())
    elif law == "noise":
        need = Need(name="level", set_point=0.0, leak=LEAK, noise=NOISE, bounds=(-math.inf, math.inf))
        species = (Species(name="body", needs=(need,), **idle),)
    elif law == "drift":
        marker = Trait(name="marker", of="none", bounds=(0.0, 1.0), spread=0.3)
        species = (
            Species(
                name="body", needs=still, birth=Birth(rate=AT_ONCE), hazard=Hazard(rate=0.05), traits=(marker,), **idle
            ),
        )  # fmt: skip
    else:
        birth = Birth(rate=BEARS, maturity=MATURE)
        species = (
            Species(name="body", needs=still, birth=birth, hazard=Hazard(rate=DIES), **{**idle, "capacity": 40 * n}),
        )
    return Scenario(
        name="laws",
        arena=Arena(vertices=((0, 0), (SIDE, 0), (SIDE, SIDE), (0, SIDE)), walls=False),
        resources=pools,
        species=species,
        ticks=ticks,
    )
