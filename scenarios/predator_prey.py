"""Grass, prey and predators that learn f and J; fit agents reproduce, agents that starve or are bitten to death die.

Patches of grass regrow at a constant rate, so they feed about patches * regrowth / prey_decay prey. A bite
wounds: it takes health, which hurts, heals and is deadly at zero, so that a prey can learn to keep away from
predators before it dies of one. No agent knows where it is: a prey senses the nearest grass and the nearest predator, a
predator the nearest prey. Of movements that seem equally good the first is taken, so a newborn that knows nothing eats
where it can.

Fleeing pays: both kinds walk at the same speed, a prey sees farther than a predator, and a predator that has bitten
stands still for the handling time. Every other predator nearby costs a predator energy (`disturbance`), which keeps
predators too few to eat up the prey.
"""

from __future__ import annotations

import math
from dataclasses import replace

from ecology import (
    Arena,
    Birth,
    Crowding,
    Growth,
    Hazard,
    Need,
    Neighbours,
    Resource,
    Scenario,
    Species,
    bite,
    consume,
    go_to,
    move,
    rest,
    turn,
)

WALK = 0.12  # speed of prey and of predators, length per unit of time
TURN = math.pi / 2  # radians per unit of time
TURNS = (turn("turn_left", TURN), turn("turn_right", -TURN))
SIGHT, HUNT_SIGHT = 3.0, 2.0  # how far prey and predators see, length
DISTURBED = 3.0  # distance within which predators disturb each other, length
HEALING = 0.002  # share of a wound that heals per unit of time
LEARNER = {  # of a short life: small networks, small batches, short movements
    "width": 32, "batch": 16, "batch_f": 32, "memory": 500, "recent": 100, "update_every": 6.0, "updates": 1,
    "place_cells": 0, "stride": 4.0, "pause": 5.0, "gamma": 0.99, "epsilon": 0.2, "epsilon_final": 0.05, "youth": 200.0,
    "learning_rate": 1e-3, "polyak": 0.005, "depth": 1, "errors": 0, "recent_share": 0.4, "relative_weight": 2,
    "option_cost": True,
}  # fmt: skip


def build(
    prey: int = 110,
    predators: int = 30,
    patches: int = 45,
    regrowth: float = 0.01,
    side: float = 22.0,
    prey_decay: float = 0.0025,
    prey_birth: float = 0.008,
    prey_mortality: float = 0.0002,
    predator_decay: float = 0.001,
    predator_birth: float = 0.003,
    predator_mortality: float = 0.0005,
    reach: float = 0.5,
    chance: float = 0.08,
    handling: float = 30.0,
    gain: float = 0.4,
    wound: float = 0.5,
    disturbance: float = 0.0012,
    arrival: float = 0.0,
    inherit: bool = True,
    mutation: float = 0.01,
    ticks: int = 20_000,
) -> Scenario:
    """Return the meadow, a walled square.

    `decay` is energy lost, `birth` the birth rate of fit agents and `mortality` the death rate of all, per unit of
    time. A bite has `chance` per unit of time to take `wound` of health and bring `gain` of energy, and takes the time
    `handling`. `disturbance` is energy that each other predator nearby costs a predator, per unit of time. `arrival` is
    the rate of newcomers of either species; slots are three times the numbers at the start.
    """
    grass = Resource(name="grass", count=patches, radius=0.4, stock=1.0, capacity=2.0, growth=Growth(rate=regrowth))
    energy = Need(name="energy", set_point=1.0, start=0.7, decay=prey_decay, bounds=(0.0, math.inf), lethal=True)
    health = Need(name="health", set_point=1.0, decay=-HEALING, leak=HEALING, bounds=(0.0, math.inf), lethal=True)
    hunted = Species(
        name="prey",
        needs=(energy, health),
        actions=(
            consume("grass", {"energy": 0.05}, closes_at={"energy": 1.2}),
            go_to("grass", WALK),
            move("walk", WALK),
            *TURNS,
            rest(),
        ),
        count=prey,
        capacity=3 * prey,
        birth=Birth(rate=prey_birth, threshold={"energy": 0.8}, cost={"energy": 0.4}, maturity=100.0),
        hazard=Hazard(rate=prey_mortality),
        arrival=arrival,
        solid=False,
        view_range=SIGHT,
        senses=(),
        sees=("grass",),
        neighbours=(Neighbours(species=("predator",)),),
        learner_settings={**LEARNER, "inherit": inherit, "mutation": mutation},
    )
    attack = bite(
        "prey",
        reach=reach,
        chance=chance,
        duration=handling,
        gain={"energy": gain},
        damage={"health": wound},
        closes_at={"energy": 1.2},
    )
    hunter = replace(
        hunted,
        name="predator",
        needs=(replace(energy, start=0.5, decay=predator_decay),),
        actions=(attack, move("walk", WALK), *TURNS, rest()),
        count=predators,
        capacity=3 * predators,
        birth=Birth(rate=predator_birth, threshold={"energy": 0.9}, cost={"energy": 0.5}, maturity=200.0),
        hazard=Hazard(rate=predator_mortality),
        crowding=Crowding(within=DISTURBED, control={"energy": -disturbance}, species=("predator",)),
        view_range=HUNT_SIGHT,
        sees=(),
        neighbours=(Neighbours(species=("prey",)),),
    )
    meadow = Arena(vertices=((0, 0), (side, 0), (side, side), (0, side)))
    return Scenario(name="predator_prey", arena=meadow, resources=(grass,), species=(hunted, hunter), ticks=ticks)
