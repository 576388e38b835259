"""Births, deaths, slots and the serial numbers that never return."""

from __future__ import annotations

from typing import Any

import numpy as np

from ecology.kernels import inside_polygon, stays
from ecology.plane import plane_of
from ecology.spec import Arena, Birth, Hazard, Species, require
from ecology.state import Bools, Floats, Ints

ROUNDS = 1_000  # of at least 18 points at random, none of them inside, after which an arena is too thin
AROUND = 8  # directions in which a parent looks for room for its newborn


def place(arena: Arena, species: Species, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return positions (count, 2) and headings (count,) at birth.

    Where the species fixes neither, they are drawn uniformly over the arena, a body's radius away
    from every wall, and over all directions.
    """
    if species.position is not None:
        position = np.tile(np.array(species.position, dtype=float), (count, 1))
    else:
        position = scatter(arena, species.radius, count, rng)
    if species.heading is not None:
        heading = np.full(count, float(species.heading))
    else:
        heading = rng.uniform(-np.pi, np.pi, count)
    return plane_of(arena).home(position), heading


def scatter(arena: Arena, margin: float, count: int, rng: np.random.Generator) -> Floats:
    """Return points (count, 2), uniform over the arena and at least `margin` from its walls."""
    if not count:
        return np.empty((0, 2))
    import shapely  # slow to load, needed at births only

    margin = margin if arena.walls else 0.0
    room = shapely.Polygon(arena.vertices).buffer(-margin, join_style="mitre")
    return scatter_in(room, count, rng, f"{margin!r} away from every wall")


def scatter_in(room: Any, count: int, rng: np.random.Generator, where: str) -> Floats:
    """Return points (count, 2), uniform over the polygons of the shapely geometry `room`; `where` says what it is."""
    polygons = [part for part in getattr(room, "geoms", [room]) if part.geom_type == "Polygon"]
    rings = [np.array(ring.coords)[:-1] for part in polygons for ring in (part.exterior, *part.interiors)]
    low = np.min([ring.min(axis=0) for ring in rings], axis=0)
    high = np.max([ring.max(axis=0) for ring in rings], axis=0)
    found: list[Floats] = []
    have = 0
    fruitless = 0  # rounds in a row
    while have < count:
        require(
            fruitless < ROUNDS,
            f"{count} places, {where}, are not found at random in an arena this thin; widen it, or give positions.",
        )
        points = rng.uniform(low, high, (2 * (count - have) + 16, 2))
        kept = points[np.logical_xor.reduce([inside_polygon(ring, points) for ring in rings])]
        found.append(kept)
        have += len(kept)
        fruitless = 0 if len(kept) else fruitless + 1
    return np.concatenate(found)[:count]


# ---- births ----------------------------------------------------------------------------------


def fit(birth: Birth, needs: tuple[str, ...], internal: Floats, age: Floats, alive: Bools) -> Bools:
    """Return who can bear: alive, mature and with every need at its threshold, (n,) for internal (n, V)."""
    able: Bools = alive & (age >= birth.maturity)
    for name, least in birth.threshold.items():
        able &= internal[:, needs.index(name)] >= least
    return able


def bearers(birth: Birth, able: Bools, free: int, dt: float, rng: np.random.Generator) -> Ints:
    """Return which of those `able` (n,) bear in a tick, at most as many as slots are `free`, in random order."""
    drawn = rng.random((2, len(able)))
    who = np.flatnonzero(able & (drawn[0] < -np.expm1(-birth.rate * dt)))
    return who[np.argsort(drawn[1, who])][:free]


def beside(arena: Arena, walls: Floats, position: Floats, radius: float, rng: np.random.Generator) -> Floats:
    """Return places (k, 2) beside parents at `position` (k, 2), two radii away: clear of the walls, none between.

    `walls` (W, 2) are the corners of the arena, which lies on the left of every wall. Directions are tried at random;
    where no one has room, the newborn starts where its parent is.
    """
    angle = rng.uniform(-np.pi, np.pi, len(position))[:, None] + 2 * np.pi / AROUND * np.arange(AROUND)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)  # (k, AROUND, 2)
    places = position[:, None] + 2.0 * radius * way
    plane = plane_of(arena)
    if plane.torus:
        return plane.home(places[:, 0])
    tried = places.reshape(-1, 2)
    near = stays(walls, np.repeat(position, AROUND, axis=0), tried)
    free = np.logical_and(near, inside_polygon(walls, tried) & (_room(walls, tried) >= radius)).reshape(angle.shape)
    chosen = places[np.arange(len(places)), free.argmax(axis=1)]
    return np.where(np.logical_or.reduce(free, axis=1)[:, None], chosen, position)


def _room(walls: Floats, points: Floats) -> Floats:
    """Return how far points (m, 2) are from the nearest wall of the polygon (W, 2), (m,)."""
    along = np.roll(walls, -1, axis=0) - walls
    offset = points[:, None] - walls
    share = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    return np.hypot(*np.moveaxis(offset - share[..., None] * along, -1, 0)).min(axis=1)


# ---- deaths ----------------------------------------------------------------------------------


def fails(hazard: Hazard, age: Floats, dt: float, rng: np.random.Generator) -> Bools:
    """Return who of age (n,) dies by chance in a tick: the exact probability of a Gompertz hazard, (n,)."""
    c = hazard.ageing
    span = dt if c == 0 else np.exp(c * age) * np.expm1(c * dt) / c
    return rng.random(len(age)) < -np.expm1(-hazard.rate * span)
