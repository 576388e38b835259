"""The memory of decisions: a ring per agent, all in one array per field."""

from __future__ import annotations

import numpy as np

from ecology.agents.hjb.devices import Device


class Memory:
    """The last `capacity` decisions of n agents: state, movement, state after, duration, what was open."""

    def __init__(self, n: int, capacity: int, components: int, movements: int, device: Device) -> None:
        self.capacity, self.device = capacity, device
        self.zeta = device.zeros((n, capacity, components), np.float32)
        self.after = device.zeros((n, capacity, components), np.float32)
        self.duration = device.zeros((n, capacity), np.float32)  # units of time
        self.movement = device.zeros((n, capacity), np.int16)  # -1: what it would have led to is unknown
        self.open = device.zeros((n, capacity, movements), np.bool_)
        self.count = np.zeros(n, np.int64)  # decisions so far

    def spare(self, slots: np.ndarray, uniform: np.ndarray, recent: int) -> None:
        """Before one more decision of `slots` (k,): let some old ones outlive ones that are no longer recent.

        A full memory then holds the last `recent` decisions and a sample of all before them, each being as likely:
        reservoir sampling (Vitter 1985). Without, it holds the last ones alone. `uniform` (k,) are random numbers.
        """
        count, older = self.count[slots], self.capacity - recent
        full = count >= self.capacity
        enters = older / np.maximum(count - recent + 1.0, older)  # probability that the one that is leaving stays
        nth = np.floor(uniform / enters * older).astype(np.int64)  # which of the older ones makes room for it
        goes = np.where(uniform < enters, count - self.capacity + nth, count - recent)
        rows = self.device.on(slots[full])
        oldest, gone = (
            self.device.on(which[full] % self.capacity) for which in (count, goes)
        )  # it would be overwritten
        for array in (self.zeta, self.after, self.duration, self.movement, self.open):
            array[rows, gone] = array[rows, oldest]

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
        rows, at = self.device.on(slots), self.device.on(self.count[slots] % self.capacity)
        self.zeta[rows, at] = self.device.on(zeta)
        self.after[rows, at] = self.device.on(after)
        self.duration[rows, at] = self.device.on(duration)
        self.movement[rows, at] = self.device.on(movement.astype(np.int16))
        self.open[rows, at] = self.device.on(open_)
        self.count[slots] += 1
