"""The decisions of the f/J learner as observers see them: what was weighed, how, and how well f predicts."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np

from ecology.agents.movements import ARRIVES
from ecology.decision import Decision, Plan

if TYPE_CHECKING:
    from ecology.agents.hjb.learner import HJB


class DecisionRecord:
    """Keeps the decisions of the agents that are followed, and weighs decisions again; it changes nothing.

    Only a followed agent's decision is known as it was made. Another's is weighed again when it is asked for, with
    what the agent has learned since.
    """

    def __init__(self, learner: HJB) -> None:
        self.learner = learner
        self.followed: frozenset[int] = frozenset()  # slots whose decisions are kept
        self._kept: dict[int, tuple[Decision, int]] = {}  # by slot, with its clock at the decision

    def follow(self, slots: Collection[int]) -> None:
        """Keep from now on what the agents in `slots` weigh when they decide."""
        self.followed = frozenset(int(slot) for slot in slots)
        self._kept = {slot: kept for slot, kept in self._kept.items() if slot in self.followed}

    def forget(self, slots: np.ndarray) -> None:
        """Forget the last decisions in `slots` (k,)."""
        for slot in np.atleast_1d(slots).tolist():
            self._kept.pop(slot, None)

    def clear(self) -> None:
        """Forget all decisions."""
        self._kept.clear()

    def keep(
        self,
        slots: np.ndarray,
        observations: np.ndarray,
        masks: np.ndarray,
        chosen: np.ndarray,
        compared: np.ndarray | None,
    ) -> None:
        """Keep the decisions of those of `slots` (k,) that are followed, with the scores (k, M) that they `compared`.

        Where the world leaves one option, and it is the one under way, nothing is decided: the agent sleeps on.
        """
        for row, slot in enumerate(slots.tolist()):
            if slot not in self.followed:
                continue
            weighed = self.weigh(slot, observations[row], masks[row])
            known = np.full(self.learner.count, np.nan) if compared is None else compared[row]
            decision = dataclasses.replace(
                weighed,
                score=np.where(weighed.open & np.isfinite(known), known, weighed.score),
                taken=int(chosen[row]),
                explored=bool(self.learner.explores[slot]),
                length=self._length(int(chosen[row])),
            )
            if slot in self._kept and decision.open.sum() == 1 and self._kept[slot][0].taken == decision.taken:
                continue
            self._kept[slot] = decision, int(self.learner.clock[slot])

    def _length(self, movement: int) -> int | None:
        """Return the ticks that a movement takes, None where the world ends it."""
        lasts = int(self.learner.moves.ticks[movement].sum())
        return None if lasts >= ARRIVES else max(lasts, int(self.learner.moves.length[movement]))

    def decision(self, slot: int) -> Decision | None:
        """Return the decision that the agent in `slot` acts on, None before its first one."""
        learner = self.learner
        if slot in self._kept:
            kept, made = self._kept[slot]
            return dataclasses.replace(kept, age=int(learner.clock[slot]) - made + 1)
        taken = int(learner.execution.movement[slot])
        if taken < 0:
            return None
        decision = dataclasses.replace(
            self._weigh(slot, learner.execution.began[slot].copy(), learner.execution.was_open[slot].copy()),
            taken=taken,
            explored=None if learner.explores[slot] < 0 else bool(learner.explores[slot]),
            age=int(learner.execution.elapsed[slot]),
            length=self._length(taken),
            recalled=True,
        )
        if slot in self.followed:
            self._kept[slot] = decision, int(learner.clock[slot]) - decision.age + 1
        return decision

    def plan(self, slot: int) -> Plan | None:
        """Return the best plan of the agent in `slot` where it last decided, by what it knows now."""
        under = self.learner.execution
        if under.movement[slot] < 0:
            return None
        from ecology.agents.hjb.plan import best_plan  # it loads torch, which takes seconds

        return best_plan(self.learner, slot, under.began[slot], under.was_open[slot])

    def weigh(self, slot: int, zeta: np.ndarray, mask: np.ndarray) -> Decision:
        """Return what the agent in `slot` would decide at zeta (D,) with the actions of `mask` (A,) open.

        Over a whole movement of duration tau, dJ/dzeta . f is the mean slope (J(zeta') - J(zeta)) / tau; without
        `finite_difference`, the slope at zeta.
        """
        return self._weigh(slot, zeta, self.learner.moves.open(mask[None])[0])

    def _weigh(self, slot: int, zeta: np.ndarray, open_: np.ndarray) -> Decision:
        """Return what the agent in `slot` would decide at zeta (D,) with the movements `open_` (M,)."""
        learner = self.learner
        s, layout = learner.settings, learner.group.layout
        gamma = float(np.broadcast_to(learner.number("gamma"), learner.size)[slot])
        predicted = learner.predict(slot, zeta[None])
        change, duration = predicted["change"][0], predicted["duration"][0]  # (M, D), (M,)
        whole = s.finite_difference
        step = duration if whole else np.full(len(duration), learner.group.dt)
        after = zeta + change * (step / duration)[:, None]
        if whole:
            angle = np.array(layout.kinds) == "angle"
            after = np.clip(after, np.where(angle, -np.inf, layout.low), np.where(angle, np.inf, layout.high))
        here = float(learner.deviation(slot, zeta[None])[0])
        ahead = learner.deviation(slot, after.astype(np.float32))
        if whole:
            slope = (ahead - here) / (-np.log(gamma) * step)
        else:
            climb = change / duration[:, None] * learner.slope(slot, zeta[None])[0]
            slope = climb.sum(axis=1) / -np.log(gamma)
        at, every = np.ascontiguousarray(zeta[None], np.float32), np.ones((1, learner.count), bool)
        open_, here_slot = open_[None], np.array([slot])  # what is open competes for the beam alone
        score = np.where(open_, learner.scores(here_slot, at, open_), learner.scores(here_slot, at, every))[0]
        inherited = s.inherit and learner.tried[slot].sum() > learner.decisions[slot]  # an heir has its parent's tries
        return Decision(
            options=learner.moves.names,
            open=open_[0],
            next_drive=learner.drive(after),
            slope=slope,
            score=score,
            taken=int(np.where(open_[0], score, np.inf).argmin()),
            explored=False,
            learned=bool(np.isfinite(learner.loss_j[slot]) or inherited),
            value=here,
            gamma=gamma,
            error=self._error(slot),
            zeta=np.array(zeta),
            after=after,
        )

    def _error(self, slot: int, last: int = 64) -> np.ndarray:
        """Return the error of f per component over the `last` decisions, relative to the changes met, (D,)."""
        learner = self.learner
        memory, newest = learner.memory, int(learner.memory.count[slot])
        at = np.arange(max(newest - min(last, memory.capacity), 0), newest) % memory.capacity
        rows = learner.device.on(at)
        began, met, taken = (
            learner.device.off(part[slot, rows]) for part in (memory.zeta, memory.after, memory.movement)
        )
        kept = taken >= 0
        if kept.sum() < 2:
            return np.full(learner.components, np.nan)
        change, taken = (met - began)[kept], taken[kept]
        predicted = learner.predict(slot, began[kept])["change"][np.arange(len(taken)), taken]
        angle = np.array(learner.group.layout.kinds) == "angle"
        change[:, angle] = (change[:, angle] + np.pi) % (2 * np.pi) - np.pi
        size = np.sqrt(np.square(change).mean(0))
        error = np.sqrt(np.square(predicted - change).mean(0))
        return np.divide(error, size, out=np.full(learner.components, np.nan), where=size > 1e-9)
