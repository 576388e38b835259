"""The authors' own world: mean drives of agents that do not learn."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Scenario, agents, scenarios
from ecology.agents import loop
from ecology.lab.certificate.case import Part, Row

AUTHORS: tuple[tuple[str, str, str, float, int, int, int], ...] = (
    # arena, learner, words, theirs, seeds, ticks, skipped
    ("EASY", "camping_2", "camping at food 2, 5,000 ticks", 1.04, 1, 5000, 0),
    ("MEDIUM", "camping_4", "camping at food 4, 5,000 ticks", 3.61, 1, 5000, 0),
    ("EASY", "rest", "doing nothing, ticks 2,001 to 4,000", 2.17, 1, 4000, 2000),
    ("MEDIUM", "rest", "doing nothing, ticks 2,001 to 4,000", 5.30, 1, 4000, 2000),
    ("EASY", "random", "random without heading, ticks 2,001 to 4,000", 2.78, 5, 4000, 2000),
    ("MEDIUM", "random", "random without heading, ticks 2,001 to 4,000", 5.34, 5, 4000, 2000),
    ("EASY", "random_actions", "random without heading, actions 2,001 to 4,000", 2.78, 5, 4000, 2000),
    ("MEDIUM", "random_actions", "random without heading, actions 2,001 to 4,000", 5.34, 5, 4000, 2000),
)


def mean_drive(arena: str, learner: str, seed: int, ticks: int, skip: int) -> float:
    """Return the mean drive over ticks `skip` to `ticks` of a life in the authors' own world.

    Of `random_actions` only the ticks count in which an action is over: a walk to food or a sleep is one.
    """
    name, _, counted = learner.partition("_")
    scenario = scenarios.load("paper_reference", arena=arena, heading=name != "random", start=(2.0, 2.0))
    env = Ecology(scenario)
    group = env.groups["agent"]
    tick = env.reset_arrays(seed)
    if name == "camping":
        return _camp(env, scenario, int(counted), ticks, skip)
    mind = agents.make(name, group, np.random.SeedSequence(seed), {})
    drives: list[float] = []
    while len(drives) < ticks:
        tick, state = loop.run(env, {"agent": mind}, tick, 1), env.state_view
        if not counted or (state.hold[0] <= 0 and state.bound_for[0] < 0):
            drives.append(float(tick.drive[0]))
    return float(np.mean(drives[skip:]))


def _camp(env: Ecology, scenario: Scenario, resource: int, ticks: int, skip: int) -> float:
    """Return the mean drive of an agent in a resource's circle that eats whenever it is below the set point."""
    place, names = scenario.resources[resource - 1].position, env.groups["agent"].actions
    tick = env.set_state(position=np.array([place]))
    eat, idle = names.index(f"consume_food_{resource}"), names.index("rest")
    drives = []
    for k in range(ticks):
        hungry = env.state_view.internal[0, resource - 1] < scenario.species[0].needs[resource - 1].set_point
        tick = env.step_arrays(np.array([eat if hungry else idle]))
        if k >= skip:
            drives.append(float(tick.drive[0]))
    return float(np.mean(drives))


def mean_drives(arena: str, learner: str, seeds: int, ticks: int, skip: int) -> list[float]:
    """Return the mean drive of every seed."""
    return [mean_drive(arena, learner, seed, ticks, skip) for seed in range(seeds)]


def parts(camping: bool) -> list[Part]:
    """Return a part for every agent of `AUTHORS`: those that camp, or the others."""
    found = []
    for arena, learner, _, _, seeds, ticks, skip in AUTHORS:
        if learner.startswith("camping") == camping:
            words = {"seeds": seeds, "ticks": ticks, "skip": skip, "heading": not learner.startswith("random")}
            found.append(
                Part(
                    f"{arena}-{learner}",
                    words,
                    6.0 * seeds,
                    functools.partial(mean_drives, arena, learner, seeds, ticks, skip),
                )
            )
    return found


def rows(done: Mapping[str, Any]) -> list[Row]:
    """Return a row for every agent that was measured."""
    return [
        Row(f"{arena}: mean drive, {words}", done[f"{arena}-{learner}"], theirs=(theirs, None, None), tolerance=0.05)
        for arena, learner, words, theirs, *_ in AUTHORS
        if f"{arena}-{learner}" in done
    ]
