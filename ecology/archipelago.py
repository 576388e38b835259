"""Archipelago: worlds that run side by side, and exchange agents or breed from one pool."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ecology import typed
from ecology.errors import EcologyError, nearest
from ecology.scenario import Scenario
from ecology.spec import Birth, Species, require

WHERE = ("ring", "all")  # besides a matrix
WHO = ("random", "least drive", "most drive", "oldest", "youngest")
ALIVE = "alive"  # fitness of 1 for every living agent
SELF = 1e-9  # by which the sum of a row of the matrix may differ from 1


@dataclass(frozen=True, kw_only=True)
class Island:
    """One world of an archipelago: a scenario with settings, as `ecology run` takes them."""

    scenario: str  # name, or path of a .py file, relative to the file of the archipelago
    settings: Mapping[str, object] = field(default_factory=dict)  # KEY, learner.KEY or SPECIES.learner.KEY -> value
    learners: tuple[str, ...] = ()  # NAME, or SPECIES=NAME

    def __post_init__(self) -> None:
        typed.check_types(self)


@dataclass(frozen=True, kw_only=True)
class Migration:
    """Migration of agents of a species to other islands, at every exchange.

    Every agent is drawn to leave at `rate`. It leaves if its destination has room: a slot that is free, or becomes free
    in the same exchange. An agent takes along its body, its serial and all that it has learned, and starts where agents
    of its species start at birth.
    """

    species: str
    rate: float  # per unit of time and agent
    where: str | tuple[tuple[float, ...], ...] = (
        "ring"  # "ring": the next island; "all": any other; or row i: shares from i
    )
    who: str = "random"  # who leaves first: "random", "least drive", "most drive", "oldest" or "youngest"

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"migration of {self.species!r}"
        require(math.isfinite(self.rate) and self.rate >= 0, f"{owner}: rate is 0 or more, got {self.rate!r}.")
        if isinstance(self.where, str):
            require(self.where in WHERE, f"{owner}: where is a matrix, or {_among(self.where, WHERE)}")
        require(self.who in WHO, f"{owner}: who is {_among(self.who, WHO)}")


@dataclass(frozen=True, kw_only=True)
class Pool:
    """One mating pool of all islands: each generation is bred from all agents of the one before.

    After every `generation`, all agents of the species are removed, and every island starts with as many newborns as it
    had founders. Their parents are drawn from the living agents of all islands, in proportion to their fitness. Some
    newborns of an island share one parent, so that two of them descend from the same one with the probability
    `relatedness`, besides chance. Newborns inherit traits with mutation; they have learned nothing.
    """

    species: str
    generation: float  # units of time
    fitness: str = ALIVE  # 1 for the living, or the name of a need: its level above the lower bound
    relatedness: float = 0.0  # probability that two newborns of an island share a parent, besides chance
    parents: int = 1  # with 2, every trait comes from one of them at random
    renew: bool = True  # whether every generation starts with the initial stocks

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"pool of {self.species!r}"
        require(0 < self.generation < math.inf, f"{owner}: generation is a positive time, got {self.generation!r}.")
        require(0 <= self.relatedness <= 1, f"{owner}: relatedness is from 0 to 1, got {self.relatedness!r}.")
        require(self.parents in (1, 2), f"{owner}: parents are 1 or 2, got {self.parents!r}.")


@dataclass(frozen=True, kw_only=True)
class Archipelago:
    """Islands, each a world of its own, and the migration or breeding between them.

    `ecology archipelago` runs them, in processes on this machine or as actors on a Ray cluster. The result is the same
    everywhere, bit for bit.
    """

    name: str
    islands: tuple[Island, ...]
    every: float = 100.0  # units of time between two exchanges of migrants
    migrations: tuple[Migration, ...] = ()  # of at most one per species
    pool: Pool | None = None  # of a species that breeds from all islands
    ticks: int = 10_000  # default length of a run
    settings: Mapping[str, object] = field(default_factory=dict)  # as resolved by its file

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner, count = f"archipelago {self.name!r}", len(self.islands)
        require(count > 0, f"{owner}: at least one island.")
        require(0 < self.every < math.inf, f"{owner}: every is a positive time, got {self.every!r}.")
        require(self.ticks > 0, f"{owner}: ticks is a positive whole number, got {self.ticks!r}.")
        species = [migration.species for migration in self.migrations]
        twice = sorted({name for name in species if species.count(name) > 1})
        require(not twice, f"{owner}: a species has one migration, {twice} have several.")
        require(
            self.pool is None or self.pool.species not in species,
            f"{owner}: {self.pool and self.pool.species!r} breeds from a pool and migrates; it does one of both.",
        )
        for migration in self.migrations:
            if isinstance(migration.where, tuple):
                _check_matrix(f"{owner}, migration of {migration.species!r}", migration.where, count)

    @property
    def moving(self) -> list[str]:
        """Return the species that migrate or breed from a pool."""
        pool = [] if self.pool is None else [self.pool.species]
        return [*(migration.species for migration in self.migrations), *pool]

    def check_worlds(self, worlds: list[Scenario]) -> None:
        """Raise EcologyError if the islands' worlds do not allow the migrations or the pool."""
        for i, world in enumerate(worlds):
            require(
                world.dt == worlds[0].dt,
                f"archipelago {self.name!r}: ticks are of one length on all islands; island 0 has dt {worlds[0].dt!r}, "
                f"island {i} {world.dt!r}.",
            )
            for name in self.moving:
                known = {s.name: s for s in world.species}
                if name not in known:
                    raise EcologyError(f"island {i} has no species {name!r}. {nearest(name, known)}")
                require(
                    not known[name].carries,
                    f"agents of {name!r} carry things, which belong to their world; they cannot migrate.",
                )
            if self.pool is not None:
                s = next(s for s in world.species if s.name == self.pool.species)
                needs = [need.name for need in s.needs]
                require(
                    self.pool.fitness in (ALIVE, *needs),
                    f"the pool's fitness is {_among(self.pool.fitness, (ALIVE, *needs))}",
                )
                require(
                    [trait.name for trait in s.traits] == _traits(worlds[0], s.name),
                    f"island {i} has other traits of {s.name!r} than island 0; one pool needs the same traits.",
                )


def as_island(world: Scenario, island: Mapping[str, Any]) -> Scenario:
    """Return the world of an island: its serials are its own, and species that migrate there have room for newcomers.

    `island` has the "number", the number of "islands" and the "species" that migrate; it is empty outside archipelagos.
    """
    if not island:
        return world
    number, count, moving = island["number"], island["islands"], island["species"]
    species = tuple(
        dataclasses.replace(s, birth=Birth(rate=0.0)) if s.name in moving and not s.grows else s for s in world.species
    )
    return dataclasses.replace(world, species=species, numbering=(number, count))


def _check_matrix(owner: str, matrix: tuple[tuple[float, ...], ...], count: int) -> None:
    """Raise EcologyError unless a matrix has, for each of `count` islands, the shares that go to the others."""
    require(
        len(matrix) == count and all(len(row) == count for row in matrix),
        f"{owner}: the matrix is {count} by {count}, a row and a column per island.",
    )
    for i, row in enumerate(matrix):
        good = all(math.isfinite(share) and share >= 0 for share in row)
        total = sum(row)
        require(
            good and row[i] == 0 and (total == 0 or abs(total - 1) <= SELF),
            f"{owner}: row {i} of the matrix has shares of at least 0 that sum to 1, or to 0 if none leaves, and 0 "
            f"for the island itself; got {row!r}.",
        )


def _traits(world: Scenario, species: str) -> list[str]:
    of: Species = next(s for s in world.species if s.name == species)
    return [trait.name for trait in of.traits]


def _among(word: str, known: tuple[str, ...]) -> str:
    return f"one of {', '.join(known)}, got {word!r}. {nearest(word, known)}"
