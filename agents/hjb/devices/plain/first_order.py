"""The first-order form of the HJB equation, d + dJ/dzeta . f, which only Algorithm 1 as printed needs."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ecology.agents.hjb.devices.plain.encoding import drive
from ecology.agents.hjb.devices.plain.networks import deviations, forecast
from ecology.agents.hjb.devices.records import LONGEST


def slopes(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return dJn/dzeta (b, D) of zeta (b, D), differentiable in the weights."""
    at = zeta.detach().requires_grad_()
    return torch.autograd.grad(deviations(s, own, at).sum(), at, create_graph=True)[0]


def first_order_scores(s: Any, own: Any, zeta: Tensor, open_: Tensor) -> Tensor:
    """Return d + dJ/dzeta . f (b, M) of the open movements at zeta (b, D), infinity for the others."""
    predicted = forecast(s, own, zeta) * s.unit
    parts = zeta.shape[1]
    rate = predicted[..., :parts] / predicted[..., parts : parts + 1].clamp(s.dt, LONGEST)
    climb = (slopes(s, own, zeta)[:, None] * rate).sum(-1)
    return (drive(s, zeta[:, None] + rate * s.dt) - climb / s.log_gamma).masked_fill(~open_, math.inf).detach()


def executed_pace(s: Any, own: Any, zeta: Tensor, movement: Tensor) -> Tensor:
    """Return f (b, D), per unit of time, of the movement executed (b,) at each zeta (b, D)."""
    predicted = pick(forecast(s, own, zeta), movement) * s.unit
    parts = zeta.shape[1]
    return predicted[:, :parts] / predicted[:, parts : parts + 1].clamp(s.dt, LONGEST)


def add_climb(s: Any, own: Any, zeta: Tensor, pace: Tensor, residual: Tensor) -> Tensor:
    """Return residual (b,) + dJn/dzeta . f / ln(gamma) at zeta (b, D) with f = pace (b, D)."""
    return residual + (slopes(s, own, zeta) * pace).sum(1) / s.log_gamma


def pick(table: Tensor, movement: Tensor) -> Tensor:
    """Return of a table (b, M, k) the rows (b, k) of the movements executed (b,)."""
    return table[torch.arange(len(table)), movement.clamp(min=0)]
