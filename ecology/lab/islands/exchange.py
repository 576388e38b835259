"""Exchanges between islands at a stop: migration and breeding. Pure functions of the census."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ecology import Migration, Pool, Trait, elementary, heredity
from ecology.lab.islands.island import Count


@dataclass
class Moves:
    """The agents of one species that leave, in order: from which island and slot, and where to."""

    origin: np.ndarray  # (m,) island
    slot: np.ndarray  # (m,)
    serial: np.ndarray  # (m,)
    to: np.ndarray  # (m,) island
    refused: int  # that would have left, but there was no room


def draw_moves(migration: Migration, counts: Sequence[Count], time: float, seed: np.random.SeedSequence) -> Moves:
    """Draw the agents that leave in an exchange, `time` after the last one."""
    rng, islands = np.random.default_rng(seed), len(counts)
    share = -elementary.expm1(-migration.rate * time)
    origin, row, to = [], [], []
    for i, count in enumerate(counts):
        leaving = int(np.count_nonzero(rng.random(len(count.slots)) < share))
        order = _order(migration.who, count, rng)[:leaving]
        goes = _destinations(migration, i, islands, rng.random(len(order)))
        some = goes >= 0
        origin.append(np.full(np.count_nonzero(some), i))
        row.append(order[some])
        to.append(goes[some])
    moves = Moves(
        origin=np.concatenate(origin),
        slot=np.concatenate([count.slots[rows] for count, rows in zip(counts, row, strict=True)]),
        serial=np.concatenate([count.serial[rows] for count, rows in zip(counts, row, strict=True)]),
        to=np.concatenate(to),
        refused=0,
    )
    return _with_room(moves, np.array([count.free for count in counts]))


def _order(who: str, count: Count, rng: np.random.Generator) -> np.ndarray:
    """Return the rows of a census (k,) in the order in which agents leave."""
    drawn = rng.permutation(len(count.slots))
    by = {"least drive": count.drive, "most drive": -count.drive, "oldest": -count.age, "youngest": count.age}
    return drawn if who == "random" else drawn[np.argsort(by[who][drawn], kind="stable")]


def _destinations(migration: Migration, island: int, islands: int, drawn: np.ndarray) -> np.ndarray:
    """Return the destinations of an island's agents (k,), from uniform numbers (k,); -1 for those that stay."""
    if isinstance(migration.where, tuple):
        upto = np.cumsum(migration.where[island])
        target = np.searchsorted(upto, drawn * upto[-1], side="right")
        return np.where(upto[-1] > 0, np.minimum(target, islands - 1), -1)
    if islands == 1:
        return np.full(len(drawn), -1)
    if migration.where == "ring":
        return np.full(len(drawn), (island + 1) % islands)
    return (island + 1 + np.floor(drawn * (islands - 1)).astype(np.int64)) % islands


def _with_room(moves: Moves, free: np.ndarray) -> Moves:
    """Return the moves for which there is room, `free` slots (K,) and those that others leave; the last are refused."""
    kept = np.ones(len(moves.to), bool)
    while True:
        leave, come = (np.bincount(at[kept], minlength=len(free)) for at in (moves.origin, moves.to))
        over = come - free - leave
        if (over <= 0).all():
            break
        for island in np.flatnonzero(over > 0):
            kept[np.flatnonzero(kept & (moves.to == island))[-over[island] :]] = False
    origin, slot, serial, to = (array[kept] for array in (moves.origin, moves.slot, moves.serial, moves.to))
    return Moves(origin, slot, serial, to, refused=int(np.count_nonzero(~kept)))


@dataclass
class Brood:
    """The next generation: per island the serials of the parents and the traits, and what was selected."""

    parents: list[np.ndarray]  # per island (n,)
    traits: list[np.ndarray | None]  # per island (n, T)
    report: dict[str, Any]  # of the generation, for the ledger


def draw_brood(pool: Pool, traits: Sequence[Trait], counts: Sequence[Count], seed: np.random.SeedSequence) -> Brood:
    """Draw the next generation of all islands; empty if no agent is left."""
    rng = np.random.default_rng(seed)
    serial = np.concatenate([count.serial for count in counts])
    weight = np.concatenate([np.maximum(_require_array(count.fitness), 0.0) for count in counts])
    weight = weight if weight.sum() > 0 else np.ones(len(serial))
    sizes = [count.founders if len(serial) else 0 for count in counts]
    z = np.concatenate([_require_array(count.trait) for count in counts]) if traits else np.zeros((len(serial), 0))
    upto = np.cumsum(weight)
    low, high = (np.array([trait.bounds[side] for trait in traits]) for side in (0, 1))
    mutation = np.array([trait.mutation for trait in traits])
    first, second, values = [], [], []
    for size in sizes:
        one, other = (_draw_parents(pool, upto, size, rng) for _ in range(2))
        other = other if pool.parents == 2 else one
        coin = rng.random((size, len(traits))) < 0.5
        found = np.where(coin, z[one], z[other]) + mutation * rng.standard_normal((size, len(traits)))
        first.append(one)
        second.append(other)
        values.append(np.clip(found, low, high))
    report: dict[str, Any] = {"parents": len(serial), "born": sum(sizes)}
    report |= {"distinct parents": len(np.unique(np.concatenate([*first, *second])))} if len(serial) else {}
    if len(serial):
        children, mother, father = np.concatenate(values), np.concatenate(first), np.concatenate(second)
        report["traits"] = {
            trait.name: _measure_selection(z[:, t], children[:, t], serial, mother, father)
            for t, trait in enumerate(traits)
        }
    return Brood([serial[one] for one in first], [found if traits else None for found in values], report)


def _draw_parents(pool: Pool, upto: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the parents of an island's newborns, as rows (size,); some newborns share one."""
    drawn = rng.random(size + 1)
    kin = rng.random(size) < np.sqrt(pool.relatedness)
    rows = np.minimum(np.searchsorted(upto, drawn * (upto[-1] if len(upto) else 0.0), side="right"), len(upto) - 1)
    return np.where(kin, rows[-1], rows[:-1])


def _measure_selection(
    z: np.ndarray, child: np.ndarray, serial: np.ndarray, mother: np.ndarray, father: np.ndarray
) -> dict[str, float]:
    """Return the mean of a trait before and after, and the Price equation between them."""
    before = dict(zip(serial.tolist(), z.tolist(), strict=True))
    after = {
        i: (value, list(dict.fromkeys((int(serial[m]), int(serial[f])))))
        for i, (value, m, f) in enumerate(zip(child.tolist(), mother, father, strict=True))
    }
    price = heredity.price(before, after)
    return {
        "mean": float(z.mean()),
        "sd": float(z.std()),
        "next": float(child.mean()),
        "change": price.change,
        "selection": price.selection,
        "transmission": price.transmission,
    }


def _require_array(array: np.ndarray | None) -> np.ndarray:
    assert array is not None  # the census of a species with a pool has it
    return array
