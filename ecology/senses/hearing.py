"""The sense of signals: what the nearest other that sends on a channel says, and where it is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary
from ecology.ground import wrap
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.spec import Hearing
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class HearingSense(Sense):
    """Sense content, distance and bearing of the nearest signal on a channel; walls do not stop it."""

    def __init__(self, whose: Perceiver, sensed: Hearing) -> None:
        """Compile what every action of every species sends."""
        self._rows, self._sensed = whose.rows, sensed
        everyone, name = whose.everyone, sensed.channel
        self._sent = np.full((len(everyone), max(len(s.actions) for s in everyone)), np.nan)  # by species and action
        for i, s in enumerate(everyone):
            self._sent[i, : len(s.actions)] = [action.emits.get(name, np.nan) for action in s.actions]
        said = [0.0, *self._sent[np.isfinite(self._sent)].tolist()]
        size = max(max(map(abs, said)), 1e-6)
        self.components = (
            Component(name, "plain", size, min(said), max(said)),
            Component(f"{name}_distance", "plain", sensed.range / 2, 0.0, sensed.range),
            Component(f"{name}_bearing", "angle", math.pi, -math.pi, math.pi),
        )

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write the nearest signal; 0, the range and 0 where none is heard."""
        rows, pairs = self._rows, seen.pairs
        assert pairs is not None
        zeta[:, column + 1] = self._sensed.range
        first, last = pairs.starts[rows.start], pairs.starts[rows.stop]
        other = pairs.other[first:last]
        content = self._sent[model.species_of[other], state.action[other]]
        heard = np.flatnonzero(np.isfinite(content) & (pairs.distance[first:last] <= self._sensed.range))
        who, nearest = np.unique(pairs.who[first + heard], return_index=True)  # of each, the nearest comes first
        at, row = heard[nearest], who - rows.start
        gap = pairs.gap[first + at]
        zeta[row, column] = content[at]
        zeta[row, column + 1] = pairs.distance[first + at]
        zeta[row, column + 2] = wrap(elementary.arctan2(gap[:, 1], gap[:, 0]) - state.heading[who])
