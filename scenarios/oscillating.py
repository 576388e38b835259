"""Two resources that swing back and forth, faster in the test than where the agent learned.

The third experiment of the follow-up (CTCS-HRRL 2024) on its square of 10 x 10: triangle waves of one unit's
width, the first resource's along x, the second's along y. The period is 1000 while learning, 500 (or 750) in
the `test`. The agent sees where to go (go_to leads to where a resource is now) but not its phase.
 Train, then test:

    ecology run oscillating
    ecology evaluate runs/oscillating-0 --set test=true
"""

from __future__ import annotations

from ecology import Oscillation, Scenario
from ecology.scenarios.shared.square import square

SWINGS = (((0.5, 4.25), (1.5, 4.25)), ((3.5, 1.5), (3.5, 2.5)))  # of each resource: from, to


def build(
    test: bool = False,
    period: float = 1000.0,
    period_in_test: float = 500.0,
    numbers: str = "code",
    heading: bool = False,
    ticks: int = 40_000,
) -> Scenario:
    """Return the square; periods are in units of time, `numbers` of the authors' "code" or the paper's "text"."""
    every = period_in_test if test else period
    swings = tuple({"position": a, "motion": Oscillation(to=b, period=every)} for a, b in SWINGS)
    return square("oscillating", numbers, heading, ticks, swings)
