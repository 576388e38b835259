"""Update one agent: a step on L_f, and a step on L_J."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from ecology.agents.hjb.devices.plain.adam import Row, step
from ecology.agents.hjb.devices.plain.encoding import drive
from ecology.agents.hjb.devices.plain.first_order import executed_pace
from ecology.agents.hjb.devices.plain.learning import imagine, learn_f, learn_j, positions, redraw
from ecology.agents.hjb.devices.plain.networks import inputs_of, layers
from ecology.agents.hjb.devices.plain.scores import expected_score, scores
from ecology.agents.hjb.devices.records import Agent, Replay, Sampling, Weights


def own_constants(s: Any, weights: Weights, i: int) -> Any:
    """Return the encoding with the constants of agent `i`."""
    numbers = {name: float(getattr(weights, name)[i]) for name in ("log_gamma", "explored", "polyak")}
    return SimpleNamespace(**{**vars(s), **numbers})


def agent_of(s: Any, weights: Weights, i: int, network: np.ndarray, optimism: np.ndarray | None) -> Agent:
    """Return agent `i`, whose J is computed by `network` (Q,)."""
    inputs = inputs_of(s, weights)
    return Agent(
        layers(s, weights.f[i], inputs),
        layers(s, network, inputs),
        weights.centres[i],
        weights.cells[i],
        optimism,
        weights.marks[i],
        weights.marked[i],
    )


def train_f(s: Any, weights: Weights, replay: Replay, sampling: Sampling, i: int, rate: float) -> float:
    """Take one step on L_f for agent `i`; return the loss."""
    own = agent_of(s, weights, i, weights.J[i], None)
    leaves = [layer.detach().requires_grad_() for layer in own.f]
    uniform = sampling.uniform[i, sampling.batch : sampling.batch + sampling.batch_f]
    at = positions(int(replay.count[i]), replay.zeta.shape[1], uniform, sampling.late_f, sampling.recent)
    drawn = (replay.zeta, replay.after, replay.duration, replay.excess)
    zeta, after, duration, excess = (torch.from_numpy(array[i, at]) for array in drawn)
    movement = torch.from_numpy(replay.movement[i, at].astype(np.int64))
    m, numbers = sampling.imagined_f, sampling.uniform[i]
    zeta = redraw(s, zeta, numbers[len(numbers) - m * len(s.deprivable) :], m)
    loss = learn_f(s, own._replace(f=leaves), (zeta, movement, after, duration, excess), m)
    loss.backward()
    trained = np.isin(np.arange(s.movements), movement.numpy()) if s.lazy else np.ones(s.movements, bool)
    row = Row(weights.f[i], weights.f_first[i], weights.f_second[i], weights.f_steps[i])
    step(row, leaves, rate, float(s.weight_decay), trained)
    return loss.item()


def train_j(s: Any, weights: Weights, replay: Replay, sampling: Sampling, i: int, rate: float) -> float:
    """Take one step on L_J for agent `i`, and let the slow copy of J follow; return the loss."""
    b, uniform = sampling.batch, sampling.uniform[i]
    at = positions(int(replay.count[i]), replay.zeta.shape[1], uniform[:b], sampling.late, sampling.recent)
    movement = torch.from_numpy(replay.movement[i, at].astype(np.int64))
    zeta = torch.from_numpy(replay.zeta[i, at])
    zeta = imagine(s, zeta, uniform[b + sampling.batch_f :], sampling.normal[i], sampling.imagined)
    slow = agent_of(s, weights, i, weights.target[i], None)  # no optimism: the target stays what was met
    pace = zeta
    if s.minimum or s.finite:
        did = functional.one_hot(movement.clamp(min=0), s.movements).bool()
        target = expected_score(s, scores(s, slow, zeta, torch.from_numpy(replay.open[i, at]) if s.minimum else did))
        target = target.clamp(0, s.ceiling)
    else:
        pace = executed_pace(s, slow, zeta, movement)
        target = drive(s, torch.from_numpy(replay.after[i, at]))
    own = agent_of(s, weights, i, weights.J[i], None)
    leaves = [layer.detach().requires_grad_() for layer in own.J]
    loss = learn_j(s, own._replace(J=leaves), (zeta, movement, target, pace))
    loss.backward()
    row = Row(weights.J[i], weights.J_first[i], weights.J_second[i], weights.J_steps[i])
    step(row, leaves, rate, 0.0, np.ones(1, bool))
    if s.slow:
        torch.from_numpy(weights.target[i]).lerp_(torch.from_numpy(weights.J[i]), s.polyak)
    return loss.item()


def update(s: Any, weights: Weights, replay: Replay, sampling: Sampling, i: int, rate: float) -> tuple[float, float]:
    """Take one step on L_f and on L_J for agent `i`; return both losses."""
    s = own_constants(s, weights, i)
    loss_f = train_f(s, weights, replay, sampling, i, rate)
    return loss_f, train_j(s, weights, replay, sampling, i, rate)
