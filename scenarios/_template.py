"""NAME: a square room, one species with two needs, two foods."""

from __future__ import annotations

import math

from ecology import Arena, Need, Resource, Scenario, Species, consume, go_to, move, rest, sleep, turn

# Lengths are in units of the plane, rates and speeds per unit of time; a tick lasts dt.
# The outer walls, once around; holes=[polygon, ...] and walls=[polyline, ...] put obstacles into the room.
ROOM = Arena(
    vertices=((0, 0), (6, 0), (6, 6), (0, 6)),
    # + arena
)
WALK, TURN = 0.1, math.pi / 10  # length and radians per unit of time
# + top


def build(decay: float = 0.002, intake: float = 0.1, dt: float = 1.0, ticks: int = 20_000) -> Scenario:
    """Return the room. Every parameter here is a setting: `ecology run NAME.py --set decay=0.004`."""
    foods = (
        Resource(name="water", position=(1.0, 1.0), radius=0.4),
        Resource(name="grass", position=(5.0, 5.0), radius=0.4),
        # + resources
    )
    # A need decays by itself; the agent feels its deviation from the set point.
    # A fatigue is a need with the set point 0 that grows by itself (negative decay).
    needs = (
        Need(name="thirst", set_point=1.0, decay=decay, bounds=(0.0, 2.0)),
        Need(name="hunger", set_point=2.0, decay=decay, bounds=(0.0, 4.0)),
        Need(name="sleepiness", set_point=0.0, decay=-0.001, bounds=(0.0, 6.0)),
        # + needs
    )
    actions = (
        rest(),
        move("walk", WALK),
        turn("turn_left", TURN),
        turn("turn_right", -TURN),
        sleep(duration=50.0, control={"sleepiness": -0.011}),  # control: change per unit of time
        consume("water", {"thirst": intake}, closes_at={"thirst": 2.0}),  # open inside the circle
        consume("grass", {"hunger": intake}, closes_at={"hunger": 4.0}),
        go_to("water", WALK),  # open while the resource is seen
        go_to("grass", WALK),
        # + actions
    )
    agent = Species(
        name="agent",
        needs=needs,
        actions=actions,
        count=1,
        # what it perceives besides its deviations
        senses=(
            "position",
            "heading",
            # + senses
        ),
        view_angle=math.pi,
        view_range=4.0,
        collapse={"sleepiness": 5.0},  # from here on only sleep is open
        # + species
    )
    return Scenario(
        name="NAME",
        arena=ROOM,
        resources=foods,
        species=(agent,),
        dt=dt,
        ticks=ticks,
        # + scenario
    )
