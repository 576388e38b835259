"""Stacked networks: n agents' own weights in one tensor per layer, and their own Adam."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence

import torch
from torch import Tensor

Activation = Callable[[Tensor], Tensor]


class Perceptrons:
    """n multilayer perceptrons of one shape, each with its own weights."""

    def __init__(self, n: int, sizes: Sequence[int], activation: Activation, generator: torch.Generator) -> None:
        """Draw weights uniformly within 1 / sqrt(fan in), for layers of `sizes`."""
        self.activation, self.sizes, self.generator = activation, tuple(sizes), generator
        self.weights = self._draw(n)  # per layer: (n, in, out), (n, 1, out)
        for w in self.weights:
            w.requires_grad_()

    def _draw(self, n: int) -> list[Tensor]:
        weights: list[Tensor] = []
        for fan_in, fan_out in itertools.pairwise(self.sizes):
            bound = 1 / math.sqrt(fan_in)
            for shape in ((n, fan_in, fan_out), (n, 1, fan_out)):
                drawn = torch.rand(shape, generator=self.generator) * (2 * bound) - bound
                weights.append(drawn)
        for w in weights[-2:]:
            w.zero_()  # an output of zero at birth
        return weights

    @torch.no_grad()
    def redraw(self, index: Tensor) -> None:
        """Draw the weights of the agents `index` (k,) anew."""
        for w, drawn in zip(self.weights, self._draw(len(index)), strict=True):
            w[index] = drawn

    def __call__(self, inputs: Tensor, weights: Sequence[Tensor] | None = None) -> Tensor:
        """Return outputs (n, b, out) for inputs (n, b, in); `weights` in place of its own if given."""
        weights = self.weights if weights is None else weights
        hidden = inputs
        for layer in range(0, len(weights), 2):
            if layer:
                hidden = self.activation(hidden)
            hidden = torch.baddbmm(weights[layer + 1], hidden, weights[layer])
        return hidden


def rows(weights: Sequence[Tensor], index: Tensor | None) -> list[Tensor]:
    """Return the weights of the agents `index` (k,); of all without."""
    return list(weights) if index is None else [w[index] for w in weights]


class Adam:
    """Adam (Kingma and Ba 2015) with a step count and a learning rate per agent."""

    BETA1, BETA2, EPSILON = 0.9, 0.999, 1e-8

    def __init__(self, weights: Sequence[Tensor]) -> None:
        self.weights = list(weights)
        self.first = [torch.zeros_like(w) for w in weights]  # m
        self.second = [torch.zeros_like(w) for w in weights]  # v
        self.steps = torch.zeros(len(weights[0]))  # (n,)

    def forget(self, index: Tensor) -> None:
        """Start anew for the agents `index` (k,)."""
        for moment in (*self.first, *self.second, self.steps):
            moment[index] = 0

    @torch.no_grad()
    def step(self, gradients: Sequence[Tensor], rate: Tensor) -> None:
        """Move the weights by one step; `rate` (n,), 0 leaves an agent as it is."""
        active = rate > 0
        self.steps += active
        if not bool(active.all()):
            gradients = [torch.where(active.view(-1, 1, 1), g, torch.zeros_like(g)) for g in gradients]
        t = self.steps.clamp(min=1)
        correction = (1 - self.BETA2**t).sqrt()
        size = (rate * correction / (1 - self.BETA1**t)).view(-1, 1, 1)
        floor = (self.EPSILON * correction).view(-1, 1, 1)
        for w, g, m, v in zip(self.weights, gradients, self.first, self.second, strict=True):
            m.lerp_(g, 1 - self.BETA1)
            v.mul_(self.BETA2).addcmul_(g, g, value=1 - self.BETA2)
            w.sub_(m * size / (v.sqrt() + floor))
