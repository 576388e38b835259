"""The sense of what one carries."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class Load(Sense):
    """Sense how much of each thing one carries, as a share of the most."""

    def __init__(self, whose: Perceiver) -> None:
        """Compile what the species carries."""
        names = [r.name for r in whose.resources]
        carried = [name for name in whose.species.carries if name in names]
        self.components = tuple(Component(f"load_{name}", "plain", 0.5, 0.0, 1.0) for name in carried)
        self._rows, self._columns = whose.rows, [names.index(name) for name in carried]

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write the shares."""
        assert state.load is not None
        assert model.hauling is not None
        for i, k in enumerate(self._columns):
            zeta[:, column + i] = state.load[self._rows, k] / model.hauling.most[self._rows, k]
