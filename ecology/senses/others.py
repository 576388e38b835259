"""The sense of others: the nearest that are seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ecology import elementary, physiology
from ecology.compiler_cache import compiled, use_cache
from ecology.elementary import angle_of
from ecology.ground import plane
from ecology.ground.plane import wrap_angle
from ecology.neighbours import Pairs
from ecology.senses.acquaintance import Acquaintance
from ecology.senses.base import Component, Perceiver, Perception, Sense, place_components
from ecology.sight import nearest_seen
from ecology.spec import Neighbours
from ecology.state import Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__, plane.__file__, elementary.__file__)


class Features(NamedTuple):
    """What is sensed of each neighbour, one after the other in zeta."""

    far: float  # distance that stands for nobody
    heading: bool  # whether its heading is sensed
    kinds: int  # species among which it is told apart
    kind_of: Ints  # (N,) which of them a slot belongs to, -1 none
    needs: Ints  # (kinds, W) columns of the needs that each lets others perceive, -1 without
    more: int  # components that `Acquaintance` writes


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
        columns = [[_column(kind.opens, [n.name for n in kind.needs], name) for name in opened] for kind in kinds]
        self._rows, self._sensed, self._known = whose.rows, sensed, known
        self._features = Features(
            far=whose.far,
            heading=sensed.heading,
            kinds=len(kinds),
            kind_of=np.repeat([kinds.index(s) if s in kinds else -1 for s in everyone], [s.slots for s in everyone]),
            needs=np.array(columns, np.int64).reshape(len(kinds), -1),
            more=known.width,
        )
        self._wanted = self._features.kind_of >= 0  # (N,)

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write what is sensed of the nearest; the farthest distance and 0 where there is none."""
        vision, pairs, sensed = seen.vision, seen.pairs, self._sensed
        assert pairs is not None
        first = self._rows.start
        found = nearest_seen(vision, pairs, state.position, state.heading, first, len(zeta), sensed.count, self._wanted)
        set_point, own = physiology.set_points(model.body, state), zeta[:, column : column + len(self.components)]
        _write_others(own, self._features, pairs, found, first, state.heading, state.internal, set_point)
        if self._known.width:
            width = len(self.components) // sensed.count
            for place in range(sensed.count):
                row = np.flatnonzero(found[:, place] >= 0)
                values, at = zeta[row], column + (place + 1) * width - self._known.width
                other = pairs.other[found[row, place]]
                self._known.write(values, at, state, model.species_of, first + row, other)
                zeta[row] = values


def _column(opens: tuple[str, ...], needs: list[str], name: str) -> int:
    return needs.index(name) if name in opens else -1


@compiled
def _write_others(
    zeta: np.ndarray,
    features: Features,
    pairs: Pairs,
    found: Ints,
    first: int,
    heading: Floats,
    internal: Floats,
    set_point: Floats,
) -> None:
    """Write what n slots from `first` on sense of others, of which the pairs `found` (n, k) are with them.

    Into zeta (n, k times what is sensed of each). `heading` (N,), `internal` and `set_point` (N, V) are by slot.
    """
    far, with_heading, kinds, kind_of, columns, more = features
    for row in range(len(found)):
        i, c = first + row, 0
        for place in range(found.shape[1]):
            p = found[row, place]
            if p < 0:
                zeta[row, c] = far
            else:
                j = pairs.other[p]
                kind = kind_of[j]
                zeta[row, c] = pairs.distance[p]
                zeta[row, c + 1] = wrap_angle(angle_of(pairs.gap[p, 1], pairs.gap[p, 0]) - heading[i])
                at = c + 2
                if with_heading:
                    zeta[row, at] = wrap_angle(heading[j] - heading[i])
                    at += 1
                if kinds > 1:
                    zeta[row, at + kind] = 1.0
                    at += kinds
                for w in range(columns.shape[1]):
                    need = columns[kind, w]
                    if need >= 0:
                        zeta[row, at + w] = internal[j, need] - set_point[j, need]
            c += 2 + with_heading + (kinds if kinds > 1 else 0) + columns.shape[1] + more
