"""The sense of a resource: the nearest patch of it that is seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary, resources
from ecology.compiler_cache import compiled, use_cache
from ecology.elementary import angle_of
from ecology.ground import plane
from ecology.ground.plane import way_along, wrapped
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
        if self._kind >= 0 and math.isfinite(whose.resources[self._kind].most):
            self.components += (Component(f"{resource}_fullness", "plain", 0.5, 0.0, 1.0),)

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write where the patch is; the farthest distance and 0 where none is seen."""
        own, patch = zeta[:, column : column + len(self.components)], seen.nearest[:, self._kind]
        _write_patches(
            own, self._far, patch, self._rows.start, state.position, state.heading, seen.patches, model.plane.period
        )


@compiled
def _write_patches(
    zeta: np.ndarray,
    far: float,
    patch: Ints,
    first: int,
    position: Floats,
    heading: Floats,
    patches: resources.Patches,
    period: Floats,
) -> None:
    """Write distance and bearing of the `patch` (N,) that each sees, -1 none, into zeta (n, 2 or 3).

    The rows of zeta are the slots from `first` on; a third column is for the fullness of the patch.
    """
    for row in range(len(zeta)):
        i = first + row
        r = patch[i]
        if r < 0:
            zeta[row, 0] = far
            continue
        dx = way_along(position[i, 0], patches.position[r, 0], period[0])
        dy = way_along(position[i, 1], patches.position[r, 1], period[1])
        zeta[row, 0] = min(math.sqrt(dx * dx + dy * dy), far)
        zeta[row, 1] = wrapped(angle_of(dy, dx) - heading[i])
        if zeta.shape[1] > 2:
            zeta[row, 2] = patches.stock[r] / patches.capacity[r]
