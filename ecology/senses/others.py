"""The sense of others: the nearest that are seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary, physiology
from ecology.compiler_cache import compiled, use_cache
from ecology.ground import plane
from ecology.ground.plane import wrapped
from ecology.senses.acquaintance import Acquaintance
from ecology.senses.base import Component, Perceiver, Perception, Sense, place_components
from ecology.sight import nearest_seen
from ecology.spec import Neighbours
from ecology.state import Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__, plane.__file__)


class Others(Sense):
    """Sense the nearest others: where they are, their heading, what they are and what they let others perceive."""

    def __init__(self, whose: Perceiver, sensed: Neighbours) -> None:
        """Compile what `sensed` says."""
        everyone = whose.everyone
        kinds = [s for s in everyone if not sensed.species or s.name in sensed.species]
        opened = list(dict.fromkeys(name for kind in kinds for name in kind.opens))
        known = Acquaintance(sensed, kinds, everyone)
        found: list[Component] = []
        label = "_".join(sensed.species) or "other"
        for i in range(sensed.count):
            one = f"{label}_{i + 1}"
            found += place_components(one, whose.far)
            if sensed.heading:
                found.append(Component(f"{one}_heading", "angle", math.pi, -math.pi, math.pi))
            if len(kinds) > 1:
                found += [Component(f"{one}_is_{kind.name}", "plain", 0.5, 0.0, 1.0) for kind in kinds]
            for name in opened:
                needs = [n for kind in kinds for n in kind.needs if n.name == name and name in kind.opens]
                low, high = min(n.deviations[0] for n in needs), max(n.deviations[1] for n in needs)
                scale = max(n.scale for n in needs)
                found.append(Component(f"{one}_{name}", "plain", scale, min(low, 0.0), max(high, 0.0)))
            found += known.components(one)
        self.components = tuple(found)
        self._rows, self._far, self._sensed, self._kinds, self._known = whose.rows, whose.far, sensed, len(kinds), known
        # the place of each species (S,) among the kinds that are sensed, -1 without
        self._kind_of = np.array([kinds.index(s) if s in kinds else -1 for s in everyone], np.int64)
        # the needs that each of these opens, (kinds, W), -1 without
        columns = [[_column(kind.opens, [n.name for n in kind.needs], name) for name in opened] for kind in kinds]
        self._columns = np.array(columns, np.int64).reshape(len(kinds), -1)

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write what is sensed of the nearest; the farthest distance and 0 where there is nobody."""
        eyes, pairs, sensed = seen.eyes, seen.pairs, self._sensed
        assert pairs is not None
        found, way = nearest_seen(
            pairs.starts, pairs.other, pairs.gap, pairs.distance, self._rows.start, len(zeta), sensed.count,
            self._kind_of >= 0, model.species_of, state.position, state.heading, eyes.half_angle, eyes.range,
            eyes.wall_from, eyes.wall_along, eyes.open,
        )  # fmt: skip
        angle = elementary.arctan2(way[1], way[0])  # (n, k)
        _write_others(
            zeta, column, self._far, found, angle, pairs.other, pairs.distance, self._rows.start, state.heading,
            sensed.heading, self._kind_of, self._kinds, model.species_of, self._columns, state.internal,
            physiology.set_points(model.body, state), self._known.width,
        )  # fmt: skip
        if self._known.width:
            width = len(self.components) // sensed.count
            for place in range(sensed.count):
                row = np.flatnonzero(found[:, place] >= 0)
                told, at = zeta[row], column + (place + 1) * width - self._known.width
                other = pairs.other[found[row, place]]
                self._known.write(told, at, state, model.species_of, self._rows.start + row, other)
                zeta[row] = told


def _column(opens: tuple[str, ...], needs: list[str], name: str) -> int:
    return needs.index(name) if name in opens else -1


@compiled
def _write_others(
    zeta: np.ndarray,
    column: int,
    far: float,
    found: Ints,
    angle: Floats,
    other: Ints,
    distance: Floats,
    first: int,
    heading: Floats,
    with_heading: bool,
    kind_of: Ints,
    kinds: int,
    species_of: Ints,
    columns: Ints,
    internal: Floats,
    set_point: Floats,
    more: int,
) -> None:
    """Write what n slots from `first` on sense of others into zeta (n, D) from `column` on.

    `found` (n, k) are the pairs, at `angle` (n, k); `kind_of` (S,) is the place of a species among the `kinds` that
    are sensed, and `columns` (kinds, W) the needs that each lets others perceive, -1 without. After each neighbour,
    `more` components are left to the caller.
    """
    for row in range(len(found)):
        i, c = first + row, column
        for place in range(found.shape[1]):
            p = found[row, place]
            if p < 0:
                zeta[row, c] = far
            else:
                j = other[p]
                kind = kind_of[species_of[j]]
                zeta[row, c] = distance[p]
                zeta[row, c + 1] = wrapped(angle[row, place] - heading[i])
                at = c + 2
                if with_heading:
                    zeta[row, at] = wrapped(heading[j] - heading[i])
                    at += 1
                if kinds > 1:
                    zeta[row, at + kind] = 1.0
                    at += kinds
                for w in range(columns.shape[1]):
                    need = columns[kind, w]
                    if need >= 0:
                        zeta[row, at + w] = internal[j, need] - set_point[j, need]
            c += 2 + with_heading + (kinds if kinds > 1 else 0) + columns.shape[1] + more
