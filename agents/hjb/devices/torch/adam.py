"""Take a step of Adam (Kingma and Ba 2015) on the weights of all agents."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from ecology.agents.hjb.devices.records import BETA1, BETA2, TINY


class Row(NamedTuple):
    """One network of a agents, with Adam's moments."""

    w: Tensor  # (a, P)
    first: Tensor
    second: Tensor
    steps: Tensor  # int (a, 1 + heads)


def step(row: Row, leaves: list[Tensor], rate: Tensor, decay: float, learns: Tensor, trained: Tensor) -> None:
    """Take one step for the agents that learn (a, 1), after `learn_f` or `learn_j`; `leaves` hold the gradients.

    Of the last layer only the heads `trained` (a, M) move; all have as many outputs, and their weights decay. The step
    counts of the hidden layers and of every head that moves are brought up to date.
    """
    gradient = torch.cat([leaf.grad.flatten(1) for leaf in leaves if leaf.grad is not None], 1)
    moves = torch.cat([learns, learns & trained], 1)
    row.steps.add_(moves)
    taken = row.steps.clamp(min=1).float()
    correction = (-torch.expm1(taken * math.log(BETA2))).sqrt()
    size = rate * moves * correction / -torch.expm1(taken * math.log(BETA1))
    w3, b3 = (leaf[0].numel() for leaf in leaves[4:])
    hidden = gradient.shape[1] - w3 - b3
    for columns, start, length, decays in (
        (slice(0, 1), 0, hidden, 0.0),
        (slice(1, None), hidden, w3, decay),
        (slice(1, None), -b3, b3, 0.0),
    ):
        on, pace, floor = (part[:, columns, None] for part in (moves.float(), size, TINY * correction))
        own, g, m, v = (  # (a, 1 or M, weights)
            array.narrow(1, start, length).unflatten(1, (on.shape[1], -1))
            for array in (row.w, gradient, row.first, row.second)
        )
        if decays:
            own.mul_(1 - (rate * decays)[..., None] * on)
        m.lerp_(g, (1 - BETA1) * on)
        v.lerp_(g.square_(), (1 - BETA2) * on)
        own.sub_(m / (v.sqrt() + floor) * pace)
