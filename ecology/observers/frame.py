"""What a picture shows of one tick, from a world that lives or from a recording."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ecology.ground import plane_of
from ecology.model import Model
from ecology.observers import places, shapes
from ecology.scenario import Scenario
from ecology.spec import Species
from ecology.state import Floats, State


@dataclass(frozen=True)
class Followed:
    """One agent at one tick: where it is, its needs and its decision."""

    name: str
    place: Floats  # (2,), NaN where it does not live
    species: Species
    needs: Floats  # (V,) x
    target: Floats  # (V,) x*
    decision: str  # in Markdown, "" where none was recorded


@dataclass(frozen=True)
class Frame:
    """What a picture shows of one tick, for N slots and R patches."""

    tick: int
    time: float
    position: Floats  # (N, 2), NaN for the dead
    heading: Floats  # (N,)
    drive: Floats  # (N,)
    patches: Floats  # (R, 2)
    full: Floats  # (R,) from 0 to 1
    doors: Sequence[np.ndarray] = ()  # those that are closed, lines (2, 2)
    fields: Mapping[str, np.ndarray] = field(default_factory=dict)  # how strong, uint8 (rows, columns); none of a film
    marks: Mapping[str, Sequence[np.ndarray]] = field(default_factory=dict)  # kind -> strips (k, 2)
    followed: Followed | None = None  # whose mind is shown beside the arena


def frame(scenario: Scenario, state: State, model: Model | None = None) -> Frame:
    """Return what a picture shows of `state`; its fields only where the `model` of the world is given."""
    alive, none = state.alive, np.zeros(len(state.alive), bool)
    wide = max(shapes.radius(scenario, species) for species in scenario.species)
    marks, plane = {}, plane_of(scenario.arena)
    for kind, who, other in (
        ("born", alive & (state.age == 0.0) if state.tick else none, state.bit),
        ("bit", state.bit >= 0, state.bit),
        ("gave", state.gave >= 0, state.gave),
    ):
        place = state.position[who]
        marks[kind] = shapes.mark(kind, place, place + plane.gap(place, state.position[other[who]]), wide)
    return Frame(
        tick=state.tick,
        time=state.time,
        position=np.where(alive[:, None], state.position, np.nan),
        heading=state.heading,
        drive=state.drive,
        patches=shapes.patches(scenario, state),
        full=shapes.fullness(scenario, state),
        doors=places.closed_doors(scenario.arena, state.doors),
        fields={} if model is None else places.levels(model, state, places.grid_of(scenario.arena)),
        marks=marks,
    )
