"""Choices that the drive itself decides: food or water, how much, and the sure meal or the risky one of the same mean.

A body can reach three things from its place: a `sure` meal of food, a `risky` one that fails with probability
1 - chance and is larger by the same factor, and water. The paper's drive d = |delta| predicts in closed form:

    deprivation  food is preferred where m_1 |delta_1| > m_2 |delta_2|, to first order in the meals
    dose         a meal is best stopped where t m = |delta_1|
    risk         with one need a body below its set point is indifferent to risk, E d is the same; with another need
                 unmet it is averse: at -1 and 1, E d is 1.118 for +.5 and 1.207 for +1 half the time
"""

from __future__ import annotations

from ecology import Need, Resource, Scenario, Species, consume, rest
from ecology.scenarios.shared.chamber import CHAMBER, LEARNER, MIDDLE, STILL


def build(
    meal: float = 0.5,
    drink: float = 0.5,
    chance: float = 0.5,
    decay: float = 0.05,
    noise: float = 0.0,
    exponent: float = 1.0,
    water: bool = True,
    wide: float = 4.0,
    count: int = 1,
    ticks: int = 20_000,
) -> Scenario:
    """Return the chamber; a `meal` is units of food per tick, on average, a `drink` of water.

    `exponent` is that of the drive, 1 in the paper; without `water` there is one need. Needs stay within `wide` of
    their set points.
    """

    def need(name: str) -> Need:
        return Need(name=name, set_point=wide, decay=decay, noise=noise, bounds=(0.0, 2 * wide))

    body = Species(
        name="body",
        needs=(need("food"), need("water")) if water else (need("food"),),
        actions=(
            rest(),
            consume("larder", {"food": meal}, name="sure"),
            consume("larder", {"food": meal / chance}, name="risky", chance=chance),
            *((consume("spring", {"water": drink}, name="drink"),) if water else ()),
        ),
        count=count,
        drive_epsilon=1e-6,
        drive_exponent=exponent,
        # a need takes some ticks to satisfy: over a long horizon, one meal changes J by less than its errors
        learner_settings={**LEARNER, "gamma": 0.8, "update_every": 1.0, "epsilon_final": 0.1},
        **STILL,
    )
    names = ("larder", "spring") if water else ("larder",)
    return Scenario(
        name="choice",
        arena=CHAMBER,
        resources=tuple(Resource(name=name, position=MIDDLE) for name in names),
        species=(body,),
        ticks=ticks,
    )
