"""Update agents one after another: a step on L_f, a step on L_J, and the scores of their next decisions.

Each agent's weights are one row, and all that an update does with them is done while the row is in the cache.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ecology.agents.hjb.devices.cpu.adam import Extent, Pace, Row, step
from ecology.agents.hjb.devices.cpu.arithmetic import FEW, ZERO, F, copy, scratch_for
from ecology.agents.hjb.devices.cpu.compiler import compiled, inlined, within
from ecology.agents.hjb.devices.cpu.encoding import drive
from ecology.agents.hjb.devices.cpu.first_order import executed_pace
from ecology.agents.hjb.devices.cpu.learning import imagine, learn_f, learn_j, positions, redraw
from ecology.agents.hjb.devices.cpu.llvm import ZEROED, borrow, control_word, keep_alive, replace_last, set_control_word
from ecology.agents.hjb.devices.cpu.networks import inputs_of, layers
from ecology.agents.hjb.devices.cpu.scores import expected_score, scores
from ecology.agents.hjb.devices.records import Agent


class Batch(NamedTuple):
    """Room for what an update draws from memory, and for its gradients, for one agent at a time."""

    g_f: np.ndarray  # (P,)
    g_j: np.ndarray  # (Q,)
    at: np.ndarray  # int (b,)
    at_f: np.ndarray  # int (b',)
    zeta_f: np.ndarray  # (b', D)
    after_f: np.ndarray  # (b', D)
    time_f: np.ndarray  # (b',)
    excess_f: np.ndarray  # (b',)
    movement_f: np.ndarray  # int (b',)
    zeta: np.ndarray  # (b, D)
    pace: np.ndarray  # (b, D)
    movement: np.ndarray  # int (b,)
    open: np.ndarray  # bool (b, M)
    table: np.ndarray  # (b, M)
    target: np.ndarray  # (b,)
    trained: np.ndarray  # bool (M,) heads of f that move
    always: np.ndarray  # bool (1,) the head of J
    neutral: np.ndarray  # (2,) no optimism


@inlined
def batch_for(s, weights, sampling, parts):
    """Return room for the batches of `sampling`, of states with `parts` components."""
    b, bf = sampling.batch, sampling.batch_f
    return Batch(
        np.zeros(weights.f.shape[1], F),
        np.zeros(weights.J.shape[1], F),
        np.empty(b, np.int64),
        np.empty(bf, np.int64),
        np.empty((bf, parts), F),
        np.empty((bf, parts), F),
        np.empty(bf, F),
        np.empty(bf, F),
        np.empty(bf, np.int64),
        np.empty((b, parts), F),
        np.empty((b, parts), F),
        np.empty(b, np.int64),
        np.empty((b, s.movements), np.bool_),
        np.empty((b, s.movements), F),
        np.empty(b, F),
        np.empty(s.movements, np.bool_),
        np.ones(1, np.bool_),
        np.zeros(2, F),
    )


@inlined
def own_constants(s, weights, i):
    """Return the encoding with the constants of agent `i`."""
    return replace_last(s, (weights.log_gamma[i], weights.explored[i], weights.polyak[i]))


@within
def agent_of(weights, i, network, optimism):
    """Return agent `i`, whose J is computed by `network` (Q,)."""
    return Agent(
        weights.f[i],
        network,
        weights.centres[i],
        weights.cells[i],
        optimism,
        weights.marks[i],
        weights.marked[i],
    )


@inlined
def train_f(s, weights, replay, sampling, i, rate, batch, scratch):
    """Take one step on L_f for agent `i`; return the loss."""
    bf = len(batch.at_f)
    own = agent_of(weights, i, weights.J[i], batch.neutral)
    uniform = sampling.uniform[i]
    positions(
        replay.count[i], replay.zeta.shape[1], uniform[sampling.batch :], sampling.late_f, sampling.recent, batch.at_f
    )
    for r in range(bf):
        at = batch.at_f[r]
        copy(replay.zeta[i, at], batch.zeta_f[r])
        copy(replay.after[i, at], batch.after_f[r])
        batch.time_f[r], batch.movement_f[r] = replay.duration[i, at], replay.movement[i, at]
        batch.excess_f[r] = replay.excess[i, at]
    m = sampling.imagined_f
    redraw(s, batch.zeta_f, uniform[len(uniform) - m * len(s.deprivable) :], m)
    sample = batch.zeta_f, batch.movement_f, batch.after_f, batch.time_f, batch.excess_f
    loss = learn_f(s, own, sample, m, scratch, batch.g_f)
    batch.trained[:] = not s.lazy
    for r in range(bf):
        if batch.movement_f[r] >= 0:
            batch.trained[batch.movement_f[r]] = True
    base = len(s.plain) + 2 * len(s.angle)
    inputs = base + own.centres.shape[1]
    row = Row(weights.f[i], weights.f_first[i], weights.f_second[i], weights.f_steps[i])
    step(
        s,
        row,
        batch.g_f,
        Pace(rate, s.weight_decay),
        Extent(base + own.cells, inputs, bf),
        batch.trained,
        scratch,
        weights.J[i],
    )
    if bf <= FEW:
        _, _, _, _, g3, gb3 = layers(batch.g_f, inputs, s.width)
        for r in range(bf):
            head = max(batch.movement_f[r], 0) * s.outputs
            g3[head : head + s.outputs], gb3[head : head + s.outputs] = ZERO, ZERO
    return loss


@inlined
def train_j(s, weights, replay, sampling, i, rate, batch, scratch):
    """Take one step on L_J for agent `i`, and let the slow copy of J follow; return the loss."""
    b, m, zeta, movement, target = len(batch.at), sampling.imagined, batch.zeta, batch.movement, batch.target
    uniform = sampling.uniform[i]
    positions(replay.count[i], replay.zeta.shape[1], uniform, sampling.late, sampling.recent, batch.at)
    for r in range(b):
        at = batch.at[r]
        copy(replay.zeta[i, at], zeta[r])
        movement[r] = replay.movement[i, at]
        for v in range(s.movements):
            batch.open[r, v] = replay.open[i, at, v] if s.minimum else v == max(movement[r], 0)
    if m:
        imagine(s, zeta, uniform[b + sampling.batch_f :], sampling.normal[i], m)
    slow = agent_of(weights, i, weights.target[i], batch.neutral)  # no optimism: the target stays what was met
    if s.minimum or s.finite:
        scores(s, slow, zeta, batch.open, scratch, batch.table)
        for r in range(b):
            target[r] = min(max(expected_score(s, batch.table[r]), ZERO), s.ceiling)
    else:
        executed_pace(s, slow, zeta, movement, scratch, batch.pace)
        for r in range(b):
            target[r] = drive(s, replay.after[i, batch.at[r]], scratch.mixed)
    own = agent_of(weights, i, weights.J[i], batch.neutral)
    loss = learn_j(s, own, (zeta, movement, target, batch.pace), scratch, batch.g_j)
    base = len(s.plain) + 2 * len(s.angle)
    extent = Extent(base + own.cells, base + own.centres.shape[1], b if s.finite or s.minimum else 2 * b)
    row = Row(weights.J[i], weights.J_first[i], weights.J_second[i], weights.J_steps[i])
    step(s, row, batch.g_j, Pace(rate, ZERO), extent, batch.always, scratch, weights.f[min(i + 1, len(weights.f) - 1)])
    if s.slow:
        follows, leads = weights.target[i], weights.J[i]
        for p in range(len(follows)):
            follows[p] += s.polyak * (leads[p] - follows[p])
    return loss


@compiled
def update(s, weights, replay, sampling, training, lookahead, start, stop):
    """Take one step on L_f and on L_J for every `ready` agent from `start` to `stop`; score what is in `lookahead`."""
    parts, b, bf = replay.zeta.shape[2], sampling.batch, sampling.batch_f
    inputs = inputs_of(s, weights)
    scratch = scratch_for(s, max(b * s.movements, bf), parts, s.movements * s.outputs, inputs, b)
    batch = batch_for(s, weights, sampling, parts)
    word = control_word()
    set_control_word(word | ZEROED)
    kept = scratch, batch
    s, weights, replay, sampling = borrow(s), borrow(weights), borrow(replay), borrow(sampling)
    scratch, batch, lookahead = borrow(scratch), borrow(batch), borrow(lookahead)
    for i in range(start, stop):
        if not training.ready[i]:
            continue
        mine = own_constants(s, weights, i)
        training.loss_f[i] = train_f(mine, weights, replay, sampling, i, training.rate[i], batch, scratch)
        training.loss_j[i] = train_j(mine, weights, replay, sampling, i, training.rate[i], batch, scratch)
        if lookahead.open[i].any():
            own = agent_of(weights, i, weights.target[i], weights.optimism[i])
            zeta, open_ = lookahead.zeta[i : i + 1], lookahead.open[i : i + 1]
            scores(mine, own, zeta, open_, scratch, lookahead.score[i : i + 1])
    set_control_word(word)
    keep_alive(kept)
