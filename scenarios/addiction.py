"""A set point that moves with the intake of a drug: intake escalates with long access, and not with short access.

Time is in trials of 4 s. A press infuses a dose into a buffer. Per trial, an eighth of the buffer enters the brain,
and the brain loses .7 %. The set point of the brain's level rises with every unit infused and falls back by itself,
day and night, but never below where it began. At the set point h* the rate is .126 h* infusions an hour, so a day with
T hours of access changes h* by .09 (.126 h* T + h* / 50) - 3.456: up only where T is more than 2.9 hours at h* = 100.
After Keramati, Durand, Girardeau, Gutkin and Ahmed (2017).
"""

from __future__ import annotations

from ecology import Adaptation, Cue, Event, Need, Resource, Scenario, Session, Species, consume, rest
from ecology.scenarios.shared.chamber import CHAMBER, LEARNER, MIDDLE, STILL

HOUR, DAY = 900, 21_600  # trials of 4 s
DOSE, ENTERS, LEAVES = 50.0, 0.12, 0.007  # units; shares per trial
RISE, RECOVERY = 0.0018, 0.00016  # of the set point, per unit infused and per trial
START, MOST = 100.0, 200.0  # of the set point


def build(
    hours: float = 6.0,
    days: int = 12,
    acquisition: int = 1,
    hurry: float = 30.0,
    dt: float = 1.0,
    count: int = 1,
    ticks: int = 0,
) -> Scenario:
    """Return the chamber with `hours` of access a day, after days of `acquisition` with one; `ticks` 0 means all days.

    A press is a dose per tick of dt trials.
    At night, nothing but the recovery of h* happens. The night is `hurry` times shorter, and the recovery `hurry` times
    faster.
    """
    level = Need(
        name="level", set_point=START, start=0.0, leak=LEAVES, bounds=(0.0, 400.0), set_range=(START, MOST),
        adaptation=Adaptation(gain=RISE, recovery=RECOVERY, by="buffer"),
    )  # fmt: skip
    buffer = Need(
        name="buffer", set_point=400.0, start=0.0, leak=ENTERS, bounds=(0.0, 400.0), regulated=False,
        feeds={"level": 1.0},
    )  # fmt: skip
    user = Species(
        name="user",
        needs=(level, buffer),
        actions=(
            rest(),
            consume("drug", {"buffer": DOSE / dt}, name="press", cue="lever", closes_at={"buffer": 100.0}),
        ),
        cues=("lever",),
        count=count,
        drive_power=4.0,
        drive_exponent=4 / 3,
        learner_settings=LEARNER,
        **STILL,
    )
    path = "change user.level.adaptation.recovery"

    def days_of(name: str, open_for: float, trials: int) -> Session:
        access = HOUR * open_for
        return Session(
            name=name,
            trials=trials,
            length=access + (DAY - access) / hurry,
            events=(
                Event(do="show lever on"),
                Event(do=f"{path} {RECOVERY}"),
                Event(do="show lever off", at=access),
                Event(do=f"{path} {RECOVERY * hurry}", at=access),
            ),
        )

    sessions = (days_of("training", 1.0, acquisition), days_of("access", hours, days))
    return Scenario(
        name="addiction",
        arena=CHAMBER,
        species=(user,),
        resources=(Resource(name="drug", position=MIDDLE),),
        cues=(Cue(name="lever"),),
        sessions=sessions,
        dt=dt,
        ticks=ticks or int(sum(s.trials * s.length for s in sessions) / dt),
    )
