"""Baselines that know nothing of the world: random, resting, and two that go by what each action brought."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import EcologyError, Group
from ecology.agents import checkpoint
from ecology.agents.base import Learner, Transition

EXPLORES = 0.2  # share of random actions while one learns


def draw_open(masks: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an action (n,) drawn uniformly from those open in `masks` (n, A); 0 where none is."""
    nth = np.floor(rng.random(len(masks)) * masks.sum(axis=1))
    return (masks.cumsum(axis=1) > nth[:, None]).argmax(axis=1)


class Random(Learner):
    """A learner that takes every open action with the same probability."""

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return open actions (n,), drawn uniformly."""
        return draw_open(masks, self.rng)


class Rest(Learner):
    """A learner that does nothing for as long as its body lets it."""

    def __init__(self, group: Group, seed: np.random.SeedSequence) -> None:
        super().__init__(group, seed)
        self.rest = group.kinds.index("rest")

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return rest (n,), or the first open action where rest is closed."""
        return np.where(masks[:, self.rest], self.rest, masks.argmax(axis=1))


class Averaging(Learner):
    """A learner that keeps the mean outcome of each action and takes the open action with the lowest score."""

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the settings by name with their defaults."""
        return {"epsilon": EXPLORES}

    @classmethod
    def with_settings(cls, group: Group, seed: np.random.SeedSequence, settings: Mapping[str, Any]) -> Averaging:
        """Return n agents; the setting `epsilon` is the share of random actions while learning."""
        return cls(group, seed, **{**cls.defaults(), **settings})

    def __init__(self, group: Group, seed: np.random.SeedSequence, epsilon: float = EXPLORES) -> None:
        super().__init__(group, seed)
        if not isinstance(epsilon, (int, float)) or not (math.isfinite(epsilon) and 0 <= epsilon <= 1):
            raise EcologyError(f"learner setting epsilon must lie between 0 and 1, got {epsilon!r}.")
        self.epsilon = float(epsilon)
        nobody = np.zeros((0, len(group.layout.kinds)))
        self.met = np.zeros((self.size, len(group.actions)))  # how often each action has been met
        self.mean = np.zeros((*self.met.shape, self.brings(nobody, nobody).shape[1]))  # of what it brought

    @abstractmethod
    def brings(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return what is kept of a tick that led from zeta `before` to `after` (k, D), (k, K)."""

    @abstractmethod
    def score(self, zeta: np.ndarray) -> np.ndarray:
        """Return what is expected of every action at zeta (n, D), (n, A); less is better."""

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return open actions (n,): epsilon-greedy in the score."""
        score = np.where(masks, self.score(observations), np.inf)
        explores = self.rng.random(self.size) < self.epsilon
        return np.where(explores, draw_open(masks, self.rng), score.argmin(axis=1))

    def learn(self, transition: Transition) -> None:
        """Take what one tick brought into the mean of the action executed."""
        row = np.flatnonzero(transition.alive)
        action = transition.actions[row]
        brought = self.brings(transition.observations[row], transition.next_observations[row])
        self.met[row, action] += 1
        self.mean[row, action] += (brought - self.mean[row, action]) / self.met[row, action][:, None]

    def born(self, slots: np.ndarray, parents: np.ndarray) -> None:
        """Forget what the last agent in each of `slots` (k,) has met."""
        self.met[slots], self.mean[slots] = 0, 0

    def evaluating(self, epsilon: float) -> None:
        """Stop learning and explore with `epsilon` from now on."""
        super().evaluating(epsilon)
        self.epsilon = epsilon

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return the means, the counts and the random stream, as copies."""
        arrays, values = super().state()
        return {**arrays, "met": self.met.copy(), "mean": self.mean.copy()}, {**values, "epsilon": self.epsilon}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Become what `state` returned."""
        for name, low in (("met", 0), ("mean", None)):
            checkpoint.check_array(name, arrays[name], getattr(self, name), low=low)
        super().restore(arrays, values)
        self.met[:], self.mean[:] = arrays["met"], arrays["mean"]
        self.epsilon = values["epsilon"]


class Greedy(Averaging):
    """A learner that takes the open action after which it predicts the least drive, one tick ahead.

    The prediction is its own: the mean change of zeta that it has met with each action, in the
    follow-up's words "argmin of the predicted next drive". An action not yet met is predicted to
    change nothing.
    """

    def brings(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return the change of zeta, (k, D)."""
        return after - before

    def score(self, zeta: np.ndarray) -> np.ndarray:
        """Return the predicted next drive, (n, A)."""
        return self.drive(zeta[:, None] + self.mean)


class QValue(Averaging):
    """A learner that takes the open action after which the drive was least on average, ignoring its state.

    The follow-up's "Q-value" baseline. An action not yet met counts as bringing no drive, so it is tried.
    """

    def brings(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return the drive after the tick, (k, 1)."""
        return self.drive(after)[:, None]

    def score(self, zeta: np.ndarray) -> np.ndarray:
        """Return the mean drive seen after each action, (n, A)."""
        return self.mean[..., 0]
