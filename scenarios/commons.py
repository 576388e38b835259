"""The tragedy of the commons: n agents eat from one pool that regrows in proportion to what is left of it.

The pool E grows by a share `growth` per unit of time, up to its capacity E0. Eaters with a fixed appetite q take
n q: E' = min(E0, (1 + growth) E - n q) per unit of time, which a full pool sustains exactly when n q <= growth E0, and
which otherwise empties it for good after ln(n q / (n q - growth E0)) / ln(1 + growth). Agents that learn eat to
hold a need at its set point, which takes `decay` each: n decay in all, as long as no agent takes more than it needs.
A pool that has once fallen below n decay / growth is lost, whoever is to blame.

Agents sense how full the pool is, but nothing rewards restraint. The scenario also serves to measure speed:
its area grows with n (one agent per unit of area), with inner `walls` and the nearest `neighbours` as settings.
"""

from __future__ import annotations

import math

from ecology import Arena, Growth, Need, Neighbours, Resource, Scenario, Species, consume, go_to, move, rest

WALK = 0.1  # length per unit of time
PATCH = 0.35  # radius of the pool, times the side of the arena: all find room in it
THICK, DEEP = 0.02, 0.3  # of the inner walls, times the side of the arena
SMALL = {  # hjb
    "width": 16, "batch": 32, "batch_f": 32, "memory": 2000, "update_every": 4.0, "updates": 1, "place_cells": 0,
    "depth": 1, "errors": 0, "recent_share": 0.4, "relative_weight": 2,
}  # fmt: skip


def build(
    n: int = 12,
    growth: float = 0.0005,
    capacity: float = 300.0,
    appetite: float = 0.05,
    decay: float = 0.01,
    walls: bool = False,
    neighbours: int = 0,
    view_range: float = 2.5,
    ticks: int = 10_000,
) -> Scenario:
    """Return n agents around a pool that starts full.

    `growth` is a share per unit of time, `capacity` E0 in units of intake, `appetite` q and `decay` are units per
    unit of time; `walls` reach from the middle of each side inwards, `neighbours` is how many others are sensed.
    """
    side = max(math.sqrt(n), 2.0)
    pool = Resource(
        name="pool",
        position=(side / 2, side / 2),
        radius=PATCH * side,
        stock=capacity,
        growth=Growth(kind="exponential", rate=math.log1p(growth)),
    )
    ways = {"east": 0.0, "north": math.pi / 2, "west": math.pi, "south": -math.pi / 2}
    agent = Species(
        name="agent",
        needs=(Need(name="food", set_point=1.0, decay=decay, bounds=(0.0, 2.0)),),
        actions=(
            rest(),
            *(move(f"walk_{way}", WALK, direction=angle) for way, angle in ways.items()),
            consume("pool", {"food": appetite}),
            go_to("pool", WALK),
        ),
        count=n,
        senses=("position",),
        sees=("pool",),
        view_range=view_range,
        neighbours=(Neighbours(count=neighbours),) if neighbours else (),
        learner_settings=SMALL,
    )
    arena = Arena(vertices=_bays(side) if walls else ((0, 0), (side, 0), (side, side), (0, side)))
    return Scenario(name="commons", arena=arena, resources=(pool,), species=(agent,), ticks=ticks)


def _bays(side: float) -> tuple[tuple[float, float], ...]:
    """Return a square with a wall from the middle of each side inwards, once around."""
    half, low, high = THICK / 2, 0.5 - THICK / 2, 0.5 + THICK / 2
    bottom = ((0.0, 0.0), (low, 0.0), (low, DEEP), (low + half, DEEP + half), (high, DEEP), (high, 0.0))
    found = []
    for x, y in bottom:
        found.append((x, y))
    quarter = found
    for _ in range(3):  # the same, turned about the middle
        quarter = [(1.0 - y, x) for x, y in quarter]
        found += quarter
    return tuple((side * x, side * y) for x, y in found)
