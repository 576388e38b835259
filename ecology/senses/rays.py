"""The sense of walls: how far they are in several directions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary
from ecology.compiler_cache import compiled, use_cache
from ecology.elementary import cosine_and_sine
from ecology.ground import walls as ground_walls
from ecology.ground.walls import Walls, reach
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.spec import Rays
from ecology.state import Floats, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__, ground_walls.__file__, elementary.__file__)


class RaySense(Sense):
    """Sense the distance to the nearest wall along rays from the body's centre; closed doors are walls."""

    def __init__(self, whose: Perceiver, sensed: Rays) -> None:
        """Compile the directions: the first ray is the one farthest to the right, the middle one points ahead."""
        self._rows, self._range = whose.rows, sensed.range
        places = np.arange(sensed.count)
        whole = sensed.spread >= 2 * np.pi - 1e-9  # all around, from the back on
        share = places / sensed.count if whole else places / max(sensed.count - 1, 1)
        self._angles = -sensed.spread / 2 + sensed.spread * share if sensed.count > 1 else np.zeros(1)
        self.components = tuple(
            Component(f"ray_{i + 1}", "plain", sensed.range / 2, 0.0, sensed.range) for i in range(sensed.count)
        )

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write the distances, at most the range."""
        rows = self._rows
        if model.ground.torus:
            zeta[:, column : column + len(self._angles)] = self._range
            return
        walls = model.ground.walls
        cast(zeta, column, state.position[rows], state.heading[rows], self._angles, self._range, walls)


@compiled
def cast(
    zeta: np.ndarray,
    column: int,
    position: Floats,
    heading: Floats,
    angles: Floats,
    far: float,
    walls: Walls,
) -> None:
    """Write the distances to the nearest wall from `position` (n, 2) along `heading` (n,) + `angles` (k,), at most far.

    They stand in zeta (n, D) from `column` on.
    """
    for i in range(len(position)):
        for a in range(len(angles)):
            dx, dy = cosine_and_sine(heading[i] + angles[a])
            zeta[i, column + a] = reach(walls, position[i, 0], position[i, 1], dx, dy, far)
