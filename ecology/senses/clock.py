"""The sense of the time of day."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.spec import require
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class Clock(Sense):
    """Sense cosine and sine of the time of day."""

    @classmethod
    def check(cls, owner: str, day: float | None) -> None:
        """Raise EcologyError if the scenario has no day."""
        require(day is not None, f"{owner}: the sense 'clock' needs the scenario's day, the length of its period.")

    def __init__(self, whose: Perceiver) -> None:
        """Compile the sense."""
        self.components = tuple(Component(f"clock_{part}", "plain", 1.0, -1.0, 1.0) for part in ("cos", "sin"))

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write where the hand of a clock points that goes round once a day."""
        angle = 2 * math.pi * state.time / (model.scenario.day or 1.0)
        zeta[:, column : column + 2] = elementary.cosine_and_sine(angle)
