"""What a learner has learned: its life, its maps, its choices and its knowledge against the simulator.

All measures are taken without learning, with a little exploration, on the true world. `evaluate` puts
them together; `ABOUT` says what each key of its report means.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from ecology import Ecology, EcologyError, Group, Scenario, Tick
from ecology.actions import ActionTable, compile_actions
from ecology.agents import loop
from ecology.agents.base import Learner
from ecology.agents.baselines import Greedy, QValue, Random, Rest
from ecology.agents.lives import (
    EPSILON,
    WINDOW,
    Life,
    LifeRecorder,
    check_fits,
    company,
    drive_series,
    find_regulation,
    fresh_life,
    interval,
    live,
    sinks,
    worst_block,
)
from ecology.agents.planner import Camping, Exploring, Paths, Planner, service_of
from ecology.ground import scatter, wrap
from ecology.observers.maps import Grid, cover, deviation_maps, mapped_needs
from ecology.physiology import set_points
from ecology.state import Bools, Floats, Ints

BASELINES = ("planner", "camping", "greedy", "qvalue", "random", "rest")
LEARN = {"greedy": Greedy, "qvalue": QValue}  # those that have lived as long as they are measured
REGULATED = 0.5  # share of the drive of camping (or of resting, where nobody can camp) below which it does
NEAR = 1.0  # length within which a map's minimum counts as at the resource
PROBES, PROBE_TICKS = 60, 600  # places per need, and ticks within which something must be eaten
PATIENCE = 20  # ticks between two looks at what a probe has eaten
STATES, STARTS = 200, 20  # states of the deviation check, and random starts of its second half
FORGOTTEN = 0.01  # share of the discounted future that a truncation leaves out
DEPRIVED, SATED = -1.0, 0.4  # needs at a random start lie between these times x*
PER_MOVEMENT = 20  # states in which each movement's f is checked
LONGEST = 2000  # ticks of a movement

ABOUT: Mapping[str, str] = {
    "mean_drive": "mean of the drive over ticks `skip` to `ticks` of a life from birth, no learning, for the "
    "learner (epsilon 0.05) and for each baseline in the same world, `learned_epsilon_0` without exploration and "
    "`planner_exploring` with that of the learner; `low` and `high` bound the 95 % "
    "interval of a bootstrap over blocks of 500 ticks, `blocks` how many there were; of fewer than 2 there is none",
    "mean_own_drive": "the same without what is felt of others; without empathy it equals `mean_drive`",
    "regulated": "the drive below which a life counts as regulated, `below`: half of the mean drive of camping, or of "
    "resting where nobody can camp (`of`)",
    "as_lived": "the run itself, learning and its own exploration included: mean drive of its last tenth, and "
    "`regulated_from`, the first tick from which the running mean of the drive over `window` ticks stays below "
    "`regulated.below`, null where it never does; null without a run",
    "worst_block": "the highest mean drive among consecutive blocks of 1,000 ticks of the lives above, for `learned` "
    "and `learned_epsilon_0`, and the tick at which it begins; null of less than one block",
    "stuck": "sinks in the same two lives: stretches of 500 ticks or more in which the drive of an agent exceeds "
    "`regulated.below` throughout, it eats nothing, and it stays within 0.5 lengths of one place or repeats one "
    "action; ticks, place, mean drive, most frequent action and its share, worst drive first, at most 20 of each life",
    "closed_gap": "(camping - learned) / (camping - planner) of the mean drives: 0 is no better than "
    "camping, 1 as good as the planner",
    "action_shares": "share of the ticks of the learner's life above that each action took",
    "deviation_maps": "-ln(gamma) J in drive units over the arena, need i at -x_i*, all else 0 (the "
    "paper's results figure): where its minimum lies, how far from the resource that serves the need, and "
    "the rank correlation (Spearman) of J with the walking distance to that resource; 1 is best",
    "probe": "put at random places with one need at its floor and all else as at birth: the share of "
    "trials in which the resource that serves the need is eaten first, and how often each was",
    "deviation_check": "J against the discounted drive -ln(gamma) int gamma^(s-t) d(s) ds measured along "
    "the same policy: `life` from states of the life above, `random_starts` from states met after random "
    "starts; bias is the mean of J minus measured, all in drive units",
    "transition_check": "f against the true change, per movement: the share of the squared change "
    "explained (1 is perfect, 0 no better than predicting no change) and the error of the predicted "
    "duration in units of time",
}


# ---- deviation maps ----------------------------------------------------------------------


@dataclass(frozen=True)
class Maps:
    """Deviation maps of k needs over a grid of places where a body fits, NaN elsewhere."""

    grid: Grid
    needs: tuple[int, ...]  # k
    resources: tuple[int, ...]  # k the resource that serves the need, -1 without one that stays in place
    value: Floats  # (k, rows, columns) drive units
    walk: Floats  # (k, rows, columns) walking distance to the resource's circle

    def minimum(self, i: int) -> tuple[float, float]:
        """Return where map `i` has its minimum."""
        row, column = np.unravel_index(np.nanargmin(self.value[i]), self.value[i].shape)
        return float(self.grid.x[column]), float(self.grid.y[row])


def serving(scenario: Scenario, table: ActionTable) -> dict[int, int]:
    """Return the resource that serves each need, by index: the one whose consumption raises it most."""
    found: dict[int, tuple[float, int]] = {}
    for resource in range(len(scenario.resources)):
        need, act = service_of(table, resource)
        if need >= 0 and table.control[act, need] > found.get(need, (0.0, -1))[0]:
            found[need] = (float(table.control[act, need]), resource)
    return {need: resource for need, (_, resource) in found.items()}


def maps_of(scenario: Scenario, learner: Learner, slot: int = 0) -> Maps | None:
    """Return the deviation maps of the agent in `slot` of its species; None without a J or sense of place."""
    group = learner.group
    species = scenario.species[group.index]
    paths = Paths(scenario.arena, species.radius)
    grid = cover(scenario.arena)
    places = np.stack(np.meshgrid(grid.x, grid.y), axis=-1)  # (rows, columns, 2)
    grid = replace(grid, inside=grid.inside & paths.fits(places))
    value = deviation_maps(species, group, learner, slot, grid)
    if value is None:
        return None
    serves = serving(scenario, compile_actions(species, scenario.resources, scenario.species))
    needs = mapped_needs(species)
    walk = np.full(value.shape, np.nan)
    resources = [serves.get(need, -1) for need in needs]
    for i, served_by in enumerate(resources):
        if served_by < 0:
            continue
        resource = scenario.resources[served_by]
        if resource.position is None or resource.motion is not None:  # no place to measure a map against
            resources[i] = -1
            continue
        distance = paths.distance(places[grid.inside], resource.position)
        walk[i][grid.inside] = np.maximum(distance - resource.radius, 0.0)
    return Maps(grid=grid, needs=tuple(needs), resources=tuple(resources), value=value, walk=walk)


def correlation(rank: bool, a: Floats, b: Floats) -> float | None:
    """Return Spearman's (by `rank`) or Pearson's correlation; None where one of them does not vary."""
    if len(a) < 3 or np.ptp(a) < 1e-12 or np.ptp(b) < 1e-12:
        return None
    return float((stats.spearmanr if rank else stats.pearsonr)(a, b).statistic)


def maps_report(maps: Maps, scenario: Scenario, group: Group) -> dict[str, Any]:
    """Return, per need, where the minimum lies and how the map follows the walking distance."""
    species = scenario.species[group.index]
    report: dict[str, Any] = {}
    for i, (need, served_by) in enumerate(zip(maps.needs, maps.resources, strict=True)):
        if served_by < 0:
            continue
        resource, inside = scenario.resources[served_by], maps.grid.inside
        at = maps.minimum(i)
        assert resource.position is not None  # `maps_of` leaves out those without a place
        distance = math.dist(at, resource.position)
        reached = np.isfinite(maps.walk[i][inside])
        report[species.needs[need].name] = {
            "resource": resource.name,
            "minimum": list(at),
            "distance_of_minimum": distance,
            "minimum_within_1": distance <= NEAR,
            "spearman_with_walking_distance": correlation(
                True, maps.value[i][inside][reached], maps.walk[i][inside][reached]
            ),
            "lowest": float(np.nanmin(maps.value[i])),
            "highest": float(np.nanmax(maps.value[i])),
        }
    return report


# ---- the probe ---------------------------------------------------------------------------


def place_group(env: Ecology, group: Group, position: Floats, heading: Floats, internal: Floats) -> Tick:
    """Put the n agents of `group` at `position` (n, 2), `heading` (n,), x `internal` (n, V), at leisure."""
    now = env.state_view
    fields = {"position": position, "heading": heading, "internal": internal}
    fields |= {"hold": np.zeros(group.size), "bound_for": np.full(group.size, -1)}
    fields |= {"action": np.full(group.size, group.kinds.index("rest"))}
    whole = {}
    for name, value in fields.items():
        whole[name] = getattr(now, name).copy()
        if name == "internal":
            whole[name][group.slots, : value.shape[1]] = value
        else:
            whole[name][group.slots] = value
    return env.set_state(**whole)


def probe(
    scenario: Scenario, learner: Learner, seed: int, places: int = PROBES, limit: int = PROBE_TICKS
) -> dict[str, Any]:
    """Return, per need, what is eaten first from `places` random places with that need at its floor.

    All else is as at birth. A trial ends with the first meal or after `limit` ticks.
    """
    learner.evaluating(EPSILON)
    env, group = Ecology(scenario), learner.group
    species, n = scenario.species[group.index], group.size
    table = compile_actions(species, scenario.resources, scenario.species)
    serves = serving(scenario, table)
    rng = np.random.default_rng(seed)
    names = [resource.name for resource in scenario.resources]
    report: dict[str, Any] = {}
    for need in mapped_needs(species):
        if need not in serves:
            continue
        eaten: list[int] = []
        waited: list[int] = []
        for _ in range(math.ceil(places / n)):
            env.reset_arrays(seed)
            internal = np.tile([each.x0 for each in species.needs], (n, 1))
            internal[:, need] = species.needs[need].low
            heading = rng.uniform(-np.pi, np.pi, n)
            tick = place_group(env, group, scatter(scenario.arena, species.radius, n, rng), heading, internal)
            first, after = first_meals(env, learner, tick, table, limit)
            eaten += first.tolist()
            waited += after[first == serves[need]].tolist()
        counts = {name: eaten.count(r) for r, name in enumerate(names)} | {"nothing": eaten.count(-1)}
        report[species.needs[need].name] = {
            "resource": names[serves[need]],
            "trials": len(eaten),
            "share_right": eaten.count(serves[need]) / len(eaten),
            "first_eaten": counts,
            "median_ticks_when_right": float(np.median(waited)) if waited else None,
        }
    return report


def first_meals(env: Ecology, learner: Learner, tick: Tick, table: ActionTable, limit: int) -> tuple[Ints, Ints]:
    """Return the resource that each agent eats first, -1 without, and after how many ticks, both (n,)."""
    recorder = LifeRecorder(learner.group, tick, env.state_view.position)
    learner.begin()
    acting = company(env, learner)
    while True:
        meals = table.consumes[recorder.actions()]  # (t, n)
        fed: Bools = np.any(meals >= 0, axis=0)
        if fed.all() or len(meals) >= limit:
            break
        tick = loop.advance(env, acting, tick, min(PATIENCE, limit - len(meals)), [recorder])
    when = (meals >= 0).argmax(axis=0)
    return np.where(fed, meals[when, np.arange(len(fed))], -1), when


# ---- is J what it is said to be? ---------------------------------------------------------


@dataclass(frozen=True)
class DeviationCheck:
    """J and what it stands for, in drive units, at the same states (m,)."""

    learned: Floats
    measured: Floats

    def report(self) -> dict[str, Any]:
        """Return how well they agree."""
        error = self.learned - self.measured
        return {
            "states": len(error),
            "correlation": correlation(False, self.learned, self.measured),
            "bias": float(error.mean()) if len(error) else None,
            "root_mean_square_error": float(np.sqrt((error**2).mean())) if len(error) else None,
            "mean_measured": float(self.measured.mean()) if len(error) else None,
        }


def discount(drive: Floats, gamma: float, dt: float) -> Floats:
    """Return -ln(gamma) int gamma^(s-t) d(s) ds from each tick on, (T,), the last drive lasting for ever."""
    keep = gamma**dt
    ahead = np.array(drive, float)
    for t in range(len(drive) - 2, -1, -1):
        ahead[t] = (1 - keep) * 0.5 * (drive[t] + drive[t + 1]) + keep * ahead[t + 1]
    return ahead


def horizon(gamma: float, dt: float) -> int:
    """Return the ticks after which 1 % of the discounted future is left."""
    return math.ceil(math.log(FORGOTTEN) / math.log(gamma) / dt)


def compare_deviation(
    learner: Learner,
    lives: Sequence[tuple[Life, int, int]],
    gamma: float,
    states: int,
    rng: np.random.Generator,
) -> DeviationCheck:
    """Return J against the measured discounted drive at `states` states drawn from lives.

    Each life comes with the slot whose J is meant and its first tick to be drawn; its last ticks,
    whose future is cut off, are left out.
    """
    zeta, measured, slots = [], [], []
    for life, slot, first in lives:
        last = len(life.drive) - horizon(gamma, learner.group.dt)
        stays = np.flatnonzero(life.alive[:, slot].cumprod())
        ahead = discount(life.drive[: len(stays), slot], gamma, learner.group.dt)
        at = np.arange(min(first, max(last, 0)), min(max(last, 0), len(stays)))
        at = rng.choice(at, min(len(at), math.ceil(states / len(lives))), replace=False)
        zeta.append(life.zeta[at, slot])
        measured.append(ahead[at])
        slots.append(np.full(len(at), slot))
    where, whose = np.concatenate(zeta).astype(np.float32), np.concatenate(slots)
    learned = np.zeros(len(where))
    for slot in np.unique(whose):
        learned[whose == slot] = learner.deviation(int(slot), where[whose == slot])
    return DeviationCheck(learned=learned, measured=np.concatenate(measured))


def random_starts(scenario: Scenario, learner: Learner, seed: int, starts: int, ticks: int) -> list[Life]:
    """Return lives of `ticks` ticks from random places and random needs, at least `starts` over all slots."""
    learner.evaluating(EPSILON)
    env, group, n = Ecology(scenario), learner.group, learner.group.size
    species, rng = scenario.species[group.index], np.random.default_rng(seed)
    found = []
    for _ in range(math.ceil(starts / n)):
        env.reset_arrays(seed)
        internal = np.tile([need.x0 for need in species.needs], (n, 1))
        for i, need in enumerate(species.needs):
            if need.set_point > 0:
                drawn = need.set_point * (1 + rng.uniform(DEPRIVED, SATED, n))
                internal[:, i] = np.clip(drawn, need.low, need.bounds[1])
        heading = rng.uniform(-np.pi, np.pi, n)
        tick = place_group(env, group, scatter(scenario.arena, species.radius, n, rng), heading, internal)
        found.append(live(env, learner, tick, ticks))
    return found


# ---- is f what the world does? -----------------------------------------------------------


def transition_check(
    scenario: Scenario,
    learner: Learner,
    lives: Sequence[Life],
    seed: int,
    slot: int = 0,
    states: int = PER_MOVEMENT,
) -> dict[str, Any] | None:
    """Return f against the true change per movement, at states of `lives` in which it is open.

    None for a learner that does not tell its f: one without `moves` and `predict`.
    """
    moves, predict = getattr(learner, "moves", None), getattr(learner, "predict", None)
    if moves is None or predict is None:
        return None
    group, rng = learner.group, np.random.default_rng(seed)
    env = Ecology(scenario)
    env.reset_arrays(seed)
    zeta = np.concatenate([life.zeta[life.alive[:, slot], slot] for life in lives])
    open_ = moves.open(np.concatenate([life.masks[life.alive[:, slot], slot] for life in lives]))  # (m, M)
    angle = np.array(group.layout.kinds) == "angle"
    report: dict[str, Any] = {}
    for m, name in enumerate(moves.names):
        at = np.flatnonzero(open_[:, m])
        at = rng.choice(at, min(len(at), states), replace=False)
        if not len(at):
            report[name] = {"states": 0, "share_explained": None, "duration": None, "duration_error": None}
            continue
        guess = predict(slot, zeta[at].astype(np.float32))
        true, lasted = zip(*(carry_out(env, learner, m, zeta[i], slot) for i in at), strict=True)
        change = np.array(true) - zeta[at]
        error = guess["change"][:, m] - change
        for difference in (change, error):
            difference[:, angle] = wrap(difference[:, angle])
        scale = group.layout.scale
        whole = float(((change / scale) ** 2).sum())
        report[name] = {
            "states": len(at),
            "share_explained": 1 - float(((error / scale) ** 2).sum()) / whole if whole > 1e-12 else None,
            "duration": float(np.mean(lasted)) * group.dt,
            "duration_error": float(np.abs(guess["duration"][:, m] - np.array(lasted) * group.dt).mean()),
        }
    return report


def carry_out(env: Ecology, learner: Learner, movement: int, zeta: Floats, slot: int) -> tuple[Floats, int]:
    """Return zeta (D,) after the learner's `movement` from `zeta`, in the simulator, and its ticks."""
    moves, group = learner.moves, learner.group  # type: ignore[attr-defined]
    species, names = env.scenario.species[group.index], list(group.layout.names)
    where = [names.index("x"), names.index("y")] if "x" in names else []
    now, me = env.state_view, group.slots.start + slot
    position, heading = now.position[group.slots].copy(), now.heading[group.slots].copy()
    internal = np.tile([need.x0 for need in species.needs], (group.size, 1))
    if where:
        position[slot] = zeta[where]
    if "heading" in names:
        heading[slot] = zeta[names.index("heading")]
    set_point = set_points(env.world.model.body, now)[me, : len(species.needs)]
    internal[slot] = zeta[: len(species.needs)] + set_point
    place_group(env, group, position, heading, internal)
    actions = np.zeros(env.size, np.int64)
    for other in env.groups.values():
        actions[other.slots] = other.kinds.index("rest")
    stage, left, ticks = 0, int(moves.ticks[movement, 0]), 0
    while ticks < LONGEST:
        ticks += 1
        actions[me] = moves.action[movement, stage]
        tick = env.step_arrays(actions)
        left -= 1
        mask = tick.masks[group.name][slot]
        over = left <= 0
        if over and stage == 0 and moves.ticks[movement, 1] > 0:
            stage, left, over = 1, int(moves.ticks[movement, 1]), False
        if not mask[moves.action[movement, stage]] or (over and mask.sum() > 1):
            break
    return tick.observations[group.name][slot].astype(float), ticks


# ---- everything --------------------------------------------------------------------------


@dataclass(frozen=True)
class Findings:
    """What an evaluation found: the report for evaluation.json and the arrays behind the figures."""

    report: dict[str, Any]
    life: Life  # of the learner, from birth
    maps: Maps | None
    checks: dict[str, DeviationCheck]  # "life" and "random_starts"


@dataclass(frozen=True)
class Lived:
    """The run of the learner: its species' mean drive, NaN if none is alive, in blocks of `span` ticks from birth."""

    drive: Floats  # (T,)
    span: int = 1

    def report(self, bound: float | None) -> dict[str, Any]:
        """Return the mean drive of the last tenth, and from which tick on the running mean stays below `bound`."""
        some = self.drive[np.isfinite(self.drive)]
        last = self.drive[-max(1, len(self.drive) // 10) :]
        last = last[np.isfinite(last)]
        return {
            "ticks": len(self.drive) * self.span,
            "mean_drive_last_tenth": float(last.mean()) if len(last) else None,
            "window": WINDOW,
            "regulated_from": None if bound is None else find_regulation(some, bound, span=self.span),
        }


@dataclass(frozen=True)
class Extent:
    """How much of a learner is measured, and with which random numbers."""

    seed: int = 0
    ticks: int = 10_000  # of each life
    skip: int = 1000  # of them, before drives are measured
    places: int = PROBES  # per need, at which choices are probed
    slot: int = 0  # within the species, whose maps and checks are meant; drives and probes are averaged over all
    device: str = "cpu"  # where the report says that the learner computes


@dataclass(frozen=True)
class Trained:
    """Where a learner comes from."""

    name: str | None = None  # what it is called in the report
    home: Scenario | None = None  # the world that it was trained in, where that is another than it is measured in
    lived: Lived | None = None  # the run itself


def evaluate(
    scenario: Scenario,
    learner: Learner,
    extent: Extent | None = None,
    trained: Trained | None = None,
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> Findings:
    """Measure `learner` in `scenario`, against the baselines and the true world.

    The learner stops learning for good; agents of other species rest. Baselines that learn do so in the world that it
    was `trained` in. `tell` is called with a line before each part. Raises EcologyError where the `extent` skips all
    ticks, or where the learner does not fit the world.
    """
    extent, trained = extent or Extent(), trained or Trained()
    seed, ticks, skip, slot, home = extent.seed, extent.ticks, extent.skip, extent.slot, trained.home
    if not 0 <= skip < ticks:
        raise EcologyError(f"an evaluation needs more ticks than it skips, got {ticks} ticks, {skip} skipped.")
    check_fits(learner, scenario)
    group = learner.group
    drives: dict[str, dict[str, Any]] = {"learned": {}, "learned_epsilon_0": {}}
    own_drives: dict[str, dict[str, Any]] = {"learned": {}, "learned_epsilon_0": {}}

    def keep(name: str, life: Life) -> Floats:
        """Keep the mean drives of a life; return its drive as a series."""
        series = drive_series(life, skip)
        drives[name], own_drives[name] = interval(series), interval(drive_series(life, skip, own=True))
        return series

    _live_as_baselines(scenario, learner, seed, ticks, home, keep, tell)
    yardstick, bound = _yardstick(drives)
    worst, sunk, frozen = {}, {}, {}
    for each, epsilon in (("learned", EPSILON), ("learned_epsilon_0", 0.0)):
        tell(f"living with epsilon {epsilon:g}")
        frozen[each] = fresh_life(scenario, learner, ticks, seed, epsilon)
        worst[each] = worst_block(keep(each, frozen[each]), skip=skip)
        sunk[each] = sinks(frozen[each], group, bound) if bound is not None else None
    learner.evaluating(EPSILON)  # as all that follows is measured
    tell("maps")
    life, maps = frozen["learned"], maps_of(scenario, learner, slot)
    tell("probe")
    probed = probe(scenario, learner, seed, extent.places)
    gamma = getattr(getattr(learner, "settings", None), "gamma", None)
    checks, lives = _check_deviation(scenario, learner, (life, slot, skip), gamma, seed, tell)
    tell("transition check")
    report = {
        "scenario": scenario.name,
        "settings": dict(scenario.settings),
        "trained_in": None if home is None else {"scenario": home.name, "settings": dict(home.settings)},
        "species": group.name,
        "learner": trained.name or type(learner).__name__.lower(),
        "device": extent.device,
        "slot": slot,
        "seed": seed,
        "ticks": ticks,
        "skip": skip,
        "places": extent.places,
        "epsilon": EPSILON,
        "mean_drive": drives,
        "mean_own_drive": own_drives,
        "regulated": {"below": bound, "of": yardstick, "share": REGULATED},
        "as_lived": None if trained.lived is None else trained.lived.report(bound),
        "worst_block": worst,
        "stuck": sunk,
        "closed_gap": closed_gap(drives),
        "action_shares": action_shares(life, group),
        "deviation_maps": maps_report(maps, scenario, group) if maps is not None else None,
        "probe": probed,
        "deviation_check": _deviation_report(checks, gamma, life),
        "transition_check": transition_check(scenario, learner, lives, seed, slot),
        "about": dict(ABOUT),
    }
    return Findings(report=report, life=life, maps=maps, checks=checks)


def _yardstick(drives: Mapping[str, Mapping[str, Any]]) -> tuple[str, float | None]:
    """Return the baseline that says what is regulated, and the drive below which a life counts so."""
    name = "camping" if "camping" in drives else "rest"
    usual = drives.get(name, {}).get("mean")
    return name, None if usual is None else REGULATED * usual


def _deviation_report(checks: Mapping[str, DeviationCheck], gamma: float | None, life: Life) -> dict[str, Any] | None:
    """Return what the checks of J found, None without one."""
    if not checks:
        return None
    worst = FORGOTTEN * float(life.drive.max())
    found = {name: check.report() for name, check in checks.items()}
    return {"gamma": gamma, "truncation_error_at_most": worst, **found}


def _live_as_baselines(
    scenario: Scenario,
    learner: Learner,
    seed: int,
    ticks: int,
    home: Scenario | None,
    keep: Callable[[str, Life], Floats],
    tell: Callable[[str], None],
) -> None:
    """Run every baseline from birth and `keep` its life under its name."""
    moves = getattr(learner, "moves", None)
    for name in BASELINES:
        tell(f"living as {name}")
        try:
            other = baseline(name, scenario, learner.group, seed, ticks, home)
        except EcologyError:
            continue  # a world in which this one cannot live: nothing to walk to
        keep(name, fresh_life(scenario, other, ticks, seed))
        if isinstance(other, Planner) and moves is not None:
            explorer = Exploring(other, moves, EPSILON, np.random.SeedSequence(seed))
            keep("planner_exploring", fresh_life(scenario, explorer, ticks, seed))


def _check_deviation(
    scenario: Scenario,
    learner: Learner,
    lived: tuple[Life, int, int],
    gamma: float | None,
    seed: int,
    tell: Callable[[str], None],
) -> tuple[dict[str, DeviationCheck], list[Life]]:
    """Compare J with what followed, in a life and from random starts; return the checks by name, and all lives.

    `lived` is the life of the learner, the slot that is meant and the ticks to skip.
    """
    (life, slot, skip), checks = lived, {}
    if gamma is None or learner.deviation(slot, life.zeta[:1, slot].astype(np.float32)) is None:
        return {}, [life]
    tell("deviation check")
    rng, far = np.random.default_rng(seed), horizon(gamma, learner.group.dt)
    starts = random_starts(scenario, learner, seed, STARTS, far + far // 4)
    checks["life"] = compare_deviation(learner, [(life, slot, skip)], gamma, STATES, rng)
    checks["random_starts"] = compare_deviation(learner, [(each, slot, 0) for each in starts], gamma, STATES, rng)
    return checks, [life, *starts]


def action_shares(life: Life, group: Group) -> dict[str, float]:
    """Return the share of the living ticks that each action took."""
    done = np.bincount(life.actions[life.alive[:-1]], minlength=len(group.actions))
    return dict(zip(group.actions, (done / max(done.sum(), 1)).tolist(), strict=True))


def closed_gap(drives: Mapping[str, Mapping[str, Any]]) -> float | None:
    """Return (camping - learned) / (camping - planner), None where the two do not differ."""
    try:
        learned, camping, planner = (drives[name]["mean"] for name in ("learned", "camping", "planner"))
    except KeyError:
        return None
    return (camping - learned) / (camping - planner) if camping - planner > 0.01 * planner else None


def baseline(
    name: str, scenario: Scenario, group: Group, seed: int, ticks: int, home: Scenario | None = None
) -> Learner:
    """Return one of `BASELINES`, ready to be evaluated over `ticks`; those that learn have lived as long in `home`."""
    stream = np.random.SeedSequence(seed)
    if name == "planner":
        return Planner(group, stream, scenario)
    if name == "camping":
        return Camping(group, stream, scenario)
    if name in LEARN:
        learner, env = LEARN[name](group, stream), Ecology(home or scenario)
        loop.run(env, company(env, learner), env.reset_arrays(seed), ticks)
        return learner
    return {"random": Random, "rest": Rest}[name](group, stream)
