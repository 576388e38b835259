"""The body: deviation, drive, transition f, noise g and reward, pure functions of arrays.

Shapes: n agents, V needs. Equations of Laurencon et al. (2021), section "Modeling". A fatigue is a need with set point
0: its decay and the control of actions, in `velocity`, are how a body tires and recovers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ecology import elementary, heredity
from ecology.compiler_cache import compiled, use_cache
from ecology.spec import Need, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__)


class Form(NamedTuple):
    """The form of the drive beyond the paper's: (epsilon + sum_i |c_i delta_i|^n) ^ (exponent / n), c by the sign."""

    below: Floats  # (n, V) c below the set point, w^(1/n)
    above: Floats  # (n, V) c above it
    power: Floats  # (n,) n

    def rows(self, which: Any) -> Form:
        """Return the form of some of the bodies."""
        return Form(self.below[which], self.above[which], self.power[which])


class Ledger(NamedTuple):
    """What went through each need of n bodies, and how time passes for them."""

    taken: Floats  # (n, V) from outside, in this tick
    metabolised: Floats  # (n, V) since birth
    lost: Floats  # (n, V) at the bounds, since birth
    age: Floats  # (n,)
    hold: Floats  # (n,) time for which an action still immobilises


@dataclass(frozen=True)
class Body:
    """The constants of every slot's body, one row per slot; padding columns stay at zero."""

    set_point: Floats  # (n, V) x*
    start: Floats  # (n, V)
    decay: Floats  # (n, V) per unit of time
    leak: Floats  # (n, V) per unit of time
    proportional: Bools  # (n, V)
    amplitude: Floats  # (n, V) of the season
    frequency: Floats  # (n, V) of the season, radians per unit of time
    phase: Floats  # (n, V) of the season, radians
    ageing: Floats  # (n, V) per unit of age
    noise: Floats  # (n, V) per square root of a unit of time
    low: Floats  # (n, V) bounds
    high: Floats  # (n, V)
    least: Floats  # (n, V) set points that it can have
    most: Floats  # (n, V)
    lethal: Bools  # (n, V)
    regulated: Floats  # (n, V) 1 where the deviation counts in the drive
    epsilon: Floats  # (n,) of the drive
    exponent: Floats  # (n,) of the drive
    form: Form | None  # of the drive, None where it is the paper's but for the exponent
    straight: bool  # whether every exponent is 1
    varies: bool  # whether any season or ageing is at work
    leaks: bool  # whether any rate is proportional to x
    noisy: bool
    deadly: bool
    moves: bool  # whether any set point can move: they are in the state then
    flows: tuple[tuple[slice, int, int, float], ...] = ()  # rows, from need, to need, units gained per unit leaked


def compile_bodies(species: Sequence[Species], width: int) -> Body:
    """Return the constants of the slots of `species`, in their order, padded to `width` needs."""

    def rows(read: Callable[[Need], Any], padding: float = 0.0) -> np.ndarray:
        table = [[read(need) for need in s.needs] + [padding] * (width - len(s.needs)) for s in species]
        return np.repeat(np.array(table, dtype=float), [s.slots for s in species], axis=0)

    def season(name: str) -> Callable[[Need], float]:
        return lambda need: getattr(need.season, name) if need.season else 0.0

    frequency = rows(lambda need: 2 * np.pi / need.season.period if need.season else 0.0)
    proportional = rows(lambda need: need.proportional).astype(bool)
    ageing, noise = rows(lambda need: need.ageing), rows(lambda need: need.noise)
    leak, lethal = rows(lambda need: need.leak), rows(lambda need: need.lethal).astype(bool)
    return Body(
        set_point=rows(lambda need: need.set_point),
        start=rows(lambda need: need.x0),
        decay=rows(lambda need: need.decay),
        leak=leak,
        proportional=proportional,
        amplitude=rows(season("amplitude")),
        frequency=frequency,
        phase=rows(season("phase")),
        ageing=ageing,
        noise=noise,
        low=rows(lambda need: need.low),
        high=rows(lambda need: need.bounds[1]),
        least=rows(lambda need: need.set_points[0]),
        most=rows(lambda need: need.set_points[1]),
        lethal=lethal,
        regulated=rows(lambda need: need.regulated),
        epsilon=np.repeat([s.drive_epsilon for s in species], [s.slots for s in species]),
        exponent=np.repeat([s.drive_exponent for s in species], [s.slots for s in species]),
        form=_compile_form(species, width),
        straight=all(s.drive_exponent == 1.0 for s in species),
        varies=bool(frequency.any() or ageing.any()),
        leaks=bool(leak.any() or proportional.any()),
        noisy=bool(noise.any()),
        deadly=bool(lethal.any()),
        moves=any(need.set_range is not None for s in species for need in s.needs),
        flows=tuple(_flows(species)),
    )


def _flows(species: Sequence[Species]) -> Iterator[tuple[slice, int, int, float]]:
    """Yield what enters a need of what leaks out of another: the rows of the bodies, from, to, and the factor."""
    first = 0
    for s in species:
        rows, columns = slice(first, first + s.slots), {need.name: v for v, need in enumerate(s.needs)}
        first += s.slots
        for v, need in enumerate(s.needs):
            for name, factor in need.feeds.items():
                yield rows, v, columns[name], float(factor)


def _compile_form(species: Sequence[Species], width: int) -> Form | None:
    """Return the form of the drive of the slots of `species`, None where it is the paper's for all."""
    if not any(has_bent_drive(s) for s in species):
        return None
    factors = np.ones((len(species), 2, width))
    for i, s in enumerate(species):
        factors[i, :, : len(s.needs)] = drive_factors(s)
    below, above = np.repeat(factors, [s.slots for s in species], axis=0).transpose(1, 0, 2)
    return Form(below, above, np.repeat([float(s.drive_power) for s in species], [s.slots for s in species]))


def has_bent_drive(species: Species) -> bool:
    """Return whether the drive of a species has weights, an asymmetry or a power of its own."""
    return species.drive_power != 2 or any((need.weight, need.excess) != (1, 1) for need in species.needs)


def drive_factors(species: Species) -> tuple[Floats, Floats]:
    """Return c = w^(1/n) of every need below its set point and above it, both (V,)."""
    weight = np.array([need.weight for need in species.needs], float)
    excess = np.array([need.excess for need in species.needs], float)
    return _positive_power(weight, 1 / species.drive_power), _positive_power(weight * excess, 1 / species.drive_power)


def _positive_power(x: Floats, power: Floats | float) -> Floats:
    """Return x^power of x >= 0 for a power above 0, the same on every processor."""
    return np.where(x > 0, elementary.power(np.where(x > 0, x, 1.0), power), 0.0)


def drive(delta: Floats, epsilon: Floats | float, exponent: Floats | float = 1.0, form: Form | None = None) -> Floats:
    """Return d(delta) = (epsilon + sum_i |c_i delta_i|^n) ^ (exponent / n), (...) for delta (..., V).

    Without a `form` it is the paper's, all c = 1 and n = 2. Learners compute the drive again, from zeta;
    CONTRIBUTING.md lists where.
    """
    if form is not None:
        size = np.abs(delta) * np.where(delta > 0, form.above, form.below)
        power = np.asarray(form.power, float)
        total = epsilon + _positive_power(size, power[..., None]).sum(axis=-1)
        return elementary.power(total, np.asarray(exponent / power))
    root = np.sqrt(epsilon + np.einsum("...v,...v->...", delta, delta))
    if isinstance(exponent, float) and exponent == 1.0:
        return root
    return root if np.all(exponent == 1.0) else elementary.power(root, exponent)


def set_points(body: Body, state: State) -> Floats:
    """Return x* as it is now, (n, V)."""
    return body.set_point if state.set_point is None else state.set_point


def deviation(body: Body, internal: Floats, set_point: Floats | None = None) -> Floats:
    """Return delta = x - x* of the regulated needs, 0 for the others, (n, V); x* is the scenario's if not given."""
    return (internal - (body.set_point if set_point is None else set_point)) * body.regulated


def velocity(body: Body, internal: Floats, control: Floats, time: float, age: Floats) -> Floats:
    """Return f(zeta, u, t) of the internal state, (n, V) per unit of time (paper, eq. of d zeta).

    (a) self-regulation, (b) the control u (n, V), (c) time and age.
    """
    decay = body.decay
    if body.varies:
        season = 1.0 + body.amplitude * elementary.sin(body.frequency * time + body.phase)
        decay = decay * season * (1.0 + body.ageing * age[:, None])
    if body.leaks:
        leaked = body.leak * internal
        rate = np.where(body.proportional, control * internal, control) - decay - leaked
        for rows, source, into, factor in body.flows:
            rate[rows, into] += factor * leaked[rows, source]
        return rate
    return control - decay


def noise(body: Body, dt: float, rng: np.random.Generator) -> Floats:
    """Return g dS over dt, (n, V): a Wiener increment per need."""
    return body.noise * (np.sqrt(dt) * rng.standard_normal(body.noise.shape))


def drive_of(species: Species, delta: Floats) -> Floats:
    """Return d of one body of a species at delta (..., V) of its regulated needs, 0 of others, (...)."""
    form = None if not has_bent_drive(species) else Form(*drive_factors(species), np.array(float(species.drive_power)))
    return drive(delta, species.drive_epsilon, float(species.drive_exponent), form)


def body_now(model: Model, state: State) -> Body:
    """Return the constants of all bodies as their traits and their age have them."""
    body, stages = model.body, model.stages
    if model.heredity is not None:
        body = heredity.embody(model.heredity, body, state)
    if stages is None:
        return body
    return replace(body, decay=body.decay * stages.of(stages.metabolism, state.age)[:, None])


def advance(
    body: Body,
    internal: Floats,
    control: Floats,
    time: float,
    age: Floats,
    dt: float,
    rng: np.random.Generator,
) -> Floats:
    """Return x after dt: an Euler step of d zeta = f dt + g dS, before bounds, (n, V)."""
    after = internal + velocity(body, internal, control, time, age) * dt
    if body.noisy:
        after += noise(body, dt, rng)
    return after


def commit(model: Model, state: State, internal: Floats, taken: Floats, died: Bools) -> None:
    """Set x (N, V) of the living, within its bounds, and keep the account of it.

    `taken` (N, V) came from outside in the tick; agents that `died` (N,) keep what they had before it.
    """
    state.own("metabolised", "lost", "age", "hold")
    ledger = Ledger(taken, state.metabolised, state.lost, state.age, state.hold)
    state.internal, state.alive = settle(
        state.alive, died, state.internal, internal, model.body.low, model.body.high, ledger, model.dt
    )


def clamp(body: Body, internal: Floats) -> Floats:
    """Return x kept within its bounds: the organism's automatic regulation, (n, V)."""
    return np.minimum(np.maximum(internal, body.low), body.high)


def fatal(body: Body, internal: Floats) -> Bools:
    """Return which bodies have a lethal need beyond its bounds, (n,); call it before `clamp`."""
    return np.logical_or.reduce(_beyond(body, internal), axis=1)


def first_fatal(body: Body, internal: Floats) -> Ints:
    """Return the column of the first lethal need beyond its bounds, (n,); 0 where none is."""
    found: Ints = _beyond(body, internal).argmax(axis=1)
    return found


def _beyond(body: Body, internal: Floats) -> Bools:
    """Return which lethal needs are beyond their bounds, (n, V)."""
    return ((internal < body.low) | (internal > body.high)) & body.lethal


@compiled
def settle(
    alive: Bools, died: Bools, before: Floats, after: Floats, low: Floats, high: Floats, ledger: Ledger, dt: float
) -> tuple[Floats, Bools]:
    """Return x (N, V) kept within its bounds, the organism's automatic regulation, and which agents survive (N,).

    x went from `before` to `after` by f and g and what was taken from outside. One that dies, or is dead, keeps what it
    was before. The ledger of those that were alive is kept: before + taken - metabolised - lost = x. Survivors grow
    older by dt, and what immobilises bodies wears off.
    """
    taken, metabolised, lost, age, hold = ledger
    kept, lives = before.copy(), np.empty(len(alive), np.bool_)
    for i in range(len(alive)):
        lives[i] = alive[i] and not died[i]
        if alive[i]:
            for v in range(before.shape[1]):
                if lives[i]:
                    kept[i, v] = min(max(after[i, v], low[i, v]), high[i, v])
                metabolised[i, v] += before[i, v] + taken[i, v] - after[i, v]
                lost[i, v] += after[i, v] - kept[i, v]
        if lives[i]:
            age[i] += dt
        hold[i] = max(hold[i] - dt, 0.0) if hold[i] > 1.5 * dt else 0.0
    return kept, lives
