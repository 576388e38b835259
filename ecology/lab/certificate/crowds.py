"""The fate of a pool and of a brood with agents that learn: the runs behind two cases of the certificate.

A life is that of `ecology run commons --set n=N` or `ecology run colony --set weight=W`, with its seed.
"""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ecology import Ecology, State, scenarios
from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Part
from ecology.lab.certificate.report import markdown
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve

TICKS = 5_000
NUMBERS = (12, 14, 16, 18, 20, 24)  # of agents at the pool
SEEDS = {"commons": 3, "colony": 4}  # of those who learn
WEIGHTS = (0.0, 0.25, 0.5, 1.0, 2.0)  # of empathy
LOOKS = Callable[[Ecology, State], tuple[float, ...]]


def run_life(name: str, seed: int, ticks: int, look: LOOKS, **settings: Any) -> tuple[State, np.ndarray]:
    """Return the last state of a life, and what `look` saw in every tick, (ticks, k)."""
    run, seen = Run(resolve(name, changes=settings, ticks=ticks, seed=seed), Path(os.devnull)), answers.Watch(look)
    run.live_on(ticks, [seen])
    return run.env.state_view, np.array(seen.rows)


# ---- the pool ----------------------------------------------------------------------------------


def commons(n: int, seed: int, ticks: int = TICKS) -> dict[str, float | None]:
    """Return when the pool of n learners was empty (None: never), what is left, what each ate, and its drive."""
    state, rows = run_life("commons", seed, ticks, lambda _, now: (now.stock[0], now.own_drive.mean()), n=n)
    stock, drive = rows.T
    empty = int(np.flatnonzero(stock > 0)[-1]) + 2 if stock[-1] <= 0 else None
    return {
        "empty": empty,
        "stock": float(stock[-1]),
        "eaten": float(state.eaten[0] / n / (empty or ticks)),
        "drive": float(drive[ticks // 2 :].mean()),
    }


def most() -> float:
    """Return how many agents that take what a need takes a full pool sustains, growth E0 / decay."""
    words = scenarios.settings("commons")
    return words["growth"] * words["capacity"] / words["decay"]


def emptying_time(n: float) -> float:
    """Return when n agents with a fixed appetite of what a need takes have emptied the pool, infinity: never."""
    if n <= most():
        return math.inf
    return math.log(n / (n - most())) / math.log1p(scenarios.settings("commons")["growth"])


def commons_table(lives: Mapping[float, Sequence[Mapping[str, Any]]]) -> str:
    """Return the table of docs/results/commons.md from the lives of each n."""
    rows = []
    for n, of in lives.items():
        empty = [life["empty"] for life in of]
        means = [float(np.mean([life[word] for life in of])) for word in ("stock", "eaten", "drive")]
        rows.append((
            f"{n:g}", f"{empty.count(None)} of {len(of)}", ", ".join("-" if e is None else str(e) for e in empty),
            "-" if math.isinf(emptying_time(n)) else f"{emptying_time(n):.0f}",
            f"{means[0]:.0f}", f"{means[1]:.4f}", f"{means[2]:.2f}",
        ))  # fmt: skip
    head = ("n", "pools that survive", "emptied at tick", "closed form", "stock at the end", "eaten per agent and tick",
            "mean drive")  # fmt: skip
    return markdown(head, rows)


# ---- the colony --------------------------------------------------------------------------------


def colony(weight: float, seed: int, ticks: int = TICKS) -> dict[str, float | None]:
    """Return the shares alive at the end and, of the second half, own drives and how often nurses give.

    Means are over those alive, None without any.
    """
    _, rows = run_life("colony", seed, ticks, _colony_now, weight=weight)
    found: dict[str, float | None] = {"brood alive": float(rows[-1, 0]), "nurses alive": float(rows[-1, 1])}
    for word, column in zip(("brood", "nurses", "gives"), rows[ticks // 2 :, 2:].T, strict=True):
        known = column[np.isfinite(column)]
        found[word] = float(known.mean()) if known.size else None
    return found


def _colony_now(env: Ecology, state: State) -> tuple[float, ...]:
    """Return the shares of brood and nurses alive and, of those, own drives and nurses that give; NaN without any."""
    brood, nurse = env.groups["brood"].slots, env.groups["nurse"].slots
    young, old = state.alive[brood], state.alive[nurse]
    values = state.own_drive[brood][young], state.own_drive[nurse][old], state.gave[nurse][old] >= 0
    return young.mean(), old.mean(), *(each.mean() if each.size else math.nan for each in values)


def colony_table(lives: Mapping[float, Sequence[Mapping[str, Any]]]) -> str:
    """Return the table of docs/results/colony.md from the lives of each weight: means, with SDs over seeds."""
    rows = []
    for weight, of in lives.items():
        alive = [[life[word] for life in of] for word in ("brood alive", "nurses alive")]
        rows.append((
            f"{weight:g}", *(f"{np.mean(a):.0%} ({', '.join(f'{one:.0%}' for one in a)})" for a in alive),
            *(_spread([life[word] for life in of]) for word in ("brood", "nurses", "gives")),
        ))  # fmt: skip
    head = ("weight", "brood alive at the end", "nurses alive at the end", "own drive, brood", "own drive, nurses",
            "share of nurses that gives")  # fmt: skip
    return markdown(head, rows)


def _spread(values: Sequence[float | None]) -> str:
    """Return mean and standard deviation (n - 1) over the seeds that have a value."""
    known = [value for value in values if value is not None]
    return f"{np.mean(known):.2f} ({np.std(known, ddof=1):.2f})" if len(known) > 1 else "-"


# ---- as cases ----------------------------------------------------------------------------------


def parts_of(name: str, live: Callable[[Any, int], Any], values: Sequence[float], seconds: float) -> list[Part]:
    """Return a part for every life of `name`: live(value, seed)."""
    found = []
    for value in values:
        for seed in range(SEEDS[name]):
            words = answers.parameters(name, ticks=TICKS)
            found.append(Part(f"{value:g}-seed-{seed}", words, seconds, functools.partial(live, value, seed)))
    return found


def lives_of(done: Mapping[str, Any]) -> dict[float, list[Any]]:
    """Return the lives that are done by value, in the order of their seeds."""
    found: dict[float, list[Any]] = {}
    for key, life in done.items():
        found.setdefault(float(key.partition("-")[0]), []).append(life)
    return found
