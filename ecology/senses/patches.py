"""The sense of a resource: the nearest patch of it that is seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary
from ecology.compiler_cache import compiled, use_cache
from ecology.elementary import angle_of
from ecology.ground import plane
from ecology.ground.plane import way_along, wrap_angle
from ecology.senses.base import Component, Perceiver, Perception, Sense, place_components
from ecology.state import Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__, plane.__file__, elementary.__file__)


class Patches(Sense):
    """Sense distance, bearing and fullness of the nearest patch of one resource; fullness where its stock is finite."""

    def __init__(self, whose: Perceiver, resource: str) -> None:
        """Compile the sense of `resource`."""
        names = [r.name for r in whose.resources]
        self._rows, self._far = whose.rows, whose.far
        self.components: tuple[Component, ...] = place_components(resource, whose.far)
        self._kind = names.index(resource) if resource in names else -1  # the scenario refuses an unknown one
        self._full = self._kind >= 0 and math.isfinite(whose.resources[self._kind].most)
        if self._full:
            self.components += (Component(f"{resource}_fullness", "plain", 0.5, 0.0, 1.0),)

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write where the patch is; the farthest distance and 0 where none is seen."""
        own, patch, first = zeta[:, column:], seen.nearest[:, self._kind], self._rows.start
        _write_places(
            own, self._far, patch, first, state.position, state.heading, state.resource_position, model.plane.period
        )
        if self._full:
            _write_fullness(own[:, 2], patch, first, state.stock, model.resources.capacity)


@compiled
def _write_places(
    zeta: np.ndarray,
    far: float,
    patch: Ints,
    first: int,
    position: Floats,
    heading: Floats,
    places: Floats,
    period: Floats,
) -> None:
    """Write distance and bearing of the `patch` (N,) that each sees, -1 none, into zeta (n, 2 or more).

    The rows of zeta are the slots from `first` on.
    """
    for row in range(len(zeta)):
        i = first + row
        r = patch[i]
        if r < 0:
            zeta[row, 0] = far
            continue
        dx = way_along(position[i, 0], places[r, 0], period[0])
        dy = way_along(position[i, 1], places[r, 1], period[1])
        zeta[row, 0] = min(math.sqrt(dx * dx + dy * dy), far)
        zeta[row, 1] = wrap_angle(angle_of(dy, dx) - heading[i])


@compiled
def _write_fullness(fullness: np.ndarray, patch: Ints, first: int, stock: Floats, capacity: Floats) -> None:
    """Write how full the `patch` (N,) is that each sees, -1 none, into zeta's column (n,), slots from `first` on."""
    for row in range(len(fullness)):
        r = patch[first + row]
        if r >= 0:
            fullness[row] = stock[r] / capacity[r]
