"""Scenario: what lives in a world and the checks that its words fit together."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ecology import heredity, typed, verbs
from ecology.errors import EcologyError, nearest
from ecology.ground.outline import polygon_of
from ecology.meetings import Rule
from ecology.powers import check_memory
from ecology.resources import consumers, too_far
from ecology.senses import PARAMETRIC, SENSES, layout
from ecology.spec import (
    Action,
    Arena,
    Cue,
    Drift,
    Event,
    Field,
    Gauge,
    Hearing,
    Oscillation,
    Relocation,
    Remains,
    Resource,
    Session,
    Species,
    Trace,
    require,
    require_known,
)
from ecology.state import State

SHORTEST = 1e-9  # units of time that a tick lasts at least: what is divided by it stays a number
FARTHEST = 200  # radii that a body moves in one tick at most: as many substeps as physics takes


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A world that can be built: an arena, its resources, its species and its clock."""

    name: str
    arena: Arena
    species: tuple[Species, ...]
    resources: tuple[Resource, ...] = ()
    fields: tuple[Field, ...] = ()  # over the plane
    dt: float = 1.0  # length of a tick, in units of time
    ticks: int = 10_000  # default length of a run
    day: float | None = None  # length of a day for the sense "clock", in units of time
    cues: tuple[Cue, ...] = ()  # lights and tones
    schedule: tuple[Event, ...] = ()  # events at set times; in this order at the same time
    sessions: tuple[Session, ...] = ()  # trials one after the other, from time 0 on
    rule: Rule | None = None  # interactions beyond bites, gifts and crowding: a pure function of the state
    memory: Mapping[str, object] = field(default_factory=dict)  # the rule's own state at the start: numbers or arrays
    measures: Mapping[str, Callable[[State], float]] = field(default_factory=dict)  # to record and plot, by name
    props: Callable[[State], Mapping[str, Sequence[Sequence[Sequence[float]]]]] | None = None  # to draw: lines by name
    sample_every: int | None = None  # ticks between two samples of a run that is recorded; the usual number for None
    until_extinct: bool = False  # whether a run ends when no agent is alive
    settings: Mapping[str, object] = field(default_factory=dict)  # as resolved by the scenario file
    numbering: tuple[int, int] = (0, 1)  # first serial and step between serials: islands share the numbers

    def __post_init__(self) -> None:
        typed.check_types(self)
        owner = f"scenario {self.name!r}"
        require(len(self.species) > 0, f"{owner}: at least one species.")
        require(
            isinstance(self.dt, (int, float)) and SHORTEST <= self.dt < float("inf"),
            f"{owner}: dt must be a positive number of at least {SHORTEST:g}, got {self.dt!r}.",
        )
        require(
            isinstance(self.ticks, int) and self.ticks > 0,
            f"{owner}: ticks must be a positive whole number, got {self.ticks!r}.",
        )
        require(
            self.sample_every is None or self.sample_every > 0,
            f"{owner}: sample_every must be a whole number of ticks of at least 1, got {self.sample_every!r}.",
        )
        first, step = self.numbering
        require(0 <= first < step, f"{owner}: numbering is (first, step), 0 <= first < step, got {self.numbering!r}.")
        require(self.day is None or self.day > 0, f"{owner}: day must be a positive length, got {self.day!r}.")
        for what, names in (
            ("species", [species.name for species in self.species]),
            ("resource", [resource.name for resource in self.resources]),
            ("field", [each.name for each in self.fields]),
            ("cue", [cue.name for cue in self.cues]),
            ("session", [session.name for session in self.sessions]),
        ):
            twice = sorted({name for name in names if names.count(name) > 1})
            require(not twice, f"{owner}: every {what} needs a name of its own, {twice} appear twice.")
        self._check_places()
        require(
            sum(species.count for species in self.species) > 0 or any(s.arrival for s in self.species),
            f"{owner}: at least one agent; every species has the count 0 and no arrivals.",
        )
        check_memory(owner, self.memory, self.rule is not None)
        require("" not in self.measures, f"{owner}: a measure needs a name, got '' in {sorted(self.measures)}.")
        self._check_fields()
        for species in self.species:
            self._check_needs_named(species)
            self._check_others(species)
        for species in self.species:
            self._check_species(species)
        for event in self.events:
            verbs.check_command(self, event.do)

    @property
    def events(self) -> list[Event]:
        """Return all events, those of sessions last."""
        return [*self.schedule, *(event for session in self.sessions for event in session.events)]

    def __reduce__(self) -> tuple[Callable[..., Scenario], tuple[type[Scenario], bytes]]:
        """Pickle the functions of a scenario file by value: no other process has loaded that file.

        Raises EcologyError where `rule` or `measures` hold something that cannot be pickled.
        """
        import cloudpickle  # needed by those who pickle only

        try:
            return _unpickled, (type(self), cloudpickle.dumps(self.__dict__))
        except Exception as error:  # of the many things that a function can hold, each fails in its own way
            raise EcologyError(
                f"scenario {self.name!r} cannot be pickled: its rule or measures use something that stays in its "
                f"process ({error}). Use values and functions in them only, or build the scenario in the other process."
            ) from error

    def __deepcopy__(self, memo: dict[int, Any]) -> Scenario:
        """Return a copy that shares the functions."""
        return _restored(type(self), copy.deepcopy(self.__dict__, memo))

    def measure(self, state: State) -> list[float]:
        """Return the measures of `state`, in their order; EcologyError where one is no number."""
        found = []
        for name, measure in self.measures.items():
            value = measure(state)
            try:
                found.append(float(value))
            except (TypeError, ValueError) as error:
                raise EcologyError(
                    f"scenario {self.name!r}: the measure {name!r} must return a number, got {value!r}."
                ) from error
        return found

    def _check_places(self) -> None:
        import shapely  # slow to load, needed once per scenario

        polygon = polygon_of(self.arena)
        for resource in self.resources:
            owner, place, motion = f"resource {resource.name!r}", resource.position, resource.motion
            require(
                place is None or polygon.contains(shapely.Point(place)),
                f"{owner}: its position {place!r} lies outside the arena; move it inside the walls.",
            )
            require(
                not isinstance(motion, Oscillation) or polygon.contains(shapely.LineString([place, motion.to])),
                f"{owner}: its way from {place!r} to {getattr(motion, 'to', None)!r} leaves the arena; "
                "oscillate between two points with no wall between them.",
            )
            require(
                not (place is None or isinstance(motion, Relocation))
                or not polygon.buffer(-resource.radius, join_style="mitre").is_empty,
                f"{owner}: a circle of radius {resource.radius!r} is placed at random in the arena, but finds no "
                "room in it; give a smaller radius.",
            )
        for species in self.species:
            widest = species.radius * max([stage.size for stage in species.stages], default=1.0)
            room = polygon if self.arena.torus else polygon.buffer(-widest)
            require(
                not room.is_empty,
                f"species {species.name!r}: a body of radius {widest!r} finds no room in the arena.",
            )
            if species.position is not None:
                require(
                    room.covers(shapely.Point(species.position)),
                    f"species {species.name!r}: its position {species.position!r} lies outside the arena "
                    f"or nearer than its radius {widest!r} to a wall.",
                )
        for resource in self.resources:
            if isinstance(resource.motion, Drift):  # sooner or later it comes into reach
                continue
            for species in consumers(resource, self.species)[:1]:  # the one with the smallest body
                require(
                    not too_far(resource, self.arena, species),
                    f"resource {resource.name!r}: at {resource.position!r}, with the radius {resource.radius!r}, it is "
                    "too near to a wall for every species that consumes it; the smallest body, of "
                    f"{species.name!r}, has the radius {species.radius!r}. Move the resource away from the wall, widen "
                    "its circle or make the body smaller.",
                )

    def _check_fields(self) -> None:
        """Check what is said of fields: that they and their sources are there."""
        known = [each.name for each in self.fields]
        givers = [*(r.name for r in self.resources), *(s.name for s in self.species)]
        for each in self.fields:
            for name in each.sources:
                require_known(
                    name,
                    givers,
                    f"field {each.name!r}: its sources name {name!r}, which is neither a resource nor a species.",
                )
        for species in self.species:
            mentions = [("an exposure", e.field) for e in species.exposures]
            mentions += [("a gauge", sense.field) for sense in species.senses if isinstance(sense, Gauge)]
            for word, name in mentions:
                require_known(
                    name,
                    known,
                    f"species {species.name!r}: {word} names the field {name!r}.",
                    "The scenario has no fields; give Scenario(fields=...).",
                )

    def _check_species(self, species: Species) -> None:
        owner = f"species {species.name!r}"
        resources = [resource.name for resource in self.resources]
        self._check_actions(owner, species)
        for name in species.carries:
            require_known(name, resources, f"{owner}: carries names the resource {name!r}.")
        for sense in species.senses:
            if not isinstance(sense, str):
                require(
                    type(sense) in PARAMETRIC,
                    f"{owner}: no sense has the parameters {type(sense).__name__}; add it to "
                    "ecology.senses.zeta.PARAMETRIC.",
                )
                continue
            if sense not in SENSES:
                raise EcologyError(f"{owner}: unknown sense {sense!r}. {nearest(sense, SENSES)}")
            SENSES[sense].check(owner, self.day)
        for name in species.sees:
            require_known(name, resources, f"{owner}: sees names the resource {name!r}.")
        for name in species.cues:
            cues = [cue.name for cue in self.cues]
            require_known(name, cues, f"{owner}: it senses the cue {name!r}.")
        heredity.check_traits(species)
        for need in species.needs:
            leaks = [trait.bounds[1] for trait in species.traits if trait.of == f"{need.name}.leak"]
            fastest = (
                max([need.leak, *leaks])
                + max(a.drain.get(need.name, 0.0) for a in species.actions)
                - min([0.0, *(a.control.get(need.name, 0.0) for a in species.actions)]) * need.proportional
            )
            require(
                fastest * self.dt <= 1,
                f"{owner}: {need.name!r} falls by {fastest:g} of itself per unit of time, which a tick of {self.dt!r} "
                f"cannot follow; dt must be at most {1 / max(fastest, 1e-300):g}.",
            )
        components = layout(species, self.arena, self.resources, self.species, self.fields).names
        self._check_senses(owner, species, components)
        twice = sorted({name for name in components if components.count(name) > 1})
        require(
            not twice,
            f"{owner}: the components of zeta need names of their own, {twice} appear twice; rename the need, or "
            "name every sense once.",
        )

    def _check_actions(self, owner: str, species: Species) -> None:
        resources = [resource.name for resource in self.resources]
        unlimited = [resource.name for resource in self.resources if math.isinf(resource.stock)]
        faster = max([stage.speed for stage in species.stages], default=1.0)
        faster *= max([trait.bounds[1] for trait in species.traits if trait.of == "speed"], default=1.0)
        least = species.radius * min([stage.size for stage in species.stages], default=1.0)
        for action in species.actions:
            fastest = action.speed * faster
            require(
                fastest * self.dt <= FARTHEST * least,
                f"{owner}: {action.name!r} at speed {fastest!r} moves {fastest * self.dt:g} in a tick of "
                f"{self.dt!r}, and a tick moves a body by at most {FARTHEST} radii ({FARTHEST * least:g}); "
                "lower the speed or dt, or widen the body.",
            )
            require_known(
                action.resource,
                resources,
                f"{owner}: action {action.name!r} names the resource {action.resource!r}.",
            )
            for name in (action.into, action.resource if action.kind in ("take", "drop") else None):
                require_known(name, resources, f"{owner}: action {action.name!r} names the resource {name!r}.")
            require(
                action.kind not in ("take", "drop") or action.resource in species.carries,
                f"{owner}: action {action.name!r} hauls {action.resource!r}, which the species does not carry; give it "
                "carries={resource: most}.",
            )
            require(
                action.kind != "consume" or action.resource in unlimited or self._feeds(species, action),
                f"{owner}: action {action.name!r} takes nothing out of the finite stock of {action.resource!r}, "
                "because it raises no need that can lie below its set point; give such an intake, or leave the "
                "stock unlimited.",
            )
            require_known(
                action.cue,
                [cue.name for cue in self.cues],
                f"{owner}: action {action.name!r} waits for the cue {action.cue!r}.",
            )
            require(
                not action.by_stock or all(math.isfinite(r.most) for r in self.resources if r.name == action.resource),
                f"{owner}: action {action.name!r} goes by the share of its capacity that {action.resource!r} holds, "
                "which has no end; give the resource a stock.",
            )

    def _check_needs_named(self, species: Species) -> None:
        """Check every mention of a need: that the species meant has it."""
        owner, by_name = f"species {species.name!r}", {s.name: s for s in self.species}
        mentions: list[tuple[str, Iterable[str], Species]] = [
            ("collapse", species.collapse, species),
            ("opens", species.opens, species),
        ]
        mentions += [("an exposure's control", e.control, species) for e in species.exposures]
        mentions += [
            (f"by of the adaptation of need {need.name!r}", (need.adaptation.by,), species)
            for need in species.needs
            if need.adaptation is not None and need.adaptation.by is not None
        ]
        mentions += [(f"feeds of need {need.name!r}", need.feeds, species) for need in species.needs if need.feeds]
        if species.crowding is not None:
            mentions.append(("crowding", species.crowding.control, species))
        if species.birth is not None:
            mentions += [("birth's threshold", species.birth.threshold, species)]
            mentions += [("birth's cost", species.birth.cost, species)]
        if species.remains is not None:
            mentions.append(("remains", species.remains.needs, species))
        for action in species.actions:
            mentions += [
                (f"{word} of action {action.name!r}", getattr(action, word), species)
                for word in ("control", "drain", "opens_from", "closes_at", "gain", "gives")
            ]
            if action.species in by_name:
                whom = by_name[action.species]
                mentions += [
                    (f"{word} of action {action.name!r}", getattr(action, word) or (), whom)
                    for word in ("damage", "gives")
                ]
        for word, names, meant in mentions:
            needs = [need.name for need in meant.needs]
            for name in names:
                require_known(
                    name,
                    needs,
                    f"{owner}: {word} names the need {name!r}, which the species {meant.name!r} does not have.",
                )

    def _check_others(self, species: Species) -> None:
        """Check what a species says of others, of its births and of its empathy."""
        owner, names = f"species {species.name!r}", [s.name for s in self.species]
        empathy, birth = species.empathy, species.birth
        mentions = [(f"action {a.name!r}", a.species) for a in species.actions if a.species is not None]
        mentions += [("neighbours", name) for sensed in species.neighbours for name in sensed.species]
        mentions += [("empathy", name) for name in (empathy.species if empathy is not None else ())]
        mentions += [("crowding", name) for name in (species.crowding.species if species.crowding is not None else ())]
        for word, name in mentions:
            require_known(name, names, f"{owner}: {word} names the species {name!r}.")
        if birth is not None:
            low = {need.name: need.low for need in species.needs}
            for name, cost in birth.cost.items():
                left = birth.threshold.get(name, -math.inf) - cost
                require(
                    left >= low[name],
                    f"{owner}: a birth costs {cost!r} of {name!r}, and its threshold would leave {left!r}, below the "
                    f"lower bound {low[name]!r}; raise the threshold or lower the cost.",
                )
        if species.remains is not None:
            self._check_remains(owner, species, species.remains)
        if empathy is not None:
            shapes = {len(row) for row in empathy.matrix} if empathy.matrix is not None else {species.slots}
            rows = species.slots if empathy.matrix is None else len(empathy.matrix)
            require(
                rows == species.slots and shapes == {species.slots},
                f"{owner}: the matrix of its empathy must be {species.slots} by {species.slots}, a row and a column "
                f"per slot, got {rows} rows of {sorted(shapes)}.",
            )
            others = [s for s in self.species if s.name in (empathy.species or (species.name,))]
            require(
                empathy.matrix is None or species in others,
                f"{owner}: the matrix of its empathy is of its own species, which it does not feel; add "
                f"{species.name!r} to its species {empathy.species!r}, or leave the matrix out.",
            )
            known = {need.name for s in (*others, species) for need in s.needs}
            for name in empathy.needs:
                require_known(name, known, f"{owner}: its empathy names the need {name!r}.")
            felt = sum(s.slots for s in others)
            require(
                empathy.lesion != "shuffled" or felt >= 3,
                f"{owner}: shuffled partners need at least 3 to shuffle, got {felt}; use the lesion 'off' or 'sham'.",
            )

    def _check_senses(self, owner: str, species: Species, components: tuple[str, ...]) -> None:
        """Check what is said of the components of zeta, and that what is listened to is said."""
        channels = sorted({name for s in self.species for action in s.actions for name in action.emits})
        mentions = [("a trace", sense.of) for sense in species.senses if isinstance(sense, Trace)]
        mentions += [("a fault", fault.of) for fault in species.faults]
        for word, name in mentions:
            require_known(
                name,
                components,
                f"{owner}: {word} names {name!r}, which is none of the components of its zeta.",
            )
        for sense in species.senses:
            if isinstance(sense, Hearing):
                require_known(
                    sense.channel,
                    channels,
                    f"{owner}: it listens to the channel {sense.channel!r}, on which no action sends.",
                    "Give an action emits={channel: content}.",
                )

    def _check_remains(self, owner: str, species: Species, remains: Remains) -> None:
        known = {r.name: r for r in self.resources}
        require_known(remains.resource, known, f"{owner}: its remains name the resource {remains.resource!r}.")
        require(
            known[remains.resource].gone_below is not None,
            f"{owner}: its remains are patches of {remains.resource!r}, which must come and go; give that resource "
            "gone_below.",
        )
        for need in species.needs:
            require(
                math.isfinite(need.low) or not remains.needs.get(need.name),
                f"{owner}: its remains count what it stores of {need.name!r} from the lower bound on, which is "
                f"{need.low!r}; give the need a finite bound.",
            )

    @staticmethod
    def _feeds(species: Species, action: Action) -> bool:
        return any(action.control.get(need.name, 0.0) > 0 and need.low < need.set_point for need in species.needs)


def puts(scenario: Scenario) -> bool:
    """Return whether the schedule of a scenario lets agents live that were not born."""
    return any(verbs.split(event.do)[0] == "put" for event in scenario.events)


def _restored(cls: type[Scenario], values: dict[str, Any]) -> Scenario:
    """Return the scenario of these values, which have been checked before."""
    scenario = object.__new__(cls)
    scenario.__dict__.update(values)
    return scenario


def _unpickled(cls: type[Scenario], pickled: bytes) -> Scenario:
    import cloudpickle

    return _restored(cls, cloudpickle.loads(pickled))
