"""Encode a state: its drive and the inputs of the networks."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ecology.agents.hjb.devices.records import SILENT


def drive(s: Any, zeta: Tensor) -> Tensor:
    """Return d at zeta (..., D)."""
    own = zeta @ s.mix
    if s.bent:  # the floor keeps the slope finite at the set point
        own = (own * torch.where(own > 0, s.above, 1.0)).abs().clamp(min=1e-12) ** (s.power / 2)
    return (own.square().sum(-1) + s.epsilon) ** s.root + zeta @ s.felt


def features(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return the network inputs (b, I) of zeta (b, D): plain, cosine and sine, place cells."""
    angle = zeta[:, s.angle]
    parts = [(zeta - s.centre)[:, s.plain] / s.scale[s.plain], angle.cos(), angle.sin()]
    if own.centres.shape[1]:
        gap = (zeta[:, None, s.place] - torch.from_numpy(own.centres.T)).square().sum(-1)
        used = torch.arange(own.centres.shape[1]) < int(own.cells)
        parts.append(torch.where(used, (-0.5 * gap * s.sharp).clamp(min=SILENT).exp(), 0.0))
    return torch.cat(parts, 1)
