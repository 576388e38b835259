"""Movements: the elementary movements a decision is between, and how long each is held.

The paper's actions are open to be changed at any tick; it names adaptive time steps as what its
continuous formulation allows. A movement holds one action, or a turn and then a walk, for a while,
whether or not something is in the way; the agent lets go of it when the world closes it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ecology import Group

ARRIVES = 1_000_000  # ticks: held until the world closes it
APPROACH = 10  # ticks: what a go_to counts as before any was made
HALF_TURN = math.pi


@dataclass(frozen=True)
class Movements:
    """M movements of up to two stages, as arrays over the actions of one species."""

    names: tuple[str, ...]  # M
    action: np.ndarray  # int (M, 2) action of each stage
    ticks: np.ndarray  # int (M, 2) length of each stage, 0: no such stage
    length: np.ndarray  # (M,) ordinary length in ticks
    walk: int  # movement that is the second stage of others, alone; -1 without
    onward: np.ndarray  # int (M,) walk that goes on where a walk has ended, -1 for other movements

    def open(self, masks: np.ndarray) -> np.ndarray:
        """Return which movements (n, M) are open under the action masks (n, A)."""
        return masks[:, self.action[:, 0]] & masks[:, self.action[:, 1]]

    def explore(self, open_: np.ndarray, uniform: np.ndarray) -> np.ndarray:
        """Return a random movement (k,) for each row of `open_` (k, M), from uniform numbers (k,).

        The chance of a movement is inverse to its length, so that all open movements get the same time.
        """
        share = (open_ / self.length).cumsum(axis=1)
        return (share > uniform[:, None] * share[:, -1:]).argmax(axis=1)


def single_ticks(group: Group) -> Movements:
    """Return one movement of one tick per action: the fixed time step of Algorithm 1."""
    return _table(group, [(name, [(i, 1)]) for i, name in enumerate(group.actions)])


def adaptive(
    group: Group,
    *,
    bearings: bool,
    stride: float = 10.0,
    pause: float = 40.0,
    meal: float = 5.0,
    bearing: float = math.pi / 4,
) -> Movements:
    """Return movements with adaptive time steps; lengths in units of time.

    A move lasts `stride`, a rest `pause`, a meal, a bite, a gift, taking and dropping `meal`, an act one tick, a
    turn about `bearing` radians, go_to until it arrives, sleep its minimal duration. With `bearings`, turns are not
    decided alone: a turn toward a bearing and the slowest move forward are one movement.
    """
    turns = [i for i, kind in enumerate(group.kinds) if kind == "turn"]
    moves = [i for i, kind in enumerate(group.kinds) if kind == "move"]
    join = bearings and bool(turns) and bool(moves)
    found: list[tuple[str, list[tuple[int, int]]]] = []
    for i, (name, kind) in enumerate(zip(group.actions, group.kinds, strict=True)):
        length = {
            "move": stride, "rest": pause, "consume": meal, "bite": meal, "give": meal, "take": meal, "drop": meal,
            "act": group.dt,
        }.get(kind)  # fmt: skip
        if length is not None:
            found.append((name, [(i, _count(length, group.dt))]))
        elif kind == "go_to":
            found.append((name, [(i, ARRIVES)]))
        elif kind == "sleep":
            found.append((name, [(i, 1)]))
        elif kind == "turn" and not join:
            found.append((name, [(i, _steps(group, i, bearing))]))
    if join:
        walk = min(moves, key=lambda i: group.speeds[i])
        for i in turns:
            ticks = _steps(group, i, bearing)
            angle = abs(group.turns[i]) * group.dt * ticks
            for k in range(1, int(HALF_TURN / angle + 1e-9) + 1):
                half = k * angle > HALF_TURN - 1e-6
                if half and group.turns[i] < 0:
                    continue  # the same bearing as the half turn to the left
                degrees = round(math.degrees(k * angle))
                found.append(
                    (
                        f"{group.actions[i]}_{degrees}_{group.actions[walk]}",
                        [(i, k * ticks), (walk, _count(stride, group.dt))],
                    )
                )
    return _table(group, found)


def _count(length: float, dt: float) -> int:
    return max(1, round(length / dt))


def _steps(group: Group, action: int, angle: float) -> int:
    return max(1, round(angle / (abs(float(group.turns[action])) * group.dt)))


def _table(group: Group, found: list[tuple[str, list[tuple[int, int]]]]) -> Movements:
    action = np.array([(stages[0][0], stages[-1][0]) for _, stages in found], dtype=np.int64)
    ticks = np.array([[s[0][1], s[1][1] if len(s) > 1 else 0] for _, s in found], dtype=np.int64)
    immobile = np.ceil(group.durations / group.dt)[action[:, 0]]
    length = np.maximum(np.where(ticks >= ARRIVES, APPROACH, ticks).sum(axis=1), immobile)
    joined = action[ticks[:, 1] > 0, 1]
    alone: list[int] = []
    if len(joined):
        alone = np.flatnonzero((ticks[:, 1] == 0) & (action[:, 0] == joined[0])).tolist()
    walk = alone[0] if alone else -1
    slow = (speed := group.speeds[action[:, 1]]) <= np.min(speed[speed > 0], initial=np.inf)
    walks = np.array([group.kinds[last] == "move" for last in action[:, 1]]) & slow
    onward = np.where(walks, np.where(ticks[:, 1] > 0, walk, np.arange(len(found))), -1)
    return Movements(
        names=tuple(name for name, _ in found),
        action=action,
        ticks=ticks,
        length=length,
        walk=walk,
        onward=onward,
    )
