"""Yardsticks that know the world: a planner that makes rounds, and one that camps.

Both are given the scenario: its map, its resources and the body's dynamics. Neither learns. They act as
every learner does, one elementary action a tick, within the action mask.

A plan is a round of resources with, for every stay, the deviation up to which the agent eats, and
thresholds of fatigue for naps, rests and running. Plans are compared in an abstract model (the true
body, with walks as a number of ticks) and improved by cross-entropy search; the best one is carried out
with geodesic paths. Resources that swing or are not always there are planned with as if they stood at
their position and were.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import ClassVar

import numpy as np

from ecology import Ecology, EcologyError, Group, Scenario
from ecology.actions import ActionTable, compile_actions
from ecology.agents.base import Learner
from ecology.agents.movements import Movements
from ecology.ground import wrap
from ecology.ground.ways import Norm, Paths, euclid, gauge
from ecology.physiology import advance, clamp, compile_bodies, drive
from ecology.spec import Oscillation
from ecology.state import Bools, Floats, Ints

LEGS = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0, 1.2, 1.4, 1.7, 2.0, 2.4, 2.8])  # lengths of a leg
ALIGNED = 0.08  # share of a turn by which a heading may miss a bearing and still count as facing it
LOST = 2000  # ticks after which a walk counts as impossible
FIRST_LEVELS = (0.0, 0.5, 1.0, 2.0)  # refill levels tried first, times what a need loses in half a round
ORDERS, SAMPLES, ELITE, GENERATIONS = 8, 64, 8, 8  # of the cross-entropy search
SHORT, LONG = 4000.0, 10_000.0  # time over which plans are compared; the long one if sleep is closed at birth
MANY = 5000  # sequences of stays that are enumerated, at most


# ---- plans -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Plans:
    """P plans, one a row; a round of K stays at most, repeated for ever."""

    order: Ints  # (P, K) resource of each stay
    length: Ints  # (P,) stays in the round
    level: Floats  # (P, K) deviation up to which it eats
    nap_from: Floats  # (P,) sleep fatigue from which it sleeps after a meal
    rest_above: Floats  # (P,) muscle fatigue above which it rests after a meal
    run_below: Floats  # (P,) muscle fatigue below which it runs

    def rows(self, which: Ints) -> Plans:
        """Return the plans `which`, in that order."""
        return Plans(**{f.name: getattr(self, f.name)[which] for f in fields(self)})


@dataclass(frozen=True)
class Knowledge:
    """What a baseline knows of the body and the resources, V needs, R resources, A actions."""

    table: ActionTable
    set_point: Floats  # (V,)
    need: Ints  # (R,) the need that the resource serves, -1 without
    eat: Ints  # (R,) its consume action
    go: Ints  # (R,) its go_to action, -1 without
    walks: Ints  # moves at the slowest speed
    runs: Ints  # moves at a higher one
    sleep: int  # the sleep action, -1 without
    muscle: int  # the need that walking raises, -1 without
    fatigue: int  # the need that sleep lowers, -1 without


def service_of(table: ActionTable, resource: int) -> tuple[int, int]:
    """Return the need that `resource` serves most and the consume action that does, (-1, -1) without."""
    acts = np.flatnonzero(table.consumes == resource)
    if not acts.size:
        return -1, -1
    act, need = np.unravel_index(np.argmax(table.control[acts]), table.control[acts].shape)
    return int(need), int(acts[act])


def know(scenario: Scenario, group: Group) -> Knowledge:
    """Return what there is to know for the species of `group`; EcologyError where no tour is possible."""
    species = scenario.species[group.index]
    for resource in scenario.resources:
        swings = resource.motion is None or isinstance(resource.motion, Oscillation)
        if resource.position is None or not swings or not math.isinf(resource.stock):
            raise EcologyError(
                f"a planner counts on resources that are unlimited and stay in place, or swing about it; "
                f"{resource.name!r} of {scenario.name!r} does not. Leave planner and camping out of the comparison."
            )
    for action in species.actions:
        if (
            action.cue is not None
            or action.drain
            or action.by_stock
            or (action.kind == "consume" and action.chance < 1)
        ):
            raise EcologyError(
                f"a planner counts on actions that always do the same and wait for no cue; {action.name!r} of "
                f"{scenario.name!r} does not. Leave planner and camping out of the comparison."
            )
    table = compile_actions(species, scenario.resources, scenario.species)
    own = {name: getattr(table, name)[:, : len(species.needs)] for name in ("control", "opens_from", "closes_at")}
    table = replace(table, **own)  # its own needs alone
    serves = [service_of(table, r) for r in range(len(scenario.resources))]
    moves = np.flatnonzero(np.array(table.kinds) == "move")
    sleeps = np.flatnonzero(np.array(table.kinds) == "sleep")
    if not any(need >= 0 for need, _ in serves) or not moves.size or "position" not in species.senses:
        raise EcologyError(
            f"a planner needs a species that moves, eats and senses its position; {species.name!r} of "
            f"{scenario.name!r} does not. Leave planner and camping out of the comparison."
        )
    slowest = table.speed[moves].min()
    tires = table.control[moves[table.speed[moves] == slowest][0]]
    rests = table.control[sleeps[0]] if sleeps.size else np.zeros(1)
    goes = [np.flatnonzero(table.goes_to == r) for r in range(len(scenario.resources))]
    return Knowledge(
        table=table,
        set_point=np.array([need.set_point for need in species.needs]),
        need=np.array([need for need, _ in serves]),
        eat=np.array([act for _, act in serves]),
        go=np.array([int(g[0]) if g.size else -1 for g in goes]),
        walks=moves[table.speed[moves] == slowest],
        runs=moves[table.speed[moves] > slowest],
        sleep=int(sleeps[0]) if sleeps.size else -1,
        muscle=int(np.argmax(tires)) if tires.max() > 0 else -1,
        fatigue=int(np.argmin(rests)) if rests.min() < 0 else -1,
    )


def wants(plans: Plans, stage: Ints, at: Bools, internal: Floats, known: Knowledge) -> tuple[Bools, Bools, Bools]:
    """Return which plans at their stay eat, sleep and rest, each (P,); all others there are done with it.

    `stage` (P,) is the stay of the round, `at` (P,) whether it has been reached, `internal` (P, V) is x.
    """
    row = np.arange(len(stage))
    column = known.need[plans.order[row, stage]]
    eats = at & (internal[row, column] - known.set_point[column] < plans.level[row, stage])
    sleeps = np.zeros_like(eats)
    if known.sleep >= 0 and known.fatigue >= 0:
        sleeps = at & ~eats & (internal[:, known.fatigue] >= plans.nap_from)
    rests = np.zeros_like(eats)
    if known.muscle >= 0:
        rests = at & ~eats & ~sleeps & (internal[:, known.muscle] > plans.rest_above)
    return eats, sleeps, rests


def simulate(plans: Plans, scenario: Scenario, group: Group, known: Knowledge, travel: Floats, ticks: int) -> Floats:
    """Return the mean drive (P,) of plans in the abstract model, over `ticks` from birth.

    `travel` (R + 1, R) holds the walking ticks between resources, the last row from the birthplace.
    """
    p, table, dt = len(plans.length), known.table, scenario.dt
    body = compile_bodies([replace(scenario.species[group.index], count=p)], len(known.set_point))
    body = replace(body, noise=np.zeros_like(body.noise), noisy=False)
    row, internal = np.arange(p), body.start.copy()
    opens, closes, control = table.opens_from, table.closes_at, table.control
    stage, hold = np.zeros(p, np.int64), np.zeros(p)
    left = travel[-1, plans.order[:, 0]].copy()
    walk, run = known.walks[0], (known.runs[0] if known.runs.size else known.walks[0])
    pace = table.speed[run] / table.speed[walk]
    rng, total, age = np.random.default_rng(0), np.zeros(p), np.zeros(p)

    def open_(action: Ints) -> Bools:
        return np.all((internal < closes[action]) & (internal >= opens[action]), axis=1)

    for tick in range(ticks):
        at = left <= 0
        eats, sleeps, rests = wants(plans, stage, at, internal, known)
        done = at & ~eats & ~sleeps & ~rests & (hold <= 0)
        if done.any():
            here = plans.order[row, stage]
            stage = np.where(done, (stage + 1) % plans.length, stage)
            left = np.where(done, travel[here, plans.order[row, stage]], left)
        runs = internal[:, known.muscle] < plans.run_below if known.muscle >= 0 else plans.run_below > 0
        goes = left > 0
        action = np.full(p, table.rest)
        action[eats] = known.eat[plans.order[row, stage]][eats]
        if known.sleep >= 0:
            action[sleeps] = known.sleep
        action[goes] = np.where(runs, run, walk)[goes]
        shut = ~open_(action)
        if shut.any():
            action[shut & goes] = walk
            shut = ~open_(action)
            action[shut] = table.rest
            if known.sleep >= 0:
                action[shut & ~open_(np.full(p, table.rest))] = known.sleep
        if known.sleep >= 0:
            asleep = hold > 0
            action[asleep] = known.sleep
            begins = (action == known.sleep) & ~asleep
            hold = np.maximum(np.where(begins, table.duration[known.sleep], hold) - dt, 0.0)
        left = left - np.where(action == walk, 1.0, np.where(action == run, pace, 0.0)) * goes
        internal = clamp(body, advance(body, internal, control[action], tick * dt, age, dt, rng))
        total += drive((internal - body.set_point) * body.regulated, body.epsilon, form=body.form)
    return total / ticks


# ---- walking -----------------------------------------------------------------------------


@dataclass
class Leg:
    """A walk under way: turns that remain, then steps along the heading or a direction."""

    turns: int = 0  # negative to the right
    steps: int = 0
    way: int = -1  # the direction among the four (or more), -1 for the heading


class Steering:
    """The choice of elementary movements that leads one body to a goal by the shortest walk.

    A leg is a number of turns and a number of steps. The next one is chosen among all that the walls
    allow by what it takes and by the way left from its end, in the norm of the directions that can be
    walked there. A walk is kept to its end, so that it does not waver.
    """

    def __init__(self, paths: Paths, known: Knowledge, dt: float) -> None:
        table = known.table
        self.paths, self.known, self.dt = paths, known, dt
        self.absolute = not np.isnan(table.direction[known.walks[0]])
        turns = np.flatnonzero(np.array(table.kinds) == "turn")
        self.left = int(turns[np.argmax(table.turn[turns])]) if turns.size else -1
        self.right = int(turns[np.argmin(table.turn[turns])]) if turns.size else -1
        self.step = float(table.speed[known.walks[0]]) * dt
        self.turn = float(table.turn[self.left]) * dt if turns.size else 2 * math.pi
        # k directions at hand: absolute, or relative to the heading and so many turns away
        self.turns = np.zeros(known.walks.size, np.int64)
        self.angles: Floats = table.direction[known.walks]
        if not self.absolute:
            most = math.ceil(math.pi / self.turn - 1e-9)
            self.turns = np.arange(-most, most + 1)
            self.angles = np.asarray(self.turns * self.turn, float)
        self._norm = gauge(self.angles) if self.absolute else euclid
        self._fields: dict[tuple[int, float], tuple[Norm, Floats, Floats]] = {}

    def field(self, goal: int, place: Floats, heading: float) -> tuple[Norm, Floats, Floats]:
        """Return the norm of the directions at hand, the points that lead to `goal` and the ways left."""
        offset = 0.0 if self.absolute else round(heading % self.turn, 6)
        key = (goal, offset)
        if key not in self._fields:
            if len(self._fields) > 256:
                self._fields.clear()
            norm = self._norm if self.absolute else gauge(heading + self.angles)
            self._fields[key] = (norm, *self.paths.to(place, norm))
        return self._fields[key]

    def leg(self, position: Floats, heading: float, goal: int, place: Floats) -> Leg:
        """Return the next leg from `position` (2,) and `heading` toward resource `goal` at `place` (2,)."""
        norm, points, left = self.field(goal, place, heading)
        angles = self.angles if self.absolute else heading + self.angles
        steps = np.unique(np.maximum(np.round(LEGS / self.step).astype(int), 1))
        unit = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ends = position + unit[:, None] * (steps[:, None] * self.step)  # (k, s, 2)
        walkable = self.paths.clear(position, ends)
        which, length = np.nonzero(walkable)
        if not which.size:  # pressed into a corner: one step the right way round
            return self._toward(position, heading, points, left, norm)
        end = ends[which, length]  # (m, 2)
        way = points[None] - end[:, None]  # (m, c + 1, 2)
        cost = norm(way) + left
        if not self.absolute:
            off = wrap(np.arctan2(way[..., 1], way[..., 0]) - angles[which][:, None])
            cost = cost + self._turns_for(off) * self.step
        seen = self.paths.clear(end[:, None], points[None])
        rest = np.where(seen, cost, np.inf).min(axis=1) / self.step  # ticks left from the leg's end
        spent = steps[length] + np.abs(self.turns[which])
        best = int(np.argmin(spent + rest - 1e-6 * steps[length]))
        k, s = which[best], steps[length[best]]
        return Leg(steps=int(s), way=int(k)) if self.absolute else Leg(turns=int(self.turns[k]), steps=int(s))

    def _turns_for(self, angle: Floats) -> Floats:
        """Return the turns that a walk along `angle` off the heading takes: to one or two of the headings."""
        share = angle / self.turn
        low, near = np.floor(share), np.round(share)
        two = np.minimum(np.abs(low), np.abs(low + 1)) + 1
        return np.where(np.abs(share - near) < ALIGNED, np.abs(near), two)

    def _toward(self, position: Floats, heading: float, points: Floats, left: Floats, norm: Norm) -> Leg:
        """Return one step by the heading nearest to the way out of a corner."""
        way = points - position
        target = int(np.argmin(norm(way) + left))
        bearing = math.atan2(way[target, 1], way[target, 0])
        if self.absolute:
            return Leg(steps=1, way=int(np.argmin(np.abs(wrap(self.angles - bearing)))))
        return Leg(turns=round(float(wrap(np.array(bearing - heading))) / self.turn), steps=1)


# ---- the search of a plan ----------------------------------------------------------------


def rounds(resources: Sequence[int], longest: int) -> list[tuple[int, ...]]:
    """Return all rounds of up to `longest` stays, shortest first, each once whatever its beginning."""
    found = []
    for n in range(1, longest + 1):
        for order in itertools.product(resources, repeat=n):
            turned = [order[i:] + order[:i] for i in range(n)]
            stays = n == 1 or all(a != b for a, b in zip(order, turned[1], strict=True))
            if stays and order == min(turned) and turned.count(order) == 1:
                found.append(order)
    return found


def plans_of(orders: Sequence[tuple[int, ...]], width: int, values: Floats) -> Plans:
    """Return plans from `orders` and `values` (P, width + 3): levels, then the three thresholds."""
    order = np.array([list(o) + [o[0]] * (width - len(o)) for o in orders])
    return Plans(
        order=order,
        length=np.array([len(o) for o in orders]),
        level=values[:, :width],
        nap_from=np.exp(values[:, width]),
        rest_above=np.exp(values[:, width + 1]),
        run_below=values[:, width + 2],
    )


def search(
    scenario: Scenario, group: Group, known: Knowledge, travel_ticks: Floats, longest: int
) -> tuple[Plans, float]:
    """Return the best plan found (one row) and its mean drive in the abstract model.

    All rounds of up to `longest` stays are compared with a few refill levels; the levels and thresholds of
    the best are improved by cross-entropy search. The same world gives the same plan.
    """
    needs = scenario.species[group.index].needs
    reachable = [r for r in np.flatnonzero(known.need >= 0) if np.isfinite(travel_ticks[-1, r])]
    while longest > 1 and len(reachable) ** longest > MANY:
        longest -= 1
    orders = rounds([int(r) for r in reachable], longest)
    width = max(len(order) for order in orders)
    # what a need loses in half a round, the natural size of a refill level
    trip = sum(float(np.max(travel_ticks[r], initial=0.0)) for r in reachable) if longest > 1 else 0.0
    eaten = [needs[known.need[r]] for r in reachable]
    lost = max(min(n.decay + n.leak * n.set_point, 1.0) for n in eaten) * max(trip, 20.0) * scenario.dt / 2
    size = min(lost, max(n.scale for n in eaten))
    nap, tired, horizon = 0.5, 1.0, SHORT
    if known.sleep >= 0 and known.fatigue >= 0:  # a nap that just takes away all fatigue
        gain = -known.table.control[known.sleep, known.fatigue] - needs[known.fatigue].decay
        opens = known.table.opens_from[known.sleep, known.fatigue]
        horizon = LONG if opens > needs[known.fatigue].x0 else SHORT
        nap = max(gain * known.table.duration[known.sleep], opens, 0.1)
    start = np.concatenate([np.full(width, 0.5 * size), [math.log(nap / 2), math.log(tired), -0.2]])
    spread = np.concatenate([np.full(width, 0.6 * size), [1.0, 1.0, 0.3]])

    def score(orders: Sequence[tuple[int, ...]], values: Floats, time: float) -> Floats:
        plans, ticks = plans_of(orders, width, values), math.ceil(time / scenario.dt)
        return simulate(plans, scenario, group, known, travel_ticks, ticks)

    many = [order for order in orders for _ in FIRST_LEVELS]
    values = np.tile(start, (len(many), 1))
    values[:, :width] = np.tile(FIRST_LEVELS, len(orders))[:, None] * size - 0.02 * size
    first = score(many, values, SHORT).reshape(len(orders), -1).min(axis=1)
    kept = [orders[i] for i in np.argsort(first, kind="stable")[:ORDERS]]

    rng = np.random.default_rng(0)
    mean, deviation = np.tile(start, (len(kept), 1)), np.tile(spread, (len(kept), 1))
    best, least = mean.copy(), np.full(len(kept), np.inf)
    for _ in range(GENERATIONS):
        drawn = mean[:, None] + deviation[:, None] * rng.standard_normal((len(kept), SAMPLES, width + 3))
        drawn[:, 0] = best
        flat = drawn.reshape(-1, width + 3)
        cost = score([order for order in kept for _ in range(SAMPLES)], flat, horizon).reshape(len(kept), -1)
        ranked = np.argsort(cost, axis=1, kind="stable")[:, :ELITE]
        elite = np.take_along_axis(drawn, ranked[:, :, None], axis=1)
        mean, deviation = elite.mean(axis=1), elite.std(axis=1) + 0.01 * spread
        best, least = elite[:, 0], cost.min(axis=1)
    winner = int(np.argmin(least))
    return plans_of([kept[winner]], width, best[winner][None]), float(least[winner])


# ---- yardsticks --------------------------------------------------------------------------


class Yardstick(Learner):
    """Base class of baselines that carry out a plan in a world that they know, with any number of stays in a tour."""

    longest: ClassVar[int]

    def __init__(self, group: Group, seed: np.random.SeedSequence, scenario: Scenario) -> None:
        """Search the plan with the least mean drive in `scenario`; takes some seconds."""
        super().__init__(group, seed)
        self.known = know(scenario, group)
        species = scenario.species[group.index]
        self.paths = Paths(scenario.arena, species.radius)
        self.places = np.array([r.position for r in scenario.resources])
        # where one may be at it: its circle, and as far as it swings
        motions = [r.motion for r in scenario.resources]
        swing = [
            math.dist(place, m.to) if isinstance(m, Oscillation) else 0.0
            for place, m in zip(self.places, motions, strict=True)
        ]
        self.radii = np.array([r.radius for r in scenario.resources]) + swing
        self.steering = Steering(self.paths, self.known, scenario.dt)
        names = list(group.layout.names)
        self._at = [names.index("x"), names.index("y")]
        self._heading = names.index("heading") if "heading" in names else -1
        if self._heading < 0 and not self.steering.absolute:
            raise EcologyError(
                f"a planner of species {group.name!r} must sense its heading; add 'heading' to its senses."
            )
        self.begin()
        self.travel = travel(self, scenario)  # (R + 1, R) ticks
        # one row for every slot, and its mean drive in the abstract model
        self.plan, self.expected = search(scenario, group, self.known, self.travel, self.longest)

    def begin(self) -> None:
        """Start the tour again."""
        self.stage = np.zeros(self.size, np.int64)
        self._legs = [Leg() for _ in range(self.size)]

    def lose_way(self, slots: Ints) -> None:
        """Drop the walks under way of `slots` (k,), which were moved elsewhere."""
        for slot in slots:
            self._legs[slot] = Leg()

    def walk_to(self, slot: int, goal: int, zeta: Floats, mask: Bools, run: bool = False) -> int:
        """Return the action that brings the agent in `slot` nearer to resource `goal`."""
        known, steering, leg = self.known, self.steering, self._legs[slot]
        position, heading = zeta[self._at].astype(float), float(zeta[self._heading])
        go = known.go[goal]
        if go >= 0 and mask[go] and not run:
            leg.turns = leg.steps = 0
            return int(go)
        if leg.turns == 0 and leg.steps <= 0:
            leg = self._legs[slot] = steering.leg(position, heading, goal, self.places[goal])
        if leg.turns:
            action = steering.left if leg.turns > 0 else steering.right
            if mask[action]:
                leg.turns -= 1 if leg.turns > 0 else -1
                return action
        else:
            moves = known.runs if run and known.runs.size else known.walks
            ways = known.table.direction[moves]
            action = int(moves[0] if leg.way < 0 else moves[np.argmin(np.abs(wrap(ways - steering.angles[leg.way])))])
            if run and (not mask[action] or leg.steps < known.table.speed[action] / known.table.speed[known.walks[0]]):
                action = int(known.walks[0 if leg.way < 0 else leg.way])
            if mask[action]:
                leg.steps -= max(1, round(known.table.speed[action] / known.table.speed[known.walks[0]]))
                return action
        return known.table.rest

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return the plan's next action (n,) in states (n, D)."""
        known = self.known
        internal = observations[:, : len(known.set_point)] + known.set_point
        plan = self.plan.rows(np.zeros(self.size, np.int64))
        position = observations[:, self._at]
        row = np.arange(self.size)
        actions = np.full(self.size, known.table.rest)
        for _ in range(2):
            goal = plan.order[row, self.stage]
            # a float32 zeta may place the body a hair off the circle that the world has it in
            at = np.hypot(*(position - self.places[goal]).T) <= self.radii[goal] - 1e-6
            at &= ~(masks[row, known.go[goal]] & (known.go[goal] >= 0))  # who can go to it is not there
            eats, sleeps, rests = wants(plan, self.stage, at, internal, known)
            done = at & ~eats & ~sleeps & ~rests & (masks.sum(axis=1) > 1)
            self.stage = np.where(done, (self.stage + 1) % plan.length, self.stage)
            for slot in np.flatnonzero(done):
                self._legs[slot] = Leg()
        for slot in np.flatnonzero(~at & (masks.sum(axis=1) > 1)):
            tired = internal[slot, known.muscle] if known.muscle >= 0 else 0.0
            run = bool(tired < plan.run_below[slot])
            actions[slot] = self.walk_to(int(slot), int(goal[slot]), observations[slot], masks[slot], run)
        actions = np.where(eats, known.eat[goal], actions)
        if known.sleep >= 0:
            actions = np.where(sleeps, known.sleep, actions)
        otherwise = np.where(masks[:, known.table.rest], known.table.rest, np.argmax(masks, axis=1))
        return np.where(masks[row, actions], actions, otherwise)


class Planner(Yardstick):
    """A planner that follows a tour: the baseline with the lowest drive."""

    longest: ClassVar[int] = 6


class Camping(Yardstick):
    """A baseline that walks to the best resource, stays, and sleeps and rests there: the strongest simple policy."""

    longest: ClassVar[int] = 1


class Exploring(Learner):
    """A yardstick that explores as an epsilon-greedy learner does: the same movements, as often, in the same world.

    A decision is due when the last movement is over. With probability epsilon it is a random one of `moves`, held to
    its end; otherwise the yardstick acts for as long as the movement lasts that its action begins.
    """

    def __init__(
        self, inner: Yardstick, moves: Movements, epsilon: float, seed: np.random.SeedSequence | None = None
    ) -> None:
        super().__init__(inner.group, seed or np.random.SeedSequence(0))
        self.inner, self.moves, self.epsilon = inner, moves, epsilon
        firsts = moves.action[:, 0]  # of the movements that begin with an action, the shortest
        self._length = np.array(
            [moves.length[firsts == a].min() if (firsts == a).any() else 1 for a in range(len(self.group.actions))]
        )
        self.begin()

    def begin(self) -> None:
        """Drop the movements under way."""
        self.inner.begin()
        self.movement = np.full(self.size, -1)  # explored, -1: the yardstick acts
        self.stage, self.left = np.zeros(self.size, np.int64), np.zeros(self.size, np.int64)

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return an action (n,): that of the baseline, or of an exploratory movement."""
        moves, row = self.moves, np.arange(self.size)
        explores = self.movement >= 0
        over = self.left <= 0
        second = explores & over & (self.stage == 0) & (moves.ticks[self.movement, 1] > 0)
        self.stage[second] = 1
        self.left[second] = moves.ticks[self.movement[second], 1]
        chosen = moves.action[self.movement, self.stage]
        ends = explores & (~masks[row, chosen] | (over & ~second & (masks.sum(axis=1) > 1)))
        self.inner.lose_way(np.flatnonzero(ends))
        self.movement[ends] = -1

        actions = self.inner.act(observations, masks)
        open_ = moves.open(masks)
        drawn = self.rng.random((self.size, 2))
        due = (ends | (~explores & over)) & open_.any(axis=1) & (masks.sum(axis=1) > 1)
        begins = due & (drawn[:, 0] < self.epsilon)
        if begins.any():
            self.movement[begins] = moves.explore(open_[begins], drawn[begins, 1])
            self.stage[begins] = 0
            self.left[begins] = moves.ticks[self.movement[begins], 0]
        plans = due & ~begins
        self.left[plans] = self._length[actions[plans]]
        self.left -= 1
        return np.where(self.movement >= 0, moves.action[self.movement, self.stage], actions)


def travel(traveller: Yardstick, scenario: Scenario) -> Floats:
    """Return the ticks (R + 1, R) of walks between resources and, last row, from birth, by walking them."""
    species = scenario.species[traveller.group.index]
    env = Ecology(replace(scenario, species=(replace(species, count=1),)))
    count = len(traveller.places)
    ticks = np.zeros((count + 1, count))
    for start in range(count + 1):
        for goal in np.flatnonzero(traveller.known.need >= 0):
            if start == goal:
                continue
            tick = env.reset_arrays(0)
            if start < count:
                tick = env.set_state(position=traveller.places[start][None])
            traveller._legs[0] = Leg()
            while not env.state_view.inside[0, goal]:
                zeta, mask = tick.observations[species.name][0], tick.masks[species.name][0]
                tick = env.step_arrays(np.array([traveller.walk_to(0, int(goal), zeta, mask)]))
                if env.state_view.tick > LOST:
                    ticks[start, goal] = np.inf
                    break
            else:
                ticks[start, goal] = max(env.state_view.tick, 1)
    return ticks
