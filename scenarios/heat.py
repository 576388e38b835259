"""Cooling ahead of a heat load: a light announces the load, and an agent that waits for it cannot cool in time.

Body temperature T falls to that of the room, dT = (u + load - (T - 25) / 10) / 30 per unit of time, and the agent
controls u from -5 to 5. The set point is 36, and outside 32 to 42 the agent dies. A load of 10 exceeds any cooling:
T approaches 75 with the time constant 300, so that an agent at 36.27 is dead after 48 units unless it was cooler at
the start. A light announces the load `lead` units before, and the agent remembers it by a fading trace.
After Yoshida, Sprekeler and Gutkin (2025).
"""

from __future__ import annotations

import math

from ecology import Cue, Event, Exposure, Field, Need, Scenario, Session, Species, Trace, act, rest
from ecology.scenarios.shared.chamber import CHAMBER, LEARNER, STILL

ROOM, COUPLING, INERTIA = 25.0, 10.0, 30.0  # temperature outside, and the constants of dT
MOST = 5.0  # of u, heating or cooling
FADES = -math.log(0.95)  # of the trace, share per unit of time


def build(
    load: float = 10.0,
    lead: float = 20.0,
    lasts: float = 50.0,
    gap: float = 1000.0,
    trials: int = 30,
    lethal: bool = True,
    levels: int = 5,
    count: int = 1,
    ticks: int = 30_000,
) -> Scenario:
    """Return the chamber; `levels` of u are evenly from -5 to 5, the gap between trials has the mean `gap`.

    With `lethal` False the body survives any temperature and stays within 32 and 42, which young learners need.
    """
    temperature = Need(
        name="temperature", set_point=36.0, decay=-ROOM / COUPLING / INERTIA, leak=1 / COUPLING / INERTIA,
        bounds=(32.0, 42.0), lethal=lethal,
    )  # fmt: skip
    efforts = [MOST * (2 * i / (levels - 1) - 1) for i in range(levels)]
    body = Species(
        name="body",
        needs=(temperature,),
        actions=(
            rest(),
            *(
                act(f"{'cool' if u < 0 else 'heat'}_{abs(u):g}".replace(".", "_"), control={"temperature": u / INERTIA})
                for u in efforts
                if u
            ),
        ),
        cues=("light",),
        exposures=(Exposure(field="load", control={"temperature": 1 / INERTIA}),),
        drive_exponent=2.0,
        count=count,
        learner_settings={**LEARNER, "gamma": 0.985, "update_every": 1.0},  # a load lasts 50 ticks
        **{**STILL, "senses": (Trace(of="light", rate=FADES),)},
    )
    trial = Session(
        name="load",
        length=lead + lasts,
        trials=trials,
        gap=gap,
        random=True,
        events=(
            Event(do="show light on"),
            Event(do="show light off", at=1.0),
            Event(do=f"change load.values {load:g}", at=lead),
            Event(do="change load.values 0", at=lead + lasts - 1e-6),
        ),
    )
    return Scenario(
        name="heat",
        arena=CHAMBER,
        species=(body,),
        fields=(Field(name="load", values=0.0),),
        cues=(Cue(name="light"),),
        sessions=(trial,),
        ticks=ticks,
        sample_every=2,
    )
