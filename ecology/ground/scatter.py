"""Places at random, uniform over shapely polygons."""

from __future__ import annotations

from typing import Any

import numpy as np

from ecology.errors import EcologyError
from ecology.ground.walls import inside_rings, walls_of
from ecology.state import Floats

ROUNDS = 1_000  # of at least 18 points at random, none of them inside, after which an arena is too thin


def scatter_in(room: Any, count: int, rng: np.random.Generator, where: str) -> Floats:
    """Return points (count, 2), uniform over the polygons of the shapely geometry `room`; `where` says what it is."""
    polygons = [part for part in getattr(room, "geoms", [room]) if part.geom_type == "Polygon"]
    rings = [np.array(ring.coords)[:-1] for part in polygons for ring in (part.exterior, *part.interiors)]
    low = np.min([ring.min(axis=0) for ring in rings], axis=0)
    high = np.max([ring.max(axis=0) for ring in rings], axis=0)
    walls = walls_of(rings)
    found: list[Floats] = []
    have = 0
    fruitless = 0  # rounds in a row
    while have < count:
        if fruitless == ROUNDS:
            raise EcologyError(
                f"{count} places, {where}, are not found at random in an arena this thin; widen it, or give positions."
            )
        points = rng.uniform(low, high, (2 * (count - have) + 16, 2))
        kept = points[inside_rings(walls, points)]
        found.append(kept)
        have += len(kept)
        fruitless = 0 if len(kept) else fruitless + 1
    return np.concatenate(found)[:count]
