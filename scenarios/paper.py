"""The paper's single agent: four needs, two fatigues, one non-convex arena.

Laurencon et al. (2021), section "Experiment", with intake as a quantity per unit of time (section
"Properties of the reward"). The agent that learns lives on; one that never rests or sleeps meets
every threshold of its body.
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

ARENA = Arena(
    vertices=(
        (0, 1), (0, 5), (1, 5), (1, 3), (2, 3), (2, 4), (3, 4), (3, 6), (8, 6),
        (8, 5), (5, 5), (5, 3), (6, 3), (6, 0), (5, 0), (5, 2), (4, 2), (4, 1),
    )
)  # fmt: skip
PLACES = ((0.5, 4.25), (3.5, 1.5), (7.0, 5.5), (5.5, 0.75))
WALK, RUN, TURN = 0.1, 0.3, 2 * math.pi / 5  # per unit of time
TIRES_WALKING, TIRES_RUNNING, TIRES_TURNING, RECOVERS = 0.003, 0.03, 0.0005, 0.002  # muscle fatigue
RUN_UP_TO, WALK_UP_TO = 1.5, 3.0  # muscle fatigue at which running and walking close
WAKING, SLEEPING, NAP, COLLAPSE = 0.0005, 0.0055, 50.0, 5.0  # sleep fatigue


def build(
    set_points: tuple[float, ...] = (1.0, 2.0, 3.0, 4.0),
    decay: float = 0.002,
    intake: float = 0.1,
    heading: bool = True,
    view_angle: float = 2 * math.pi / 3,
    view_range: float = 3.0,
    commitment: str = "free",
    dt: float = 1.0,
    ticks: int = 60_000,
) -> Scenario:
    """Return the world, with a need for each of 1 to 4 `set_points`; `heading` False gives absolute directions."""
    if not 1 <= len(set_points) <= len(PLACES):
        raise EcologyError(f"set_points are 1 to {len(PLACES)} numbers, one for each food; got {set_points!r}.")
    foods = tuple(
        Resource(name=f"food_{i + 1}", position=place, radius=0.3) for i, place in enumerate(PLACES[: len(set_points)])
    )
    needs = tuple(
        Need(name=f"need_{i + 1}", set_point=level, decay=decay, bounds=(0.0, 2 * level))
        for i, level in enumerate(set_points)
    )
    fatigues = (
        Need(name="muscle_fatigue", set_point=0.0, start=0.1, decay=RECOVERS, bounds=(0.0, 10.0)),
        Need(name="sleep_fatigue", set_point=0.0, start=0.1, decay=-WAKING, bounds=(0.0, 12.0)),
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
        motions = tuple(
            move(f"{verb}_{way}", speed, direction=angle, **how)
            for verb, speed, how in (("walk", WALK, step), ("run", RUN, sprint))
            for way, angle in ways.items()
        )
    agent = Species(
        name="agent",
        needs=needs + fatigues,
        actions=(
            rest(),
            *motions,
            sleep(duration=NAP, control={"sleep_fatigue": -SLEEPING}),
            *(
                consume(food.name, {need.name: intake}, closes_at={need.name: need.bounds[1]})
                for food, need in zip(foods, needs, strict=True)
            ),
            *(go_to(food.name, WALK, **step) for food in foods),
        ),
        position=(3.0, 2.0),
        heading=0.0,
        senses=("position", "heading") if heading else ("position",),
        view_angle=view_angle if heading else 2 * math.pi,
        view_range=view_range,
        collapse={"sleep_fatigue": COLLAPSE},
        commitment=commitment,  # type: ignore[arg-type]
    )
    return Scenario(name="paper", arena=ARENA, resources=foods, species=(agent,), dt=dt, ticks=ticks)
