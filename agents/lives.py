"""Record the lives of learners that no longer learn, and measure their drive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage, stats

from ecology import Ecology, EcologyError, Group, Scenario, State, Tick
from ecology.agents import loop
from ecology.agents.base import Learner
from ecology.agents.baselines import Rest
from ecology.observers.base import Mind, Observer
from ecology.state import Bools, Floats, Ints

EPSILON = 0.05  # exploration while evaluated
BLOCK = 500  # ticks whose mean is one observation of the bootstrap
CONFIDENCE, RESAMPLES = 0.95, 2000
WINDOW = 2_000  # ticks of the running mean by which a life counts as regulated
WORST = 1_000  # ticks of the blocks of which the worst is reported
SINK, SINK_RADIUS = 500, 0.5  # ticks without a meal within this length of one place that count as stuck
SINKS = 20  # of a life that are reported, at most


@dataclass(frozen=True)
class Life:
    """T ticks in the life of the n slots of one species; row t is before tick t, the last after all."""

    zeta: Floats  # (T + 1, n, D)
    masks: Bools  # (T + 1, n, A)
    drive: Floats  # (T + 1, n) what is felt of others included
    own_drive: Floats  # (T, n) after every tick, without what is felt of others
    alive: Bools  # (T + 1, n)
    born: Bools  # (T + 1, n) whether a new tenant took the slot in the tick before
    position: Floats  # (T + 1, n, 2)
    actions: Ints  # (T, n) executed


class LifeRecorder(Observer):
    """An observer that records the lives of the species of `group`."""

    def __init__(self, group: Group, tick: Tick, position: Floats) -> None:
        """Start with `tick` and the `position` (N, 2) of all agents of the world in it."""
        self.group = group
        self.ticks = [tick]
        self.own_drive: list[Floats] = []
        self.positions = [position[group.slots].copy()]

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Keep a tick."""
        self.ticks.append(tick)
        self.own_drive.append(state.own_drive[self.group.slots].copy())
        self.positions.append(state.position[self.group.slots].copy())

    def actions(self) -> Ints:
        """Return the actions executed so far, (T, n)."""
        rows = [tick.action[self.group.slots] for tick in self.ticks[1:]]
        return np.array(rows, np.int64).reshape(len(rows), self.group.size)

    def life(self) -> Life:
        """Return the ticks recorded so far."""
        name, slots = self.group.name, self.group.slots
        return Life(
            zeta=np.array([tick.observations[name] for tick in self.ticks], float),
            masks=np.array([tick.masks[name] for tick in self.ticks]),
            drive=np.array([tick.drive[slots] for tick in self.ticks]),
            own_drive=np.array(self.own_drive).reshape(len(self.own_drive), self.group.size),
            alive=np.array([tick.alive[slots] for tick in self.ticks]),
            born=np.array([tick.born[slots] for tick in self.ticks]),
            position=np.array(self.positions),
            actions=self.actions(),
        )


def company(env: Ecology, learner: Learner) -> dict[str, Learner]:
    """Return a learner for each species: `learner` for its own; agents of all others rest."""
    found = {name: learner for name in env.groups if name == learner.group.name}
    if not found:
        raise EcologyError(
            f"the learner is of the species {learner.group.name!r}, which the scenario "
            f"{env.scenario.name!r} does not have; evaluate it in the world that it lived in."
        )
    others = [group for group in env.groups.values() if group.name != learner.group.name]
    return found | {group.name: Rest(group, np.random.SeedSequence(0)) for group in others}


def check_fits(learner: Learner, scenario: Scenario) -> None:
    """Raise EcologyError if `learner` has other senses or actions than its species has in `scenario`."""
    mine = learner.group
    theirs = Ecology(scenario).groups.get(mine.name)
    differ = (
        ["species"]
        if theirs is None
        else [
            what
            for what, here, expected in (
                ("slots", mine.slots, theirs.slots),
                ("actions", mine.actions, theirs.actions),
                ("senses", mine.layout.names, theirs.layout.names),
                ("length of a tick", mine.dt, theirs.dt),
            )
            if here != expected
        ]
    )
    if differ:
        raise EcologyError(
            f"the learner of the species {mine.name!r} does not fit the scenario {scenario.name!r}: it differs in "
            f"{' and '.join(differ)}; measure it in a world of the same body."
        )


def live(env: Ecology, learner: Learner, tick: Tick, ticks: int) -> Life:
    """Run `ticks` ticks from `tick` and return the life; movements under way are dropped first."""
    acting, recorder = company(env, learner), LifeRecorder(learner.group, tick, env.state_view.position)
    learner.begin()
    loop.run(env, acting, tick, ticks, [recorder])
    return recorder.life()


def mean_drive(scenario: Scenario, learner: Learner, ticks: int, seed: int, skip: int = 1000) -> Floats:
    """Return the drive (ticks - skip,) of a fresh start, averaged over the living of the learner's species.

    The learner does not learn and explores with epsilon 0.05.
    """
    return drive_series(fresh_life(scenario, learner, ticks, seed), skip)


def fresh_life(scenario: Scenario, learner: Learner, ticks: int, seed: int, epsilon: float = EPSILON) -> Life:
    """Return a life of `ticks` ticks from birth, without learning and with exploration `epsilon`."""
    learner.evaluating(epsilon)
    env = Ecology(scenario)
    return live(env, learner, env.reset_arrays(seed), ticks)


def drive_series(life: Life, skip: int, *, own: bool = False) -> Floats:
    """Return the drive from tick `skip` on, averaged over the living, up to the last death.

    `own` leaves out what is felt of others.
    """
    alive, drive = life.alive[skip + 1 :], (life.own_drive if own else life.drive[1:])[skip:]
    some = alive.any(axis=1)
    return (drive * alive).sum(axis=1)[some] / alive.sum(axis=1)[some]


def running_mean(series: Floats, window: int = WINDOW) -> Floats:
    """Return the means (T - window + 1,) of a series (T,) over the last `window` ticks, from the first whole one on."""
    total = np.concatenate([[0.0], np.cumsum(series)])
    return (total[window:] - total[:-window]) / window


def find_regulation(series: Floats, bound: float, *, span: int = 1, window: int = WINDOW) -> int | None:
    """Return the first tick from which the running mean over `window` ticks stays below `bound`, None without one.

    A row of `series` (T,) is the mean drive of `span` ticks, from birth on. The earliest answer is `window`.
    """
    window = max(1, window // span)
    if len(series) < window:
        return None
    above = np.flatnonzero(running_mean(series, window) >= bound)
    first = window + (int(above[-1]) + 1 if above.size else 0)
    return first * span if first <= len(series) else None


def worst_block(series: Floats, ticks: int = WORST, skip: int = 0) -> dict[str, float | int] | None:
    """Return the highest mean drive among consecutive blocks of `ticks`, and where it begins; None of no whole one.

    The first row of `series` is that of tick `skip`.
    """
    count = len(series) // ticks
    if not count:
        return None
    means = np.asarray(series)[: count * ticks].reshape(count, ticks).mean(axis=1)
    return {"mean": float(means.max()), "from": skip + int(means.argmax()) * ticks}


def stuck(life: Life, group: Group, bound: float, slot: int = 0) -> list[dict[str, Any]]:
    """Return the sinks in the life of the agent in `slot`: stretches of `SINK` ticks or more in which it starves.

    In a sink the drive exceeds `bound` throughout, the agent eats nothing, and it stays within `SINK_RADIUS` of one
    place or repeats one action. Where the world leaves no choice for more than half of the ticks, it is asleep.
    """
    count = len(life.actions) - SINK + 1
    if count < 1:
        return []
    feeds = np.isin(np.array(group.kinds), ("consume", "bite"))
    action, place, drive = life.actions[:, slot], life.position[1:, slot], life.drive[1:, slot]
    starves = (drive > bound) & life.alive[1:, slot] & ~life.born[1:, slot] & ~feeds[action]

    def span(series: np.ndarray) -> np.ndarray:  # largest minus smallest of every window of SINK ticks, by its start
        highest, lowest = (
            extreme(series, SINK, axis=0, origin=-(SINK // 2))[:count]
            for extreme in (ndimage.maximum_filter1d, ndimage.minimum_filter1d)
        )
        return highest - lowest

    stays = (span(place) <= 2 * SINK_RADIUS).all(axis=1) | (span(action) == 0)
    starved, chose = (
        running_mean(each.astype(float), SINK) for each in (starves, life.masks[:-1, slot].sum(axis=1) > 1)
    )
    begins = stays & (starved > 1 - 0.5 / SINK) & (chose >= 0.5)
    change = np.zeros(len(action) + 1, np.int64)
    np.add.at(change, np.flatnonzero(begins), 1)
    np.add.at(change, np.flatnonzero(begins) + SINK, -1)
    inside = np.concatenate([[False], change[:-1].cumsum() > 0, [False]])
    found = []
    for start, end in np.flatnonzero(inside[1:] != inside[:-1]).reshape(-1, 2).tolist():
        most = np.bincount(action[start:end], minlength=len(group.actions))
        found.append(
            {
                "slot": slot,
                "from": start,
                "to": end,
                "place": place[start:end].mean(axis=0).tolist(),
                "mean_drive": float(drive[start:end].mean()),
                "action": group.actions[int(most.argmax())],
                "share_of_action": float(most.max() / (end - start)),
            }
        )
    return found


def sinks(life: Life, group: Group, bound: float, most: int = SINKS) -> list[dict[str, Any]]:
    """Return the sinks (see `stuck`) of all agents in a life, the worst drive first, at most `most`."""
    found = [sink for slot in range(group.size) for sink in stuck(life, group, bound, slot)]
    return sorted(found, key=lambda sink: -sink["mean_drive"])[:most]


def interval(series: Floats, seed: int = 0) -> dict[str, float | int | None]:
    """Return the mean of a series of ticks with its bootstrap interval over blocks of 500, None of fewer than two."""
    if not len(series):
        return {"mean": None, "low": None, "high": None, "blocks": 0}
    blocks = np.array([block.mean() for block in np.array_split(series, max(1, round(len(series) / BLOCK)))])
    mean = low = high = float(np.mean(series))
    if len(blocks) < 2:
        return {"mean": mean, "low": None, "high": None, "blocks": len(blocks)}
    if np.ptp(blocks) > 1e-12:
        found = stats.bootstrap(
            (blocks,),
            np.mean,
            n_resamples=RESAMPLES,
            confidence_level=CONFIDENCE,
            method="percentile",
            random_state=np.random.default_rng(seed),
        ).confidence_interval
        low, high = min(float(found.low), mean), max(float(found.high), mean)
    return {"mean": mean, "low": low, "high": high, "blocks": len(blocks)}
