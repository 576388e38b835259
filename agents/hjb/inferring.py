"""f/J agents that infer what others feel from their signs, by what the same signs mean in themselves.

An agent knows its own drive, and its own signs: the needs that others can sense of it, such as posture or a display.
It remembers both. For another agent with a sign s, it expects the mean of its own drives at signs near s (a kernel
regression, Nadaraya and Watson 1964). It feels this expected drive, times its weight of empathy. It never reads the
component `felt` of zeta, which holds the truth. Without signs it expects the mean of its own drives. An agent that
feels no other is the same as `hjb`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ecology import Group, elementary
from ecology.agents.base import Transition
from ecology.agents.hjb.learner import HJB
from ecology.agents.hjb.settings import HJBSettings

REMEMBERED = 400  # latest ticks whose own signs and drive are known
NEAR = 0.1  # standard deviation of the kernel, in units of a sign's scale
PRIOR = 1e-3  # weight of the drive at rest, which is expected of unknown signs


class Inferring(HJB):
    """f/J that infer what others feel from signs that they know of themselves."""

    def __init__(
        self, group: Group, seed: np.random.SeedSequence, settings: HJBSettings | None = None, device: str = "cpu"
    ) -> None:
        super().__init__(group, seed, settings, device)
        layout = group.layout
        names = list(layout.names)
        own = [i for i, kind in enumerate(layout.kinds) if kind == "deviation"]
        pairs = [
            (i, j)
            for i in own
            for j, name in enumerate(names)
            if layout.kinds[j] == "plain" and name.endswith(f"_1_{names[i]}")
        ]
        self.own, self.others = np.array(pairs, np.int64).reshape(-1, 2).T
        self.felt = names.index("felt") if "felt" in names else -1
        scale = np.asarray(layout.scale, float)
        minded = [i for i in own if layout.regulated[i]]
        size = float(np.sqrt(np.square(scale[minded]).sum()))
        self.cares = float(scale[self.felt]) / max(size, 1e-9) if self.felt >= 0 else 0.0  # weight of empathy
        self.width = NEAR * scale[self.own]
        n = group.size
        self.signs = np.zeros((n, REMEMBERED, len(pairs)))
        self.drives = np.zeros((n, REMEMBERED))
        self.known = np.zeros(n, np.int64)

    def infer(self, observations: np.ndarray) -> np.ndarray:
        """Return the drive (n,) that each agent expects of its nearest neighbour, from its signs in zeta (n, D)."""
        gap = (self.signs - observations[:, None, self.others]) / self.width
        weight = elementary.exp(-0.5 * np.square(gap).sum(axis=-1))
        weight *= np.arange(REMEMBERED) < np.minimum(self.known, REMEMBERED)[:, None]
        found: np.ndarray = (weight * self.drives).sum(axis=1) / (weight.sum(axis=1) + PRIOR)
        return found

    def read(self, observations: np.ndarray) -> np.ndarray:
        """Return zeta (n, D) with the inferred drive in place of the felt one."""
        if self.felt < 0:
            return observations
        found = np.array(observations)
        found[:, self.felt] = self.cares * self.infer(observations)
        return found

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Act on zeta with the inferred drive."""
        return super().act(self.read(observations), masks)

    def learn(self, transition: Transition) -> None:
        """Remember the agent's own signs and drive, and learn from one tick with the inferred drive."""
        if self.felt < 0:
            super().learn(transition)
            return
        zeta = np.array(transition.observations)
        zeta[:, self.felt] = 0.0
        rows = np.flatnonzero(transition.alive)
        at = self.known[rows] % REMEMBERED
        self.signs[rows, at], self.drives[rows, at] = zeta[np.ix_(rows, self.own)], self.drive(zeta)[rows]
        self.known[rows] += 1
        after = self.read(transition.next_observations)
        super().learn(replace(transition, observations=self.read(transition.observations), next_observations=after))

    def _life(self) -> dict[str, np.ndarray]:
        """Return every array here that changes and starts blank at birth, by name."""
        return super()._life() | {"signs": self.signs, "sign_drives": self.drives, "signs_known": self.known}
