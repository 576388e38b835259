"""State: everything that changes in a world, one row per slot."""

from __future__ import annotations

import copy
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ecology.errors import EcologyError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# of death: a lethal need, a bite that kills, by chance, the scenario's rule, a bite that takes a lethal need too low
CAUSES = ("alive", "need", "eaten", "hazard", "rule", "bitten")


class Bodies(NamedTuple):
    """What compiled loops read of bodies, and write: arrays of a state, no copies; N slots."""

    alive: Bools  # (N,)
    position: Floats  # (N, 2)
    heading: Floats  # (N,)
    action: Ints  # (N,)
    hold: Floats  # (N,)
    bound_for: Ints  # (N,)


@dataclass
class State:
    """All that changes, for N slots, V needs (the most of any species) and R patches of resources.

    A slot belongs to one species for good; a dead agent's row stays as it was until a newborn takes
    the slot. Rows of a species with fewer than V needs are padded with zeros.
    """

    tick: int
    time: float
    next_serial: int
    alive: Bools  # (N,)
    serial: Ints  # (N,) number of the agent in the slot, never used again; -1 before the first
    parent: Ints  # (N,) serial of the parent; -1: none
    cause: Ints  # (N,) what it died of, an index into CAUSES; 0 while it lives
    fatal_need: Ints  # (N,) column of the lethal need it died of, the first in its species' order; -1: none
    killer: Ints  # (N,) serial of the agent that bit it to death; -1: none
    age: Floats  # (N,) time since birth
    position: Floats  # (N, 2)
    heading: Floats  # (N,) radians in [-pi, pi)
    internal: Floats  # (N, V) x
    drive: Floats  # (N,) d, including what is felt of others
    own_drive: Floats  # (N,) d(delta), without what is felt of others
    felt: Floats  # (N, V) of others: average form, sum of w_ij delta_j per need; sum form, in column 0, of w_ij d_j
    action: Ints  # (N,) executed in the last tick, an index into the species' own actions
    hold: Floats  # (N,) time for which the present action still immobilises the body
    bound_for: Ints  # (N,) patch that a go_to under way leads to; -1: none
    bit: Ints  # (N,) slot that was bitten with success in the last tick; -1: none
    gave: Ints  # (N,) slot that was given to in the last tick; -1: none
    inside: Bools  # (N, R) within the patch's circle
    seen: Bools  # (N, R) within the view field, with no wall between
    resource_position: Floats  # (R, 2)
    stock: Floats  # (R,) what is left, units of intake
    available: Bools  # (R,) whether it is available in this unit of time
    # the account, summed up since the start: what is stored is what came in less what went out
    grown: Floats  # (R,) into the stock, by all but what spoiled: growth, relocation, seeds, remains; unlimited: eaten
    eaten: Floats  # (R,) out of the stock
    ingested: Floats  # (N, V) eaten by the body
    received: Floats  # (N, V) from others: prey, gifts, at birth, by the scenario's own rule
    given: Floats  # (N, V) to others: bitten off, gifts, the cost of a birth, remains, by the scenario's own rule
    metabolised: Floats  # (N, V) taken by the rest of f and g: its own dynamics, other controls, noise
    lost: Floats  # (N, V) beyond the bounds, in the tick of death, or a body's rest; negative: held up by a bound
    returned: int  # times that a body outside the arena was put back inside
    closed: Ints  # (N,) closed actions chosen so far, each replaced
    # there only in worlds that use them, else None
    memory: Floats | None = None  # (M,) what the scenario's rule remembers, one name after the other
    pace: Floats | None = None  # (N,) share of its speed at which the rule lets a body move in the next tick
    traces: Floats | None = None  # (N, T) fading memories, by the columns that each species gives them
    misread: Floats | None = None  # (N, F) noise of faulty senses in this tick, in standard deviations
    failed: Bools | None = None  # (N, F) faulty senses that read nothing
    load: Floats | None = None  # (N, K) carried of each resource, units of its stock
    grid: Floats | None = None  # (M,) the fields that change, a value per cell, one field after the other
    doors: Bools | None = None  # (D,) open
    sight: Floats | None = None  # (N,) share of its view range that the rule lets it see
    set_point: Floats | None = None  # (N, V) x*, where it moves
    trait: Floats | None = None  # (N, T) inherited traits, by the columns of the slot's own species
    partner: Ints | None = None  # (N,) slot of the mate of an agent that reproduced in this tick; -1: none
    second: Ints | None = None  # (N,) serial of the second parent; -1: none
    cue: Floats | None = None  # (C,) value shown of every cue, from 0 to 1

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the array fields by name; those that this world does not use are left out."""
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}

    def next(self) -> State:
        """Return a state that begins as this one and shares its arrays: steps of the tick replace arrays.

        A step that writes into an array calls `own` first, which copies it.
        """
        after = object.__new__(State)
        after.__dict__ = self.__dict__.copy()
        return after

    def own(self, *names: str) -> None:
        """Copy the arrays `names`, so that writing into them does not change an earlier state."""
        values = self.__dict__
        for name in names:
            values[name] = values[name].copy()

    def bodies(self) -> Bodies:
        """Return the arrays that loops over bodies need, as they are now."""
        return Bodies(self.alive, self.position, self.heading, self.action, self.hold, self.bound_for)

    def readonly(self) -> State:
        """Return a view of this state that refuses to be written, its arrays and its fields."""
        view = object.__new__(_ReadOnly)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                value = value.view()
                value.setflags(write=False)
            vars(view)[name] = value
        return view

    def copy(self) -> State:
        """Return a deep copy, which may be written."""
        found = object.__new__(State)
        vars(found).update(copy.deepcopy(vars(self)))
        return found


class _ReadOnly(State):
    """A state that was handed out: no field of it can be set; what `dataclasses.replace` makes of it is a State."""

    def __new__(cls, **values: Any) -> State:  # type: ignore[misc]
        return State(**values) if values else object.__new__(cls)

    def __setattr__(self, name: str, value: object) -> None:
        raise EcologyError(
            f"the state is read-only, {name!r} cannot be set; use `env.set_state({name}=...)` between ticks, and the "
            "outcome of a rule within one."
        )
