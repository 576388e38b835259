"""What a device is: it holds what is large (weights, optimisers, place cells, memories) and computes with it.

The learner does the same with every device: see `ecology.agents.hjb.learner`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from ecology.agents.hjb.devices.records import Lookahead, Replay, Sampling, Trace, Training, Weights


class Device(ABC):
    """Holds the arrays of n agents, and computes with them; shapes as in `records`."""

    @abstractmethod
    def on(self, array: np.ndarray) -> Any:
        """Return an array as the device holds it."""

    @abstractmethod
    def off(self, array: Any) -> np.ndarray:
        """Return as NumPy what the device holds."""

    @abstractmethod
    def zeros(self, shape: tuple[int, ...], kind: type) -> Any:
        """Return an array of zeros on the device."""

    @abstractmethod
    def uniform(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Any:
        """Return float32 numbers from 0 to 1, on the device."""

    @abstractmethod
    def normal(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Any:
        """Return float32 numbers from the standard normal law, on the device."""

    @abstractmethod
    def scores(
        self,
        weights: Weights,
        replay: Replay,
        trace: Trace,
        ages: np.ndarray,
        slots: np.ndarray,
        zeta: np.ndarray,
        open_: np.ndarray,
    ) -> np.ndarray:
        """Return the HJB score (k, M) of the open movements of `slots` (k,) at zeta (k, D), infinity elsewhere.

        `ages` (k,) are units of time. The settings say whether errors of f are corrected and how far it looks ahead.
        """

    @abstractmethod
    def expect(self, weights: Weights, slots: np.ndarray, zeta: np.ndarray, movement: np.ndarray) -> np.ndarray:
        """Return what f predicts (k, E) of the `movement` (k,) of each of `slots` (k,) at zeta (k, D)."""

    @abstractmethod
    def update(
        self, weights: Weights, replay: Replay, sampling: Sampling, training: Training, lookahead: Lookahead
    ) -> None:
        """Take one step on L_f and then one on L_J for every agent that is ready, and fill in their losses.

        Then fill in the scores of the movements in `lookahead` that are open to one of them.
        """

    @abstractmethod
    def value(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return Jn (m,) of one agent at zeta (m, D)."""

    @abstractmethod
    def slope(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return dJn/dzeta (m, D) of one agent at zeta (m, D)."""

    @abstractmethod
    def forecast(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return f's outputs (m, M E) of one agent at zeta (m, D), in its units."""


class HostDevice(Device):
    """A device whose arrays are NumPy's, with the random numbers of the learner's own generator."""

    def on(self, array: np.ndarray) -> np.ndarray:  # noqa: D102
        return array

    def off(self, array: np.ndarray) -> np.ndarray:  # noqa: D102
        return array

    def zeros(self, shape: tuple[int, ...], kind: type) -> np.ndarray:  # noqa: D102
        return np.zeros(shape, kind)

    def uniform(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:  # noqa: D102
        return generator.random(shape, np.float32)

    def normal(self, generator: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:  # noqa: D102
        return generator.standard_normal(shape, np.float32)
