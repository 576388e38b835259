"""Update all agents at once: a step on L_f, and a step on L_J."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ecology.agents.hjb.devices.records import Agent, Replay, Sampling, Weights
from ecology.agents.hjb.devices.torch.adam import Row, step
from ecology.agents.hjb.devices.torch.encoding import drive
from ecology.agents.hjb.devices.torch.first_order import executed_pace
from ecology.agents.hjb.devices.torch.learning import imagine, learn_f, learn_j, positions, redraw
from ecology.agents.hjb.devices.torch.lookahead import rows_at
from ecology.agents.hjb.devices.torch.networks import inputs_of, layers
from ecology.agents.hjb.devices.torch.scores import expected_score, scores


def own_constants(s: Any, weights: Weights, rows: Any) -> Any:
    """Return the encoding with the constants of the agents in `rows` (a,), to be used with (a, R, M) and (a, R)."""
    log_gamma, explored, polyak = (each[rows, None] for each in (weights.log_gamma, weights.explored, weights.polyak))
    return SimpleNamespace(**{**vars(s), "log_gamma": log_gamma[..., None], "explored": explored, "polyak": polyak})


def agent_of(s: Any, weights: Weights, network: Tensor, optimism: Tensor | None) -> Agent:
    """Return the agents of `weights`, whose J is computed by `network` (a, Q)."""
    inputs = inputs_of(s, weights)
    return Agent(
        layers(s, weights.f, inputs),
        layers(s, network, inputs),
        weights.centres,
        weights.cells,
        optimism,
        weights.marks,
        weights.marked,
    )


def train_f(s: Any, weights: Weights, replay: Replay, sampling: Sampling, learns: Tensor, rate: Tensor) -> Tensor:
    """Take one step on L_f for the agents that learn (a, 1); return the losses (a,)."""
    own = agent_of(s, weights, weights.J, None)
    leaves = [layer.detach().requires_grad_() for layer in own.f]
    uniform = sampling.uniform[:, sampling.batch : sampling.batch + sampling.batch_f]
    at = positions(replay.count, replay.zeta.shape[1], uniform, sampling.late_f, sampling.recent)
    drawn = replay.zeta, replay.after, replay.duration, replay.movement, replay.excess
    zeta, after, duration, movement, excess = (rows_at(array, at) for array in drawn)
    m, numbers = sampling.imagined_f, sampling.uniform
    zeta = redraw(s, zeta, numbers[:, numbers.shape[1] - m * len(s.deprivable) :], m)
    with torch.enable_grad():
        loss = learn_f(s, own._replace(f=leaves), (zeta, movement, after, duration, excess), m)
        loss.sum().backward()
    trained = torch.ones_like(weights.f_steps[:, 1:], dtype=torch.bool)
    if s.lazy:
        ran = functional.one_hot(movement.clamp(min=0).long(), s.movements).bool()
        trained = (ran & (movement >= 0)[..., None]).any(1)
    row = Row(weights.f, weights.f_first, weights.f_second, weights.f_steps)
    step(row, leaves, rate, float(s.weight_decay), learns, trained)
    return loss.detach()


def train_j(s: Any, weights: Weights, replay: Replay, sampling: Sampling, learns: Tensor, rate: Tensor) -> Tensor:
    """Take one step on L_J for the agents that learn (a, 1), and let the slow copies follow; return the losses (a,)."""
    b = sampling.batch
    at = positions(replay.count, replay.zeta.shape[1], sampling.uniform[:, :b], sampling.late, sampling.recent)
    zeta, movement = rows_at(replay.zeta, at), rows_at(replay.movement, at)
    zeta = imagine(s, zeta, sampling.uniform[:, b + sampling.batch_f :], sampling.normal, sampling.imagined)
    slow = agent_of(s, weights, weights.target, None)  # no optimism: the target stays what was met
    pace = zeta
    if s.minimum or s.finite:
        did = functional.one_hot(movement.clamp(min=0).long(), s.movements).bool()
        table = scores(s, slow, zeta, rows_at(replay.open, at) if s.minimum else did)
        target = expected_score(s, table).clamp(0.0, s.ceiling)
    else:
        pace = executed_pace(s, slow, zeta, movement)
        target = drive(s, rows_at(replay.after, at))
    own = agent_of(s, weights, weights.J, None)
    leaves = [layer.detach().requires_grad_() for layer in own.J]
    with torch.enable_grad():
        loss = learn_j(s, own._replace(J=leaves), (zeta, movement, target, pace))
        loss.sum().backward()
    row = Row(weights.J, weights.J_first, weights.J_second, weights.J_steps)
    step(row, leaves, rate, 0.0, learns, torch.ones_like(learns))
    if s.slow:
        weights.target.lerp_(weights.J, s.polyak * learns.float())
    return loss.detach()


def update(s: Any, weights: Weights, replay: Replay, sampling: Sampling, learns: Tensor, rate: Tensor) -> Tensor:
    """Take one step on L_f and on L_J for the agents that learn (a, 1), all views; return the losses (2, a)."""
    s = own_constants(s, weights, slice(None))
    loss_f = train_f(s, weights, replay, sampling, learns, rate)
    return torch.stack([loss_f, train_j(s, weights, replay, sampling, learns, rate)])
