"""Look several movements ahead: a beam search in which f is corrected by its latest errors."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ecology.agents.hjb.devices import records
from ecology.agents.hjb.devices.cpu.arithmetic import (
    HALF,
    LONGEST,
    ONE,
    TURN,
    ZERO,
    F,
    copy,
    exp32,
    product_back,
    reshape,
)
from ecology.agents.hjb.devices.cpu.compiler import inlined, within
from ecology.agents.hjb.devices.cpu.encoding import drive
from ecology.agents.hjb.devices.cpu.networks import deviations, hidden_layer, inputs_of, layers
from ecology.agents.hjb.devices.cpu.scores import add_optimism

PRIOR, FADING, STALE, FAINT = F(records.PRIOR), F(records.FADING), F(records.STALE), F(records.FAINT)


class Beam(NamedTuple):
    """Room for a lookahead: B states to look ahead from, and their B M successors."""

    state: np.ndarray  # (B, D)
    cost: np.ndarray  # (B,) discounted drive on the way here
    keep: np.ndarray  # (B,) discount here
    root: np.ndarray  # int (B,) first movement on the way here
    open: np.ndarray  # bool (B, M)
    next_state: np.ndarray  # (B M, D)
    next_cost: np.ndarray
    next_keep: np.ndarray
    next_root: np.ndarray
    score: np.ndarray  # (B M,)
    taken: np.ndarray  # bool (B M,)
    bias: np.ndarray  # (M, E) correction of f
    support: np.ndarray  # (M,) weight of the errors behind it


@inlined
def beam_for(s, parts):
    """Return room for a lookahead over zeta of `parts` components."""
    size = max(s.beam, s.movements)
    return Beam(
        np.empty((size, parts), F),
        np.empty(size, F),
        np.empty(size, F),
        np.empty(size, np.int64),
        np.empty((size, s.movements), np.bool_),
        np.empty((size * s.movements, parts), F),
        np.empty(size * s.movements, F),
        np.empty(size * s.movements, F),
        np.empty(size * s.movements, np.int64),
        np.empty(size * s.movements, F),
        np.empty(size * s.movements, np.bool_),
        np.empty((s.movements, s.outputs), F),
        np.empty(s.movements, F),
    )


@within
def square(s, w, gap):
    """Return the square of a gap between two zetas in component `w` of those that locate the agent."""
    if s.turning[w]:
        gap -= TURN * F(math.floor(gap / TURN + HALF))
    gap *= s.nearness[w]
    return gap * gap


@within
def distance(s, zeta, where):
    """Return the squared distance between zeta (D,) and a place `where` (W,), in standard deviations."""
    total = ZERO
    for w in range(len(where)):
        total += square(s, w, zeta[s.where[w]] - where[w])
    return total


@within
def recall(s, past, zeta, bias, support):
    """Fill `bias` (M, E) with the error of f to be expected at zeta (D,) by movement, from those remembered.

    A mean weighted by how near and how recent they are, with a prior of no error: Nadaraya-Watson regression.
    """
    bias[:], support[:] = ZERO, PRIOR
    for k in range(min(past.noted, len(past.movement))):
        exponent = -HALF * distance(s, zeta, past.where[k]) - (past.now - past.time[k]) / FADING
        if exponent > FAINT:
            weight, m = exp32(exponent), past.movement[k]
            support[m] += weight
            for v in range(bias.shape[1]):
                bias[m, v] += weight * past.error[k, v]
    for m in range(len(support)):
        for v in range(bias.shape[1]):
            bias[m, v] /= support[m]


@within
def recall_open(s, past, zeta, here, open_, out):
    """Fill out (M,) with what was open at the decision nearest to zeta (D,); newer ones count as nearer.

    The newest is the one that is being made, at `here` (D,) with `open_` (M,). The others are those whose errors are
    remembered, and those of the replay buffer.
    """
    best, found, capacity = ZERO, -1, len(past.zeta)
    for w in range(len(s.where)):
        best += square(s, w, zeta[s.where[w]] - here[s.where[w]])
    copy(open_, out)
    for back in range(min(past.noted, len(past.movement))):
        at = (past.noted - 1 - back) % len(past.movement)
        total = F(back + 1) * STALE + distance(s, zeta, past.where[at])
        if total < best:
            best = total
            copy(past.possible[at], out)
    for back in range(min(min(past.count, capacity), s.searched)):
        at = (past.count - 1 - back) % capacity
        total = F(back + 1) * STALE
        for w in range(len(s.where)):
            total += square(s, w, zeta[s.where[w]] - past.zeta[at, s.where[w]])
        if total < best:
            best, found = total, at
    if found >= 0:
        copy(past.open[found], out)


@within
def look_ahead(s, own, past, zeta, open_, scratch, beam, out):
    """Fill out (M,) with the score of the open movements, the least over what may follow; infinity for the others.

    A beam search over `depth` movements: the discounted drive on the way and J at its end. The best successor of every
    first movement is kept, so all have the same depth. What is open at a predicted state is what was open at the
    nearest decision, this one included.
    """
    nodes = np.int64(1)  # a literal would be compiled for, and then an integer
    beam.cost[0], beam.keep[0] = ZERO, ONE
    copy(zeta, beam.state[0])
    copy(open_, beam.open[0])
    out[:] = np.inf
    for level in range(s.depth):
        count = expand(s, own, past, level, nodes, scratch, beam)
        deviations(s, own, beam.next_state[:count], scratch)
        add_optimism(s, own, beam.next_state[:count], scratch.outputs)
        for c in range(count):
            beam.score[c] = beam.next_cost[c] + beam.next_keep[c] * scratch.outputs[c]
        if level == s.depth - 1:
            for c in range(count):
                out[beam.next_root[c]] = min(out[beam.next_root[c]], beam.score[c])
            break
        nodes = keep_best(s, beam, count)
        for r in range(nodes):
            recall_open(s, past, beam.state[r], zeta, open_, beam.open[r])


@inlined
def expand(s, own, past, level, nodes, scratch, beam):
    """Predict the successors of the first `nodes` states of the beam; return how many there are."""
    parts = beam.state.shape[1]
    second = hidden_layer(s, own, beam.state[:nodes], scratch)
    _, _, _, _, w3, b3 = layers(own.f, inputs_of(s, own), s.width)
    raw = reshape(scratch.outputs, nodes, len(w3))
    product_back(second, w3, raw)
    count = 0
    for r in range(nodes):
        here = beam.state[r]
        d = drive(s, here, scratch.mixed)
        recall(s, past, here, beam.bias, beam.support)
        for m in range(s.movements):
            if not beam.open[r, m]:
                continue
            o = m * s.outputs
            tau = (raw[r, o + parts] + b3[o + parts]) * s.unit[parts] + beam.bias[m, parts]
            tau = min(max(tau, s.dt), LONGEST)
            ahead = beam.next_state[count]
            for v in range(parts):
                change = (raw[r, o + v] + b3[o + v]) * s.unit[v] + beam.bias[m, v]
                ahead[v] = min(max(here[v] + change, s.low[v]), s.high[v])
            keep = exp32(max(tau * s.log_gamma, F(-80.0)))
            if s.costed:
                excess = (raw[r, o + parts + 1] + b3[o + parts + 1]) * s.unit[parts + 1] + beam.bias[m, parts + 1]
                beam.next_cost[count] = beam.cost[r] + beam.keep[r] * ((ONE - keep) * d + excess)
            else:
                drives = d + drive(s, ahead, scratch.mixed)
                beam.next_cost[count] = beam.cost[r] + beam.keep[r] * (ONE - keep) * HALF * drives
            beam.next_keep[count] = beam.keep[r] * keep
            beam.next_root[count] = m if level == 0 else beam.root[r]
            count += 1
    return count


@within
def keep_best(s, beam, count):
    """Keep the best successor of every first movement, and of the others the best that there is room for."""
    beam.taken[:count] = False
    nodes = np.int64(0)  # a literal would be compiled for, and then an integer
    for m in range(s.movements):
        best = -1
        for c in range(count):
            if beam.next_root[c] == m and (best < 0 or beam.score[c] < beam.score[best]):
                best = c
        if best >= 0:
            nodes = keep_one(beam, best, nodes)
    while nodes < min(count, len(beam.state)):
        best = -1
        for c in range(count):
            if not beam.taken[c] and (best < 0 or beam.score[c] < beam.score[best]):
                best = c
        nodes = keep_one(beam, best, nodes)
    return nodes


@within
def keep_one(beam, c, nodes):
    """Make the successor c the next state to look ahead from; return how many there are."""
    beam.taken[c] = True
    copy(beam.next_state[c], beam.state[nodes])
    beam.cost[nodes], beam.keep[nodes], beam.root[nodes] = beam.next_cost[c], beam.next_keep[c], beam.next_root[c]
    return nodes + 1
