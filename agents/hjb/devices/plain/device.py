"""The plain reference: one agent after another, torch's own gradients and Adam, loops where they are clearest.

Tests compare the other devices with it, and `ecology bench` compares their speed. It is slow: use it to check a change
or to step through an update with a debugger.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ecology.agents.hjb.devices.base import HostDevice
from ecology.agents.hjb.devices.plain.first_order import slopes
from ecology.agents.hjb.devices.plain.lookahead import look_ahead
from ecology.agents.hjb.devices.plain.networks import deviations, forecast
from ecology.agents.hjb.devices.plain.scores import scores
from ecology.agents.hjb.devices.plain.update import agent_of, own_constants, update
from ecology.agents.hjb.devices.records import (
    LONGEST,
    Agent,
    Encoding,
    Lookahead,
    RecalledErrors,
    Replay,
    Sampling,
    Trace,
    Training,
    Weights,
)
from ecology.agents.hjb.devices.torch.encoding import on_device


class Plain(HostDevice):
    """NumPy arrays, which tensors share for as long as something is computed."""

    def __init__(self, encoding: Encoding) -> None:
        self.s = on_device(encoding, torch.device("cpu"))

    @torch.no_grad()
    def scores(  # noqa: D102
        self,
        weights: Weights,
        replay: Replay,
        trace: Trace,
        ages: np.ndarray,
        slots: np.ndarray,
        zeta: np.ndarray,
        open_: np.ndarray,
    ) -> np.ndarray:
        out = np.empty(open_.shape, np.float32)
        for r, i in enumerate(slots.tolist()):
            if self.s.depth == 1 and not trace.where.shape[1]:
                out[r] = self._score(weights, i, zeta[r], open_[r])
                continue
            past = RecalledErrors._make(
                (*(array[i] for array in trace), ages[r], replay.zeta[i], replay.open[i], replay.count[i])
            )
            out[r] = look_ahead(
                own_constants(self.s, weights, i), self._agent(weights, i), past, torch.from_numpy(zeta[r]), open_[r]
            )
        return out

    def _score(self, weights: Weights, i: int, zeta: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the score (M,) of one movement of agent `i` at zeta (D,), nothing corrected."""
        at, options = torch.from_numpy(zeta)[None], torch.from_numpy(open_)[None]
        with torch.enable_grad():
            return scores(own_constants(self.s, weights, i), self._agent(weights, i), at, options)[0].numpy()

    def _agent(self, weights: Weights, i: int) -> Agent:
        """Return agent `i` with its slow copy of J."""
        return agent_of(self.s, weights, i, weights.target[i], weights.optimism[i])

    def expect(self, weights: Weights, slots: np.ndarray, zeta: np.ndarray, movement: np.ndarray) -> np.ndarray:  # noqa: D102
        found = [
            forecast(self.s, self._agent(weights, i), _row(zeta[r]))[0, movement[r]]
            for r, i in enumerate(slots.tolist())
        ]
        raw = torch.stack(found) * self.s.unit
        raw[:, zeta.shape[1]].clamp_(self.s.dt, LONGEST)
        return raw.numpy()

    def update(  # noqa: D102
        self, weights: Weights, replay: Replay, sampling: Sampling, training: Training, lookahead: Lookahead
    ) -> None:
        for i in np.flatnonzero(training.ready).tolist():
            losses = update(self.s, weights, replay, sampling, i, float(training.rate[i]))
            training.loss_f[i], training.loss_j[i] = losses
            if lookahead.open[i].any():
                lookahead.score[i] = self._score(weights, i, lookahead.zeta[i], lookahead.open[i])

    def value(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return deviations(self.s, self._agent(weights, slot), torch.from_numpy(zeta)).numpy()

    def slope(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return slopes(self.s, self._agent(weights, slot), torch.from_numpy(zeta)).detach().numpy()

    def forecast(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return forecast(self.s, self._agent(weights, slot), torch.from_numpy(zeta)).flatten(1).numpy()


def _row(zeta: np.ndarray) -> Tensor:
    """Return one state (D,) as a batch of one."""
    return torch.from_numpy(np.ascontiguousarray(zeta[None], np.float32))
