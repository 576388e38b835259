"""The memory of decisions: a ring per agent, all in one tensor per field."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


class Memory:
    """The last `capacity` decisions of n agents: state, movement, state after, duration, what was open."""

    def __init__(self, n: int, capacity: int, components: int, movements: int) -> None:
        self.capacity = capacity
        self.zeta = torch.zeros(n, capacity, components)
        self.after = torch.zeros(n, capacity, components)
        self.duration = torch.zeros(n, capacity)  # units of time
        self.movement = torch.zeros(n, capacity, dtype=torch.int64)
        self.open = torch.zeros(n, capacity, movements, dtype=torch.bool)
        self.count = np.zeros(n, np.int64)  # decisions so far

    def add(
        self,
        slots: np.ndarray,
        zeta: np.ndarray,
        movement: np.ndarray,
        after: np.ndarray,
        duration: np.ndarray,
        open_: np.ndarray,
    ) -> None:
        """Store one decision for each of `slots` (k,)."""
        row = torch.from_numpy(slots)
        at = torch.from_numpy(self.count[slots] % self.capacity)
        self.zeta[row, at] = torch.from_numpy(zeta)
        self.after[row, at] = torch.from_numpy(after)
        self.duration[row, at] = torch.from_numpy(duration.astype(np.float32))
        self.movement[row, at] = torch.from_numpy(movement)
        self.open[row, at] = torch.from_numpy(open_)
        self.count[slots] += 1

    def sample(self, batch: int, recent: int, share: float, generator: torch.Generator) -> Tensor:
        """Return positions (n, batch): a `share` from the last `recent` decisions, the rest from all."""
        count = torch.from_numpy(self.count).clamp(min=1)[:, None]
        kept = count.clamp(max=self.capacity)
        late = round(batch * share)
        drawn = torch.rand(len(count), batch, generator=generator)
        window = kept.repeat(1, batch)
        window[:, batch - late :] = kept.clamp(max=recent)
        back = torch.minimum((drawn * window).long(), window - 1)  # 0: the newest
        return (count - 1 - back) % self.capacity

    def newest(self) -> Tensor:
        """Return the position (n, 1) of the newest decision."""
        return ((torch.from_numpy(self.count).clamp(min=1) - 1) % self.capacity)[:, None]

    def take(self, at: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return zeta, movement, after, duration and open at positions (n, b)."""
        row = torch.arange(len(at))[:, None]
        return (
            self.zeta[row, at],
            self.movement[row, at],
            self.after[row, at],
            self.duration[row, at],
            self.open[row, at],
        )
