"""Base class of learners: one learner acts for all agents of a species, each of which learns for itself."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ecology import elementary
from ecology.decision import Decision, Plan
from ecology.errors import EcologyError

if TYPE_CHECKING:
    from ecology.model import Group
    from ecology.senses import Layout


class DivergedError(EcologyError):
    """A network of the agent in `slot` (of the world) holds numbers that are not finite.

    Raised by a learner with what it was that diverged ("the deviation function J") and what to do
    about it; the run adds the tick and the agent's name.
    """

    def __init__(self, what: str, slot: int, advice: str = "") -> None:
        super().__init__(f"{what} is no longer finite. {advice}".rstrip())
        self.slot = slot


def drive_terms(layout: Layout) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the drive as a function of zeta (..., D), in rows: `mix` (D, D), `felt` (D,), p.

    d(zeta) = (epsilon + |zeta mix|^2)^(p/2) + zeta . felt: own regulated deviations, with what is felt of
    others added to the deviation that it belongs to (`mix`) or to the drive itself (`felt`). `drive_bend` has what the
    form of a drive has beyond the paper's.
    """
    count = len(layout.kinds)
    own = (np.array(layout.kinds) == "deviation") & layout.regulated
    mix = np.diag(np.where(own, getattr(layout, "own", np.ones(count)), 0.0))
    felt = np.zeros(count)
    felt_to = getattr(layout, "felt_to", np.full(count, -1))
    for row, (kind, to) in enumerate(zip(layout.kinds, felt_to, strict=True)):
        if kind == "felt" and to >= 0:
            mix[row, to] = float(layout.regulated[to])
        elif kind == "felt":
            felt[row] = 1.0
    mix = mix * getattr(layout, "below", np.ones(count))
    return mix.astype(np.float32), felt.astype(np.float32), float(getattr(layout, "exponent", 1.0))


def drive_bend(layout: Layout) -> tuple[np.ndarray, float]:
    """Return the rest of the drive's form: how many times more a deviation counts above its set point, (D,), and n.

    With y = zeta mix, d(zeta) = (epsilon + sum_i |b_i y_i|^n)^(p/n) + zeta . felt; b_i is that where y_i > 0, else 1.
    """
    count = len(layout.kinds)
    above, below = (getattr(layout, side, np.ones(count)) for side in ("above", "below"))
    return (above / below).astype(np.float32), float(getattr(layout, "power", 2.0))


@dataclass(frozen=True)
class Transition:
    """One tick in the life of the n slots of a species."""

    observations: np.ndarray  # float32 (n, D) zeta before
    masks: np.ndarray  # bool (n, A) before
    actions: np.ndarray  # int (n,) executed
    next_observations: np.ndarray  # float32 (n, D)
    next_masks: np.ndarray  # bool (n, A)
    alive: np.ndarray  # bool (n,) before and after: neither the dead nor the newborn
    died: np.ndarray  # bool (n,) alive before and dead after; next_observations holds its needs at death


class Learner(ABC):
    """A learner for all n slots of one species.

    A learner gets zeta and the action mask, and knows what its senses and actions are
    (`Group`: layout, action names, kinds, speeds). It never sees the state of the world.
    """

    devices = False  # whether `with_settings` takes a device to compute on; else it is the CPU
    decides = False  # whether `decision` returns decisions
    heritable: Collection[str] = ()  # settings that agents can inherit, see `adopt`

    def __init__(self, group: Group, seed: np.random.SeedSequence) -> None:
        self.group = group
        self.size = group.size
        self.rng = np.random.default_rng(seed)
        self.seconds = 0.0  # that acting and learning have taken, by the clock of the loop
        self.learning = True  # False: act as in evaluation, learn nothing

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """Return the settings by name with their defaults; plain values that TOML holds."""
        return {}

    @classmethod
    def with_settings(cls, group: Group, seed: np.random.SeedSequence, settings: Mapping[str, Any]) -> Learner:
        """Return a learner with its settings by name; a learner without settings takes none."""
        if settings:
            raise EcologyError(f"the learner {cls.__name__} has no settings, got {sorted(settings)}.")
        return cls(group, seed)

    @functools.cached_property
    def _terms(self) -> tuple[np.ndarray, np.ndarray, float]:
        return drive_terms(self.group.layout)

    @functools.cached_property
    def _bend(self) -> tuple[np.ndarray, float]:
        return drive_bend(self.group.layout)

    def drive(self, zeta: np.ndarray) -> np.ndarray:
        """Return the drive d (...) at zeta (..., D); the reward of a tick is the decrease of d.

        Sums have a fixed order, and no product comes from a BLAS, so the numbers are the same on every processor.
        """
        mix, felt, exponent = self._terms
        above, power = self._bend
        bent = power != 2 or bool((above != 1).any())
        shape = zeta.shape[:-1]
        total, shared = np.full(shape, self.group.layout.epsilon), np.zeros(shape)
        for i in range(zeta.shape[-1]):
            own = np.zeros(shape)
            for j in np.flatnonzero(mix[:, i]):
                own = own + zeta[..., j] * mix[j, i]
            if bent:
                own = elementary.power(np.abs(own * np.where(own > 0, above[i], 1.0)), power / 2)
            total = total + own * own
            shared = shared + zeta[..., i] * felt[i]
        return elementary.power(total, exponent / power) + shared

    @abstractmethod
    def act(self, observations: np.ndarray, masks: np.ndarray) -> np.ndarray:
        """Return an action (n,) for every slot, open in its mask; any number for a dead slot."""

    def learn(self, transition: Transition) -> None:  # noqa: B027  (most baselines learn nothing)
        """Learn from one tick."""

    def died(self, slots: np.ndarray) -> None:  # noqa: B027
        """Handle the deaths of the agents in `slots` (k,), rows of this species, in this tick."""

    def born(self, slots: np.ndarray, parents: np.ndarray) -> None:  # noqa: B027
        """Begin a new life in `slots` (k,); `parents` (k,) are rows of this species, -1: came from outside."""

    def adopt(self, settings: Mapping[str, np.ndarray]) -> None:  # noqa: B027
        """Use the settings that agents have inherited as traits, by name (n,), those of `heritable` among them.

        The loop calls it before every tick, and before `born` of those who are born. A learner that has none of
        them, such as a baseline, ignores it.
        """

    def interrupted(self, slots: np.ndarray) -> None:  # noqa: B027
        """Handle agents in `slots` (k,) that were moved or changed from outside between two ticks.

        What comes next does not follow from what they did, so nothing about their actions is to be learned from it.
        """

    def begin(self) -> None:  # noqa: B027
        """Drop whatever is under way: the next observation does not follow from the last."""

    def evaluating(self, epsilon: float) -> None:
        """Stop learning; explore with `epsilon` from now on."""
        self.learning = False

    def report(self) -> Mapping[str, np.ndarray]:
        """Return numbers by name, each (n,): a column of `metrics.parquet` and a curve in the viewer.

        The names are the same from the start of a run.
        """
        return {}

    def deviation(self, slot: int, zeta: np.ndarray) -> np.ndarray | None:
        """Return -ln(gamma) J, drive units, (m,) at states (m, D), of the agent in `slot`, or None."""
        return None

    def follow(self, slots: Collection[int]) -> None:  # noqa: B027
        """Record from now on the decisions of the agents in `slots`, rows of this species; drop those of all others.

        It must not change what an agent does or learns: observers call it.
        """

    def decision(self, slot: int) -> Decision | None:
        """Return the decision that the agent in `slot` acts on, None where there is none.

        It has the numbers with which it was made if the agent was followed then. A learner that returns decisions sets
        `decides`.
        """
        return None

    def plan_ahead(self, slot: int) -> Plan | None:
        """Return the best plan that the agent in `slot` found when it decided, None where it does not look ahead."""
        return None

    def pack(self, slots: np.ndarray) -> Mapping[str, np.ndarray]:
        """Return all that the agents in `slots` (k,) have learned, rows (k, ...) by name, for `unpack` elsewhere.

        Those are the rows of every array of `state` that has a row per slot.
        """
        arrays, _ = self.state()
        return {name: array[slots].copy() for name, array in arrays.items() if array.shape[:1] == (self.size,)}

    def unpack(self, slots: np.ndarray, packed: Mapping[str, np.ndarray]) -> None:
        """Replace the agents in `slots` (k,) by those that another learner of this kind has packed."""
        arrays, values = self.state()
        if packed.keys() != {name for name, array in arrays.items() if array.shape[:1] == (self.size,)}:
            raise EcologyError(
                f"the learner {type(self).__name__} cannot take in {sorted(packed)}; islands between which a species "
                "migrates need the same learner."
            )
        arrays = {name: array.copy() for name, array in arrays.items()}
        for name, rows in packed.items():
            arrays[name][slots] = rows
        self.restore(arrays, values)

    def state(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Return all that the learner has learned: arrays, and plain values that JSON holds."""
        return {}, {"rng": self.rng.bit_generator.state}

    def restore(self, arrays: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> None:
        """Restore what `state` returned."""
        self.rng.bit_generator.state = values["rng"]
