"""The frozen words of a scenario: Need, Action, Species (Birth, Hazard, Neighbours, Empathy), Resource, Arena, Event.

Everything a user writes is per unit of time (rates, speeds) and in units of the plane (lengths).
Each word checks itself; `scenario.Scenario` checks that the words fit together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from dataclasses import field as _field  # where a field of a word is called so
from typing import Literal

from ecology import typed
from ecology.errors import EcologyError, nearest

Kind = Literal["rest", "move", "turn", "sleep", "consume", "go_to", "bite", "give", "take", "drop", "act"]
Commitment = Literal["free", "committed"]
Cause = Literal["need", "eaten", "hazard", "rule", "bitten"]
BODILY = ("set_point", "decay", "leak", "ageing", "noise")  # numbers of a need that can be inherited


def require(rule: bool, message: str) -> None:
    """Raise EcologyError(message) unless `rule` holds."""
    if not rule:
        raise EcologyError(message)


def require_known(name: str | None, known: Collection[str], message: str, without: str | None = None) -> None:
    """Raise EcologyError(message), with the nearest words or with what to do `without` any, unless `name` is known."""
    if name is not None and name not in known:
        raise EcologyError(f"{message} {without if without and not known else nearest(name, known)}")


def _words(owner: str, name: str) -> None:
    require(bool(name) and name.isidentifier(), f"{owner}: a name is a Python word.")


def _amounts(owner: str, word: str, amounts: Mapping[str, float], *, below: float = math.inf) -> None:
    for name, value in amounts.items():
        require(
            isinstance(value, (int, float)) and 0 <= value < below,
            f"{owner}: {word} of {name!r} must be a number of at least 0, got {value!r}.",
        )


def _finite(owner: str, /, **numbers: float) -> None:
    for name, value in numbers.items():
        require(
            isinstance(value, (int, float)) and math.isfinite(value),
            f"{owner}: {name} must be a finite number, got {value!r}.",
        )


@dataclass(frozen=True, kw_only=True)
class Season:
    """A sine of time that multiplies a decay or a growth: 1 + amplitude sin(2 pi t / period + phase)."""

    amplitude: float  # share by which the rate rises and falls
    period: float  # units of time
    phase: float = 0.0  # radians

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Season", amplitude=self.amplitude, period=self.period, phase=self.phase)
        require(self.period >= 1e-9, f"Season: period must be positive, at least 1e-9, got {self.period!r}.")


@dataclass(frozen=True, kw_only=True)
class Adaptation:
    """The set point of a need that moves by itself, within the need's `set_range`.

    x* = x*_0 + swing sin(2 pi t / period + phase) + offset. What is eaten, or received from others, moves the offset by
    `gain` per unit; it goes back to 0 by `recovery` per unit of time, and by the share `relaxation`.
    """

    gain: float = 0.0  # change of the set point per unit taken in
    recovery: float = 0.0  # towards x*_0, units per unit of time
    relaxation: float = 0.0  # towards x*_0, share of the offset per unit of time
    by: str | None = None  # need whose intake counts, such as the blood that feeds this one; itself when None
    swing: float = 0.0  # of the clock, units
    period: float = 1.0  # of the clock, units of time
    phase: float = 0.0  # of the clock, radians

    def __post_init__(self) -> None:
        typed.check_types(self)
        numbers = {name: getattr(self, name) for name in ("gain", "recovery", "relaxation", "swing", "period", "phase")}
        _finite("Adaptation", **numbers)
        for name in ("recovery", "relaxation", "swing"):
            require(numbers[name] >= 0, f"Adaptation: {name} must not be negative, got {numbers[name]!r}.")
        require(self.period >= 1e-9, f"Adaptation: period must be positive, at least 1e-9, got {self.period!r}.")
        require(
            self.gain != 0 or self.swing > 0,
            "Adaptation: nothing moves the set point, gain and swing are 0; give one, or leave the adaptation out.",
        )


@dataclass(frozen=True, kw_only=True)
class Need:
    """One variable x of the internal state and the way it moves by itself (paper, eq. of d zeta).

    dx = (-decay * season(t) * (1 + ageing * age) - leak * x + u [* x if proportional]) dt + noise dS

    A need that `feeds` others is a compartment, such as a gut or the blood: what leaks out of it enters them.
    A fatigue is a need whose set point is 0: it grows by itself (negative decay), or where actions control it, and then
    recovers by its decay (the muscle fatigue of `paper`).
    """

    name: str
    set_point: float  # x*, in units of the variable
    start: float | None = None  # x at birth; the set point when None
    decay: float = 0.0  # (a) self-regulation: units lost per unit of time
    leak: float = 0.0  # (a) self-regulation proportional to x, per unit of time
    proportional: bool = False  # (b) whether the control u multiplies x, as in the authors' code
    season: Season | None = None  # (c) time of day or year
    ageing: float = 0.0  # (c) growth of the decay per unit of age
    noise: float = 0.0  # (d) standard deviation per square root of a unit of time
    bounds: tuple[float, float] = (0.0, math.inf)  # x is clamped to them, or the agent dies beyond them if lethal
    floor: float = -math.inf  # x is kept above it; unlike the bounds it may lie above the set point
    lethal: bool = False  # whether the agent dies when x leaves the bounds
    regulated: bool = True  # whether the deviation counts in the drive
    set_range: tuple[float, float] | None = None  # within which the set point may move; None: it stays
    adaptation: Adaptation | None = None  # how the set point moves by itself; it needs a set_range
    weight: float = 1.0  # w of the drive: how much the deviation counts
    excess: float = 1.0  # factor of w above the set point
    feeds: Mapping[str, float] = field(default_factory=dict)  # need -> units it gets per unit that leaks from this one

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"need {self.name!r}"
        _words(owner, self.name)
        _finite(
            owner,
            set_point=self.set_point,
            start=self.x0,
            decay=self.decay,
            leak=self.leak,
            ageing=self.ageing,
            noise=self.noise,
        )
        require(self.noise >= 0, f"{owner}: noise must not be negative, got {self.noise!r}.")
        _finite(owner, **{f"feeds[{name!r}]": factor for name, factor in self.feeds.items()})
        require(
            not self.feeds or self.leak != 0,
            f"{owner}: it feeds {sorted(self.feeds)} with what leaks out of it, and nothing does; give it a leak.",
        )
        require(self.name not in self.feeds, f"{owner}: it feeds itself; lower its leak instead.")
        require(
            len(self.bounds) == 2 and self.bounds[0] < self.bounds[1],
            f"{owner}: bounds must be (low, high) with low < high, got {self.bounds!r}.",
        )
        low, high = self.bounds
        require(
            low <= self.set_point <= high,
            f"{owner}: the bounds {self.bounds!r} must include the set point {self.set_point!r}; "
            "widen the bounds or move the set point.",
        )
        require(
            low <= self.x0 <= high,
            f"{owner}: the bounds {self.bounds!r} must include the start {self.x0!r}.",
        )
        require(
            self.floor <= self.x0 and not (self.lethal and math.isfinite(self.floor)),
            f"{owner}: the floor {self.floor!r} must not lie above the start {self.x0!r}, and a lethal need "
            "has none: its bounds are where it dies.",
        )
        self._check_range(owner)

    def _check_range(self, owner: str) -> None:
        _finite(owner, weight=self.weight, excess=self.excess)
        require(self.weight > 0, f"{owner}: weight must be positive, got {self.weight!r}; regulated=False is for none.")
        require(self.excess >= 0, f"{owner}: excess must not be negative, got {self.excess!r}.")
        if self.set_range is None:
            require(
                self.adaptation is None,
                f"{owner}: a set point that moves needs a set_range, within which it stays; got None.",
            )
            return
        require(len(self.set_range) == 2, f"{owner}: set_range is (lowest, highest), got {self.set_range!r}.")
        _finite(owner, **{"set_range[0]": self.set_range[0], "set_range[1]": self.set_range[1]})
        lowest, highest = self.set_range
        require(
            self.bounds[0] <= lowest <= self.set_point <= highest <= self.bounds[1] and lowest < highest,
            f"{owner}: set_range must be (lowest, highest) within the bounds {self.bounds!r} and include the set point "
            f"{self.set_point!r}, got {self.set_range!r}.",
        )
        swing = 0.0 if self.adaptation is None else self.adaptation.swing
        require(
            lowest <= self.set_point - swing and self.set_point + swing <= highest,
            f"{owner}: a swing of {swing!r} around the set point {self.set_point!r} leaves the set_range "
            f"{self.set_range!r}; widen it, or swing less.",
        )

    @property
    def x0(self) -> float:
        """Return the value at birth."""
        return self.set_point if self.start is None else self.start

    @property
    def low(self) -> float:
        """Return the lowest value: the lower bound, or the floor where that lies higher."""
        return max(self.bounds[0], self.floor)

    @property
    def set_points(self) -> tuple[float, float]:
        """Return the lowest and the highest set point that it can have."""
        return (self.set_point, self.set_point) if self.set_range is None else self.set_range

    @property
    def deviations(self) -> tuple[float, float]:
        """Return the lowest and the highest deviation x - x*, wherever the set point is."""
        lowest, highest = self.set_points
        return self.low - highest, self.bounds[1] - lowest

    @property
    def scale(self) -> float:
        """Return the size of an ordinary deviation: x*, or 3 for a variable whose set point is 0."""
        return abs(self.set_point) if self.set_point else 3.0


@dataclass(frozen=True, kw_only=True)
class Action:
    """One action as data: its control u, its motion, and when it is open.

    Write actions with `rest`, `move`, `turn`, `sleep`, `consume`, `go_to`, `bite`, `give`, `take`, `drop` and `act`,
    each of which takes a `name`; without one, the action is called after what it does and to whom ("bite_prey").
    """

    name: str
    kind: Kind
    control: Mapping[str, float] = field(default_factory=dict)  # u: need -> change per unit of time
    speed: float = 0.0  # forward, length per unit of time
    turn: float = 0.0  # radians per unit of time, positive to the left
    direction: float | None = None  # absolute direction of a move, radians; None: the heading
    resource: str | None = None  # of consume, go_to, take and drop
    into: str | None = None  # of drop: resource whose patch holds it then
    amount: float = 0.0  # of take and drop: units per unit of time
    species: str | None = None  # of bite and give: species of the partner
    reach: float = 0.0  # of bite and give: farthest distance between the centres, length
    chance: float = 1.0  # of bite and consume: probability of success per unit of time; a failed meal takes nothing
    gain: Mapping[str, float] = field(default_factory=dict)  # of bite: units that a success adds to its own needs
    damage: Mapping[str, float] | None = None  # of bite: units that the victim loses; None: it dies
    gives: Mapping[str, float] = field(default_factory=dict)  # of give: units per unit of time, from need to same need
    efficiency: float = 1.0  # of give: share of what is given that arrives
    drain: Mapping[str, float] = field(default_factory=dict)  # need -> share of x that it loses per unit of time
    by_stock: bool = False  # of consume: intake is multiplied by the share of its capacity that the patch holds
    duration: float = 0.0  # minimal duration, during which no other action is open; of bite: handling time
    cue: str | None = None  # open only while this cue of the scenario is shown
    emits: Mapping[str, float] = field(default_factory=dict)  # channel -> content of the signal that it sends
    opens_from: Mapping[str, float] = field(default_factory=dict)  # need -> lowest level at which the action is open
    closes_at: Mapping[str, float] = field(default_factory=dict)  # need -> level from which the action is closed

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"action {self.name!r}"
        _words(owner, self.name)
        _finite(owner, speed=self.speed, turn=self.turn, duration=self.duration)
        require(self.speed >= 0, f"{owner}: speed must not be negative, got {self.speed!r}.")
        require(
            self.speed > 0 or self.kind not in ("move", "go_to"),
            f"{owner}: a {self.kind} needs a positive speed, got {self.speed!r}.",
        )
        require(self.turn != 0 or self.kind != "turn", f"{owner}: a turn needs a rate other than 0.")
        if self.direction is not None:
            _finite(owner, direction=self.direction)
        require(self.duration >= 0, f"{owner}: duration must not be negative, got {self.duration!r}.")
        for rates in (self.control, self.drain, self.opens_from, self.closes_at, self.emits):
            _finite(owner, **rates)
        require(
            (self.resource is not None) == (self.kind in ("consume", "go_to", "take", "drop")),
            f"{owner}: consume, go_to, take and drop name a resource, other actions do not.",
        )
        hauls = self.kind in ("take", "drop")
        _finite(owner, amount=self.amount)
        require(
            (self.amount > 0) == hauls,
            f"{owner}: take and drop have an amount above 0 per unit of time, other actions have none, got "
            f"{self.amount!r}.",
        )
        require(
            (self.into is not None) == (self.kind == "drop"), f"{owner}: drop says into what, other actions do not."
        )
        require(self.duration == 0 or not hauls, f"{owner}: a {self.kind} has no duration, got {self.duration!r}.")
        meets = self.kind in ("bite", "give")
        require((self.species is not None) == meets, f"{owner}: bite and give name a species, other actions do not.")
        _finite(owner, reach=self.reach)
        require(self.reach > 0 or not meets, f"{owner}: reach must be positive, got {self.reach!r}.")
        for word, share in (("chance", self.chance), ("efficiency", self.efficiency)):
            require(
                isinstance(share, (int, float)) and 0 <= share <= 1,
                f"{owner}: {word} must be a number from 0 to 1, got {share!r}.",
            )
        for word, amounts in (("gain", self.gain), ("damage", self.damage or {}), ("gives", self.gives)):
            _amounts(owner, word, amounts)
        require(bool(self.gives) or self.kind != "give", f"{owner}: name what is given, {{need: units per time}}.")
        require(
            self.kind == "consume" or not self.by_stock,
            f"{owner}: by_stock is of consume, what it takes depends on the patch; a {self.kind} has none.",
        )
        require(
            self.chance == 1 or self.kind in ("bite", "consume"),
            f"{owner}: chance is of bite and consume; a {self.kind} always succeeds, got {self.chance!r}.",
        )
        require(
            self.cue is None or self.kind != "rest",
            f"{owner}: rest takes the place of closed actions and waits for no cue, got {self.cue!r}.",
        )


def rest(name: str = "rest", **rest_of: object) -> Action:
    """Return the action that does nothing: u = 0."""
    return Action(name=name, kind="rest", **rest_of)  # type: ignore[arg-type]


def move(name: str, speed: float, **rest_of: object) -> Action:
    """Return a move forward along the heading (or along `direction`) at `speed`."""
    return Action(name=name, kind="move", speed=speed, **rest_of)  # type: ignore[arg-type]


def turn(name: str, rate: float, **rest_of: object) -> Action:
    """Return a turn on the spot at `rate` radians per unit of time, positive to the left."""
    return Action(name=name, kind="turn", turn=rate, **rest_of)  # type: ignore[arg-type]


def sleep(name: str = "sleep", *, duration: float, **rest_of: object) -> Action:
    """Return a sleep that immobilises for `duration` units of time, and can be renewed."""
    return Action(name=name, kind="sleep", duration=duration, **rest_of)  # type: ignore[arg-type]


def consume(resource: str, intake: Mapping[str, float], *, name: str | None = None, **rest_of: object) -> Action:
    """Return the consumption of `resource`, open within its circle while there is some; `intake` is u per need.

    What it adds to needs is taken out of the stock, except for a need that cannot lie below its set point: a fatigue is
    raised at no cost. Where a stock is short, all of u is scaled down.
    """
    return Action(
        name=f"consume_{resource}" if name is None else name,
        kind="consume",
        resource=resource,
        control=intake,
        **rest_of,  # type: ignore[arg-type]
    )


def go_to(resource: str, speed: float, *, name: str | None = None, **rest_of: object) -> Action:
    """Return the walk to `resource`, open while a patch with stock is seen, until the body stands in one."""
    return Action(
        name=f"go_to_{resource}" if name is None else name,
        kind="go_to",
        resource=resource,
        speed=speed,
        **rest_of,  # type: ignore[arg-type]
    )


def bite(species: str, *, reach: float, name: str | None = None, **rest_of: object) -> Action:
    """Return the attack on the nearest of `species` within `reach`, open while there is one in sight.

    It succeeds with `chance` per unit of time, kills or does `damage`, adds `gain`, and is followed by
    the handling time `duration`, in which no other action is open. Of several that succeed on one
    victim in a tick, one drawn at random gets it.
    """
    return Action(
        name=f"bite_{species}" if name is None else name,
        kind="bite",
        species=species,
        reach=reach,
        **rest_of,  # type: ignore[arg-type]
    )


def give(
    species: str, gives: Mapping[str, float], *, reach: float, name: str | None = None, **rest_of: object
) -> Action:
    """Return the gift to the nearest of `species` within `reach`: `gives` units per unit of time and need.

    What is given leaves the giver, as far as it lies above its lower bound; `efficiency` of it arrives.
    """
    return Action(
        name=f"give_{species}" if name is None else name,
        kind="give",
        species=species,
        gives=gives,
        reach=reach,
        **rest_of,  # type: ignore[arg-type]
    )


def take(resource: str, amount: float, *, name: str | None = None, **rest_of: object) -> Action:
    """Return the action that takes `amount` per unit of time from a patch of `resource` into its load.

    It is open within the patch's circle while there is some and `Species.carries` leaves room. Where a stock is short,
    those that take share it; those that eat come first.
    """
    return Action(
        name=f"take_{resource}" if name is None else name,
        kind="take",
        resource=resource,
        amount=amount,
        **rest_of,  # type: ignore[arg-type]
    )


def drop(
    resource: str, amount: float, *, into: str | None = None, name: str | None = None, **rest_of: object
) -> Action:
    """Return the action that puts down `amount` per unit of time of its load of `resource`, as stock of `into`.

    `into` is the same resource unless another is named, a store. It goes into the patch in whose circle the body
    stands, as far as there is room; without a patch, into a new one there, if the patches of `into` come and go. It is
    open while something is carried and there is a place for it.
    """
    return Action(
        name=f"drop_{resource}" if name is None else name,
        kind="drop",
        resource=resource,
        into=resource if into is None else into,
        amount=amount,
        **rest_of,  # type: ignore[arg-type]
    )


def act(name: str, **rest_of: object) -> Action:
    """Return an action that does nothing but its control: the scenario's own rule gives it a meaning."""
    return Action(name=name, kind="act", **rest_of)  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True)
class Growth:
    """How a stock S regrows, up to its capacity K; the season multiplies the rate.

    linear: dS/dt = rate. logistic: dS/dt = rate S (1 - S / K). exponential: dS/dt = rate S, cut at K.
    An empty stock stays empty, but in the linear kind.
    """

    kind: Literal["linear", "logistic", "exponential"] = "linear"  # law of growth
    rate: float  # linear: units of the stock per unit of time; otherwise per unit of time
    season: Season | None = None  # factor of the rate over time

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Growth", rate=self.rate)
        require(self.rate > 0, f"Growth: rate must be positive, got {self.rate!r}; leave growth out for none.")
        require(
            self.season is None or abs(self.season.amplitude) <= 1,
            f"Growth: a season's amplitude must lie in [-1, 1], else growth would turn negative, got {self.season!r}.",
        )


@dataclass(frozen=True, kw_only=True)
class Oscillation:
    """A triangle wave of time: from the resource's position straight to `to` and back in one period."""

    to: tuple[float, float]  # the other end
    period: float  # time
    phase: float = 0.0  # radians of the wave at time 0: 0 at the position, pi at `to`

    def __post_init__(self) -> None:
        typed.check_types(self)
        require(len(self.to) == 2, f"Oscillation: to is (x, y), got {self.to!r}.")
        _finite("Oscillation", x=self.to[0], y=self.to[1], period=self.period, phase=self.phase)
        require(self.period >= 1e-9, f"Oscillation: period must be positive, at least 1e-9, got {self.period!r}.")


@dataclass(frozen=True, kw_only=True)
class Drift:
    """A Brownian motion of the circle's centre, reflected by the walls of the arena."""

    spread: float  # standard deviation along x and along y, length per square root of a unit of time

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Drift", spread=self.spread)
        require(self.spread > 0, f"Drift: spread must be positive, got {self.spread!r}.")


@dataclass(frozen=True, kw_only=True)
class Relocation:
    """A jump to a random place whenever the stock is eaten up; there it is what it was at the start."""


Motion = Oscillation | Drift | Relocation


@dataclass(frozen=True, kw_only=True)
class Seeding:
    """Patches that appear by chance where patches of the resource are gone, each with its stock at the start.

    `rate` brings them anywhere in the arena, `offspring` beside patches that are there: uniform over a circle of
    `reach` around each; those that would land behind a wall are lost. With all patches there, nothing appears.
    """

    rate: float = 0.0  # anywhere, per unit of time
    offspring: float = 0.0  # beside a patch, per unit of time and patch that is there
    reach: float = 1.0  # of offspring, farthest distance from its parent, length

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Seeding", rate=self.rate, offspring=self.offspring, reach=self.reach)
        require(
            self.rate >= 0 and self.offspring >= 0 and self.rate + self.offspring > 0,
            f"Seeding: rate and offspring must not be negative, and one must be positive, got {self.rate!r} and "
            f"{self.offspring!r}; leave seeding out for none.",
        )
        require(self.reach > 0, f"Seeding: reach must be positive, got {self.reach!r}.")


@dataclass(frozen=True, kw_only=True)
class Resource:
    """A stock at a place: a circle in the plane within which it can be consumed; or `count` of them.

    By default it is unlimited, fixed and always available. A stock is counted in units
    of intake: what consuming adds to needs is what leaves the stock. Of several patches, each has its
    own stock; one consumes the nearest whose circle one is in, and goes to the nearest that is seen
    from where there is none.

    With `gone_below`, patches come and go: one whose stock is no more than that is gone, what was left of it is
    spoiled, and its place is free for the next one that `seeding`, the `Remains` of a body or the scenario's rule
    brings.
    """

    name: str
    count: int = 1  # patches; with gone_below the most that can exist at once
    position: tuple[float, float] | None = None  # at the start; random in the arena when None
    radius: float = 0.3  # of the circle, length
    stock: float = math.inf  # at the start, units of intake
    capacity: float | None = None  # largest stock, units of intake; the stock at the start when None
    growth: Growth | None = None  # None: the stock does not regrow
    availability: float = 1.0  # probability of being there, drawn at every whole unit of time
    motion: Motion | None = None  # None: it does not move
    decay: float = 0.0  # share of the stock that spoils per unit of time
    gone_below: float | None = None  # stock at which a patch is gone; None: an empty patch stays where it is
    present: int | None = None  # patches that exist at the start; all when None
    seeding: Seeding | None = None  # patches that appear by chance

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"resource {self.name!r}"
        self._check_coming_and_going(owner)
        _words(owner, self.name)
        if self.position is not None:
            require(len(self.position) == 2, f"{owner}: position is (x, y), got {self.position!r}.")
            _finite(owner, x=self.position[0], y=self.position[1])
        require(
            isinstance(self.count, int) and self.count >= 1,
            f"{owner}: count must be a whole number of at least 1, got {self.count!r}.",
        )
        require(
            self.count == 1 or self.position is None,
            f"{owner}: {self.count!r} patches at the one position {self.position!r}; leave the position out to "
            "scatter them, or write a resource for each.",
        )
        _finite(owner, radius=self.radius)
        require(self.radius > 0, f"{owner}: radius must be positive, got {self.radius!r}.")
        for word, amount in (("stock", self.stock), ("capacity", self.most)):
            require(
                isinstance(amount, (int, float)) and amount >= 0,
                f"{owner}: {word} must be a number of at least 0, or math.inf, got {amount!r}.",
            )
        require(
            self.stock <= self.most,
            f"{owner}: the stock {self.stock!r} must not exceed the capacity {self.most!r}; "
            "raise the capacity or start with less.",
        )
        if self.growth is not None:
            require(
                math.isfinite(self.stock),
                f"{owner}: only a finite stock grows, got the stock {self.stock!r}; give a stock or leave growth out.",
            )
            require(self.most > 0, f"{owner}: growth needs room; give a capacity above the stock {self.stock!r}.")
            require(
                self.growth.kind == "linear" or (math.isfinite(self.most) and self.stock > 0),
                f"{owner}: {self.growth.kind} growth needs a finite capacity and a stock above 0 to start from, got "
                f"the stock {self.stock!r} and the capacity {self.most!r}.",
            )
        require(
            isinstance(self.availability, (int, float)) and 0 <= self.availability <= 1,
            f"{owner}: availability is a probability from 0 to 1, got {self.availability!r}.",
        )
        require(
            not isinstance(self.motion, Oscillation) or self.position is not None,
            f"{owner}: an oscillation starts from the resource's position, got None; give the position.",
        )
        require(
            not isinstance(self.motion, Relocation) or 0 < self.stock < math.inf,
            f"{owner}: a relocation waits until the stock is eaten up, so it needs a finite stock above 0, "
            f"got {self.stock!r}.",
        )

    def _check_coming_and_going(self, owner: str) -> None:
        _finite(owner, decay=self.decay)
        require(self.decay >= 0, f"{owner}: decay must not be negative, got {self.decay!r}.")
        require(
            self.decay == 0 or math.isfinite(self.stock),
            f"{owner}: only a finite stock spoils, got the stock {self.stock!r}; give a stock or leave decay out.",
        )
        comes = self.gone_below is not None
        if self.gone_below is not None:
            _finite(owner, gone_below=self.gone_below)
            require(self.gone_below >= 0, f"{owner}: gone_below must not be negative, got {self.gone_below!r}.")
            require(
                math.isfinite(self.stock) and self.most > self.gone_below,
                f"{owner}: patches that can be gone have a finite stock and a capacity above gone_below, got the stock "
                f"{self.stock!r}, the capacity {self.most!r} and gone_below {self.gone_below!r}.",
            )
            require(
                self.motion is None,
                f"{owner}: patches that come and go do not move, got {self.motion!r}; leave out motion or gone_below.",
            )
        require(
            self.present is None or (comes and 0 <= self.present <= self.count),
            f"{owner}: present is how many of the {self.count!r} patches are there at the start, and needs gone_below, "
            f"got {self.present!r}.",
        )
        require(
            self.seeding is None or (comes and self.stock > (self.gone_below or 0.0)),
            f"{owner}: seeding brings patches with the stock at the start, which must be above gone_below, got the "
            f"stock {self.stock!r} and gone_below {self.gone_below!r}; give both.",
        )

    @property
    def most(self) -> float:
        """Return the capacity: what the stock is at the start where none is given."""
        return self.stock if self.capacity is None else self.capacity

    @property
    def constant(self) -> bool:
        """Return whether it always is where its position says, and yields whatever is asked."""
        return self.position is not None and self.motion is None and math.isinf(self.stock) and self.availability == 1.0


@dataclass(frozen=True, kw_only=True)
class Door:
    """An inner wall that opens and closes: by time, or as the scenario's rule says (`outcome.doors[name] = True`).

    With a period it is open in the first `open_for` of each. While a body stands in its way it does not close. Open, it
    is no wall at all; closed, it may part the arena.
    """

    name: str
    start: tuple[float, float]
    end: tuple[float, float]
    open: bool = False  # at the start, without a period
    period: float | None = None  # units of time; None: it stays as it is until the rule moves it
    open_for: float = 0.5  # share of the period, from 0 to 1
    phase: float = 0.0  # share of the period that has passed at time 0

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"door {self.name!r}"
        _words(owner, self.name)
        for word, place in (("start", self.start), ("end", self.end)):
            require(len(place) == 2, f"{owner}: {word} is (x, y), got {place!r}.")
            _finite(owner, x=place[0], y=place[1])
        require(
            tuple(self.start) != tuple(self.end), f"{owner}: it starts and ends at {self.start!r}; give it a width."
        )
        _finite(owner, open_for=self.open_for, phase=self.phase)
        require(0 <= self.open_for <= 1, f"{owner}: open_for is a share from 0 to 1, got {self.open_for!r}.")
        require(
            self.period is None or 1e-9 <= self.period < math.inf,
            f"{owner}: period must be positive, at least 1e-9, got {self.period!r}.",
        )


@dataclass(frozen=True, kw_only=True)
class Field:
    """A quantity over the plane, such as temperature, light, odour, danger or mud.

    `values` are a function of x, y (arrays of n places) and the time, which returns n numbers; a number, the same
    everywhere; or a grid over the arena's extent, rows from low y to high, each from low x to high, linear between the
    centres of its cells. What is sensed and acts is kept within `low` and `high`.

    A grid or a number with diffusion, decay or sources changes: dF/dt = diffusion laplace(F) - decay F + sources.
    Nothing flows through walls. What a source gives is spread over the area of its cell, so that the integral of F over
    the arena grows by as much.
    """

    name: str
    values: Callable[..., object] | tuple[tuple[float, ...], ...] | float = 0.0  # function, grid or number
    low: float = -math.inf  # lowest value that is sensed and acts
    high: float = math.inf  # highest value that is sensed and acts
    scale: float = 1.0  # size of an ordinary value, for learners
    diffusion: float = 0.0  # area per unit of time
    decay: float = 0.0  # share per unit of time
    sources: Mapping[str, float] = field(default_factory=dict)  # resource or species -> given by each per unit of time
    cells: int = 32  # of a number that changes: cells along the arena's longer side

    def __post_init__(self) -> None:
        if hasattr(self.values, "tolist"):  # an array
            object.__setattr__(self, "values", self.values.tolist())
        if isinstance(self.values, (list, tuple)):
            rows = tuple(tuple(row) if isinstance(row, (list, tuple)) else row for row in self.values)
            object.__setattr__(self, "values", rows)
        typed.check_types(self)
        owner = f"field {self.name!r}"
        _words(owner, self.name)
        _finite(owner, scale=self.scale, diffusion=self.diffusion, decay=self.decay)
        require(self.scale > 0, f"{owner}: scale must be positive, got {self.scale!r}.")
        require(self.low < self.high, f"{owner}: low must lie below high, got {self.low!r} and {self.high!r}.")
        for word, value in (("diffusion", self.diffusion), ("decay", self.decay)):
            require(value >= 0, f"{owner}: {word} must not be negative, got {value!r}.")
        _finite(owner, **self.sources)
        require(1 <= self.cells <= 1000, f"{owner}: cells is a whole number from 1 to 1000, got {self.cells!r}.")
        require(
            not (callable(self.values) and self.changes),
            f"{owner}: a function says what the field is at every time, so it has no diffusion, decay or sources; give "
            "a grid or a number for the start, or leave these out.",
        )
        if isinstance(self.values, tuple):
            widths = {len(row) for row in self.values}
            require(
                len(widths) == 1 and 0 not in widths,
                f"{owner}: the rows of a grid are equally long, and none is empty, got lengths {sorted(widths)}.",
            )
            for row in self.values:
                _finite(owner, **{f"values[...][{i}]": value for i, value in enumerate(row)})
        elif not callable(self.values):
            _finite(owner, values=self.values)

    def __reduce__(self) -> tuple[Callable[..., Field], tuple[bytes]]:
        """Pickle a function by value, as `Scenario` does: no other process has loaded the file that it stands in."""
        import cloudpickle  # needed by those who pickle only

        return _unpickled_field, (cloudpickle.dumps(self.__dict__),)

    def __deepcopy__(self, memo: dict[int, object]) -> Field:
        """Return this field, which never changes."""
        return self

    @property
    def changes(self) -> bool:
        """Return whether it changes by its own dynamics."""
        return bool(self.diffusion or self.decay or self.sources)


def _unpickled_field(pickled: bytes) -> Field:
    import cloudpickle

    found = object.__new__(Field)
    found.__dict__.update(cloudpickle.loads(pickled))
    return found


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """The effect of a field on bodies of a species, in proportion to its value at their place minus a reference."""

    field: str  # name of the field
    reference: float = 0.0  # value without effect
    control: Mapping[str, float] = _field(default_factory=dict)  # need -> change per unit of the field and of time
    slowing: float = 0.0  # share of its speed that a body loses per unit of the field
    dimming: float = 0.0  # share of its view range that a body loses per unit of the field

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Exposure", reference=self.reference, slowing=self.slowing, dimming=self.dimming)
        _finite("Exposure", **self.control)
        require(
            bool(self.control or self.slowing or self.dimming),
            f"Exposure: the field {self.field!r} does nothing; give control, slowing or dimming.",
        )


class SenseSpec:
    """Base class of the parameters of a sense; `ecology.senses.zeta.PARAMETRIC` has the sense of each."""


@dataclass(frozen=True, kw_only=True)
class Gauge(SenseSpec):
    """The sense of a field at the body's place: its value, and its gradient along the heading and to the left of it."""

    field: str  # name of the field
    value: bool = True  # whether the value is sensed
    gradient: bool = False  # whether the gradient is sensed

    def __post_init__(self) -> None:
        typed.check_types(self)
        require(
            self.value or self.gradient,
            f"Gauge: nothing of the field {self.field!r} is sensed; give value or gradient.",
        )


@dataclass(frozen=True, kw_only=True)
class Rays(SenseSpec):
    """The sense of walls: distances to the nearest one along `count` rays, evenly over `spread` around the heading.

    The first ray is the one farthest to the right. Closed doors are walls; on a torus there are none.
    """

    range: float  # the farthest that is sensed, length
    count: int = 8  # number of rays
    spread: float = 2 * math.pi  # radians between the outermost rays; all around by default

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Rays", range=self.range, spread=self.spread)
        require(self.range > 0, f"Rays: range must be positive, got {self.range!r}.")
        require(1 <= self.count <= 360, f"Rays: count must be a whole number from 1 to 360, got {self.count!r}.")
        require(0 < self.spread <= 2 * math.pi, f"Rays: spread must lie in (0, 2 pi] radians, got {self.spread!r}.")


@dataclass(frozen=True, kw_only=True)
class Hearing(SenseSpec):
    """The sense of signals on a channel: content, distance and bearing of the nearest other that sends.

    An action sends by `emits`, in the tick in which it is executed. Walls do not stop a signal.
    """

    channel: str  # channel of `Action.emits`
    range: float  # the farthest that is heard, length

    def __post_init__(self) -> None:
        typed.check_types(self)
        _words("Hearing", self.channel)
        _finite("Hearing", range=self.range)
        require(self.range > 0, f"Hearing: range must be positive, got {self.range!r}.")


@dataclass(frozen=True, kw_only=True)
class Trace(SenseSpec):
    """The sense of a fading memory: the last large value of a component of zeta, times exp(-rate t) since.

    It is replaced by a value that is at least as far from 0 as what is left of it. A newborn remembers nothing.
    """

    of: str  # component of zeta, as `ecology check` lists them
    rate: float  # share that fades per unit of time

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Trace", rate=self.rate)
        require(self.rate > 0, f"Trace: rate must be positive, got {self.rate!r}.")


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A sense that is noisy or fails: what is read of one component of zeta.

    Noise is normal, drawn at every tick, and within the bounds of the component. A sense that fails reads 0 until it
    works again; in the long run it fails failure / (failure + repair) of the time.
    """

    of: str  # component of zeta
    noise: float = 0.0  # standard deviation, in units of the component
    failure: float = 0.0  # rate at which it fails, per unit of time
    repair: float = 0.0  # rate at which it works again, per unit of time

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Fault", noise=self.noise, failure=self.failure, repair=self.repair)
        for word, value in (("noise", self.noise), ("failure", self.failure), ("repair", self.repair)):
            require(value >= 0, f"Fault: {word} must not be negative, got {value!r}.")
        require(
            self.noise > 0 or self.failure > 0, f"Fault: {self.of!r} has neither noise nor failure; give one of them."
        )


@dataclass(frozen=True, kw_only=True)
class Arena:
    """A closed polygon whose edges are walls, with holes and inner walls in it.

    The edges of a hole are walls too. An inner wall is a polyline without thickness; it may touch or cross other walls.
    No body's centre crosses a wall, walls hide what lies behind them, and nothing is placed in a hole.

    A rectangle along the axes can do without walls (`walls=False`): an agent that leaves on one side comes in on the
    other (a torus). Bodies do not touch across that seam.
    """

    vertices: tuple[tuple[float, float], ...]  # of the outer walls, once around
    walls: bool | tuple[tuple[tuple[float, float], ...], ...] = True  # inner walls, each a polyline; False: a torus
    holes: tuple[tuple[tuple[float, float], ...], ...] = ()  # polygons, each the vertices once around
    doors: tuple[Door, ...] = ()  # inner walls that open and close

    def __post_init__(self) -> None:
        typed.check_types(self)
        from ecology.ground.outline import check_outline  # loads what checks polygons, once an arena is made

        check_outline(self)

    @property
    def torus(self) -> bool:
        """Return whether an agent that leaves on one side comes in on the other."""
        return self.walls is False

    @property
    def inner_walls(self) -> tuple[tuple[tuple[float, float], ...], ...]:
        """Return the walls within the outer ones, polylines."""
        return () if isinstance(self.walls, bool) else self.walls

    @property
    def extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the lowest x and y, and the highest."""
        xs, ys = zip(*self.vertices, strict=True)
        return (min(xs), min(ys)), (max(xs), max(ys))


@dataclass(frozen=True, kw_only=True)
class Birth:
    """Offspring of a parent that is fit: alive, mature, and every need in `threshold` at least there.

    A fit parent reproduces at `rate`. The newborn takes a free slot of its species and starts beside its parent, with
    its needs at their start; without a free slot the parent waits. With the rate 0, only the scenario's rule brings
    newborns.
    """

    rate: float  # per unit of time and fit parent
    threshold: Mapping[str, float] = field(default_factory=dict)  # need -> least x
    cost: Mapping[str, float] = field(default_factory=dict)  # need -> units that the parent gives
    maturity: float = 0.0  # age from which a body is fit, time
    parents: int = 1  # with 2, the nearest other fit body is the mate; only the first parent pays the cost
    mates_within: float = math.inf  # farthest distance of a mate, length
    limit: float = math.inf  # K: with n of the species alive the rate is multiplied by 1 - n / K, 0 from K on

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Birth", rate=self.rate, maturity=self.maturity)
        _finite("Birth", **self.threshold)  # apart: a need may have the name of a field
        require(self.rate >= 0, f"Birth: rate must not be negative, got {self.rate!r}; leave birth out for none.")
        require(self.maturity >= 0, f"Birth: maturity must not be negative, got {self.maturity!r}.")
        require(self.parents in (1, 2), f"Birth: parents are 1 or 2, got {self.parents!r}.")
        require(
            self.mates_within > 0 and (self.parents == 2 or self.mates_within == math.inf),
            f"Birth: mates_within is a positive distance, of two parents, got {self.mates_within!r}.",
        )
        require(self.limit > 0, f"Birth: limit must be positive, got {self.limit!r}; leave it out for none.")
        _amounts("Birth", "cost", self.cost)


@dataclass(frozen=True, kw_only=True)
class Hazard:
    """Death by chance: rate exp(ageing * age) per unit of time (Gompertz); constant without ageing."""

    rate: float  # at birth, per unit of time
    ageing: float = 0.0  # per unit of age

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Hazard", rate=self.rate, ageing=self.ageing)
        require(self.rate >= 0, f"Hazard: rate must not be negative, got {self.rate!r}.")


@dataclass(frozen=True, kw_only=True)
class Remains:
    """Remains of a body: a patch that appears where it dies, of a resource whose patches come and go.

    Its stock is `body` units, and of each need named the share that the body still stored of it, above the need's lower
    bound. Where no patch is free, or beyond the capacity, what is left is lost with the body.
    """

    resource: str  # name of the resource
    needs: Mapping[str, float] = field(default_factory=dict)  # need -> share of what is stored, from 0 to 1
    body: float = 0.0  # units that every body leaves, however starved
    causes: tuple[Cause, ...] = ("need", "hazard", "rule", "bitten", "eaten")  # causes of death that leave remains

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Remains", body=self.body)
        require(self.body >= 0, f"Remains: body must not be negative, got {self.body!r}.")
        for name, share in self.needs.items():
            require(0 <= share <= 1, f"Remains: the share of {name!r} must lie from 0 to 1, got {share!r}.")
        require(
            self.body > 0 or any(self.needs.values()),
            "Remains: nothing is left, body is 0 and no need has a share; give either, or leave remains out.",
        )
        require(bool(self.causes), "Remains: no cause of death leaves anything; name one, or leave remains out.")


@dataclass(frozen=True, kw_only=True)
class Crowding:
    """Effect of others within a distance on a body: u per other and unit of time."""

    within: float  # length, between the centres
    control: Mapping[str, float]  # need -> change per other and unit of time
    species: tuple[str, ...] = ()  # species that count as others; all when empty

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Crowding", within=self.within)
        _finite("Crowding", **self.control)
        require(self.within > 0, f"Crowding: within must be positive, got {self.within!r}.")


@dataclass(frozen=True, kw_only=True)
class Neighbours:
    """The sense of others: the `count` nearest in the view field, not hidden by a wall, nearest first.

    Per neighbour: distance, bearing from one's own heading, its heading from one's own, which
    species it is (where several are sensed), the deviations that its species opens, and where asked for, what it does,
    whether it is kin, and its identity. Without a neighbour the distance is the farthest and the rest is 0.
    """

    count: int = 1  # how many are sensed
    species: tuple[str, ...] = ()  # all when empty
    heading: bool = False  # whether its heading is sensed
    action: bool = False  # whether its last action is sensed
    kin: bool = False  # whether kinship is sensed: parent, child or sibling
    identity: int = 0  # last binary digits of its serial that are sensed, as -1 or 1

    def __post_init__(self) -> None:
        typed.check_types(self)
        require(
            isinstance(self.count, int) and self.count >= 1,
            f"Neighbours: count must be a whole number of at least 1, got {self.count!r}.",
        )
        require(
            0 <= self.identity <= 32,
            f"Neighbours: identity is a number of binary digits from 0 to 32, got {self.identity!r}.",
        )


@dataclass(frozen=True, kw_only=True)
class Empathy:
    """Affective empathy: the state of others enters an agent's own drive, by a coupling matrix w.

    sum: drive_i = d(delta_i) + sum_j w_ij d(delta_j) (Man and Yoshida 2024).
    average: drive_i = d(sum_j w_ij delta_j), where `weight` is what the others have together and
    w_ii = 1 - weight (Laurencon et al. 2021, Discussion); an agent that feels nobody has w_ii = 1.

    j are the other living agents of `species` that meet every condition given (kin: parent, child or sibling). For
    cognitive empathy see `Neighbours` and `Species.opens`.
    """

    weight: float  # w of each other (sum), or of all others together (average)
    form: Literal["sum", "average"] = "sum"  # see above
    species: tuple[str, ...] = ()  # species that are felt; its own when empty
    matrix: tuple[tuple[float, ...], ...] | None = None  # factor of the weight, by slots of its own species, square
    needs: Mapping[str, float] = field(default_factory=dict)  # how much a need of others counts; 1 where not named
    kin: bool = False  # whether only kin is felt
    within: float = math.inf  # length
    sight: bool = False  # only others that it sees
    perceived: bool = True  # whether what is felt is a part of zeta; if not, zeta hides a part of the drive
    lesion: Literal["none", "off", "sham", "shuffled"] = "none"  # off: no empathy; sham: no change; shuffled: of others
    lesion_at: float = 0.0  # time at which the lesion begins

    def __post_init__(self) -> None:
        typed.check_types(self)
        _finite("Empathy", weight=self.weight, lesion_at=self.lesion_at)
        _finite("Empathy", **self.needs)
        require(
            self.form == "sum" or 0 <= self.weight <= 1,
            f"Empathy: in the average form, weight is a share from 0 to 1, got {self.weight!r}.",
        )
        for row in self.matrix or ():
            _finite("Empathy", **{f"matrix[{j}]": w for j, w in enumerate(row)})
        require(self.within > 0, f"Empathy: within must be positive, got {self.within!r}.")


@dataclass(frozen=True, kw_only=True)
class Trait:
    """A number of a species that differs from body to body and is inherited.

    `of` says which: "NEED.set_point", "NEED.decay", "NEED.leak", "NEED.ageing", "NEED.noise", "speed" (a factor of the
    speed of all actions), "empathy.weight" (of the sum form), "learner.SETTING" (a number of the species' learner, as
    "learner.epsilon_final"), or "none" for a marker without any effect. A child has it from its parent, from either of
    two by a coin, with a normal mutation, kept within the bounds.
    """

    name: str
    of: str  # number that it replaces, see above
    bounds: tuple[float, float]  # of its value
    mutation: float = 0.0  # standard deviation of the change at a birth
    start: float | None = None  # mean of founders and newcomers; the scenario's number when None
    spread: float = 0.0  # standard deviation among founders and newcomers

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"trait {self.name!r}"
        _words(owner, self.name)
        require(len(self.bounds) == 2, f"{owner}: bounds are (lowest, highest), got {self.bounds!r}.")
        _finite(owner, mutation=self.mutation, spread=self.spread, lowest=self.bounds[0], highest=self.bounds[1])
        require(self.bounds[0] < self.bounds[1], f"{owner}: bounds must rise, got {self.bounds!r}.")
        for name in ("mutation", "spread"):
            require(getattr(self, name) >= 0, f"{owner}: {name} must not be negative, got {getattr(self, name)!r}.")


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A stage of life, from an age to the next one."""

    name: str
    age: float = 0.0  # at which it begins, time
    speed: float = 1.0  # factor of the speed of every action
    size: float = 1.0  # factor of the radius
    metabolism: float = 1.0  # factor of the decay of every need
    cannot: tuple[str, ...] = ()  # actions that are closed in this stage

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"stage {self.name!r}"
        _words(owner, self.name)
        numbers = {name: getattr(self, name) for name in ("age", "speed", "size", "metabolism")}
        _finite(owner, **numbers)
        for name, value in numbers.items():
            least = name == "size"
            require(
                value > 0 if least else value >= 0,
                f"{owner}: {name} must {'be positive' if least else 'not be negative'}, got {value!r}.",
            )


@dataclass(frozen=True, kw_only=True)
class Cue:
    """A light or a tone: a number that agents sense everywhere, if their species has it among its `cues`.

    Only interventions change it: `show NAME VALUE`, mostly in the schedule.
    """

    name: str
    start: float = 0.0  # shown at the start, from 0 to 1

    def __post_init__(self) -> None:
        typed.check_types(self)
        _words(f"cue {self.name!r}", self.name)
        require(0 <= self.start <= 1, f"cue {self.name!r}: start must lie from 0 to 1, got {self.start!r}.")


@dataclass(frozen=True, kw_only=True)
class Event:
    """An intervention that the scenario itself makes, once or at intervals.

    `do` is one line, such as "empty food", "move food 1 2", "set prey energy 1" or "show light on": see the guide on
    interventions. It is done between two ticks, after the tick that ends nearest to its time.
    """

    do: str  # the intervention
    at: float = 0.0  # time; in a session, since its trial began
    every: float | None = None  # time between two of them; None: it happens once
    until: float = math.inf  # time of the last one; in a session, since its trial began
    felt: bool = True  # whether agents experience its effect in reward and learning, as any other change

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"event {self.do!r}"
        _finite(owner, at=self.at)
        require(self.at >= 0, f"{owner}: at must not be negative, got {self.at!r}.")
        if self.every is not None:
            _finite(owner, every=self.every)
            require(self.every > 0, f"{owner}: every must be positive, got {self.every!r}; leave it out for once.")
        require(
            self.until >= self.at and (self.every is not None or self.until == math.inf),
            f"{owner}: until is the time of the last of several, not before at = {self.at!r}, got {self.until!r} with "
            f"every = {self.every!r}.",
        )


@dataclass(frozen=True, kw_only=True)
class Session:
    """A number of trials, one after the other: in each, the same events happen at the same times since it began.

    Sessions follow each other in the order of the scenario, the first from time 0 on. The beginning of a trial is an
    event too. After the last session nothing more happens.
    """

    name: str
    length: float  # of a trial, time
    trials: int = 1  # number of trials
    events: tuple[Event, ...] = ()  # in every trial
    gap: float = 0.0  # after every trial, time; its mean where it is random
    random: bool = False  # whether the gap is drawn: exponentially distributed

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"session {self.name!r}"
        _words(owner, self.name)
        _finite(owner, length=self.length, gap=self.gap)
        require(self.length > 0, f"{owner}: the length of a trial must be positive, got {self.length!r}.")
        require(self.trials >= 1, f"{owner}: trials must be a whole number of at least 1, got {self.trials!r}.")
        require(self.gap >= 0, f"{owner}: gap must not be negative, got {self.gap!r}.")
        require(self.gap > 0 or not self.random, f"{owner}: a random gap needs its mean, got {self.gap!r}.")
        for event in self.events:
            require(
                event.at < self.length,
                f"{owner}: the event {event.do!r} at {event.at!r} lies after the end of a trial of {self.length!r}.",
            )


@dataclass(frozen=True, kw_only=True)
class Species:
    """A kind of agent: its needs, its actions, its body, its senses and its learner."""

    name: str
    needs: tuple[Need, ...]
    actions: tuple[Action, ...]
    count: int = 1  # alive at the start
    capacity: int | None = None  # slots, the most that can live at once; the count when None
    birth: Birth | None = None  # offspring
    arrival: float = 0.0  # newcomers from outside, per unit of time
    hazard: Hazard | None = None  # death by chance
    remains: Remains | None = None  # what is left of a body
    carries: Mapping[str, float] = field(default_factory=dict)  # resource -> most that a body carries of it, units
    radius: float = 0.1  # of the body, length
    solid: bool = True  # whether the bodies of others are in its way
    view_angle: float = 2 * math.pi  # of the view field, radians
    view_range: float = math.inf  # of the view field, length
    senses: tuple[str | SenseSpec, ...] = ("position", "heading")  # e: names, or Gauge, Rays, Hearing, Trace
    sees: tuple[str, ...] = ()  # resources: distance, bearing and fullness of the nearest patch that is seen
    cues: tuple[str, ...] = ()  # cues of the scenario that it senses
    neighbours: tuple[Neighbours, ...] = ()  # what is sensed of others
    faults: tuple[Fault, ...] = ()  # of the senses
    opens: tuple[str, ...] = ()  # needs whose deviations others can sense
    empathy: Empathy | None = None  # what it feels of others
    crowding: Crowding | None = None  # what others nearby do to it
    exposures: tuple[Exposure, ...] = ()  # what fields do to it
    position: tuple[float, float] | None = None  # at birth; random in the arena when None
    heading: float | None = None  # at birth, radians; random when None
    collapse: Mapping[str, float] = field(default_factory=dict)  # need -> level from which only sleep is open
    commitment: Commitment = "free"  # whether a go_to may be abandoned before it arrives
    traits: tuple[Trait, ...] = ()  # numbers that children inherit from their parents
    stages: tuple[Stage, ...] = ()  # of life, the first from age 0 on; none: all ages are alike
    drive_epsilon: float = 0.001  # of the drive (epsilon + sum_i w_i |delta_i|^n) ^ (exponent / n)
    drive_exponent: float = 1.0  # 1: the paper's; 2: quadratic; n / m of Keramati and Gutkin's root m
    drive_power: float = 2.0  # n; 2: the paper's
    learner: str = "hjb"  # name of `ecology list`, or path of a .py file
    learner_settings: Mapping[str, object] = field(default_factory=dict)  # setting -> value

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"species {self.name!r}"
        if self.position is not None:
            require(len(self.position) == 2, f"{owner}: position is (x, y), got {self.position!r}.")
        _words(owner, self.name)
        require(len(self.needs) > 0, f"{owner}: at least one need.")
        require(
            isinstance(self.count, int) and self.count >= 0,
            f"{owner}: count must be a whole number of at least 0, got {self.count!r}.",
        )
        require(
            self.capacity is None or (isinstance(self.capacity, int) and self.capacity >= self.count),
            f"{owner}: capacity must be a whole number of at least the count {self.count!r}, got {self.capacity!r}.",
        )
        _finite(owner, arrival=self.arrival)
        _finite(owner, **{f"carries[{name!r}]": most for name, most in self.carries.items()})
        require(
            all(most > 0 for most in self.carries.values()),
            f"{owner}: the most that it carries must be positive, got {dict(self.carries)!r}.",
        )
        require(self.arrival >= 0, f"{owner}: arrival must not be negative, got {self.arrival!r}.")
        require(
            self.arrival == 0 or self.slots > 0,
            f"{owner}: newcomers arrive, but nobody has room; give a capacity above 0, got {self.capacity!r}.",
        )
        _finite(owner, radius=self.radius, drive_epsilon=self.drive_epsilon, drive_exponent=self.drive_exponent)
        _finite(owner, **self.collapse)
        if self.heading is not None:
            _finite(owner, heading=self.heading)
        require(self.radius > 0, f"{owner}: radius must be positive, got {self.radius!r}.")
        require(
            0 < self.view_angle <= 2 * math.pi,
            f"{owner}: view_angle must lie in (0, 2 pi] radians, got {self.view_angle!r}.",
        )
        require(self.view_range > 0, f"{owner}: view_range must be positive, got {self.view_range!r}.")
        require(self.drive_epsilon > 0, f"{owner}: drive_epsilon must be positive, got {self.drive_epsilon!r}.")
        require(self.drive_exponent > 0, f"{owner}: drive_exponent must be positive, got {self.drive_exponent!r}.")
        require(
            isinstance(self.drive_power, (int, float)) and 1 <= self.drive_power <= 16,
            f"{owner}: drive_power must be a number from 1 to 16, got {self.drive_power!r}.",
        )
        self._check_stages(owner)
        for what, names in (
            ("need", [need.name for need in self.needs]),
            ("action", [action.name for action in self.actions]),
        ):
            twice = sorted({name for name in names if names.count(name) > 1})
            require(not twice, f"{owner}: every {what} needs a name of its own, {twice} appear twice.")
        require(
            sum(action.kind == "rest" for action in self.actions) == 1,
            f"{owner}: exactly one rest action, which takes the place of a closed one.",
        )
        if self.collapse:
            require(
                any(action.kind == "sleep" for action in self.actions),
                f"{owner}: collapse leaves only sleep, but no action of kind 'sleep' is given.",
            )

    def _check_stages(self, owner: str) -> None:
        ages, names = [stage.age for stage in self.stages], [stage.name for stage in self.stages]
        require(
            not ages or (ages[0] == 0 and ages == sorted(set(ages))),
            f"{owner}: stages follow each other by age, the first from 0 on, got {ages!r}.",
        )
        require(len(set(names)) == len(names), f"{owner}: every stage needs a name of its own, got {names!r}.")
        able = [action.name for action in self.actions if action.kind != "rest"]
        for stage in self.stages:
            for name in stage.cannot:
                require_known(
                    name,
                    able,
                    f"{owner}: the stage {stage.name!r} cannot {name!r}, which is no action but rest.",
                )

    @property
    def slots(self) -> int:
        """Return how many can live at once."""
        return self.count if self.capacity is None else self.capacity

    @property
    def grows(self) -> bool:
        """Return whether anyone can be born or arrive."""
        return self.birth is not None or self.arrival > 0
