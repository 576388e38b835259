"""Two resources that are not always there, and less often in the test than where the agent learned.

The second experiment of the follow-up (CTCS-HRRL 2024) on its square of 10 x 10: in every unit of time each
resource is available with probability 0.9, and 0.8 in the `test`. While one is away, agents can neither eat
from it nor walk to it. Train, then test:

    ecology run probabilistic
    ecology evaluate runs/probabilistic-0 --set test=true
"""

from __future__ import annotations

from ecology import Scenario
from ecology.scenarios.shared.square import square


def build(
    test: bool = False,
    available: float = 0.9,
    available_in_test: float = 0.8,
    numbers: str = "code",
    heading: bool = False,
    ticks: int = 40_000,
) -> Scenario:
    """Return the square; probabilities are per unit of time, `numbers` of the authors' "code" or the paper's "text"."""
    settings = {"availability": available_in_test if test else available}
    return square("probabilistic", numbers, heading, ticks, (settings, settings))
