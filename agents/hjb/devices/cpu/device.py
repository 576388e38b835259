"""The CPU: compiled kernels, one agent after another, agents split over threads.

An agent's numbers depend on no other's, so any split of the agents over threads gives the same result. Gradients are
written out by hand; tests compare them with automatic ones. The chapters are those of the other devices, with the same
function names in the same order; what only the CPU has is in `llvm`, `arithmetic` and `compiler`, or belongs to
gradients.
"""

from __future__ import annotations

import contextlib
import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from threadpoolctl import ThreadpoolController

from ecology.agents.hjb.devices.base import HostDevice
from ecology.agents.hjb.devices.cpu.arithmetic import LONGEST, F, output, scratch_for
from ecology.agents.hjb.devices.cpu.compiler import compiled
from ecology.agents.hjb.devices.cpu.first_order import slopes
from ecology.agents.hjb.devices.cpu.llvm import ZEROED, borrow, control_word, keep_alive, set_control_word
from ecology.agents.hjb.devices.cpu.lookahead import beam_for, look_ahead
from ecology.agents.hjb.devices.cpu.networks import deviations, forecast, hidden_layer, inputs_of, layers
from ecology.agents.hjb.devices.cpu.scores import scores
from ecology.agents.hjb.devices.cpu.update import agent_of, own_constants, update
from ecology.agents.hjb.devices.records import (
    Encoding,
    Lookahead,
    RecalledErrors,
    Replay,
    Sampling,
    Trace,
    Training,
    Weights,
)
from ecology.machine import count_cpus

CROWD = 8  # agents from which on work is split over threads
BLAS = ThreadpoolController()
WORKERS = int(os.environ.get("NUMBA_NUM_THREADS", 0)) or count_cpus()
before_update: list[Callable[[], object]] = []  # called once, before the first update


class Cpu(HostDevice):
    """Compiled kernels; the results do not depend on the number of threads."""

    def __init__(self, encoding: Encoding, n: int) -> None:
        self.encoding = encoding
        self.alone = all(each["num_threads"] == 1 for each in BLAS.info() if each["user_api"] == "blas")
        self.threads = ThreadPoolExecutor(WORKERS) if WORKERS > 1 and n >= CROWD else None

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
        if self.encoding.depth > 1 or trace.where.shape[1]:
            memory = replay, trace

            def work(a: int, b: int) -> None:
                decide_far(self.encoding, weights, memory, slots[a:b], ages[a:b], zeta[a:b], open_[a:b], out[a:b])

        else:

            def work(a: int, b: int) -> None:
                decide(self.encoding, weights, slots[a:b], zeta[a:b], open_[a:b], out[a:b])

        self._share(work, len(slots))
        return out

    def expect(self, weights: Weights, slots: np.ndarray, zeta: np.ndarray, movement: np.ndarray) -> np.ndarray:  # noqa: D102
        return expect(self.encoding, weights, slots, zeta, movement)

    def update(  # noqa: D102
        self, weights: Weights, replay: Replay, sampling: Sampling, training: Training, lookahead: Lookahead
    ) -> None:
        while before_update:
            before_update.pop()()
        self._share(
            lambda a, b: update(self.encoding, weights, replay, sampling, training, lookahead, a, b),
            len(training.ready),
        )

    def value(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return value_at(self.encoding, weights, slot, zeta)

    def slope(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return slope_at(self.encoding, weights, slot, zeta)

    def forecast(self, weights: Weights, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return forecast_at(self.encoding, weights, slot, zeta)

    def _share(self, work: Callable[[int, int], None], count: int) -> None:
        """Do `work` on the rows from 0 to `count`, split over threads where there are many."""
        with contextlib.nullcontext() if self.alone else BLAS.limit(limits=1, user_api="blas"):
            if self.threads is None or count < CROWD:
                return work(0, count)
            edges = np.linspace(0, count, 4 * WORKERS + 1).astype(int)
            for done in [self.threads.submit(work, a, b) for a, b in itertools.pairwise(edges.tolist())]:
                done.result()


@compiled
def decide(s, weights, slots, zeta, open_, out):
    """Fill out (k, M) with the scores of the agents `slots` (k,) at zeta (k, D), infinity where not open."""
    parts = zeta.shape[1]
    inputs = inputs_of(s, weights)
    scratch = scratch_for(s, s.movements, parts, s.movements * s.outputs, inputs, np.int64(1))
    word = control_word()
    set_control_word(word | ZEROED)
    kept = scratch
    s, weights, scratch = borrow(s), borrow(weights), borrow(scratch)
    for r in range(len(slots)):
        i = slots[r]
        own = agent_of(weights, i, weights.target[i], weights.optimism[i])
        scores(own_constants(s, weights, i), own, zeta[r : r + 1], open_[r : r + 1], scratch, out[r : r + 1])
    set_control_word(word)
    keep_alive(kept)


@compiled
def decide_far(s, weights, memory, slots, ages, zeta, open_, out):
    """Fill out (k, M) with the scores of the agents `slots` (k,) at zeta (k, D), by looking ahead.

    `memory` is the `Replay` and the `Trace` of all agents, `ages` (k,) are units of time.
    """
    parts, size = zeta.shape[1], max(s.beam, s.movements)
    inputs = inputs_of(s, weights)
    scratch = scratch_for(s, size * s.movements, parts, s.movements * s.outputs, inputs, size)
    beam = beam_for(s, parts)
    word = control_word()
    set_control_word(word | ZEROED)
    kept = scratch, beam
    replay, trace = borrow(memory[0]), borrow(memory[1])
    s, weights, scratch, beam = borrow(s), borrow(weights), borrow(scratch), borrow(beam)
    for r in range(len(slots)):
        i = slots[r]
        own = agent_of(weights, i, weights.target[i], weights.optimism[i])
        past = RecalledErrors(
            trace.where[i],
            trace.movement[i],
            trace.error[i],
            trace.possible[i],
            trace.time[i],
            trace.count[i],
            ages[r],
            replay.zeta[i],
            replay.open[i],
            replay.count[i],
        )
        look_ahead(own_constants(s, weights, i), own, past, zeta[r], open_[r], scratch, beam, out[r])
    set_control_word(word)
    keep_alive(kept)


@compiled
def expect(s, weights, slots, zeta, movement):
    """Return what f predicts (k, E) of one movement each (k,) of the agents `slots` (k,) at zeta (k, D)."""
    parts = zeta.shape[1]
    inputs = inputs_of(s, weights)
    scratch = scratch_for(s, np.int64(1), parts, s.outputs, inputs, np.int64(1))
    out = np.empty((len(slots), s.outputs), F)
    for r in range(len(slots)):
        i = slots[r]
        own = agent_of(weights, i, weights.target[i], weights.optimism[i])
        second = hidden_layer(s, own, zeta[r : r + 1], scratch)
        _, _, _, _, w3, b3 = layers(own.f, inputs, s.width)
        o = movement[r] * s.outputs
        for v in range(s.outputs):
            out[r, v] = output(second[0], w3[o + v], b3[o + v]) * s.unit[v]
        out[r, parts] = min(max(out[r, parts], s.dt), LONGEST)
    keep_alive(scratch)
    return out


@compiled
def value_at(s, weights, slot, zeta):
    """Return Jn (m,) of one agent at zeta (m, D)."""
    own = agent_of(weights, slot, weights.target[slot], weights.optimism[slot])
    scratch = scratch_for(s, len(zeta), zeta.shape[1], np.int64(1), inputs_of(s, own), np.int64(1))
    deviations(s, own, zeta, scratch)
    return scratch.outputs[: len(zeta)].copy()


@compiled
def slope_at(s, weights, slot, zeta):
    """Return dJn/dzeta (m, D) of one agent at zeta (m, D)."""
    own = agent_of(weights, slot, weights.target[slot], weights.optimism[slot])
    scratch = scratch_for(s, len(zeta), zeta.shape[1], np.int64(1), inputs_of(s, own), len(zeta))
    slopes(s, own, zeta, scratch)
    return scratch.slope


@compiled
def forecast_at(s, weights, slot, zeta):
    """Return f's outputs (m, M E) of one agent at zeta (m, D), in its units."""
    own = agent_of(weights, slot, weights.target[slot], weights.optimism[slot])
    out = np.empty((len(zeta), s.movements * s.outputs), F)
    scratch = scratch_for(s, len(zeta), zeta.shape[1], np.int64(1), inputs_of(s, own), np.int64(1))
    forecast(s, own, zeta, scratch, out)
    keep_alive(scratch)
    return out
