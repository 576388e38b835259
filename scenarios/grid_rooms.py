"""A corridor between food and a partner that cannot fetch its own: helping costs a walk of ten ticks.

GridRooms of Man and Yoshida (2024): five cells in a line, food in the first, the partner beyond the last.
Here x = 1 + the original's energy e, so that the set point is 1, the drive is e^2 (their reward is 100 times
its decrease) and death comes below 0. What differs: one more action, rest; eating and passing are closed without
food; the cell is perceived as the distance to the partner. The first tick of a life draws both energies and the
cell; a life is counted from the second.
"""

from __future__ import annotations

import math

import numpy as np

from ecology import Arena, Empathy, Need, Neighbours, Outcome, Scenario, Species, State, World, act, rest
from ecology.scenarios.shared.conditions import LEARNER, empathy, square

CELLS = 5  # of length 1, food in cell 0
LOSS, MEAL = 0.003, 0.1  # of energy per tick; gain of one food eaten
SPREAD = 0.3  # half width of the energies at the start
CAP = 3000  # ticks of a life at most, in the original
REWARD = 100.0  # the original's reward per fall of the drive
APART = 8.0  # length between pairs, which know nothing of each other


def rule(world: World, rng: np.random.Generator) -> Outcome:
    """Move the possessors from cell to cell, hand over food and take it; who is left alone dies too."""
    outcome, state = world.no_effect(), world.state
    possessor, partner = world.slots["possessor"], world.slots["partner"]
    new = state.age[possessor] == 0
    drawn, cell = rng.uniform(-SPREAD, SPREAD, (2, len(new))), rng.integers(CELLS, size=len(new))
    cell = np.where(new, cell, np.floor(state.position[possessor, 0]))
    passes = world.does("possessor", "pass") & (cell == CELLS - 1) & ~new
    gets = world.does("possessor", "get") & (cell == 0) & ~new
    outcome.received[possessor, 1], outcome.given[possessor, 1] = gets, passes
    outcome.received[partner, 0] = MEAL * passes
    for rows, energy in ((possessor, drawn[0]), (partner, drawn[1])):
        outcome.received[rows, 0] += new * (1.0 + energy + LOSS * world.dt)
        outcome.given[rows, 0] = new * state.internal[rows, 0]
    step = world.does("possessor", "right").astype(int) - world.does("possessor", "left")
    y = 0.5 + APART * np.arange(len(new))
    outcome.position = np.zeros(state.position.shape)
    outcome.position[possessor] = np.column_stack([np.clip(cell + step * ~new, 0, CELLS - 1) + 0.5, y])
    outcome.position[partner] = np.column_stack([np.full(len(new), CELLS + 0.5), y])
    outcome.killed[possessor] = outcome.killed[partner] = ~(state.alive[possessor] & state.alive[partner])
    return outcome


def props(state: State) -> dict[str, list[list[tuple[float, float]]]]:
    """Return the lines to draw: the cells of every corridor, the food in its first one, and food in hand."""
    pairs = len(state.alive) // 2
    rows = [APART * i for i in range(pairs)]
    cells = [square((x + 0.5, y + 0.5), 0.5) for y in rows for x in range(CELLS)]
    carries = [i for i in range(pairs) if state.alive[i] and state.internal[i, 1] > 0]
    return {
        "corridor": cells,
        "food": [square((0.5, y + 0.8), 0.12) for y in rows],
        "food in hand": [square(state.position[i] + (0.0, 0.3), 0.08) for i in carries],
    }


def build(
    condition: str = "full",
    weight: float = 0.5,
    perceived: bool = True,
    pairs: int = 1,
    ticks: int = 20_000,
    until_extinct: bool = True,
) -> Scenario:
    """Return the set-up under one condition of empathy; the settings are those of `food_share`."""
    cognitive, affective = empathy(condition)
    energy = Need(name="energy", set_point=1.0, decay=LOSS, bounds=(0.0, math.inf), lethal=True)
    carried = Need(name="carried", set_point=1.0, start=0.0, bounds=(0.0, 1.0), regulated=False)
    has_food = {"opens_from": {"carried": 1.0}}
    possessor = Species(
        name="possessor",
        count=pairs,
        needs=(energy, carried),
        actions=(
            rest(),
            act("left"),
            act("right"),
            act("get"),
            act("eat", control={"energy": MEAL, "carried": -1.0}, **has_food),
            act("pass", **has_food),
        ),
        position=(CELLS / 2, 0.5),
        heading=0.0,
        senses=(),
        view_range=CELLS + 1.0,
        neighbours=(Neighbours(species=("partner",)),),
        empathy=Empathy(weight=weight, species=("partner",), within=CELLS + 1.0, perceived=perceived)
        if affective
        else None,
        solid=False,
        drive_epsilon=1e-12,
        drive_exponent=2.0,
        learner_settings={
            **LEARNER,
            "gamma": 0.97,
            "width": 48,
            "epsilon": 0.9,
            "epsilon_final": 0.2,
            "youth": 3000.0,
            "update_every": 1.0,
        },
    )
    partner = Species(
        name="partner",
        count=pairs,
        needs=(energy,),
        actions=(rest(),),
        position=(CELLS + 0.5, 0.5),
        heading=0.0,
        senses=(),
        opens=("energy",) if cognitive else (),
        solid=False,
        drive_epsilon=1e-12,
        drive_exponent=2.0,
        learner="rest",
    )
    high = APART * pairs
    corridor = Arena(vertices=((0, 0), (CELLS + 1, 0), (CELLS + 1, high), (0, high)))
    return Scenario(
        name="grid_rooms",
        arena=corridor,
        species=(possessor, partner),
        ticks=ticks,
        rule=rule,
        props=props,
        sample_every=2,
        until_extinct=until_extinct,
    )
