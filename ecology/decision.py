"""The decision of an agent, with its options and their scores: returned by a learner, drawn by observers."""

from __future__ import annotations

from dataclasses import dataclass

from ecology.state import Bools, Floats


@dataclass(frozen=True)
class Decision:
    """A choice between M options, with the numbers on which it was based; drives and scores in drive units."""

    options: tuple[str, ...]  # M names
    open: Bools  # (M,) which of them could be chosen
    next_drive: Floats  # (M,) predicted drive after each
    slope: Floats  # (M,) dJ/dzeta . f along each
    score: Floats  # (M,) what was compared: an agent that does not explore takes the least that is open
    taken: int  # index of the option that the agent takes
    explored: bool | None  # whether it was taken to explore, whatever the scores; None where that was not kept
    learned: bool  # whether anything was learned by then; without, scores are those of a random network
    value: float  # -ln(gamma) J at the time
    gamma: float  # discount per unit of time
    error: Floats  # (D,) error of f per component of zeta: 0 is perfect, 1 as bad as no change, NaN unknown
    age: int = 0  # ticks acted on it so far
    length: int | None = None  # ticks that it takes in all; None where the world ends it, as an arrival does
    zeta: Floats | None = None  # (D,) where it was made, None where that was not kept
    after: Floats | None = None  # (M, D) what f predicted of each option
    recalled: bool = False  # whether the numbers were computed afterwards, by what the agent knows by now

    @property
    def total(self) -> Floats:
        """Return the predicted drive plus the slope, (M,): the right side of the HJB equation, one option ahead."""
        return self.next_drive + self.slope


@dataclass(frozen=True)
class Plan:
    """The best that an agent sees ahead: k options, and the states that f predicts on the way."""

    options: tuple[str, ...]  # k names
    states: Floats  # (k + 1, D), from where it stands
    score: float  # what was compared, drive units
