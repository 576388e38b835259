"""The networks of n agents: every agent's weights in one row, and Adam's moments beside them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ecology.agents.hjb.devices import Device


class Perceptrons:
    """n multilayer perceptrons of one shape, each with its own weights and optimiser.

    A row holds, per layer, the weights (in, out) and the biases (out,); those of the last layer are
    (out, in), an output's weights side by side.
    """

    def __init__(self, n: int, sizes: Sequence[int], rng: np.random.Generator, device: Device, heads: int = 1) -> None:
        """Draw weights for layers of `sizes`, held by `device`; the outputs are those of `heads` of one size."""
        self.sizes, self.rng, self.device = tuple(sizes), rng, device
        self.last = sizes[-1] * (sizes[-2] + 1)  # weights of the last layer
        self.weights = device.on(self._draw(n))
        self.first = device.zeros(self.weights.shape, np.float32)  # Adam's m
        self.second = device.zeros(self.weights.shape, np.float32)  # and v
        self.steps = device.zeros((n, 1 + heads), np.int64)  # of the hidden layers, and of every head

    def _draw(self, n: int) -> np.ndarray:
        """Return weights (n, P), uniform within 1 / sqrt(fan in); an output of zero at birth."""
        parts = [
            (2 * self.rng.random((n, (fan_in + 1) * fan_out), np.float32) - 1) / np.float32(math.sqrt(fan_in))
            for fan_in, fan_out in itertools.pairwise(self.sizes[:-1])
        ]
        return np.concatenate([*parts, np.zeros((n, self.last), np.float32)], axis=1)

    def redraw(self, slots: np.ndarray) -> None:
        """Draw new weights for the agents `slots` (k,)."""
        self.weights[self.device.on(slots)] = self.device.on(self._draw(len(slots)))

    def forget(self, slots: np.ndarray) -> None:
        """Reset the optimiser of the agents `slots` (k,)."""
        for array in (self.first, self.second, self.steps):
            array[self.device.on(slots)] = 0

    def mutate(self, slots: np.ndarray, share: float | np.ndarray) -> Any:
        """Add noise of `share`, also (k,), of each layer's root mean square to the weights of `slots`; return it."""
        rows = self.device.on(slots)
        if isinstance(share, np.ndarray):
            share = self.device.on(share.astype(np.float32)[:, None])
        noise = self.device.on(self.rng.standard_normal((len(slots), self.weights.shape[1]), np.float32))
        start = 0
        for fan_in, fan_out in itertools.pairwise(self.sizes):
            for count in (fan_in * fan_out, fan_out):  # weights, biases
                layer = slice(start, start + count)
                size = (self.weights[rows, layer] ** 2).mean(axis=1, keepdims=True) ** 0.5
                noise[:, layer] *= share * size
                start += count
        self.weights[rows] += noise
        return noise
