"""Senses that are noisy or fail: what is drawn for them in a tick, and what is read then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary
from ecology.ground import wrap
from ecology.senses.base import Component
from ecology.spec import Fault
from ecology.state import State

if TYPE_CHECKING:
    from ecology.model import Model


@dataclass(frozen=True, eq=False)
class Faulty:
    """One component of zeta of a species that is noisy or fails."""

    fault: Fault
    source: int  # column of zeta
    component: Component
    place: int  # column of `state.misread` and `state.failed`


def compile_faults(faults: Sequence[Fault], components: Sequence[Component]) -> tuple[Faulty, ...]:
    """Return the faults of a species; the scenario refuses a component that is not there."""
    names = [c.name for c in components]
    known = [fault for fault in faults if fault.of in names]
    return tuple(
        Faulty(fault, names.index(fault.of), components[names.index(fault.of)], i) for i, fault in enumerate(known)
    )


def draw_faults(model: Model, state: State, rng: np.random.Generator) -> None:
    """Draw the noise of a tick, and which senses fail or work again."""
    assert state.failed is not None
    shape = state.failed.shape
    state.misread, drawn = rng.standard_normal(shape), rng.random(shape)
    change = np.zeros(shape)
    for spec in model.observation_specs:
        for one in spec.faults:
            failed = state.failed[spec.rows, one.place]
            rate = np.where(failed, one.fault.repair, one.fault.failure)
            change[spec.rows, one.place] = -elementary.expm1(-rate * model.dt)
    state.failed = state.failed ^ (drawn < change)


def misread(faults: Sequence[Faulty], rows: slice, zeta: np.ndarray, state: State) -> None:
    """Write what is read instead into zeta (n, D): noise within the bounds of a component, and 0 where it fails."""
    assert state.misread is not None
    assert state.failed is not None
    for one in faults:
        value = zeta[:, one.source] + one.fault.noise * state.misread[rows, one.place]
        c = one.component
        value = wrap(value) if c.kind == "angle" else np.minimum(np.maximum(value, c.low), c.high)
        none = min(max(0.0, c.low), c.high)
        zeta[:, one.source] = np.where(state.failed[rows, one.place], none, value)
