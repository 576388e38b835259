"""Baselines that know nothing of the world: random, resting, and greedy in the drive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.base import Learner, Transition, drive_terms
from ecology import EcologyError, Group
from ecology.errors import nearest

EXPLORES = 0.2  # share of random actions of the greedy agent while it learns


def draw_open(masks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an action (n,) drawn uniformly from those open in `masks` (n, A); 0 where none is."""
    nth = np.floor(rng.random(len(masks)) * masks.sum(axis=1))
    return (masks.cumsum(axis=1) > nth[:, None]).argmax(axis=1)


class Random(Learner):
    """One who takes every open action with the same probability."""

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return open actions (n,), drawn uniformly."""
        return draw_open(masks, self.rng)


class Rest(Learner):
    """One who does nothing for as long as its body lets it."""

    def __init__(self, group: Group, seed: np.random.SeedSequence) -> None:
        super().__init__(group, seed)
        self.rest = group.kinds.index("rest")

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return rest (n,), or the first open action where rest is closed."""
        return np.where(masks[:, self.rest], self.rest, masks.argmax(axis=1))


class Greedy(Learner):
    """One who takes the open action after which it predicts the least drive, one tick ahead.

    The prediction is its own: the mean change of the deviations that it has met with each action, in the
    follow-up's words "argmin of the predicted next drive". An action not yet met is predicted to
    change nothing.
    """

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the settings by name with their defaults."""
        return {"epsilon": EXPLORES}

    @classmethod
    def with_settings(cls, group: Group, seed: np.random.SeedSequence, settings: Mapping[str, Any]) -> Greedy:
        """Return n greedy agents; the setting `epsilon` is the share of random actions while learning."""
        for name in settings:
            if name not in cls.defaults():
                raise EcologyError(f"the learner greedy has no setting {name!r}. {nearest(name, cls.defaults())}")
        return cls(group, seed, **{**cls.defaults(), **settings})

    def __init__(self, group: Group, seed: np.random.SeedSequence, epsilon: float = EXPLORES) -> None:
        super().__init__(group, seed)
        if not isinstance(epsilon, (int, float)) or not (math.isfinite(epsilon) and 0 <= epsilon <= 1):
            raise EcologyError(f"learner setting epsilon must lie between 0 and 1, got {epsilon!r}.")
        self.epsilon = float(epsilon)
        self.mix, self.felt, self.exponent = drive_terms(group.layout)
        shape = (self.size, len(group.actions))
        self.met = np.zeros(shape)  # how often each action has been met
        self.change = np.zeros((*shape, len(group.layout.kinds)))  # mean change of zeta in a tick with it

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return open actions (n,): epsilon-greedy in the predicted next drive."""
        after = observations[:, None] + self.change  # (n, A, D)
        own = np.square(after @ self.mix).sum(axis=-1) + self.group.layout.epsilon
        score = np.where(masks, own ** (self.exponent / 2) + after @ self.felt, np.inf)
        explores = self.rng.random(self.size) < self.epsilon
        return np.where(explores, draw_open(masks, self.rng), score.argmin(axis=1))

    def learn(self, transition: Transition) -> None:
        """Take the change of one tick into the mean of the action executed."""
        row = np.flatnonzero(transition.alive)
        action = transition.actions[row]
        change = (transition.next_observations - transition.observations)[row]
        self.met[row, action] += 1
        self.change[row, action] += (change - self.change[row, action]) / self.met[row, action][:, None]

    def born(self, slots: np.ndarray, parents: np.ndarray) -> None:
        """Forget what the last agent in each of `slots` (k,) has met."""
        self.met[slots], self.change[slots] = 0, 0

    def evaluating(self, epsilon: float) -> None:
        """Stop learning and explore with `epsilon` from now on."""
        super().evaluating(epsilon)
        self.epsilon = epsilon

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the means, the counts and the random stream."""
        arrays, values = super().state()
        return {**arrays, "met": self.met, "change": self.change}, {**values, "epsilon": self.epsilon}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Become what `state` returned."""
        super().restore(arrays, values)
        self.met[:], self.change[:] = arrays["met"], arrays["change"]
        self.epsilon = values["epsilon"]
