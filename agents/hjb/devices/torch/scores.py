"""Score the open movements by the HJB equation over one whole movement, with optimism about unknown places."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ecology.agents.hjb.devices.records import LONGEST
from ecology.agents.hjb.devices.torch.encoding import drive
from ecology.agents.hjb.devices.torch.first_order import first_order_scores
from ecology.agents.hjb.devices.torch.networks import deviations, forecast


def is_unknown(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return which of zeta (a, R, D) lie beyond the reach of all marks."""
    gap = zeta[..., s.place, None] - own.marks[:, None, :2]  # (a, R, 2, K)
    used = torch.arange(own.marks.shape[-1], device=s.device) < own.marked[:, None]
    return ~((gap.square().sum(2) <= own.marks[:, None, 2]) & used[:, None]).any(-1)


def add_optimism(s: Any, own: Any, zeta: Tensor, value: Tensor) -> Tensor:
    """Return Jn (a, R) at zeta (a, R, D), given as `value`: lower at unknown places while marks are left to set."""
    capacity = own.marks.shape[-1]
    if own.optimism is None or not capacity:
        return value
    lower = is_unknown(s, own, zeta) & ((own.marked > 0) & (own.marked < capacity))[:, None]
    return torch.where(lower, value - own.optimism[:, :1] * value - own.optimism[:, 1:], value)


def drive_on_the_way(s: Any, before: Tensor, after: Tensor, keep: Any, excess: Tensor) -> Tensor:
    """Return the discounted drive of movements from `before` to `after` (..., D), of which `keep` (...) is gamma^tau.

    It is the one at the start and the `excess` (...) that f predicts, or else the mean of both ends.
    """
    here = drive(s, before)
    return (1 - keep) * here + excess if s.costed else (1 - keep) * 0.5 * (here + drive(s, after))


def scores(s: Any, own: Any, zeta: Tensor, open_: Tensor) -> Tensor:
    """Return the HJB score (a, R, M) of the open movements at zeta (a, R, D), drive units; infinity for the others.

    Over a whole movement, (1 - gamma^tau) (d + d') / 2 + gamma^tau Jn(zeta'). Where f predicts the drive on the way,
    it replaces the mean of both ends.
    """
    if not s.finite:
        return first_order_scores(s, own, zeta, open_)
    predicted = forecast(s, own, zeta) * s.unit
    parts = zeta.shape[-1]
    ahead = (zeta[:, :, None] + predicted[..., :parts]).clamp(s.low, s.high)
    keep = torch.exp(predicted[..., parts].clamp(s.dt, LONGEST) * s.log_gamma)
    cost = drive_on_the_way(s, zeta[:, :, None], ahead, keep, predicted[..., -1])
    flat = ahead.flatten(1, 2)
    value = add_optimism(s, own, flat, deviations(s, own, flat))
    return (cost + keep * value.view_as(keep)).masked_fill(~open_, math.inf)


def expected_score(s: Any, score: Tensor) -> Tensor:
    """Return the mean score (a, R) of agents that explore with the share `explored`, else take the least."""
    least = score.amin(-1)
    share = torch.where(score < math.inf, 1 / s.length, 0.0)
    mean = (share * score.nan_to_num(posinf=0.0)).sum(-1) / share.sum(-1).clamp(min=1e-30)
    return torch.where(share.sum(-1) > 0, least + s.explored * (mean - least), least)
