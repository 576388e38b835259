"""The deviations delta of one's own needs, the first part of zeta."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ecology import physiology
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class Deviations(Sense):
    """Sense how far every need is from its set point."""

    def __init__(self, whose: Perceiver) -> None:
        """Compile the deviations of the needs of `whose` species."""
        self.components = tuple(Component(n.name, "deviation", n.scale, *n.deviations) for n in whose.species.needs)
        self._rows, self._width = whose.rows, len(self.components)

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write x - x*."""
        rows, width = self._rows, self._width
        set_point = physiology.set_points(model.body, state)
        zeta[:, column : column + width] = state.internal[rows, :width] - set_point[rows, :width]
