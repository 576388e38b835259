"""Score the open movements by the HJB equation over one whole movement, with optimism about unknown places."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ecology.agents.hjb.devices.plain.encoding import drive
from ecology.agents.hjb.devices.plain.first_order import first_order_scores
from ecology.agents.hjb.devices.plain.networks import deviations, forecast
from ecology.agents.hjb.devices.records import LONGEST


def is_unknown(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return which of zeta (b, D) lie beyond the reach of all marks."""
    x, y, reach = torch.from_numpy(own.marks[:, : own.marked])
    here = zeta[:, s.place]
    return ~((here[:, :1] - x).square() + (here[:, 1:] - y).square() <= reach).any(-1)


def add_optimism(s: Any, own: Any, zeta: Tensor, value: Tensor) -> Tensor:
    """Return Jn (b,) at zeta (b, D), given as `value`: lower at unknown places, as long as marks are left to set."""
    if own.optimism is None or not 0 < own.marked < own.marks.shape[1]:
        return value
    share, more = (float(number) for number in own.optimism)
    return torch.where(is_unknown(s, own, zeta), (1 - share) * value - more, value)


def drive_on_the_way(s: Any, before: Tensor, after: Tensor, keep: Any, excess: Tensor) -> Tensor:
    """Return the discounted drive of movements from `before` to `after` (..., D), of which `keep` (...) is gamma^tau.

    It is the one at the start and the `excess` (...) that f predicts, or else the mean of both ends.
    """
    here = drive(s, before)
    return (1 - keep) * here + excess if s.costed else (1 - keep) * 0.5 * (here + drive(s, after))


def scores(s: Any, own: Any, zeta: Tensor, open_: Tensor) -> Tensor:
    """Return the HJB score (b, M) of the open movements at zeta (b, D), drive units; infinity for the others.

    Over a whole movement, (1 - gamma^tau) (d + d') / 2 + gamma^tau Jn(zeta'). Where f predicts the drive on the way,
    it replaces the mean of both ends.
    """
    if not s.finite:
        return first_order_scores(s, own, zeta, open_)
    predicted = forecast(s, own, zeta) * s.unit
    parts = zeta.shape[1]
    after = torch.minimum(torch.maximum(zeta[:, None] + predicted[..., :parts], s.low), s.high)
    keep = math.exp(s.log_gamma) ** predicted[..., parts].clamp(s.dt, LONGEST)
    flat = after.flatten(0, 1)
    ahead = add_optimism(s, own, flat, deviations(s, own, flat)).view(keep.shape)
    cost = drive_on_the_way(s, zeta[:, None], after, keep, predicted[..., -1])
    return (cost + keep * ahead).masked_fill(~open_, math.inf).detach()


def expected_score(s: Any, score: Tensor) -> Tensor:
    """Return the mean score (b,) of an agent that explores with the share `explored`, else takes the least."""
    share = torch.where(torch.isfinite(score), 1 / s.length, 0.0)
    mean = (share * score.nan_to_num(posinf=0.0)).sum(1) / share.sum(1)
    return (1 - s.explored) * score.amin(1) + s.explored * mean
