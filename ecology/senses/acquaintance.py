"""What is sensed of others besides their place: their action, kinship and identity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ecology.life import are_kin
from ecology.senses.base import Component
from ecology.spec import Neighbours, Species
from ecology.state import Ints, State


class Acquaintance:
    """The components of one neighbour's action, kinship and identity, in this order."""

    def __init__(self, sensed: Neighbours, kinds: Sequence[Species], everyone: Sequence[Species]) -> None:
        """Compile what `sensed` says of the species `kinds`, of `everyone`."""
        self._sensed = sensed
        self._names = list(dict.fromkeys(a.name for s in kinds for a in s.actions)) if sensed.action else []
        self._index = np.full((len(everyone), max(len(s.actions) for s in everyone)), -1)  # by species and action
        for i, s in enumerate(everyone):
            if s in kinds and sensed.action:
                self._index[i, : len(s.actions)] = [self._names.index(a.name) for a in s.actions]
        self.width = len(self._names) + sensed.kin + sensed.identity

    def components(self, one: str) -> list[Component]:
        """Return the components of the neighbour that is called `one`."""
        found = [Component(f"{one}_does_{name}", "plain", 0.5, 0.0, 1.0) for name in self._names]
        if self._sensed.kin:
            found.append(Component(f"{one}_is_kin", "plain", 0.5, 0.0, 1.0))
        return found + [Component(f"{one}_mark_{i + 1}", "plain", 1.0, -1.0, 1.0) for i in range(self._sensed.identity)]

    def write(self, zeta: np.ndarray, column: int, state: State, species_of: Ints, who: Ints, other: Ints) -> None:
        """Write what the slots `who` (k,), in the rows of zeta (k, D), sense of `other` (k,), from `column` on."""
        rows = np.arange(len(who))
        if self._names:
            does = self._index[species_of[other], state.action[other]]
            zeta[rows, column + does] = 1.0
            column += len(self._names)
        if self._sensed.kin:
            zeta[:, column] = are_kin(state, who, other)
            column += 1
        for i in range(self._sensed.identity):
            zeta[:, column + i] = 2.0 * ((state.serial[other] >> i) & 1) - 1.0
