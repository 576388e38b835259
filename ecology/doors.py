"""Doors: inner walls that open and close, by time or by the scenario's rule.

Every set of closed doors has a ground and a vision of its own, compiled when it first occurs. The model of a tick is
that of the doors that are closed then. So sight, bodies, bites and seeds know one kind of wall only.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ecology import fields
from ecology.fields import Fields
from ecology.ground import Ground, ground_of
from ecology.sight import Vision, hiding
from ecology.spec import Arena, Door
from ecology.state import Bools, Floats, State

if TYPE_CHECKING:
    from ecology.meetings import Outcome
    from ecology.model import Model


@dataclass(frozen=True, eq=False)
class Doors:
    """The constants of the doors of an arena, and the grounds of those sets that have been closed so far."""

    each: tuple[Door, ...]
    known: dict[bytes, tuple[Ground, Vision, Fields | None]] = field(default_factory=dict)  # by which are open


def first_doors(arena: Arena) -> Bools | None:
    """Return which doors are open at the start, (D,), None where there are none."""
    return np.array([is_due(door, 0.0, door.open) for door in arena.doors]) if arena.doors else None


def is_due(door: Door, time: float, now: bool) -> bool:
    """Return whether a door is to be open at a time: as its period says, or as it is `now` without one."""
    if door.period is None:
        return now
    return (time / door.period + door.phase) % 1.0 < door.open_for - 1e-12


def fit(model: Model, open_: Bools | None = None) -> Model:
    """Return the model with ground, vision and flows for doors (D,) that are `open_`, all of them if None."""
    doors = model.doors
    if doors is None:
        return model
    open_ = np.ones(len(doors.each), bool) if open_ is None else open_
    key = open_.tobytes()
    if key not in doors.known:
        ground = ground_of(shut(model.scenario.arena, open_))
        vision = model.vision._replace(walls=hiding(ground))
        doors.known[key] = ground, vision, fields.around_walls(model.fields, ground)
    ground, vision, flows = doors.known[key]
    return model if model.ground is ground else replace(model, ground=ground, vision=vision, fields=flows)


def shut(arena: Arena, open_: Bools) -> Arena:
    """Return the arena with walls where doors are closed; unlike an arena that is written, they may part it."""
    walls = tuple((door.start, door.end) for door, is_open in zip(arena.doors, open_, strict=True) if not is_open)
    found = object.__new__(Arena)
    found.__dict__.update(arena.__dict__)
    found.__dict__["walls"] = (*arena.inner_walls, *walls) or True
    return found


def turn(model: Model, state: State, outcome: Outcome | None) -> bool:
    """Open and close the doors of `state` for its time and as the rule says; return whether any has moved.

    A door does not close while a body stands in its way.
    """
    doors, open_ = model.doors, state.doors
    if doors is None or open_ is None:
        return False
    orders = {} if outcome is None else outcome.doors
    wanted = np.array(
        [
            orders.get(door.name, is_due(door, state.time, bool(now)))
            for door, now in zip(doors.each, open_, strict=True)
        ]
    )
    closing = np.flatnonzero(open_ & ~wanted)
    for i in closing.tolist():
        wanted[i] = bool((_distance(doors.each[i], state.position[state.alive]) < model.radius[state.alive]).any())
    if (wanted == open_).all():
        return False
    state.doors = wanted
    return True


def _distance(door: Door, points: Floats) -> Floats:
    """Return how far points (n, 2) are from a door, (n,)."""
    start, along = np.array(door.start), np.array(door.end) - np.array(door.start)
    share = np.clip(((points - start) @ along) / (along @ along), 0.0, 1.0)
    off = points - start - share[:, None] * along
    return np.sqrt((off**2).sum(axis=1))
