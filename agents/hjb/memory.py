"""The memory of decisions: a ring per agent, all in one array per field."""

from __future__ import annotations

import numpy as np

from ecology.agents.hjb.devices import Device


class Memory:
    """The last `capacity` decisions of n agents: state, movement, state after, duration, what was open, drive met."""

    def __init__(self, n: int, capacity: int, components: int, movements: int, device: Device) -> None:
        self.capacity, self.device = capacity, device
        self.zeta = device.zeros((n, capacity, components), np.float32)
        self.after = device.zeros((n, capacity, components), np.float32)
        self.duration = device.zeros((n, capacity), np.float32)  # units of time
        self.movement = device.zeros((n, capacity), np.int16)  # -1: what it would have led to is unknown
        self.open = device.zeros((n, capacity, movements), np.bool_)
        self.excess = device.zeros((n, capacity), np.float32)  # drive units, see `records.Replay`
        self.count = np.zeros(n, np.int64)  # decisions so far

    def add(
        self,
        slots: np.ndarray,
        zeta: np.ndarray,
        movement: np.ndarray,
        after: np.ndarray,
        duration: np.ndarray,
        open_: np.ndarray,
        excess: np.ndarray | None = None,
    ) -> None:
        """Store one decision for each of `slots` (k,)."""
        rows, at = self.device.on(slots), self.device.on(self.count[slots] % self.capacity)
        self.zeta[rows, at] = self.device.on(zeta)
        self.after[rows, at] = self.device.on(after)
        self.duration[rows, at] = self.device.on(duration)
        self.movement[rows, at] = self.device.on(movement.astype(np.int16))
        self.open[rows, at] = self.device.on(open_)
        if excess is not None:
            self.excess[rows, at] = self.device.on(excess)
        self.count[slots] += 1
