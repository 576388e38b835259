"""What an update of `algorithm1` costs, for all agents at once: `python -m ecology.lab.bench.updates --device cpu`.

Each update is one of both networks of every agent, in the world of `paper`. Beside it stand the same on the plain
device, and the floor: a bare pass over the weights that move and their two moments.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from ecology import Ecology, EcologyError, agents, scenarios
from ecology.agents.hjb.devices import Device
from ecology.agents.hjb.devices.cpu import device as cpu
from ecology.agents.hjb.devices.cpu.adam import Row, adam
from ecology.agents.hjb.devices.cpu.compiler import compiled

AGENTS, WIDTHS = "1,10,100,1000", "32,64,128"
PLAINLY = 20  # agents on the plain device at most; the time of the others is in proportion
BYTES = 24  # per weight that moves: it and two moments, read and written
WINDOW = 0.2  # seconds of CPU time over which a cheap call is repeated
F = np.float32


@dataclass(frozen=True, kw_only=True)
class Cost:
    """Of all agents at once; times in milliseconds, medians over rounds."""

    width: int
    agents: int
    weights: int  # of an agent, both networks
    moved: int  # of them in an update
    update: float
    score: float
    floor: float
    plain: float  # an update and a score; NaN where the device is not the CPU

    def cells(self) -> list[str]:
        """Return a row of the table."""
        rate = self.agents / self.update * 1e3
        speed = self.agents * self.moved * BYTES / self.update / 1e6
        return [
            str(self.width), f"{self.weights:,}", f"{self.moved:,}", f"{self.agents:,}", f"{self.update:.3g}",
            f"{self.score:.3g}", f"{rate:,.0f}", f"{speed:.3g}", f"{self.floor:.3g}", f"{self.update / self.floor:.1f}",
            f"{self.plain:,.3g}", f"{self.plain / (self.update + self.score):,.0f}",
        ]  # fmt: skip


HEAD = ("width", "weights", "moved", "agents", "update, ms", "score, ms", "updates per second", "GB/s", "floor, ms",
        "times the floor", "plain, ms", "times faster")  # fmt: skip


def population(n: int, width: int, device: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """Return n agents with a transition each, where they are (n, D), and what is open to them (n, M)."""
    scenario = scenarios.load("paper")
    many = dataclasses.replace(scenario.species[0], count=n, position=None)
    group = Ecology(dataclasses.replace(scenario, species=(many,))).groups[many.name]
    learner: Any = agents.make("algorithm1", group, np.random.SeedSequence(0), {"width": width}, device)
    rng = np.random.default_rng(0)
    low, high = group.layout.low, group.layout.high
    zeta, after = (rng.uniform(low, high, (n, len(low))).astype(F) for _ in range(2))
    movement, open_ = rng.integers(0, learner.count, n), rng.random((n, learner.count)) < 0.5
    open_[np.arange(n), movement] = True
    learner.memory.add(np.arange(n), zeta, movement, after, np.full(n, group.dt), open_)
    return learner, zeta, open_


def time_calls(what: Callable[[], object], rounds: int, clock: Callable[[], float]) -> float:
    """Return the median over rounds of the milliseconds that a call takes, after two that are not counted."""
    what()
    begun = clock()
    what()
    times = max(1, int(WINDOW / max(clock() - begun, 1e-9) / rounds))
    found = []
    for _ in range(rounds):
        begun = clock()
        for _ in range(times):
            what()
        found.append((clock() - begun) / times * 1e3)
    return float(np.median(found))


def bare(n: int, moved: int, device: Device) -> Callable[[], object]:
    """Return a pass over n rows of `moved` weights and their moments, each read and written once."""
    if isinstance(device, cpu.Cpu):
        w, m, v = (np.ones((n, moved), F) for _ in range(3))
        gradient = np.ones(moved, F)
        steps = np.zeros(2, np.int64)
        return lambda: _adam_all(w, gradient, m, v, steps)
    w, m, v = (device.on(np.ones((n, moved), F)) for _ in range(3))

    def all_() -> float:
        for array in (w, m, v):
            array.mul_(1.0)
        return float(w[0, 0])  # when they are done

    return all_


@compiled
def _adam_all(w, g, m, v, steps):  # type: ignore[no-untyped-def]
    for i in range(len(w)):
        adam(Row(w[i], m[i], v[i], steps), g, 0, len(g), F(0), F(1))


def cost(n: int, width: int, device: str, rounds: int) -> Cost:
    """Return what n agents of a width cost."""
    learner, zeta, open_ = population(n, width, device)
    everyone = np.ones(n, bool)
    weights = learner.f.weights.shape[1] + learner.J.weights.shape[1]
    by_kernels = isinstance(learner.device, cpu.Cpu)
    heads = learner.count if by_kernels else 1  # the kernels read and write one head, torch all of them
    moved = weights - learner.f.last + learner.f.last // heads
    clock = time.process_time if by_kernels else time.perf_counter
    plain = np.nan
    if by_kernels:
        few = min(n, PLAINLY)
        alone, zetas, options = population(few, width, "plain")

        def one_by_one() -> None:
            alone._update(np.ones(few, bool))
            alone.scores(np.arange(few), zetas, options)

        plain = time_calls(one_by_one, min(rounds, 3), clock) * n / few
    return Cost(
        width=width,
        agents=n,
        weights=weights,
        moved=moved,
        update=time_calls(lambda: learner._update(everyone), rounds, clock),
        score=time_calls(lambda: learner.scores(np.arange(n), zeta, open_), rounds, clock),
        floor=time_calls(bare(n, moved, learner.device), rounds, clock),
        plain=plain,
    )


def one_or_more(word: str) -> int:
    """Return a whole number of at least 1."""
    if not word.strip().isdigit() or int(word) < 1:
        raise argparse.ArgumentTypeError(f"whole numbers are at least 1, got {word!r}")
    return int(word)


def several(words: str) -> list[int]:
    """Return whole numbers of at least 1, given with commas between them."""
    return [one_or_more(word) for word in words.split(",")]


def main(words: Sequence[str] | None = None) -> None:
    """Print a table in markdown, one row after the other as they are measured."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--agents", type=several, default=AGENTS, metavar="N,...")
    parser.add_argument("--widths", type=several, default=WIDTHS, metavar="H,...")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--rounds", type=one_or_more, default=9, metavar="N")
    options = parser.parse_args(words)
    cpu.WORKERS = 1
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    with threadpool_limits(1):
        for width in options.widths:
            for n in options.agents:
                try:
                    print(f"| {' | '.join(cost(n, width, options.device, options.rounds).cells())} |", flush=True)
                except EcologyError as error:
                    parser.error(str(error))


if __name__ == "__main__":
    main()
