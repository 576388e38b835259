"""Encode a state: its drive and the inputs of the networks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ecology.agents.hjb.devices.records import SILENT, Encoding


def on_device(encoding: Encoding, device: torch.device) -> Any:
    """Return `encoding` as tensors and numbers, with the drive's mix (D, D) and the needs that can be deprived (D,)."""
    s = SimpleNamespace(device=device)
    for name, value in encoding._asdict().items():
        if isinstance(value, np.ndarray):
            kind = torch.float32 if value.dtype == np.float64 else None  # mps has no float64
            value = torch.tensor(value, dtype=kind, device=device)
        setattr(s, name, value.item() if isinstance(value, np.generic) else value)
    size = len(encoding.low)
    s.can = torch.zeros(size, dtype=torch.bool, device=device)
    s.can[s.deprivable] = True
    s.mix = torch.zeros(size, size, device=device)
    s.mix[s.mix_from, s.mix_to] = s.mix_weight
    return s


def drive(s: Any, zeta: Tensor) -> Tensor:
    """Return d at zeta (..., D)."""
    own = zeta @ s.mix
    if s.bent:  # the floor keeps the slope finite at the set point
        own = (own * torch.where(own > 0, s.above, 1.0)).abs().clamp(min=1e-12) ** (s.power / 2)
    total = own.square().sum(-1) + s.epsilon
    return (total.sqrt() if s.root == 0.5 else total**s.root) + zeta @ s.felt


def features(s: Any, own: Any, zeta: Tensor) -> Tensor:
    """Return the network inputs (a, R, I) of zeta (a, R, D): plain, cosine and sine, place cells."""
    angle = zeta[..., s.angle]
    parts = [((zeta - s.centre) * s.inverse)[..., s.plain], angle.cos(), angle.sin()]
    count = own.centres.shape[-1]
    if count:
        gap = zeta[..., s.place, None] - own.centres[:, None]  # (a, R, 2, C)
        bump = torch.exp((-0.5 * s.sharp * gap.square().sum(2)).clamp(min=SILENT))
        used = torch.arange(count, device=s.device) < own.cells[:, None]
        parts.append(torch.where(used[:, None], bump, 0.0))
    return torch.cat(parts, -1)
