"""Where the f/J learner computes: on the CPU by compiled kernels, on another device by torch.

A device holds what is large (weights, optimisers, place cells, memories) and computes the scores and the update of all
agents at once. What is done with it is the same everywhere: see `agents.hjb`.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from ecology import EcologyError
from ecology.agents import kernels
from ecology.agents.kernels import Ahead, Brains, Draws, Ring, Senses, Trace

NAMES = r"cpu|mps|cuda(:\d+)?"
CROWD = 8  # agents from which on work is split over threads
BLAS = ThreadpoolController()
CPUS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
WORKERS = int(os.environ.get("NUMBA_NUM_THREADS", 0)) or CPUS
before_update: list[Callable[[], object]] = []  # called once, before the first update


class Device(ABC):
    """Holds the arrays of n agents, and computes with them; shapes as in `agents.kernels`."""

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
        brains: Brains,
        ring: Ring,
        trace: Trace,
        ages: np.ndarray,
        slots: np.ndarray,
        zeta: np.ndarray,
        open_: np.ndarray,
    ) -> np.ndarray:
        """Return the HJB score (k, M) of the open movements of `slots` (k,) at zeta (k, D), infinity elsewhere.

        `ages` (k,) are units of time. Errors of f are corrected, and futures looked into, as the settings say.
        """

    @abstractmethod
    def expected(self, brains: Brains, slots: np.ndarray, zeta: np.ndarray, movement: np.ndarray) -> np.ndarray:
        """Return what f predicts (k, D + 1) of the `movement` (k,) of each of `slots` (k,) at zeta (k, D)."""

    @abstractmethod
    def update(
        self,
        brains: Brains,
        ring: Ring,
        draws: Draws,
        ready: np.ndarray,
        rate: np.ndarray,
        loss_f: np.ndarray,
        loss_j: np.ndarray,
        ahead: Ahead,
    ) -> None:
        """Take one step on L_f and then one on L_J for every `ready` agent (n,), and fill in their losses (n,).

        Then fill in the scores of the movements `ahead` that are open to one of them.
        """

    @abstractmethod
    def value(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return Jn (m,) of one agent at zeta (m, D)."""

    @abstractmethod
    def slope(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return dJn/dzeta (m, D) of one agent at zeta (m, D)."""

    @abstractmethod
    def forecast(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return f's outputs (m, M (D + 1)) of one agent at zeta (m, D), in its units."""


class Cpu(Device):
    """Compiled kernels, the agents split over threads; what comes out does not depend on their number."""

    def __init__(self, senses: Senses, n: int) -> None:
        self.senses = senses
        self.alone = all(each["num_threads"] == 1 for each in BLAS.info() if each["user_api"] == "blas")
        self.threads = ThreadPoolExecutor(WORKERS) if WORKERS > 1 and n >= CROWD else None

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

    def expected(self, brains: Brains, slots: np.ndarray, zeta: np.ndarray, movement: np.ndarray) -> np.ndarray:  # noqa: D102
        return kernels.expected(self.senses, brains, slots, zeta, movement)

    def scores(  # noqa: D102
        self,
        brains: Brains,
        ring: Ring,
        trace: Trace,
        ages: np.ndarray,
        slots: np.ndarray,
        zeta: np.ndarray,
        open_: np.ndarray,
    ) -> np.ndarray:
        out = np.empty(open_.shape, np.float32)
        if self.senses.depth > 1 or trace.where.shape[1]:
            self._share(
                lambda a, b: kernels.decide_far(
                    self.senses, brains, ring, trace, slots[a:b], ages[a:b], zeta[a:b], open_[a:b], out[a:b]
                ),
                len(slots),
            )
            return out
        self._share(
            lambda a, b: kernels.decide(self.senses, brains, slots[a:b], zeta[a:b], open_[a:b], out[a:b]), len(slots)
        )
        return out

    def update(  # noqa: D102
        self,
        brains: Brains,
        ring: Ring,
        draws: Draws,
        ready: np.ndarray,
        rate: np.ndarray,
        loss_f: np.ndarray,
        loss_j: np.ndarray,
        ahead: Ahead,
    ) -> None:
        while before_update:
            before_update.pop()()
        self._share(
            lambda a, b: kernels.update(self.senses, brains, ring, draws, ready, rate, loss_f, loss_j, ahead, a, b),
            len(ready),
        )

    def value(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return kernels.value_at(self.senses, brains, slot, zeta)

    def slope(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return kernels.slope_at(self.senses, brains, slot, zeta)

    def forecast(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return kernels.forecast_at(self.senses, brains, slot, zeta)

    def _share(self, work: Callable[[int, int], None], count: int) -> None:
        """Do `work` on the rows from 0 to `count`, split over threads where there are many."""
        with contextlib.nullcontext() if self.alone else BLAS.limit(limits=1, user_api="blas"):
            if self.threads is None or count < CROWD:
                return work(0, count)
            edges = np.linspace(0, count, 4 * WORKERS + 1).astype(int)
            for done in [self.threads.submit(work, a, b) for a, b in itertools.pairwise(edges.tolist())]:
                done.result()


def check(name: str) -> None:
    """Raise EcologyError where `name` is no device, be it here or not."""
    if not re.fullmatch(NAMES, name):
        raise EcologyError(f"device is cpu, cuda, cuda:NUMBER or mps, got {name!r}.")


def make(name: str, senses: Senses, n: int) -> Device:
    """Return the device `name` for n agents; EcologyError where it is not here."""
    check(name)
    if name == "cpu":
        return Cpu(senses, n)
    from ecology.agents import torch_device  # slow to load

    there = torch_device.there()
    if name not in there:
        raise EcologyError(f"there is no device {name!r} here; there is {', '.join(there)}. Give one by --device.")
    return torch_device.Torch(name, senses)
