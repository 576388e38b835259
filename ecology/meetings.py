"""What bodies do to each other when they meet: bite, give, crowd, and the scenario's own rule."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from ecology.errors import EcologyError, nearest
from ecology.kernels import inside_polygon
from ecology.spec import Arena
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.scenario import Scenario


@dataclass
class Outcome:
    """What meetings come to in one tick, for N slots and V needs. It has no other fields than these."""

    received: Floats  # (N, V) units added to needs
    given: Floats  # (N, V) units taken from needs
    killed: Bools  # (N,)
    position: Floats | None = None  # (N, 2) where bodies are put; None: they stay where they are

    def __setattr__(self, name: str, value: object) -> None:
        if name not in OUTCOME:
            raise EcologyError(
                f"the outcome of a rule has no field {name!r}. {nearest(name, OUTCOME)} A rule changes nothing else."
            )
        object.__setattr__(self, name, value)


OUTCOME = tuple(f.name for f in fields(Outcome))


@dataclass(frozen=True)
class World:
    """What a scenario's own rule is shown: the read-only state in the middle of a tick, and where to find what.

    Bodies have moved; needs are as they were at the start of the tick.
    """

    state: State  # read-only
    dt: float
    slots: Mapping[str, slice]  # by species
    needs: Mapping[str, tuple[str, ...]]  # by species, in the order of the columns
    actions: Mapping[str, tuple[str, ...]]  # by species, in the order of the indices
    resources: Mapping[str, slice] = field(default_factory=dict)  # rows of its patches, by resource
    arena: Arena | None = None

    def resource(self, name: str) -> slice:
        """Return the rows of the patches of a resource in `state.stock`, `state.resource_position` and the like."""
        return self.resources[self._known(self.resources, name, "resource")]

    def inside(self, position: Floats) -> Bools:
        """Return which of `position` (n, 2) lie in the arena, (n,); all do where it has no walls, as a torus."""
        if self.arena is None or not self.arena.walls:
            return np.ones(len(position), bool)
        return inside_polygon(np.array(self.arena.vertices, float), np.asarray(position, float))

    def column(self, species: str, need: str) -> int:
        """Return the column of a need of `species` in `state.internal`."""
        return self._index(self.needs, species, need, "need")

    def does(self, species: str, action: str) -> Bools:
        """Return which slots of `species` are alive and execute `action` in this tick, (n,)."""
        rows = self.slots[self._known(self.slots, species, "species")]
        return (self.state.action[rows] == self._index(self.actions, species, action, "action")) & self.state.alive[
            rows
        ]

    def nothing(self) -> Outcome:
        """Return an outcome of zeros, to be written into."""
        shape = self.state.internal.shape
        return Outcome(np.zeros(shape), np.zeros(shape), np.zeros(shape[0], bool))

    def _index(self, table: Mapping[str, tuple[str, ...]], species: str, name: str, what: str) -> int:
        names = table[self._known(table, species, "species")]
        return names.index(self._known(names, name, what))

    @staticmethod
    def _known(names, name: str, what: str) -> str:
        if name not in names:
            raise EcologyError(f"the rule asks for the {what} {name!r}. {nearest(name, names)}")
        return name


Rule = Callable[[World, np.random.Generator], Outcome]


def checked(outcome: Outcome, scenario: Scenario, world: World) -> Outcome:
    """Return the outcome of a scenario's own rule in `world`, or raise EcologyError where it is none."""
    owner, state = f"the rule of scenario {scenario.name!r}", world.state
    if not isinstance(outcome, Outcome):
        raise EcologyError(f"{owner} must return an Outcome (start from world.nothing()), got {outcome!r}.")
    for word, like in (("received", state.internal), ("given", state.internal), ("position", state.position)):
        value = getattr(outcome, word)
        if value is None and word == "position":
            continue
        numbers = isinstance(value, np.ndarray) and value.dtype.kind in "biuf"
        if not numbers or value.shape != like.shape or not np.isfinite(value).all():
            raise EcologyError(
                f"{owner}: {word} must be an array of finite numbers of shape {like.shape}, got {value!r}."
            )
    killed = outcome.killed
    if not isinstance(killed, np.ndarray) or killed.shape != state.alive.shape or killed.dtype != bool:
        raise EcologyError(
            f"{owner}: killed must be an array of true or false of shape {state.alive.shape}, got {killed!r}."
        )
    for species, needs in world.needs.items():
        rows = world.slots[species]
        for word in ("received", "given"):
            beyond = getattr(outcome, word)[rows, len(needs) :]
            if beyond.size and (beyond[state.alive[rows]] != 0).any():
                raise EcologyError(
                    f"{owner}: {word} has a column other than 0 for {species!r} that is none of its needs "
                    f"({', '.join(needs)}); find the column of a need by world.column({species!r}, need)."
                )
    if outcome.position is not None:
        outside = state.alive & ~world.inside(outcome.position)
        if outside.any():
            slot = int(np.argmax(outside))
            species = next(name for name, rows in world.slots.items() if rows.start <= slot < rows.stop)
            raise EcologyError(
                f"{owner}: position puts {species}_{state.serial[slot]} at {outcome.position[slot].tolist()}, outside "
                "the arena; world.inside(position) says which places are within."
            )
    return outcome


def succeed(attackers: Ints, victims: Ints, chance: Floats, dt: float, slots: int, rng: np.random.Generator) -> Bools:
    """Return which of the attackers (k,) succeed on their victims (k,), at most one on each victim.

    `chance` (k,) is per unit of time. Numbers are drawn for all `slots`, so that they do not depend on who bites.
    """
    drawn, order = rng.random((2, slots))
    success = drawn[attackers] < 1.0 - (1.0 - chance) ** dt
    winner = np.full(slots, np.inf)
    np.minimum.at(winner, victims[success], order[attackers[success]])
    return success & (order[attackers] == winner[victims])


def gifts(wanted: Floats, held: Floats) -> Floats:
    """Return what is given (k, V) of what is `wanted` (k, V): at most what is `held` (k, V) above the bound."""
    return np.minimum(wanted, np.maximum(held, 0.0))
