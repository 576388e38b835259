"""The sense of a field: its value where one is, and how it changes ahead and to the left."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary, fields
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.spec import Gauge
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


class GaugeSense(Sense):
    """Sense the value of a field, its gradient, or both."""

    def __init__(self, whose: Perceiver, sensed: Gauge) -> None:
        """Compile what `sensed` says; the scenario refuses a field that is not there."""
        found = [f for f in whose.fields if f.name == sensed.field]
        self._rows, self._sensed = whose.rows, sensed
        self.components = ()
        for f in found:
            if sensed.value:
                self.components += (Component(f.name, "plain", f.scale, f.low, f.high),)
            if sensed.gradient:
                size = max(b - a for a, b in zip(*whose.arena.extent, strict=True))
                scale = f.scale / size
                self.components += tuple(
                    Component(f"{f.name}_{way}", "plain", scale, -math.inf, math.inf) for way in ("ahead", "left")
                )

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write value and gradient; a dead body senses nothing."""
        assert model.fields is not None
        one = model.fields.each[model.fields.index(self._sensed.field)]
        points = state.position[self._rows]
        if self._sensed.value:
            zeta[:, column] = fields.sample(one, state, points)
            column += 1
        if self._sensed.gradient:
            heading, rise = state.heading[self._rows], fields.slope(one, state, model.plane, points)
            cos, sin = elementary.cos(heading), elementary.sin(heading)
            zeta[:, column] = cos * rise[:, 0] + sin * rise[:, 1]
            zeta[:, column + 1] = cos * rise[:, 1] - sin * rise[:, 0]
