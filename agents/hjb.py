"""The f/J learner of Algorithm 1 (Laurencon et al. 2021), for n agents at once, each with its own.

An agent learns a transition function f (how a movement changes zeta) and a deviation function J
(how bad its future is), and acts by the Hamilton-Jacobi-Bellman equation

    -ln(gamma) J(zeta) = min over open a of d(zeta, u_a) + dJ/dzeta . f(zeta, u_a).

J is kept in drive units, Jn = -ln(gamma) J: a constant drive d has Jn = d. `ALGORITHM1` is the bare
algorithm; every addition is an option of `HJBSettings`, named with its source, and can be switched
off alone. An agent is given d and the layout of its own senses, nothing of the world.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ecology import EcologyError, Group, elementary
from ecology.agents import checkpoint, kernels
from ecology.agents import device as devices
from ecology.agents.base import DivergedError, Learner, Transition, drive_bend, drive_terms
from ecology.agents.curiosity import Curiosity
from ecology.agents.memory import Memory
from ecology.agents.movements import ARRIVES, Movements, adaptive, single_ticks
from ecology.agents.networks import Perceptrons
from ecology.decision import Decision

DEPRIVED, SATED = -1.0, 0.4  # imagined deviations lie between these, times x*
J_CENTRE, J_SPREAD, J_CEILING = 0.45, 0.55, 2.75  # of J's output, times the drive of total deprivation
WEIGHT_TOP, WEIGHT_FLOOR = 0.42, 0.055  # of the relative loss weight, times the same
CHANGE = 0.1  # change of a deviation that counts as one unit in L_f, times its scale
LENGTH = 0.5  # the same for a position, times half the extent; angles in radians, durations in strides
ADVICE = "Lower learner.learning_rate, or bound the needs of the species."
ZETA = 2.0  # exponent of the law of the length of explored walks
BLANK = {"movement": -1, "curiosity": 1.0, "loss_f": math.nan, "loss_j": math.nan}  # of a life that begins; all else 0
TRAIL = 64  # ticks of a movement whose states are kept on the way


@dataclass(frozen=True, kw_only=True)
class HJBSettings:
    """Everything that can be set; times are in units of time, not ticks."""

    gamma: float = 0.995  # discount per unit of time
    youth: float = 1000.0  # units of time in which exploration falls from that at birth to 1/e of the way to adults
    epsilon: float = 0.1  # share of exploratory movements at birth
    epsilon_final: float = 0.05  # share of exploratory movements of adults
    settling: float = 4000.0  # units of time in which the learning rate falls to a half
    tries: int = 1  # times that an open movement is tried before scores decide
    persistence: int = 8  # most strides that an exploratory walk without optimism is repeated (Dabney et al. 2021)
    width: int = 64  # units of each of the two hidden layers of f and J
    learning_rate: float = 4e-3  # learning rate at birth
    learning_rate_final: float = 4e-4  # learning rate of adults
    adaptive_steps: bool = True  # a decision lasts as long as its movement (paper, "adaptive time steps")
    bearings: bool = True  # a turn and the walk after it are one movement
    stride: float = 10.0  # length of a move
    pause: float = 40.0  # length of a rest
    meal: float = 5.0  # length of a meal
    finite_difference: bool = True  # the HJB score over a whole movement instead of its first-order limit
    minimum_in_loss: bool = True  # L_J is the residual of the HJB equation, its min included
    replay: bool = True  # learn from remembered decisions, not the newest alone (Mnih et al. 2015)
    intra_option: bool = True  # learn from states within a movement too (Sutton, Precup and Singh 1999)
    batch: int = 64  # decisions per gradient step on L_J
    batch_f: int = 128  # decisions per gradient step on L_f
    recent_share: float = 0.4  # share of a batch that comes from the last `recent` decisions
    recent: int = 300  # decisions that count as recent
    memory: int = 12_000  # decisions in the replay buffer
    update_every: float = 1.0  # units of time between updates
    updates: int = 3  # gradient steps on L_f and L_J per update
    warm_up: int = 16  # decisions before the first update
    place_cells: int = 64  # Gaussian bumps of position, recruited where the agent has been; 0: none
    place_spacing: float = 0.75  # length between centres
    place_width: float = 0.6  # length, standard deviation of a bump
    optimism: float = 0.15  # share by which J of an unknown place is taken to be lower
    optimism_young: float = 0.1  # what is added to it at birth, as a share of the drive of total deprivation
    depth: int = 3  # movements that a decision looks ahead
    beam: int = 24  # predicted states kept at each movement of the lookahead
    errors: int = 64  # latest decisions whose errors of f are remembered and corrected; 0: none
    marks: int = 256  # places that an agent can know to have reached or aimed at
    mark_reach: float = 1.25  # length around a place reached that counts as known
    aim_reach: float = 0.5  # length around a place aimed at in vain that counts as known
    boredom: float = 0.1  # rate at which curiosity follows the share of attempts that found a new place
    near: float = 0.25  # length, standard deviation of the kernel that weighs remembered errors by distance
    near_angle: float = 0.6  # radians, standard deviation of the same kernel for angles
    searched: int = 4000  # latest decisions that are searched for the open movements at a predicted state
    imagined: float = 0.5  # share of J's batch whose needs are redrawn, the rest of zeta kept
    relative_weight: bool = True  # L_J weighs small drives more
    learn_value: bool = True  # the network of J learns V = d - Jn, so that J begins as the drive
    target_network: bool = True  # a slow copy of J in the target (Lillicrap et al. 2016), by which an agent acts
    polyak: float = 0.03  # share by which the slow copy follows J per gradient step
    target_explores: bool = True  # the target is that of an agent that explores with `epsilon_final`
    lazy_heads: bool = False  # Adam does not move heads of f that no decision of the batch trained
    inherit: bool = False  # a newborn starts from what its parent has learned, not from nothing
    mutation: float = 0.0  # standard deviation of inherited weights, relative to each layer's root mean square

    def __post_init__(self) -> None:
        for names, rule, holds in RULES:
            for name in names:
                value = getattr(self, name)
                if not (math.isfinite(value) and holds(value)):
                    raise EcologyError(f"learner setting {name} must be {rule}, got {value!r}.")


RULES: tuple[tuple[tuple[str, ...], str, Callable[[float], bool]], ...] = (
    (("gamma",), "between 0 and 1, both excluded", lambda v: 0 < v < 1),
    (
        ("epsilon", "epsilon_final", "recent_share", "imagined", "optimism", "optimism_young"),
        "from 0 to 1",
        lambda v: 0 <= v <= 1,
    ),
    (("place_cells", "mutation", "errors", "tries"), "0 or more", lambda v: v >= 0),
    (
        ("width", "batch", "batch_f", "recent", "memory", "updates", "persistence", "depth", "beam", "searched"),
        "1 or more",
        lambda v: v >= 1,
    ),
    (("place_spacing", "place_width"), "a length of at least 0.001", lambda v: v >= 1e-3),
    (
        ("youth", "settling", "learning_rate", "learning_rate_final", "stride", "pause", "meal", "update_every"),
        "positive and finite",
        lambda v: v > 0,
    ),
)


# Algorithm 1 as printed: newest transition, executed action, first-order score, fixed time step
ALGORITHM1: Mapping[str, Any] = {
    "adaptive_steps": False,
    "bearings": False,
    "finite_difference": False,
    "minimum_in_loss": False,
    "replay": False,
    "update_every": 1.0,
    "place_cells": 0,
    "imagined": 0.0,
    "optimism": 0.0,
    "relative_weight": False,
    "persistence": 1,
    "intra_option": False,
    "target_network": False,
    "lazy_heads": True,
    "depth": 1,
    "errors": 0,
    "tries": 0,
    "updates": 1,
    "polyak": 0.1,
    "target_explores": False,
    "learn_value": False,
    "gamma": 0.99,
    "learning_rate": 1e-3,
    "learning_rate_final": 1e-3,
    "epsilon": 0.3,
    "epsilon_final": 0.3,
}


# the least work that was found to beat camping in every seed of `paper`: see docs/performance.md
LEAN: Mapping[str, Any] = {
    "width": 32,
    "batch": 32,
    "batch_f": 64,
    "update_every": 8.0,
    "updates": 1,
    "depth": 1,
    "errors": 0,
}


class HJB(Learner):
    """n agents that learn f and J online, each from its own life.

    Networks, place cells and memories are held by a `Device`, which computes scores and updates; which
    movement is under way is kept here.
    """

    devices = True
    decides = True

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the settings by name with their defaults."""
        return dataclasses.asdict(HJBSettings())

    @classmethod
    def with_settings(
        cls, group: Group, seed: np.random.SeedSequence, settings: Mapping[str, Any], device: str = "cpu"
    ) -> HJB:
        """Return n learners with `settings` by name, all of `defaults`, that compute on `device`."""
        known = cls.defaults()
        checked = {}
        for name, value in settings.items():
            kind = type(known[name])
            if kind is float and isinstance(value, int) and not isinstance(value, bool):
                value = float(value)
            if type(value) is not kind:
                raise EcologyError(f"learner setting {name} is of type {kind.__name__}, got {value!r}.")
            checked[name] = value
        return cls(group, seed, HJBSettings(**checked), device)

    def __init__(
        self,
        group: Group,
        seed: np.random.SeedSequence,
        settings: HJBSettings | None = None,
        device: str = "cpu",
    ) -> None:
        super().__init__(group, seed)
        self.settings = s = settings or HJBSettings()
        n = group.size
        self.moves: Movements = (
            adaptive(group, bearings=s.bearings, stride=s.stride, pause=s.pause, meal=s.meal)
            if s.adaptive_steps
            else single_ticks(group)
        )
        layout = group.layout
        kinds = np.array(layout.kinds)
        self.components, self.count = len(kinds), len(self.moves.names)
        self.cells = s.place_cells if np.sum(kinds == "position") >= 2 else 0
        self.hopes = self.cells > 0 and s.optimism > 0 and s.finite_difference
        self.senses = self._senses()
        self.device = at = devices.make(device, self.senses, n)
        # the seed's first child, made here: `seed.spawn` would change the caller's seed
        child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 0), pool_size=seed.pool_size)
        draw = np.random.default_rng(child)
        self.generator = np.random.default_rng(draw.integers(2**62))
        angles = int(np.sum(kinds == "angle"))
        inputs = len(kinds) + angles + self.cells
        w = s.width
        self.f = Perceptrons(n, (inputs, w, w, self.count * (self.components + 1)), self.generator, at, self.count)
        self.J = Perceptrons(n, (inputs, w, w, 1), self.generator, at)
        # a slow copy of J, or J's own weights where it is switched off
        self.target = self.J.weights + 0 if s.target_network else self.J.weights
        self.memory = Memory(n, s.memory if s.replay else 1, self.components, self.count, at)
        self.cell_centre = at.zeros((n, 2, self.cells), np.float32)
        self.cell_count = at.zeros((n,), np.int64)
        self.hope = at.zeros((n, 2), np.float32)
        self.curiosity = Curiosity(n, s.marks if self.hopes else 0, s.mark_reach, s.aim_reach, s.boredom, at)
        self.cell_names = at.on(np.arange(self.cells))
        self.brains = kernels.Brains(
            self.f.weights, self.f.first, self.f.second, self.f.steps,
            self.J.weights, self.J.first, self.J.second, self.J.steps,
            self.target, self.cell_centre, self.cell_count, self.hope, self.curiosity.marks, self.curiosity.marked,
        )  # fmt: skip
        m = self.memory
        w = len(self.senses.where)
        self.trace = kernels.Trace(
            np.zeros((n, s.errors, w), np.float32),
            np.zeros((n, s.errors), np.int16),
            np.zeros((n, s.errors, self.components + 1), np.float32),
            np.zeros((n, s.errors), np.float32),
            np.zeros(n, np.int64),
        )
        self.ring = kernels.Ring(m.zeta, m.after, m.duration, m.movement, m.open, m.count)

        # the movement under way, one row per slot
        self.movement = np.full(n, -1)
        self.stage = np.zeros(n, np.int64)
        self.left = np.zeros(n, np.int64)  # ticks of the stage that are left
        self.elapsed = np.zeros(n, np.int64)  # ticks since the decision
        self.began = np.zeros((n, self.components), np.float32)  # zeta at the decision
        self.was_open = np.zeros((n, self.count), bool)
        self.trail = np.zeros((n, TRAIL, self.components), np.float32)  # zeta on the way, by ticks elapsed
        self.trail_open = np.zeros((n, TRAIL, self.count), bool)
        self.way = kernels.Way(self.movement, self.stage, self.left, self.elapsed, self.trail, self.trail_open)
        self.free = np.zeros(n, bool)  # who has no movement to go on with
        # what the next decision is on, as an update has scored it; nothing is open where it has not
        self.ahead = kernels.Ahead(
            np.zeros((n, self.components), np.float32),
            np.zeros((n, self.count), bool),
            np.zeros((n, self.count), np.float32),
        )
        self.more = np.zeros(n, np.int64)  # strides that an explored walk goes on for
        self.age = np.zeros(n, np.int64)  # ticks learned
        self.clock = np.zeros(n, np.int64)  # ticks acted
        self.ticks = 0
        self.exploration: float | None = None  # fixed epsilon, in evaluation
        self._trained: tuple[Any, list[np.ndarray]] = ({}, [])  # random stream and memory of errors after learning
        self.loss_f, self.loss_j = np.full(n, np.nan), np.full(n, np.nan)
        self.decisions = np.zeros(n, np.int64)
        self.tried = np.zeros((n, self.count), np.int64)
        self.explores = np.full(n, -1, np.int8)  # whether the movement under way explores, -1 unknown: for observers
        self._followed: frozenset[int] = frozenset()  # slots whose decisions are kept
        self._kept: dict[int, tuple[Decision, int]] = {}  # by slot, with its clock at the decision

    def _senses(self) -> kernels.Senses:
        """Return what all agents share, for the kernels."""
        s, layout = self.settings, self.group.layout
        kinds = np.array(layout.kinds)
        needs, angles, places = kinds == "deviation", kinds == "angle", np.flatnonzero(kinds == "position")
        mix, felt, exponent = drive_terms(layout)
        mix_from, mix_to = map(np.ascontiguousarray, np.nonzero(mix))  # else kernels are compiled for strides too
        can = needs & layout.regulated & (layout.low < 0)  # needs that can be deprived
        deprived = layout.scale[can] if can.any() else layout.scale[needs]
        above, power = drive_bend(layout)
        worst = float(np.sqrt(np.sum(deprived**2))) ** exponent  # drive of total deprivation
        bent = bool(power != 2 or (above != 1).any())
        if bent or (layout.below != 1).any():
            lacking = (deprived * layout.below[can if can.any() else needs]) ** power
            worst = float(np.sum(lacking)) ** (exponent / power)
        unit = np.where(needs | (kinds == "felt"), CHANGE * layout.scale, LENGTH * layout.scale)
        unit = np.append(np.where(angles, 1.0, unit), s.stride if s.adaptive_steps else self.group.dt)
        placed, centre = kinds == "position", np.zeros(len(kinds))
        centre[placed] = (layout.low[placed] + layout.high[placed]) / 2
        f4 = np.float32
        where = np.flatnonzero(~needs & (kinds != "felt"))
        return kernels.Senses(
            centre=centre.astype(f4),
            inverse=(1 / layout.scale).astype(f4),
            scale=layout.scale.astype(f4),
            low=np.where(angles, -1e30, np.maximum(layout.low, -1e30)).astype(f4),
            high=np.where(angles, 1e30, np.minimum(layout.high, 1e30)).astype(f4),
            unit=unit.astype(f4),
            plain=np.flatnonzero(~angles),
            angle=np.flatnonzero(angles),
            place=places[:2] if self.cells else np.zeros(2, np.int64),
            need=needs,
            deprivable=np.flatnonzero(can),
            mix_from=mix_from,
            mix_to=mix_to,
            mix_weight=mix[mix_from, mix_to],
            felt=felt,
            epsilon=f4(layout.epsilon),
            exponent=f4(exponent),
            root=f4(exponent) * f4(0.5) if power == 2 else f4(exponent / power),
            power=f4(power),
            above=above,
            bent=bent,
            sharp=f4(s.place_width**-2),
            log_gamma=f4(elementary.logarithm(s.gamma)),
            dt=f4(self.group.dt),
            centre_j=f4(worst * J_CENTRE),
            spread_j=f4(worst * J_SPREAD),
            ceiling=f4(worst * J_CEILING),
            weight_top=f4(worst * WEIGHT_TOP * s.relative_weight),
            weight_floor=f4(worst * WEIGHT_FLOOR),
            deprived=f4(DEPRIVED),
            sated=f4(SATED),
            width=s.width,
            movements=self.count,
            finite=s.finite_difference,
            minimum=s.minimum_in_loss,
            polyak=f4(s.polyak),
            anchored=s.learn_value,
            slow=s.target_network,
            lazy=s.lazy_heads,
            where=where,
            nearness=np.select(
                [kinds[where] == "position", kinds[where] == "angle"],
                [1 / s.near, 1 / s.near_angle],
                2 / layout.scale[where],
            ).astype(f4),
            turning=kinds[where] == "angle",
            length=self.moves.length.astype(f4),
            explored=f4(s.epsilon_final * s.target_explores),
            depth=s.depth,
            beam=s.beam,
            searched=s.searched,
        )

    # ---- births and deaths ----------------------------------------------------------------

    def died(self, slots: np.ndarray) -> None:
        """Drop the movements under way in `slots` (k,)."""
        self.movement[slots] = -1
        self._forget(slots)

    def interrupted(self, slots: np.ndarray) -> None:
        """Drop the movements under way in `slots` (k,): where they would have led is not known."""
        self.died(slots)

    def born(self, slots: np.ndarray, parents: np.ndarray) -> None:
        """Begin a new life in `slots` (k,), from nothing or from what `parents` (k,) know; all in place."""
        self._forget(slots)
        for name, array in self._life().items():
            array[slots] = BLANK.get(name, 0)
        self.f.forget(slots)
        self.J.forget(slots)
        own = (parents >= 0) & self.settings.inherit
        new, heirs = slots[~own], slots[own]
        self.f.redraw(new)
        self.J.redraw(new)
        blank, to, from_ = (self.device.on(rows) for rows in (new, heirs, parents[own]))
        self.target[blank] = self.J.weights[blank]
        for array in (self.cell_centre, self.cell_count, *self.curiosity.places):
            array[blank] = 0
        for array in (
            self.f.weights, self.J.weights, self.target, self.cell_centre, self.cell_count, *self.curiosity.places,
        ):  # fmt: skip
            array[to] = array[from_]
        for known in (self.curiosity.level, self.tried):
            known[heirs] = known[parents[own]]
        if self.settings.mutation > 0:
            self.f.mutate(heirs, self.settings.mutation)
            noise = self.J.mutate(heirs, self.settings.mutation)
            if self.settings.target_network:
                self.target[to] += noise  # it mutates with J

    # ---- acting ---------------------------------------------------------------------------

    def begin(self) -> None:
        """Drop the movements under way: the next observation does not follow from the last."""
        self.movement[:] = -1
        self._kept.clear()

    def evaluating(self, epsilon: float) -> None:
        """Stop learning and explore with `epsilon` from now on.

        Whatever has been lived in evaluation is forgotten, so evaluations do not depend on their order.
        """
        if self.learning:
            self._trained = self.rng.bit_generator.state, [array.copy() for array in (*self.trace, self.clock)]
        else:
            stream, arrays = self._trained
            self.rng.bit_generator.state = stream
            for array, kept in zip((*self.trace, self.clock), arrays, strict=True):
                array[...] = kept
        self.learning = False
        self.exploration = epsilon
        self.begin()

    def epsilon(self) -> np.ndarray:
        """Return the exploration rate of every agent, (n,), by its age."""
        if self.exploration is not None:
            return np.full(self.size, self.exploration)
        s = self.settings
        left = elementary.exp(-self.age * self.group.dt / s.youth)
        return s.epsilon_final + (s.epsilon - s.epsilon_final) * left

    def _hope(self) -> None:
        """Set how much lower J of unknown places is taken to be; nothing in evaluation.

        The share grows with what is at stake, so an agent whose needs are met stays, and one that lacks something
        searches. The young search even when they lack nothing.
        """
        if self.hopes:
            s, level = self.settings, self.curiosity.level * (self.exploration is None)
            young = elementary.exp(-self.age * self.group.dt / s.youth) * self.senses.centre_j / J_CENTRE
            hope = np.column_stack([s.optimism * level, s.optimism_young * level * young])
            self.hope[...] = self.device.on(hope.astype(np.float32))

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Go on with the movements under way, decide where one has ended, and return actions (n,)."""
        self.clock += 1
        actions = np.empty(self.size, np.int64)
        keep = self.learning and self.settings.intra_option
        if kernels.go_on(self.moves.action, self.moves.ticks, self.way, masks, observations, keep, self.free, actions):
            free = np.flatnonzero(self.free)
            ended = free[self.movement[free] >= 0]
            if ended.size:
                if self.settings.errors or self.hopes:
                    self._note(ended, observations)
                if self.learning:
                    self._remember(ended, observations)
            deciding = free[masks[free].any(axis=1)]
            if deciding.size:
                self._decide(deciding, observations[deciding], masks[deciding])
            self.left[free] -= 1
            self.elapsed[free] += 1
            actions[free] = self.moves.action[self.movement[free], self.stage[free]]
        self.ahead.open[:] = False  # it was about this tick
        return actions

    def _decide(self, slots: np.ndarray, observations: np.ndarray, masks: np.ndarray) -> None:
        """Choose a movement for the agents in `slots` (k,): epsilon-greedy in the HJB score."""
        open_ = self.moves.open(masks)  # (k, M)
        drawn = self.rng.random((self.size, 2))[slots]
        explores = drawn[:, 0] < self.epsilon()[slots]
        choice = open_
        if self.learning and self.settings.tries:
            untried = open_ & (self.tried[slots] < self.settings.tries)
            some = untried.any(axis=1)
            choice = np.where(some[:, None], untried, open_)
            explores |= some
        chosen = self.moves.explore(choice, drawn[:, 1])
        knows = np.flatnonzero(~explores)
        compared: np.ndarray | None = None  # scores (k, M) by which those choose that do not explore
        self._hope()
        if knows.size:
            score = self._scores(slots[knows], observations[knows], open_[knows])
            if np.isnan(score).any() or np.isneginf(score).any():
                bad = int(slots[knows[np.flatnonzero(~(score > -np.inf).all(axis=1))[0]]])
                raise DivergedError("f or J", self.group.slots.start + bad, ADVICE)
            chosen[knows] = score.argmin(axis=1)
            compared = np.full(open_.shape, np.nan, np.float32)
            compared[knows] = score
        if self.learning and self.settings.persistence > 1 and not self.hopes:
            walks = self._persist(slots, chosen, explores, open_)
            chosen, explores = walks, explores | (walks != chosen)
        self.explores[slots] = explores
        if self._followed:
            self._keep(slots, observations, masks, chosen, compared)
        self.movement[slots] = chosen
        self.stage[slots] = 0
        self.left[slots] = self.moves.ticks[chosen, 0]
        self.elapsed[slots] = 0
        self.began[slots] = observations
        self.was_open[slots] = open_
        self.decisions[slots] += 1
        self.tried[slots, chosen] += 1
        if self.cells and self.learning:
            self._recruit(slots, observations)

    def _scores(self, slots: np.ndarray, observations: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the HJB scores (k, M) of what is open to `slots` (k,), as the last update left them where it did."""
        ahead = self.ahead
        there = (ahead.open[slots] == open_).all(axis=1) & (ahead.zeta[slots] == observations).all(axis=1)
        score, rest = ahead.score[slots], np.flatnonzero(~there)
        if rest.size:
            score[rest] = self.scores(slots[rest], observations[rest], open_[rest])
        return score

    def scores(self, slots: np.ndarray, zeta: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the score (k, M), drive units, of the open movements of `slots` (k,) at zeta (k, D); else infinity."""
        return self.device.scores(self.brains, self.ring, self.trace, self._now()[slots], slots, zeta, open_)

    def _now(self) -> np.ndarray:
        """Return for how long every agent has acted, (n,), units of time."""
        return (self.clock * self.group.dt).astype(np.float32)

    def _persist(self, slots: np.ndarray, chosen: np.ndarray, explores: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the movements (k,) with explored walks gone on with; their lengths follow a zeta law.

        One step at random and then back to what is known explores a corner of the arena for ever
        (Dabney, Ostrovski and Barreto 2021, temporally extended epsilon-greedy exploration).
        """
        onward = self.moves.onward[self.movement[slots]]
        drawn = np.minimum(self.rng.zipf(ZETA, self.size)[slots], self.settings.persistence)
        goes_on = (self.more[slots] > 0) & (self.movement[slots] >= 0) & (onward >= 0)
        goes_on &= open_[np.arange(len(slots)), onward]
        self.more[slots] = np.where(goes_on, self.more[slots] - 1, np.where(explores, drawn - 1, 0))
        return np.where(goes_on, onward, chosen)

    def _recruit(self, slots: np.ndarray, observations: np.ndarray) -> None:
        """Give a place cell to those of `slots` who stand farther than the spacing from all of theirs."""
        at, here = self.device.on(slots), self.device.on(observations[:, self.senses.place])  # (k), (k, 2)
        gap = ((self.cell_centre[at] - here[:, :, None]) ** 2).sum(1)  # (k, C)
        count = self.cell_count[at]
        far = (gap > self.settings.place_spacing**2) | (self.cell_names >= count[:, None])
        new = far.all(1) & (count < self.cells)
        self.cell_centre[at[new], :, count[new]] = here[new]
        self.cell_count[at[new]] += 1

    # ---- learning -------------------------------------------------------------------------

    def _note(self, slots: np.ndarray, observations: np.ndarray) -> None:
        """Note by how much f was wrong in the movements of `slots` that have just ended."""
        trace, senses = self.trace, self.senses
        began, movement = self.began[slots], self.movement[slots]
        expected = self.device.expected(self.brains, slots, began, movement)
        met = np.column_stack([observations[slots] - began, self.elapsed[slots] * self.group.dt])
        error = (met - expected).astype(np.float32)
        error[:, senses.angle] = np.remainder(error[:, senses.angle] + np.pi, 2 * np.pi) - np.pi
        if self.learning and self.hopes:
            place = senses.place
            aimed = np.clip(began[:, place] + expected[:, place], senses.low[place], senses.high[place])
            self.curiosity.learn(slots, aimed, observations[slots][:, place])
        if not self.settings.errors:
            return
        at = trace.count[slots] % self.settings.errors
        trace.where[slots, at] = began[:, senses.where]
        trace.movement[slots, at] = movement
        trace.error[slots, at] = error
        trace.time[slots, at] = self._now()[slots]
        trace.count[slots] += 1

    def _remember(self, slots: np.ndarray, observations: np.ndarray) -> None:
        """Store the movements of `slots` that have just ended at `observations` (n, D).

        With `intra_option`, a state passed on the way is stored too. If the world ended the
        movement (an arrival, a full stomach), the same movement from there has the same end; else what it
        would have led to is unknown, and the state serves L_J alone.
        """
        after, elapsed = observations[slots], self.elapsed[slots]
        took = elapsed * self.group.dt
        movement = self.movement[slots]
        self.memory.add(slots, self.began[slots], movement, after, took, self.was_open[slots])
        if not self.settings.intra_option:
            return
        draw = self.rng.random(self.size)[slots]
        passed = 1 + np.floor(draw * (np.minimum(elapsed, TRAIL) - 1)).astype(np.int64)
        # where the world leaves no choice (asleep), zeta alone does not tell how bad the future is
        some = (elapsed > 1) & (self.trail_open[slots, np.minimum(passed, TRAIL - 1)].sum(axis=1) > 1)
        second = (self.stage[slots] == 1) & (passed >= self.moves.ticks[movement, 0])
        same = np.where(second, self.moves.walk, np.where(self.stage[slots] == 0, movement, -1))
        same = np.where(self.left[slots] > 0, same, -1)
        slots, passed = slots[some], passed[some]
        self.memory.add(
            slots,
            self.trail[slots, passed],
            same[some],
            after[some],
            took[some] - passed * self.group.dt,
            self.trail_open[slots, passed],
        )

    def learn(self, transition: Transition) -> None:
        """Take in one tick; at fixed intervals take a gradient step on L_f and L_J for all agents."""
        self.age += transition.alive
        self.ticks += 1
        s = self.settings
        if self.ticks % max(1, round(s.update_every / self.group.dt)) == 0:
            ready = (self.memory.count >= (s.warm_up if s.replay else 1)) & transition.alive
            if ready.any():
                deciding = ready & (self.left <= 0)
                self.ahead.zeta[:] = transition.next_observations
                if s.depth == 1 and not s.errors:
                    self.ahead.open[:] = self.moves.open(transition.next_masks) & deciding[:, None]
                for _ in range(s.updates):
                    self._update(ready)

    def rate(self) -> np.ndarray:
        """Return the learning rate of every agent, (n,), by its age."""
        s = self.settings
        return np.maximum(s.learning_rate / (1 + self.age * self.group.dt / s.settling), s.learning_rate_final)

    def compile_update(self) -> None:
        """Compile the update, which the first ticks do without, by updating no agent."""
        self._update(np.zeros(self.size, bool))

    def _update(self, ready: np.ndarray) -> None:
        """Take one gradient step on L_f and L_J for the agents that are `ready` (n,)."""
        s, n = self.settings, self.size
        b, bf = (s.batch, s.batch_f) if s.replay else (1, 1)
        m = round(s.imagined * b)
        draws = kernels.Draws(
            uniform=self.device.uniform(self.generator, (n, b + bf + m * self.components + m + m // 2)),
            normal=self.device.normal(self.generator, (n, m // 2, self.components)),
            batch=b,
            batch_f=bf,
            recent=s.recent,
            late=round(b * s.recent_share),
            late_f=round(bf * s.recent_share),
            imagined=m,
        )
        self._hope()
        self.device.update(self.brains, self.ring, draws, ready, self.rate(), self.loss_f, self.loss_j, self.ahead)
        bad = np.flatnonzero(ready & ~(np.isfinite(self.loss_f) & np.isfinite(self.loss_j)))
        if bad.size:
            raise DivergedError("L_f or L_J", self.group.slots.start + int(bad[0]), ADVICE)

    # ---- what it has become ---------------------------------------------------------------

    def _life(self) -> dict[str, np.ndarray]:
        """Return every array here that changes and starts blank at birth, by name."""
        own = (
            "movement", "stage", "left", "elapsed", "began", "was_open", "more",
            "trail", "trail_open", "age", "clock", "tried", "loss_f", "loss_j", "decisions",
        )  # fmt: skip
        trace = {f"trace.{name}": array for name, array in self.trace._asdict().items()}
        ahead = {f"ahead.{name}": array for name, array in self.ahead._asdict().items()}
        return (
            {name: getattr(self, name) for name in own}
            | {"curiosity": self.curiosity.level}
            | ahead
            | trace
            | {"memory.count": self.memory.count}
        )

    def _held(self) -> dict[str, Any]:
        """Return every array that the device holds, by name."""
        found = {name: getattr(self, name) for name in ("target", "cell_centre", "cell_count", "hope")}
        found |= {"marks": self.curiosity.marks, "marked": self.curiosity.marked}
        for name, network in (("f", self.f), ("J", self.J)):
            found[name] = network.weights
            found |= {f"adam_{name}.{part}": getattr(network, part) for part in ("first", "second", "steps")}
        for name in ("zeta", "after", "duration", "movement", "open"):
            found[f"memory.{name}"] = getattr(self.memory, name)
        return found

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the agents have become: arrays, and plain values that JSON holds."""
        streams = {"rng": self.rng.bit_generator.state, "generator": self.generator.bit_generator.state}
        held = {name: self.device.off(array) for name, array in self._held().items()}
        return held | self._life(), {**streams, "ticks": self.ticks}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Become what `state` returned; EcologyError where it does not fit this learner."""
        self._kept.clear()
        self.explores[:] = -1
        held, life = self._held(), self._life()
        low = dict.fromkeys(("movement", "memory.movement", "trace.movement"), -1) | {"left": None}
        below = dict.fromkeys(("movement", "memory.movement", "trace.movement"), self.count)
        below |= {"stage": 2, "left": ARRIVES + 1, "marked": self.curiosity.capacity + 1}
        for name, here in (held | life).items():
            if name not in arrays:
                raise EcologyError(f"the checkpoint does not fit the learner: it has no {name}.")
            whole = arrays[name].dtype.kind == "i"
            checkpoint.check_array(
                name,
                arrays[name],
                here,
                finite=name not in ("loss_f", "loss_j", "ahead.score"),
                low=low.get(name, 0) if whole else None,
                below=below.get(name),
            )
        if type(values["ticks"]) is not int or values["ticks"] < 0:
            raise EcologyError(f"the checkpoint's ticks are a whole number of at least 0, got {values['ticks']!r}.")
        for name, array in held.items():
            array[...] = self.device.on(arrays[name])
        for name, array in life.items():
            array[...] = arrays[name]
        self.rng.bit_generator.state = values["rng"]
        self.generator.bit_generator.state = values["generator"]
        self.ticks = int(values["ticks"])

    # ---- what others may see --------------------------------------------------------------

    def report(self) -> Mapping[str, np.ndarray]:
        """Return L_f, L_J, epsilon and the number of decisions, each (n,)."""
        return {
            "loss_f": self.loss_f,
            "loss_J": self.loss_j,
            "epsilon": self.epsilon(),
            "decisions": self.decisions,
        }

    def deviation(self, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return -ln(gamma) J in drive units, (m,) at states (m, D), for the agent in `slot`."""
        zeta = np.ascontiguousarray(zeta, np.float32)
        return self.device.value(self.brains, slot, zeta)

    def slope(self, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return the derivative of `deviation` by zeta, (m, D) at states (m, D)."""
        return self.device.slope(self.brains, slot, np.ascontiguousarray(zeta, np.float32))

    def predict(self, slot: int, zeta: np.ndarray) -> dict[str, Any]:
        """Return f at states (m, D): movement names, change (m, M, D), duration (m, M)."""
        zeta = np.ascontiguousarray(zeta, np.float32)
        raw = self.device.forecast(self.brains, slot, zeta)
        raw = raw.reshape(len(zeta), self.count, self.components + 1) * self.senses.unit
        duration = raw[..., -1].clip(self.group.dt, kernels.LONGEST)
        return {"names": self.moves.names, "change": raw[..., :-1], "duration": duration}

    def follow(self, slots: Collection[int]) -> None:
        """Keep what the agents in `slots` weigh when they decide."""
        self._followed = frozenset(int(slot) for slot in slots)
        self._kept = {slot: kept for slot, kept in self._kept.items() if slot in self._followed}

    def _forget(self, slots: np.ndarray) -> None:
        """Forget what those in `slots` (k,) last decided."""
        for slot in np.atleast_1d(slots).tolist():
            self._kept.pop(slot, None)

    def _keep(
        self,
        slots: np.ndarray,
        observations: np.ndarray,
        masks: np.ndarray,
        chosen: np.ndarray,
        compared: np.ndarray | None,
    ) -> None:
        """Keep the decisions of those of `slots` (k,) that are followed, with the scores (k, M) that they `compared`.

        Where the world leaves one option, and it is the one under way, nothing is decided: the agent sleeps on.
        """
        for row, slot in enumerate(slots.tolist()):
            if slot not in self._followed:
                continue
            weighed = self.weigh(slot, observations[row], masks[row])
            known = np.full(self.count, np.nan) if compared is None else compared[row]
            decision = dataclasses.replace(
                weighed,
                score=np.where(weighed.open & np.isfinite(known), known, weighed.score),
                taken=int(chosen[row]),
                explored=bool(self.explores[slot]),
                length=self._length(int(chosen[row])),
            )
            if slot in self._kept and decision.open.sum() == 1 and self._kept[slot][0].taken == decision.taken:
                continue
            self._kept[slot] = decision, int(self.clock[slot])

    def _length(self, movement: int) -> int | None:
        """Return the ticks that a movement takes, None where the world ends it."""
        lasts = int(self.moves.ticks[movement].sum())
        return None if lasts >= ARRIVES else max(lasts, int(self.moves.length[movement]))

    def decision(self, slot: int) -> Decision | None:
        """Return the decision that the agent in `slot` acts on, None before its first one."""
        if slot in self._kept:
            kept, made = self._kept[slot]
            return dataclasses.replace(kept, age=int(self.clock[slot]) - made + 1)
        taken = int(self.movement[slot])
        if taken < 0:
            return None
        decision = dataclasses.replace(
            self._weigh(slot, self.began[slot], self.was_open[slot]),
            taken=taken,
            explored=None if self.explores[slot] < 0 else bool(self.explores[slot]),
            age=int(self.elapsed[slot]),
            length=self._length(taken),
            recalled=True,
        )
        if slot in self._followed:
            self._kept[slot] = decision, int(self.clock[slot]) - decision.age + 1
        return decision

    def weigh(self, slot: int, zeta: np.ndarray, mask: np.ndarray) -> Decision:
        """Return what the agent in `slot` would decide at zeta (D,) with the actions of `mask` (A,) open.

        Over a whole movement of duration tau, dJ/dzeta . f is the mean slope (J(zeta') - J(zeta)) / tau; without
        `finite_difference`, the slope at zeta.
        """
        return self._weigh(slot, zeta, self.moves.open(mask[None])[0])

    def _weigh(self, slot: int, zeta: np.ndarray, open_: np.ndarray) -> Decision:
        """Return what the agent in `slot` would decide at zeta (D,) with the movements `open_` (M,)."""
        s, layout = self.settings, self.group.layout
        told = self.predict(slot, zeta[None])
        change, duration = told["change"][0], told["duration"][0]  # (M, D), (M,)
        whole = s.finite_difference
        step = duration if whole else np.full(len(duration), self.group.dt)
        after = zeta + change * (step / duration)[:, None]
        if whole:
            angle = np.array(layout.kinds) == "angle"
            after = np.clip(after, np.where(angle, -np.inf, layout.low), np.where(angle, np.inf, layout.high))
        here = float(self.deviation(slot, zeta[None])[0])
        ahead = self.deviation(slot, after.astype(np.float32))
        if whole:
            slope = (ahead - here) / (-np.log(s.gamma) * step)
        else:
            slope = self.slope(slot, zeta[None])[0] @ (change / duration[:, None]).T / -np.log(s.gamma)
        at, every = np.ascontiguousarray(zeta[None], np.float32), np.ones((1, self.count), bool)
        open_, here_slot = open_[None], np.array([slot])  # what is open competes for the beam alone
        score = np.where(open_, self.scores(here_slot, at, open_), self.scores(here_slot, at, every))[0]
        inherited = s.inherit and self.tried[slot].sum() > self.decisions[slot]  # a heir has its parent's tries
        return Decision(
            options=self.moves.names,
            open=open_[0],
            next_drive=self.drive(after),
            slope=slope,
            score=score,
            taken=int(np.where(open_[0], score, np.inf).argmin()),
            explored=False,
            learned=bool(np.isfinite(self.loss_j[slot]) or inherited),
            value=here,
            gamma=s.gamma,
            error=self._error(slot),
        )

    def _error(self, slot: int, last: int = 64) -> np.ndarray:
        """Return the error of f per component over the `last` decisions, relative to the changes met, (D,)."""
        memory, newest = self.memory, int(self.memory.count[slot])
        at = np.arange(max(newest - min(last, memory.capacity), 0), newest) % memory.capacity
        rows = self.device.on(at)
        began, met, taken = (self.device.off(part[slot, rows]) for part in (memory.zeta, memory.after, memory.movement))
        kept = taken >= 0
        if kept.sum() < 2:
            return np.full(self.components, np.nan)
        change, taken = (met - began)[kept], taken[kept]
        predicted = self.predict(slot, began[kept])["change"][np.arange(len(taken)), taken]
        angle = np.array(self.group.layout.kinds) == "angle"
        change[:, angle] = (change[:, angle] + np.pi) % (2 * np.pi) - np.pi
        size = np.sqrt(np.square(change).mean(0))
        error = np.sqrt(np.square(predicted - change).mean(0))
        return np.divide(error, size, out=np.full(self.components, np.nan), where=size > 1e-9)
