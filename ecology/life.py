"""Births, deaths, slots and the serial numbers that never return."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary, physiology, setpoints
from ecology.ground import Ground, wrap
from ecology.spec import Birth, Hazard, Species
from ecology.state import CAUSES, Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.meetings import Met
    from ecology.model import Model

AROUND = 8  # directions in which a parent looks for room for its newborn


def place(ground: Ground, species: Species, count: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return positions (count, 2) and headings (count,) at birth.

    Where the species fixes neither, they are drawn uniformly over the arena, a body's radius away
    from every wall, and over all directions.
    """
    if species.position is not None:
        position = np.tile(np.array(species.position, dtype=float), (count, 1))
    else:
        position = ground.scatter(species.radius, count, rng)
    if species.heading is not None:
        heading = np.full(count, float(species.heading))
    else:
        heading = rng.uniform(-np.pi, np.pi, count)
    return ground.plane.home(position), heading


# ---- births ----------------------------------------------------------------------------------


def reproduce(model: Model, state: State, free: Bools, met: Met, rng: np.random.Generator) -> tuple[Bools, Ints]:
    """Let newborns take `free` slots (N,); return which slots were born (N,) and the slot of each one's parent (N,).

    Those of fit parents come first, then newcomers, then those that the rule brought about in `met`, while slots last.
    """
    born, parent = np.zeros(model.size, bool), model.nobody.copy()
    if not model.grows:
        return born, parent
    if model.mates:
        state.partner = model.nobody.copy()
    for group, species in model.species:
        if not species.grows:
            continue
        slots = group.slots.start + np.flatnonzero(free[group.slots])
        parents = _give_birth(model, state, group.name, species, len(slots), rng)
        arriving = (
            min(int(rng.poisson(species.arrival * model.dt)), len(slots) - len(parents)) if species.arrival else 0
        )
        position, heading = place(model.ground, species, arriving, rng)
        if parents.size:
            near = beside(model.ground, state.position[parents], species.radius, rng)
            position = np.concatenate([near, position])
            heading = np.concatenate([rng.uniform(-np.pi, np.pi, len(parents)), heading])
        if met.outcome is not None and group.name in met.outcome.births:
            of_rule = met.outcome.births[group.name][: len(slots) - len(position)]
            position = np.concatenate([position, model.plane.home(of_rule)])
            heading = np.concatenate([heading, rng.uniform(-np.pi, np.pi, len(of_rule))])
            chosen = met.outcome.parents.get(group.name, np.full(len(of_rule), -1))[: len(of_rule)]
            parents = np.concatenate([parents, np.full(arriving, -1), chosen])
        new = slots[: len(position)]
        if not new.size:
            continue
        start_lives(model, state, new, position, heading)
        parent[new[: len(parents)]] = parents
        state.parent[new[: len(parents)]] = np.where(parents >= 0, state.serial[parents], -1)
        born[new] = True
    return born, parent


def _give_birth(model: Model, state: State, name: str, species: Species, free: int, rng: np.random.Generator) -> Ints:
    """Return the slots of the agents of `species` that reproduce, at most `free`, and charge them for it."""
    rows, needs, birth = model.groups[name].slots, model.needs[name], species.birth
    if birth is None:
        return np.empty(0, np.int64)
    able = fit(birth, needs, state.internal[rows], state.age[rows], state.alive[rows])
    living = int(np.count_nonzero(state.alive[rows])) if birth.limit < np.inf else 0
    parents: Ints = rows.start + bearers(birth, able, free, model.dt, rng, living)
    if birth.parents == 2:
        parents = _find_mates(model, state, parents, rows.start + np.flatnonzero(able), birth.mates_within)
    if parents.size:
        state.own("given")
    for need, cost in birth.cost.items():
        state.internal[parents, needs.index(need)] -= cost
        state.given[parents, needs.index(need)] += cost
    return parents


def _find_mates(model: Model, state: State, parents: Ints, able: Ints, within: float) -> Ints:
    """Return those of `parents` (k,) that have a mate, the nearest other one of `able` (m,), and record it."""
    if len(able) < 2 or not parents.size:
        return parents[:0]
    gap = model.plane.gap(state.position[parents, None], state.position[able])
    distance = np.where(able == parents[:, None], np.inf, gap[..., 0] ** 2 + gap[..., 1] ** 2)  # squared
    nearest = distance.argmin(axis=1)
    found = distance[np.arange(len(parents)), nearest] <= within**2
    state.own("partner")
    assert state.partner is not None
    state.partner[parents[found]] = able[nearest[found]]
    return parents[found]


def start_lives(model: Model, state: State, new: Ints, position: Floats, heading: Floats) -> None:
    """Start lives in the slots `new` (k,), at `position` (k, 2); what was left of the dead there is lost."""
    state.own(
        "serial", "parent", "cause", "fatal_need", "killer", "age", "alive", "action", "bound_for", "position",
        "heading", "received",
    )  # fmt: skip
    start = model.body.start[new]
    state.lost[new] += state.internal[new]
    state.received[new] += start
    state.internal[new] = start
    if state.set_point is not None:
        state.own("set_point")
        state.set_point[new] = setpoints.at_birth(model, model.body.set_point, state.time)[new]
    state.serial[new] = model.serials(state, len(new))
    state.next_serial = int(state.serial[new[-1]]) + 1
    state.alive[new], state.age[new], state.cause[new], state.parent[new] = True, 0.0, 0, -1
    state.fatal_need[new], state.killer[new] = -1, -1
    state.position[new], state.heading[new] = position, wrap(heading)
    state.hold[new], state.bound_for[new] = 0.0, -1
    for name in ("traces", "failed", "load"):  # it remembers nothing, its senses work, and its hands are empty
        if getattr(state, name) is not None:
            state.own(name)
            getattr(state, name)[new] = 0
    state.action[new] = model.tables[int(model.species_of[new[0]])].rest


def are_kin(state: State, one: Ints, other: Ints) -> Bools:
    """Return which of pairs of slots (...) are parent and child, or children of one parent, (...)."""
    mine, theirs = state.serial[one], state.serial[other]
    parents = [state.parent] if state.second is None else [state.parent, state.second]
    found = np.zeros(np.broadcast(mine, theirs).shape, bool)
    for first in parents:
        found |= (first[one] == theirs) | (first[other] == mine)
        for second in parents:
            found |= (first[one] == second[other]) & (first[one] >= 0)
    return found


def fit(birth: Birth, needs: tuple[str, ...], internal: Floats, age: Floats, alive: Bools) -> Bools:
    """Return which agents can reproduce: alive, mature, every need at its threshold, (n,) for internal (n, V)."""
    able: Bools = alive & (age >= birth.maturity)
    for name, least in birth.threshold.items():
        able &= internal[:, needs.index(name)] >= least
    return able


def bearers(birth: Birth, able: Bools, free: int, dt: float, rng: np.random.Generator, living: int = 0) -> Ints:
    """Return which of the `able` (n,) agents reproduce in a tick, at most as many as slots are `free`, in random order.

    `living` is how many of the species are alive, which counts where births have a limit.
    """
    drawn = rng.random((2, len(able)))
    rate = birth.rate if birth.limit == np.inf else birth.rate * max(1.0 - living / birth.limit, 0.0)
    who = np.flatnonzero(able & (drawn[0] < -elementary.expm1(-rate * dt)))
    return who[np.argsort(drawn[1, who])][:free]


def beside(ground: Ground, position: Floats, radius: float, rng: np.random.Generator) -> Floats:
    """Return places (k, 2) beside parents at `position` (k, 2), two radii away: clear of the walls, none between.

    Directions are tried at random; where no one has room, the newborn starts where its parent is.
    """
    angle = rng.uniform(-np.pi, np.pi, len(position))[:, None] + 2 * np.pi / AROUND * np.arange(AROUND)
    way = np.stack([elementary.cos(angle), elementary.sin(angle)], axis=-1)  # (k, AROUND, 2)
    places = position[:, None] + 2.0 * radius * way
    if ground.torus:
        return ground.plane.home(places[:, 0])
    tried = places.reshape(-1, 2)
    near = ground.stays(np.repeat(position, AROUND, axis=0), tried)
    free = np.logical_and(near, ground.inside(tried) & (ground.room(tried) >= radius)).reshape(angle.shape)
    chosen = places[np.arange(len(places)), free.argmax(axis=1)]
    return np.where(np.logical_or.reduce(free, axis=1)[:, None], chosen, position)


# ---- deaths ----------------------------------------------------------------------------------


def die(model: Model, state: State, internal: Floats, met: Met, rng: np.random.Generator) -> tuple[Bools, Ints]:
    """Return which agents die in this tick and the slot of the agent that killed each, -1 without, both (N,).

    The cause is noted. An agent was bitten to death if it would have lived without the wound.
    """
    body, killer = model.body, model.nobody
    died = np.zeros(model.size, bool)
    if not model.mortal:
        return died, killer
    of_need = physiology.fatal(body, internal) if body.deadly else died
    bitten = died
    if met.wound is not None and of_need.any():
        bitten = of_need & (met.biter >= 0) & ~physiology.fatal(body, internal + met.wound)
    failed = np.zeros(model.size, bool)
    for group, species in model.species:
        if species.hazard is not None:
            failed[group.slots] = fails(species.hazard, state.age[group.slots], model.dt, rng)
    for cause, who in (
        ("eaten", met.killed), ("rule", met.ruled), ("bitten", bitten), ("need", of_need), ("hazard", failed)
    ):  # fmt: skip
        new = who & state.alive & ~died
        if not new.any():
            continue
        state.cause = np.where(new, CAUSES.index(cause), state.cause)
        if cause in ("bitten", "need"):
            state.fatal_need = np.where(new, physiology.first_fatal(body, internal), state.fatal_need)
        if cause in ("eaten", "bitten"):
            killer = np.where(new, met.biter, killer)
            state.killer = np.where(new, state.serial[met.biter], state.killer)
        died = died | new
    return died, killer


def fails(hazard: Hazard, age: Floats, dt: float, rng: np.random.Generator) -> Bools:
    """Return which agents of age (n,) die by chance in a tick: the exact probability of a Gompertz hazard, (n,)."""
    c = hazard.ageing
    span = dt if c == 0 else elementary.exp(c * age) * elementary.expm1(c * dt) / c
    return rng.random(len(age)) < -elementary.expm1(-hazard.rate * span)
