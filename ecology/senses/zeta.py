"""zeta = [delta, what is felt of others, e]: all senses of a species side by side."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ecology import physiology
from ecology.empathy import own_weights
from ecology.ground import Plane, plane_of
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.senses.clock import Clock
from ecology.senses.cues import Cues
from ecology.senses.deviations import Deviations
from ecology.senses.faults import Faulty, compile_faults, misread
from ecology.senses.felt import Felt
from ecology.senses.gauge import GaugeSense
from ecology.senses.heading import Heading
from ecology.senses.hearing import HearingSense
from ecology.senses.load import Load
from ecology.senses.others import Others
from ecology.senses.patches import Patches
from ecology.senses.position import Position
from ecology.senses.rays import RaySense
from ecology.senses.traces import TraceSense, follow
from ecology.spec import Arena, Field, Gauge, Hearing, Rays, Resource, SenseSpec, Species, Trace
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

SENSES: dict[str, type[Sense]] = {
    "position": Position,
    "heading": Heading,
    "clock": Clock,
    "load": Load,
}  # by their names in `Species.senses`
PARAMETRIC: dict[type[SenseSpec], Callable[[Perceiver, Any], Sense]] = {  # by their parameters
    Gauge: GaugeSense,
    Rays: RaySense,
    Hearing: HearingSense,
    Trace: TraceSense,
}


@dataclass(frozen=True)
class Layout:
    """What the components of zeta are: the agent's knowledge of its own senses, D components."""

    names: tuple[str, ...]  # D
    kinds: tuple[str, ...]  # D: "deviation", "felt", "position", "angle" or "plain"
    scale: Floats  # (D,) size of an ordinary value
    low: Floats  # (D,)
    high: Floats  # (D,)
    regulated: Bools  # (D,) components that count in the drive
    epsilon: float  # of the drive
    exponent: float  # of the drive
    below: Floats  # (D,) factor of a deviation below the set point in the drive
    above: Floats  # (D,) factor above it
    power: float  # n of the drive
    own: Floats  # (D,) w_ii of the average form of empathy, 1 without
    felt_to: Ints  # (D,) deviation that a felt component adds to; -1: it adds to the drive (sum form), or is none

    @property
    def needs(self) -> int:
        """Return how many components are deviations; they come first."""
        return self.kinds.count("deviation")


@dataclass(frozen=True, eq=False)
class ObservationSpec:
    """The constants of what one species perceives."""

    species: Species
    rows: slice
    layout: Layout
    far: float  # the farthest that anything is seen, length
    senses: tuple[tuple[Sense, int], ...]  # with the first column of each in zeta
    traces: tuple[TraceSense, ...]  # those of them that remember
    faults: tuple[Faulty, ...]


def compile_observation_spec(
    species: Species,
    rows: slice,
    arena: Arena,
    resources: Sequence[Resource],
    everyone: Sequence[Species],
    fields: Sequence[Field] = (),
) -> ObservationSpec:
    """Return the constants of what the slots `rows` of `species` perceive."""
    far = farthest(species, plane_of(arena))
    whose = Perceiver(
        species=species, rows=rows, arena=arena, resources=resources, everyone=everyone, far=far, fields=fields
    )
    senses: list[Sense] = [
        Deviations(whose),
        Felt(whose),
        *(_make_sense(whose, each) for each in species.senses),
        *(Patches(whose, name) for name in species.sees),
        Cues(whose),
        *(Others(whose, sensed) for sensed in species.neighbours),
    ]
    senses = [sense for sense in senses if sense.components]
    columns = np.cumsum([0, *(len(sense.components) for sense in senses)]).tolist()
    components = [c for sense in senses for c in sense.components]
    traces = [sense for sense in senses if isinstance(sense, TraceSense)]
    if traces:
        known = {c.name: (i, c) for i, c in enumerate(components)}
        for place, sense in enumerate(traces):
            sense.bind(known, place)
        components = [c for sense in senses for c in sense.components]
    return ObservationSpec(
        species=species,
        rows=rows,
        traces=tuple(traces),
        faults=compile_faults(species.faults, components),
        layout=_lay_out(species, components, everyone),
        far=far,
        senses=tuple(zip(senses, columns[:-1], strict=True)),
    )


def _make_sense(whose: Perceiver, sensed: str | SenseSpec) -> Sense:
    """Return an entry of `Species.senses`, compiled."""
    if isinstance(sensed, str):
        return SENSES[sensed](whose)
    return PARAMETRIC[type(sensed)](whose, sensed)


def layout(
    species: Species,
    arena: Arena,
    resources: Sequence[Resource],
    everyone: Sequence[Species],
    fields: Sequence[Field] = (),
) -> Layout:
    """Return the layout of zeta = [delta, what is felt of others, e] for `species` among `everyone`."""
    return compile_observation_spec(species, slice(0, species.slots), arena, resources, everyone, fields).layout


def _lay_out(species: Species, components: Sequence[Component], everyone: Sequence[Species]) -> Layout:
    """Return the layout of `components`, those of the needs first."""
    own, needs = own_weights(species, everyone), len(species.needs)
    rest = len(components) - needs
    below, above = (np.append(factor, np.ones(rest)) for factor in physiology.drive_factors(species))
    return Layout(
        names=tuple(c.name for c in components),
        kinds=tuple(c.kind for c in components),
        scale=np.array([c.scale for c in components]),
        low=np.array([c.low for c in components]),
        high=np.array([c.high for c in components]),
        regulated=np.array([n.regulated for n in species.needs] + [False] * rest),
        epsilon=species.drive_epsilon,
        exponent=species.drive_exponent,
        below=below,
        above=above,
        power=species.drive_power,
        own=np.array([own[n.name] for n in species.needs] + [1.0] * rest),
        felt_to=np.array([c.felt_to for c in components]),
    )


def farthest(species: Species, plane: Plane) -> float:
    """Return the farthest that anything is seen by `species`, length."""
    return min(species.view_range, plane.diagonal)


def remember(model: Model, state: State, seen: Perception) -> None:
    """Let traces fade for a tick, and take up what is sensed now."""
    if state.traces is not None:
        observed = {
            spec.species.name: _sense(model, spec, state, seen) for spec in model.observation_specs if spec.traces
        }
        follow(model, state, observed)


def observe(model: Model, spec: ObservationSpec, state: State, seen: Perception) -> np.ndarray:
    """Return zeta = [delta, what is felt, e] of the n slots of one species, float32 (n, D), as senses read it."""
    zeta = _sense(model, spec, state, seen)
    if spec.faults:
        misread(spec.faults, spec.rows, zeta, state)
    return zeta


def _sense(model: Model, spec: ObservationSpec, state: State, seen: Perception) -> np.ndarray:
    """Return zeta (n, D) as it is."""
    zeta = np.zeros((spec.rows.stop - spec.rows.start, len(spec.layout.names)), np.float32)
    for sense, column in spec.senses:
        sense.write(zeta, column, model, state, seen)
    return zeta


def show_fatal_needs(
    model: Model, state: State, internal: Floats, died: Bools, observations: Mapping[str, np.ndarray]
) -> None:
    """Write the needs with which agents `died` (N,), from x (N, V) after the tick, into their last observations.

    The state keeps what a dead body stored before the tick, so that the account closes and death is no relief.
    """
    body, set_point = model.body, physiology.set_points(model.body, state)
    x = np.where(np.isfinite(internal), np.clip(internal, body.low, body.high), state.internal)
    for group, species in model.species:
        rows, width = np.flatnonzero(died[group.slots]), len(species.needs)
        at = group.slots.start + rows
        observations[group.name][rows, :width] = (x - set_point)[at, :width]
