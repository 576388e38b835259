"""Time and noise at work: a day that changes decay, weather that disturbs, in one small room.

Terms (c) and (d) of the paper's equation of d zeta (section "Dynamics and decision-making"). The
room has two places: berries still hunger, a fire restores warmth. By night warmth is lost faster
and hunger pauses; wind and sun push warmth up and down at random. The agent has a clock.
"""

from __future__ import annotations

import math

from ecology import Arena, Need, Resource, Scenario, Season, Species, consume, go_to, move, rest

ROOM = Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4)))
WALK = 0.1  # length per unit of time
INTAKE = 0.1  # of either need per unit of time
DAYTIME, NIGHT = 0.0, math.pi  # phases: a day begins at sunrise; decay peaks at noon, or at midnight


def build(
    day: float = 400.0,
    swing: float = 0.8,
    weather: float = 0.01,
    decay: float = 0.004,
    dt: float = 1.0,
    ticks: int = 50_000,
) -> Scenario:
    """Return the room.

    `swing` is the share by which decay rises and falls over a `day`; `weather` is the standard
    deviation of warmth after one unit of time.
    """
    food = Need(
        name="food",
        set_point=2.0,
        decay=decay,
        season=Season(amplitude=swing, period=day, phase=DAYTIME),
        bounds=(0.0, 4.0),
    )
    warmth = Need(
        name="warmth",
        set_point=2.0,
        decay=decay,
        season=Season(amplitude=swing, period=day, phase=NIGHT),
        noise=weather,
        bounds=(0.0, 4.0),
    )
    places = (Resource(name="berries", position=(1.0, 1.0)), Resource(name="fire", position=(3.0, 3.0)))
    ways = {"east": 0.0, "north": math.pi / 2, "west": math.pi, "south": -math.pi / 2}
    agent = Species(
        name="agent",
        needs=(food, warmth),
        actions=(
            rest(),
            *(move(f"walk_{way}", WALK, direction=angle) for way, angle in ways.items()),
            consume("berries", {"food": INTAKE}, closes_at={"food": 4.0}),
            consume("fire", {"warmth": INTAKE}, closes_at={"warmth": 4.0}),
            go_to("berries", WALK),
            go_to("fire", WALK),
        ),
        position=(2.0, 2.0),
        senses=("position", "clock"),
    )
    return Scenario(name="seasons", arena=ROOM, resources=places, species=(agent,), day=day, dt=dt, ticks=ticks)
