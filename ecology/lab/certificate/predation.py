"""Measure fear in `predator_prey`: whether fleeing pays, whether learners flee, and whether newborns learn in time.

Scripted agents act on what their species senses, as learners do. They show what the world allows.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np

from ecology import Ecology, Group, State, Tick, agents, scenarios
from ecology.agents import loop
from ecology.agents.base import Learner
from ecology.lab.certificate import answers
from ecology.observers.base import Mind, Observer
from ecology.scenarios.predator_prey import HUNT_SIGHT

TURNS = 0.1  # probability per tick that a scripted agent turns while it sees nothing to go to
STARVES = -0.8  # deviation of energy below which scripted prey eat although a predator is near, units
WARY = 1.5  # distance within which scripted prey flee, length
LATER = 30  # ticks after a sighting at which the distance is measured
STEP = 0.25  # half of the difference of distance over which the slope of J is taken, length
EXPLORES = 0.05  # epsilon of frozen prey
ARRIVAL = 0.01  # newcomers of each species where newborns are measured, per unit of time
SEEDS = 8  # of the certificate


class Scripted(Learner):
    """Agents that act by a rule on what they sense."""

    def __init__(self, group: Group, seed: np.random.SeedSequence) -> None:
        super().__init__(group, seed)
        self.column = {name: i for i, name in enumerate(group.layout.names)}
        self.action = {name: i for i, name in enumerate(group.actions)}

    def _wander(self) -> np.ndarray:
        """Return walks (n,), with a turn now and then: walls are not sensed."""
        side = np.where(self.rng.random(self.size) < 0.5, self.action["turn_left"], self.action["turn_right"])
        return np.where(self.rng.random(self.size) < TURNS, side, self.action["walk"])

    def _head(self, bearing: np.ndarray) -> np.ndarray:
        """Return what leads toward `bearing` (n,), radians: a turn where it brings one nearer, else a walk."""
        side = np.where(bearing > 0, self.action["turn_left"], self.action["turn_right"])
        return np.where(np.abs(bearing) > math.pi / 4, side, self.action["walk"])


class Prey(Scripted):
    """Prey that eat and go to grass; those of `flees` (n,) turn away from a predator nearer than `wary` and walk."""

    def __init__(self, group: Group, seed: np.random.SeedSequence, flees: np.ndarray, wary: float = WARY) -> None:
        super().__init__(group, seed)
        self.flees, self.wary = flees, wary

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return actions (n,)."""
        zeta, at, do = observations.T, self.column, self.action
        hungry = zeta[at["energy"]] < 0.2
        chosen = np.where(hungry, self._wander(), do["rest"])
        chosen = np.where(hungry & masks[:, do["go_to_grass"]], do["go_to_grass"], chosen)
        chosen = np.where(masks[:, do["consume_grass"]], do["consume_grass"], chosen)
        away = (zeta[at["predator_1_bearing"]] + 2 * math.pi) % (2 * math.pi) - math.pi
        flees = self.flees & (zeta[at["predator_1_distance"]] < self.wary) & (zeta[at["energy"]] > STARVES)
        return np.where(flees, self._head(away), chosen)


class Predators(Scripted):
    """Predators that turn to the nearest prey in sight, walk to it and bite it; they rest while sated."""

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return actions (n,)."""
        zeta, at, do = observations.T, self.column, self.action
        seen = zeta[at["prey_1_distance"]] < self.group.layout.high[at["prey_1_distance"]]
        chosen = np.where(seen, self._head(zeta[at["prey_1_bearing"]]), self._wander())
        chosen = np.where(zeta[at["energy"]] >= 0.2, do["rest"], chosen)
        return np.where(masks[:, do["bite_prey"]], do["bite_prey"], chosen)


# ---- what is seen of a world -------------------------------------------------------------------


class Fates(Observer):
    """An observer that counts, for the slots of one species in `classes` (n,), the ticks lived and the deaths."""

    def __init__(self, env: Ecology, species: str, classes: np.ndarray) -> None:
        self.rows, self.classes, count = env.groups[species].slots, classes, int(classes.max()) + 1
        self.species, self.ticks, self.deaths, self.wounds = species, *np.zeros((3, count), np.int64)

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Count one tick."""
        count = len(self.ticks)
        self.ticks += np.bincount(self.classes[tick.alive[self.rows]], minlength=count)
        died = np.flatnonzero(tick.died[self.rows])
        if died.size:
            self.deaths += np.bincount(self.classes[died], minlength=count)
            bled = died[tick.observations[self.species][died, 1] <= -1.0] if self.species == "prey" else died[:0]
            self.wounds += np.bincount(self.classes[bled], minlength=count)


class Sightings(Observer):
    """An observer of prey: how far the nearest predator is `later` ticks after one came nearer than `near`.

    `near` is how far predators see. A prey that flees a farther one hovers at the edge of its own sight, which says
    little. `distance` lists it, length; a prey that died meanwhile counts as caught, distance 0.
    """

    def __init__(self, env: Ecology, later: int = LATER, near: float = HUNT_SIGHT) -> None:
        self.prey, self.hunters = env.groups["prey"].slots, env.groups["predator"].slots
        self.column, self.near = env.groups["prey"].layout.names.index("predator_1_distance"), near
        self.past: deque[tuple[np.ndarray, np.ndarray]] = deque(maxlen=later)  # who sighted (n,), serials (n,)
        self.saw = np.ones(self.prey.stop - self.prey.start, bool)  # at the start nobody has just sighted one
        self.distance: list[float] = []

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Look at one tick."""
        alive, serial = tick.alive[self.prey], state.serial[self.prey].copy()
        sees = alive & (tick.observations["prey"][:, self.column] < self.near)
        if len(self.past) == self.past.maxlen:
            sighted, known = self.past[0]
            hunters = state.position[self.hunters][tick.alive[self.hunters]]
            if sighted.any() and len(hunters):
                gap = state.position[self.prey][sighted][:, None] - hunters
                far = np.sqrt(np.square(gap).sum(-1).min(axis=1))
                self.distance += np.where((alive & (serial == known))[sighted], far, 0.0).tolist()
        self.past.append((sees & ~self.saw & ~tick.born[self.prey], serial))
        self.saw = sees | ~alive


# ---- the measures --------------------------------------------------------------------------------


def pays(seed: int, ticks: int = 10_000, **settings: Any) -> dict[str, float]:
    """Return life spans (ticks) and deaths by wound (per 1,000 ticks) of prey that flee and prey that do not.

    Both are scripted and live together, half of the slots each, with scripted predators.
    """
    env = Ecology(scenarios.load("predator_prey", **settings))
    prey, hunters = env.groups["prey"], env.groups["predator"]
    flees = np.arange(prey.size) % 2 == 1
    one, other = np.random.SeedSequence([seed, 0]).spawn(2)
    fates = Fates(env, "prey", flees.astype(np.int64))
    minds = {"prey": Prey(prey, one, flees), "predator": Predators(hunters, other)}
    loop.run(env, minds, env.reset_arrays(seed), ticks, (fates,))
    life, wounds = fates.ticks / np.maximum(fates.deaths, 1), 1_000 * fates.wounds / np.maximum(fates.ticks, 1)
    return {"life": life[0], "life fleeing": life[1], "wounds": wounds[0], "wounds fleeing": wounds[1]}


def train_both(
    seed: int, ticks: int, learner: str = "lean", **settings: Any
) -> tuple[Ecology, dict[str, Learner], Tick]:
    """Return a world of `predator_prey` in which both kinds have learned for `ticks` ticks, its minds and last tick."""
    env = Ecology(scenarios.load("predator_prey", **settings))
    words = env.scenario.species[0].learner_settings
    minds = {
        name: agents.make(learner, group, np.random.SeedSequence([seed, group.index]), words)
        for name, group in env.groups.items()
    }
    return env, minds, loop.run(env, minds, env.reset_arrays(seed), ticks)


def flight(env: Ecology, prey: Learner, tick: Tick, ticks: int = 2_000, seed: int = 0) -> dict[str, float] | None:
    """Return how far predators are after a sighting, under frozen `prey` and under random prey, length.

    Both start from the world as it is, which is put back afterwards, with scripted predators. None where either
    kind is extinct or sights nothing.
    """
    group, found = env.groups["prey"], {}
    one, other = np.random.SeedSequence([seed, 1]).spawn(2)
    prey.evaluating(EXPLORES)
    before = env.snapshot()
    for name, mind in (("learned", prey), ("random", agents.make("random", group, one, {}))):
        sightings = Sightings(env)
        minds = {"prey": mind, "predator": Predators(env.groups["predator"], other)}
        loop.run(env, minds, tick, ticks, (sightings,))
        tick = env.restore(*before)
        if not sightings.distance:
            return None
        found[name] = float(np.mean(sightings.distance))
    return {**found, "difference": found["learned"] - found["random"]}


def fear(env: Ecology, prey: Learner, tick: Tick, ticks: int = 200) -> float | None:
    """Return by how much -ln(gamma) J rises per unit of length toward the nearest predator, drive units per length.

    The mean over prey of states in which a predator is in sight, over `ticks` ticks; every tenth is looked at. None
    where there is no such state. Only the predator's distance is varied: its bearing stays as it is.
    """
    group = env.groups["prey"]
    column = group.layout.names.index("predator_1_distance")
    far, slopes = group.layout.high[column], list[float]()
    hunters = Predators(env.groups["predator"], np.random.SeedSequence(0))
    prey.evaluating(EXPLORES)
    for _ in range(ticks // 10):
        tick = loop.run(env, {"prey": prey, "predator": hunters}, tick, 10)
        zeta = tick.observations["prey"]
        for slot in np.flatnonzero(tick.alive[group.slots] & (zeta[:, column] < far - STEP) & (zeta[:, column] > STEP)):
            at = np.repeat(zeta[slot][None], 2, axis=0)
            at[:, column] += (-STEP, STEP)
            value = prey.deviation(int(slot), at)
            if value is not None:
                slopes.append(float(value[0] - value[1]) / (2 * STEP))
    return float(np.mean(slopes)) if slopes else None


def newborns(seed: int, predators: str, ticks: int = 10_000, prey: str = "lean", **settings: Any) -> float:
    """Return the life span, ticks, of predators of the learner `predators` that inherit nothing.

    Newcomers arrive at a constant rate, so that short lives do not end the count.
    """
    env = Ecology(scenarios.load("predator_prey", **{"inherit": False, "arrival": ARRIVAL, **settings}))
    words = env.scenario.species[0].learner_settings
    minds = {
        name: agents.make(
            learner, env.groups[name], np.random.SeedSequence([seed, k]), answers.settings_of(learner, words)
        )
        for k, (name, learner) in enumerate({"prey": prey, "predator": predators}.items())
    }
    fates = Fates(env, "predator", np.zeros(env.groups["predator"].size, np.int64))
    loop.run(env, minds, env.reset_arrays(seed), ticks, (fates,))
    return float(fates.ticks[0] / max(fates.deaths[0], 1))
