"""The f/J learner on a device of torch: all agents in one batch of stacked weights, gradients by autograd.

The same mathematics as `agents.kernels`, whose words it uses. What is large stays on the device; observations and
masks go in, scores and losses come out, each in one transfer for all agents.

Shapes: a agents, R states of each, D components of zeta, M movements, H hidden units, C place cells.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ecology.agents.device import Device
from ecology.agents.kernels import FADING as FADES
from ecology.agents.kernels import LONGEST as LIMIT
from ecology.agents.kernels import PRIOR as NO_ERROR
from ecology.agents.kernels import STALE as STALENESS
from ecology.agents.kernels import Ahead, Brains, Draws, Ring, Senses, Trace

ROOM = 2**31  # bytes to work in; agents are taken in parts that fit
LONGEST = float(LIMIT)  # units of time, of a predicted duration
PRIOR, FADING, STALE, TURN = float(NO_ERROR), float(FADES), float(STALENESS), 2 * math.pi
BETA1, BETA2, TINY = 0.9, 0.999, 1e-8  # of Adam


def there() -> list[str]:
    """Return the names of the devices of this machine, the CPU first."""
    cuda = ["cuda", *(f"cuda:{i}" for i in range(torch.cuda.device_count()))] if torch.cuda.is_available() else []
    return ["cpu", *cuda, *(["mps"] if torch.backends.mps.is_available() else [])]


class Torch(Device):
    """Tensors on the device `name`. Random numbers are the device's own, from a seed that the learner draws."""

    def __init__(self, name: str, senses: Senses) -> None:
        self.name = torch.device(name)
        self.generator = torch.Generator(self.name)
        self.senses: Any = Senses(*(self._known(value) for value in senses))
        size = len(senses.low)
        self.can = torch.zeros(size, dtype=torch.bool, device=self.name)
        self.can[self.senses.deprivable] = True
        self.mix = torch.zeros(size, size, device=self.name)
        self.mix[self.senses.mix_from, self.senses.mix_to] = self.senses.mix_weight

    def _known(self, value: Any) -> Any:
        """Return one of `Senses` as torch takes it."""
        if isinstance(value, np.ndarray):
            return self.on(value)
        return value.item() if isinstance(value, np.generic) else value

    def on(self, array: np.ndarray) -> Tensor:  # noqa: D102
        kind = torch.float32 if array.dtype == np.float64 else None  # mps has no float64
        return torch.tensor(array, dtype=kind, device=self.name)

    def off(self, array: Tensor) -> np.ndarray:  # noqa: D102
        return array.cpu().numpy()

    def zeros(self, shape: tuple[int, ...], kind: type) -> Tensor:  # noqa: D102
        return torch.zeros(shape, dtype=torch.from_numpy(np.empty(0, kind)).dtype, device=self.name)

    def uniform(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Tensor:  # noqa: D102
        self.generator.manual_seed(int(generator.integers(2**62)))
        return torch.rand(shape, generator=self.generator, device=self.name)

    def normal(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Tensor:  # noqa: D102
        self.generator.manual_seed(int(generator.integers(2**62)))
        return torch.randn(shape, generator=self.generator, device=self.name)

    # ---- what all agents share ----------------------------------------------------------------

    def _drive(self, zeta: Tensor) -> Tensor:
        """Return d at zeta (..., D)."""
        s = self.senses
        own = zeta @ self.mix
        if s.bent:  # at 0 the slope of |y|^(n / 2) is 0 or not finite; the floor keeps it finite
            own = (own * torch.where(own > 0, s.above, 1.0)).abs().clamp(min=1e-12) ** (s.power / 2)
        total = own.square().sum(-1) + s.epsilon
        return (total.sqrt() if s.root == 0.5 else total**s.root) + zeta @ s.felt

    def _features(self, zeta: Tensor, centres: Tensor, cells: Tensor) -> Tensor:
        """Return the network inputs (a, R, I) of zeta (a, R, D): plain, cosine and sine, place cells."""
        s = self.senses
        angle = zeta[..., s.angle]
        parts = [((zeta - s.centre) * s.inverse)[..., s.plain], angle.cos(), angle.sin()]
        count = centres.shape[-1]
        if count:
            gap = zeta[..., s.place, None] - centres[:, None]  # (a, R, 2, C)
            bump = torch.exp((-0.5 * s.sharp * gap.square().sum(2)).clamp(min=-30.0))
            known = torch.arange(count, device=self.name) < cells[:, None]
            parts.append(torch.where(known[:, None], bump, 0.0))
        return torch.cat(parts, -1)

    def _layers(self, rows: Tensor, inputs: int) -> list[Tensor]:
        """Return w1, b1, w2, b2, w3, b3 as views of weights (a, P)."""
        a, width = len(rows), self.senses.width
        outputs = (rows.shape[1] - (inputs + width + 2) * width) // (width + 1)
        sizes = [inputs * width, width, width * width, width, outputs * width, outputs]
        shapes = [(a, inputs, width), (a, 1, width), (a, width, width), (a, 1, width), (a, outputs, width), (a, 1, -1)]
        return [part.view(shape) for part, shape in zip(rows.split(sizes, 1), shapes, strict=True)]

    @staticmethod
    def _outputs(x: Tensor, layers: list[Tensor], activation: Any) -> Tensor:
        """Return the outputs (a, R, O) of networks at inputs x (a, R, I)."""
        w1, b1, w2, b2, w3, b3 = layers
        hidden = activation(torch.baddbmm(b1, x, w1))
        hidden = activation(torch.baddbmm(b2, hidden, w2))
        return torch.baddbmm(b3, hidden, w3.transpose(1, 2))

    def _f(self, zeta: Tensor, layers: list[Tensor], centres: Tensor, cells: Tensor) -> Tensor:
        """Return f of all movements (a, R, M, D + 1), in its units."""
        raw = self._outputs(self._features(zeta, centres, cells), layers, functional.relu)
        return raw.unflatten(2, (self.senses.movements, -1))

    def _J(self, zeta: Tensor, layers: list[Tensor], centres: Tensor, cells: Tensor) -> Tensor:  # noqa: N802
        """Return Jn (a, R), in drive units."""
        s, raw = self.senses, self._outputs(self._features(zeta, centres, cells), layers, functional.silu)
        return (self._drive(zeta) if s.anchored else s.centre_j) + s.spread_j * raw[..., 0]

    def _slope(self, zeta: Tensor, layers: list[Tensor], centres: Tensor, cells: Tensor, *, graph: bool) -> Tensor:
        """Return dJn/dzeta (a, R, D), with `graph` differentiable in the weights."""
        with torch.enable_grad():
            at = zeta.detach().requires_grad_()
            return torch.autograd.grad(self._J(at, layers, centres, cells).sum(), at, create_graph=graph)[0]

    def _changes(self, zeta: Tensor, layers: list[Tensor], centres: Tensor, cells: Tensor) -> tuple[Tensor, Tensor]:
        """Return what f predicts: changes (a, R, M, D), durations (a, R, M)."""
        found = self._f(zeta, layers, centres, cells) * self.senses.unit
        return found[..., :-1], found[..., -1].clamp(self.senses.dt, LONGEST)

    def _table(
        self, zeta: Tensor, open_: Tensor, f: list[Tensor], j: list[Tensor], known: tuple[Tensor, ...], *where: Tensor
    ) -> Tensor:
        """Return the HJB score (a, R, M) of the open movements at zeta (a, R, D), infinity elsewhere."""
        s = self.senses
        change, tau = self._changes(zeta, f, *where)
        if s.finite:
            ahead = (zeta[:, :, None] + change).clamp(s.low, s.high)
            keep = torch.exp(tau * s.log_gamma)
            ends = 0.5 * (self._drive(zeta)[..., None] + self._drive(ahead))
            value = self._J(ahead.flatten(1, 2), j, *where)
            if known:
                hoped = self._hoped(value, known[0])
                value = torch.where(self._unknown(ahead.flatten(1, 2), *known[1:]), hoped, value)
            score = (1 - keep) * ends + keep * value.view_as(keep)
        else:
            rate = change / tau[..., None]
            climb = (self._slope(zeta, j, *where, graph=False)[:, :, None] * rate).sum(-1)
            score = self._drive(zeta[:, :, None] + rate * s.dt) - climb / s.log_gamma
        return score.masked_fill(~open_, math.inf)

    @staticmethod
    def _hoped(value: Tensor, hope: Tensor) -> Tensor:
        """Return Jn (a, R) as it is taken to be where it is unknown."""
        return value - hope[:, :1] * value - hope[:, 1:]

    def _unknown(self, zeta: Tensor, marks: Tensor, marked: Tensor) -> Tensor:
        """Return which of zeta (a, R, D) lie beyond the reach of all marks; none where no mark is left to be set."""
        count = marks.shape[-1]
        if not count:
            return torch.zeros(zeta.shape[:2], dtype=torch.bool, device=self.name)
        gap = zeta[..., self.senses.place, None] - marks[:, None, :2]  # (a, R, 2, K)
        given = torch.arange(count, device=self.name) < marked[:, None]
        known = ((gap.square().sum(2) <= marks[:, None, 2]) & given[:, None]).any(-1)
        return ~known & ((marked > 0) & (marked < count))[:, None]

    # ---- acting -------------------------------------------------------------------------------

    @torch.no_grad()
    def scores(  # noqa: D102
        self,
        brains: Brains,
        ring: Ring,
        trace: Trace,
        ages: np.ndarray,
        slots: np.ndarray,
        zeta: np.ndarray,
        open_: np.ndarray,
    ) -> np.ndarray:
        if self.senses.depth == 1 and not trace.where.shape[1]:
            return self._near_scores(brains, slots, zeta, open_)
        at, states, options, now = self.on(slots), self.on(zeta)[:, None], self.on(open_)[:, None], self.on(ages)
        lived = self.on(ring.lived)
        found = []
        for part in self._parts(len(slots), brains, self._beam()):
            rows = at[part]
            own = Brains(*(array[rows] for array in brains))
            memory = Ring(*(array[rows] for array in ring._replace(lived=lived)))
            noted = Trace(*(self.on(array[slots[part]]) for array in trace))
            found.append(self._look_ahead(states[part], options[part], own, memory, noted, now[part]))
        return self.off(torch.cat(found))

    def _near_scores(self, brains: Brains, slots: np.ndarray, zeta: np.ndarray, open_: np.ndarray) -> np.ndarray:
        """Return the score (k, M) of one movement, nothing corrected."""
        at, states, options = self.on(slots), self.on(zeta)[:, None], self.on(open_)[:, None]
        found = []
        for part in self._parts(len(slots), brains, 1):
            own = Brains(*(array[at[part]] for array in brains))
            f, j = (self._layers(rows, self._inputs(brains)) for rows in (own.f, own.target))
            known = (own.hope, own.marks, own.marked)
            found.append(self._table(states[part], options[part], f, j, known, own.cell_centre, own.cell_count)[:, 0])
        return self.off(torch.cat(found))

    def _beam(self) -> int:
        return max(self.senses.beam, self.senses.movements)

    def _look_ahead(
        self,
        state: Tensor,
        open_: Tensor,
        own: Brains,
        ring: Ring,
        trace: Trace,
        now: Tensor,
    ) -> Tensor:
        """Return the score (a, M) of the open movements at one state (a, 1, D), as `kernels.look_ahead` does."""
        s, where = self.senses, (own.cell_centre, own.cell_count)
        f, j = (self._layers(rows, self._inputs(own)) for rows in (own.f, own.target))
        a, count = len(state), s.movements
        cost = torch.zeros(a, 1, device=self.name)
        keep = torch.ones_like(cost)
        root = None
        out = torch.full((a, count), math.inf, device=self.name)
        for level in range(s.depth):
            raw = self._f(state, f, *where) * s.unit + self._recalled(state, trace, now)
            tau = raw[..., -1].clamp(s.dt, LONGEST)  # (a, R, M)
            ahead = (state[:, :, None] + raw[..., :-1]).clamp(s.low, s.high)
            faded = torch.exp(tau * s.log_gamma)
            ends = 0.5 * (self._drive(state)[..., None] + self._drive(ahead))
            cost = (cost[..., None] + keep[..., None] * (1 - faded) * ends).flatten(1)
            keep = (keep[..., None] * faded).flatten(1)
            first = torch.arange(count, device=self.name).expand(a, state.shape[1], count)
            root = (first if root is None else root[..., None].expand_as(first)).flatten(1)
            state, possible = ahead.flatten(1, 2), open_.flatten(1)
            value = self._J(state, j, *where)
            value = torch.where(self._unknown(state, own.marks, own.marked), self._hoped(value, own.hope), value)
            score = (cost + keep * value).masked_fill(~possible, math.inf)  # (a, R M)
            of_root = torch.full((a, score.shape[1], count), math.inf, device=self.name)
            of_root.scatter_(2, root[..., None], score[..., None])
            out, best = of_root.min(1)
            if level == s.depth - 1:
                break
            # the best successor of every first movement, then the best of the others
            kept = score.scatter(1, best, score.gather(1, best).where(out == math.inf, -math.inf))
            size = min(self._beam(), kept.shape[1])
            rank, chosen = kept.topk(size, largest=False)
            state = state.gather(1, chosen[..., None].expand(-1, -1, state.shape[2]))
            cost, keep, root = cost.gather(1, chosen), keep.gather(1, chosen), root.gather(1, chosen)
            open_ = self._nearest_open(state, ring) & (rank < math.inf)[..., None]
        return out

    def _apart(self, zeta: Tensor, places: Tensor) -> Tensor:
        """Return squared distances (a, R, K) of zeta (a, R, D) from places (a, K, W), in standard deviations."""
        s = self.senses
        gap = zeta[..., s.where][:, :, None] - places[:, None]
        gap = torch.where(s.turning, gap - TURN * torch.floor(gap / TURN + 0.5), gap)
        return (gap * s.nearness).square().sum(-1)

    def _recalled(self, zeta: Tensor, trace: Trace, now: Tensor) -> Tensor:
        """Return the error of f to be expected (a, R, M, D + 1) at zeta (a, R, D), see `kernels.recall`."""
        s = self.senses
        size = trace.where.shape[1]
        exponent = -0.5 * self._apart(zeta, trace.where) - ((now[:, None] - trace.time) / FADING)[:, None]
        there = torch.arange(size, device=self.name) < trace.count[:, None]
        weight = torch.where((exponent > -8.0) & there[:, None], exponent.exp(), 0.0)  # (a, R, L)
        did = functional.one_hot(trace.movement.long(), s.movements).float()  # (a, L, M)
        total = torch.einsum("arl,alm,ald->armd", weight, did, trace.error)
        return total / (PRIOR + weight @ did)[..., None]

    def _nearest_open(self, zeta: Tensor, ring: Ring) -> Tensor:
        """Return what was open (a, R, M) at the decision remembered that is nearest to zeta (a, R, D)."""
        capacity = ring.zeta.shape[1]
        back = torch.arange(min(self.senses.searched, capacity), device=self.name)
        at = (ring.lived[:, None] - 1 - back) % capacity  # (a, K)
        places = self._picked(ring.zeta, at)[..., self.senses.where]
        gap = self._apart(zeta, places) + back * STALE
        gap = gap.masked_fill((back >= ring.lived[:, None])[:, None], math.inf)
        return self._picked(ring.open, at.gather(1, gap.argmin(-1)))

    @torch.no_grad()
    def expected(self, brains: Brains, slots: np.ndarray, zeta: np.ndarray, movement: np.ndarray) -> np.ndarray:  # noqa: D102
        at = self.on(slots)
        layers = self._layers(brains.f[at], self._inputs(brains))
        raw = self._f(self.on(zeta)[:, None], layers, brains.cell_centre[at], brains.cell_count[at]) * self.senses.unit
        raw = self._executed(raw, self.on(movement)[:, None])[:, 0]
        raw[:, -1].clamp_(self.senses.dt, LONGEST)
        return self.off(raw)

    def _inputs(self, brains: Brains) -> int:
        return len(self.senses.plain) + 2 * len(self.senses.angle) + brains.cell_centre.shape[2]

    def _parts(self, count: int, brains: Brains, states: int) -> list[slice]:
        """Return slices of `count` agents, each of a size whose work on `states` states fits into the room."""
        s = self.senses
        cells = brains.cell_centre.shape[2]
        ahead = states * s.movements * (2 * self._inputs(brains) + 2 * cells + 4 * s.width + 6 * len(s.low))
        size = max(1, ROOM // (4 * (ahead + 3 * brains.f.shape[1] + 3 * brains.J.shape[1])))
        return [slice(start, min(start + size, count)) for start in range(0, count, size)]

    # ---- learning -----------------------------------------------------------------------------

    @torch.no_grad()
    def update(  # noqa: D102
        self,
        brains: Brains,
        ring: Ring,
        draws: Draws,
        ready: np.ndarray,
        rate: np.ndarray,
        loss_f: np.ndarray,
        loss_j: np.ndarray,
        ahead: Ahead,
    ) -> None:
        learns, pace, lived = self.on(ready), self.on(rate), self.on(ring.lived)
        found = [
            self._step(
                Brains(*(array[part] for array in brains)),
                Ring(*(array[part] for array in ring._replace(lived=lived))),
                draws._replace(uniform=draws.uniform[part], normal=draws.normal[part]),
                learns[part, None],
                pace[part, None],
            )
            for part in self._parts(len(ready), brains, max(draws.batch, draws.batch_f))
        ]
        losses = self.off(torch.cat(found, 1))
        loss_f[ready], loss_j[ready] = losses[0, ready], losses[1, ready]
        asked = np.flatnonzero(ahead.open.any(1))
        if asked.size:
            ahead.score[asked] = self._near_scores(brains, asked, ahead.zeta[asked], ahead.open[asked])

    def _step(self, own: Brains, ring: Ring, draws: Draws, learns: Tensor, rate: Tensor) -> Tensor:
        """Take one step on L_f and L_J for a agents, all views of what the device holds; return both losses (2, a)."""
        s, b, bf = self.senses, draws.batch, draws.batch_f
        inputs, where = self._inputs(own), (own.cell_centre, own.cell_count)
        f, target = self._layers(own.f, inputs), self._layers(own.target, inputs)

        # f
        at = self._positions(ring, draws.uniform[:, b : b + bf], draws.late_f, draws.recent)
        zeta, after, movement = (self._picked(array, at) for array in (ring.zeta, ring.after, ring.movement))
        goal = torch.cat([self._change(zeta, after), self._picked(ring.duration, at)[..., None].clamp(max=LONGEST)], -1)
        leaves = [layer.detach().requires_grad_() for layer in f]
        with torch.enable_grad():
            found = self._executed(self._f(zeta, leaves, *where), movement)
            loss_f = _mean((found - goal / s.unit).square().mean(-1), movement >= 0)
            loss_f.sum().backward()
        trained = torch.ones_like(own.f_steps[:, 1:], dtype=torch.bool)
        if s.lazy:
            ran = functional.one_hot(movement.clamp(min=0).long(), s.movements).bool()
            trained = (ran & (movement >= 0)[..., None]).any(1)
        self._adam(own.f, leaves, own.f_first, own.f_second, own.f_steps, rate, learns, trained)

        # the right-hand side of the equation
        at = self._positions(ring, draws.uniform[:, :b], draws.late, draws.recent)
        zeta, after, movement = (self._picked(array, at) for array in (ring.zeta, ring.after, ring.movement))
        zeta = self._imagined(zeta, draws.uniform[:, b + bf :], draws.normal, draws.imagined)
        known = torch.ones_like(movement, dtype=torch.bool) if s.minimum else movement >= 0
        printed = not (s.minimum or s.finite)
        if printed:
            change, tau = self._changes(zeta, f, *where)
            pace = self._executed(change / tau[..., None], movement)
            goal = self._drive(after)
        else:
            did = functional.one_hot(movement.clamp(min=0).long(), s.movements).bool()
            open_ = self._picked(ring.open, at) if s.minimum else did
            goal = self._expected_score(self._table(zeta, open_, f, target, (), *where)).clamp(0.0, s.ceiling)

        # J
        leaves = [layer.detach().requires_grad_() for layer in self._layers(own.J, inputs)]
        with torch.enable_grad():
            residual = self._J(zeta, leaves, *where) - goal
            if printed:
                residual = residual + (self._slope(zeta, leaves, *where, graph=True) * pace).sum(-1) / s.log_gamma
            if s.weight_top > 0:
                residual = residual * s.weight_top / (s.weight_floor + self._drive(zeta))
            loss_j = _mean(residual.square(), known)
            loss_j.sum().backward()
        self._adam(own.J, leaves, own.J_first, own.J_second, own.J_steps, rate, learns, torch.ones_like(learns))
        if s.slow:
            own.target.lerp_(own.J, s.polyak * learns.float())
        return torch.stack([loss_f.detach(), loss_j.detach()])

    def _expected_score(self, score: Tensor) -> Tensor:
        """Return the mean score (a, R) of one that explores as `kernels.expected_score` has it, of scores (a, R, M)."""
        s, least = self.senses, score.amin(-1)
        share = torch.where(score < math.inf, 1 / s.length, 0.0)
        mean = (share * score.nan_to_num(posinf=0.0)).sum(-1) / share.sum(-1).clamp(min=1e-30)
        return torch.where(share.sum(-1) > 0, least + s.explored * (mean - least), least)

    def _positions(self, ring: Ring, uniform: Tensor, late: int, recent: int) -> Tensor:
        """Return positions in the ring (a, b); the last `late` of them are among the `recent` decisions."""
        capacity, count = ring.zeta.shape[1], ring.lived[:, None]
        window = count.clamp(max=capacity).repeat(1, uniform.shape[1])
        window[:, uniform.shape[1] - late :].clamp_(max=recent)
        back = torch.minimum((uniform * window).long(), window - 1).clamp(min=0)
        return (count - 1 - back) % capacity

    @staticmethod
    def _picked(array: Tensor, at: Tensor) -> Tensor:
        """Return the rows (a, b, ...) at positions (a, b) of an array (a, capacity, ...)."""
        return array[torch.arange(len(at), device=at.device)[:, None], at]

    def _executed(self, table: Tensor, movement: Tensor) -> Tensor:
        """Return of a table (a, R, M, k) the rows (a, R, k) of the movements executed (a, R)."""
        which = movement.clamp(min=0).long()[..., None, None].expand(-1, -1, 1, table.shape[-1])
        return table.gather(2, which)[:, :, 0]

    def _change(self, zeta: Tensor, after: Tensor) -> Tensor:
        """Return the change (..., D) from zeta to after, that of an angle between -pi and pi."""
        change = after - zeta
        turned = change[..., self.senses.angle]
        change[..., self.senses.angle] = torch.atan2(turned.sin(), turned.cos())
        return change

    def _imagined(self, zeta: Tensor, uniform: Tensor, normal: Tensor, m: int) -> Tensor:
        """Return zeta with the needs of the first m states redrawn, as `kernels.imagine` does."""
        if not m:
            return zeta
        s, parts, half = self.senses, zeta.shape[-1], m // 2
        fresh = uniform[:, : m * parts].unflatten(1, (m, parts))
        calm = uniform[:, m * parts : m * parts + m, None]
        bottom = (s.deprived * s.scale).maximum(s.low)
        drawn = bottom + fresh * (s.sated * s.scale - bottom)
        if half and len(s.deprivable):
            which = (uniform[:, m * parts + m : m * parts + m + half] * len(s.deprivable)).long()
            one = s.deprivable[which.clamp(max=len(s.deprivable) - 1)]  # (a, half)
            alone = torch.arange(parts, device=self.name) == one[..., None]
            drawn[:, :half] = torch.where(alone, drawn[:, :half], 0.1 * s.scale * normal)
        drawn = torch.where(self.can, drawn, zeta[:, :m] * calm).clamp(s.low, s.high)
        return torch.cat([torch.where(s.need, drawn, zeta[:, :m]), zeta[:, m:]], 1)

    @staticmethod
    def _adam(
        w: Tensor,
        leaves: list[Tensor],
        first: Tensor,
        second: Tensor,
        steps: Tensor,
        rate: Tensor,
        learns: Tensor,
        trained: Tensor,
    ) -> None:
        """Move the weights (a, P) of those that learn (a, 1) by one step of Adam, in place.

        Of the last layer only the heads that were `trained` (a, M) move; `steps` (a, 1 + M) are brought up to date.
        """
        gradient = torch.cat([leaf.grad.flatten(1) for leaf in leaves if leaf.grad is not None], 1)
        moves = torch.cat([learns, learns & trained], 1)
        steps += moves
        taken = steps.clamp(min=1).float()
        correction = (-torch.expm1(taken * math.log(BETA2))).sqrt()
        size = rate * moves * correction / -torch.expm1(taken * math.log(BETA1))
        w3, b3 = (leaf[0].numel() for leaf in leaves[4:])
        hidden = gradient.shape[1] - w3 - b3
        for columns, start, length in (
            (slice(0, 1), 0, hidden),
            (slice(1, None), hidden, w3),
            (slice(1, None), -b3, b3),
        ):
            on, pace, floor = (part[:, columns, None] for part in (moves.float(), size, TINY * correction))
            own, g, m, v = (  # (a, 1 or M, weights)
                array.narrow(1, start, length).unflatten(1, (on.shape[1], -1)) for array in (w, gradient, first, second)
            )
            m.lerp_(g, (1 - BETA1) * on)
            v.lerp_(g.square_(), (1 - BETA2) * on)
            own.sub_(m / (v.sqrt() + floor) * pace)

    # ---- what others may see ------------------------------------------------------------------

    def _of(self, rows: Tensor, brains: Brains, slot: int, zeta: np.ndarray) -> tuple[Any, ...]:
        """Return zeta, layers, place cells and their number of one agent, as a batch of one."""
        one = slice(slot, slot + 1)
        layers = self._layers(rows[one], self._inputs(brains))
        return self.on(zeta)[None], layers, brains.cell_centre[one], brains.cell_count[one]

    def value(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return self.off(self._J(*self._of(brains.target, brains, slot, zeta))[0])

    def slope(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return self.off(self._slope(*self._of(brains.target, brains, slot, zeta), graph=False)[0])

    def forecast(self, brains: Brains, slot: int, zeta: np.ndarray) -> np.ndarray:  # noqa: D102
        return self.off(self._f(*self._of(brains.f, brains, slot, zeta))[0].flatten(1))


def _mean(errors: Tensor, known: Tensor) -> Tensor:
    """Return the mean (a,) of the errors (a, R) that are known."""
    return (errors * known).sum(1) / known.sum(1).clamp(min=1)
