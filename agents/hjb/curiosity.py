"""Where an agent has been, and how much it expects of where it has not been."""

from __future__ import annotations

from typing import Any

import numpy as np

from ecology.agents.hjb.devices import Device

CLOSER = 0.7  # factor of the reach of marks from one search to the next
SEARCHES = 5  # times that a search begins again
SHARES = np.cumprod([1.0] + [CLOSER] * SEARCHES)  # of the reach, by searches


class Curiosity:
    """Marks of the places that n agents have reached or aimed at, and how curious each of them still is.

    A place beyond the reach of all marks is unknown, and what is unknown is taken to be good (R-MAX, Brafman and
    Tennenholtz 2002). A place that was aimed at and not reached gets a mark of a smaller reach, so an agent does not
    try a wall twice. `level` (n,) is the recent share of attempts at the unknown that led to a new place: learning
    progress (Oudeyer and Kaplan 2007). An agent that lacks something and has found no new place for a while begins
    the search again: it forgets its marks and searches more closely, `SEARCHES` times at most.
    """

    def __init__(self, n: int, capacity: int, reach: float, aim: float, boredom: float, device: Device) -> None:
        self.capacity, self.reach, self.aim, self.boredom, self.device = capacity, reach, aim, boredom, device
        self.marks = device.zeros((n, 3, capacity), np.float32)  # x, y and squared reach
        self.marked = device.zeros((n,), np.int64)
        self.names = device.on(np.arange(capacity))
        self.level = np.ones(n)
        self.searches = np.zeros(n, np.int64)  # times that the search began again
        self.since = np.zeros(n, np.int64)  # decisions since a new place was found

    @property
    def places(self) -> tuple[Any, Any]:
        """Return the marks and how many there are, as the device holds them."""
        return self.marks, self.marked

    def unknown(self, slots: np.ndarray, places: np.ndarray, reach: np.ndarray) -> Any:
        """Return which `places` (k, 2) lie beyond all marks of `slots` (k,), whose reach is `reach` (k,) at most."""
        at, most = self.device.on(slots), self.device.on((reach**2).astype(np.float32))[:, None]
        gap = ((self.marks[at, :2] - self.device.on(places)[:, :, None]) ** 2).sum(1)  # (k, K)
        near = (gap <= self.marks[at, 2]) & (gap <= most) & (self.names < self.marked[at][:, None])
        return ~near.any(1) & (self.marked[at] < self.capacity)

    def learn(self, slots: np.ndarray, aimed: np.ndarray, reached: np.ndarray) -> None:
        """Take in that movements of `slots` (k,) that f let end at `aimed` (k, 2) have ended at `reached` (k, 2)."""
        reach = np.maximum(self.reach * SHARES[np.minimum(self.searches[slots], SEARCHES)], self.aim)
        tried = self.device.off(self.unknown(slots, aimed, reach))
        found = self.device.off(self.mark(slots, reached, reach))
        self.mark(slots, aimed, np.full(len(slots), self.aim))
        self.level[slots] += np.where(tried | found, self.boredom, 0.0) * (found - self.level[slots])
        self.since[slots] = np.where(found, 0, self.since[slots] + 1)

    def search_again(self, slots: np.ndarray, patience: int) -> None:
        """Begin the search again in those of `slots` (k,) that have found nothing new for `patience` decisions."""
        again = slots[(self.since[slots] > patience) & (self.searches[slots] < SEARCHES)]
        self.search(again, self.searches[again] + 1)

    def search(self, slots: np.ndarray, before: np.ndarray | int) -> None:
        """Let `slots` (k,) forget their marks and be as curious as at birth, after `before` (k,) other searches."""
        self.marked[self.device.on(slots)] = 0
        self.level[slots], self.since[slots] = 1.0, 0
        self.searches[slots] = before

    def mark(self, slots: np.ndarray, places: np.ndarray, reach: np.ndarray) -> Any:
        """Mark the `places` (k, 2) that are unknown to `slots` (k,); return which, on the device."""
        new = self.unknown(slots, places, reach)
        at, here = self.device.on(slots)[new], self.device.on(places)[new]
        count = self.marked[at]
        self.marks[at, :2, count] = here
        self.marks[at, 2, count] = self.device.on((reach**2).astype(np.float32))[new]
        self.marked[at] += 1
        return new
