"""Food shared with a partner whose hunger shows in signs alone: empathy has to be learned.

This is `food_share` with one difference: an agent cannot sense what its partner feels. Both bodies show a display,
which says whether their energy is high, and is wrong in a share `noise` of all ticks. An agent that learns which of
its own drives go with its own display (the learner `inferring`) can infer from the partner's display what the partner
feels. Man and Yoshida (2025) train a decoder for this.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ecology import EcologyError, Need, Neighbours, Outcome, Scenario, World
from ecology.scenarios import food_share

KNOWS = ("signs", "energy", "nothing")  # what is sensed of the partner


def build(
    senses: str = "signs", weight: float = 0.5, noise: float = 0.1, pairs: int = 1, ticks: int = 5_000
) -> Scenario:
    """Return the set-up; agents sense their partner's "signs", its "energy" itself, or "nothing"."""
    if senses not in KNOWS:
        raise EcologyError(f"senses is one of {', '.join(map(repr, KNOWS))}, got {senses!r}.")
    world = food_share.build("affective" if weight > 0 else "none", max(weight, 1e-9), True, pairs, ticks)
    display = Need(name="display", set_point=1.0, bounds=(0.0, 1.0), regulated=False)
    possessor, partner = world.species

    def rule(world: World, rng: np.random.Generator) -> Outcome:
        """Feed one of each pair as `food_share` does, and update both displays."""
        outcome = food_share.rule(world, rng)
        x = world.state.internal
        for name in ("possessor", "partner"):
            rows = world.slots[name]
            energy, shown = world.column(name, "energy"), world.column(name, "display")
            after = x[rows, energy] + outcome.received[rows, energy] - outcome.given[rows, energy]
            wrong = rng.random(len(after)) < noise
            change = ((after > food_share.HIGH / 2) ^ wrong) - x[rows, shown]
            outcome.received[rows, shown], outcome.given[rows, shown] = np.maximum(change, 0), np.maximum(-change, 0)
        return outcome

    opened = {"signs": ("display",), "energy": ("energy",), "nothing": ()}[senses]
    possessor = replace(
        possessor,
        needs=(*possessor.needs, display),
        neighbours=(Neighbours(species=("partner",)),),
        learner="inferring" if senses == "signs" and weight > 0 else "hjb",
    )
    partner = replace(partner, needs=(*partner.needs, display), opens=opened)
    return replace(world, name="inferred", species=(possessor, partner), rule=rule)
