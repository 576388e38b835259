"""The memory of decisions: a ring per agent, all in one array per field."""

from __future__ import annotations

import numpy as np


class Memory:
    """The last `capacity` decisions of n agents: state, movement, state after, duration, what was open."""

    def __init__(self, n: int, capacity: int, components: int, movements: int) -> None:
        self.capacity = capacity
        self.zeta = np.zeros((n, capacity, components), np.float32)
        self.after = np.zeros((n, capacity, components), np.float32)
        self.duration = np.zeros((n, capacity), np.float32)  # units of time
        self.movement = np.zeros((n, capacity), np.int16)  # -1: what it would have led to is unknown
        self.open = np.zeros((n, capacity, movements), bool)
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
        at = self.count[slots] % self.capacity
        self.zeta[slots, at] = zeta
        self.after[slots, at] = after
        self.duration[slots, at] = duration
        self.movement[slots, at] = movement
        self.open[slots, at] = open_
        self.count[slots] += 1
