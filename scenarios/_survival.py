"""The tables of commons and colony in docs/results.md: `python -m scenarios._survival commons` (or colony).

Seeds are worlds of their own that are lived side by side, their learners in one batch, each with its own weights.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np

import agents
import scenarios
from agents.base import Transition
from ecology import Ecology, Scenario


def live(scenario: Scenario, seeds: int, ticks: int, watch: Callable[[list[Ecology], int], None]) -> list[Ecology]:
    """Return the worlds of seeds 0, 1, ... after `ticks`; `watch` is shown them after every tick."""
    envs = [Ecology(scenario) for _ in range(seeds)]
    crowd = Ecology(replace(scenario, species=tuple(replace(s, count=s.count * seeds) for s in scenario.species)))
    learners = {}
    for i, s in enumerate(scenario.species):
        settings = dict(s.learner_settings)
        if "life" in agents.settings(s.learner):
            settings["life"] = ticks * scenario.dt
        stream = np.random.SeedSequence(0, spawn_key=(1000, i))
        learners[s.name] = agents.make(s.learner, crowd.groups[s.name], stream, settings)
    now = [env.reset_arrays(seed) for seed, env in enumerate(envs)]
    for at in range(ticks):
        before, actions = now, [np.zeros(env.size, np.int64) for env in envs]
        for name, learner in learners.items():
            slots = envs[0].groups[name].slots
            chosen = learner.act(
                np.concatenate([t.observations[name] for t in before]), np.concatenate([t.masks[name] for t in before])
            )
            for mine, part in zip(actions, np.split(chosen, seeds), strict=True):
                mine[slots] = part
        now = [env.step_arrays(mine) for env, mine in zip(envs, actions, strict=True)]
        for name, learner in learners.items():
            slots = envs[0].groups[name].slots
            learner.learn(
                Transition(
                    observations=np.concatenate([t.observations[name] for t in before]),
                    masks=np.concatenate([t.masks[name] for t in before]),
                    actions=np.concatenate([t.action[slots] for t in now]),
                    next_observations=np.concatenate([t.observations[name] for t in now]),
                    next_masks=np.concatenate([t.masks[name] for t in now]),
                    alive=np.concatenate([t.alive[slots] for t in now]),
                )
            )
            died = np.flatnonzero(np.concatenate([t.died[slots] for t in now]))
            if died.size:
                learner.died(died)
        watch(envs, at)
    return envs


def commons(seeds: int, ticks: int, numbers: list[int]) -> None:
    """Print whether the pool survives n learners, and when it was empty."""
    words = scenarios.settings("commons")
    bears = words["growth"] * words["capacity"]
    print(
        f"a full pool bears growth E0 = {bears:g} per unit of time: {bears / words['decay']:.1f} agents that take what"
    )
    print(f"they need, {bears / words['appetite']:.1f} that eat all the time\n")
    print("| n | pools that survive | emptied at tick | stock at the end | eaten per agent and tick | mean drive |")
    print("|---|---|---|---|---|---|", flush=True)
    for n in numbers:
        empty = np.full(seeds, math.inf)
        drive: list[float] = []

        def watch(envs: list[Ecology], at: int, empty: np.ndarray = empty, drive: list[float] = drive) -> None:
            stock = np.array([env.state_view.stock[0] for env in envs])
            empty[:] = np.where(stock <= 0, np.minimum(empty, at + 1), np.inf)
            drive.append(float(np.mean([env.state_view.own_drive.mean() for env in envs])))

        envs = live(scenarios.load("commons", n=n, ticks=ticks), seeds, ticks, watch)
        stock = [env.state_view.stock[0] for env in envs]
        lived = np.minimum(empty, ticks)
        eaten = np.array([env.state_view.eaten[0] for env in envs]) / n / lived
        when = ", ".join("-" if math.isinf(t) else f"{t:.0f}" for t in empty)
        print(
            f"| {n} | {np.isinf(empty).sum()} of {seeds} | {when} | {np.mean(stock):.0f} | {eaten.mean():.4f} | "
            f"{np.mean(drive[ticks // 2 :]):.2f} |",
            flush=True,
        )


def colony(seeds: int, ticks: int, weights: list[float], **settings: object) -> None:
    """Print what becomes of brood and nurses for every weight; means over the second half, SD over seeds."""
    print(f"{settings or ''}\n| weight | brood alive at the end | own drive, brood | own drive, nurses | nurse gives |")
    print("|---|---|---|---|---|", flush=True)
    for weight in weights:
        kept: list[list[tuple[float, float, float]]] = []

        def watch(envs: list[Ecology], at: int, kept: list[list[tuple[float, float, float]]] = kept) -> None:
            if at >= ticks // 2:
                kept.append([_colony_now(env) for env in envs])

        envs = live(scenarios.load("colony", weight=weight, ticks=ticks, **settings), seeds, ticks, watch)
        alive = [env.state_view.alive[env.groups["brood"].slots].mean() for env in envs]
        young, nurse, gives = np.nanmean(np.array(kept), axis=0).T
        print(
            f"| {weight:g} | {np.mean(alive):.0%} ({', '.join(f'{a:.0%}' for a in alive)}) | {_spread(young)} | "
            f"{_spread(nurse)} | {gives.mean():.0%} |",
            flush=True,
        )


def _colony_now(env: Ecology) -> tuple[float, float, float]:
    """Return the own drive of the brood that lives and of the nurses, and the share of nurses that gives."""
    state, nurse, brood = env.state_view, env.groups["nurse"].slots, env.groups["brood"].slots
    alive = state.alive[brood]
    young = float(state.own_drive[brood][alive].mean()) if alive.any() else math.nan
    return young, float(state.own_drive[nurse].mean()), float((state.gave[nurse] >= 0).mean())


def _spread(values: np.ndarray) -> str:
    """Return mean and standard deviation over the seeds that have a value."""
    known = values[np.isfinite(values)]
    return f"{known.mean():.2f} ({known.std():.2f})" if known.size else "-"


def main(words: list[str] | None = None) -> None:
    """Print one of the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenario", choices=("commons", "colony"))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--ticks", type=int, default=6000)
    parser.add_argument("--values", type=float, nargs="+", help="numbers of agents, or weights")
    parser.add_argument("--set", nargs="*", default=[], help="of colony: KEY=WORD")
    told = parser.parse_args(words)
    if told.scenario == "commons":
        commons(told.seeds, told.ticks, [int(v) for v in told.values or (4, 8, 12, 16, 20, 24)])
    else:
        weights = told.values or [0.0, 0.25, 0.5, 1.0, 2.0]
        changes = {k: {"true": True, "false": False}.get(v, v) for k, v in (word.split("=") for word in told.set)}
        for key in ("lesion_at", "efficiency"):
            if key in changes:
                changes[key] = float(changes[key])
        colony(told.seeds, told.ticks, weights, **changes)


if __name__ == "__main__":
    main(sys.argv[1:])
