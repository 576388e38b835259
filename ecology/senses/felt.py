"""What one feels of others, where affective empathy is perceived."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology.empathy import own_weights
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class Felt(Sense):
    """Sense what enters one's drive of others: a part of the drive (sum form), or of deviations (average form)."""

    def __init__(self, whose: Perceiver) -> None:
        """Compile what one feels; no components where it has no empathy, or does not perceive it."""
        species, empathy = whose.species, whose.species.empathy
        found: list[Component] = []
        if empathy is not None and empathy.perceived:
            own = own_weights(species, whose.everyone)
            if empathy.form == "sum":
                size = math.sqrt(sum(n.scale**2 for n in species.needs if n.regulated))
                own_weight = [max(map(abs, trait.bounds)) for trait in species.traits if trait.of == "empathy.weight"]
                largest = max(own_weight, default=abs(empathy.weight))
                found.append(Component("felt", "felt", max(largest * size, 1e-6), -math.inf, math.inf))
            found += [
                Component(f"felt_{n.name}", "felt", abs(1.0 - own[n.name]) * n.scale, -math.inf, math.inf, v)
                for v, n in enumerate(species.needs)
                if own[n.name] != 1.0
            ]
        self.components = tuple(found)
        self._rows = whose.rows
        self._columns = [max(component.felt_to, 0) for component in found]

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write the felt columns of the state."""
        for i, felt in enumerate(self._columns):
            zeta[:, column + i] = state.felt[self._rows, felt]
