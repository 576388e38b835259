"""Where an agent has been, and how much it expects of where it has not been."""

from __future__ import annotations

from typing import Any

import numpy as np

from ecology.agents.hjb.devices import Device


class Curiosity:
    """Marks of the places that n agents have reached or aimed at, and how curious each of them still is.

    A place beyond the reach of all marks is unknown, and what is unknown is taken to be good (R-MAX, Brafman and
    Tennenholtz 2002). A place that was aimed at and not reached gets a mark of a smaller reach, so an agent does not
    try a wall twice. `level` (n,) is the recent share of attempts at the unknown that led to a new place: learning
    progress (Oudeyer and Kaplan 2007).
    """

    def __init__(self, n: int, capacity: int, reach: float, aim: float, boredom: float, device: Device) -> None:
        self.capacity, self.reach, self.aim, self.boredom, self.device = capacity, reach, aim, boredom, device
        self.marks = device.zeros((n, 3, capacity), np.float32)  # x, y and squared reach
        self.marked = device.zeros((n,), np.int64)
        self.names = device.on(np.arange(capacity))
        self.level = np.ones(n)

    @property
    def places(self) -> tuple[Any, Any]:
        """Return the marks and how many there are, as the device holds them."""
        return self.marks, self.marked

    def unknown(self, slots: np.ndarray, places: np.ndarray, reach: float) -> Any:
        """Return which `places` (k, 2) lie beyond all marks of `slots` (k,), whose reach is `reach` at most."""
        at = self.device.on(slots)
        gap = ((self.marks[at, :2] - self.device.on(places)[:, :, None]) ** 2).sum(1)  # (k, K)
        near = (gap <= self.marks[at, 2]) & (gap <= reach**2) & (self.names < self.marked[at][:, None])
        return ~near.any(1) & (self.marked[at] < self.capacity)

    def learn(self, slots: np.ndarray, aimed: np.ndarray, reached: np.ndarray) -> None:
        """Take in that movements of `slots` (k,) that f let end at `aimed` (k, 2) have ended at `reached` (k, 2)."""
        tried = self.device.off(self.unknown(slots, aimed, self.reach))
        found = self.device.off(self.mark(slots, reached, self.reach))
        self.mark(slots, aimed, self.aim)
        self.level[slots] += np.where(tried | found, self.boredom, 0.0) * (found - self.level[slots])

    def mark(self, slots: np.ndarray, places: np.ndarray, reach: float) -> Any:
        """Mark the `places` (k, 2) that are unknown to `slots` (k,); return which, on the device."""
        new = self.unknown(slots, places, reach)
        at, here = self.device.on(slots)[new], self.device.on(places)[new]
        count = self.marked[at]
        self.marks[at, :2, count] = here
        self.marks[at, 2, count] = reach**2
        self.marked[at] += 1
        return new
