"""Grass, grazers that leave carcasses where they die, and scavengers that live on these alone.

A carcass holds the flesh of the body and the energy that it still had, and rots. So the scavengers get what the grazers
do not use up: grazers * mortality * (flesh + energy), less what rots before it is found.

With a `childhood`, young grazers are small and slow and use more energy: a stage of life.
"""

from __future__ import annotations

import math
from typing import Any

from ecology import Arena, Birth, Growth, Hazard, Need, Remains, Resource, Scenario, Species, Stage

from ecology import consume, go_to, move, rest, turn  # isort: skip

WALK, TURN = 0.12, math.pi / 2  # length and radians per unit of time


def _eats(name: str, food: str, count: int, decay: float, sight: float, **words: Any) -> Species:
    """Return a species that walks, sees one food and eats it."""
    return Species(
        name=name,
        needs=(Need(name="energy", set_point=1.0, start=0.7, decay=decay, bounds=(0.0, math.inf), lethal=True),),
        actions=(
            consume(food, {"energy": 0.05}, closes_at={"energy": 1.2}), go_to(food, WALK), move("walk", WALK),
            turn("turn_left", TURN), turn("turn_right", -TURN), rest(),
        ),
        count=count, capacity=3 * count, solid=False, view_range=sight, senses=(), sees=(food,), learner="lean",
        **words,
    )  # fmt: skip


def build(
    grazers: int = 40, scavengers: int = 8, patches: int = 16, regrowth: float = 0.01, side: float = 13.0,
    mortality: float = 0.001, flesh: float = 0.5, rot: float = 0.005, childhood: float = 0.0, ticks: int = 20_000,
) -> Scenario:  # fmt: skip
    """Return the meadow, a walled square.

    `mortality` of grazers and `rot` of carcasses are shares per unit of time; `flesh` is what the body of a grazer
    yields besides its energy. Grazers are fawns up to the age `childhood`, time; 0 is none.
    """
    fawn = Stage(name="fawn", speed=0.6, size=0.6, metabolism=1.3)
    grass = Resource(name="grass", count=patches, radius=0.4, stock=1.0, capacity=2.0, growth=Growth(rate=regrowth))
    carcass = Resource(
        name="carcass", count=3 * grazers, radius=0.3, stock=0.0, capacity=2.0, decay=rot, gone_below=0.02
    )
    fed: dict[str, Any] = {"threshold": {"energy": 0.8}, "cost": {"energy": 0.4}}
    return Scenario(
        name="scavengers",
        arena=Arena(vertices=((0, 0), (side, 0), (side, side), (0, side))),
        resources=(grass, carcass),
        species=(
            _eats("grazer", "grass", grazers, 0.0025, 3.0, hazard=Hazard(rate=mortality),
                  birth=Birth(rate=0.008, maturity=100.0, **fed),
                  remains=Remains(resource="carcass", needs={"energy": 1.0}, body=flesh),
                  stages=(fawn, Stage(name="adult", age=childhood)) if childhood > 0 else ()),
            _eats("scavenger", "carcass", scavengers, 0.001, 6.0, hazard=Hazard(rate=mortality / 4),
                  birth=Birth(rate=0.002, maturity=200.0, **fed)),
        ),
        ticks=ticks,
    )  # fmt: skip
