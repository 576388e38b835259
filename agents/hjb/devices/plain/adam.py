"""Take a step of Adam (Kingma and Ba 2015) on the weights of one agent, by torch's own optimiser."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ecology.agents.hjb.devices.records import BETA1, BETA2, TINY


class Row(NamedTuple):
    """One network of one agent, with Adam's moments."""

    w: np.ndarray  # (P,)
    first: np.ndarray
    second: np.ndarray
    steps: np.ndarray  # int (1 + heads,)


def step(row: Row, leaves: list[Tensor], rate: float, decay: float, trained: np.ndarray) -> None:
    """Take one step, after `learn_f` or `learn_j`; `leaves` hold the gradients.

    Of the last layer only the heads `trained` (M,) move; all have as many outputs, and their weights decay. The step
    counts of the hidden layers and of every head that moves are brought up to date.
    """
    gradient = torch.cat([leaf.grad.flatten() for leaf in leaves if leaf.grad is not None])
    w3, b3 = (leaf.numel() for leaf in leaves[4:])
    end, heads = len(gradient) - w3 - b3, len(trained)
    moved = [(0, 0, end, 0.0)]  # count of steps, first weight, last weight, decay
    for o in np.flatnonzero(trained).tolist():
        moved.append((1 + o, end + o * w3 // heads, end + (o + 1) * w3 // heads, decay))
        moved.append((1 + o, end + w3 + o * b3 // heads, end + w3 + (o + 1) * b3 // heads, 0.0))
    weights, first, second = (torch.from_numpy(array) for array in (row.w, row.first, row.second))
    parts = [weights[start:stop] for _, start, stop, _ in moved]
    groups = [{"params": [part], "weight_decay": each[3]} for part, each in zip(parts, moved, strict=True)]
    optimiser = torch.optim.AdamW(groups, lr=rate, betas=(BETA1, BETA2), eps=TINY)
    for part, (count, start, stop, _) in zip(parts, moved, strict=True):
        part.grad = gradient[start:stop]
        optimiser.state[part] = {
            "step": torch.tensor(float(row.steps[count])),
            "exp_avg": first[start:stop],
            "exp_avg_sq": second[start:stop],
        }
    optimiser.step()
    row.steps[0] += 1
    row.steps[1:] += trained
