"""Affective empathy: how the state of others enters one's own drive; pure functions of arrays.

Coupling matrices are dense, n slots of the one who feels by m slots of those whom it may feel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary, physiology
from ecology.ground import Plane
from ecology.life import are_kin
from ecology.neighbours import Pairs
from ecology.physiology import Body
from ecology.spec import Empathy, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model
    from ecology.sight import Vision


@dataclass(frozen=True)
class Coupling:
    """The constants of one species' empathy."""

    species: str
    empathy: Empathy
    rows: slice  # n slots of those who feel
    others: Ints  # (m,) slots of those who may be felt
    weight: Floats  # (n, m) w_ij of the sum form, a factor of it in the average form; 0 for oneself
    counts: Floats  # (m, V) how much each need of the other counts, by the other's columns
    column: Ints  # (m, V) column of the other's need of the same name, -1 without, by one's own columns
    own: Floats  # (V,) w_ii of the average form, by one's own columns; 1 in the sum form
    inherited: bool = False  # whether every body has a weight of its own; `weight` is a factor of that then


def own_weights(species: Species, everyone: Sequence[Species]) -> dict[str, float]:
    """Return w_ii by need: 1, or in the average form what others leave of it."""
    empathy = species.empathy
    if empathy is None or empathy.form == "sum":
        return {need.name: 1.0 for need in species.needs}
    felt = {need.name for s in everyone if s.name in felt_species(species) for need in s.needs}
    return {
        n.name: 1.0 - empathy.weight * empathy.needs.get(n.name, 1.0) if n.name in felt and n.regulated else 1.0
        for n in species.needs
    }


def felt_species(species: Species) -> tuple[str, ...]:
    """Return the names of the species that `species` feels with."""
    empathy = species.empathy
    return () if empathy is None else empathy.species or (species.name,)


def compile_coupling(species: Sequence[Species], slots: Sequence[slice], width: int) -> list[Coupling]:
    """Return the couplings of the species that have empathy; `slots` are those of every species."""
    found = []
    for i, s in enumerate(species):
        if s.empathy is None:
            continue
        felt = [k for k, other in enumerate(species) if other.name in felt_species(s)]
        others = np.concatenate([np.arange(slots[k].start, slots[k].stop) for k in felt])
        inherited = any(trait.of == "empathy.weight" for trait in s.traits)
        weight = np.full((s.slots, len(others)), 1.0 if inherited else float(s.empathy.weight))
        if s.empathy.matrix is not None:
            weight[:, np.isin(others, np.arange(slots[i].start, slots[i].stop))] *= np.array(s.empathy.matrix)
        weight[others == np.arange(slots[i].start, slots[i].stop)[:, None]] = 0.0
        counts, column = np.zeros((len(others), width)), np.full((len(others), width), -1)
        for k in felt:
            names = [need.name for need in species[k].needs]
            theirs = np.isin(others, np.arange(slots[k].start, slots[k].stop))
            counts[theirs, : len(names)] = [s.empathy.needs.get(name, 1.0) for name in names]
            for v, need in enumerate(s.needs):
                if need.name in names:
                    column[theirs, v] = names.index(need.name)
        own = np.ones(width)
        own[: len(s.needs)] = list(own_weights(s, species).values())
        found.append(Coupling(s.name, s.empathy, slots[i], others, weight, counts, column, own, inherited))
    return found


def matrix(
    coupling: Coupling, state: State, plane: Plane, pairs: Pairs | None, seen: Bools | None, ring: Ints | None
) -> Floats:
    """Return how much n agents feel of m others now, (n, m): the weights under every condition and lesion.

    `pairs` and which of them are `seen` (P,) serve the condition of sight; `ring` (N,) is an order of
    all slots in which a shuffled partner is the next one.
    """
    e, rows, others = coupling.empathy, coupling.rows, coupling.others
    weight = coupling.weight * state.alive[rows, None] * state.alive[others]
    if e.kin:
        weight *= are_kin(state, np.arange(rows.start, rows.stop)[:, None], others)
    if np.isfinite(e.within):
        gap = plane.gap(state.position[rows, None], state.position[others])
        weight *= elementary.hypot(gap[..., 0], gap[..., 1]) <= e.within
    if e.sight and pairs is not None and seen is not None:
        sees = np.zeros((len(weight), len(state.alive)), bool)
        who = pairs.who - rows.start
        mine_ = seen & (who >= 0) & (who < len(weight))
        sees[who[mine_], pairs.other[mine_]] = True
        weight *= sees[:, others]
    if e.lesion == "off" and state.time >= e.lesion_at:
        weight[:] = 0.0
    if e.lesion == "shuffled" and ring is not None and state.time >= e.lesion_at:
        weight = _shuffle(weight, state.alive[others], ring[others], others, np.arange(rows.start, rows.stop))
    return weight


def weights(coupling: Coupling, weight: Floats, alive: Bools, column: int | None) -> tuple[Floats, Ints]:
    """Return the w_ij that make the drive of `weight` (n, m), (n, k), one's own among them, and the k slots felt.

    They are those of the need in `column` in the average form, of the one that is felt most where it is None.
    """
    rows, others = coupling.rows, coupling.others
    mine = np.arange(rows.start, rows.stop)
    own = alive[rows].astype(float)
    if coupling.empathy.form == "average":
        column = int(np.argmin(coupling.own)) if column is None else column
        weight = weight * (coupling.column[:, column] >= 0)
        total = weight.sum(axis=1)
        share = np.where(total > 0, 1.0 - coupling.own[column], 0.0)
        weight = weight * np.divide(share, total, out=np.zeros_like(total), where=total > 0)[:, None]
        own -= share
    slots = np.union1d(others, mine)
    found = np.zeros((len(weight), len(slots)))
    found[:, np.searchsorted(slots, others)] = weight
    found[np.arange(len(mine)), np.searchsorted(slots, mine)] = own
    return found, slots


def _shuffle(weight: Floats, alive: Bools, ring: Ints, others: Ints, mine: Ints) -> Floats:
    """Return the weights (n, m) with each partner's place taken by the next one alive in the ring, never oneself."""
    living = np.flatnonzero(alive)[np.argsort(ring[alive])]
    if len(living) < 2:
        return np.zeros_like(weight)
    after = np.zeros(len(others), np.int64)
    after[living] = np.roll(living, -1)
    moved = np.zeros_like(weight)
    row, partner = np.nonzero(weight)
    next_ = after[partner]
    next_ = np.where(others[next_] == mine[row], after[next_], next_)
    np.add.at(moved, (row, next_), weight[row, partner])
    return moved


def feel(coupling: Coupling, weight: Floats, state: State, body: Body) -> Floats:
    """Return what is felt of others, (n, V), by one's own columns (sum form: in column 0) for weights (n, m)."""
    others, rows = coupling.others, coupling.rows
    delta = physiology.deviation(body, state.internal, state.set_point)
    felt = np.zeros((len(weight), delta.shape[1]))
    if coupling.empathy.form == "sum":
        theirs = physiology.drive(
            delta[others] * coupling.counts, body.epsilon[others], body.exponent[others], _form(body, others)
        )
        felt[:, 0] = weight @ theirs
        return felt
    has = coupling.column >= 0
    theirs = np.take_along_axis(delta[others], np.maximum(coupling.column, 0), axis=1) * has
    total = weight @ has
    mean = np.divide(weight @ theirs, total, out=delta[rows].copy(), where=total > 0)
    return (1.0 - coupling.own) * mean


def update_drives(
    model: Model, state: State, vision: Vision, pairs: Pairs | None, order: Ints, factors: Mapping[str, float]
) -> None:
    """Set the drive of every agent, its own and what it feels of others.

    `order` (N,) of all slots serves the shuffled lesion, `factors` multiply what a species feels.
    The dead feel what they felt last: to die is no relief.
    """
    body, last = model.body, (state.drive, state.felt)
    delta = physiology.deviation(body, state.internal, state.set_point)
    exponent = 1.0 if body.straight else body.exponent
    state.own_drive = state.drive = physiology.drive(delta, body.epsilon, exponent, body.form)
    if model.appearing is not None and model.appearing.left:  # what is taken out of the dead changes no drive
        state.own_drive = state.drive = np.where(state.alive, state.drive, last[0])
    if not model.couplings:
        return
    state.own("felt", "drive")
    for coupling in model.couplings:
        rows = coupling.rows
        felt = feel(coupling, weigh(model, state, vision, coupling, pairs, order, factors), state, body)
        state.felt[rows] = felt
        if coupling.empathy.form == "sum":
            state.drive[rows] = state.own_drive[rows] + felt[:, 0]
        else:
            state.drive[rows] = physiology.drive(
                coupling.own * delta[rows] + felt, body.epsilon[rows], body.exponent[rows], _form(body, rows)
            )
    state.drive = np.where(state.alive, state.drive, last[0])
    state.felt = np.where(state.alive[:, None], state.felt, last[1])


def _form(body: Body, which: slice | Ints) -> physiology.Form | None:
    return None if body.form is None else body.form.rows(which)


def weigh(
    model: Model,
    state: State,
    vision: Vision,
    coupling: Coupling,
    pairs: Pairs | None,
    order: Ints,
    factors: Mapping[str, float],
) -> Floats:
    """Return whom the agents of one species feel now and how much, (n, m)."""
    seen = None
    if coupling.empathy.sight and pairs is not None:
        seen = vision.sees_others(pairs, state.position, state.heading, model.looks)
    weight = matrix(coupling, state, model.plane, pairs, seen, order)
    own = None if model.heredity is None else model.heredity.values(state, "empathy.weight", 1.0)
    if own is not None and coupling.inherited:
        weight *= own[coupling.rows, None]
    factor = factors.get(coupling.species, 1.0)
    return weight if factor == 1.0 else weight * factor
