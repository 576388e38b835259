"""Learn from remembered decisions: draw them, and compute the losses of f and J; torch derives the gradients."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ecology.agents.hjb.devices.records import LONGEST
from ecology.agents.hjb.devices.torch.encoding import drive
from ecology.agents.hjb.devices.torch.first_order import add_climb, pick
from ecology.agents.hjb.devices.torch.networks import deviations, forecast

Sample = tuple[Tensor, ...]


def positions(count: Tensor, capacity: int, uniform: Tensor, late: int, recent: int) -> Tensor:
    """Return positions in the ring (a, b): the last `late` of them among the `recent` decisions."""
    window = count[:, None].clamp(max=capacity).repeat(1, uniform.shape[1])
    window[:, uniform.shape[1] - late :].clamp_(max=recent)
    back = torch.minimum((uniform * window).long(), window - 1).clamp(min=0)  # 0: the newest
    return (count[:, None] - 1 - back) % capacity


def lack(s: Any, which: Tensor | slice, share: Tensor) -> Tensor:
    """Return deviations (a, m, K) of the needs `which`, a `share` of the way from deprived to a little beyond sated."""
    bottom = (s.deprived * s.scale[which]).maximum(s.low[which])
    return bottom + share * (s.sated * s.scale[which] - bottom)


def imagine(s: Any, zeta: Tensor, uniform: Tensor, normal: Tensor, m: int) -> Tensor:
    """Return zeta (a, b, D) with the needs of its first m states redrawn, place and rest kept; fatigues scaled down.

    Half of them have one need deprived and the others near sated, half have all needs uniform
    between deprived and a little beyond sated.
    """
    if not m:
        return zeta
    parts, half = zeta.shape[-1], m // 2
    fresh = uniform[:, : m * parts].unflatten(1, (m, parts))
    calm = uniform[:, m * parts : m * parts + m, None]
    drawn = lack(s, slice(None), fresh)
    if half and len(s.deprivable):
        which = (uniform[:, m * parts + m : m * parts + m + half] * len(s.deprivable)).long()
        one = s.deprivable[which.clamp(max=len(s.deprivable) - 1)]  # (a, half)
        alone = torch.arange(parts, device=s.device) == one[..., None]
        drawn[:, :half] = torch.where(alone, drawn[:, :half], 0.1 * s.scale * normal)
    drawn = torch.where(s.can, drawn, zeta[:, :m] * calm).clamp(s.low, s.high)
    return torch.cat([torch.where(s.need, drawn, zeta[:, :m]), zeta[:, m:]], 1)


def redraw(s: Any, zeta: Tensor, uniform: Tensor, m: int) -> Tensor:
    """Return zeta (a, b, D) with the deprivable needs of its first m states redrawn, as in half of `imagine`."""
    if not (m and len(s.deprivable)):
        return zeta
    zeta, can = zeta.clone(), s.deprivable
    zeta[:, :m, can] = torch.minimum(lack(s, can, uniform.unflatten(1, (m, len(can)))), s.high[can])
    return zeta


def learn_f(s: Any, own: Any, sample: Sample, m: int) -> Tensor:
    """Return L_f (a,): the squared error of the executed movement's predicted change.

    `sample` are zeta (a, b, D), the movement (a, b), zeta after it, its duration and its excess (a, b). The first m
    rows, whose needs are imagined, count for the spatial components alone.
    """
    zeta, movement, after, duration, excess = sample
    change = after - zeta
    turned = change[..., s.angle]
    change[..., s.angle] = torch.atan2(turned.sin(), turned.cos())
    met = change, duration[..., None].clamp(max=LONGEST), excess[..., None]
    target = torch.cat(met, -1)[..., : s.outputs]
    error = (pick(forecast(s, own, zeta), movement) - target / s.unit).square()
    kept = s.spatial | (torch.arange(error.shape[1], device=s.device) >= m)[:, None]
    return mean((error * kept).mean(-1), movement >= 0)


def learn_j(s: Any, own: Any, sample: Sample) -> Tensor:
    """Return L_J (a,): the squared residual of the HJB equation, in drive units.

    `sample` are zeta (a, b, D), the movement (a, b), J's target (a, b), which is the right-hand side of the
    equation, and the pace (a, b, D). Where the score is first order and there is no min (Algorithm 1 as printed), the
    target lacks dJ/dzeta . f, which is added here along the pace and differentiated too.
    """
    zeta, movement, target, pace = sample
    residual = deviations(s, own, zeta) - target
    if not (s.minimum or s.finite):
        residual = add_climb(s, own, zeta, pace, residual)
    weight = (s.weight_top / (s.weight_floor + drive(s, zeta))) ** s.weight_power
    return mean(weight * residual.square(), torch.ones_like(movement, dtype=torch.bool) if s.minimum else movement >= 0)


def mean(errors: Tensor, known: Tensor) -> Tensor:
    """Return the mean (a,) of the errors (a, R) that are known."""
    return (errors * known).sum(1) / known.sum(1).clamp(min=1)
