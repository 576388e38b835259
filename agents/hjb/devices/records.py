"""What devices are given and give back: records of arrays, and the constants of the learner's arithmetic.

Shapes: n agents, b states, D components of zeta, M movements, I inputs, H hidden units, C place cells, E outputs of f
per movement: the change of zeta, its duration and, where f is `costed`, its excess. This is the discounted drive on the
way, less that at its start for as long.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

LONGEST = 300.0  # units of time, of a predicted duration
PRIOR = 0.3  # weight of "no error" among the remembered errors of f
FADING = 2000.0  # units of time over which a remembered error fades
STALE = 1e-4  # squared distance that is added per decision made since
SILENT = -30.0  # exponent of a place cell below which it is silent; keeps subnormal numbers out
FAINT = -8.0  # exponent of a remembered error's weight below which the error is left out
BETA1, BETA2, TINY = 0.9, 0.999, 1e-8  # of Adam

Array = Any  # of NumPy, or as another device holds it


class Encoding(NamedTuple):
    """What all agents of one learner share: how zeta becomes inputs and drive, and the equation's constants."""

    centre: Array  # (D,)
    inverse: Array  # (D,) 1 / scale
    scale: Array  # (D,)
    low: Array  # (D,)
    high: Array  # (D,)
    unit: Array  # (E,) of f's outputs
    plain: Array  # int, components that are inputs as they are
    angle: Array  # int, components that are inputs by cosine and sine
    place: Array  # int (2,)
    need: Array  # bool (D,)
    deprivable: Array  # int, needs that can be deprived
    mix_from: Array  # int: |zeta mix|^2 of the drive, entry by entry
    mix_to: Array
    mix_weight: Array
    felt: Array  # (D,)
    epsilon: np.float32  # of the drive
    exponent: np.float32
    root: np.float32  # exponent / power
    power: np.float32  # n of the drive
    above: Array  # (D,) factor of what lies above its set point
    bent: bool  # whether power or any factor is another than the paper's, 2 and 1
    sharp: np.float32  # 1 / width^2 of a place cell
    dt: np.float32
    centre_j: np.float32  # Jn = centre_j + spread_j x output
    spread_j: np.float32
    ceiling: np.float32  # of targets of Jn
    weight_top: np.float32  # of the relative loss weight, (top / (floor + d))^power
    weight_floor: np.float32
    weight_power: int  # 0: all drives weigh the same
    deprived: np.float32  # imagined deviations lie between these, times the scale
    sated: np.float32
    width: int  # H
    movements: int  # M
    outputs: int  # E
    costed: bool  # f predicts the drive on the way too
    finite: bool  # the score over a whole movement
    minimum: bool  # the min in L_J
    anchored: bool  # J is the drive plus the output of the network
    slow: bool  # whether there is a target network
    weight_decay: np.float32  # decay of the weights of f's heads, per unit of the learning rate
    lazy: bool  # Adam leaves heads of f alone that no decision of the batch trains
    spatial: Array  # bool (E,) positions and angles, of an agent that senses its position
    where: Array  # int (W,) components of zeta that locate the agent: neither needs nor felt
    nearness: Array  # (W,) 1 / sd of each in the kernel that measures how near two states are
    turning: Array  # bool (W,) which of them are angles
    length: Array  # (M,) ordinary length of a movement in ticks
    depth: int  # movements that a decision looks ahead
    beam: int  # predicted states kept per depth
    searched: int  # newest decisions among which the one nearest to a predicted state is looked up
    # the last three are an agent's own where a device computes for it: see `Weights`
    log_gamma: np.float32
    explored: np.float32  # share of exploration that the target of J assumes
    polyak: np.float32  # share by which the slow copy of J follows it per update


class Weights(NamedTuple):
    """What n agents have learned: a row of weights each."""

    f: Array  # (n, P) w1 (I, H), b1, w2 (H, H), b2, w3 (M E, H), b3
    f_first: Array  # Adam's moments
    f_second: Array
    f_steps: Array  # int (n, 1 + M) of the hidden layers, and of every head
    J: Array  # (n, Q) the same with one output
    J_first: Array
    J_second: Array
    J_steps: Array  # int (n, 2)
    target: Array  # (n, Q) J itself without a target network
    centres: Array  # (n, 2, C) of place cells
    cells: Array  # int (n,) how many place cells are in use
    optimism: Array  # (n, 2) by which J of unknown places is lowered: a share of it, and drive units
    marks: Array  # (n, 3, K) places visited or aimed at: x, y and squared reach
    marked: Array  # int (n,) how many
    log_gamma: Array  # (n,) the last three of `Encoding`, of every agent
    explored: Array  # (n,)
    polyak: Array  # (n,)


class Agent(NamedTuple):
    """What one agent predicts with; on torch a batch of agents. `J` is the network itself or its slow copy."""

    f: Array
    J: Array
    centres: Array
    cells: Array
    optimism: Array
    marks: Array
    marked: Array


class Replay(NamedTuple):
    """The replay buffer: a ring of decisions per agent, see `ecology.agents.hjb.memory`."""

    zeta: Array
    after: Array
    duration: Array
    movement: Array
    open: Array
    excess: Array  # (n, K) discounted drive on the way, less that at the start for as long
    count: Array  # (n,) decisions so far


class Trace(NamedTuple):
    """The latest decisions with the errors of f in them: a ring of L per agent, kept in evaluation too."""

    where: Array  # (n, L, W) where the decision was made
    movement: Array  # int16 (n, L)
    error: Array  # (n, L, E) what was met, less what f predicted
    possible: Array  # bool (n, L, M) the movements that were open
    time: Array  # (n, L) age of the agent at the decision, units of time
    count: Array  # int (n,) decisions so far


class RecalledErrors(NamedTuple):
    """What a lookahead recalls, of one agent; on torch of a batch of agents."""

    where: Array  # the rows of `Trace`
    movement: Array
    error: Array
    possible: Array
    time: Array
    noted: Array
    now: Array  # age, units of time
    zeta: Array  # rows of `Replay`
    open: Array
    count: Array


class Sampling(NamedTuple):
    """How a batch is drawn, and the random numbers for it."""

    uniform: Array  # (n, >= batch + batch_f + m D + m + m // 2 + m_f E), E deprivable needs
    normal: Array  # (n, m // 2, D)
    batch: int
    batch_f: int
    recent: int
    late: int  # of the batch on J, those from the `recent` decisions
    late_f: int
    imagined: int  # m, of the batch on J, those whose needs are redrawn
    imagined_f: int  # m_f, the same of the batch on f, which serve the spatial components alone


class Training(NamedTuple):
    """Which agents an update trains, how fast, and the losses that it fills in."""

    ready: np.ndarray  # bool (n,)
    rate: np.ndarray  # (n,)
    loss_f: np.ndarray  # (n,)
    loss_j: np.ndarray  # (n,)


class Lookahead(NamedTuple):
    """The next decisions, which an update scores in the same pass, while weights are in the cache."""

    zeta: np.ndarray  # (n, D)
    open: np.ndarray  # bool (n, M); nothing is open where nothing is to be decided
    score: np.ndarray  # (n, M)
