"""Births, deaths, slots and the serial numbers that never return."""

from __future__ import annotations

import numpy as np

from ecology.physics import inside_polygon
from ecology.spec import Arena, Species
from ecology.state import Floats


def place(arena: Arena, species: Species, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return positions (count, 2) and headings (count,) at birth.

    Where the species fixes neither, they are drawn uniformly over the arena, a body's radius away
    from every wall, and over all directions.
    """
    if species.position is not None:
        position = np.tile(np.array(species.position, dtype=float), (count, 1))
    else:
        position = scatter(arena, species.radius, count, rng)
    if species.heading is not None:
        heading = np.full(count, float(species.heading))
    else:
        heading = rng.uniform(-np.pi, np.pi, count)
    return position, heading


def scatter(arena: Arena, margin: float, count: int, rng: np.random.Generator) -> Floats:
    """Return points (count, 2), uniform over the arena and at least `margin` from its walls."""
    import shapely  # slow to load, needed at births only

    room = shapely.Polygon(arena.vertices).buffer(-margin, join_style="mitre")
    parts = [np.array(p.exterior.coords)[:-1] for p in getattr(room, "geoms", [room])]
    low = np.min([p.min(axis=0) for p in parts], axis=0)
    high = np.max([p.max(axis=0) for p in parts], axis=0)
    found: list[Floats] = []
    have = 0
    while have < count:
        points = rng.uniform(low, high, (2 * (count - have) + 16, 2))
        kept = points[np.any([inside_polygon(p, points) for p in parts], axis=0)]
        found.append(kept)
        have += len(kept)
    return np.concatenate(found)[:count] if found else np.empty((0, 2))
