"""Tolerance to ethanol, which cools the body: shivering an hour before it, when a light announces it.

There is one trial a day. While the light is on, the rat can shiver; sixty minutes later it is given ethanol, or
nothing. Time is in minutes, temperature h is a change from normal, in degrees, and the drive is |h|. Both responses
are sums of two exponentials, each two compartments that leak:

    ethanol      1.9635 (exp(-.04064 L) - exp(-.003632 L)),   coldest -1.41 at L = 65
    shivering    .015 L exp(-.0047045 L),                     warmest +1.17 at L = 213

Four blocks of trials follow each other: the light alone, light and ethanol, the light alone, light and ethanol again.
After Keramati and Gutkin (2014), on the rats of Mansfield and Cunningham (1980).
"""

from __future__ import annotations

import math
from typing import Any

from ecology import Cue, Event, Need, Scenario, Session, Species, Trace, act, rest
from ecology.scenarios.shared.chamber import CHAMBER, LEARNER, STILL

DAY, LATER = 1440.0, 60.0  # minutes: between trials, and from the light to the ethanol
ETHANOL, SLOW, FAST = 1.9635, 0.003632, 0.04064  # degrees; rates per minute
WARMTH, WANES = 0.015, 0.0047045  # degrees per minute, rate per minute
FORGETS = 0.02  # rate at which the memory of the light fades, per minute: it tells the hour before from all others
# of hjb, minutes: one choice a day, so it explores for weeks and learns most from the last ones
PATIENT = {
    "epsilon": 0.5, "epsilon_final": 0.1, "youth": 30_000.0, "settling": 60_000.0, "updates": 4, "recent_share": 0.4,
    "relative_weight": 2,
}  # fmt: skip
BLOCKS = (("habituation", 24, False), ("acquisition", 24, True), ("extinction", 12, False), ("reacquisition", 3, True))


def build(gamma: float = 0.995, dt: float = 10.0, count: int = 1, ticks: int = 0) -> Scenario:
    """Return the chamber; `gamma` is the learner's discount per minute, `ticks` 0 means all 63 days."""

    def leak(rate: float) -> float:
        """Return the leak whose Euler step of dt is exp(-rate dt)."""
        return (1 - math.exp(-rate * dt)) / dt

    # shivering fills the first compartment, which empties into the second; h follows the second. After the tick in
    # which the rat shivers, all three are where they are a time dt after an impulse
    left = math.exp(-WANES * dt)
    gain = WARMTH * dt * left / (1 - left)
    shiver = {"effort": left / dt, "warmth": (1 - left) / dt, "temperature": WARMTH * left}
    hidden: dict[str, Any] = {"set_point": 0.0, "regulated": False, "bounds": (0.0, 4.0)}
    needs = (
        Need(name="temperature", set_point=0.0, bounds=(-5.0, 5.0)),
        Need(name="cold_slow", leak=leak(SLOW), feeds={"temperature": 1.0}, **hidden),
        Need(name="cold_fast", leak=leak(FAST), feeds={"temperature": -1.0}, **hidden),
        Need(name="effort", leak=leak(WANES), feeds={"warmth": 1.0, "temperature": gain}, **hidden),
        Need(name="warmth", leak=leak(WANES), feeds={"temperature": -gain}, **hidden),
    )
    rat = Species(
        name="rat",
        needs=needs,
        # grooming is always open and does nothing: without a choice, f/J would take all that follows for one movement
        actions=(rest(), act("shiver", cue="light", control=shiver), act("groom")),
        cues=("light",),
        count=count,
        drive_epsilon=1e-6,
        learner_settings={**LEARNER, **PATIENT, "gamma": gamma},
        **{**STILL, "senses": (Trace(of="light", rate=FORGETS),)},
    )
    anew = tuple(Event(do=f"set rat {need.name} 0", felt=False) for need in needs)
    light = (Event(do="show light on"), Event(do="show light off", at=dt))
    dose = tuple(Event(do=f"set rat cold_{which} {ETHANOL}", at=LATER) for which in ("slow", "fast"))
    sessions = tuple(
        Session(name=name, trials=trials, length=DAY, events=(*anew, *light, *(dose if ethanol else ())))
        for name, trials, ethanol in BLOCKS
    )
    days = sum(trials for _, trials, _ in BLOCKS)
    return Scenario(
        name="anticipation",
        arena=CHAMBER,
        species=(rat,),
        cues=(Cue(name="light"),),
        sessions=sessions,
        dt=dt,
        ticks=ticks or round(days * DAY / dt),
    )
