"""Look several movements ahead: a beam search in which f is corrected by its latest errors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from ecology.agents.hjb.devices.records import FADING, FAINT, LONGEST, PRIOR, STALE, RecalledErrors
from ecology.agents.hjb.devices.torch.networks import deviations, forecast
from ecology.agents.hjb.devices.torch.scores import add_optimism, drive_on_the_way

TURN = 2 * math.pi


class Beam(NamedTuple):
    """States to look ahead from, R for each of a agents, or their R M successors."""

    state: Tensor  # (a, R, D)
    cost: Tensor  # (a, R) discounted drive on the way here
    keep: Tensor  # (a, R) discount here
    root: Tensor  # int (a, R) first movement on the way here
    open: Tensor  # bool (a, R, M); of successors (a, R M), which exist


def distance(s: Any, zeta: Tensor, where: Tensor) -> Tensor:
    """Return squared distances (a, R, K) of zeta (a, R, D) from places (a, K, W), in standard deviations."""
    gap = zeta[..., s.where][:, :, None] - where[:, None]
    gap = torch.where(s.turning, gap - TURN * torch.floor(gap / TURN + 0.5), gap)
    return (gap * s.nearness).square().sum(-1)


def recall(s: Any, past: RecalledErrors, zeta: Tensor) -> Tensor:
    """Return the error of f to be expected (a, R, M, E) at zeta (a, R, D), from those remembered.

    A mean weighted by how near and how recent they are, with a prior of no error: Nadaraya-Watson regression.
    """
    faded = (past.now[:, None] - past.time) / FADING
    exponent = -0.5 * distance(s, zeta, past.where) - faded[:, None]
    used = torch.arange(past.where.shape[1], device=s.device) < past.noted[:, None]
    weight = torch.where((exponent > FAINT) & used[:, None], exponent.exp(), 0.0)  # (a, R, L)
    did = functional.one_hot(past.movement.long(), s.movements).float()  # (a, L, M)
    total = torch.einsum("arl,alm,ald->armd", weight, did, past.error)
    return total / (PRIOR + weight @ did)[..., None]


def recall_open(s: Any, past: RecalledErrors, zeta: Tensor, here: Tensor, open_: Tensor) -> Tensor:
    """Return what was open (a, R, M) at the decision nearest to zeta (a, R, D); newer ones count as nearer.

    The newest is the one that is being made, at `here` (a, D) with `open_` (a, M). The others are those whose errors
    are remembered, and those of the replay buffer.
    """
    places, gaps, opened = here[:, None, s.where], [torch.zeros(len(here), 1, device=s.device)], [open_[:, None]]
    for count, where, possible in (
        (past.noted, past.where, past.possible),
        (past.count, past.zeta[..., s.where], past.open),
    ):
        back = torch.arange(min(s.searched, where.shape[1]), device=s.device)
        at = (count[:, None] - 1 - back) % max(where.shape[1], 1)  # (a, K)
        places = torch.cat([places, rows_at(where, at)], 1)
        gaps.append(((back + 1) * STALE).masked_fill(back >= count[:, None], math.inf))
        opened.append(rows_at(possible, at))
    found = (distance(s, zeta, places) + torch.cat(gaps, 1)[:, None]).argmin(-1)
    return rows_at(torch.cat(opened, 1), found)


def look_ahead(s: Any, own: Any, past: RecalledErrors, zeta: Tensor, open_: Tensor) -> Tensor:
    """Return the score (a, M) of the open movements at zeta (a, D), the least over what may follow; else infinity.

    A beam search over `depth` movements: the discounted drive on the way and J at its end. The best successor of every
    first movement is kept, so all have the same depth. What is open at a predicted state is what was open at the
    nearest decision, this one included.
    """
    cost = torch.zeros(len(zeta), 1, device=s.device)
    beam = Beam(zeta[:, None], cost, torch.ones_like(cost), torch.zeros_like(cost).long(), open_[:, None])
    for level in range(s.depth):
        ahead = expand(s, own, past, level, beam)
        value = add_optimism(s, own, ahead.state, deviations(s, own, ahead.state))
        score = (ahead.cost + ahead.keep * value).masked_fill(~ahead.open, math.inf)  # (a, R M)
        out, best = by_root(s, ahead.root, score)
        if level == s.depth - 1:
            break
        chosen, exists = keep_best(s, score, out, best)
        state = ahead.state.gather(1, chosen[..., None].expand(-1, -1, zeta.shape[1]))
        cost, keep, root = (array.gather(1, chosen) for array in (ahead.cost, ahead.keep, ahead.root))
        possible = recall_open(s, past, state, zeta, open_)
        beam = Beam(state, cost, keep, root, possible & exists[..., None])
    return out


def expand(s: Any, own: Any, past: RecalledErrors, level: int, beam: Beam) -> Beam:
    """Predict the successors of all states of the beam, by every movement."""
    raw = forecast(s, own, beam.state) * s.unit + recall(s, past, beam.state)
    parts = beam.state.shape[-1]
    ahead = (beam.state[:, :, None] + raw[..., :parts]).clamp(s.low, s.high)
    faded = torch.exp(raw[..., parts].clamp(s.dt, LONGEST) * s.log_gamma)  # (a, R, M)
    way = drive_on_the_way(s, beam.state[:, :, None], ahead, faded, raw[..., -1])
    cost = beam.cost[..., None] + beam.keep[..., None] * way
    first = torch.arange(s.movements, device=s.device).expand_as(faded) if level == 0 else beam.root[..., None]
    return Beam(
        ahead.flatten(1, 2),
        cost.flatten(1),
        (beam.keep[..., None] * faded).flatten(1),
        first.expand_as(faded).flatten(1),
        beam.open.flatten(1),
    )


def keep_best(s: Any, score: Tensor, out: Tensor, best: Tensor) -> tuple[Tensor, Tensor]:
    """Return which successors to look ahead from (a, B), and which of them exist, by their score (a, R M).

    The `best` (a, M) of every first movement, which have the scores `out`, and of the others the best that there is
    room for.
    """
    kept = score.scatter(1, best, score.gather(1, best).where(out == math.inf, -math.inf))
    rank, chosen = kept.topk(min(max(s.beam, s.movements), kept.shape[1]), largest=False)
    return chosen, rank < math.inf


def by_root(s: Any, root: Tensor, score: Tensor) -> tuple[Tensor, Tensor]:
    """Return the least score (a, M) among the successors (a, R M) of every first movement, and which has it."""
    of_root = torch.full((*score.shape, s.movements), math.inf, device=s.device)
    of_root.scatter_(2, root[..., None], score[..., None])
    return of_root.min(1)


def rows_at(array: Tensor, at: Tensor) -> Tensor:
    """Return the rows (a, b, ...) at positions (a, b) of an array (a, capacity, ...)."""
    return array[torch.arange(len(at), device=at.device)[:, None], at]
