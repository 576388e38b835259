"""The sense of where one heads."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class Heading(Sense):
    """Sense one's heading, radians from the x axis."""

    def __init__(self, whose: Perceiver) -> None:
        """Compile the sense."""
        self.components = (Component("heading", "angle", math.pi, -math.pi, math.pi),)
        self._rows = whose.rows

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write the headings."""
        zeta[:, column] = state.heading[self._rows]
