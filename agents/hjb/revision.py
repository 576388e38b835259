"""Correcting memories that the world contradicts: a food that was always here has gone."""

from __future__ import annotations

import numpy as np

from ecology.agents.hjb.memory import Memory

SAME, RIM = 0.15, 0.5  # shares of the reach: within the first, memories are of one place; within the second, around it
LEAST, MOSTLY = 2, 0.8  # memories of one place, and the share of them that have a movement open, for it to be expected


class Revision:
    """Rewrites which of some movements were open in memories that are no longer true, in place.

    J is learned from memories. While thousands of them say that an agent can eat where a food was, J stays low there,
    and the agent waits at the empty place while its other needs grow. So a strong and lasting surprise changes what is
    remembered (Gershman, Monfils, Norman and Niv 2017). `which` (M,) are the movements that depend on a place.
    """

    def __init__(self, memory: Memory, which: np.ndarray, place: np.ndarray, reach: float, doubt: int) -> None:
        self.memory, self.device, self.which, self.place = memory, memory.device, which, place
        self.reach, self.doubt = reach, doubt

    def revise(self, slots: np.ndarray, zeta: np.ndarray, open_: np.ndarray) -> list[tuple[int, int]]:
        """Correct the memories of `slots` (k,), which are at zeta (k, D) with the movements `open_` (k, M).

        Returns the slots and movements of which no memory is left that has the movement open.
        """
        memory, device, at = self.memory, self.device, zeta[:, self.place]
        newest = (memory.count[slots, None] - 1 - np.arange(memory.capacity)) % memory.capacity
        rows, columns = device.on(slots[:, None]), device.on(newest)
        exists = device.on(np.arange(memory.capacity) < memory.count[slots, None])
        x, y = (
            memory.zeta[rows, columns, int(axis)] - device.on(at[:, i : i + 1]) for i, axis in enumerate(self.place)
        )
        gap = x * x + y * y  # (k, C), newest first
        within = (gap < self.reach**2) & exists
        same = (gap < (SAME * self.reach) ** 2) & exists
        made = memory.movement[rows, columns]
        chooses = open_.sum(1) > 1  # where one movement alone is open, as in sleep, that says nothing of the place
        lost = []
        for movement in np.flatnonzero(self.which):
            was_open = memory.open[rows, columns, int(movement)]
            since = (within & was_open).cumsum(1) == 0  # newer than the last time that it was open around here
            before = same & ~since
            missed = (within & since).sum(1) >= self.doubt
            missed &= before.sum(1) >= LEAST
            missed &= (before & was_open).sum(1) >= MOSTLY * before.sum(1)
            for row in np.flatnonzero(device.off(missed) & ~open_[:, movement] & chooses):
                rim = (gap[row] < (RIM * self.reach) ** 2) & exists[row] & was_open[row]
                if not surrounded(device.off(x[row][rim]), device.off(y[row][rim])):
                    continue
                wrong = columns[row][within[row] & was_open[row]]
                memory.open[int(slots[row]), wrong, int(movement)] = False
                if not (memory.open[int(slots[row]), columns[row], int(movement)] & exists[row]).any():
                    lost.append((int(slots[row]), int(movement)))
            # a movement that was made was open: if it is again, the doubt was wrong
            denied = within & ~was_open & (made == int(movement))
            for row in np.flatnonzero(device.off(denied.any(1)) & open_[:, movement]):
                memory.open[int(slots[row]), columns[row][denied[row]], int(movement)] = True
        return lost


def surrounded(x: np.ndarray, y: np.ndarray) -> bool:
    """Return whether the points (x, y), (m,) each, lie all around the origin: it is inside their convex hull."""
    elsewhere = (x != 0) | (y != 0)
    x, y = x[elsewhere], y[elsewhere]
    cross = x[:, None] * y - y[:, None] * x  # below 0 where the second point is to the right of the first
    return bool(len(x) > 2 and (cross < 0).any(axis=1).all())
