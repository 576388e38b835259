"""What agents perceive: view field, line of sight, reach, and observations; pure functions of arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ecology.spec import Arena, Resource, Species
from ecology.state import Bools, Floats

SENSES: Mapping[str, int] = {"position": 2, "heading": 1, "clock": 2}  # components in zeta


@dataclass(frozen=True)
class Layout:
    """What the components of zeta are: the agent's knowledge of its own senses, D components."""

    names: tuple[str, ...]  # D
    kinds: tuple[str, ...]  # D: "deviation", "position", "angle" or "plain"
    scale: Floats  # (D,) size of an ordinary value
    low: Floats  # (D,)
    high: Floats  # (D,)
    regulated: Bools  # (D,) components that count in the drive
    epsilon: float  # of the drive

    @property
    def needs(self) -> int:
        """Return how many components are deviations; they come first."""
        return self.kinds.count("deviation")


def layout(species: Species, arena: Arena) -> Layout:
    """Return the layout of zeta = [delta, e] for `species`."""
    corners = np.array(arena.vertices)
    low, high = corners.min(axis=0), corners.max(axis=0)
    rows: list[tuple[str, str, float, float, float, bool]] = [
        (
            need.name,
            "deviation",
            need.scale,
            need.low - need.set_point,
            need.bounds[1] - need.set_point,
            need.regulated,
        )
        for need in species.needs
    ]
    for sense in species.senses:
        if sense == "position":
            rows += [
                (
                    axis,
                    "position",
                    max(float(high[i] - low[i]) / 2, 1e-6),
                    float(low[i]),
                    float(high[i]),
                    False,
                )
                for i, axis in enumerate("xy")
            ]
        elif sense == "heading":
            rows.append(("heading", "angle", math.pi, -math.pi, math.pi, False))
        elif sense == "clock":
            rows += [(f"clock_{part}", "plain", 1.0, -1.0, 1.0, False) for part in ("cos", "sin")]
    names, kinds, scale, bottom, top, regulated = zip(*rows, strict=True)
    return Layout(
        names=names,
        kinds=kinds,
        scale=np.array(scale),
        low=np.array(bottom),
        high=np.array(top),
        regulated=np.array(regulated),
        epsilon=species.drive_epsilon,
    )


def observe(
    species: Species,
    set_point: Floats,
    internal: Floats,
    position: Floats,
    heading: Floats,
    time: float,
    day: float | None,
) -> np.ndarray:
    """Return zeta = [delta, e] of the n slots of one species, float32 (n, D)."""
    width = len(species.needs)
    zeta = np.empty((len(internal), width + sum(SENSES[s] for s in species.senses)), np.float32)
    zeta[:, :width] = internal[:, :width] - set_point[:, :width]
    column = width
    for sense in species.senses:
        if sense == "position":
            zeta[:, column : column + 2] = position
        elif sense == "heading":
            zeta[:, column] = heading
        elif sense == "clock":
            angle = 2 * math.pi * time / (day or 1.0)
            zeta[:, column : column + 2] = (math.cos(angle), math.sin(angle))
        column += SENSES[sense]
    return zeta


@dataclass(frozen=True)
class Eyes:
    """The constants of sight: each slot's view field, the walls and the resources' reach."""

    half_angle: Floats  # (n,)
    range: Floats  # (n,)
    sees: Bools  # (n,) slots that use sight at all
    wall_from: Floats  # (W, 2)
    wall_along: Floats  # (W, 2) from the first to the second end
    reach: Floats  # (R,) radius of the circle

    @property
    def used(self) -> bool:
        """Return whether any slot uses sight."""
        return bool(self.sees.any())


def compile_eyes(species: tuple[Species, ...], arena: Arena, resources: tuple[Resource, ...]) -> Eyes:
    """Return the constants of sight for the slots of `species`, in their order."""
    counts = [s.count for s in species]
    vertices = np.array(arena.vertices, dtype=float)
    return Eyes(
        half_angle=np.repeat([s.view_angle / 2 for s in species], counts),
        range=np.repeat([s.view_range for s in species], counts),
        sees=np.repeat([any(a.kind == "go_to" for a in s.actions) for s in species], counts),
        wall_from=vertices,
        wall_along=np.roll(vertices, -1, axis=0) - vertices,
        reach=np.array([r.radius for r in resources]),
    )


def wrap(angle: Floats) -> Floats:
    """Return the angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def clear(eyes: Eyes, start: Floats, end: Floats) -> Bools:
    """Return whether the straight segment from start to end (m, 2) crosses no wall, (m,)."""
    along = (end - start)[:, None, :]  # (m, 1, 2)
    offset = eyes.wall_from - start[:, None, :]  # (m, W, 2)
    wall = eyes.wall_along
    # solve start + t along = wall_from + s wall with t and s in [0, 1]
    cross = along[..., 0] * wall[:, 1] - along[..., 1] * wall[:, 0]  # (m, W)
    t = offset[..., 0] * wall[:, 1] - offset[..., 1] * wall[:, 0]
    s = offset[..., 0] * along[..., 1] - offset[..., 1] * along[..., 0]
    sign = np.sign(cross)
    t, s, size = t * sign, s * sign, np.abs(cross)
    hit = (size > 0) & (t >= 0) & (t <= size) & (s >= 0) & (s <= size)
    return ~np.logical_or.reduce(hit, axis=1)


def reach_and_sight(
    eyes: Eyes, position: Floats, heading: Floats, alive: Bools, resources: Floats
) -> tuple[Bools, Bools]:
    """Return who is inside which resource's circle, and who sees which resource, both (n, R).

    A resource is seen within the angle and the range of the view field, with no wall between.
    """
    gap = resources[None, :, :] - position[:, None, :]  # (n, R, 2)
    distance = np.sqrt(gap[..., 0] ** 2 + gap[..., 1] ** 2)
    inside = (distance <= eyes.reach) & alive[:, None]
    seen = np.zeros_like(inside)
    if eyes.used:
        near = (distance <= eyes.range[:, None]) & (alive & eyes.sees)[:, None]
        who, what = np.nonzero(near)
        if who.size:
            bearing = np.arctan2(gap[who, what, 1], gap[who, what, 0])
            field = np.abs(wrap(bearing - heading[who])) <= eyes.half_angle[who] + 1e-12
            who, what = who[field], what[field]
            if who.size:
                open_line = clear(eyes, position[who], resources[what])
                seen[who[open_line], what[open_line]] = True
    return inside, seen
