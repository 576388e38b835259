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
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from ecology import EcologyError, Group, elementary
from ecology.agents import checkpoint
from ecology.agents.base import DivergedError, Learner, Transition
from ecology.agents.hjb import devices
from ecology.agents.hjb.curiosity import Curiosity
from ecology.agents.hjb.decisions import DecisionRecord
from ecology.agents.hjb.devices.records import LONGEST, Lookahead, Replay, Sampling, Trace, Training, Weights
from ecology.agents.hjb.encoding import J_CENTRE, count_cells, encode
from ecology.agents.hjb.execution import Execution
from ecology.agents.hjb.experience import excess_of, remember
from ecology.agents.hjb.memory import Memory
from ecology.agents.hjb.networks import Perceptrons
from ecology.agents.hjb.revision import Revision
from ecology.agents.hjb.settings import HERITABLE, HJBSettings, check_bounds
from ecology.agents.movements import ARRIVES, Movements, adaptive, single_ticks
from ecology.decision import Decision, Plan

ADVICE = "Lower learner.learning_rate, or bound the needs of the species."
ZETA = 2.0  # exponent of the law of the length of explored walks
BLANK = {"movement": -1, "curiosity": 1.0, "loss_f": math.nan, "loss_j": math.nan}  # at birth; all else is 0


class HJB(Learner):
    """n agents that learn f and J online, each from its own life.

    Networks, place cells and memories are held by a `Device`, which computes scores and updates. The movements under
    way are kept by an `Execution`, and decisions that observers follow by a `DecisionRecord`.
    """

    devices = True
    decides = True
    heritable = HERITABLE

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
            if name == "relative_weight" and isinstance(value, bool):
                value = 2 if value else 0  # as runs say that are older than the power
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
        self.personal: dict[str, np.ndarray] = {}  # settings that differ from agent to agent, (n,) each
        for trait in group.inherited:
            check_bounds(s, trait)
        top = {trait.setting: trait.bounds[1] for trait in group.inherited}
        self.mutates = top.get("mutation", s.mutation) > 0
        self.moves: Movements = (
            adaptive(group, bearings=s.bearings, stride=s.stride, pause=s.pause, meal=s.meal)
            if s.adaptive_steps
            else single_ticks(group)
        )
        self.components, self.count = len(group.layout.kinds), len(self.moves.names)
        self.cells = count_cells(group, s)
        self.curious = self.cells > 0 and top.get("optimism", s.optimism) > 0 and s.finite_difference
        self.encoding = encode(group, s, self.moves)
        self.device = devices.make(device, self.encoding, n)
        # the seed's first child, made here: `seed.spawn` would change the caller's seed
        child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 0), pool_size=seed.pool_size)
        draw = np.random.default_rng(child)
        self.generator = np.random.default_rng(draw.integers(2**62))
        kinds = np.array(group.kinds)[self.moves.action[:, 0]]
        self.idle, self.approaches = kinds == "rest", kinds == "go_to"  # (M,)
        self._hold_arrays(n)
        meals = kinds == "consume"  # they depend on a place
        self.revision = Revision(
            self.memory, meals, self.encoding.place, self.settings.doubt_reach, self.settings.doubt
        )
        self.execution = Execution(self.moves, n, self.components, costed=self.encoding.costed)
        self.more = np.zeros(n, np.int64)  # strides for which an exploratory walk continues
        self.age = np.zeros(n, np.int64)  # ticks learned
        self.clock = np.zeros(n, np.int64)  # ticks acted
        self.ticks = 0
        self.exploration: float | None = None  # fixed epsilon, in evaluation
        self._trained: tuple[Any, list[np.ndarray]] = ({}, [])  # random stream and memory of errors after learning
        self.loss_f, self.loss_j = np.full(n, np.nan), np.full(n, np.nan)
        self.decisions = np.zeros(n, np.int64)
        self.tried = np.zeros((n, self.count), np.int64)
        self.explores = np.full(n, -1, np.int8)  # whether the movement under way explores, -1 unknown: for observers
        self.record = DecisionRecord(self)

    def _hold_arrays(self, n: int) -> None:
        """Make what the device holds and computes with: networks, memories, place cells and marks."""
        s, at, w = self.settings, self.device, self.settings.width
        inputs = len(self.encoding.plain) + 2 * len(self.encoding.angle) + self.cells
        self.f = Perceptrons(n, (inputs, w, w, self.count * self.encoding.outputs), self.generator, at, self.count)
        self.J = Perceptrons(n, (inputs, w, w, 1), self.generator, at)
        # a slow copy of J, or J's own weights where it is switched off
        self.target = self.J.weights + 0 if s.target_network else self.J.weights
        self.memory = m = Memory(n, s.memory if s.replay else 1, self.components, self.count, at)
        self.cell_centre = at.zeros((n, 2, self.cells), np.float32)
        self.cell_count = at.zeros((n,), np.int64)
        self.optimism = at.zeros((n, 2), np.float32)
        self.curiosity = Curiosity(n, s.marks if self.curious else 0, s.mark_reach, s.aim_reach, s.boredom, at)
        self.cell_names = at.on(np.arange(self.cells))
        self.weights = Weights(
            self.f.weights, self.f.first, self.f.second, self.f.steps,
            self.J.weights, self.J.first, self.J.second, self.J.steps,
            self.target, self.cell_centre, self.cell_count, self.optimism, self.curiosity.marks, self.curiosity.marked,
            *(at.zeros((n,), np.float32) for _ in range(3)),
        )  # fmt: skip
        self._set_constants()
        self.replay = Replay(m.zeta, m.after, m.duration, m.movement, m.open, m.excess, m.count)
        self.trace = Trace(
            np.zeros((n, s.errors, len(self.encoding.where)), np.float32),
            np.zeros((n, s.errors), np.int16),
            np.zeros((n, s.errors, self.encoding.outputs), np.float32),
            np.zeros((n, s.errors, self.count), bool),
            np.zeros((n, s.errors), np.float32),
            np.zeros(n, np.int64),
        )
        # the next decisions as an update has scored them; nothing is open where it has not
        self.lookahead = Lookahead(
            np.zeros((n, self.components), np.float32),
            np.zeros((n, self.count), bool),
            np.zeros((n, self.count), np.float32),
        )

    # ---- settings of every agent's own -----------------------------------------------------

    def adopt(self, settings: Mapping[str, np.ndarray]) -> None:
        """Use the settings that the agents have inherited, by name (n,)."""
        if any(not np.array_equal(values, self.personal.get(name, ())) for name, values in settings.items()):
            self.personal |= {name: np.array(values) for name, values in settings.items()}
            self._set_constants()

    def number(self, name: str) -> Any:
        """Return the setting `name`: one number, or (n,) where agents inherit it."""
        return self.personal.get(name, getattr(self.settings, name))

    def _set_constants(self) -> None:
        """Set the settings that the device computes with."""
        w, explores = self.weights, self.settings.target_explores
        for array, values in (
            (w.log_gamma, elementary.log(self.number("gamma"))),
            (w.explored, self.number("epsilon_final") * explores),
            (w.polyak, self.number("polyak")),
        ):
            array[...] = self.device.on(np.full(self.size, values, np.float32))

    # ---- births and deaths ----------------------------------------------------------------

    def died(self, slots: np.ndarray) -> None:
        """Drop the movements under way in `slots` (k,)."""
        self.execution.movement[slots] = -1
        self.record.forget(slots)

    def interrupted(self, slots: np.ndarray) -> None:
        """Drop the movements under way in `slots` (k,): where they would have led is not known."""
        self.died(slots)

    def born(self, slots: np.ndarray, parents: np.ndarray) -> None:
        """Begin a new life in `slots` (k,), from nothing or from what `parents` (k,) know; all in place."""
        self.record.forget(slots)
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
        if self.mutates:
            share = self.number("mutation") if "mutation" not in self.personal else self.personal["mutation"][heirs]
            self.f.mutate(heirs, share)
            noise = self.J.mutate(heirs, share)
            if self.settings.target_network:
                self.target[to] += noise  # it mutates with J

    # ---- acting ---------------------------------------------------------------------------

    def begin(self) -> None:
        """Drop the movements under way: the next observation does not follow from the last."""
        self.execution.movement[:] = -1
        self.record.clear()

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
        young, adult = self.number("epsilon"), self.number("epsilon_final")
        return adult + (young - adult) * self._youth()

    def _youth(self) -> np.ndarray:
        """Return how young every agent is, (n,): 1 at birth, 1/e after the time `youth`."""
        return elementary.exp(-self.age * self.group.dt / self.number("youth"))

    def _set_optimism(self) -> None:
        """Set by how much J of unknown places is lowered; nothing in evaluation.

        The share grows with what is at stake, so an agent whose needs are met stays, and one that lacks something
        searches. The young search even when they lack nothing. An agent that has made every movement has nothing
        left to find.
        """
        if self.curious:
            level = self.curiosity.level * (self.exploration is None) * self._lacks_movements()
            young = self._youth() * self.encoding.centre_j / J_CENTRE
            more = self.number("optimism_young") * level * young
            optimism = np.column_stack([self.number("optimism") * level, more])
            self.optimism[...] = self.device.on(optimism.astype(np.float32))

    def _lacks_movements(self, slots: Any = slice(None)) -> np.ndarray:
        """Return which of `slots` (k,) have never made some movement."""
        return (self.tried[slots] == 0).any(axis=1)

    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Continue the movements under way, decide where one has ended, and return actions (n,)."""
        self.clock += 1
        way = self.execution
        actions = np.empty(self.size, np.int64)
        if self.learning and self.settings.notice:
            self._notice(masks)
        if self.encoding.costed:
            way.drive[:] = self.drive(observations)
        if way.proceed(masks, observations, actions, keep=self.learning and self.settings.intra_option):
            free = np.flatnonzero(way.free)
            ended = free[way.movement[free] >= 0]
            if ended.size:
                if self.settings.errors or self.curious:
                    self._note(ended, observations)
                if self.learning:
                    remember(self, ended, observations)
            deciding = free[masks[free].any(axis=1)]
            if deciding.size:
                self._decide(deciding, observations[deciding], masks[deciding])
            actions[free] = way.advance(free)
        self.lookahead.open[:] = False  # it was about this tick
        return actions

    def _notice(self, masks: np.ndarray) -> None:
        """Drop the movements under way of agents for whom one has opened that they have never made.

        Else an agent that walks by passes many a food without a decision.
        """
        slots = np.flatnonzero(self._lacks_movements() & (self.execution.movement >= 0))
        if slots.size:
            opened = self.moves.open(masks[slots]) & ~self.execution.was_open[slots]
            new = slots[(opened & (self.tried[slots] == 0)).any(axis=1)]
            if new.size:
                self.interrupted(new)

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
        compared: np.ndarray | None = None  # scores (k, M) by which agents choose that do not explore
        self._set_optimism()
        if knows.size:
            score = self._scores(slots[knows], observations[knows], open_[knows])
            if np.isnan(score).any() or np.isneginf(score).any():
                bad = int(slots[knows[np.flatnonzero(~(score > -np.inf).all(axis=1))[0]]])
                raise DivergedError("f or J", self.group.slots.start + bad, ADVICE)
            chosen[knows] = score.argmin(axis=1)
            compared = np.full(open_.shape, np.nan, np.float32)
            compared[knows] = score
        if self.learning and self.settings.persistence > 1 and not self.curious:
            walks = self._persist(slots, chosen, explores, open_)
            chosen, explores = walks, explores | (walks != chosen)
        self.explores[slots] = explores
        if self.record.followed:
            self.record.keep(slots, observations, masks, chosen, compared)
        self.execution.start(slots, chosen, observations, open_)
        self.decisions[slots] += 1
        self.tried[slots, chosen] += 1
        if self.cells and self.learning:
            self._recruit(slots, observations)
            if self.settings.doubt:
                self._revise(slots, observations, open_)
            if self.curious:
                self.curiosity.search_again(slots[self._lacks_movements(slots)], self.settings.patience)

    def _revise(self, slots: np.ndarray, observations: np.ndarray, open_: np.ndarray) -> None:
        """Correct memories that what is open here contradicts; what is nowhere open any more is searched for.

        A new place may be seen from afar, so it counts as never made too to go to what is in sight.
        """
        for slot, movement in self.revision.revise(slots, observations, open_):
            self.tried[slot, movement] = 0
            self.tried[slot, self.approaches] = 0
            self.curiosity.search(np.array([slot]), 0)

    def _scores(self, slots: np.ndarray, observations: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the HJB scores (k, M) of what is open to `slots` (k,), as the last update left them where it did."""
        ahead = self.lookahead
        is_same = (ahead.open[slots] == open_).all(axis=1) & (ahead.zeta[slots] == observations).all(axis=1)
        score, rest = ahead.score[slots], np.flatnonzero(~is_same)
        if rest.size:
            score[rest] = self._plain_scores(slots[rest], observations[rest], open_[rest])
        return self._prefer_rest(slots, observations, score)

    def scores(self, slots: np.ndarray, zeta: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the score (k, M), drive units, of the open movements of `slots` (k,) at zeta (k, D); else infinity."""
        return self._prefer_rest(slots, zeta, self._plain_scores(slots, zeta, open_))

    def _plain_scores(self, slots: np.ndarray, zeta: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the same without the advantage of rest."""
        return self.device.scores(self.weights, self.replay, self.trace, self._now()[slots], slots, zeta, open_)

    def _prefer_rest(self, slots: np.ndarray, zeta: np.ndarray, score: np.ndarray) -> np.ndarray:
        """Return scores (k, M) of `slots` (k,) at zeta (k, D) in which rest has its advantage."""
        if self.settings.reluctance:
            share, relief = self.rest_terms(slots, zeta)
            score -= np.clip(share * score, 0, relief)
        return score

    def rest_terms(self, slots: np.ndarray, zeta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the terms of the advantage of rest, a share of its score (k, 1) and at most its relief (k, M).

        The least of many scores with errors is too low (van Hasselt 2010), and there are many ways to walk but one to
        rest, so an agent would walk wherever J is not exact, and tire for nothing. The share falls with the square root
        of the learning rate, as the errors do. The relief is by how much rest lowers the drive by the needs that it
        brings closer to their set points, as f predicts it: an agent that is not tired has no reason to rest.
        """
        share = self.settings.reluctance * np.sqrt(self.rate() / self.number("learning_rate"))
        relief = np.zeros((len(slots), self.count), np.float32)
        for rest in np.flatnonzero(self.idle):
            change = self.device.expect(self.weights, slots, zeta, np.full(len(slots), rest))[:, : self.components]
            relieved = self.encoding.need & (np.abs(zeta + change) < np.abs(zeta))
            relief[:, rest] = self.drive(zeta) - self.drive(np.where(relieved, zeta + change, zeta))
        return share[slots, None].astype(np.float32), relief.clip(min=0)

    def _now(self) -> np.ndarray:
        """Return for how long every agent has acted, (n,), units of time."""
        return (self.clock * self.group.dt).astype(np.float32)

    def _persist(self, slots: np.ndarray, chosen: np.ndarray, explores: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the movements (k,), where an explored walk continues; lengths of walks follow a zeta law.

        One step at random and then back to what is known explores a corner of the arena for ever
        (Dabney, Ostrovski and Barreto 2021, temporally extended epsilon-greedy exploration).
        """
        onward = self.moves.onward[self.execution.movement[slots]]
        drawn = np.minimum(self.rng.zipf(ZETA, self.size)[slots], self.settings.persistence)
        goes_on = (self.more[slots] > 0) & (self.execution.movement[slots] >= 0) & (onward >= 0)
        goes_on &= open_[np.arange(len(slots)), onward]
        self.more[slots] = np.where(goes_on, self.more[slots] - 1, np.where(explores, drawn - 1, 0))
        return np.where(goes_on, onward, chosen)

    def _recruit(self, slots: np.ndarray, observations: np.ndarray) -> None:
        """Add a place cell for each of `slots` that is farther than the spacing from all of its cells."""
        at, here = self.device.on(slots), self.device.on(observations[:, self.encoding.place])  # (k), (k, 2)
        gap = ((self.cell_centre[at] - here[:, :, None]) ** 2).sum(1)  # (k, C)
        count = self.cell_count[at]
        far = (gap > self.settings.place_spacing**2) | (self.cell_names >= count[:, None])
        new = far.all(1) & (count < self.cells)
        self.cell_centre[at[new], :, count[new]] = here[new]
        self.cell_count[at[new]] += 1

    # ---- learning -------------------------------------------------------------------------

    def _note(self, slots: np.ndarray, observations: np.ndarray) -> None:
        """Note by how much f was wrong in the movements of `slots` that have just ended."""
        trace, senses = self.trace, self.encoding
        began, movement = self.execution.began[slots], self.execution.movement[slots]
        expected = self.device.expect(self.weights, slots, began, movement)
        took = self.execution.elapsed[slots] * self.group.dt
        excess = excess_of(self, slots, began, self.execution.felt[slots], took)
        met = [observations[slots] - began, took, *(() if excess is None else (excess,))]
        error = (np.column_stack(met) - expected).astype(np.float32)
        error[:, senses.angle] = np.remainder(error[:, senses.angle] + np.pi, 2 * np.pi) - np.pi
        if self.learning and self.curious:
            place = senses.place
            aimed = np.clip(began[:, place] + expected[:, place], senses.low[place], senses.high[place])
            self.curiosity.learn(slots, aimed, observations[slots][:, place])
        if not self.settings.errors:
            return
        at = trace.count[slots] % self.settings.errors
        trace.where[slots, at] = began[:, senses.where]
        trace.movement[slots, at] = movement
        trace.error[slots, at] = error
        trace.possible[slots, at] = self.execution.was_open[slots]
        trace.time[slots, at] = self._now()[slots]
        trace.count[slots] += 1

    def learn(self, transition: Transition) -> None:
        """Take in one tick; at fixed intervals take a gradient step on L_f and L_J for all agents."""
        self.age += transition.alive
        self.ticks += 1
        s = self.settings
        if self.ticks % max(1, round(s.update_every / self.group.dt)) == 0:
            ready = (self.memory.count >= (s.warm_up if s.replay else 1)) & transition.alive
            if ready.any():
                deciding = ready & (self.execution.left <= 0)
                self.lookahead.zeta[:] = transition.next_observations
                if s.depth == 1 and not s.errors:
                    self.lookahead.open[:] = self.moves.open(transition.next_masks) & deciding[:, None]
                for _ in range(s.updates):
                    self._update(ready)

    def rate(self) -> np.ndarray:
        """Return the learning rate of every agent, (n,), by its age."""
        fall = 1 + self.age * self.group.dt / self.number("settling")
        return np.maximum(self.number("learning_rate") / fall, self.number("learning_rate_final"))

    def compile_update(self) -> None:
        """Compile the update, which the first ticks do without, by updating no agent."""
        self._update(np.zeros(self.size, bool))

    def _update(self, ready: np.ndarray) -> None:
        """Take one gradient step on L_f and L_J for the agents that are `ready` (n,)."""
        s, n = self.settings, self.size
        b, bf = (s.batch, s.batch_f) if s.replay else (1, 1)
        m, mf = round(s.imagined * b), round(s.imagined_f * bf) if self.encoding.spatial.any() else 0
        numbers = b + bf + m * self.components + m + m // 2 + mf * len(self.encoding.deprivable)
        sampling = Sampling(
            uniform=self.device.uniform(self.generator, (n, numbers)),
            normal=self.device.normal(self.generator, (n, m // 2, self.components)),
            batch=b,
            batch_f=bf,
            recent=s.recent,
            late=round(b * s.recent_share),
            late_f=round(bf * s.recent_share),
            imagined=m,
            imagined_f=mf,
        )
        self._set_optimism()
        training = Training(ready, self.rate(), self.loss_f, self.loss_j)
        self.device.update(self.weights, self.replay, sampling, training, self.lookahead)
        bad = np.flatnonzero(ready & ~(np.isfinite(self.loss_f) & np.isfinite(self.loss_j)))
        if bad.size:
            raise DivergedError("L_f or L_J", self.group.slots.start + int(bad[0]), ADVICE)

    # ---- what it has become ---------------------------------------------------------------

    def _life(self) -> dict[str, np.ndarray]:
        """Return every array here that changes and starts blank at birth, by name."""
        own = ("more", "age", "clock", "tried", "loss_f", "loss_j", "decisions")
        trace = {f"trace.{name}": array for name, array in self.trace._asdict().items()}
        ahead = {f"ahead.{name}": array for name, array in self.lookahead._asdict().items()}
        return (
            self.execution.arrays()
            | {name: getattr(self, name) for name in own}
            | {"curiosity": self.curiosity.level, "searches": self.curiosity.searches, "since": self.curiosity.since}
            | ahead
            | trace
            | {"memory.count": self.memory.count}
        )

    def _arrays(self) -> dict[str, Any]:
        """Return every array that the device holds, by name."""
        found = {name: getattr(self, name) for name in ("target", "cell_centre", "cell_count")}
        found |= {"hope": self.optimism, "marks": self.curiosity.marks, "marked": self.curiosity.marked}
        for name, network in (("f", self.f), ("J", self.J)):
            found[name] = network.weights
            found |= {f"adam_{name}.{part}": getattr(network, part) for part in ("first", "second", "steps")}
        excess = ("excess",) if self.encoding.costed else ()
        for name in ("zeta", "after", "duration", "movement", "open", *excess):
            found[f"memory.{name}"] = getattr(self.memory, name)
        return found

    def pack(self, slots: np.ndarray) -> Mapping[str, np.ndarray]:
        """Return all that the agents in `slots` (k,) have learned, with only the filled part of their memories."""
        rows = self.device.on(slots)
        used = min(int(self.memory.count[slots].max(initial=0)), self.memory.capacity)
        found = {name: array[slots] for name, array in self._life().items()}
        for name, array in self._arrays().items():
            part = array[rows][:, :used] if name.startswith("memory.") else array[rows]
            found[name] = np.array(self.device.off(part))
        return found

    def unpack(self, slots: np.ndarray, packed: Mapping[str, np.ndarray]) -> None:
        """Load agents that another learner with these settings has packed into `slots` (k,)."""
        self.record.forget(slots)
        held, life, rows = self._arrays(), self._life(), self.device.on(slots)
        if packed.keys() != held.keys() | life.keys():
            raise EcologyError("what arrives is of another learner; islands of a migrating species need the same one.")
        for name, array in life.items():
            array[slots] = packed[name]
        for name, array in held.items():
            if name.startswith("memory."):
                array[rows, : packed[name].shape[1]] = self.device.on(packed[name])
            else:
                array[rows] = self.device.on(packed[name])
        self.explores[slots] = -1

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the agents have become: arrays, and plain values that JSON holds."""
        streams = {"rng": self.rng.bit_generator.state, "generator": self.generator.bit_generator.state}
        held = {name: self.device.off(array) for name, array in self._arrays().items()}
        return held | self._life(), {**streams, "ticks": self.ticks}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Become what `state` returned; EcologyError where it does not fit this learner."""
        self.record.clear()
        self.explores[:] = -1
        held, life = self._arrays(), self._life()
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
        self.ticks = values["ticks"]

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
        return self.device.value(self.weights, slot, zeta)

    def slope(self, slot: int, zeta: np.ndarray) -> np.ndarray:
        """Return the derivative of `deviation` by zeta, (m, D) at states (m, D)."""
        return self.device.slope(self.weights, slot, np.ascontiguousarray(zeta, np.float32))

    def predict(self, slot: int, zeta: np.ndarray) -> dict[str, Any]:
        """Return f at states (m, D): movement names, change (m, M, D), duration (m, M)."""
        zeta = np.ascontiguousarray(zeta, np.float32)
        raw = self.device.forecast(self.weights, slot, zeta)
        raw = raw.reshape(len(zeta), self.count, self.encoding.outputs) * self.encoding.unit
        duration = raw[..., self.components].clip(self.group.dt, LONGEST)
        return {"names": self.moves.names, "change": raw[..., : self.components], "duration": duration}

    def follow(self, slots: Collection[int]) -> None:
        """Keep what the agents in `slots` weigh when they decide."""
        self.record.follow(slots)

    def decision(self, slot: int) -> Decision | None:
        """Return the decision that the agent in `slot` acts on, None before its first one."""
        return self.record.decision(slot)

    def plan_ahead(self, slot: int) -> Plan | None:
        """Return the best plan of the agent in `slot` where it last decided, None before its first decision."""
        return self.record.plan(slot)

    def weigh(self, slot: int, zeta: np.ndarray, mask: np.ndarray) -> Decision:
        """Return what the agent in `slot` would decide at zeta (D,) with the actions of `mask` (A,) open."""
        return self.record.weigh(slot, zeta, mask)
