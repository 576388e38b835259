"""Look several movements ahead: a beam search in which f is corrected by its latest errors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ecology.agents.hjb.devices.plain.networks import deviations, forecast
from ecology.agents.hjb.devices.plain.scores import add_optimism, drive_on_the_way
from ecology.agents.hjb.devices.records import FADING, FAINT, LONGEST, PRIOR, STALE, RecalledErrors


class Node(NamedTuple):
    """A state to look ahead from, or a successor."""

    state: Tensor  # (D,)
    cost: float  # discounted drive on the way here
    keep: float  # discount here
    root: int  # first movement on the way here
    open: np.ndarray  # bool (M,)
    score: float = 0.0


def distance(s: Any, zeta: Tensor, where: np.ndarray) -> float:
    """Return the squared distance between zeta (D,) and a place `where` (W,), in standard deviations."""
    total = 0.0
    for at, place, nearness, turns in zip(s.where, where, s.nearness, s.turning, strict=True):
        gap = float(zeta[at]) - float(place)
        total += ((math.remainder(gap, 2 * math.pi) if turns else gap) * float(nearness)) ** 2
    return total


def recall(s: Any, past: RecalledErrors, zeta: Tensor) -> Tensor:
    """Return the error of f (M, E) to be expected at zeta (D,) by movement, from those remembered.

    A mean weighted by how near and how recent they are, with a prior of no error: Nadaraya-Watson regression.
    """
    total, weight = torch.zeros(s.movements, s.outputs), torch.full((s.movements, 1), PRIOR)
    for k in range(min(int(past.noted), len(past.movement))):
        exponent = -0.5 * distance(s, zeta, past.where[k]) - float(past.now - past.time[k]) / FADING
        if exponent > FAINT:
            weight[past.movement[k]] += math.exp(exponent)
            total[past.movement[k]] += math.exp(exponent) * torch.from_numpy(past.error[k])
    return total / weight


def recall_open(s: Any, past: RecalledErrors, zeta: Tensor, here: Tensor, open_: np.ndarray) -> np.ndarray:
    """Return what was open (M,) at the decision nearest to zeta (D,); newer ones count as nearer.

    The newest is the one that is being made, at `here` (D,) with `open_` (M,). The others are those whose errors are
    remembered, and those of the replay buffer.
    """
    found = [(distance(s, zeta, here[s.where].numpy()), open_)]
    for count, places, opened in (
        (int(past.noted), past.where, past.possible),
        (int(past.count), past.zeta[:, s.where.numpy()], past.open),
    ):
        for back in range(min(count, len(places), s.searched)):
            at = (count - 1 - back) % len(places)
            found.append((distance(s, zeta, places[at]) + (back + 1) * STALE, opened[at]))
    return min(found, key=lambda each: each[0])[1]


def look_ahead(s: Any, own: Any, past: RecalledErrors, zeta: Tensor, open_: np.ndarray) -> np.ndarray:
    """Return the score (M,) of the open movements at zeta (D,), the least over what may follow; else infinity.

    A beam search over `depth` movements: the discounted drive on the way and J at its end. The best successor of every
    first movement is kept, so all have the same depth. What is open at a predicted state is what was open at the
    nearest decision, this one included.
    """
    nodes = [Node(zeta, 0.0, 1.0, -1, open_)]
    for _ in range(s.depth - 1):
        kept = keep_best(s, expand(s, own, past, nodes))
        nodes = [node._replace(open=recall_open(s, past, node.state, zeta, open_)) for node in kept]
    out = np.full(s.movements, np.inf, np.float32)
    for node in expand(s, own, past, nodes):
        out[node.root] = min(out[node.root], node.score)
    return out


def expand(s: Any, own: Any, past: RecalledErrors, nodes: list[Node]) -> list[Node]:
    """Predict the successors of `nodes` and score them."""
    found = []
    for node in nodes:
        predicted = forecast(s, own, node.state[None])[0] * s.unit + recall(s, past, node.state)
        for m in np.flatnonzero(node.open).tolist():
            after = torch.minimum(torch.maximum(node.state + predicted[m, : len(s.low)], s.low), s.high)
            fade = math.exp(s.log_gamma * float(predicted[m, len(s.low)].clamp(s.dt, LONGEST)))
            way = drive_on_the_way(s, node.state, after, fade, predicted[m, -1])
            cost, keep = node.cost + node.keep * float(way), node.keep * fade
            value = float(add_optimism(s, own, after[None], deviations(s, own, after[None])))
            found.append(Node(after, cost, keep, m if node.root < 0 else node.root, node.open, cost + keep * value))
    return found


def keep_best(s: Any, found: list[Node]) -> list[Node]:
    """Return the best successor of every first movement, and of the others the best that there is room for."""
    ranked = sorted(found, key=lambda node: node.score)
    best = [next(node for node in ranked if node.root == root) for root in sorted({node.root for node in found})]
    rest = [node for node in ranked if not any(node is each for each in best)]
    return [*best, *rest][: max(s.beam, s.movements)]
