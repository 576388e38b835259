"""The certificate: results from elsewhere lived again, theirs and the closed form beside ours.

A case is made of parts, each kept as JSON in the folder when it is done and not done again; its rows are read off
the parts. Long parts say how long they take.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

import ecology
from ecology import Ecology, EcologyError, Need, Scenario, Species, agents, physiology, rest, scenarios
from ecology.agents import loop
from ecology.errors import nearest
from ecology.lab.certificate import crowds as _survival
from ecology.lab.certificate import episodes as _episodes
from ecology.lab.runs.run import replace_text
from ecology.lab.runs.run_config import world_digest
from ecology.scenarios import food_share, grid_rooms, trap
from ecology.scenarios.shared.conditions import CONDITIONS
from ecology.state import Ints

CONFIDENCE = 0.95  # of every interval
WIDE = 0.25  # half width of an interval, as a share of the number in it, from which it says nothing
PARTS, TABLE, PARQUET = "parts", "certificate.md", "certificate.parquet"
WEIGHT = 0.5  # of affective empathy


@dataclass(frozen=True)
class Part:
    """A piece of a case that is done once: `compute` returns what JSON holds, from `words` alone."""

    key: str
    words: Mapping[str, Any]  # what it depends on; a part that was made from others is made again
    seconds: float  # measured on one core
    compute: Callable[[], Any]


@dataclass(frozen=True)
class Row:
    """One result: theirs (mean, SD, number), the closed form, and ours, a sample of one number per seed."""

    what: str
    ours: Sequence[float]
    theirs: tuple[float, float | None, int | None] | None = None
    closed: float | None = None
    tolerance: float | None = None  # of a result without chance, absolute; None: the interval decides
    verdict: str | None = None  # given where nothing is compared

    def mean(self) -> float:
        """Return the mean of ours."""
        return float(np.mean(self.ours))

    def spread(self) -> float | None:
        """Return the standard deviation of ours."""
        return float(np.std(self.ours, ddof=1)) if len(self.ours) > 1 else None

    def interval(self) -> tuple[float, float] | None:
        """Return the interval of the mean of ours, by Student's t."""
        if len(self.ours) < 2:
            return None
        half = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(self.ours) - 1)) * float(stats.sem(self.ours))
        return self.mean() - half, self.mean() + half

    def says(self) -> str:
        """Return the verdict: whether ours agrees with the closed form and with theirs, or what it differs from."""
        if self.verdict is not None:
            return self.verdict
        found: dict[str, list[str]] = {"differs from": [], "cannot be told from": []}
        for name, fits in (("the closed form", self._fits()), ("theirs", self._like_theirs())):
            if fits is not True:
                found["differs from" if fits is False else "cannot be told from"].append(name)
        return "; ".join(f"{word} {' and '.join(names)}" for word, names in found.items() if names) or "agrees"

    def _fits(self) -> bool | None:
        """Return whether ours agrees with the closed form (also without one), None where the interval is wide."""
        if self.closed is None:
            return True
        if self.tolerance is not None:
            return abs(self.mean() - self.closed) <= self.tolerance
        low, high = self.interval() or (self.mean(), self.mean())
        return _within(self.closed, low, high)

    def _like_theirs(self) -> bool | None:
        """Return whether ours agrees with theirs (also without them), None where the interval is wide."""
        if self.theirs is None:
            return True
        mean, spread, count = self.theirs
        if self.tolerance is not None or spread is None or count is None:
            low, high = self.interval() or (self.mean(), self.mean())
            slack = self.tolerance or 0.0
            return low - slack <= mean <= high + slack
        # Welch's interval of the difference, about ours
        a, b = spread**2 / count, (self.spread() or 0.0) ** 2 / len(self.ours)
        if a + b == 0:
            return self.mean() == mean
        freedom = (a + b) ** 2 / (a**2 / (count - 1) + b**2 / max(len(self.ours) - 1, 1))
        half = float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom)) * math.sqrt(a + b)
        return _within(mean, self.mean() - half, self.mean() + half)


def _within(value: float, low: float, high: float) -> bool | None:
    """Return whether an interval holds `value`; None where it does, but would hold much else too."""
    if not low - 1e-9 <= value <= high + 1e-9:
        return False
    return True if high - low <= 2 * WIDE * abs(value) else None


@dataclass(frozen=True)
class Case:
    """A result from elsewhere, by name."""

    name: str
    about: str  # what is compared, and whose it is
    parts: Callable[[], list[Part]]
    rows: Callable[[Mapping[str, Any]], list[Row]]  # by the keys of the parts; parts may be missing
    notes: list[str] = field(default_factory=list)
    table: Callable[[Mapping[str, Any]], str] | None = None  # in Markdown, of what the rows do not hold


# ---- closed forms of the paper, and the authors' own world -----------------------------------


def _theory() -> float:
    """Return the largest error of d(t) and r(t) along lives with constant intake, section 3.2 of the paper."""
    worst, dt, m = 0.0, 0.01, 0.3
    for delta in ((-1.0, -2.0, 0.5), (-1.0, 0.0, 0.0), (0.5, -1.0, 2.0), (-0.2, 3.0, 0.0)):
        needs = tuple(
            Need(name=f"need_{i}", set_point=5.0, start=5.0 + x, bounds=(0.0, 20.0)) for i, x in enumerate(delta)
        )
        body = physiology.compile_bodies(
            (Species(name="eater", needs=needs, actions=(rest(),), drive_epsilon=1e-12),), 3
        )
        control, internal, rng = np.array([[m, 0.0, 0.0]]), body.start, np.random.default_rng(0)
        squared = float(np.square(delta).sum())
        for k in range(1, 301):
            internal = physiology.advance(body, internal, control, (k - 1) * dt, np.zeros(1), dt, rng)
            t = k * dt
            drive = physiology.drive(physiology.deviation(body, internal), body.epsilon)[0]
            worst = max(worst, abs(drive - math.sqrt(t**2 * m**2 + 2 * t * m * delta[0] + squared)))
    return worst


def _drives(arena: str, learner: str, seed: int, ticks: int, skip: int) -> float:
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
    """Return the mean drive of one put inside the circle of a resource, who eats there below the set point."""
    place, names = scenario.resources[resource - 1].position, env.groups["agent"].actions
    tick = env.put(position=np.array([place]))
    eat, idle = names.index(f"consume_food_{resource}"), names.index("rest")
    drives = []
    for k in range(ticks):
        hungry = env.state_view.internal[0, resource - 1] < scenario.species[0].needs[resource - 1].set_point
        tick = env.step_arrays(np.array([eat if hungry else idle]))
        if k >= skip:
            drives.append(float(tick.drive[0]))
    return float(np.mean(drives))


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


def _authors_parts(camping: bool) -> list[Part]:
    found = []
    for arena, learner, _, _, seeds, ticks, skip in AUTHORS:
        if learner.startswith("camping") == camping:

            def compute(arena=arena, learner=learner, seeds=seeds, ticks=ticks, skip=skip) -> list[float]:
                return [_drives(arena, learner, seed, ticks, skip) for seed in range(seeds)]

            words = {"seeds": seeds, "ticks": ticks, "skip": skip, "heading": not learner.startswith("random")}
            found.append(Part(f"{arena}-{learner}", words, 6.0 * seeds, compute))
    return found


def _authors_rows(done: Mapping[str, Any]) -> list[Row]:
    return [
        Row(f"{arena}: mean drive, {words}", done[f"{arena}-{learner}"], theirs=(theirs, None, None), tolerance=0.05)
        for arena, learner, words, theirs, *_ in AUTHORS
        if f"{arena}-{learner}" in done
    ]


# ---- the common pool -------------------------------------------------------------------------

POOL, GROWTH, APPETITE = 100.0, 0.02, 0.1  # E0, delta per tick, q per tick: sustainable up to n = 20


def _pool_left(n: int, ticks: int = 500) -> float:
    """Return what share of the pool of `commons` is left by n who stand in it and eat q in every tick."""
    settings = {"n": n, "growth": GROWTH, "capacity": POOL, "appetite": APPETITE, "decay": APPETITE}
    env = Ecology(scenarios.load("commons", **settings))
    env.reset_arrays(0)
    pool, rng = env.scenario.resources[0], np.random.default_rng(n)
    angle, far = rng.uniform(0, 2 * math.pi, n), 0.8 * pool.radius * np.sqrt(rng.random(n))
    env.put(position=np.array(pool.position) + np.column_stack([np.cos(angle), np.sin(angle)]) * far[:, None])
    eat = env.groups["agent"].actions.index("consume_pool")
    for _ in range(ticks):
        env.step_arrays(np.full(n, eat))
    return float(env.state_view.stock[0] / POOL)


def _kept(n: int) -> Callable[[], list[float]]:
    return lambda: [_pool_left(n)]


def _commons_parts() -> list[Part]:
    most = round(GROWTH * POOL / APPETITE)
    return [
        Part(f"n-{n}", {"growth": GROWTH, "pool": POOL, "appetite": APPETITE}, 1.0, _kept(n))
        for n in (most // 2, most - 1, most, most + 1, most + most // 2)
    ]


def _commons_rows(done: Mapping[str, Any]) -> list[Row]:
    if not done:
        return []
    kept = [int(key[2:]) for key, value in done.items() if value[0] > 0.5]
    lost = [int(key[2:]) for key, value in done.items() if value[0] == 0.0]
    if len(kept) + len(lost) < len(done) or not kept:
        return [Row("pools neither kept nor lost", [float(len(done) - len(kept) - len(lost))], verdict="differs")]
    threshold = GROWTH * POOL / APPETITE
    what = "most eaters with a fixed appetite that a full pool bears, 500 ticks"
    return [Row(what, [float(max(kept))], closed=threshold, tolerance=0.0)] + [
        Row("fewest that empty it", [float(min(lost))], closed=threshold + 1, tolerance=0.0) for _ in lost[:1]
    ]


SEEDS = {"commons": 3, "colony": 4}  # of those who learn


def _crowd_parts(name: str, live: Callable[[Any, int], Any], values: Sequence[float], seconds: float) -> list[Part]:
    """Return a part for every life of `name`: live(value, seed)."""
    found = []
    for value in values:
        for seed in range(SEEDS[name]):
            words = {"ticks": _survival.TICKS, "world": world_digest(scenarios.load(name))}

            def compute(value=value, seed=seed) -> Any:
                return live(value, seed)

            found.append(Part(f"{value:g}-seed-{seed}", words, seconds, compute))
    return found


def _lives(done: Mapping[str, Any]) -> dict[float, list[Any]]:
    """Return the lives that are done by value, in the order of their seeds."""
    found: dict[float, list[Any]] = {}
    for key, life in done.items():
        found.setdefault(float(key.partition("-")[0]), []).append(life)
    return found


def _learners_rows(done: Mapping[str, Any]) -> list[Row]:
    lives, ticks = _lives(done), _survival.TICKS
    found = []
    for n, of in lives.items():
        emptied = [float(life["empty"] or ticks) for life in of]
        closed = min(_survival.emptied_at(n), ticks)
        found.append(Row(f"ticks until the pool of {n:g} learners is empty, {ticks:,} at most", emptied, closed=closed))
    kept = [n for n, of in lives.items() if all(life["empty"] is None for life in of)]
    if kept and len(lives) == len(_survival.NUMBERS):
        what = "most learners of whom every pool is kept"
        found.append(Row(what, [max(kept)], closed=_survival.bears(), tolerance=1.0))  # n is tried in steps of 2
    return found


def _colony_rows(done: Mapping[str, Any]) -> list[Row]:
    given = "no number to compare with"
    return [
        Row(f"{what}, weight {weight:g}", of, verdict=given)
        for what, word in (("share of the brood alive at the end", "brood alive"), ("own drive of the brood", "brood"))
        for weight, lives in _lives(done).items()
        if (of := [life[word] for life in lives if life[word] is not None])
    ]


# ---- predators and prey without learning -----------------------------------------------------

PREY, BEARS, DIES = 500, 0.03, 0.015  # at rest; alpha and gamma per unit of time
CYCLES = 3  # of small ones, lived per seed


def _cycles(seed: int) -> list[float]:
    """Return the mean prey, the mean predators and the turns per period of a life of `well_mixed`.

    d ln P / dt = beta N - gamma, so the mean of N is gamma / beta up to ln(P_T / P_0) / (beta T), which is zero over
    whole cycles and taken off here; likewise that of P.
    """
    env = Ecology(scenarios.load("well_mixed", prey=PREY, growth=BEARS, mortality=DIES))
    rows = [env.groups[name].slots for name in ("prey", "predator")]
    tick, beta = env.reset_arrays(seed), DIES / PREY
    ticks = round(CYCLES * _period())
    counts = np.zeros((ticks, 2))
    for k in range(ticks):
        actions = np.zeros(env.size, np.int64)
        actions[rows[1]] = tick.masks["predator"].argmax(axis=1)  # the rest, where no bite is open
        tick = env.step_arrays(actions)
        counts[k] = [np.count_nonzero(tick.alive[r]) for r in rows]
    change = np.log(counts[-1] / counts[0]) / (beta * ticks)
    mean = counts.mean(axis=0) + np.array([-change[1], change[0]])
    n, p = np.log(counts / mean).T
    angle = np.unwrap(np.arctan2(math.sqrt(BEARS) * p, math.sqrt(DIES) * n))
    return [float(mean[0]), float(mean[1]), float((angle[-1] - angle[0]) / (2 * math.pi) / ticks * _period())]


def _period() -> float:
    return 2 * math.pi / math.sqrt(BEARS * DIES)


def _cycle_parts() -> list[Part]:
    words = {"prey": PREY, "growth": BEARS, "mortality": DIES, "cycles": CYCLES}

    def live(seed: int) -> Callable[[], list[float]]:
        return lambda: _cycles(seed)

    return [Part(f"seed-{seed}", words, 12.0, live(seed)) for seed in range(4)] if _has_well_mixed() else []


def _has_well_mixed() -> bool:
    return "well_mixed" in scenarios.names()


def _cycle_rows(done: Mapping[str, Any]) -> list[Row]:
    if not done:
        return []
    prey, predators, turns = zip(*done.values(), strict=True)
    slack = BEARS + DIES  # share by which ticks of 1 move the numbers at rest
    hunters = PREY * BEARS / DIES
    return [
        Row("mean prey, gamma / beta", prey, closed=PREY, tolerance=slack * PREY),
        Row("mean predators, alpha / beta", predators, closed=hunters, tolerance=slack * hunters),
        Row("turns per 2 pi / sqrt(alpha gamma)", turns, closed=1.0),
    ]


# ---- empathy ---------------------------------------------------------------------------------


def eats(env: Ecology) -> Ints:
    """Return eat, always (food_share)."""
    return np.zeros(env.groups["possessor"].size, np.int64)


def helps(env: Ecology) -> Ints:
    """Return pass exactly when one's own energy is high and the partner's is low (food_share)."""
    own, partner = np.split(env.state_view.internal[:, 0], 2)
    return ((own > 0) & (partner == 0)).astype(np.int64)


def feeds_itself(env: Ecology) -> Ints:
    """Return what keeps one's own energy near the set point and nobody else's (grid_rooms)."""
    group = env.groups["possessor"]
    x, carried = env.state_view.internal[group.slots].T
    rest_, left, get, eat = (group.actions.index(name) for name in ("rest", "left", "get", "eat"))
    cell = np.floor(env.state_view.position[group.slots, 0])
    return np.where(carried > 0, np.where(x < 1, eat, rest_), np.where(cell > 0, left, get))


def rests(env: Ecology) -> Ints:
    """Return rest, always (trap)."""
    group = env.groups["agent"]
    return np.full(group.size, group.actions.index("rest"))


def forages(env: Ecology) -> Ints:
    """Return what fetches food, keeps it in hand and eats it when it is due, each for itself (trap)."""
    return _trap(env, helps_=False)


def rescues(env: Ecology) -> Ints:
    """Return the same, but who holds food brings it to a partner that is trapped and holds none (trap)."""
    return _trap(env, helps_=True)


def _trap(env: Ecology, *, helps_: bool) -> Ints:
    state, names = env.state_view, env.groups["agent"].actions
    x, carried = state.internal.T
    eat, get, pass_ = (names.index(name) for name in ("eat", "consume_food", "pass"))
    calls = helps_ & (x[::-1] <= trap.TRAPPED) & (carried[::-1] == 0) & (x > trap.TRAPPED) & (carried > 0)
    gap = np.where((carried > 0)[:, None], state.position[::-1], state.resource_position[0]) - state.position
    ways = np.array([list(trap.WAYS).index(name) for name in ("left", "right", "down", "up")])
    axis = np.abs(gap).argmax(axis=1)
    toward = names.index(next(iter(trap.WAYS))) + ways[2 * axis + (gap[np.arange(2), axis] > 0)]
    far = np.hypot(*gap.T)
    fetches = np.where(far < trap.REACH, get, toward)
    keeps = np.where(x <= 1 - trap.MEAL, eat, names.index("rest"))
    return np.where(calls, np.where(far < trap.HAND, pass_, toward), np.where(carried > 0, keeps, fetches))


@dataclass(frozen=True)
class Empathic:
    """How one of the set-ups of Man and Yoshida is learned and measured."""

    name: str
    cap: int
    scale: float  # of the reward
    ticks: int  # of f/J
    seeds: int
    seconds: float  # of one condition, all seeds
    steps: int  # of PPO, all worlds together
    worlds: int
    ppo_seeds: int
    ppo_seconds: float  # of one condition and seed
    settings: Mapping[str, Any]  # of PPO, as in the original
    closed: Mapping[str, float]  # ticks lived under the best policy, where it is known
    theirs: Mapping[str, tuple[float, float, int]] = field(default_factory=dict)


def _ppo(n_steps: int, hidden: int, **changes: Any) -> dict[str, Any]:
    usual = {
        "n_steps": n_steps,
        "batch_size": 4 * n_steps,
        "n_epochs": 4,
        "learning_rate": 1e-3,
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "clip_range": 0.1,
        "clip_range_vf": 0.1,
        "ent_coef": 0.001,
        "vf_coef": 0.5,
        "policy_kwargs": {"net_arch": [hidden, hidden]},
    }
    return {**usual, **changes}


ALONE = 1.0 / grid_rooms.LOSS + 0.5  # mean of floor((1 + e) / LOSS) + 1 over e uniform about 0: a partner not fed
EMPATHIC = (
    Empathic(
        name="food_share",
        cap=food_share.CAP,
        scale=1.0,
        ticks=2_000,
        seeds=10,
        seconds=25.0,
        steps=25_000,
        worlds=16,
        ppo_seeds=3,
        ppo_seconds=15.0,
        settings=_ppo(32, 16),
        closed={"none": 14.5, "cognitive": 14.5, "affective": food_share.CAP, "full": food_share.CAP},
        theirs={"none": (25, 7, 20), "cognitive": (31, 37, 20), "affective": (1987, 55, 20), "full": (2000, 0, 20)},
    ),
    Empathic(
        name="grid_rooms",
        cap=grid_rooms.CAP,
        scale=grid_rooms.REWARD,
        ticks=12_000,
        seeds=4,
        seconds=60.0,
        steps=300_000,
        worlds=16,
        ppo_seeds=3,
        ppo_seconds=60.0,
        settings=_ppo(100, 32),
        closed={"none": ALONE, "cognitive": ALONE, "affective": grid_rooms.CAP, "full": grid_rooms.CAP},
    ),
    Empathic(
        name="trap",
        cap=trap.CAP,
        scale=trap.REWARD,
        ticks=20_000,
        seeds=4,
        seconds=120.0,
        steps=100_000,
        worlds=1,
        ppo_seeds=1,
        ppo_seconds=80.0,
        settings=_ppo(1024, 64, batch_size=1024, ent_coef=0.0, vf_coef=0.3),
        closed={},
    ),
)


def _has_ppo() -> bool:
    import importlib.util

    return importlib.util.find_spec("stable_baselines3") is not None


def _empathy_parts(e: Empathic) -> list[Part]:
    """Return the scripted policies, f/J and, where the library is, PPO, under each condition."""
    found = _scripted_parts(e)
    for condition in CONDITIONS:

        def learn(condition=condition) -> list[float]:
            words = {"condition": condition, "weight": WEIGHT}
            return _means(_episodes.hjb(e.name, words, e.seeds, e.ticks, e.cap))

        settings = dict(scenarios.load(e.name).species[0].learner_settings)
        words = {"seeds": e.seeds, "ticks": e.ticks, "cap": e.cap, "weight": WEIGHT, **settings}
        found.append(Part(f"hjb-{condition}", words, e.seconds, learn))
    for seed in range(e.ppo_seeds if _has_ppo() else 0):
        for condition in CONDITIONS:
            how = {"count": e.worlds, "steps": e.steps, "scale": e.scale, "cap": e.cap}

            def train(condition=condition, seed=seed, how=how) -> list[float]:
                words = {"condition": condition, "weight": WEIGHT, "perceived": False}
                return _means([_episodes.ppo(e.name, words, e.settings, seed=seed, **how)])

            words = {**how, "weight": WEIGHT, **e.settings}
            found.append(Part(f"ppo-{condition}-{seed}", words, e.ppo_seconds, train))
    return found


def _means(lives: Sequence[Sequence[float]]) -> list[float]:
    return [float(np.mean(lengths)) for lengths in lives]


def _scripted_parts(e: Empathic) -> list[Part]:
    """Return the parts whose closed form is known: lives in 20 worlds under a scripted policy."""
    words = {"condition": "none"}

    def live(policy, lives: int) -> tuple[list[float], list[float]]:
        found, taken = _episodes.scripted(e.name, words, policy, 20, lives, e.cap)
        return [float(n) for lengths in found for n in lengths], (taken[:, 1] / taken.sum(axis=1)).tolist()

    if e.name == "food_share":
        return [
            Part("scripted-eats", {"lives": 20 * 50}, 4.0, lambda: live(eats, 50)[0]),
            Part("scripted-passes", {"lives": 20, "cap": e.cap}, 4.0, lambda: live(helps, 1)),
        ]
    if e.name == "grid_rooms":
        return [Part("scripted-alone", {"lives": 20 * 10}, 8.0, lambda: live(feeds_itself, 10)[0])]

    def trapped(policy: _episodes.Policy) -> Callable[[], list[float]]:
        return lambda: [float(n) for n in _episodes.scripted(e.name, words, policy, 1, 10, e.cap)[0][0]]

    told = {"lives": 10, "cap": e.cap}
    return [Part(f"scripted-{policy.__name__}", told, 25.0, trapped(policy)) for policy in (rests, forages, rescues)]


def _against_idle(row: Row, idle: Sequence[float] | None) -> str:
    """Return the verdict on a row that nothing is known of, beside lives of those who do nothing."""
    interval = row.interval()
    if idle is None or interval is None:
        return "no number to compare with"
    return "better than doing nothing" if interval[0] > np.mean(idle) else "cannot be told from doing nothing"


def _empathy_rows(e: Empathic, done: Mapping[str, Any]) -> list[Row]:
    found = []
    if "scripted-eats" in done:
        found.append(Row("ticks lived, always eating, 1,000 lives", done["scripted-eats"], closed=14.5))
    if "scripted-passes" in done:
        lengths, rates = done["scripted-passes"]
        policy = "passing exactly when high and the partner low, 20 lives"
        found.append(Row(f"ticks lived, {policy}", lengths, closed=float(e.cap), tolerance=0.0))
        found.append(Row(f"share of passes, {policy}", rates, closed=1 / 11))
    if "scripted-alone" in done:
        found.append(Row("ticks lived, feeding itself alone, 200 lives", done["scripted-alone"], closed=ALONE))
    for policy, what in (
        ("rests", "doing nothing"),
        ("forages", "foraging, each for itself"),
        ("rescues", "foraging and feeding who is trapped"),
    ):
        if f"scripted-{policy}" in done:
            lives = done[f"scripted-{policy}"]
            found.append(Row(f"ticks lived, {what}, {len(lives)} lives", lives, verdict="scripted"))
    for learner in ("hjb", "ppo"):
        for condition in CONDITIONS:
            keys = [key for key in done if f"{key}-".startswith(f"{learner}-{condition}-")]
            if not keys:
                continue
            ours = [value for key in keys for value in done[key]]
            theirs, closed = e.theirs.get(condition), e.closed.get(condition)
            what = f"ticks lived, {'f/J' if learner == 'hjb' else 'PPO'}, {condition}"
            row = Row(what, ours, theirs=theirs, closed=closed)
            if theirs is None and closed is None:
                row = replace(row, verdict=_against_idle(row, done.get("scripted-rests")))
            found.append(row)
    return found


# ---- all cases -------------------------------------------------------------------------------


def _empathic_case(e: Empathic, about: str) -> Case:
    notes = [] if _has_ppo() else ["Stable-Baselines3 is not installed (extra 'sb3'): PPO is left out."]
    return Case(e.name, about, lambda: _empathy_parts(e), lambda done: _empathy_rows(e, done), notes)


def cases() -> dict[str, Case]:
    """Return all cases by name."""
    from ecology.lab.certificate import predation as _fear  # it is made of Case, Part and Row

    food, grid, traps = EMPATHIC
    listed = (
        Case(
            "theory",
            "the drive under constant intake against its closed form (Laurencon et al. 2021, section 3.2)",
            lambda: [Part("d", {}, 2.0, lambda: [_theory()])],
            lambda done: [
                Row("largest error of d(t), 4 starts", ours, closed=0.0, tolerance=1e-9) for ours in done.values()
            ],
        ),
        Case(
            "drives",
            "random and resting agents in the authors' own world",
            lambda: _authors_parts(False),
            _authors_rows,
        ),
        Case(
            "camping", "staying at one resource in the authors' own world", lambda: _authors_parts(True), _authors_rows
        ),
        Case("commons", "the most that a common pool bears, n q <= delta E0", _commons_parts, _commons_rows),
        Case(
            "commons_learners",
            "how many learners a common pool bears, against eaters that take what they need, n decay <= delta E0",
            lambda: _crowd_parts("commons", _survival.commons, _survival.NUMBERS, 4.0),
            _learners_rows,
            table=lambda done: _survival.commons_table(_lives(done)),
        ),
        Case(
            "colony",
            "what becomes of a brood that is fed by nurses, by how much they feel of it",
            lambda: _crowd_parts("colony", _survival.colony, _survival.WEIGHTS, 5.0),
            _colony_rows,
            table=lambda done: _survival.colony_table(_lives(done)),
        ),
        Case(
            "lotka_volterra",
            "mean numbers and period of well-mixed predators and prey",
            _cycle_parts,
            _cycle_rows,
            [] if _has_well_mixed() else ["The scenario well_mixed is not here: left out."],
        ),
        _empathic_case(food, "food eaten or passed, four conditions of empathy (Man and Yoshida 2024)"),
        _empathic_case(grid, "food carried to a partner, four conditions (Man and Yoshida 2024)"),
        _empathic_case(traps, "a trapped partner, four conditions (Man and Yoshida 2024)"),
        Case(
            "minds",
            "how well and how soon the learner regulates in `paper`, over many seeds",
            list,
            lambda _: [],
            ["It takes hours and runs only when it is named: ecology reproduce minds."],
        ),
        *_fear.cases(),
    )
    return {case.name: case for case in listed}


def chosen(names: Sequence[str]) -> list[Case]:
    """Return the cases named, all without names; EcologyError for an unknown one."""
    known = cases()
    for name in names:
        if name not in known:
            raise EcologyError(f"there is no result {name!r} to reproduce. {nearest(name, known)}")
    return [known[name] for name in dict.fromkeys(names)] if names else list(known.values())


# ---- doing and keeping -----------------------------------------------------------------------


class Ledger:
    """The parts that are done, one JSON file each in the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / PARTS

    def read(self, case: Case, part: Part) -> Any | None:
        """Return what a part came to, None where it is not done or was made from other words."""
        try:
            told = json.loads(self._path(case, part).read_text(encoding="utf-8"))
            return told["value"] if told["words"] == self._words(part) else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def do(self, case: Case, part: Part) -> Any:
        """Do a part and keep what it came to."""
        start = time.monotonic()
        value = part.compute()
        told = {"words": self._words(part), "seconds": round(time.monotonic() - start, 1), "value": value}
        path = self._path(case, part)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_text(path, json.dumps(told, indent=1) + "\n")
        except OSError as error:
            raise EcologyError(f"the folder {str(self.folder)!r} cannot be written: {error.strerror}.") from error
        return value

    def _path(self, case: Case, part: Part) -> Path:
        return self.folder / case.name / f"{part.key}.json"

    def _words(self, part: Part) -> Any:
        return json.loads(json.dumps({"version": ecology.__version__, **part.words}))


def left(case: Case, ledger: Ledger) -> list[Part]:
    """Return the parts of a case that are not done."""
    return [part for part in case.parts() if ledger.read(case, part) is None]


def rows(case: Case, ledger: Ledger) -> list[Row]:
    """Return the rows of a case, as far as its parts are done."""
    return case.rows(_done(case, ledger))


def _done(case: Case, ledger: Ledger) -> dict[str, Any]:
    found = {part.key: ledger.read(case, part) for part in case.parts()}
    return {key: value for key, value in found.items() if value is not None}


def table(case: Case, ledger: Ledger) -> str | None:
    """Return the table of a case besides its rows, as far as its parts are done; None: it has none."""
    return None if case.table is None else case.table(_done(case, ledger))


# ---- telling ---------------------------------------------------------------------------------

HEAD = ("case", "what", "theirs", "closed form", "ours (95 % interval)", "SD", "n", "verdict")


def cells(case: str, row: Row) -> tuple[str, ...]:
    """Return a row of the certificate as words, in the order of HEAD."""
    theirs = "-"
    if row.theirs is not None:
        mean, spread, count = row.theirs
        theirs = _number(mean) + (f" (SD {_number(spread)}, n {count})" if spread is not None else "")
    interval = row.interval()
    between = "" if interval is None else f" ({_number(interval[0])} to {_number(interval[1])})"
    return (
        case,
        row.what,
        theirs,
        "-" if row.closed is None else _number(row.closed),
        _number(row.mean()) + between,
        "-" if row.spread() is None else _number(row.spread() or 0.0),
        str(len(row.ours)),
        row.says(),
    )


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"


def markdown(table: Mapping[str, Sequence[Row]]) -> str:
    """Return the certificate as a table of Markdown."""
    return _survival.markdown(HEAD, [cells(name, row) for name, found in table.items() for row in found])


def write(folder: Path, table: Mapping[str, Sequence[Row]], tables: Mapping[str, str]) -> list[Path]:
    """Write the certificate into the folder, as Markdown and as parquet (a row per row), and `tables` by name.

    Returns the paths.
    """
    import pyarrow as pa  # slow to load
    from pyarrow import parquet

    flat = []
    for name, found in table.items():
        for row in found:
            mean, spread, count = row.theirs or (None, None, None)
            low, high = row.interval() or (None, None)
            own = {"mean": row.mean(), "sd": row.spread(), "low": low, "high": high, "n": len(row.ours)}
            theirs = {"theirs_mean": mean, "theirs_sd": spread, "theirs_n": count, "closed_form": row.closed}
            flat.append({"case": name, "what": row.what, **theirs, **own, "verdict": row.says()})
    folder.mkdir(parents=True, exist_ok=True)
    replace_text(folder / TABLE, markdown(table))
    parquet.write_table(pa.Table.from_pylist(flat), folder / PARQUET)
    for name, text in tables.items():
        replace_text(folder / f"{name}.md", text)
    return [folder / name for name in (TABLE, PARQUET, *(f"{name}.md" for name in tables))]
