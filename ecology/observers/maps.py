"""Deviation maps: J over the arena for one need at its worst, as in the paper's results figure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ecology.ground import ground_of
from ecology.model import Group
from ecology.observers.base import Mind
from ecology.spec import Arena, Species
from ecology.state import Bools, Floats

MAPS = 4  # the most needs that are mapped
CELLS = 80  # along the longer side of the arena


@dataclass(frozen=True)
class Grid:
    """Square cells that cover an arena; row 0 is the lowest y, column 0 the lowest x."""

    x: Floats  # (columns,) of the cells' centres
    y: Floats  # (rows,)
    cell: float  # side, length
    inside: Bools  # (rows, columns) whether the centre lies in the arena

    @property
    def corner(self) -> tuple[float, float]:
        """Return the lower left corner of the first cell."""
        return float(self.x[0] - self.cell / 2), float(self.y[0] - self.cell / 2)


def cover(arena: Arena, cells: int = CELLS) -> Grid:
    """Return a grid over `arena` with `cells` along its longer side."""
    vertices = np.array(arena.vertices, dtype=float)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    cell = float((high - low).max()) / cells
    x, y = (np.arange(low[i] + cell / 2, high[i] + cell / 4, cell) for i in range(2))
    points = np.stack(np.meshgrid(x, y), axis=-1)  # (rows, columns, 2)
    inside = ground_of(arena).inside(points.reshape(-1, 2)).reshape(points.shape[:2])
    return Grid(x=x, y=y, cell=cell, inside=inside)


def mapped_needs(species: Species) -> list[int]:
    """Return which needs are mapped: the first four regulated ones whose set point is positive."""
    return [i for i, need in enumerate(species.needs) if need.regulated and need.set_point > 0][:MAPS]


def deviation_maps(species: Species, group: Group, mind: Mind, slot: int, grid: Grid) -> Floats | None:
    """Return the deviation map of every mapped need, (k, rows, columns) in drive units, NaN outside.

    Map i stands for the states zeta with need i at -x_i* (or its lower bound, if that is nearer),
    every other deviation 0, heading 0 and the position of the cell (paper, section "Results").
    `slot` counts within the species. None without a J, or for an agent that does not sense where it is.
    """
    layout, needs = group.layout, mapped_needs(species)
    if not needs or "x" not in layout.names:
        return None
    rows, columns = np.nonzero(grid.inside)
    zeta = np.zeros((len(needs), len(rows), len(layout.names)), np.float32)
    zeta[:, :, layout.names.index("x")] = grid.x[columns]
    zeta[:, :, layout.names.index("y")] = grid.y[rows]
    if "clock_cos" in layout.names:  # the clock stands at 0
        zeta[:, :, layout.names.index("clock_cos")] = 1.0
    for i, need in enumerate(needs):
        zeta[i, :, need] = max(-species.needs[need].set_point, layout.low[need])
    value = mind.deviation(slot, zeta.reshape(-1, zeta.shape[2]))
    if value is None:
        return None
    maps = np.full((len(needs), *grid.inside.shape), np.nan)
    maps[:, rows, columns] = np.asarray(value, dtype=float).reshape(len(needs), -1)
    return maps
