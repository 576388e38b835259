"""Evaluate the networks of all agents: f for the transitions, J for the deviations."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ecology.agents.hjb.devices.torch.encoding import drive, features


def layers(s: Any, rows: Tensor, inputs: int) -> list[Tensor]:
    """Return w1, b1, w2, b2, w3, b3 as views of weights (a, P)."""
    a, width = len(rows), s.width
    outputs = (rows.shape[1] - (inputs + width + 2) * width) // (width + 1)
    sizes = [inputs * width, width, width * width, width, outputs * width, outputs]
    shapes = [(a, inputs, width), (a, 1, width), (a, width, width), (a, 1, width), (a, outputs, width), (a, 1, -1)]
    return [part.view(shape) for part, shape in zip(rows.split(sizes, 1), shapes, strict=True)]


def inputs_of(s: Any, own: Any) -> int:
    """Return how many inputs the networks have: components, and room for place cells."""
    return len(s.plain) + 2 * len(s.angle) + own.centres.shape[-1]


def hidden_layer(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return the second hidden layer (a, R, H) of f at zeta (a, R, D)."""
    w1, b1, w2, b2, _, _ = own.f
    first = functional.relu(torch.baddbmm(b1, features(s, own, zeta), w1))
    return functional.relu(torch.baddbmm(b2, first, w2))


def forecast(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return f of all movements (a, R, M, E) at zeta (a, R, D), in its units."""
    _, _, _, _, w3, b3 = own.f
    raw = torch.baddbmm(b3, hidden_layer(s, own, zeta), w3.transpose(1, 2))
    return raw.unflatten(2, (s.movements, -1))


def deviations(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return Jn (a, R) of zeta (a, R, D), drive units."""
    w1, b1, w2, b2, w3, b3 = own.J
    first = functional.silu(torch.baddbmm(b1, features(s, own, zeta), w1))
    second = functional.silu(torch.baddbmm(b2, first, w2))
    raw = torch.baddbmm(b3, second, w3.transpose(1, 2))[..., 0]
    return (drive(s, zeta) if s.anchored else s.centre_j) + s.spread_j * raw
