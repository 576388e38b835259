"""The authors' own world, with the numbers of their public code (2021): the reference parameter set.

The body's own dynamics and the control are proportional to the variable, dx/dt = (c + u) x, unlike the quantities
per unit of time of `paper`. Where this world still differs from that code:
- a sleep and a go_to last tick by tick (Euler) instead of one jump with the exponential, and a
  go_to ends at the circle's edge, where the resource can be consumed, instead of at its centre;
- the body is a small disc, and a step into a wall ends at the wall; in that code it is a point, and such
  a step is closed;
- sleep opens at its threshold, not just above it;
- the ceilings of the variables, which the code lacks, are set where no action reaches at dt = 1.
"""

from __future__ import annotations

import math
from typing import Any

from ecology import (
    Action,
    Arena,
    EcologyError,
    Need,
    Resource,
    Scenario,
    Species,
    consume,
    go_to,
    move,
    rest,
    sleep,
    turn,
)
from ecology.scenarios.paper import ARENA, PLACES

SQUARE = Arena(vertices=((0, 0), (10, 0), (10, 10), (0, 10)))
WORLDS = {"MEDIUM": (ARENA, 4), "EASY": (SQUARE, 2)}  # the arena and how many of the resources
LEAK, MUSCLE_LEAK, WAKING = 0.05, 0.008, 0.0005  # -c, -c and c, per unit of time
INTAKE, FULL = 0.1, 8.0  # u of consuming; delta at which it closes
WALK, RUN, TURN = 0.1, 0.3, 2 * math.pi / 5  # per unit of time
TIRES_WALKING, TIRES_RUNNING, TIRES_TURNING = 0.01, 0.05, 0.001  # u of muscle fatigue
RUN_UP_TO, WALK_UP_TO = 3.0, 6.0  # muscle fatigue at which running and walking close
SLEEPING, NIGHT, SLEEPY, COLLAPSE = -0.001, 1000.0, 1.0, 10.0  # u and thresholds of sleep fatigue
FLOOR, RESTED = 0.1, 0.1  # of every variable; fatigues at the start
RADIUS = 0.05  # of the body


def build(
    arena: str = "MEDIUM",
    heading: bool = True,
    start: tuple[float, float] = (3.0, 2.0),
    commitment: str = "committed",
    dt: float = 1.0,
    ticks: int = 100_000,
) -> Scenario:
    """Return the world "MEDIUM" (the paper's arena) or "EASY" (a square, the first two resources).

    `heading` False gives the four absolute directions, without running, of the later code. That
    code starts at (2, 2), the one at the paper's time at (3, 2); since its arena then lay one unit
    to the right, both may mean the same place.
    """
    if arena not in WORLDS:
        raise EcologyError(f"arena is one of {', '.join(map(repr, WORLDS))}, got {arena!r}.")
    walls, count = WORLDS[arena]
    foods = tuple(Resource(name=f"food_{i + 1}", position=place, radius=0.3) for i, place in enumerate(PLACES[:count]))
    needs = tuple(
        Need(
            name=f"need_{i}",
            set_point=float(i),
            leak=LEAK,
            proportional=True,
            floor=FLOOR,
            bounds=(0.0, 1.1 * (i + FULL)),
        )
        for i in range(1, count + 1)
    )
    fatigues = tuple(
        Need(
            name=name,
            set_point=0.0,
            start=RESTED,
            leak=leak,
            proportional=True,
            floor=FLOOR,
            bounds=(0.0, ceiling),
        )
        for name, leak, ceiling in (("muscle_fatigue", MUSCLE_LEAK, 10.0), ("sleep_fatigue", -WAKING, 12.0))
    )
    step: dict[str, Any] = {"control": {"muscle_fatigue": TIRES_WALKING}, "closes_at": {"muscle_fatigue": WALK_UP_TO}}
    sprint = {"control": {"muscle_fatigue": TIRES_RUNNING}, "closes_at": {"muscle_fatigue": RUN_UP_TO}}
    spin = {"control": {"muscle_fatigue": TIRES_TURNING}, "closes_at": {"muscle_fatigue": WALK_UP_TO}}
    motions: tuple[Action, ...]
    if heading:
        motions = (
            move("walk", WALK, **step),
            move("run", RUN, **sprint),
            turn("turn_left", TURN, **spin),
            turn("turn_right", -TURN, **spin),
        )
    else:
        ways = {"east": 0.0, "north": math.pi / 2, "west": math.pi, "south": -math.pi / 2}
        motions = tuple(move(f"walk_{way}", WALK, direction=angle, **step) for way, angle in ways.items())
    agent = Species(
        name="agent",
        needs=needs + fatigues,
        actions=(
            rest(),
            *motions,
            sleep(duration=NIGHT, control={"sleep_fatigue": SLEEPING}, opens_from={"sleep_fatigue": SLEEPY}),
            *(
                consume(food.name, {need.name: INTAKE}, closes_at={need.name: need.set_point + FULL})
                for food, need in zip(foods, needs, strict=True)
            ),
            # seen all round and at any distance: wherever a straight line to it is free of walls
            *(go_to(food.name, WALK, **step) for food in foods),
        ),
        radius=RADIUS,
        position=start,
        heading=0.0,
        senses=("position", "heading") if heading else ("position",),
        collapse={"sleep_fatigue": COLLAPSE},
        commitment=commitment,  # type: ignore[arg-type]
    )
    return Scenario(name="paper_reference", arena=walls, resources=foods, species=(agent,), dt=dt, ticks=ticks)
