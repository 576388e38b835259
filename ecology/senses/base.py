"""What a sense is: its components of zeta, their bounds, and how they are written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from ecology.neighbours import Pairs
from ecology.spec import Arena, Field, Resource, Species
from ecology.state import Bools, Ints, State

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ecology.model import Model
    from ecology.sight import Vision

Kind = Literal["deviation", "felt", "position", "angle", "plain"]


class Component(NamedTuple):
    """One component of zeta. A learner that uses networks divides it by `scale` and encodes it by its `kind`."""

    name: str
    kind: Kind  # "deviation": of a need; "felt": of others' needs; "position": x or y; "angle": wraps; else "plain"
    scale: float  # size of an ordinary value
    low: float
    high: float
    felt_to: int = -1  # deviation that a felt component adds to; -1: it adds to the drive (sum form), or is none


@dataclass(frozen=True)
class Perceiver:
    """The species whose senses are compiled, and what there is to be sensed."""

    species: Species
    rows: slice  # its slots
    arena: Arena
    resources: Sequence[Resource]
    everyone: Sequence[Species]
    far: float  # the farthest that it sees, length
    fields: Sequence[Field] = ()


class Perception(NamedTuple):
    """What bodies see and can do after a tick, on which they decide in the next one; K resources, A actions."""

    here: Ints  # (N, K) patch of each resource that the body stands in and can consume, -1 without
    toward: Ints  # (N, K) patch of each resource that a go_to leads to, -1 without
    nearest: Ints  # (N, K) nearest patch of each resource that is seen or stood in, -1 without
    pairs: Pairs | None  # of bodies near each other; None where nobody senses or meets another
    targets: Mapping[str, Ints]  # by species (n, A), slot that a bite or gift would meet, -1 without
    masks: Mapping[str, Bools]  # by species (n, A), A_zeta
    vision: Vision  # as they are now


class Sense:
    """A sense of one species: one class per sense, compiled for a `Perceiver`, and written at every tick.

    `components` are its part of zeta, in order. `write` fills their columns for the n slots of the species, also for
    slots in which nobody lives: their values are ignored, but must not raise an error. The vector from one place to
    another is `model.plane.gap`, which goes the shorter way round on a torus.
    """

    components: tuple[Component, ...]

    @classmethod
    def check(cls, owner: str, day: float | None) -> None:
        """Raise EcologyError, which begins with `owner`, where a scenario with this `day` cannot have the sense."""

    def __init__(self, whose: Perceiver) -> None:
        """Compile the sense for `whose` species."""
        raise NotImplementedError

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write what is sensed into zeta (n, D) from `column` on; it is 0 before."""
        raise NotImplementedError


def place_components(name: str, far: float) -> tuple[Component, Component]:
    """Return the components of what lies somewhere: its distance and its bearing from one's heading."""
    return (
        Component(f"{name}_distance", "plain", far / 2, 0.0, far),
        Component(f"{name}_bearing", "angle", np.pi, -np.pi, np.pi),
    )
