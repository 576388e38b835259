"""The movements under way: one row per slot, continued by a compiled loop from tick to tick."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ecology.agents.hjb.devices.cpu.compiler import compiled
from ecology.agents.movements import Movements

TRAIL = 64  # ticks of a movement whose states are kept on the way


class Underway(NamedTuple):
    """What the compiled loop reads and writes."""

    movement: np.ndarray  # int (n,), -1: none
    stage: np.ndarray  # int (n,)
    left: np.ndarray  # int (n,) ticks of the stage that are left
    elapsed: np.ndarray  # int (n,) ticks since the decision
    trail: np.ndarray  # (n, T, D) zeta on the way, by ticks elapsed
    trail_open: np.ndarray  # bool (n, T, M)
    drive: np.ndarray  # (n,) of this tick, zero where it is not needed
    felt: np.ndarray  # (n,) sum of the drive over the ticks since the decision
    trail_felt: np.ndarray  # (n, T) the same on the way


class Execution:
    """Which movement every agent is executing, since when, and the states that it has passed."""

    def __init__(self, moves: Movements, n: int, components: int, *, costed: bool) -> None:
        """Begin without movements; `costed` says that the drive on the way is needed."""
        self.costed = costed
        count = len(moves.names)
        self.moves = moves
        self.movement = np.full(n, -1)
        self.stage = np.zeros(n, np.int64)
        self.left = np.zeros(n, np.int64)  # ticks of the stage that are left
        self.elapsed = np.zeros(n, np.int64)  # ticks since the decision
        self.began = np.zeros((n, components), np.float32)  # zeta at the decision
        self.was_open = np.zeros((n, count), bool)
        self.trail = np.zeros((n, TRAIL, components), np.float32)  # zeta on the way, by ticks elapsed
        self.trail_open = np.zeros((n, TRAIL, count), bool)
        self.drive = np.zeros(n)
        self.felt = np.zeros(n)
        self.trail_felt = np.zeros((n, TRAIL))
        self.free = np.zeros(n, bool)  # agents without a movement to continue
        self._underway = Underway(
            self.movement, self.stage, self.left, self.elapsed, self.trail, self.trail_open,
            self.drive, self.felt, self.trail_felt,
        )  # fmt: skip

    def arrays(self) -> dict[str, np.ndarray]:
        """Return every array that a checkpoint holds, by name."""
        felt = {"drive"} if self.costed else {"drive", "felt", "trail_felt"}
        names = [name for name in (*Underway._fields, "began", "was_open") if name not in felt]
        return {name: getattr(self, name) for name in names}

    def proceed(self, masks: np.ndarray, zeta: np.ndarray, actions: np.ndarray, *, keep: bool) -> int:
        """Continue the movements by one tick and fill in their actions (n,); `keep` the states passed.

        Returns how many agents are `free` to decide.
        """
        return proceed(self.moves.action, self.moves.ticks, self._underway, masks, zeta, keep, self.free, actions)

    def start(self, slots: np.ndarray, chosen: np.ndarray, zeta: np.ndarray, open_: np.ndarray) -> None:
        """Start the movements `chosen` (k,) in `slots` (k,), decided at zeta (k, D) among those `open_` (k, M)."""
        self.movement[slots] = chosen
        self.stage[slots] = 0
        self.left[slots] = self.moves.ticks[chosen, 0]
        self.elapsed[slots] = 0
        self.felt[slots] = 0
        self.began[slots] = zeta
        self.was_open[slots] = open_

    def advance(self, slots: np.ndarray) -> np.ndarray:
        """Execute the first tick of what was started in `slots` (k,); return their actions (k,)."""
        self.left[slots] -= 1
        self.elapsed[slots] += 1
        return self.moves.action[self.movement[slots], self.stage[slots]]

    def draw_passed(self, slots: np.ndarray, uniform: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw a tick on the way of each movement of `slots` (k,) that has just ended, from uniform numbers (k,).

        Returns the ticks since the decision (k,), whether the agent had a choice then, and the movement that has the
        same end from there on: the same one if the world ended it (an arrival, a full stomach), else -1, unknown.
        """
        elapsed, movement = self.elapsed[slots], self.movement[slots]
        ticks = 1 + np.floor(uniform * (np.minimum(elapsed, TRAIL) - 1)).astype(np.int64)
        # where the world leaves no choice (asleep), zeta alone does not tell how bad the future is
        some = (elapsed > 1) & (self.trail_open[slots, np.minimum(ticks, TRAIL - 1)].sum(axis=1) > 1)
        second = (self.stage[slots] == 1) & (ticks >= self.moves.ticks[movement, 0])
        same = np.where(second, self.moves.walk, np.where(self.stage[slots] == 0, movement, -1))
        return ticks, some, np.where(self.left[slots] > 0, same, -1)


@compiled
def proceed(table, ticks, underway, masks, zeta, keep, free, actions):  # type: ignore[no-untyped-def]
    """Continue movements by one tick: fill actions (n,), and with `keep` the trail.

    A movement passes to its second stage when the first is over; it continues past its end where the world leaves
    no choice. Returns how many agents have none to continue, marked in free (n,). `table` and `ticks` (M, 2) are
    those of `ecology.agents.movements`; masks (n, A), zeta (n, D).
    """
    count = 0
    for i in range(len(free)):
        m = underway.movement[i]
        free[i] = True
        if m >= 0:
            underway.felt[i] += underway.drive[i]
            over = underway.left[i] <= 0
            if over and underway.stage[i] == 0 and ticks[m, 1] > 0:
                underway.stage[i], underway.left[i], over = 1, ticks[m, 1], False
            actions[i] = table[m, underway.stage[i]]
            free[i] = not masks[i, actions[i]] or (over and np.sum(masks[i]) != 1)
        if free[i]:
            count += 1
            continue
        at = underway.elapsed[i]
        if keep and at < underway.trail.shape[1]:
            for v in range(zeta.shape[1]):
                underway.trail[i, at, v] = zeta[i, v]
            underway.trail_felt[i, at] = underway.felt[i]
            for k in range(len(table)):
                underway.trail_open[i, at, k] = masks[i, table[k, 0]] and masks[i, table[k, 1]]
        underway.left[i] -= 1
        underway.elapsed[i] += 1
    return count
