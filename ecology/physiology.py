"""The body: deviation, drive, transition f, noise g and reward, pure functions of arrays.

Shapes: n agents, V needs. Equations of Laurencon et al. (2021), section "Modeling".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ecology import elementary
from ecology.compiler_cache import compiled, use_cache
from ecology.spec import Need, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model

use_cache(__file__)


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
    straight: bool  # whether every exponent is 1
    varies: bool  # whether any season or ageing is at work
    leaks: bool  # whether any rate is proportional to x
    noisy: bool
    deadly: bool
    moves: bool  # whether any set point can move: they are in the state then


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
        straight=all(s.drive_exponent == 1.0 for s in species),
        varies=bool(frequency.any() or ageing.any()),
        leaks=bool(leak.any() or proportional.any()),
        noisy=bool(noise.any()),
        deadly=bool(lethal.any()),
        moves=any(need.set_range is not None for s in species for need in s.needs),
    )


def drive(delta: Floats, epsilon: Floats | float, exponent: Floats | float = 1.0) -> Floats:
    """Return d(delta) = (epsilon + delta . delta) ^ (exponent / 2), (...) for delta (..., V)."""
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
        return np.where(body.proportional, control * internal, control) - decay - body.leak * internal
    return control - decay


def noise(body: Body, dt: float, rng: np.random.Generator) -> Floats:
    """Return g dS over dt, (n, V): a Wiener increment per need."""
    return body.noise * (np.sqrt(dt) * rng.standard_normal(body.noise.shape))


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
    """Give the living the x (N, V) that they have come to, within its bounds, and keep the account of it.

    `taken` (N, V) came from outside in the tick; agents that `died` (N,) keep what they had before it.
    """
    body = model.body
    state.own("metabolised", "lost", "age", "hold")
    state.internal, state.alive = live(
        state.alive, died, state.internal, taken, internal, body.low, body.high,
        state.metabolised, state.lost, state.age, state.hold, model.dt,
    )  # fmt: skip


def clamp(body: Body, internal: Floats) -> Floats:
    """Return x kept within its bounds: the organism's automatic regulation, (n, V)."""
    return np.minimum(np.maximum(internal, body.low), body.high)


def fatal(body: Body, internal: Floats) -> Bools:
    """Return who has a lethal need beyond its bounds, (n,); ask before `clamp`."""
    return np.logical_or.reduce(_beyond(body, internal), axis=1)


def first_fatal(body: Body, internal: Floats) -> Ints:
    """Return the column of the first lethal need beyond its bounds, (n,); 0 where none is."""
    found: Ints = _beyond(body, internal).argmax(axis=1)
    return found


def _beyond(body: Body, internal: Floats) -> Bools:
    """Return which lethal needs are beyond their bounds, (n, V)."""
    return ((internal < body.low) | (internal > body.high)) & body.lethal


@compiled
def live(
    alive: Bools,
    died: Bools,
    before: Floats,
    taken: Floats,
    after: Floats,
    low: Floats,
    high: Floats,
    metabolised: Floats,
    lost: Floats,
    age: Floats,
    hold: Floats,
    dt: float,
) -> tuple[Floats, Bools]:
    """Return x (N, V) kept within its bounds, the organism's automatic regulation, and who lives on (N,).

    x goes from `before` to `after` by f and g and what was `taken` from outside; one that dies, or is dead, keeps
    what it was. Written: `metabolised` and `lost` (N, V), before + taken - metabolised - lost = kept; `age`, `hold`.
    """
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
