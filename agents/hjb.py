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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from agents.base import DivergedError, Learner, Transition, drive_terms
from agents.memory import Memory
from agents.movements import Movements, adaptive, single_ticks
from agents.networks import Adam, Perceptrons, rows
from ecology import EcologyError, Group
from ecology.errors import nearest

DEPRIVED, SATED = -1.0, 0.4  # imagined deviations lie between these, times x*
J_CENTRE, J_SPREAD, J_CEILING = 0.45, 0.55, 2.75  # of J's output, times the drive of total deprivation
WEIGHT_TOP, WEIGHT_FLOOR = 0.42, 0.055  # of the relative loss weight, times the same
CHANGE = 0.1  # change of a deviation that counts as one unit in L_f, times its scale
LENGTH = 0.5  # the same for a position, times half the extent; angles in radians, durations in strides
FAR = -30.0  # exponent of a place cell below which it is silent; keeps denormal numbers out
LONGEST = 300.0  # units of time, of a predicted duration
ADVICE = "Lower learner.learning_rate, or bound the needs of the species."
ZETA = 2.0  # exponent of the law of the length of explored walks
BLANK = {"movement": -1, "loss_f": math.nan, "loss_j": math.nan}  # of a life that begins; all else 0
TRAIL = 64  # ticks of a movement whose states are kept on the way
NEAR = 0.05  # ticks over which a slope is taken where it is shown
POLYAK = 0.1  # share by which the target network follows J per update

Weights = Sequence[Tensor]


@dataclass(frozen=True, kw_only=True)
class HJBSettings:
    """Everything that can be set; times are in units of time, not ticks."""

    gamma: float = 0.995  # discount per unit of time
    life: float = 100_000.0  # over which epsilon and the learning rate fall
    epsilon: float = 0.5  # exploration at birth
    epsilon_final: float = 0.1  # from `epsilon_until` of life on
    epsilon_until: float = 0.6  # share of life
    persistence: int = 8  # strides that an explored walk goes on for at most (Dabney et al. 2021); 1: one
    width: int = 64  # of both hidden layers of f and J
    learning_rate: float = 4e-3
    learning_rate_final: float = 2e-4  # reached linearly in the second half of life
    adaptive_steps: bool = True  # a decision lasts as long as its movement (paper, "adaptive time steps")
    bearings: bool = True  # a turn and the walk after it are one movement
    stride: float = 10.0  # length of a move
    pause: float = 40.0  # length of a rest
    meal: float = 5.0  # length of a meal
    finite_difference: bool = True  # the HJB score over a whole movement instead of its first-order limit
    minimum_in_loss: bool = True  # L_J is the residual of the HJB equation, its min included
    replay: bool = True  # learn from remembered decisions, not the newest alone (Mnih et al. 2015)
    intra_option: bool = True  # learn from states passed on the way too (Sutton, Precup and Singh 1999)
    batch: int = 64  # decisions per gradient step on L_J
    batch_f: int = 128  # and on L_f
    recent_share: float = 0.4  # of the batch, from the last `recent` decisions
    recent: int = 300
    memory: int = 12_000  # decisions
    update_every: float = 2.0  # units of time between gradient steps
    place_cells: int = 64  # Gaussian bumps of position, recruited where the agent has been; 0: none
    place_spacing: float = 0.75  # length between centres
    place_width: float = 0.6  # length, standard deviation of a bump
    imagined: float = 0.5  # share of J's batch whose needs are redrawn, the rest of zeta kept
    relative_weight: bool = True  # L_J weighs small drives more
    target_network: bool = True  # a slow copy of J in the target (Lillicrap et al. 2016)
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
    (("epsilon", "epsilon_final", "recent_share", "imagined"), "from 0 to 1", lambda v: 0 <= v <= 1),
    (("epsilon_until",), "above 0 and at most 1", lambda v: 0 < v <= 1),
    (("place_cells", "mutation"), "0 or more", lambda v: v >= 0),
    (("width", "batch", "batch_f", "recent", "memory", "persistence"), "1 or more", lambda v: v >= 1),
    (("place_spacing", "place_width"), "a length of at least 0.001", lambda v: v >= 1e-3),
    (
        ("life", "learning_rate", "learning_rate_final", "stride", "pause", "meal", "update_every"),
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
    "relative_weight": False,
    "persistence": 1,
    "intra_option": False,
    "target_network": False,
    "gamma": 0.99,
    "learning_rate": 1e-3,
    "learning_rate_final": 1e-3,
    "epsilon": 0.3,
    "epsilon_final": 0.3,
}


class HJB(Learner):
    """n agents that learn f and J online, each from its own life."""

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the settings by name with their defaults."""
        return dataclasses.asdict(HJBSettings())

    @classmethod
    def with_settings(cls, group: Group, seed: np.random.SeedSequence, settings: Mapping[str, Any]) -> HJB:
        """Return n learners with `settings` by name."""
        known = cls.defaults()
        checked = {}
        for name, value in settings.items():
            if name not in known:
                raise EcologyError(f"the learner hjb has no setting {name!r}. {nearest(name, known)}")
            kind = type(known[name])
            if kind is float and isinstance(value, int) and not isinstance(value, bool):
                value = float(value)
            if type(value) is not kind:
                raise EcologyError(f"learner setting {name} is of type {kind.__name__}, got {value!r}.")
            checked[name] = value
        return cls(group, seed, HJBSettings(**checked))

    def __init__(self, group: Group, seed: np.random.SeedSequence, settings: HJBSettings | None = None) -> None:
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
        mix, felt, self.exponent = drive_terms(layout)
        self.mix, self.felt = torch.from_numpy(mix), torch.from_numpy(felt) if felt.any() else None
        self.epsilon_of_drive = float(layout.epsilon)
        scale = torch.from_numpy(layout.scale.astype(np.float32))
        needs = kinds == "deviation"
        self.need = torch.from_numpy(needs)
        set_points = needs & layout.regulated & (layout.low < 0)  # needs that can be deprived
        self.deprivable = torch.from_numpy(set_points)
        deprived = layout.scale[set_points] if set_points.any() else layout.scale[needs]
        self.worst = float(np.sqrt(np.sum(deprived**2))) ** self.exponent  # drive of total deprivation
        self.scale = scale
        angles = kinds == "angle"
        self.low = torch.from_numpy(np.where(angles, -1e30, np.maximum(layout.low, -1e30)).astype(np.float32))
        self.high = torch.from_numpy(np.where(angles, 1e30, np.minimum(layout.high, 1e30)).astype(np.float32))
        self.angle = torch.from_numpy(np.flatnonzero(angles))
        self.plain = torch.from_numpy(np.flatnonzero(~angles))
        placed = kinds == "position"
        centre = np.zeros(len(kinds))
        centre[placed] = (layout.low[placed] + layout.high[placed]) / 2
        self.centre = torch.from_numpy(centre.astype(np.float32))
        self.place = torch.from_numpy(np.flatnonzero(kinds == "position")[:2])
        self.cells = s.place_cells if len(self.place) == 2 else 0
        unit = torch.where(self.need | torch.from_numpy(kinds == "felt"), CHANGE * scale, LENGTH * scale)
        unit[self.angle] = 1.0
        self.unit = torch.cat([unit, torch.tensor([s.stride if s.adaptive_steps else group.dt])])  # (D + 1,)

        draw = np.random.default_rng(seed.spawn(1)[0])
        self.generator = torch.Generator().manual_seed(int(draw.integers(2**62)))
        inputs = len(self.plain) + 2 * len(self.angle) + self.cells
        w = s.width
        self.f = Perceptrons(n, (inputs, w, w, self.count * (self.components + 1)), F.relu, self.generator)
        self.J = Perceptrons(n, (inputs, w, w, 1), F.silu, self.generator)
        # a slow copy of J, or J's own weights where it is switched off
        self.target = [w.detach().clone() for w in self.J.weights] if s.target_network else self.J.weights
        self.adam_f, self.adam_j = Adam(self.f.weights), Adam(self.J.weights)
        self.memory = Memory(n, s.memory if s.replay else 1, self.components, self.count)
        self.cell_centre = torch.zeros(n, max(self.cells, 1), 2)
        self.cell_on = torch.zeros(n, max(self.cells, 1))
        self.cell_count = np.zeros(n, np.int64)

        # the movement under way, one row per slot
        self.movement = np.full(n, -1)
        self.stage = np.zeros(n, np.int64)
        self.left = np.zeros(n, np.int64)  # ticks of the stage that are left
        self.elapsed = np.zeros(n, np.int64)  # ticks since the decision
        self.began = np.zeros((n, self.components), np.float32)  # zeta at the decision
        self.was_open = np.zeros((n, self.count), bool)
        self.trail = np.zeros((n, TRAIL, self.components), np.float32)  # zeta on the way, by ticks elapsed
        self.trail_open = np.zeros((n, TRAIL, self.count), bool)
        self.more = np.zeros(n, np.int64)  # strides that an explored walk goes on for
        self.age = np.zeros(n, np.int64)  # ticks learned
        self.ticks = 0
        self.exploration: float | None = None  # fixed epsilon, in evaluation
        self.loss_f, self.loss_j = np.full(n, np.nan), np.full(n, np.nan)
        self.decisions = np.zeros(n, np.int64)

    # ---- f, J and the score ---------------------------------------------------------------

    def drive(self, zeta: Tensor) -> Tensor:
        """Return d, (...) at zeta (..., D): the a priori interoception of Algorithm 1."""
        own = ((zeta @ self.mix).square().sum(-1) + self.epsilon_of_drive) ** (self.exponent / 2)
        return own if self.felt is None else own + zeta @ self.felt

    def features(self, zeta: Tensor, index: Tensor | None = None) -> Tensor:
        """Return network inputs (k, b, F) for zeta (k, b, D) of the agents `index` (k,)."""
        parts = [(zeta[..., self.plain] - self.centre[self.plain]) / self.scale[self.plain]]
        if len(self.angle):
            angle = zeta[..., self.angle]
            parts += [angle.cos(), angle.sin()]
        if self.cells:
            centre = self.cell_centre if index is None else self.cell_centre[index]  # (k, C, 2)
            on = self.cell_on if index is None else self.cell_on[index]
            here = zeta[..., self.place]
            # -|here - centre|^2 / (2 width^2), expanded so that one product makes all pairs
            sharp = 1.0 / self.settings.place_width**2
            own = (-0.5 * sharp) * here.square().sum(-1, keepdim=True)
            theirs = (-0.5 * sharp) * centre.square().sum(-1)[:, None] + (on[:, None] - 1) * 1e6
            parts.append((torch.baddbmm(theirs, here, centre.mT, alpha=sharp) + own).clamp_(min=FAR).exp_())
        return torch.cat(parts, -1)

    def deviation_at(self, zeta: Tensor, index: Tensor | None = None, weights: Weights | None = None) -> Tensor:
        """Return Jn = -ln(gamma) J, drive units, (k, b) at zeta (k, b, D); `weights` in place of J's own."""
        weights = rows(self.J.weights if weights is None else weights, index)
        out = self.J(self.features(zeta, index), weights)[..., 0]
        return self.worst * (J_CENTRE + J_SPREAD * out)

    def changes(self, zeta: Tensor, index: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Return f: changes (k, b, M, D) and durations (k, b, M) of all movements at zeta (k, b, D)."""
        raw = self.f(self.features(zeta, index), rows(self.f.weights, index))
        out = raw.view(*zeta.shape[:2], self.count, self.components + 1) * self.unit
        return out[..., :-1], out[..., -1].clamp(self.group.dt, LONGEST)

    def scores(self, zeta: Tensor, index: Tensor | None = None, weights: Weights | None = None) -> Tensor:
        """Return the HJB score of every movement, drive units, (k, b, M) at zeta (k, b, D).

        Over a whole movement, (1 - gamma^tau) (d + d') / 2 + gamma^tau Jn(zeta'); its limit for
        tau -> 0, less the part common to all, is the paper's d + dJ/dzeta . f.
        """
        gamma = self.settings.gamma
        if self.settings.finite_difference:
            with torch.no_grad():
                change, duration = self.changes(zeta, index)
                after = torch.minimum(torch.maximum(zeta[:, :, None] + change, self.low), self.high)
                keep = gamma**duration
                ahead = self.deviation_at(after.flatten(1, 2), index, weights).view(keep.shape)
                return (1 - keep) * 0.5 * (self.drive(zeta)[..., None] + self.drive(after)) + keep * ahead
        change, duration = self.changes(zeta, index)
        change = change.detach()
        rate = change / duration.detach()[..., None]
        slope = self.slope(zeta, index, weights)
        return self.drive(zeta[:, :, None] + rate * self.group.dt) + (slope[:, :, None] * rate).sum(-1) / -math.log(
            gamma
        )

    def slope(self, zeta: Tensor, index: Tensor | None = None, weights: Weights | None = None) -> Tensor:
        """Return dJn/dzeta (k, b, D), differentiable in the weights."""
        with torch.enable_grad():
            at = zeta.detach().requires_grad_()
            value = self.deviation_at(at, index, weights)
            return torch.autograd.grad(value.sum(), at, create_graph=True)[0]

    # ---- births and deaths ----------------------------------------------------------------

    def died(self, slots: np.ndarray) -> None:
        """Drop the movements under way in `slots` (k,)."""
        self.movement[slots] = -1

    @torch.no_grad()
    def born(self, slots: np.ndarray, parents: np.ndarray) -> None:
        """Begin a new life in `slots` (k,), from nothing or from what `parents` (k,) know; all in place."""
        for name, array in self._arrays().items():
            array[slots] = BLANK.get(name, 0)
        index = torch.from_numpy(slots)
        for tensor in (self.cell_centre, self.cell_on):
            tensor[index] = 0
        for optimiser in (self.adam_f, self.adam_j):
            optimiser.forget(index)
        own = parents >= 0 if self.settings.inherit else np.zeros(len(slots), bool)
        new = index[torch.from_numpy(~own)]
        if len(new):
            self.f.redraw(new)
            self.J.redraw(new)
            for slow, weight in zip(self.target, self.J.weights, strict=True):
                slow[new] = weight[new]
        if own.any():
            self._inherit(index[torch.from_numpy(own)], torch.from_numpy(parents[own]))

    def _inherit(self, index: Tensor, parents: Tensor) -> None:
        """Give the newborn `index` (k,) what `parents` (k,) know of the world, with mutations."""
        for tensor in (self.cell_centre, self.cell_on):
            tensor[index] = tensor[parents]
        self.cell_count[index.numpy()] = self.cell_count[parents.numpy()]
        slow = self.target if self.settings.target_network else []
        for tensor in (*self.f.weights, *self.J.weights, *slow):
            tensor[index] = tensor[parents]
        if self.settings.mutation > 0:
            for weight in (*self.f.weights, *self.J.weights):
                spread = self.settings.mutation * weight[index].square().mean((1, 2), keepdim=True).sqrt()
                weight[index] += spread * torch.randn(weight[index].shape, generator=self.generator)
            for slow_, weight, old in zip(slow, self.J.weights, [w[parents] for w in self.J.weights], strict=False):
                slow_[index] += weight[index] - old  # the target mutates with J

    # ---- acting ---------------------------------------------------------------------------

    def begin(self) -> None:
        """Drop the movements under way: the next observation does not follow from the last."""
        self.movement[:] = -1

    def evaluating(self, epsilon: float) -> None:
        """Stop learning and explore with `epsilon` from now on."""
        self.learning = False
        self.exploration = epsilon
        self.begin()

    def epsilon(self) -> np.ndarray:
        """Return the exploration rate of every agent, (n,), by its age."""
        if self.exploration is not None:
            return np.full(self.size, self.exploration)
        s = self.settings
        gone = np.minimum(self.age * self.group.dt / (s.life * s.epsilon_until), 1.0)
        return s.epsilon + (s.epsilon_final - s.epsilon) * gone

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Go on with the movements under way, decide where one has ended, and return actions (n,)."""
        rows_ = np.arange(self.size)
        on = self._goes_on(masks)
        ended = np.flatnonzero(~on & (self.movement >= 0))
        if ended.size and self.learning:
            self._remember(ended, observations)
        if self.learning and self.settings.intra_option:
            self.trail[rows_, self.elapsed % TRAIL] = observations
            self.trail_open[rows_, self.elapsed % TRAIL] = self.moves.open(masks)
        deciding = np.flatnonzero(~on & masks.any(axis=1))
        if deciding.size:
            self._decide(deciding, observations[deciding], masks[deciding])
        self.left -= 1
        self.elapsed += 1
        return self.moves.action[self.movement, self.stage][rows_]

    def _goes_on(self, masks: np.ndarray) -> np.ndarray:
        """Return whose movement goes on, (n,), having passed to its second stage where due."""
        moves, at = self.moves, self.movement
        under_way = at >= 0
        rows_ = np.arange(self.size)
        over = self.left <= 0
        following = over & (self.stage == 0) & (moves.ticks[at, 1] > 0) & under_way
        self.stage[following] = 1
        self.left[following] = moves.ticks[at, 1][following]
        over &= ~following
        action = moves.action[at, self.stage]
        forced = masks.sum(axis=1) == 1  # the world leaves no choice
        return under_way & masks[rows_, action] & (~over | forced)

    def _decide(self, slots: np.ndarray, observations: np.ndarray, masks: np.ndarray) -> None:
        """Choose a movement for the agents in `slots` (k,): epsilon-greedy in the HJB score."""
        open_ = self.moves.open(masks)  # (k, M)
        index = None if len(slots) == self.size else torch.from_numpy(slots)
        with torch.no_grad():
            zeta = torch.from_numpy(observations)[:, None]
            score = self.scores(zeta, index)[:, 0].detach().numpy()
        if not np.isfinite(score).all():
            bad = int(slots[np.flatnonzero(~np.isfinite(score).all(axis=1))[0]])
            raise DivergedError("f or J", self.group.slots.start + bad, ADVICE)
        greedy = np.where(open_, score, np.inf).argmin(axis=1)
        drawn = self.rng.random((self.size, 2))[slots]
        share = (open_ / self.moves.length).cumsum(axis=1)  # each open movement gets the same time
        explored = (share > drawn[:, 1:] * share[:, -1:]).argmax(axis=1)
        explores = drawn[:, 0] < self.epsilon()[slots]
        chosen = np.where(explores, explored, greedy)
        if self.learning and self.settings.persistence > 1:
            chosen = self._persist(slots, chosen, explores, open_)
        self.movement[slots] = chosen
        self.stage[slots] = 0
        self.left[slots] = self.moves.ticks[chosen, 0]
        self.elapsed[slots] = 0
        self.began[slots] = observations
        self.was_open[slots] = open_
        self.decisions[slots] += 1
        if self.cells and self.learning:
            self._recruit(slots, observations)

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
        here = observations[:, self.place.numpy()]  # (k, 2)
        centre = self.cell_centre.numpy()[slots]
        gap = np.hypot(centre[..., 0] - here[:, None, 0], centre[..., 1] - here[:, None, 1])
        gap[self.cell_on.numpy()[slots] == 0] = np.inf
        new = (gap.min(axis=1) > self.settings.place_spacing) & (self.cell_count[slots] < self.cells)
        who = slots[new]
        at = self.cell_count[who]
        self.cell_centre.numpy()[who, at] = here[new]
        self.cell_on.numpy()[who, at] = 1.0
        self.cell_count[who] += 1

    # ---- learning -------------------------------------------------------------------------

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
            ready = (self.memory.count >= (s.batch if s.replay else 1)) & transition.alive
            if ready.any():
                self._update(ready)

    def rate(self) -> np.ndarray:
        """Return the learning rate of every agent, (n,), by its age."""
        s = self.settings
        late = np.clip(2 * self.age * self.group.dt / s.life - 1, 0, 1)
        return s.learning_rate + (s.learning_rate_final - s.learning_rate) * late

    def _draw(self, batch: int) -> Tensor:
        """Return positions (n, batch) in memory to learn from; the newest alone without replay."""
        s = self.settings
        if not s.replay:
            return self.memory.newest()
        return self.memory.sample(batch, s.recent, s.recent_share, self.generator)

    def _update(self, ready: np.ndarray) -> None:
        s = self.settings
        zeta, movement, after, _, open_ = self.memory.take(self._draw(s.batch))
        rate = torch.from_numpy(np.where(ready, self.rate(), 0.0).astype(np.float32))
        loss_f = self._loss_f(*self.memory.take(self._draw(s.batch_f))[:4])  # (n,)
        self.adam_f.step(torch.autograd.grad(loss_f.sum(), self.f.weights), rate)
        loss_j = self._loss_j(zeta, movement, after, open_)  # (n,)
        self.adam_j.step(torch.autograd.grad(loss_j.sum(), self.J.weights), rate)
        if s.target_network:
            with torch.no_grad():
                for slow, weight in zip(self.target, self.J.weights, strict=True):
                    slow.lerp_(weight, POLYAK)
        self.loss_f = np.where(ready, loss_f.detach().numpy(), self.loss_f)
        self.loss_j = np.where(ready, loss_j.detach().numpy(), self.loss_j)
        bad = np.flatnonzero(ready & ~(np.isfinite(self.loss_f) & np.isfinite(self.loss_j)))
        if bad.size:
            raise DivergedError("L_f or L_J", self.group.slots.start + int(bad[0]), ADVICE)

    def _loss_f(self, zeta: Tensor, movement: Tensor, after: Tensor, duration: Tensor) -> Tensor:
        """Return L_f (n,): the squared error of the executed movement's predicted change."""
        raw = self.f(self.features(zeta))
        raw = raw.view(*zeta.shape[:2], self.count, self.components + 1)
        pick = movement.clamp(min=0)[..., None, None].expand(-1, -1, 1, self.components + 1)
        predicted = raw.gather(2, pick)[:, :, 0]
        change = after - zeta
        if len(self.angle):
            turned = change[..., self.angle]
            change[..., self.angle] = torch.atan2(turned.sin(), turned.cos())
        goal = torch.cat([change, duration.clamp(max=LONGEST)[..., None]], -1) / self.unit
        known = (movement >= 0).float()
        return ((predicted - goal).square().mean(2) * known).sum(1) / known.sum(1).clamp(min=1)

    def _loss_j(self, zeta: Tensor, movement: Tensor, after: Tensor, open_: Tensor) -> Tensor:
        """Return L_J (n,): the squared residual of the HJB equation, in drive units."""
        s = self.settings
        if s.imagined:
            zeta = self._imagine(zeta)
        executed, known = movement.clamp(min=0), (movement >= 0).float()
        if s.minimum_in_loss:
            known = torch.ones_like(known)  # asks for no executed movement
            score = self.scores(zeta, weights=self.target).detach()
            goal = score.masked_fill(~open_, math.inf).amin(-1)
        elif s.finite_difference:
            score = self.scores(zeta, weights=self.target)
            goal = score.gather(2, executed[..., None])[..., 0]
        else:  # as printed: d of the state reached, dJ/dzeta . f of the executed action
            change, duration = self.changes(zeta)
            pick = executed[..., None, None].expand(-1, -1, 1, self.components)
            rate = (change / duration[..., None]).detach().gather(2, pick)[:, :, 0]
            goal = self.drive(after) + (self.slope(zeta) * rate).sum(-1) / -math.log(s.gamma)
        if s.minimum_in_loss or s.finite_difference:
            goal = goal.clamp(0, J_CEILING * self.worst)
        residual = self.deviation_at(zeta) - goal
        if s.relative_weight:
            weight = WEIGHT_TOP * self.worst / (WEIGHT_FLOOR * self.worst + self.drive(zeta))
            residual = residual * weight
        return (residual.square() * known).sum(1) / known.sum(1).clamp(min=1)

    def _imagine(self, zeta: Tensor) -> Tensor:
        """Return zeta with the needs of the first part of the batch redrawn, place and rest kept.

        Half of those have all needs uniform between deprived and a little beyond sated, half have
        one need deprived and the others near sated; fatigues are scaled down at random.
        """
        n, b, d = zeta.shape
        m = round(self.settings.imagined * b)
        g = self.generator
        low = torch.maximum(DEPRIVED * self.scale, self.low)
        drawn = low + torch.rand(n, m, d, generator=g) * (SATED * self.scale - low)
        near = 0.1 * self.scale * torch.randn(n, m // 2, d, generator=g)
        chances = self.deprivable.float().expand(n * (m // 2), -1)
        if bool(self.deprivable.any()):
            which = torch.multinomial(chances, 1, generator=g).view(n, m // 2, 1)
            one = torch.zeros_like(near).scatter(2, which, 1.0).bool()
            near = torch.where(one, drawn[:, : m // 2], near)
        drawn[:, : m // 2] = near
        old = zeta[:, :m]
        calm = old * torch.rand(n, m, 1, generator=g)
        fresh = torch.where(self.deprivable, drawn, torch.where(self.need, calm, old))
        fresh = torch.minimum(torch.maximum(fresh, self.low), self.high)
        return torch.cat([fresh, zeta[:, m:]], 1)

    # ---- what it has become ---------------------------------------------------------------

    def _tensors(self) -> dict[str, Tensor]:
        """Return every tensor that changes, by name."""
        found = {"adam_f.steps": self.adam_f.steps, "adam_J.steps": self.adam_j.steps}
        for name, values in (
            ("f", self.f.weights),
            ("J", self.J.weights),
            ("target", self.target),
            ("adam_f.first", self.adam_f.first),
            ("adam_f.second", self.adam_f.second),
            ("adam_J.first", self.adam_j.first),
            ("adam_J.second", self.adam_j.second),
        ):
            found |= {f"{name}.{i}": value for i, value in enumerate(values)}
        for name in ("zeta", "after", "duration", "movement", "open"):
            found[f"memory.{name}"] = getattr(self.memory, name)
        return found | {"cell_centre": self.cell_centre, "cell_on": self.cell_on}

    def _arrays(self) -> dict[str, np.ndarray]:
        """Return every array that changes, by name."""
        own = (
            "cell_count", "movement", "stage", "left", "elapsed", "began", "was_open", "more",
            "trail", "trail_open", "age", "loss_f", "loss_j", "decisions",
        )  # fmt: skip
        return {name: getattr(self, name) for name in own} | {"memory.count": self.memory.count}

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the agents have become: arrays, and plain values that JSON holds."""
        arrays = {name: value.detach().numpy() for name, value in self._tensors().items()}
        arrays |= self._arrays()
        arrays["generator"] = self.generator.get_state().numpy()
        return arrays, {"rng": self.rng.bit_generator.state, "ticks": self.ticks}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Become what `state` returned; EcologyError where it does not fit this learner."""
        tensors, own = self._tensors(), self._arrays()
        for name, here in (tensors | own).items():
            shape = arrays[name].shape if name in arrays else None
            if shape != tuple(here.shape):
                raise EcologyError(
                    f"the checkpoint does not fit the learner: {name} has the shape {shape}, the learner "
                    f"{tuple(here.shape)}; load it with the settings that it was written with."
                )
        with torch.no_grad():
            for name, tensor in tensors.items():
                tensor.copy_(torch.from_numpy(np.array(arrays[name])))
        for name, array in own.items():
            array[...] = arrays[name]
        self.generator.set_state(torch.from_numpy(np.array(arrays["generator"])))
        self.rng.bit_generator.state = values["rng"]
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

    @torch.no_grad()
    def deviation(self, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return -ln(gamma) J in drive units, (m,) at states (m, D), for the agent in `slot`."""
        at = torch.from_numpy(np.asarray(zeta, np.float32))[None]
        return self.deviation_at(at, torch.tensor([slot]))[0].numpy()

    @torch.no_grad()
    def predict(self, slot: int, zeta: np.ndarray) -> dict[str, Any]:
        """Return f at states (m, D): movement names, change (m, M, D), duration (m, M)."""
        at = torch.from_numpy(np.asarray(zeta, np.float32))[None]
        change, duration = self.changes(at, torch.tensor([slot]))
        return {"names": self.moves.names, "change": change[0].numpy(), "duration": duration[0].numpy()}

    def decision(self, slot: int, zeta: np.ndarray, mask: np.ndarray) -> dict[str, Any]:
        """Return what the agent in `slot` weighs at zeta (D,) with the actions of `mask` (A,) open.

        See `Learner.decision`. Over a whole movement of duration tau, dJ/dzeta . f is the mean slope
        (J(zeta') - J(zeta)) / tau; without `finite_difference`, the slope at zeta.
        """
        s, layout = self.settings, self.group.layout
        told = self.predict(slot, zeta[None])
        change, duration = told["change"][0], told["duration"][0]  # (M, D), (M,)
        whole = s.finite_difference
        step = duration if whole else np.full(len(duration), self.group.dt)
        after = zeta + change * (step / duration)[:, None]
        if whole:
            angle = np.array(layout.kinds) == "angle"
            after = np.clip(after, np.where(angle, -np.inf, layout.low), np.where(angle, np.inf, layout.high))
        mix, felt, exponent = drive_terms(layout)

        def drive(at: np.ndarray) -> np.ndarray:
            return (np.square(at @ mix).sum(-1) + layout.epsilon) ** (exponent / 2) + at @ felt

        here = float(self.deviation(slot, zeta[None])[0])
        ahead = self.deviation(slot, after.astype(np.float32))
        if whole:
            slope = (ahead - here) / (-np.log(s.gamma) * step)
        else:
            ends = [self.deviation(slot, (zeta + way * (after - zeta)).astype(np.float32)) for way in (NEAR, -NEAR)]
            slope = (ends[0] - ends[1]) / (-np.log(s.gamma) * 2 * NEAR * step)
        keep = s.gamma**duration
        total = drive(after) + slope
        return {
            "names": self.moves.names,
            "open": self.moves.open(mask[None])[0],
            "next_drive": drive(after),
            "slope": slope,
            "sum": total,
            "score": (1 - keep) * 0.5 * (drive(zeta) + drive(after)) + keep * ahead if whole else total,
            "J": here,
            "gamma": s.gamma,
            "error": self._error(slot),
        }

    def _error(self, slot: int, last: int = 64) -> np.ndarray:
        """Return the error of f per component over the `last` decisions, relative to the changes met, (D,)."""
        memory, newest = self.memory, int(self.memory.count[slot])
        at = np.arange(max(newest - min(last, memory.capacity), 0), newest) % memory.capacity
        began, met, taken = (np.asarray(part[slot])[at] for part in (memory.zeta, memory.after, memory.movement))
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
