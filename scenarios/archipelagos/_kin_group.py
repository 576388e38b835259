"""A group of agents that may help each other: an island of the archipelago `kin`."""

from __future__ import annotations

import numpy as np

from ecology import Arena, Need, Outcome, Scenario, Species, Trait, World, rest

CHANCES = 5  # to give in a generation, one per tick
BENEFIT = 1.0  # b


def build(size: int = 4, cost: float = 0.5, varied: bool = True, mutation: float = 0.03) -> Scenario:
    """Return a group of `size`; giving costs `cost`, or with `varied` a cost drawn from 0 to 1 at every chance."""

    def rule(world: World, rng: np.random.Generator) -> Outcome:
        """Let every agent whose care exceeds the cost give to another agent of its group."""
        outcome, state = world.no_effect(), world.state
        assert state.trait is not None
        drawn = rng.random((2, size))  # for all slots, whoever lives
        living = np.flatnonzero(state.alive)
        price = drawn[0, living] if varied else np.full(len(living), cost)
        gives = np.flatnonzero(state.trait[living, 0] > price)
        if len(living) > 1 and gives.size:
            to = (gives + 1 + np.floor(drawn[1, living[gives]] * (len(living) - 1)).astype(np.int64)) % len(living)
            outcome.given[living[gives], 0] = price[gives]
            np.add.at(outcome.received, (living[to], 0), BENEFIT)
        return outcome

    agent = Species(
        name="agent",
        needs=(Need(name="energy", set_point=2.0 * CHANCES, start=float(CHANCES), bounds=(0.0, 100.0)),),
        actions=(rest(),),
        count=size,
        solid=False,
        senses=(),
        traits=(Trait(name="care", of="none", bounds=(0.0, 1.0), mutation=mutation, start=0.5, spread=0.3),),
        learner="rest",
    )
    arena = Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2)))
    return Scenario(name="kin_group", arena=arena, species=(agent,), rule=rule)
