"""Learn from remembered decisions: draw them, and compute the losses of f and J; torch derives the gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ecology.agents.hjb.devices.plain.encoding import drive
from ecology.agents.hjb.devices.plain.first_order import add_climb, pick
from ecology.agents.hjb.devices.plain.networks import deviations, forecast
from ecology.agents.hjb.devices.records import LONGEST

Sample = tuple[Tensor, ...]


def positions(count: int, capacity: int, uniform: np.ndarray, late: int, recent: int) -> np.ndarray:
    """Return positions in the ring (b,): the last `late` of them among the `recent` decisions."""
    found = []
    for r, u in enumerate(uniform):
        window = min(count, capacity)
        if r >= len(uniform) - late:
            window = min(window, recent)
        found.append((count - 1 - min(int(u * np.float32(window)), window - 1)) % capacity)
    return np.array(found)


def lack(s: Any, v: int, share: float) -> Any:
    """Return a deviation of need v that is a `share` of the way from deprived to a little beyond sated."""
    bottom = max(s.deprived * s.scale[v], s.low[v])
    return bottom + share * (s.sated * s.scale[v] - bottom)


def imagine(s: Any, zeta: Tensor, uniform: np.ndarray, normal: np.ndarray, m: int) -> Tensor:
    """Return zeta (b, D) with the needs of its first m states redrawn, place and rest kept; fatigues scaled down.

    Half of them have one need deprived and the others near sated, half have all needs uniform
    between deprived and a little beyond sated.
    """
    zeta, parts = zeta.clone(), zeta.shape[1]
    fresh = uniform[: m * parts].reshape(m, parts)
    calm, which = uniform[m * parts :][:m], uniform[m * parts + m :]
    can = s.deprivable.tolist()
    for r in range(m):
        one = can[min(int(which[r] * np.float32(len(can))), len(can) - 1)] if r < m // 2 and can else -1
        for v in torch.nonzero(s.need)[:, 0].tolist():
            drawn = lack(s, v, float(fresh[r, v]))
            if v not in can:
                drawn = zeta[r, v] * float(calm[r])
            elif r < m // 2 and v != one:
                drawn = 0.1 * s.scale[v] * float(normal[r, v])
            zeta[r, v] = min(max(drawn, s.low[v]), s.high[v])
    return zeta


def redraw(s: Any, zeta: Tensor, uniform: np.ndarray, m: int) -> Tensor:
    """Return zeta (b, D) with the deprivable needs of its first m states redrawn, as in half of `imagine`."""
    zeta, can = zeta.clone(), s.deprivable.tolist()
    for r, drawn in enumerate(uniform.reshape(m, len(can))):
        for v, share in zip(can, drawn.tolist(), strict=True):
            zeta[r, v] = min(lack(s, v, share), s.high[v])
    return zeta


def learn_f(s: Any, own: Any, sample: Sample, m: int) -> Tensor:
    """Return L_f: the squared error of the executed movement's predicted change.

    `sample` are zeta (b, D), the movement (b,), zeta after it, its duration and its excess (b,). The first m rows,
    whose needs are imagined, count for the spatial components alone.
    """
    zeta, movement, after, duration, excess = sample
    change = after - zeta
    change[:, s.angle] = torch.atan2(change[:, s.angle].sin(), change[:, s.angle].cos())
    target = torch.cat([change, duration[:, None].clamp(max=LONGEST), excess[:, None]], 1)[:, : s.outputs] / s.unit
    error = (pick(forecast(s, own, zeta), movement) - target).square()
    kept = s.spatial | (torch.arange(len(error)) >= m)[:, None]
    return mean((error * kept).mean(1), movement >= 0)


def learn_j(s: Any, own: Any, sample: Sample) -> Tensor:
    """Return L_J: the squared residual of the HJB equation, in drive units.

    `sample` are zeta (b, D), the movement (b,), J's target (b,), which is the right-hand side of the equation, and the
    pace (b, D). Where the score is first order and there is no min (Algorithm 1 as printed), the target lacks
    dJ/dzeta . f, which is added here along the pace and differentiated too.
    """
    zeta, movement, target, pace = sample
    residual = deviations(s, own, zeta) - target
    if not (s.minimum or s.finite):
        residual = add_climb(s, own, zeta, pace, residual)
    weight = (s.weight_top / (s.weight_floor + drive(s, zeta))) ** s.weight_power
    return mean(weight * residual.square(), torch.ones_like(movement, dtype=torch.bool) if s.minimum else movement >= 0)


def mean(errors: Tensor, known: Tensor) -> Tensor:
    """Return the mean of the errors (b,) that are known."""
    return (errors * known).sum() / known.sum().clamp(min=1)
