"""A colony in which some feed others: nurses at the food, brood that cannot reach it, and what nurses feel of them.

The paper's outlook: "a colony in which each member implements empathy for its cohorts". Nurses eat, or give what
they have to the nearest of the brood, which walks about the nest and dies without food. A nurse's drive holds the state
of the brood, with the weight `weight`: drive_i = d(own) + sum_j w d(j), or in the `average` form d of the
weighted mean deviation. Without it (weight 0) giving only costs, and the brood starves once nurses know that.

A nurse that minimises its drive one tick ahead gives exactly when the weight exceeds its own loss over the other's
gain: in the sum form, with both below their set points, when weight * efficiency > 1.
`cognitive` nurses also perceive how hungry the nearest of the brood is; `lesion` removes the empathy at `lesion_at`.
"""

from __future__ import annotations

import math

import numpy as np

from ecology import (
    Arena,
    Empathy,
    Need,
    Neighbours,
    Outcome,
    Resource,
    Scenario,
    Species,
    World,
    consume,
    give,
    move,
    rest,
)

NEST = 1.0  # side, length
WALK = 0.1  # length per unit of time
EATS, GIVES = 0.1, 0.05  # units per unit of time
SET_POINT, FULL = 2.0, 4.0
SMALL = {  # hjb
    "width": 32, "batch": 32, "batch_f": 32, "memory": 3000, "update_every": 4.0, "updates": 1, "place_cells": 0,
    "pause": 10.0, "depth": 1, "errors": 0, "recent_share": 0.4, "relative_weight": 2,
}  # fmt: skip


def build(
    weight: float = 1.0,
    form: str = "sum",
    cognitive: bool = True,
    lesion: str = "none",
    lesion_at: float = 0.0,
    nurses: int = 3,
    brood: int = 3,
    decay: float = 0.01,
    efficiency: float = 0.8,
    ticks: int = 10_000,
) -> Scenario:
    """Return the nest.

    `weight` is w_ij of every pair in the sum form, and the weight that all others have together in the average form;
    `efficiency` is the share of a gift that arrives; `lesion` is "none", "off", "sham" or "shuffled".
    """
    food = Resource(name="food", position=(NEST / 2, NEST / 2), radius=NEST)  # wherever one is in the nest
    need = Need(name="food", set_point=SET_POINT, decay=decay, bounds=(0.0, FULL))
    ways = {"east": 0.0, "north": math.pi / 2, "west": math.pi, "south": -math.pi / 2}
    nurse = Species(
        name="nurse",
        needs=(need,),
        actions=(
            rest(),
            consume("food", {"food": EATS}, closes_at={"food": FULL}),
            give("brood", {"food": GIVES}, reach=2 * NEST, efficiency=efficiency, opens_from={"food": SET_POINT / 2}),
        ),
        count=nurses,
        solid=False,
        senses=(),
        neighbours=(Neighbours(species=("brood",)),) if cognitive else (),
        opens=("food",),
        empathy=Empathy(
            weight=weight,
            form=form,  # type: ignore[arg-type]
            species=("brood",),
            lesion=lesion,  # type: ignore[arg-type]
            lesion_at=lesion_at,
        ),
        learner_settings=SMALL,
    )
    young = Species(
        name="brood",
        needs=(need,),
        actions=(rest(), *(move(f"walk_{way}", WALK, direction=angle) for way, angle in ways.items())),
        count=brood,
        solid=False,
        opens=("food",),
        learner="random",
    )
    nest = Arena(vertices=((0, 0), (NEST, 0), (NEST, NEST), (0, NEST)))
    return Scenario(name="colony", arena=nest, resources=(food,), species=(nurse, young), rule=starve, ticks=ticks)


def starve(world: World, _: np.random.Generator) -> Outcome:
    """Return the death of all who have nothing left; too much does not kill."""
    outcome = world.no_effect()
    for species, rows in world.slots.items():
        outcome.killed[rows] = world.state.internal[rows, world.column(species, "food")] <= 0
    return outcome
