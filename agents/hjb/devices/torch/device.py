"""Other devices: all agents in one batch of stacked weights, gradients by autograd.

What is large stays on the device; observations and masks go in, scores and losses come out, each in one transfer for
all agents.

Shapes: a agents, R states of each, D components of zeta, M movements, H hidden units, C place cells.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ecology.agents.hjb.devices.base import Device
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
from ecology.agents.hjb.devices.torch.first_order import pick, slopes
from ecology.agents.hjb.devices.torch.lookahead import look_ahead
from ecology.agents.hjb.devices.torch.networks import deviations, forecast, inputs_of
from ecology.agents.hjb.devices.torch.scores import scores
from ecology.agents.hjb.devices.torch.update import agent_of, own_constants, update

ROOM = 2**31  # bytes to work in; agents are taken in parts that fit


def available() -> list[str]:
    """Return the names of the devices of this machine, the CPU first."""
    cuda = ["cuda", *(f"cuda:{i}" for i in range(torch.cuda.device_count()))] if torch.cuda.is_available() else []
    return ["cpu", "plain", *cuda, *(["mps"] if torch.backends.mps.is_available() else [])]


class Torch(Device):
    """Tensors on the device `name`. Random numbers are the device's own, from a seed that the learner draws."""

    def __init__(self, encoding: Encoding, name: str) -> None:
        self.name = torch.device(name)
        self.generator = torch.Generator(self.name)
        self.s = on_device(encoding, self.name)

    def on(self, array: np.ndarray) -> Tensor:  # noqa: D102
        kind = torch.float32 if array.dtype == np.float64 else None  # mps has no float64
        return torch.tensor(array, dtype=kind, device=self.name)

    def off(self, array: Tensor) -> np.ndarray:  # noqa: D102
        return array.cpu().numpy()

    def zeros(self, shape: tuple[int, ...], kind: type) -> Tensor:  # noqa: D102
        return torch.zeros(shape, dtype=torch.from_numpy(np.empty(0, kind)).dtype, device=self.name)

    def uniform(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Tensor:  # noqa: D102
        self.generator.manual_seed(int(generator.integers(2**62)))
        return torch.rand(shape, generator=self.generator, device=self.name)

    def normal(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Tensor:  # noqa: D102
        self.generator.manual_seed(int(generator.integers(2**62)))
        return torch.randn(shape, generator=self.generator, device=self.name)

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
        if self.s.depth == 1 and not trace.where.shape[1]:
            return self._near_scores(weights, slots, zeta, open_)
        at, states, options, now = self.on(slots), self.on(zeta), self.on(open_), self.on(ages)
        count = self.on(replay.count)
        found = []
        for part in self._parts(len(slots), weights, max(self.s.beam, self.s.movements)):
            rows = at[part]
            noted = (self.on(array[slots[part]]) for array in trace)
            past = RecalledErrors._make((*noted, now[part], replay.zeta[rows], replay.open[rows], count[rows]))
            s = own_constants(self.s, weights, rows)
            found.append(look_ahead(s, self._agents(weights, rows), past, states[part], options[part]))
        return self.off(torch.cat(found))

    def _near_scores(self, weights: Weights, slots: np.ndarray, zeta: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the score (k, M) of one movement, nothing corrected."""
        at, states, options = self.on(slots), self.on(zeta)[:, None], self.on(open_)[:, None]
        parts = self._parts(len(slots), weights, 1)
        found = []
        for part in parts:
            s = own_constants(self.s, weights, at[part])
            found.append(scores(s, self._agents(weights, at[part]), states[part], options[part])[:, 0])
        return self.off(torch.cat(found))

    def _agents(self, weights: Weights, rows: Tensor) -> Agent:
        """Return the agents in `rows` (a,), with their slow copies of J."""
        own = Weights(*(array[rows] for array in weights))
        return agent_of(self.s, own, own.target, own.optimism)

    def _parts(self, count: int, weights: Weights, states: int) -> list[slice]:
        """Return slices of `count` agents, each of a size whose work on `states` states fits into the room."""
        s, inputs, cells = self.s, inputs_of(self.s, weights), weights.centres.shape[2]
        ahead = states * s.movements * (2 * inputs + 2 * cells + 4 * s.width + 6 * len(s.low))
        size = max(1, ROOM // (4 * (ahead + 3 * weights.f.shape[1] + 3 * weights.J.shape[1])))
        return [slice(start, min(start + size, count)) for start in range(0, count, size)]

    @torch.no_grad()
    def expect(self, weights: Weights, slots: np.ndarray, zeta: np.ndarray, movement: np.ndarray) -> np.ndarray:  # noqa: D102
        table = forecast(self.s, self._agents(weights, self.on(slots)), self.on(zeta)[:, None]) * self.s.unit
        raw = pick(table, self.on(movement)[:, None])[:, 0]
        raw[:, zeta.shape[1]].clamp_(self.s.dt, LONGEST)
        return self.off(raw)

    @torch.no_grad()
    def update(  # noqa: D102
        self, weights: Weights, replay: Replay, sampling: Sampling, training: Training, lookahead: Lookahead
    ) -> None:
        ready = training.ready
        learns, pace, count = self.on(ready), self.on(training.rate), self.on(replay.count)
        found = [
            update(
                self.s,
                Weights(*(array[part] for array in weights)),
                Replay(*(array[part] for array in replay._replace(count=count))),
                sampling._replace(uniform=sampling.uniform[part], normal=sampling.normal[part]),
                learns[part, None],
                pace[part, None],
            )
            for part in self._parts(len(ready), weights, max(sampling.batch, sampling.batch_f))
        ]
        losses = self.off(torch.cat(found, 1))
        training.loss_f[ready], training.loss_j[ready] = losses[0, ready], losses[1, ready]
        asked = np.flatnonzero(lookahead.open.any(1))
        if asked.size:
            lookahead.score[asked] = self._near_scores(weights, asked, lookahead.zeta[asked], lookahead.open[asked])

    def value(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return self.off(deviations(self.s, self._one(weights, slot), self.on(zeta)[None])[0])

    def slope(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return self.off(slopes(self.s, self._one(weights, slot), self.on(zeta)[None])[0])

    def forecast(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return self.off(forecast(self.s, self._one(weights, slot), self.on(zeta)[None])[0].flatten(1))

    def _one(self, weights: Weights, slot: int) -> Agent:
        """Return the agent in `slot` as a batch of one."""
        return self._agents(weights, self.on(np.array([slot])))
