"""Scenario: what lives in a world and the checks that its words fit together."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from ecology.errors import EcologyError, nearest
from ecology.senses import SENSES, layout
from ecology.spec import Action, Arena, Oscillation, Relocation, Resource, Species, require

FARTHEST = 200  # radii that a body moves in one tick at most: as many substeps as physics takes


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """A world that can be built: an arena, its resources, its species and its clock."""

    name: str
    arena: Arena
    species: tuple[Species, ...]
    resources: tuple[Resource, ...] = ()
    dt: float = 1.0  # length of a tick, in units of time
    ticks: int = 10_000  # default length of a run
    day: float | None = None  # length of a day for the sense "clock", in units of time
    settings: Mapping[str, object] = field(default_factory=dict)  # as resolved by the scenario file

    def __post_init__(self) -> None:
        owner = f"scenario {self.name!r}"
        require(len(self.species) > 0, f"{owner}: at least one species.")
        require(
            isinstance(self.dt, (int, float)) and 0 < self.dt < float("inf"),
            f"{owner}: dt must be a positive number, got {self.dt!r}.",
        )
        require(
            isinstance(self.ticks, int) and self.ticks > 0,
            f"{owner}: ticks must be a positive whole number, got {self.ticks!r}.",
        )
        require(self.day is None or self.day > 0, f"{owner}: day must be a positive length, got {self.day!r}.")
        for what, names in (
            ("species", [species.name for species in self.species]),
            ("resource", [resource.name for resource in self.resources]),
        ):
            twice = sorted({name for name in names if names.count(name) > 1})
            require(not twice, f"{owner}: every {what} needs a name of its own, {twice} appear twice.")
        self._check_places()
        require(
            sum(species.count for species in self.species) > 0,
            f"{owner}: at least one agent; every species has the count 0.",
        )
        for species in self.species:
            self._check_species(species)

    def _check_places(self) -> None:
        import shapely  # slow to load, needed once per scenario

        polygon = shapely.Polygon(self.arena.vertices)
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
            room = polygon.buffer(-species.radius)
            require(
                not room.is_empty,
                f"species {species.name!r}: a body of radius {species.radius!r} finds no room in the arena.",
            )
            if species.position is not None:
                require(
                    room.covers(shapely.Point(species.position)),
                    f"species {species.name!r}: its position {species.position!r} lies outside the arena "
                    f"or nearer than its radius {species.radius!r} to a wall.",
                )

    def _check_species(self, species: Species) -> None:
        owner = f"species {species.name!r}"
        needs = [need.name for need in species.needs]
        resources = [resource.name for resource in self.resources]
        unlimited = [resource.name for resource in self.resources if math.isinf(resource.stock)]
        for action in species.actions:
            require(
                action.speed * self.dt <= FARTHEST * species.radius,
                f"{owner}: {action.name!r} at speed {action.speed!r} moves {action.speed * self.dt:g} in a tick of "
                f"{self.dt!r}, and a tick moves a body by at most {FARTHEST} radii ({FARTHEST * species.radius:g}); "
                "lower the speed or dt, or widen the body.",
            )
            for word in ("control", "opens_from", "closes_at"):
                for name in getattr(action, word):
                    require(
                        name in needs,
                        f"{owner}: action {action.name!r} names the need {name!r} in {word}, which the "
                        f"species does not have. {nearest(name, needs)}",
                    )
            require(
                action.resource is None or action.resource in resources,
                f"{owner}: action {action.name!r} names the resource {action.resource!r}. "
                f"{nearest(str(action.resource), resources)}",
            )
            require(
                action.kind != "consume" or action.resource in unlimited or self._feeds(species, action),
                f"{owner}: action {action.name!r} takes nothing out of the finite stock of {action.resource!r}, "
                "because it raises no need that can lie below its set point; give such an intake, or leave the "
                "stock unlimited.",
            )
        for name in species.collapse:
            require(name in needs, f"{owner}: collapse names the need {name!r}. {nearest(name, needs)}")
        for sense in species.senses:
            if sense not in SENSES:
                raise EcologyError(f"{owner}: unknown sense {sense!r}. {nearest(sense, SENSES)}")
        components = layout(species, self.arena).names
        twice = sorted({name for name in components if components.count(name) > 1})
        require(
            not twice,
            f"{owner}: the components of zeta need names of their own, {twice} appear twice; rename the need, or "
            "name every sense once.",
        )
        require(
            "clock" not in species.senses or self.day is not None,
            f"{owner}: the sense 'clock' needs the scenario's day, the length of its period.",
        )

    @staticmethod
    def _feeds(species: Species, action: Action) -> bool:
        return any(action.control.get(need.name, 0.0) > 0 and need.low < need.set_point for need in species.needs)
