"""Evolution of help: Hamilton's rule for how much an agent feels of the members of its group.

Agents live in groups of `size`. At every opportunity an agent can give: giving costs it c and brings b = 1 to one other
member of its group. An agent that feels w times what others feel gives if w > c. At the end of a generation, newborns
replace all agents. Parents are drawn from the whole population in proportion to energy, and a child inherits w from
its parent, with mutation. One parent is the founder of each group. Each member is the founder's child with probability
sqrt(r), else the child of another parent, so two members of a group are related by r. There is no competition within
groups (Taylor 1992).

With one c, weights above it spread where r > c (Hamilton 1964; robots: Waibel, Floreano and Keller 2011). Where c is
drawn from 0 to 1 at every opportunity, w = r is stable.
"""

from __future__ import annotations

import math

import numpy as np

from ecology import Arena, Birth, Empathy, Need, Outcome, Scenario, Species, Trait, World, act, rest

APART = 2.0  # length between groups
LIFE, ENERGY = 5, 3.0  # ticks of a generation, the first without a chance; energy at birth in one of that length
BENEFIT = 1.0  # b


def build(
    relatedness: float = 0.5,
    cost: float = 0.5,
    varied: bool = False,
    groups: int = 12,
    size: int = 8,
    mutation: float = 0.03,
    felt: bool = True,
    life: int = LIFE,
    ticks: int = 1_000,
) -> Scenario:
    """Return the groups; with `varied` the cost is drawn from 0 to 1 at every opportunity, else it is `cost`.

    With `felt` False, w is only a number of each agent, and nothing is felt: fast, for agents that act by w itself.
    A generation has `life` ticks; energy at birth grows with it, so that selection is as strong.
    """
    count = groups * size
    child = math.sqrt(relatedness)
    energy = ENERGY * (life - 1) / (LIFE - 1)

    def rule(world: World, rng: np.random.Generator) -> Outcome:
        """Let givers give to a member of their group, set the next cost, and replace generations."""
        outcome, state = world.no_effect(), world.state
        living = np.flatnonzero(state.alive)
        home = np.column_stack([np.repeat(np.arange(groups), size) * APART + APART / 2, np.ones(count)])
        if state.tick == 0:  # the first generation finds its groups
            outcome.position = state.position.copy()
            outcome.position[living] = home[: len(living)]
            return outcome
        group = (state.position[living, 0] / APART).astype(np.int64)
        living, group = living[np.argsort(group, kind="stable")], np.sort(group)
        first, many = np.searchsorted(group, group), np.bincount(group, minlength=groups)[group]
        giver = np.flatnonzero(world.does("agent", "give")[living] & (many > 1))
        step = rng.integers(1, many[giver])
        taker = first[giver] + (giver - first[giver] + step) % many[giver]
        outcome.given[living[giver], 0] = state.internal[living[giver], 1]
        np.add.at(outcome.received, (living[taker], 0), BENEFIT)
        if varied:
            change = rng.random(len(living)) - state.internal[living, 1]
            outcome.received[living, 1], outcome.given[living, 1] = np.maximum(change, 0), np.maximum(-change, 0)
        if (state.tick + 1) % life == 0 and len(living):
            left = np.maximum(state.internal[living, 0] + outcome.received[living, 0] - outcome.given[living, 0], 0)
            share = np.cumsum(left) / left.sum()
            founder = np.repeat(np.searchsorted(share, rng.random(groups)), size)
            anybody = np.searchsorted(share, rng.random(count))
            parent = np.where(rng.random(count) < child, founder, anybody)
            outcome.killed[living] = True
            outcome.births, outcome.parents = {"agent": home}, {"agent": living[np.minimum(parent, len(living) - 1)]}
        return outcome

    weight = "empathy.weight" if felt else "none"
    care = Trait(name="care", of=weight, bounds=(0.0, 1.0), mutation=mutation, start=0.5, spread=0.3)
    agent = Species(
        name="agent",
        needs=(
            Need(name="energy", set_point=4 * energy, start=energy, bounds=(-100.0, max(100.0, 8 * energy))),
            Need(name="cost", set_point=0.0, start=0.5 if varied else cost, bounds=(0.0, 1.0), regulated=False),
        ),
        actions=(rest(), act("give")),
        count=count,
        capacity=2 * count,  # the dead rest for a tick
        birth=Birth(rate=0.0),
        solid=False,
        senses=(),
        empathy=Empathy(weight=0.5, within=APART / 4) if felt else None,
        traits=(care,),
        learner="random",
    )
    return Scenario(
        name="kin",
        arena=Arena(vertices=((0, 0), (APART * groups, 0), (APART * groups, 2), (0, 2))),
        species=(agent,),
        rule=rule,
        ticks=ticks,
    )
