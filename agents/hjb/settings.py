"""Settings of the f/J learner: what can be set, within which limits, and the named choices."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ecology.errors import EcologyError

if TYPE_CHECKING:
    from ecology.heredity import LearnerTrait


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
    option_cost: bool = False  # f predicts the drive on the way too (options: Sutton, Precup and Singh 1999)
    minimum_in_loss: bool = True  # L_J is the residual of the HJB equation, its min included
    replay: bool = True  # learn from remembered decisions, not the newest alone (Mnih et al. 2015)
    intra_option: bool = True  # learn from states within a movement too (Sutton, Precup and Singh 1999)
    batch: int = 64  # decisions per gradient step on L_J
    batch_f: int = 128  # decisions per gradient step on L_f
    recent_share: float = 0.1  # share of a batch that comes from the last `recent` decisions
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
    errors: int = 64  # latest decisions whose errors of f, and what was open, are remembered in evaluation too; 0: none
    marks: int = 256  # places that an agent can know to have reached or aimed at
    mark_reach: float = 1.25  # length around a place reached that counts as known
    aim_reach: float = 0.5  # length around a place aimed at in vain that counts as known
    boredom: float = 0.1  # rate at which curiosity follows the share of attempts that found a new place
    patience: int = 100  # decisions without a new place after which a search begins again, more closely
    notice: bool = True  # a movement ends when another opens that was never made (Sutton, Precup and Singh 1999)
    doubt: int = 5  # memories around an empty place after which a meal is no longer expected there; 0: never
    doubt_reach: float = 1.0  # length around a place within which such memories count and are corrected
    reluctance: float = 0.02  # share of the score of rest by which other movements must be better at birth
    near: float = 0.25  # length, standard deviation of the kernel that weighs remembered errors by distance
    near_angle: float = 0.6  # radians, standard deviation of the same kernel for angles
    searched: int = 4000  # latest decisions that are searched for the open movements at a predicted state
    imagined: float = 0.5  # share of J's batch whose needs are redrawn, the rest of zeta kept
    imagined_f: float = 0.5  # share of f's batch whose needs are redrawn: on none of them depends where movements lead
    relative_weight: int = 1  # power of 1 / d by which L_J weighs small drives d more; 0: not at all
    learn_value: bool = True  # the network of J learns V = d - Jn, so that J begins as the drive
    target_network: bool = True  # a slow copy of J in the target (Lillicrap et al. 2016), by which an agent acts
    polyak: float = 0.03  # share by which the slow copy follows J per gradient step
    target_explores: bool = True  # the target is that of an agent that explores with `epsilon_final`
    weight_decay: float = 0.1  # of the weights of f's heads, per unit of the learning rate (Loshchilov and Hutter 2019)
    lazy_heads: bool = False  # Adam does not move heads of f that no decision of the batch trained
    inherit: bool = False  # a newborn starts from what its parent has learned, not from nothing
    mutation: float = 0.0  # standard deviation of inherited weights, relative to each layer's root mean square

    def __post_init__(self) -> None:
        for names, rule, holds in RULES:
            for name in names:
                value = getattr(self, name)
                if not (math.isfinite(value) and holds(value)):
                    raise EcologyError(f"learner setting {name} must be {rule}, got {value!r}.")


# settings that agents can inherit, each a number of its own: they shape no array and no schedule
HERITABLE = (
    "gamma", "youth", "epsilon", "epsilon_final", "settling", "learning_rate", "learning_rate_final", "optimism",
    "optimism_young", "polyak", "mutation",
)  # fmt: skip


def check_bounds(settings: HJBSettings, trait: LearnerTrait) -> None:
    """Raise EcologyError where a setting that agents inherit could leave its limits."""
    for bound in trait.bounds:
        changed: dict[str, Any] = {trait.setting: float(bound)}
        try:
            dataclasses.replace(settings, **changed)
        except EcologyError as error:
            raise EcologyError(f"the trait {trait.name!r} has bounds {trait.bounds!r}: {error}") from error


RULES: tuple[tuple[tuple[str, ...], str, Callable[[float], bool]], ...] = (
    (("gamma",), "between 0 and 1, both excluded", lambda v: 0 < v < 1),
    (
        (
            "epsilon",
            "epsilon_final",
            "recent_share",
            "imagined",
            "imagined_f",
            "optimism",
            "optimism_young",
            "reluctance",
        ),
        "from 0 to 1",
        lambda v: 0 <= v <= 1,
    ),
    (
        ("place_cells", "mutation", "errors", "tries", "relative_weight", "weight_decay", "doubt"),
        "0 or more",
        lambda v: v >= 0,
    ),
    (
        (
            "width",
            "batch",
            "batch_f",
            "recent",
            "memory",
            "updates",
            "persistence",
            "depth",
            "beam",
            "searched",
            "patience",
        ),
        "1 or more",
        lambda v: v >= 1,
    ),
    (("place_spacing", "place_width", "doubt_reach"), "a length of at least 0.001", lambda v: v >= 1e-3),
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
    "imagined_f": 0.0,
    "optimism": 0.0,
    "relative_weight": 0,
    "persistence": 1,
    "intra_option": False,
    "target_network": False,
    "lazy_heads": True,
    "weight_decay": 0.0,
    "depth": 1,
    "errors": 0,
    "reluctance": 0.0,
    "notice": False,
    "doubt": 0,
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


# little work for many agents. Since it takes few gradient steps, the learning rate falls ten times later: see
# docs/performance.md
LEAN: Mapping[str, Any] = {
    "width": 32,
    "batch": 32,
    "batch_f": 64,
    "update_every": 8.0,
    "updates": 1,
    "depth": 1,
    "errors": 0,
    "imagined_f": 0.0,
    "recent_share": 0.4,
    "relative_weight": 2,
    "reluctance": 0.0,
    "notice": False,
    "doubt": 0,
    "settling": 40_000.0,
}


# for ten thousand minds in one world: a small memory, and no optimism, which few steps do not unlearn
CROWD: Mapping[str, Any] = {**LEAN, "memory": 2000, "update_every": 2.0, "optimism": 0.0}
