"""The f/J learner once more, plainly: one agent, torch modules, automatic gradients, torch's Adam, no stacking.

It is the reference that the compiled kernels are held to, and what their speed is compared with.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ecology.agents import hjb, kernels
from ecology.agents.base import drive_terms
from ecology.agents.hjb import HJB


def network(sizes: list[int], activation: type[nn.Module], row: np.ndarray) -> nn.Sequential:
    """Return a module with the weights of one agent's row: (in, out) per layer but the last, which is (out, in)."""
    parts: list[nn.Module] = []
    at = 0
    for k, (fan_in, fan_out) in enumerate(itertools.pairwise(sizes)):
        layer, last = nn.Linear(fan_in, fan_out), k == len(sizes) - 2
        values = torch.from_numpy(row[at : at + fan_in * fan_out].copy())
        layer.weight.data = values.view(fan_out, fan_in) if last else values.view(fan_in, fan_out).T.clone()
        at += fan_in * fan_out
        layer.bias.data = torch.from_numpy(row[at : at + fan_out].copy())
        at += fan_out
        parts += [layer] if last else [layer, activation()]
    assert at == len(row)
    return nn.Sequential(*parts)


def as_row(module: nn.Sequential) -> np.ndarray:
    """Return a module's weights as a row."""
    linear = [layer for layer in module if isinstance(layer, nn.Linear)]
    parts = []
    for layer in linear:
        weight = layer.weight if layer is linear[-1] else layer.weight.T
        parts += [weight.detach().reshape(-1), layer.bias.detach()]
    return torch.cat(parts).numpy()


class PlainAgent:
    """The agent in one slot of a learner, copied; it learns from the learner's memory of that slot."""

    def __init__(self, learner: HJB, slot: int) -> None:
        self.learner, self.slot, self.s = learner, slot, learner.settings
        layout = learner.group.layout
        kinds = np.array(layout.kinds)
        mix, felt, self.exponent = drive_terms(layout)
        self.mix, self.felt, self.eps = torch.from_numpy(mix), torch.from_numpy(felt), float(layout.epsilon)
        self.scale = torch.tensor(layout.scale, dtype=torch.float32)
        self.plain, self.angle = np.flatnonzero(kinds != "angle"), np.flatnonzero(kinds == "angle")
        self.place = np.flatnonzero(kinds == "position")[:2]
        self.need = kinds == "deviation"
        self.can = self.need & layout.regulated & (layout.low < 0)
        self.centre = torch.tensor(np.where(kinds == "position", (layout.low + layout.high) / 2, 0)).float()
        huge = np.where(kinds == "angle", 1e30, 0.0)
        self.low = torch.tensor(np.where(huge > 0, -huge, np.maximum(layout.low, -1e30))).float()
        self.high = torch.tensor(np.where(huge > 0, huge, np.minimum(layout.high, 1e30))).float()
        worst = layout.scale[self.can] if self.can.any() else layout.scale[self.need]
        self.worst = float(np.sqrt((worst**2).sum())) ** self.exponent
        self.parts, self.count, self.dt = len(kinds), learner.count, learner.group.dt
        unit = torch.where(torch.tensor(self.need | (kinds == "felt")), 0.1 * self.scale, 0.5 * self.scale)
        unit[self.angle] = 1.0
        self.unit = torch.cat([unit, torch.tensor([self.s.stride if self.s.adaptive_steps else self.dt])])
        own = {name: array[slot] for name, array in learner.state()[0].items()}
        self.f = network(list(learner.f.sizes), nn.ReLU, own["f"])
        self.J = network(list(learner.J.sizes), nn.SiLU, own["J"])
        self.slow = network(list(learner.J.sizes), nn.SiLU, own["target"]) if self.s.target_network else self.J
        # torch's Adam leaves a parameter without a gradient as it is: of lazy heads each has parameters of its own
        self.heads = self._heads() if self.s.lazy_heads else []
        trained = [*self.f[:-1].parameters(), *(p for head in self.heads for p in head.parameters())]
        self.adam_f = torch.optim.Adam(trained if self.heads else self.f.parameters(), lr=1e-3)
        self.adam_j = torch.optim.Adam(self.J.parameters(), lr=1e-3)

    def _heads(self) -> list[nn.Linear]:
        """Return the last layer of f as a layer for every movement, whose parameters are parts of the layer's."""
        whole, found = self.f[-1], []
        for start in range(0, whole.out_features, self.parts + 1):
            head = nn.Linear(whole.in_features, self.parts + 1)
            head.weight.data = whole.weight.data[start : start + self.parts + 1]
            head.bias.data = whole.bias.data[start : start + self.parts + 1]
            found.append(head)
        return found

    def executed(self, zeta: Tensor, movement: Tensor) -> Tensor:
        """Return f of the movements (b,) executed at zeta (b, D), in its units; anything where there is none."""
        if not self.heads:
            out = self.f(self.features(zeta)).view(len(zeta), self.count, self.parts + 1)
            return out[torch.arange(len(zeta)), movement.clamp(min=0)]
        hidden = self.f[:-1](self.features(zeta))
        nothing = hidden[:, :1].expand(-1, self.parts + 1)
        each = zip(movement, hidden, nothing, strict=True)
        return torch.stack([self.heads[m](h) if m >= 0 else n for m, h, n in each])

    def own(self, array: Any) -> np.ndarray:
        """Return of an array that the learner's device holds what is of this agent, as it is now."""
        return self.learner.device.off(array[self.slot])

    def drive(self, zeta: Tensor) -> Tensor:
        """Return d at zeta (..., D)."""
        own = ((zeta @ self.mix).square().sum(-1) + self.eps) ** (self.exponent / 2)
        return own + zeta @ self.felt

    def features(self, zeta: Tensor) -> Tensor:
        """Return network inputs for zeta (b, D)."""
        angle = zeta[:, self.angle]
        parts = [(zeta - self.centre)[:, self.plain] / self.scale[self.plain], angle.cos(), angle.sin()]
        if self.learner.cells:
            centres = torch.from_numpy(self.own(self.learner.cell_centre).T)
            gap = (zeta[:, None, self.place] - centres).square().sum(-1)
            on = torch.arange(self.learner.cells) < int(self.own(self.learner.cell_count))
            parts.append(torch.where(on, (-0.5 * gap / self.s.place_width**2).clamp(min=-30).exp(), 0.0))
        return torch.cat(parts, 1)

    def deviation(self, zeta: Tensor, network_: nn.Module) -> Tensor:
        """Return Jn at zeta (b, D), drive units."""
        out = network_(self.features(zeta))[:, 0]
        base = self.drive(zeta) if self.s.learn_value else self.worst * hjb.J_CENTRE
        return base + self.worst * hjb.J_SPREAD * out

    def slope(self, zeta: Tensor, network_: nn.Module) -> Tensor:
        """Return dJn/dzeta, differentiable in the weights."""
        at = zeta.detach().requires_grad_()
        return torch.autograd.grad(self.deviation(at, network_).sum(), at, create_graph=True)[0]

    def changes(self, zeta: Tensor) -> tuple[Tensor, Tensor]:
        """Return f of all movements: changes (b, M, D), durations (b, M)."""
        out = self.f(self.features(zeta)).view(len(zeta), self.count, self.parts + 1) * self.unit
        return out[..., :-1], out[..., -1].clamp(self.dt, 300.0)

    def scores(self, zeta: Tensor, network_: nn.Module, *, hopes: bool = True) -> Tensor:
        """Return the HJB score of all movements, (b, M), with optimism about the unknown or without."""
        with torch.no_grad():
            change, duration = self.changes(zeta)
        if self.s.finite_difference:
            with torch.no_grad():
                after = torch.minimum(torch.maximum(zeta[:, None] + change, self.low), self.high)
                keep = self.s.gamma**duration
                ahead = self.deviation(after.flatten(0, 1), network_).view(keep.shape)
                if hopes:
                    ahead = self.hoped(after, ahead)
                return (1 - keep) * 0.5 * (self.drive(zeta)[:, None] + self.drive(after)) + keep * ahead
        rate = change / duration[..., None]
        climb = (self.slope(zeta, network_)[:, None] * rate).sum(-1)
        return self.drive(zeta[:, None] + rate * self.dt) - climb / math.log(self.s.gamma)

    def hoped(self, zeta: Tensor, value: Tensor) -> Tensor:
        """Return Jn (...) at zeta (..., D) as an optimist takes it: lower beyond the reach of all marks."""
        share, more = self.own(self.learner.hope)
        marks, marked = (self.own(array) for array in self.learner.curiosity.places)
        if not 0 < marked < marks.shape[1]:
            return value
        x, y, reach = torch.from_numpy(marks[:, :marked])
        here = zeta[..., self.place]
        known = ((here[..., :1] - x).square() + (here[..., 1:] - y).square() <= reach).any(-1)
        return torch.where(known, value, (1 - share) * value - more)

    def apart(self, here: Tensor, there: Tensor) -> float:
        """Return the squared distance of two states, in standard deviations of the kernel, needs left out."""
        total = 0.0
        for v, kind in enumerate(self.learner.group.layout.kinds):
            gap = float(here[v] - there[v])
            if kind == "angle":
                total += (math.remainder(gap, 2 * math.pi) / self.s.near_angle) ** 2
            elif kind == "position":
                total += (gap / self.s.near) ** 2
            elif kind not in ("deviation", "felt"):
                total += (2 * gap / float(self.scale[v])) ** 2
        return total

    def recalled(self, zeta: Tensor, movement: int) -> Tensor:
        """Return the error of f (D + 1,) that is to be expected of a movement at zeta (D,), from those remembered."""
        trace, slot = self.learner.trace, self.slot
        total, weight = torch.zeros(self.parts + 1), float(kernels.PRIOR)
        for k in range(min(int(trace.count[slot]), trace.movement.shape[1])):
            there = torch.zeros(self.parts)
            there[self.learner.senses.where] = torch.from_numpy(trace.where[slot, k])
            age = float(self.learner._now()[slot] - trace.time[slot, k])
            exponent = -0.5 * self.apart(zeta, there) - age / float(kernels.FADING)
            if trace.movement[slot, k] == movement and exponent > -8:
                weight += math.exp(exponent)
                total += math.exp(exponent) * torch.from_numpy(trace.error[slot, k])
        return total / weight

    def open_near(self, zeta: Tensor) -> np.ndarray:
        """Return what was open (M,) at the remembered decision nearest to zeta (D,)."""
        ring, count = self.learner.ring, int(self.learner.memory.count[self.slot])
        states, open_ = self.own(ring.zeta), self.own(ring.open)
        newest = [(count - 1 - back) % len(states) for back in range(min(count, len(states), self.s.searched))]
        gaps = [self.apart(zeta, torch.from_numpy(states[at])) + back * 1e-4 for back, at in enumerate(newest)]
        return open_[newest[int(np.argmin(gaps))]]

    def look_ahead(self, zeta: Tensor, open_: np.ndarray) -> np.ndarray:
        """Return the score (M,) of the open movements at zeta (D,): the least over what the beam finds to follow."""
        nodes = [(zeta, 0.0, 1.0, -1, open_)]  # state, discounted drive so far, discount, first movement, what is open
        for level in range(self.s.depth):
            found = []
            for state, cost, keep, root, possible in nodes:
                out = self.f(self.features(state[None])).view(self.count, self.parts + 1) * self.unit
                for m in np.flatnonzero(possible):
                    told = out[m] + self.recalled(state, int(m))
                    after = torch.minimum(torch.maximum(state + told[:-1], self.low), self.high)
                    fade = self.s.gamma ** float(told[-1].clamp(self.dt, 300.0))
                    spent = cost + keep * (1 - fade) * 0.5 * float(self.drive(state) + self.drive(after))
                    value = self.hoped(after[None], self.deviation(after[None], self.slow))
                    score = spent + keep * fade * float(value)
                    found.append((score, len(found), after, spent, keep * fade, int(m) if level == 0 else root))
            best = {root: min(each for each in found if each[-1] == root) for root in {each[-1] for each in found}}
            if level == self.s.depth - 1:
                return np.array([best[m][0] if m in best else math.inf for m in range(self.count)])
            rest = sorted(each for each in found if each not in best.values())
            kept = [*best.values(), *rest][: max(self.s.beam, self.count)]
            nodes = [(after, spent, keep, root, self.open_near(after)) for _, _, after, spent, keep, root in kept]
        raise AssertionError

    def best(self, zeta: np.ndarray, open_: np.ndarray) -> int:
        """Return the open movement of least score at one zeta (D,)."""
        score = self.scores(torch.from_numpy(zeta)[None], self.slow).detach().numpy()[0]
        return int(np.where(open_, score, np.inf).argmin())

    def positions(self, uniform: np.ndarray) -> np.ndarray:
        """Return positions in the ring for uniform numbers (b,)."""
        count, capacity = int(self.learner.memory.count[self.slot]), self.learner.memory.capacity
        late = round(len(uniform) * self.s.recent_share)
        found = []
        for r, u in enumerate(uniform):
            window = min(count, capacity)
            if r >= len(uniform) - late:
                window = min(window, self.s.recent)
            found.append((count - 1 - min(int(u * np.float32(window)), window - 1)) % capacity)
        return np.array(found)

    def imagine(self, zeta: Tensor, uniform: np.ndarray, normal: np.ndarray, m: int) -> Tensor:
        """Return zeta with the needs of the first m states redrawn."""
        zeta = zeta.clone()
        fresh = uniform[: m * self.parts].reshape(m, self.parts)
        calm, which = uniform[m * self.parts :][:m], uniform[m * self.parts + m :]
        can = np.flatnonzero(self.can)
        for r in range(m):
            one = can[min(int(which[r] * np.float32(len(can))), len(can) - 1)] if r < m // 2 else -1
            for v in np.flatnonzero(self.need):
                bottom = max(-self.scale[v], self.low[v])
                drawn = bottom + float(fresh[r, v]) * (0.4 * self.scale[v] - bottom)
                if v not in can:
                    drawn = zeta[r, v] * float(calm[r])
                elif r < m // 2 and v != one:
                    drawn = 0.1 * self.scale[v] * float(normal[r, v])
                zeta[r, v] = min(max(drawn, self.low[v]), self.high[v])
        return zeta

    def expected_score(self, score: Tensor) -> Tensor:
        """Return the mean score (b,) of one that takes the least of scores (b, M), and sometimes any that is finite."""
        share = torch.where(torch.isfinite(score), 1 / torch.from_numpy(self.learner.moves.length).float(), 0.0)
        mean = (share * score.nan_to_num(posinf=0.0)).sum(1) / share.sum(1)
        explores = self.s.epsilon_final if self.s.target_explores else 0.0
        return (1 - explores) * score.amin(1) + explores * mean

    def update(self, uniform: np.ndarray, normal: np.ndarray, rate: float) -> tuple[float, float]:
        """Take one step on L_f and L_J with the random numbers of this agent; return both losses."""
        s, ring = self.s, self.learner.ring
        memory = {name: self.own(getattr(ring, name)) for name in ("zeta", "after", "duration", "movement", "open")}
        b, bf = (s.batch, s.batch_f) if s.replay else (1, 1)
        for group in (*self.adam_f.param_groups, *self.adam_j.param_groups):
            group["lr"] = rate
        at = self.positions(uniform[b : b + bf])
        zeta, after = torch.from_numpy(memory["zeta"][at]), torch.from_numpy(memory["after"][at])
        movement = torch.from_numpy(memory["movement"][at].astype(np.int64))
        picked = self.executed(zeta, movement)
        change = after - zeta
        change[:, self.angle] = torch.atan2(change[:, self.angle].sin(), change[:, self.angle].cos())
        duration = torch.from_numpy(memory["duration"][at]).clamp(max=300.0)
        goal = torch.cat([change, duration[:, None]], 1) / self.unit
        known = (movement >= 0).float()
        loss_f = ((picked - goal).square().mean(1) * known).sum() / known.sum().clamp(min=1)
        self.adam_f.zero_grad()
        loss_f.backward()
        self.adam_f.step()

        at = self.positions(uniform[:b])
        zeta, after = torch.from_numpy(memory["zeta"][at]), torch.from_numpy(memory["after"][at])
        movement, open_ = torch.from_numpy(memory["movement"][at].astype(np.int64)), memory["open"][at]
        executed, known = movement.clamp(min=0), (movement >= 0).float()
        m = round(s.imagined * b)
        zeta = self.imagine(zeta, uniform[b + bf :], normal, m)
        if s.minimum_in_loss:
            known = torch.ones_like(known)
            score = self.scores(zeta, self.slow, hopes=False).detach()
            goal = self.expected_score(score.masked_fill(~torch.from_numpy(open_), math.inf))
        elif s.finite_difference:
            goal = self.scores(zeta, self.slow, hopes=False).detach()[torch.arange(b), executed]
        else:
            change, duration = self.changes(zeta)
            pace = (change / duration[..., None]).detach()[torch.arange(b), executed]
            goal = self.drive(after) - (self.slope(zeta, self.J) * pace).sum(1) / math.log(s.gamma)
        if s.minimum_in_loss or s.finite_difference:
            goal = goal.clamp(0, hjb.J_CEILING * self.worst)
        residual = self.deviation(zeta, self.J) - goal
        if s.relative_weight:
            floor = hjb.WEIGHT_FLOOR * self.worst
            residual = residual * hjb.WEIGHT_TOP * self.worst / (floor + self.drive(zeta))
        loss_j = (residual.square() * known).sum() / known.sum().clamp(min=1)
        self.adam_j.zero_grad()
        loss_j.backward()
        self.adam_j.step()
        if s.target_network:
            with torch.no_grad():
                for slow, fast in zip(self.slow.parameters(), self.J.parameters(), strict=True):
                    slow.lerp_(fast, s.polyak)
        return loss_f.item(), loss_j.item()
