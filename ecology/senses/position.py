"""The sense of where one is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class Position(Sense):
    """Sense x and y in the arena."""

    def __init__(self, whose: Perceiver) -> None:
        """Compile the extent of the arena."""
        (left, bottom), (right, top) = whose.arena.extent
        self.components = (
            Component("x", "position", max((right - left) / 2, 1e-6), left, right),
            Component("y", "position", max((top - bottom) / 2, 1e-6), bottom, top),
        )
        self._rows = whose.rows

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write the positions."""
        zeta[:, column : column + 2] = state.position[self._rows]
