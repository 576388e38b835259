"""Evaluate the networks of one agent: f for the transitions, J for the deviations."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ecology.agents.hjb.devices.plain.encoding import drive, features


def layers(s: Any, row: np.ndarray, inputs: int) -> list[Tensor]:
    """Return w1, b1, w2, b2, w3, b3 as tensors that share the memory of a row of weights (P,)."""
    parts, at, width = [], 0, s.width
    outputs = (len(row) - (inputs + width + 2) * width) // (width + 1)
    for shape in ((inputs, width), (width,), (width, width), (width,), (outputs, width), (outputs,)):
        size = int(np.prod(shape))
        parts.append(torch.from_numpy(row[at : at + size]).view(shape))
        at += size
    return parts


def inputs_of(s: Any, own: Any) -> int:
    """Return how many inputs the networks have: components, and room for place cells."""
    return len(s.plain) + 2 * len(s.angle) + own.centres.shape[-1]


def hidden_layer(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return the second hidden layer (b, H) of f at zeta (b, D)."""
    w1, b1, w2, b2, _, _ = own.f
    return functional.relu(functional.relu(features(s, own, zeta) @ w1 + b1) @ w2 + b2)


def forecast(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return f of all movements (b, M, E) at zeta (b, D), in its units."""
    _, _, _, _, w3, b3 = own.f
    return functional.linear(hidden_layer(s, own, zeta), w3, b3).unflatten(1, (s.movements, -1))


def deviations(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return Jn (b,) of zeta (b, D), drive units."""
    w1, b1, w2, b2, w3, b3 = own.J
    second = functional.silu(functional.silu(features(s, own, zeta) @ w1 + b1) @ w2 + b2)
    return (drive(s, zeta) if s.anchored else s.centre_j) + s.spread_j * functional.linear(second, w3, b3)[:, 0]
