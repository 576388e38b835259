"""All geometry of the arena: rings, holes, inner walls, the torus, and what bodies and sight ask of them."""

from __future__ import annotations

from ecology.ground.outline import check_outline, split_room
from ecology.ground.plane import Plane, plane_of, wrap
from ecology.ground.scatter import scatter_in
from ecology.ground.shape import Ground, ground_of, scatter
from ecology.ground.walls import Walls

__all__ = [
    "Ground",
    "Plane",
    "Walls",
    "check_outline",
    "ground_of",
    "plane_of",
    "scatter",
    "scatter_in",
    "split_room",
    "wrap",
]
