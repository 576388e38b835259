"""Runs with known answers: scripted agents in a shipped scenario, and learners beside them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ecology import Ecology, Scenario, Tick, agents, scenarios
from ecology.agents import loop
from ecology.agents.base import Learner
from ecology.lab.certificate.case import Row
from ecology.lab.runs.run_config import world_digest
from ecology.observers.base import Observer
from ecology.observers.plotting import Axes, Style, draw_means, style
from ecology.state import Floats, Ints

SEEDS = 8  # of every part that draws
LEARNED, PUBLISHED, SCRIPTED = style(0), style(1), Style("0.45", "s", ":")  # looks of series
OURS, THEIRS, CLOSED = LEARNED.colour, PUBLISHED.colour, "#222222"
INTERVAL = "bars: 95 % t interval of the mean over seeds, small dots: seeds"
Policy = Callable[[Ecology, Tick], Ints]  # actions (N,) of all slots
Look = Callable[[Ecology, Tick], Any]


def begin(name: str, seed: int, **settings: Any) -> tuple[Ecology, Tick]:
    """Return the world of a scenario, started from `seed`, and its first tick."""
    env = Ecology(scenarios.load(name, **settings))
    return env, env.reset_arrays(seed)


def play(env: Ecology, tick: Tick, ticks: int, policy: Policy, look: Look | None = None) -> list[Any]:
    """Run scripted agents for `ticks` ticks and return what `look` returned after each."""
    seen = []
    for _ in range(ticks):
        tick = env.step_arrays(policy(env, tick))
        if look is not None:
            seen.append(look(env, tick))
    return seen


def act(env: Ecology, **actions: str | np.ndarray) -> Ints:
    """Return the actions (N,) of species by name: one for all, or an array of indices (n,); others do the first."""
    found = np.zeros(env.size, np.int64)
    for species, action in actions.items():
        group = env.groups[species]
        found[group.slots] = group.actions.index(action) if isinstance(action, str) else action
    return found


class Watch(Observer):
    """An observer that keeps the result of `look` for the state after every tick."""

    def __init__(self, look: Callable[[Ecology, Any], Any]) -> None:
        self.look, self.rows = look, list[Any]()

    def begin(self, env: Ecology, minds: Mapping[str, Any]) -> None:
        """Keep the world."""
        self.env = env

    def watch(self, state: Any, tick: Tick, minds: Mapping[str, Any]) -> None:
        """Call `look` for one tick."""
        self.rows.append(self.look(self.env, state))


def learn(
    name: str,
    seed: int,
    ticks: int,
    look: Callable[[Ecology, Any], Any] | None = None,
    own: Mapping[str, Any] | None = None,
    **settings: Any,
) -> tuple[Ecology, dict[str, Learner], Tick, list[Any]]:
    """Train the learners of a scenario for `ticks`; `own` are settings of the learners beyond the scenario's.

    Returns the world, its learners, the last tick, and what `look` returned for the state after every tick.
    """
    scenario = scenarios.load(name, **settings)
    env, watch = Ecology(scenario), Watch(look or (lambda *_: None))
    minds = minds_of(env, scenario, seed, own or {})
    tick = loop.run(env, minds, env.reset_arrays(seed), ticks, (watch,) if look else ())
    return env, minds, tick, watch.rows


def minds_of(env: Ecology, scenario: Scenario, seed: int, own: Mapping[str, Any]) -> dict[str, Learner]:
    """Return the learners that a scenario names, with their settings and `own` where they have such."""
    found = {}
    for i, (group, species) in enumerate(zip(env.groups.values(), scenario.species, strict=True)):
        known = settings_of(species.learner, {**species.learner_settings, **own})
        found[group.name] = agents.make(species.learner, group, np.random.SeedSequence([seed, i]), known)
    return found


def settings_of(learner: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that a learner has."""
    own = agents.settings(learner)
    return {name: value for name, value in settings.items() if name in own}


def run_frozen(
    env: Ecology, minds: Mapping[str, Learner], tick: Tick, ticks: int, epsilon: float, look: Any
) -> list[Any]:
    """Return what `look` returns for `ticks` more ticks in which no agent learns and all explore with `epsilon`."""
    for mind in minds.values():
        mind.evaluating(epsilon)
    watch = Watch(look)
    loop.run(env, minds, tick, ticks, (watch,))
    return watch.rows


def parameters(name: str, **more: Any) -> dict[str, Any]:
    """Return what a part in a scenario depends on."""
    return {"world": world_digest(scenarios.load(name)), **more}


def fit_line(x: Any, y: Any) -> tuple[float, float]:
    """Return slope and intercept of the least squares line."""
    slope, intercept = np.polyfit(np.asarray(x, float), np.asarray(y, float), 1)
    return float(slope), float(intercept)


def column(done: Mapping[str, Any], prefix: str) -> list[Any]:
    """Return the values of the parts whose keys begin with `prefix`, in order."""
    return [value for key, value in done.items() if key.startswith(prefix)]


def complete_parts(done: Mapping[str, Any], kind: str, values: Sequence[float]) -> list[dict[float, Any]]:
    """Return the values of the parts `KIND-VALUE-SEED`, by VALUE, of every seed whose parts are all done."""
    found = []
    for seed in range(SEEDS):
        keys = {value: f"{kind}-{value:g}-{seed}" for value in values}
        if all(key in done for key in keys.values()):
            found.append({value: done[key] for value, key in keys.items()})
    return found


# ---- figures -----------------------------------------------------------------------------------


def band(ax: Axes, x: Iterable[float], samples: Sequence[Sequence[float]], label: str, look: Style = LEARNED) -> None:
    """Draw the mean of each sample with its 95 % interval of Student's t, and the seeds; say so below the figure."""
    rows, at = [Row("", sample) for sample in samples], list(x)
    mean, bounds = [row.mean() for row in rows], np.array([row.bounds() for row in rows]).T
    sizes = sorted({len(sample) for sample in samples})
    number = f"{sizes[0]} to {sizes[-1]}" if len(sizes) > 1 else f"{sizes[0]}"
    wide = max(at) - min(at) or 1.0
    side = 1 if look == LEARNED else -1  # of two series in a figure
    label = f"{label}, {number} seeds"
    draw_means(ax, at, mean, bounds, samples, look, wide=wide, side=side, linestyle="none", label=label)
    ax.figure.supxlabel(INTERVAL, fontsize=8)


def finish(ax: Axes, x: str, y: str, title: str = "") -> None:
    """Label the axes of a panel, and hide its top and right spines."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    if title:
        ax.set_title(title, fontsize=9)
    ax.spines[["top", "right"]].set_visible(False)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(frameon=False, fontsize=7.5)


def phi(z: float) -> float:
    """Return the normal distribution function."""
    return 0.5 * (1 + math.erf(z / math.sqrt(2)))


def binomial(n: int, p: float) -> Floats:
    """Return the probabilities of 0 to n successes, (n + 1,)."""
    return np.array([math.comb(n, k) * p**k * (1 - p) ** (n - k) for k in range(n + 1)])
