"""What is drawn of places: how strong fields are, and which doors are closed."""

from __future__ import annotations

import numpy as np

from ecology import fields
from ecology.fields import Compiled
from ecology.ground import Plane
from ecology.model import Model
from ecology.observers.maps import Grid, cover
from ecology.spec import Arena
from ecology.state import State

CELLS = 40  # along the longer side of the arena
SHADES = ((236, 112, 99), (93, 173, 226), (88, 190, 120), (175, 122, 197), (244, 208, 63))  # of fields, in turn
OPAQUE = 150  # of 255, where a field is strongest


def grid_of(arena: Arena) -> Grid:
    """Return the cells in which fields are drawn."""
    return cover(arena, CELLS)


def levels(model: Model, state: State, grid: Grid) -> dict[str, np.ndarray]:
    """Return how strong every field is in the cells of `grid`, by name: uint8 (rows, columns), 0 outside the arena.

    From `low` to `high` where these are finite, else from 0 to `scale`, or to the largest value if that is more.
    """
    if model.fields is None:
        return {}
    return {one.field.name: _level(one, state, model.plane, grid) for one in model.fields.each}


def _level(one: Compiled, state: State, plane: Plane, grid: Grid) -> np.ndarray:
    x, y = np.meshgrid(grid.x, grid.y)
    value = fields.sample(one, state, plane.home(np.stack([x.ravel(), y.ravel()], axis=1))).reshape(x.shape)
    low = one.field.low if np.isfinite(one.field.low) else min(0.0, float(value[grid.inside].min(initial=0.0)))
    high = one.field.high
    if not np.isfinite(high):
        high = max(low + one.field.scale, float(value[grid.inside].max(initial=low)))
    share = np.clip((value - low) / (high - low), 0.0, 1.0) * grid.inside
    return (255 * share).round().astype(np.uint8)


def field_colour(index: int) -> tuple[int, int, int]:
    """Return the colour of a field by its place in the scenario."""
    return SHADES[index % len(SHADES)]


def image(level: np.ndarray, index: int) -> np.ndarray:
    """Return the picture of a field, uint8 (rows, columns, 4): the stronger it is, the less shines through."""
    found = np.empty((*level.shape, 4), np.uint8)
    found[..., :3] = field_colour(index)
    found[..., 3] = level.astype(np.uint16) * OPAQUE // 255
    return found


def closed_doors(arena: Arena, doors: np.ndarray | None) -> list[np.ndarray]:
    """Return the doors that are closed, lines (2, 2), of which `doors` (D,) says which are open."""
    if doors is None:
        return []
    shut = [door for door, is_open in zip(arena.doors, doors.tolist(), strict=True) if not is_open]
    return [np.array([door.start, door.end], float) for door in shut]
