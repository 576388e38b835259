"""A day of foraging and a night to survive: sleep by two processes, and the energy budget rule.

Time is in hours. Sleepiness S rises to 1 with the time constant 18.2 h awake and falls to 0 with 4.2 h asleep. A body
that falls asleep at S = .62 and wakes at .09 is awake for 18.2 ln(.91 / .38) = 15.9 h and asleep for
4.2 ln(.62 / .09) = 8.1 h (Borbely 1982); thresholds that swing with the day keep sleep at a fixed hour.

There is food only from 0 to 16 h. A `steady` meal seldom fails; a `patchy` one nearly always fails, and is larger by
the same factor. At dusk the body must have R, the energy that the night costs. With a mean mu at dusk and a standard
deviation sigma, it survives the night with probability Phi((mu - R) / sigma). So steady meals are better where mu > R,
and patchy ones where mu < R (Stephens 1981). The drive alone is averse to risk, so only an agent whose J knows death
chooses patchy meals.
"""

from __future__ import annotations

from ecology import Event, Need, Resource, Scenario, Species, act, consume, rest
from ecology.scenarios.shared.chamber import CHAMBER, LEARNER, MIDDLE, STILL

DAY, DUSK = 24.0, 16.0  # hours
RISES, FALLS = 18.2, 4.2  # time constants of sleepiness, hours
UPPER, LOWER = 0.62, 0.09  # thresholds of sleepiness
STEADY, PATCHY = 0.8, 0.1  # chances of a meal, per hour


def build(
    start: float = 1.5, mean: float = 0.25, night: float = 5.0, dt: float = 1.0, count: int = 1, ticks: int = 240
) -> Scenario:
    """Return the chamber; `mean` is what an hour of foraging brings, `night` is R, `start` the energy at the start.

    Energy is lost only at night.
    """

    def share(chance: float) -> float:
        """Return what an hour brings if it succeeds with `chance`; a tick succeeds with 1 - (1 - chance)^dt."""
        return mean / (1 - (1 - chance) ** dt)

    needs = (
        Need(name="energy", set_point=10.0, start=start, bounds=(0.0, 20.0), lethal=True),
        Need(name="sleepiness", set_point=0.0, start=LOWER, decay=-1 / RISES, leak=1 / RISES, bounds=(0.0, 1.0)),
    )
    asleep = {"control": {"sleepiness": -1 / RISES}, "drain": {"sleepiness": 1 / FALLS - 1 / RISES}}
    body = Species(
        name="body",
        needs=needs,
        actions=(
            rest(),
            act("sleep", **asleep),
            consume("field", {"energy": share(STEADY)}, name="steady", chance=STEADY),
            consume("field", {"energy": share(PATCHY)}, name="patchy", chance=PATCHY),
        ),
        count=count,
        learner_settings={**LEARNER, "gamma": 0.95},
        **{**STILL, "senses": ("clock",)},
    )
    plenty = 1e6 * count
    return Scenario(
        name="night",
        arena=CHAMBER,
        resources=(Resource(name="field", position=MIDDLE, radius=0.5, stock=plenty),),
        species=(body,),
        schedule=(
            Event(do="empty field", at=DUSK, every=DAY),
            Event(do=f"change body.energy.decay {night / (DAY - DUSK):g}", at=DUSK, every=DAY),
            Event(do=f"refill field {plenty:g}", at=DAY, every=DAY),
            Event(do="change body.energy.decay 0", at=DAY, every=DAY),
        ),
        day=DAY,
        dt=dt,
        ticks=ticks,
        sample_every=1,
    )
