"""Two resources that lie elsewhere in the test: what was learned of places, carried over.

The first experiment of the follow-up (CTCS-HRRL 2024) on its square of 10 x 10. The agent learns with the
resources at (0.5, 4.25) and (3.5, 1.5); `test` has them half a unit away, where an agent in the middle of an
old circle (of radius 0.3) reaches nothing. Here everything happens in the simulator, while the follow-up's
tests follow the learned f. Train, then test:

    ecology run shifted
    ecology evaluate runs/shifted-0 --set test=true
"""

from __future__ import annotations

from ecology import Scenario
from ecology.scenarios.shared.square import square

SHIFTED = ({"position": (1.0, 4.25)}, {"position": (3.5, 2.0)})


def build(test: bool = False, numbers: str = "code", heading: bool = False, ticks: int = 40_000) -> Scenario:
    """Return the square; `test` moves the resources, `numbers` are of the authors' "code" or the paper's "text"."""
    return square("shifted", numbers, heading, ticks, SHIFTED if test else ({}, {}))
