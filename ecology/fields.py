"""Fields over the plane: a function, a grid, or a grid that diffuses, fades and is fed; and what they act on.

A field that changes is a part of `state.grid`, one field after the other, a value per cell: row by row from low y to
high, each from low x to high. Shapes: N slots, n points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ecology import elementary
from ecology.errors import EcologyError
from ecology.ground import Ground, Plane
from ecology.spec import Exposure, Field, Species
from ecology.state import Bools, Floats, State

if TYPE_CHECKING:
    from ecology.model import Model

STABLE = 0.2  # of a cell's content that flows to one neighbour in a step of diffusion, at most
STEP = 1e-4  # of the arena's longer side, over which the slope of a function is measured


@dataclass(frozen=True, eq=False)
class Cells:
    """A grid over the extent of an arena."""

    count: tuple[int, int]  # along y and x
    size: Floats  # (2,) of a cell, along x and y
    low: Floats  # (2,)
    torus: bool
    rows: slice  # of `state.grid`, or an empty one of a grid that stays
    inside: Bools  # (ny, nx) whether the centre lies in the arena
    right: Bools  # (ny, nx) whether there is a way from a cell to the next one along x
    above: Bools  # (ny, nx) the same along y

    def at(self, values: Floats, points: Floats) -> Floats:
        """Return what a grid of `values` (ny, nx) holds at points (n, 2), linear between the centres of cells, (n,)."""
        place = (points - self.low) / self.size - 0.5
        ny, nx = self.count
        if not self.torus:
            place = np.clip(place, 0.0, [nx - 1, ny - 1])
        first = np.floor(place).astype(np.int64)
        share = place - first
        total, weight = np.zeros(len(points)), np.zeros(len(points))
        for dx in (0, 1):
            for dy in (0, 1):
                x, y = first[:, 0] + dx, first[:, 1] + dy
                x, y = (x % nx, y % ny) if self.torus else (np.minimum(x, nx - 1), np.minimum(y, ny - 1))
                part = np.abs(1 - dx - share[:, 0]) * np.abs(1 - dy - share[:, 1]) * self.inside[y, x]
                total += part * values[y, x]
                weight += part
        return np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)

    def cell(self, points: Floats) -> tuple[np.ndarray, np.ndarray]:
        """Return row and column of the cells in which points (n, 2) lie, each (n,)."""
        at = ((points - self.low) / self.size).astype(np.int64)
        return np.clip(at[:, 1], 0, self.count[0] - 1), np.clip(at[:, 0], 0, self.count[1] - 1)


@dataclass(frozen=True, eq=False)
class Compiled:
    """The constants of one field."""

    field: Field
    cells: Cells | None  # None of a function
    grid: Floats | None  # (ny, nx) of a grid that stays, and of one that changes at the start; None of a function
    changes: bool
    sources: tuple[tuple[bool, slice, float], ...]  # whether bodies, their rows, and what each gives per unit of time
    step: float  # length over which the slope is measured


@dataclass(frozen=True, eq=False)
class Fields:
    """All fields of a world, and what they act on."""

    each: tuple[Compiled, ...]
    exposed: tuple[tuple[slice, Exposure, int, tuple[tuple[int, float], ...]], ...]  # slots, how, field, (need, rate)
    size: int  # of `state.grid`

    @property
    def slows(self) -> bool:
        """Return whether any field acts on speed."""
        return any(exposure.slowing for _, exposure, _, _ in self.exposed)

    @property
    def dims(self) -> bool:
        """Return whether any field acts on sight."""
        return any(exposure.dimming for _, exposure, _, _ in self.exposed)

    def index(self, name: str) -> int:
        """Return the place of the field `name`."""
        return next(i for i, each in enumerate(self.each) if each.field.name == name)


# ---- compiling ---------------------------------------------------------------------------------


def compile_fields(
    fields: Sequence[Field],
    species: Sequence[Species],
    ground: Ground,
    patches: Mapping[str, slice],
    slots: Mapping[str, slice],
) -> Fields | None:
    """Return the constants of `fields`, None where there are none."""
    if not fields:
        return None
    each, at = [], 0
    for field in fields:
        longer = float(ground.plane.size.max())
        if callable(field.values):
            each.append(Compiled(field, None, None, False, (), STEP * longer))
            continue
        if isinstance(field.values, tuple):
            grid = np.array(field.values, float)
        else:
            count = np.maximum(np.round(field.cells * ground.plane.size / longer).astype(int), 1)
            grid = np.full((count[1], count[0]), float(field.values))
        rows = slice(at, at + grid.size) if field.changes else slice(at, at)
        at = rows.stop
        cells = _cells(grid.shape, rows, ground, walls=field.changes)
        sources = tuple(
            (name in slots, slots[name] if name in slots else patches[name], rate)
            for name, rate in field.sources.items()
        )
        grid = np.where(cells.inside, grid, 0.0)
        each.append(Compiled(field, cells, grid, field.changes, sources, float(cells.size.min()) / 2))
    names = [field.name for field in fields]
    exposed = []
    for s in species:
        column = {need.name: i for i, need in enumerate(s.needs)}
        for e in s.exposures:
            needs = tuple((column[name], rate) for name, rate in e.control.items())
            exposed.append((slots[s.name], e, names.index(e.field), needs))
    return Fields(tuple(each), tuple(exposed), at)


def _cells(shape: tuple[int, ...], rows: slice, ground: Ground, *, walls: bool) -> Cells:
    """Return a grid of `shape` (ny, nx) over the arena; with `walls`, nothing flows through them."""
    ny, nx = shape
    plane = ground.plane
    size = plane.size / (nx, ny)
    x, y = np.meshgrid(np.arange(nx), np.arange(ny))
    centres = plane.low + (np.stack([x, y], axis=-1) + 0.5) * size  # (ny, nx, 2)
    inside, right, above = np.ones((3, ny, nx), bool)
    if not plane.torus:
        right[:, -1] = above[-1] = False
        if walls:
            inside = ground.inside(centres.reshape(-1, 2)).reshape(ny, nx)
            for way, step in ((right, (size[0], 0.0)), (above, (0.0, size[1]))):
                begin = centres[way & inside]
                open_ = np.zeros((ny, nx), bool)
                open_[way & inside] = np.logical_and(ground.stays(begin, begin + step), ground.inside(begin + step))
                way[:] = open_
    return Cells((ny, nx), size, plane.low, plane.torus, rows, inside, right, above)


def around_walls(fields: Fields | None, ground: Ground) -> Fields | None:
    """Return `fields` that flow where another `ground`, with other doors open, lets them."""
    if fields is None or not any(each.changes for each in fields.each):
        return fields
    each = tuple(
        replace(one, cells=_cells(one.cells.count, one.cells.rows, ground, walls=True))
        if one.changes and one.cells is not None
        else one
        for one in fields.each
    )
    return replace(fields, each=each)


def first_grid(fields: Fields | None) -> Floats | None:
    """Return the fields that change at the start, (M,), None where none does."""
    if fields is None or not fields.size:
        return None
    return np.concatenate([one.grid.ravel() for one in fields.each if one.changes and one.grid is not None])


# ---- what fields are ---------------------------------------------------------------------------


def sample(one: Compiled, state: State, points: Floats) -> Floats:
    """Return the values of a field at points (n, 2), within its bounds, (n,)."""
    field = one.field
    if one.cells is None:
        assert callable(field.values)
        found = _evaluate(field, field.values, points, state.time)
    else:
        values = one.grid
        if one.changes:
            assert state.grid is not None
            values = state.grid[one.cells.rows].reshape(one.cells.count)
        assert values is not None
        found = one.cells.at(values, points)
    return np.minimum(np.maximum(found, field.low), field.high)


def _evaluate(field: Field, function: Callable[..., Any], points: Floats, time: float) -> Floats:
    """Return what a function gives at points (n, 2), or raise EcologyError where these are no numbers."""
    found = np.asarray(function(points[:, 0], points[:, 1], time))
    try:
        found = np.broadcast_to(found, (len(points),))
    except ValueError:
        found = np.array([""])
    if found.dtype.kind not in "biuf" or not np.isfinite(found).all():
        raise EcologyError(
            f"field {field.name!r}: values(x, y, time) must return finite numbers, one for each of the {len(points)} "
            f"places in x and y, got {function(points[:, 0], points[:, 1], time)!r}."
        )
    return found.astype(float)


def slope(one: Compiled, state: State, plane: Plane, points: Floats) -> Floats:
    """Return the gradient of a field at points (n, 2), per length, (n, 2)."""
    found = np.empty((len(points), 2))
    for axis in (0, 1):
        step = np.zeros(2)
        step[axis] = one.step
        low, high = points - step, points + step
        if plane.torus:
            between = np.full(len(points), 2 * one.step)
        else:
            low, high = np.maximum(low, plane.low), np.minimum(high, plane.low + plane.size)
            between = high[:, axis] - low[:, axis]
        found[:, axis] = (sample(one, state, plane.home(high)) - sample(one, state, plane.home(low))) / between
    return found


# ---- what fields do ----------------------------------------------------------------------------


def expose(model: Model, state: State, control: Floats) -> None:
    """Add to u (N, V) what the fields do to needs where bodies are."""
    if model.fields is None:
        return
    for rows, exposure, index, needs in model.fields.exposed:
        if needs:
            off = sample(model.fields.each[index], state, state.position[rows]) - exposure.reference
            for column, rate in needs:
                control[rows, column] += rate * off


def share(model: Model, state: State, what: str) -> Floats:
    """Return the share of its speed ("slowing") or range of sight ("dimming") that fields leave to a body, (N,)."""
    assert model.fields is not None
    found = np.ones(model.size)
    for rows, exposure, index, _ in model.fields.exposed:
        rate = getattr(exposure, what)
        if rate:
            off = sample(model.fields.each[index], state, state.position[rows]) - exposure.reference
            found[rows] *= np.clip(1.0 - rate * off, 0.0, 1.0)
    return found


def advance(model: Model, state: State) -> None:
    """Let the fields that change be fed, spread and fade for a tick."""
    fields = model.fields
    if fields is None or state.grid is None:
        return
    state.own("grid")
    for one in fields.each:
        if one.changes and one.cells is not None:
            values = state.grid[one.cells.rows].reshape(one.cells.count)  # a view
            _feed(model, state, one, one.cells, values)
            _spread(one.field, one.cells, values, model.dt)
            if one.field.decay:
                values *= elementary.exp(-one.field.decay * model.dt)


def _feed(model: Model, state: State, one: Compiled, cells: Cells, values: Floats) -> None:
    """Add what the sources give, spread over the area of the cell in which each is."""
    area = float(cells.size[0] * cells.size[1])
    for bodies, rows, rate in one.sources:
        active = state.alive[rows] if bodies else (state.available & (state.stock > 0))[rows]
        points = (state.position if bodies else state.resource_position)[rows][active]
        y, x = cells.cell(points)
        good = cells.inside[y, x]  # the centre of a cell at a slanted wall may lie outside
        np.add.at(values, (y[good], x[good]), rate * model.dt / area)


def _spread(field: Field, cells: Cells, values: Floats, dt: float) -> None:
    """Let a field diffuse for dt, in as many explicit steps as keep it stable; what leaves a cell enters another."""
    along = field.diffusion * dt / cells.size**2
    steps = math.ceil(float(along.max()) / STABLE) if field.diffusion else 0
    for _ in range(steps):
        flows = []
        for axis, way, share_ in ((1, cells.right, along[0] / steps), (0, cells.above, along[1] / steps)):
            flows.append((axis, np.where(way, share_ * (values - np.roll(values, -1, axis)), 0.0)))
        for axis, flow in flows:
            values -= flow
            values += np.roll(flow, 1, axis)
