"""Heredity: numbers of a body that children have from their parents, with mutations.

`State.trait` (N, T) holds the values, a column per trait of the slot's own species. A child has each trait from one of
its parents, by a coin where there are two, plus a normal mutation, kept within the bounds. What is said of one number
of a species in the scenario then is said of every body by its own trait. A setting of the learner is a trait like any
other here: the world holds and inherits it, and only the learner knows what it means.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ecology import setpoints
from ecology.errors import EcologyError, nearest
from ecology.spec import BODILY, Species, Trait, require
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model
    from ecology.physiology import Body

OTHERS = ("speed", "empathy.weight", "none")  # what else a trait can be of
LEARNER = "learner."  # before the name of a setting of the species' learner
STREAM = "heredity"  # of the random numbers


class Own(NamedTuple):
    """A trait of one species: where its values are and what they stand for."""

    trait: Trait
    species: str
    rows: slice
    column: int  # of `State.trait`
    field: str  # of `Body`, one of OTHERS, or LEARNER and a setting
    need: int  # column of the need, -1 without


class LearnerTrait(NamedTuple):
    """A trait that is a setting of the learner; the world inherits it, and the learner reads it."""

    name: str
    setting: str
    column: int  # of `State.trait`
    bounds: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Heredity:
    """The traits of a world, T the most of any species."""

    traits: tuple[Own, ...]
    start: Floats  # (N, T) mean of founders and newcomers
    spread: Floats  # (N, T) their standard deviation
    mutation: Floats  # (N, T) standard deviation
    low: Floats  # (N, T)
    high: Floats  # (N, T)

    def values(self, state: State, field: str, otherwise: float) -> Floats | None:
        """Return the values (N,) of a field that belongs to no need, `otherwise` where a body has none of its own."""
        meant = [own for own in self.traits if own.field == field]
        if not meant:
            return None
        assert state.trait is not None
        found = np.full(len(state.alive), otherwise)
        for own in meant:
            found[own.rows] = state.trait[own.rows, own.column]
        return found


def read(species: Species, trait: Trait) -> tuple[str, int, float]:
    """Return the field, the column of its need (-1 without) and the scenario's value of what a trait is of.

    Raises EcologyError where it is of nothing that can be inherited.
    """
    owner, names = f"species {species.name!r}: the trait {trait.name!r}", [need.name for need in species.needs]
    need, _, field = trait.of.rpartition(".")
    if need in names and field in BODILY:
        own_need = species.needs[names.index(need)]
        return field, names.index(need), float(getattr(own_need, field))
    known = [*OTHERS, f"{LEARNER}SETTING", *(f"{name}.{field}" for name in names for field in BODILY)]
    if trait.of.startswith(LEARNER) and field.isidentifier():
        value = species.learner_settings.get(field) if trait.start is None else trait.start
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise EcologyError(f"{owner} needs a start: learner_settings of the species have no number {field!r}.")
        return trait.of, -1, float(value)
    require(trait.of in OTHERS, f"{owner} is of {trait.of!r}, which cannot be inherited. {nearest(trait.of, known)}")
    if trait.of == "empathy.weight":
        sums = species.empathy is not None and species.empathy.form == "sum"
        require(sums, f"{owner} needs empathy in the sum form; in the average form weights are shares that all know.")
        assert species.empathy is not None
        return trait.of, -1, float(species.empathy.weight)
    return trait.of, -1, 1.0 if trait.of == "speed" else float(np.mean(trait.bounds))


def learner_traits(species: Species) -> tuple[LearnerTrait, ...]:
    """Return the traits of a species that are settings of its learner."""
    return tuple(
        LearnerTrait(trait.name, trait.of.removeprefix(LEARNER), column, trait.bounds)
        for column, trait in enumerate(species.traits)
        if trait.of.startswith(LEARNER)
    )


def check_traits(species: Species) -> None:
    """Raise EcologyError where the traits of a species do not fit it."""
    owner = f"species {species.name!r}"
    for what in ("name", "of"):
        values = [getattr(trait, what) for trait in species.traits if getattr(trait, what) != "none"]
        twice = sorted({name for name in values if values.count(name) > 1})
        require(not twice, f"{owner}: every trait has a {what} of its own, {twice} appear twice.")
    for trait in species.traits:
        field, column, value = read(species, trait)
        low, high = trait.bounds
        value = value if trait.start is None else trait.start
        require(
            low <= value <= high,
            f"{owner}: the trait {trait.name!r} starts at {value:g}, outside its bounds {trait.bounds!r}; widen them.",
        )
        least, most = species.needs[column].set_points if field == "set_point" else (-math.inf, math.inf)
        if field in ("leak", "noise", "speed"):
            least = 0.0
        require(
            least <= low and high <= most,
            f"{owner}: the bounds {trait.bounds!r} of the trait {trait.name!r} must lie from {least:g} to {most:g}"
            + ("; give the need a wider set_range." if field == "set_point" else "."),
        )


def compile_heredity(species: Sequence[Species], slots: Sequence[slice]) -> Heredity | None:
    """Return the traits of the slots of `species`; None where none has any."""
    most = max(len(s.traits) for s in species)
    if not most:
        return None
    size = slots[-1].stop
    start, spread, mutation, low, high = np.zeros((5, size, most))
    traits = []
    for s, rows in zip(species, slots, strict=True):
        for t, trait in enumerate(s.traits):
            field, need, value = read(s, trait)
            traits.append(Own(trait, s.name, rows, t, field, need))
            start[rows, t] = value if trait.start is None else trait.start
            spread[rows, t], mutation[rows, t] = trait.spread, trait.mutation
            low[rows, t], high[rows, t] = trait.bounds
    return Heredity(tuple(traits), start, spread, mutation, low, high)


def arrive(heredity: Heredity, rng: np.random.Generator) -> Floats:
    """Return the traits (N, T) of bodies without parents, in every slot."""
    drawn = heredity.start + heredity.spread * rng.standard_normal(heredity.start.shape)
    return np.clip(drawn, heredity.low, heredity.high)


def inherit(model: Model, state: State, born: Bools, parent: Ints, streams: Mapping[str, np.random.Generator]) -> None:
    """Give the newborns `born` (N,) the traits of their parents in the slots `parent` (N,), -1 without.

    Numbers are drawn for all slots, so that they do not depend on who is born.
    """
    heredity = model.heredity
    if heredity is None or not born.any():
        return
    assert state.trait is not None
    new, shape, rng = np.flatnonzero(born), heredity.start.shape, streams[STREAM]
    strange, change, coin = arrive(heredity, rng), rng.standard_normal(shape), rng.random(shape) < 0.5
    mother = parent[new]
    father = mother if state.partner is None else np.where(mother >= 0, state.partner[mother], -1)
    father = np.where(father >= 0, father, mother)
    values = np.where(coin[new], state.trait[mother], state.trait[father]) + heredity.mutation[new] * change[new]
    values = np.clip(values, heredity.low[new], heredity.high[new])
    settle(model, state, new, np.where((mother >= 0)[:, None], values, strange[new]))
    if state.second is not None:
        state.own("second")
        state.second[new] = np.where(father != mother, state.serial[father], -1)


def settle(model: Model, state: State, new: Ints, values: Floats) -> None:
    """Give the bodies in the slots `new` (k,) their traits (k, T), and what they begin with of them."""
    state.own("trait")
    assert state.trait is not None
    state.trait[new] = values
    if state.set_point is not None:
        state.own("set_point")
        state.set_point[new] = setpoints.at_birth(model, base(model, state), state.time)[new]


def embody(heredity: Heredity, body: Body, state: State) -> Body:
    """Return the constants of all bodies, each with its own traits in place of the scenario's numbers."""
    assert state.trait is not None
    changed: dict[str, Floats] = {}
    for own in heredity.traits:
        if own.need >= 0:
            array = changed.setdefault(own.field, getattr(body, own.field).copy())
            array[own.rows, own.need] = state.trait[own.rows, own.column]
    at_work = {"leak": "leaks", "ageing": "varies", "noise": "noisy"}
    flags = {at_work[field]: True for field in changed if field in at_work}
    return replace(body, **changed, **flags)  # type: ignore[arg-type]


def base(model: Model, state: State) -> Floats:
    """Return x*_0, around which set points move, (N, V)."""
    found = model.body.set_point
    if model.heredity is None or state.trait is None:
        return found
    for own in model.heredity.traits:
        if own.field == "set_point":
            found = found.copy() if found is model.body.set_point else found
            found[own.rows, own.need] = state.trait[own.rows, own.column]
    return found


class Price(NamedTuple):
    """The change of a mean trait and its two parts (Price 1970): change = selection + transmission."""

    change: float
    selection: float  # cov(w, z) / mean w
    transmission: float  # mean of w dz / mean w


def price(before: Mapping[int, float], after: Mapping[int, tuple[float, Sequence[int]]]) -> Price:
    """Return the Price equation of a trait between two times.

    `before`: the trait of everybody who lived then, by serial. `after`: of everybody who lives now, its trait and the
    serials of those of `before` that it descends from: itself, or one or two parents. Raises EcologyError where
    somebody has no parent among the agents before.
    """
    z = np.array(list(before.values()), float)
    place = {serial: i for i, serial in enumerate(before)}
    w, passed = np.zeros(len(z)), np.zeros(len(z))  # fitness, and fitness times the change from it to descendants
    for serial, (value, sources) in after.items():
        require(
            bool(sources) and set(sources) <= place.keys(), f"agent {serial} has no parent among the agents before."
        )
        for source in sources:
            share = 1 / len(sources)
            w[place[source]] += share
            passed[place[source]] += share * (value - z[place[source]])
    change = float(np.mean([value for value, _ in after.values()]) - z.mean())
    return Price(change, float(np.mean(w * z) / w.mean() - z.mean()), float(passed.mean() / w.mean()))
