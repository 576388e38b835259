"""What things look like in the plane, for every observer: pure functions of arrays."""

from __future__ import annotations

import math

import numpy as np

from ecology.ground import Ground
from ecology.scenario import Scenario
from ecology.spec import Resource, Species
from ecology.state import Floats, State

SMALL, LARGE = 0.008, 0.03  # of the arena: bodies are drawn at least and at most this large
KINDS = {"born": "ring: born", "died": "cross: died", "bit": "red line: bite", "gave": "green line: gift"}  # of marks


def size(scenario: Scenario) -> float:
    """Return the longer side of the arena."""
    low, high = np.array(scenario.arena.extent)
    return float((high - low).max())


def radius(scenario: Scenario, species: Species) -> float:
    """Return the radius with which a body is drawn: its own, within what can be seen and does not hide the rest."""
    return min(max(species.radius, SMALL * size(scenario)), LARGE * size(scenario))


def fullness(scenario: Scenario, state: State) -> Floats:
    """Return how full every patch is, (R,) from 0 to 1; what is unlimited is full, what is not there is empty."""
    most = np.array([r.most for r in scenario.resources for _ in range(r.count)])
    full = np.divide(state.stock, most, out=np.ones(len(most)), where=np.isfinite(most) & (most > 0))
    return np.clip(full, 0.0, 1.0) * state.available


def patches(scenario: Scenario, state: State) -> Floats:
    """Return where the patches are, (R, 2); NaN where one is gone, which is not drawn."""
    comes = np.array([r.gone_below is not None for r in scenario.resources for _ in range(r.count)], bool)
    gone = comes & (state.stock <= 0)
    return np.where(gone[:, None], np.nan, state.resource_position) if gone.any() else state.resource_position


def covers(scenario: Scenario, resource: Resource) -> bool:
    """Return whether the circle of a resource holds the whole arena, wherever the resource moves."""
    corners = np.array(scenario.arena.vertices, float)
    far = float(np.hypot(*np.ptp(corners, axis=0)))
    if resource.position is not None and resource.motion is None:
        far = float(np.hypot(*(corners - resource.position).T).max())
    return resource.count == 1 and resource.seeding is None and resource.radius >= far


def view_field(species: Species, place: Floats, heading: float, ground: Ground | None = None) -> Floats:
    """Return the outline of a field of view, (k, 2), which ends at the walls of `ground`; empty if it has no limit."""
    if not math.isfinite(species.view_range):
        return np.empty((0, 2))
    half = species.view_angle / 2
    angle = heading + np.linspace(-half, half, 25 if ground is None else 73)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    far = np.full(len(way), species.view_range) if ground is None else ground.reach(place, way, species.view_range)
    arc = place + far[:, None] * way
    return arc if half >= math.pi - 1e-9 else np.concatenate([place[None], arc, place[None]])


def mark(kind: str, place: Floats, other: Floats, wide: float) -> list[Floats]:
    """Return the strips (k, 2) that mark events at `place` (n, 2), with what is at `other` (n, 2).

    Rings of newborns and crosses of the dead by the radius `wide` of a body; lines of bites and gifts.
    """
    if kind == "born":
        angle = np.linspace(0, 2 * np.pi, 9)
        ring = 2.0 * wide * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return [at + ring for at in place]
    if kind == "died":
        arm = 1.5 * wide * np.array([[-1.0, -1.0], [1.0, 1.0]])
        return [at + way for at in place for way in (arm, arm * [1, -1])]
    return [np.stack(ends) for ends in zip(place, other, strict=True)]


def mark_kinds(scenario: Scenario) -> list[str]:
    """Return the kinds of marks that can come up."""
    species = scenario.species
    kinds = {action.kind for s in species for action in s.actions}
    grows = any(s.grows for s in species)
    mortal = any(s.hazard is not None or any(need.lethal for need in s.needs) for s in species)
    mortal |= "bite" in kinds or scenario.rule is not None
    can_occur = {"born": grows, "died": mortal, "bit": "bite" in kinds, "gave": "give" in kinds}
    return [kind for kind in KINDS if can_occur[kind]]
