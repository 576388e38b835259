"""Stages of life: speed, size, metabolism and what a body can do, by its age."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ecology.spec import Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model


@dataclass(frozen=True, eq=False)
class Stages:
    """The constants of the stages of every slot, at most S; rows of species with fewer never reach the others."""

    begins: Floats  # (N, S) age at which each begins, infinite where there is none
    speed: Floats  # (N, S) factors
    size: Floats  # (N, S)
    metabolism: Floats  # (N, S)
    able: tuple[Bools | None, ...]  # by species, (S, A) which actions are possible; None where all always are
    grow: bool  # whether any size is another

    def now(self, age: Floats) -> Ints:
        """Return the stage of bodies of `age` (N,), (N,); rounding of an age is forgiven."""
        return np.maximum((self.begins <= age[:, None] * (1 + 1e-12) + 1e-12).sum(axis=1) - 1, 0)

    def of(self, table: Floats, age: Floats) -> Floats:
        """Return the factors of a `table` (N, S) at `age` (N,), (N,)."""
        return table[np.arange(len(age)), self.now(age)]


def compile_stages(species: Sequence[Species]) -> Stages | None:
    """Return the stages of the slots of `species`; None where none has any."""
    most = max(len(s.stages) for s in species)
    if not most:
        return None
    begins, factors = np.full((len(species), most), np.inf), np.ones((3, len(species), most))
    able: list[Bools | None] = []
    for i, s in enumerate(species):
        open_ = np.ones((most, len(s.actions)), bool)
        for k, stage in enumerate(s.stages):
            begins[i, k] = stage.age
            factors[:, i, k] = stage.speed, stage.size, stage.metabolism
            open_[k] = [action.name not in stage.cannot for action in s.actions]
        able.append(None if open_.all() else open_)
    counts = [s.slots for s in species]
    speed, size, metabolism = (np.repeat(table, counts, axis=0) for table in factors)
    return Stages(np.repeat(begins, counts, axis=0), speed, size, metabolism, tuple(able), bool((size != 1.0).any()))


def radii(model: Model, state: State) -> Floats:
    """Return the radii of all bodies as they are now, (N,)."""
    stages = model.stages
    return model.radius if stages is None or not stages.grow else model.radius * stages.of(stages.size, state.age)


def close(model: Model, state: State, masks: dict[str, Bools]) -> None:
    """Close in `masks`, by species (n, A), the actions that bodies of their age cannot do; rest stays open.

    What a body is held to goes on until it ends.
    """
    assert model.stages is not None
    stage = model.stages.now(state.age)
    for (group, table), able in zip(model.acting, model.stages.able, strict=True):
        if able is None:
            continue
        rows, mask = group.slots, masks[group.name]
        mask &= able[stage[rows]] | (state.hold[rows] > 0)[:, None]
        mask[:, table.rest] |= state.alive[rows] & ~mask.any(axis=1)
