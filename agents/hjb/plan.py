"""The plan behind a decision, for observers: the best movements that the lookahead finds, and where they lead.

It runs the same beam search as the devices do, over all predicted states of a depth at once, and changes nothing.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ecology.agents.hjb.devices.plain.networks import deviations, forecast
from ecology.agents.hjb.devices.plain.scores import add_optimism, drive_on_the_way
from ecology.agents.hjb.devices.plain.update import agent_of, own_constants
from ecology.agents.hjb.devices.records import FADING, FAINT, LONGEST, PRIOR, STALE, Agent, Encoding, RecalledErrors
from ecology.agents.hjb.devices.torch.encoding import on_device
from ecology.decision import Plan

if TYPE_CHECKING:
    from ecology.agents.hjb.learner import HJB


class Nodes(NamedTuple):
    """n predicted states of one depth."""

    state: Tensor  # (n, D)
    cost: np.ndarray  # (n,) discounted drive on the way
    keep: np.ndarray  # (n,) discount
    open: np.ndarray  # bool (n, M)
    score: np.ndarray  # (n,)
    ways: list[tuple[int, ...]]  # n: the movements on the way
    states: list[tuple[np.ndarray, ...]]  # n: the states on the way, the last one included


def best_plan(learner: HJB, slot: int, zeta: np.ndarray, open_: np.ndarray) -> Plan | None:
    """Return the best plan of the agent in `slot` at zeta (D,) with movements `open_` (M,), by its present knowledge.

    None if the learner does not score whole movements, or if its networks are not NumPy arrays.
    """
    s = own_constants(on_device(learner.encoding, torch.device("cpu")), learner.weights, slot)
    if not s.finite or not isinstance(learner.weights.f, np.ndarray) or not open_.any():
        return None
    own = agent_of(s, learner.weights, slot, learner.weights.target[slot], learner.weights.optimism[slot])
    memory, now = learner.replay, learner.clock[slot] * np.float32(learner.group.dt)
    trace = (array[slot] for array in learner.trace)
    past = RecalledErrors._make((*trace, now, memory.zeta[slot], memory.open[slot], memory.count[slot]))
    first = torch.from_numpy(np.ascontiguousarray(zeta, np.float32))
    with torch.no_grad(), _one_thread():
        best = _search(s, own, past, first, open_, learner.rest_terms(np.array([slot]), first.numpy()[None]))
    return dataclasses.replace(best, options=tuple(learner.moves.names[int(m)] for m in best.options))


@contextlib.contextmanager
def _one_thread() -> Iterator[None]:
    """Compute on one thread: the tensors are small, and threads of a busy machine wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _search(
    s: Encoding, own: Agent, past: RecalledErrors, first: Tensor, open_: np.ndarray, rest: tuple[np.ndarray, np.ndarray]
) -> Plan:
    """Return the best plan at `first` (D,), its options by index; `rest` are the terms of the advantage of rest."""
    zeta = first.numpy()
    nodes = Nodes(first[None], np.zeros(1), np.ones(1), open_[None], np.zeros(1), [()], [(zeta,)])
    for depth in range(s.depth):
        nodes = _expand(s, own, past, nodes)
        if depth < s.depth - 1:
            nodes = _take(nodes, _best(s, nodes))
            nodes = nodes._replace(open=_recall_open(s, past, nodes.state, first, open_))
    share, relief = rest
    roots = [way[0] for way in nodes.ways]
    score = nodes.score - np.clip(share[0] * nodes.score, 0, relief[0, roots])
    at = int(np.argmin(score))
    return Plan(tuple(map(str, nodes.ways[at])), np.stack(nodes.states[at]), float(score[at]))


def _expand(s: Encoding, own: Agent, past: RecalledErrors, nodes: Nodes) -> Nodes:
    """Return the successors of all nodes with their scores."""
    predicted = forecast(s, own, nodes.state) * s.unit + _recall(s, past, nodes.state)
    row, movement = np.nonzero(nodes.open)
    step = predicted[torch.from_numpy(row), torch.from_numpy(movement)]
    before = nodes.state[torch.from_numpy(row)]
    parts = len(s.low)
    after = torch.minimum(torch.maximum(before + step[:, :parts], s.low), s.high)
    fade = np.exp(float(s.log_gamma) * step[:, parts].clamp(float(s.dt), LONGEST).numpy().astype(float))
    way = drive_on_the_way(s, before, after, torch.from_numpy(fade), step[:, -1]).numpy()
    cost, keep = nodes.cost[row] + nodes.keep[row] * way, nodes.keep[row] * fade
    value = add_optimism(s, own, after, deviations(s, own, after)).numpy()
    return Nodes(
        after,
        cost,
        keep,
        nodes.open[row],
        cost + keep * value,
        [(*nodes.ways[i], int(m)) for i, m in zip(row, movement, strict=True)],
        [(*nodes.states[i], state.numpy()) for i, state in zip(row, after, strict=True)],
    )


def _recall(s: Encoding, past: RecalledErrors, zeta: Tensor) -> Tensor:
    """Return the errors of f (n, M, E) to be expected at zeta (n, D): see the plain `recall`."""
    count = min(int(past.noted), len(past.movement))
    if not count:
        return torch.zeros(1)
    exponent = -0.5 * _gaps(s, zeta, past.where[:count]) - (float(past.now) - past.time[:count]) / FADING
    weight = np.where(exponent > FAINT, np.exp(exponent), 0.0)  # (n, L)
    which = past.movement[:count, None] == np.arange(s.movements)  # (L, M)
    total = np.einsum("nl,lm,ld->nmd", weight, which.astype(float), past.error[:count])
    found = total / (weight @ which + PRIOR)[..., None]
    return torch.from_numpy(found.astype(np.float32))


def _gaps(s: Encoding, zeta: Tensor, where: np.ndarray) -> np.ndarray:
    """Return the squared distances (n, K) between zeta (n, D) and the places `where` (K, W)."""
    gap = zeta.numpy()[:, None, s.where.numpy()] - where[None]
    gap = np.where(s.turning.numpy(), (gap + math.pi) % (2 * math.pi) - math.pi, gap) * s.nearness.numpy()
    return np.square(gap).sum(-1)


def _recall_open(s: Encoding, past: RecalledErrors, zeta: Tensor, here: Tensor, open_: np.ndarray) -> np.ndarray:
    """Return what is expected to be open (n, M) at zeta (n, D): see the plain `recall_open`."""
    places, opened = [here.numpy()[None, s.where.numpy()]], [open_[None]]
    gaps: list[np.ndarray] = [np.zeros(1)]
    for count, where, columns, possible in (
        (int(past.noted), past.where, slice(None), past.possible),
        (int(past.count), past.zeta, s.where.numpy(), past.open),
    ):
        back = np.arange(min(count, len(where), s.searched))
        at = (count - 1 - back) % max(len(where), 1)
        places.append(where[at][:, columns])
        gaps.append((back + 1) * STALE)
        opened.append(possible[at])
    found = np.argmin(_gaps(s, zeta, np.concatenate(places)) + np.concatenate(gaps), axis=1)
    return np.concatenate(opened)[found]


def _best(s: Encoding, nodes: Nodes) -> list[int]:
    """Return which nodes are kept: the best of every first movement, then the best that there is room for."""
    ranked = np.argsort(nodes.score, kind="stable").tolist()
    roots: dict[int, int] = {}
    for at in ranked:
        roots.setdefault(nodes.ways[at][0], at)
    kept = [roots[root] for root in sorted(roots)]
    known = set(kept)
    return [*kept, *(at for at in ranked if at not in known)][: max(s.beam, s.movements)]


def _take(nodes: Nodes, kept: list[int]) -> Nodes:
    return Nodes(
        nodes.state[torch.tensor(kept)],
        nodes.cost[kept],
        nodes.keep[kept],
        nodes.open[kept],
        nodes.score[kept],
        [nodes.ways[i] for i in kept],
        [nodes.states[i] for i in kept],
    )
