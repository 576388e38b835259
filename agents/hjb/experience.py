"""What a movement that has ended leaves in the replay buffer: where it led, how long it took, and the drive met."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary

if TYPE_CHECKING:
    from ecology.agents.hjb.learner import HJB


def remember(learner: HJB, slots: np.ndarray, observations: np.ndarray) -> None:
    """Store the movements of `slots` (k,) that have just ended at `observations` (n, D).

    With `intra_option`, a state passed on the way is stored too. Where the end of the movement from there is
    unknown, the state serves L_J alone.
    """
    way, memory, after = learner.execution, learner.memory, observations[slots]
    began, felt = way.began[slots], way.felt[slots]
    took = way.elapsed[slots] * learner.group.dt
    excess = excess_of(learner, slots, began, felt, took)
    memory.add(slots, began, way.movement[slots], after, took, way.was_open[slots], excess)
    if not learner.settings.intra_option:
        return
    passed, some, same = way.draw_passed(slots, learner.rng.random(learner.size)[slots])
    slots, passed = slots[some], passed[some]
    began, left = way.trail[slots, passed], took[some] - passed * learner.group.dt
    excess = excess_of(learner, slots, began, felt[some] - way.trail_felt[slots, passed], left)
    memory.add(slots, began, same[some], after[some], left, way.trail_open[slots, passed], excess)


def excess_of(
    learner: HJB, slots: np.ndarray, began: np.ndarray, felt: np.ndarray, took: np.ndarray
) -> np.ndarray | None:
    """Return the discounted drive (k,) that `slots` (k,) met in the time `took`, less that at `began` (k, D).

    `felt` (k,) is the sum of the drive over the ticks. None where f does not predict it.
    """
    if not learner.encoding.costed:
        return None
    gamma = np.broadcast_to(learner.number("gamma"), learner.size)[slots]
    mean = felt / np.maximum(took / learner.group.dt, 1)
    found: np.ndarray = (1 - elementary.exp(elementary.log(gamma) * took)) * (mean - learner.drive(began))
    return found
