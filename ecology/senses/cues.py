"""The sense of cues: what is shown to everybody, wherever it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class Cues(Sense):
    """Sense the cues that a species attends to, from 0 to 1; no components where it attends to none."""

    def __init__(self, whose: Perceiver) -> None:
        """Compile the sense."""
        self._names = whose.species.cues
        self.components = tuple(Component(name, "plain", 0.5, 0.0, 1.0) for name in self._names)

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write what is shown."""
        assert state.cue is not None
        for i, name in enumerate(self._names):
            zeta[:, column + i] = state.cue[model.cues[name]]
