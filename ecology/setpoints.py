"""Set points that move: by what a body takes in, back by themselves, and with a clock.

x* = x*_0 + swing sin(2 pi t / period + phase) + offset, and
d offset = gain intake - (recovery, towards 0) dt - relaxation offset dt. Escalation by intake: Keramati, Durand,
Girardeau, Gutkin and Ahmed 2017. Within a tick, the offset relaxes exactly; intake and recovery are added after it. All
of it stays within the need's `set_range`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary
from ecology.spec import Adaptation, Species, require
from ecology.state import Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model
    from ecology.scenario import Scenario


@dataclass(frozen=True)
class Moving:
    """The constants of set points that move by themselves, one row per slot."""

    gain: Floats  # (N, V) units of the set point per unit taken in
    recovery: Floats  # (N, V) units per unit of time
    relaxation: Floats  # (N, V) share per unit of time
    swing: Floats  # (N, V) units
    frequency: Floats  # (N, V) radians per unit of time
    phase: Floats  # (N, V) radians
    by: Ints | None  # (N, V) column of the need whose intake counts; None: each need's own

    def wave(self, time: float) -> Floats:
        """Return what the clock adds to the set points, (N, V)."""
        return self.swing * elementary.sin(self.frequency * time + self.phase)


def compile_moving(species: Sequence[Species], width: int) -> Moving | None:
    """Return the constants of the slots of `species`, padded to `width` needs; None where no set point moves."""
    if not any(need.adaptation is not None for s in species for need in s.needs):
        return None

    def rows(read: Callable[[Adaptation], float]) -> Floats:
        table = np.zeros((len(species), width))
        for i, s in enumerate(species):
            for v, need in enumerate(s.needs):
                table[i, v] = 0.0 if need.adaptation is None else read(need.adaptation)
        return np.repeat(table, [s.slots for s in species], axis=0)

    by = np.tile(np.arange(width), (len(species), 1))
    for i, s in enumerate(species):
        names = [need.name for need in s.needs]
        for v, need in enumerate(s.needs):
            if need.adaptation is not None and need.adaptation.by is not None:
                by[i, v] = names.index(need.adaptation.by)
    other = bool((by != np.arange(width)).any())
    return Moving(
        by=np.repeat(by, [s.slots for s in species], axis=0) if other else None,
        gain=rows(lambda a: a.gain),
        recovery=rows(lambda a: a.recovery),
        relaxation=rows(lambda a: a.relaxation),
        swing=rows(lambda a: a.swing),
        frequency=rows(lambda a: 2 * np.pi / a.period),
        phase=rows(lambda a: a.phase),
    )


def at_birth(model: Model, base: Floats, time: float) -> Floats:
    """Return the set points (N, V) of bodies that begin at `time`, of x*_0 `base` (N, V)."""
    if model.moving is None:
        return base.copy()
    return np.clip(base + model.moving.wave(time), model.body.least, model.body.most)


def move(model: Model, state: State, base: Floats, intake: Floats, before: float) -> None:
    """Move the set points of the living through the tick that began at the time `before`.

    `base` (N, V) is x*_0, and `intake` (N, V) what was taken in, in units of the need; of it counts what is positive.
    """
    moving, dt = model.moving, model.dt
    assert moving is not None
    assert state.set_point is not None
    if moving.by is not None:
        intake = np.take_along_axis(intake, moving.by, axis=1)
    offset = (state.set_point - base - moving.wave(before)) * elementary.exp(-moving.relaxation * dt)
    offset += moving.gain * np.maximum(intake, 0.0)
    offset = np.sign(offset) * np.maximum(np.abs(offset) - moving.recovery * dt, 0.0)
    after = np.clip(base + moving.wave(state.time) + offset, model.body.least, model.body.most)
    state.set_point = np.where(state.alive[:, None], after, state.set_point)


def check_set_points(wanted: Floats, scenario: Scenario, slots: Mapping[str, slice], owner: str) -> None:
    """Raise EcologyError, which begins with `owner`, where a rule puts set points (N, V) out of their range."""
    for species in scenario.species:
        for v, need in enumerate(species.needs):
            lowest, highest = need.set_points
            value = wanted[slots[species.name], v]
            off = (value < lowest) | (value > highest)
            require(
                not off.any(),
                f"{owner}: it puts the set point of {need.name!r} of {species.name!r} to {value[off][:1]}, outside "
                f"{lowest:g} to {highest:g}; give the need a wider set_range, or put it within.",
            )
