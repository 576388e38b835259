"""The first-order form of the HJB equation, d + dJ/dzeta . f, which only Algorithm 1 as printed needs."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ecology.agents.hjb.devices.records import LONGEST
from ecology.agents.hjb.devices.torch.encoding import drive
from ecology.agents.hjb.devices.torch.networks import deviations, forecast


def slopes(s: Any, own: Any, zeta: Tensor, *, graph: bool = False) -> Tensor:
    """Return dJn/dzeta (a, R, D) of zeta (a, R, D), with `graph` differentiable in the weights."""
    with torch.enable_grad():
        at = zeta.detach().requires_grad_()
        return torch.autograd.grad(deviations(s, own, at).sum(), at, create_graph=graph)[0]


def first_order_scores(s: Any, own: Any, zeta: Tensor, open_: Tensor) -> Tensor:
    """Return d + dJ/dzeta . f (a, R, M) of the open movements at zeta (a, R, D), infinity for the others."""
    predicted = forecast(s, own, zeta) * s.unit
    parts = zeta.shape[-1]
    rate = predicted[..., :parts] / predicted[..., parts : parts + 1].clamp(s.dt, LONGEST)
    climb = (slopes(s, own, zeta)[:, :, None] * rate).sum(-1)
    score = drive(s, zeta[:, :, None] + rate * s.dt) - climb / s.log_gamma
    return score.masked_fill(~open_, math.inf)


def executed_pace(s: Any, own: Any, zeta: Tensor, movement: Tensor) -> Tensor:
    """Return f (a, R, D), per unit of time, of the movement executed (a, R) at each zeta (a, R, D)."""
    predicted = pick(forecast(s, own, zeta), movement) * s.unit
    parts = zeta.shape[-1]
    return predicted[..., :parts] / predicted[..., parts : parts + 1].clamp(s.dt, LONGEST)


def add_climb(s: Any, own: Any, zeta: Tensor, pace: Tensor, residual: Tensor) -> Tensor:
    """Return residual (a, R) + dJn/dzeta . f / ln(gamma) at zeta (a, R, D) with f = pace (a, R, D)."""
    return residual + (slopes(s, own, zeta, graph=True) * pace).sum(-1) / s.log_gamma[..., 0]


def pick(table: Tensor, movement: Tensor) -> Tensor:
    """Return of a table (a, R, M, k) the rows (a, R, k) of the movements executed (a, R)."""
    which = movement.clamp(min=0).long()[..., None, None].expand(-1, -1, 1, table.shape[-1])
    return table.gather(2, which)[:, :, 0]
