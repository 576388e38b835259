"""Resources as stock times place: sharing, growth, availability and motion, pure functions of arrays.

Shapes: N slots, R resources, V needs, W walls. Amounts are in units of intake.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ecology import elementary
from ecology.actions import Deeds
from ecology.compiler_cache import compiled, use_cache
from ecology.elementary import cosine_and_sine, exponential, exponential_less_one
from ecology.ground import Ground, scatter_in
from ecology.ground.outline import polygon_of
from ecology.spec import Arena, Drift, Growth, Oscillation, Relocation, Resource, Season, Species
from ecology.state import Bools, Floats, Ints, State

if TYPE_CHECKING:
    from ecology.model import Model
    from ecology.senses import Perception

use_cache(__file__, elementary.__file__)

CRUMB = 1e-9  # share of a stock; who asks for all but a crumb gets the crumb too, so that it is empty


class Growing(NamedTuple):
    """How stocks grow: columns of `ResourceTable`."""

    capacity: Floats
    linear: Floats
    logistic: Floats
    exponential: Floats
    amplitude: Floats
    frequency: Floats
    phase: Floats
    gone_below: Floats


@dataclass(frozen=True)
class ResourceTable:
    """The constants of the resources, a row for each of R patches; 0 or False where a word is lacking."""

    kind: Ints  # (R,) resource, as the scenario lists them
    position: Floats  # (R, 2) at the start, NaN: scattered
    radius: Floats  # (R,)
    stock: Floats  # (R,) at the start
    capacity: Floats  # (R,)
    linear: Floats  # (R,) rate of growth, units per unit of time
    logistic: Floats  # (R,) rate of growth, per unit of time
    exponential: Floats  # (R,) rate of growth, per unit of time
    amplitude: Floats  # (R,) of the season of growth
    frequency: Floats  # (R,) of the season, radians per unit of time
    phase: Floats  # (R,) of the season, radians
    availability: Floats  # (R,) probability
    swings: Ints  # (S,) resources that oscillate
    far: Floats  # (S, 2) their other end
    swing: Floats  # (S,) periods per unit of time
    swing_phase: Floats  # (S,) periods
    rooms: tuple[Any, ...]  # R, shapely geometries in which patches are scattered; None where they are not
    drifts: Ints  # (D,) resources that drift
    spread: Floats  # (D,) length per square root of a unit of time
    relocates: Bools  # (R,)
    gone_below: Floats  # (R,) stock at which a patch is gone, -1 where it stays
    relocating: bool  # whether any relocates
    finite: bool  # whether any stock can be short
    uncertain: bool  # whether any is not always available
    constant: bool  # whether all are unlimited, always available and stay where they are

    @cached_property
    def growing(self) -> Growing:
        """Return how stocks grow."""
        return Growing(*(getattr(self, name) for name in Growing._fields))


def compile_resources(resources: Sequence[Resource], arena: Arena, everyone: Sequence[Species] = ()) -> ResourceTable:
    """Return the constants of the patches of `resources` of `arena`, in their order, which `everyone` may consume."""
    scattered = [r.position is None or isinstance(r.motion, Relocation) for r in resources]
    rooms = [room_of(r, arena, everyone) if any_ else None for r, any_ in zip(resources, scattered, strict=True)]
    kind = np.repeat(np.arange(len(resources)), [r.count for r in resources])
    resources = [r for r in resources for _ in range(r.count)]

    def growth(kind: str) -> Floats:
        return np.array([r.growth.rate if r.growth and r.growth.kind == kind else 0.0 for r in resources], float)

    def season(read: Callable[[Season], float]) -> Floats:
        found = [r.growth.season if isinstance(r.growth, Growth) else None for r in resources]
        return np.array([read(s) if s else 0.0 for s in found], float)

    swings = [(i, r.motion) for i, r in enumerate(resources) if isinstance(r.motion, Oscillation)]
    drifts = [(i, r.motion) for i, r in enumerate(resources) if isinstance(r.motion, Drift)]
    stock = np.array([r.stock for r in resources], float)
    availability = np.array([r.availability for r in resources], float)
    finite, uncertain = bool(np.isfinite(stock).any()), bool((availability < 1).any())
    return ResourceTable(
        kind=kind,
        position=np.array([r.position or (np.nan, np.nan) for r in resources], float).reshape(-1, 2),
        radius=np.array([r.radius for r in resources], float),
        stock=stock,
        capacity=np.array([r.most for r in resources], float),
        linear=growth("linear"),
        logistic=growth("logistic"),
        exponential=growth("exponential"),
        amplitude=season(lambda s: s.amplitude),
        frequency=season(lambda s: 2 * np.pi / s.period),
        phase=season(lambda s: s.phase),
        availability=availability,
        swings=np.array([i for i, _ in swings], np.int64),
        far=np.array([m.to for _, m in swings], float).reshape(-1, 2),
        swing=np.array([1 / m.period for _, m in swings], float),
        swing_phase=np.array([m.phase / (2 * np.pi) for _, m in swings], float),
        rooms=tuple(rooms[k] for k in kind),
        drifts=np.array([i for i, _ in drifts], np.int64),
        spread=np.array([m.spread for _, m in drifts], float),
        relocates=np.array([isinstance(r.motion, Relocation) for r in resources], bool),
        gone_below=np.array([-1.0 if r.gone_below is None else r.gone_below for r in resources], float),
        relocating=any(isinstance(r.motion, Relocation) for r in resources),
        finite=finite,
        uncertain=uncertain,
        constant=not (finite or uncertain or swings or drifts),
    )


# ---- places that bodies can reach ------------------------------------------------------------


def consumers(resource: Resource, everyone: Sequence[Species]) -> list[Species]:
    """Return the species that consume `resource`, those with the smallest bodies first."""
    found = [s for s in everyone if any(a.kind == "consume" and a.resource == resource.name for a in s.actions)]
    return sorted(found, key=lambda species: species.radius)


def too_far(resource: Resource, arena: Arena, species: Species) -> bool:
    """Return whether no body of `species` comes into the circle of `resource` at its position, wherever that swings.

    The centre of a body stays a radius away from every wall, and has to come into the circle.
    """
    import shapely  # slow to load, needed once per world

    if arena.torus or resource.position is None:
        return False
    place, motion = resource.position, resource.motion
    way = shapely.LineString([place, motion.to]) if isinstance(motion, Oscillation) else shapely.Point(place)
    free = polygon_of(arena).buffer(-species.radius)
    return bool(free.distance(way) > resource.radius)


def room_of(resource: Resource, arena: Arena, everyone: Sequence[Species]) -> Any:
    """Return where the circle of `resource` may be put at random, a shapely geometry.

    The circle lies within the walls, and a body of one of the species of `everyone` that consume it can come into it.
    """
    polygon = polygon_of(arena)
    if arena.torus:
        return polygon
    room = polygon.buffer(-resource.radius, join_style="mitre")
    smallest = min((s.radius for s in consumers(resource, everyone)), default=0.0)
    if smallest > resource.radius:  # a smaller one comes wherever the circle fits
        room = room.intersection(polygon.buffer(-smallest).buffer(resource.radius))
    return room


# ---- eating --------------------------------------------------------------------------------


class Orders(NamedTuple):
    """What bodies ask of patches in a tick, units of intake."""

    wanted: Floats  # (N, V)
    total: Floats  # (N,) sum over the needs
    source: Ints  # (N,) patch, -1 without


def eat(
    model: Model, state: State, seen: Perception, deeds: Deeds, rng: Mapping[str, np.random.Generator]
) -> tuple[Floats, Floats]:
    """Return what bodies ingest (N, V) and what leaves the stocks (R,); write each one's share into the deeds' u."""
    control = deeds.control
    ingested, eaten = np.zeros(control.shape), np.zeros(len(state.stock))
    if not deeds.busy[1]:
        return ingested, eaten
    orders = Orders(np.zeros(control.shape), np.zeros(model.size), model.nobody.copy())
    if order_meals(deeds, state.alive, seen.here, state.internal, model.body.proportional, model.dt, orders):
        if model.yields:
            scale_meals(model, state, orders, control, rng["yield"])
        wanted, total, source = orders
        part, eaten = share(total, source, np.where(state.available, state.stock, 0.0))
        serve(wanted, source, part, control, ingested)
        state.ingested = state.ingested + ingested
        state.eaten = state.eaten + eaten
    return ingested, eaten


def scale_meals(model: Model, state: State, orders: Orders, control: Floats, rng: np.random.Generator) -> None:
    """Scale what meals ask for, and that part of u (N, V), by luck and by stock.

    A meal succeeds with its chance; one that goes by the stock is multiplied by the share of the capacity that its
    patch holds. Numbers are drawn for all slots, so that they do not depend on who eats.
    """
    wanted, total, source = orders
    capacity, drawn = model.resources.capacity, rng.random(model.size)
    full = np.divide(state.stock, capacity, out=np.ones(len(capacity)), where=(capacity > 0) & np.isfinite(capacity))
    for group, table in model.acting:
        rows, action = group.slots, state.action[group.slots]
        eats = (source[rows] >= 0) & (table.consumes[action] >= 0)
        likely = 1.0 - elementary.power(1.0 - table.chance[action], model.dt)
        factor = np.where(table.by_stock[action], full[source[rows]], 1.0) * (drawn[rows] < likely)
        factor = np.where(eats, factor, 1.0)
        wanted[rows] *= factor[:, None]
        total[rows] *= factor
        control[rows] = np.where(table.intake[action] > 0, control[rows] * factor[:, None], control[rows])


def share(wanted: Floats, source: Ints, stock: Floats) -> tuple[Floats, Floats]:
    """Return the share of what it asks for that each body gets (n,), and what leaves each stock (R,).

    `wanted` (n,) units asked of the resource `source` (n,). Where a stock is short, it is divided
    in proportion to what is asked and is empty afterwards, exactly.
    """
    return share_stocks(wanted, source, stock, CRUMB)


# ---- what a tick changes -------------------------------------------------------------------


def renew(model: Model, state: State, eaten: Floats, rng: Mapping[str, np.random.Generator]) -> None:
    """Let stocks regrow, appear, vanish and move in a tick in which `eaten` (R,) was eaten."""
    table, dt = model.resources, model.dt
    if table.constant:
        state.grown = state.eaten
        return
    stock, grown = regrow(table, state.stock, eaten, state.time, dt)
    until = (state.tick + 1) * dt
    places = swing(table, state.resource_position, until)
    places = drift(table, model.ground, places, dt, rng["motion"])
    if table.relocating:
        emptied = np.isfinite(state.stock) & (eaten > 0) & (state.stock - eaten <= 0)
        places, gone = relocate(table, places, emptied, rng["motion"])
        grown[gone] += table.stock[gone] - stock[gone]
        stock[gone] = table.stock[gone]
        if gone.any():  # an agent on its way there does not know where the patch went
            state.own("bound_for")
            bound = np.flatnonzero(state.bound_for >= 0)
            state.bound_for[bound[gone[state.bound_for[bound]]]] = -1
    state.stock, state.grown, state.resource_position = stock, state.grown + grown, places
    if table.uncertain:
        units = whole_units(until) - whole_units(state.time)
        state.available = appear(table, state.available, units, rng["availability"])


# ---- growing -------------------------------------------------------------------------------


def regrow(table: ResourceTable, stock: Floats, eaten: Floats, time: float, dt: float) -> tuple[Floats, Floats]:
    """Return the stock after a tick in which `eaten` was eaten, and what has grown, both (R,).

    Growth is the exact solution over dt from the stock at the start of the tick, and stops at the
    capacity; a stock that is eaten up stays empty but in the linear kind. An unlimited stock stays unlimited: as
    much grows as is eaten.
    """
    return grow_stocks(table.growing, stock, eaten, time, dt)


# ---- coming and going ----------------------------------------------------------------------


def appear(table: ResourceTable, available: Bools, units: int, rng: np.random.Generator) -> Bools:
    """Return which resources are available after `units` whole units of time have begun, (R,).

    At each the resource is drawn again, whatever it was before; between them it stays as it is. So
    ticks of any length see the same course of it, from the same random numbers.
    """
    return rng.random((units, len(available)))[-1] < table.availability if units else available


def whole_units(time: float) -> int:
    """Return how many whole units of time have passed; rounding of time is forgiven."""
    return math.floor(time + 1e-9)


# ---- moving --------------------------------------------------------------------------------


def first_places(table: ResourceTable, rng: np.random.Generator) -> Floats:
    """Return where the resources are at the start, (R, 2): scattered ones anywhere in their room."""
    places = table.position.copy()
    for i in np.flatnonzero(np.isnan(places[:, 0])):
        places[i] = _anywhere(table, int(i), rng)
    return swing(table, places, 0.0)


def swing(table: ResourceTable, places: Floats, time: float) -> Floats:
    """Return the places (R, 2) with the oscillating resources where a triangle wave has them at `time`."""
    if not table.swings.size:
        return places
    beat = (time * table.swing + table.swing_phase) % 1.0
    way = 1.0 - np.abs(1.0 - 2.0 * beat)  # 0 at the position, 1 at the other end, half a period later
    near = table.position[table.swings]
    places = places.copy()
    places[table.swings] = near + way[:, None] * (table.far - near)
    return places


def drift(table: ResourceTable, ground: Ground, places: Floats, dt: float, rng: np.random.Generator) -> Floats:
    """Return the places (R, 2) after the drifting resources have moved for dt, mirrored at the walls."""
    if not table.drifts.size:
        return places
    steps = table.spread[:, None] * (math.sqrt(dt) * rng.standard_normal((len(table.drifts), 2)))
    places = places.copy()
    if ground.torus:
        places[table.drifts] = ground.plane.home(places[table.drifts] + steps)
        return places
    for i, step in zip(table.drifts, steps, strict=True):
        places[i] = ground.reflect(places[i], step)
    return places


def _anywhere(table: ResourceTable, patch: int, rng: np.random.Generator) -> Floats:
    return scatter_in(table.rooms[patch], 1, rng, f"circles of radius {float(table.radius[patch])!r}")[0]


def relocate(table: ResourceTable, places: Floats, emptied: Bools, rng: np.random.Generator) -> tuple[Floats, Bools]:
    """Return the places (R, 2) after relocation and which have relocated (R,), of the `emptied` (R,)."""
    gone = emptied & table.relocates
    if gone.any():
        places = places.copy()
        for i in np.flatnonzero(gone):
            places[i] = _anywhere(table, int(i), rng)
    return places, gone


# ---- compiled loops ----------------------------------------------------------------------------


@compiled
def grow_stocks(growing: Growing, stock: Floats, eaten: Floats, time: float, dt: float) -> tuple[Floats, Floats]:
    """Return the stock (R,) after a tick in which `eaten` (R,) was eaten, and what has grown (R,): see `regrow`."""
    capacity, linear, logistic, exponential_, amplitude, frequency, phase, gone_below = growing
    after, grown = stock.copy(), eaten.copy()
    for r in range(len(stock)):
        if not np.isfinite(stock[r]):
            continue
        span = dt  # the integral of 1 + amplitude sin(2 pi t / period + phase) over the tick
        if frequency[r] > 0:
            angle = frequency[r] * time + phase[r]
            wave = cosine_and_sine(angle)[0] - cosine_and_sine(angle + frequency[r] * dt)[0]
            span = dt + amplitude[r] * wave / frequency[r]
        more = linear[r] * span
        s, k = stock[r], capacity[r]
        if logistic[r] > 0 and s > eaten[r]:  # what is eaten up has no seed left
            rate = logistic[r] * span
            more = s * (k - s) * -exponential_less_one(-rate) / (s + (k - s) * exponential(-rate))
        if exponential_[r] > 0 and s > eaten[r]:
            more = s * exponential_less_one(min(exponential_[r] * span, 600.0))  # e^600 fills any stock
        left = s - eaten[r]  # not negative: a share is at most the stock
        if left <= gone_below[r]:
            more = 0.0  # nothing grows on what is gone
        grown[r] = min(more, k - left)
        after[r] = left + grown[r]
    return after, grown


@compiled
def order_meals(
    deeds: Deeds, alive: Bools, here: Ints, internal: Floats, proportional: Bools, dt: float, orders: Orders
) -> int:
    """Write the `orders` of bodies that consume in a tick, and return how many do.

    The control of a body that is held to a meal that is gone is none. A proportional need's control multiplies x, so
    it asks for u x dt.
    """
    wanted, total, source = orders
    eaters = 0
    for i in range(len(alive)):
        kind = deeds.consumes[i]
        if kind < 0 or not alive[i]:
            continue
        if here[i, kind] < 0:
            deeds.control[i] = 0.0
            continue
        eaters += 1
        source[i] = here[i, kind]
        for v in range(internal.shape[1]):
            asked = deeds.intake[i, v]
            if proportional[i, v]:
                asked *= internal[i, v]
            wanted[i, v] = max(asked, 0.0) * dt
            total[i] += wanted[i, v]
    return eaters


@compiled
def share_stocks(wanted: Floats, source: Ints, stock: Floats, crumb: float) -> tuple[Floats, Floats]:
    """Return the share of what it asks for that each body gets (n,), and what leaves each stock (R,).

    See `share`; a body without a source, -1, gets nothing.
    """
    eaten, part, given = np.zeros(len(stock)), np.ones(len(stock)), np.zeros(len(wanted))
    for i in range(len(wanted)):
        if source[i] >= 0:
            eaten[source[i]] += wanted[i]
    for r in range(len(stock)):
        if eaten[r] > 0 and eaten[r] >= stock[r] * (1 - crumb):
            part[r] = stock[r] / eaten[r]
            eaten[r] = stock[r]
    for i in range(len(wanted)):
        if source[i] >= 0:
            given[i] = part[source[i]]
    return given, eaten


@compiled
def serve(wanted: Floats, source: Ints, part: Floats, control: Floats, ingested: Floats) -> None:
    """Write `control`, `ingested` (N, V) of slots with a `source` (N,), which get their `part` of what is `wanted`."""
    for i in range(len(source)):
        if source[i] >= 0:
            for v in range(wanted.shape[1]):
                ingested[i, v] = wanted[i, v] * part[i]
                control[i, v] *= part[i]
