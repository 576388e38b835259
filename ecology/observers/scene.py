"""What is drawn of a run, and how it looks: plain data, without the viewer."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ecology.empathy import felt_species
from ecology.model import Group
from ecology.observers import colours, maps, places, shapes
from ecology.scenario import Scenario
from ecology.spec import Species

EVERYBODY = 12  # agents up to which everybody's decisions are recorded
FEW = 100  # agents up to which every one has a trail, all its numbers and all its meals told; above, the focus alone
BACKGROUND, FLOOR, WALL, INK = (16, 18, 22), (42, 46, 54), (225, 225, 225), (235, 235, 235)
FAINT = (120, 124, 132)
MARKED = {"born": INK, "died": INK, "bit": colours.BITING, "gave": colours.GIVING}
DRIVE_SCALE, MAP_SCALE = "plasma", "viridis"
STEPS = 64  # of the colour scale of the drive
DEAD = 255  # action of a slot in which nobody lives


@dataclass
class Scene:
    """What is drawn, where, and what it is called. Plain data, so that it can be sent."""

    scenario: Scenario
    groups: Mapping[str, Group]  # with at least one slot
    names: Mapping[str, str]  # species -> name of its focus at the start
    first: str | None  # species that is shown first
    reported: Mapping[str, tuple[str, ...]]  # species -> numbers that its mind reports
    mapped: Mapping[str, bool]  # species -> whether there are deviation maps
    decides: Mapping[str, bool]  # species -> whether its mind shows its decisions
    coupled: tuple[str, ...]  # species with empathy
    measures: tuple[str, ...]  # of the scenario, and its cues
    grows: bool  # whether anyone can be born
    marks: tuple[str, ...]  # kinds of events that can come up
    grid: maps.Grid
    run: str
    every: int
    maps_every: int
    full: bool  # whether every agent's drive and reward are recorded
    few: bool  # whether every agent has a trail
    lived_until: int | None = None  # last recorded tick at which anybody lived, of a recording where nobody does
    span: tuple[int, int] | None = None  # first and last tick of a recording whose run is over
    has_props: bool = False  # whether the scenario names what to draw besides
    fork: str = ""  # name of the other future that is shown beside it
    forked_at: int = 0  # tick from which on it is shown
    chosen: Mapping[str, str] = field(default_factory=dict)  # species -> who is shown after the fact instead
    died: Mapping[str, int] = field(default_factory=dict)  # species -> last recorded tick of that one, where it died

    @property
    def application(self) -> str:
        """Return the name under which the viewer keeps the layout: one per scenario."""
        return "ecology-" + re.sub(r"[^A-Za-z0-9_-]", "_", self.scenario.name)

    @property
    def crowd(self) -> bool:
        """Return whether there is more to be shown than one agent: a population, or cues."""
        return sum(group.size for group in self.groups.values()) > 1 or bool(self.scenario.cues)

    @property
    def alone(self) -> bool:
        """Return whether the world holds a single agent: panels about a population would repeat its own."""
        return sum(group.size for group in self.groups.values()) == 1

    @property
    def mixed(self) -> bool:
        """Return whether there are several species: bodies have their colours, and headings show the drive."""
        return len(self.groups) > 1

    def idle(self, name: str) -> bool:
        """Return whether a species decides nothing, has needs that nothing changes, and is felt by nobody."""
        species = self.scenario.species[self.groups[name].index]
        met = [action for each in self.scenario.species for action in each.actions if action.species == name]
        moved = any(
            need.decay or need.leak or need.noise or need.adaptation is not None or need.feeds for need in species.needs
        )
        moved |= any(action.control or action.drain or action.gain or action.gives for action in species.actions)
        moved |= any(action.gives or action.damage for action in met) or species.empathy is not None
        felt = any(name in felt_species(each) for each in self.scenario.species if each.empathy is not None)
        return not (self.decides[name] or moved or felt)

    def at(self, name: str) -> str:
        """Return where the life of a species' focus is drawn."""
        return f"chosen/{self.chosen[name]}" if name in self.chosen else f"focus/{name}"

    def colour(self, name: str) -> colours.Colour:
        """Return the colour of a species."""
        return colours.species_colour(self.groups[name].index, alone=not self.mixed)

    @property
    def size(self) -> float:
        """Return the longer side of the arena."""
        return shapes.size(self.scenario)

    @property
    def stocked(self) -> list[str]:
        """Return the names of the resources that have a finite stock."""
        return [r.name for r in self.scenario.resources if math.isfinite(r.stock)]

    def radius(self, species: Species) -> float:
        """Return the radius with which a body is drawn."""
        return shapes.radius(self.scenario, species)

    def _legend(self) -> list[tuple[str, colours.Colour]]:
        """Return what the legend says besides the drive: words with their colour."""
        found = [(name, self.colour(name)) for name in self.groups] if self.mixed else []
        shades = colours.resource_colours(self.scenario)
        for r, shade in zip(self.scenario.resources, shades, strict=True):
            if shapes.covers(self.scenario, r):
                found.append((f"{r.name}: everywhere", shade))
            elif r.count > 1:
                found.append((r.name, shade))
        found += [(each.name, places.field_colour(i)) for i, each in enumerate(self.scenario.fields)]
        found += [(shapes.KINDS[kind], MARKED[kind]) for kind in self.marks]
        return found

    @property
    def legend_unit(self) -> float:
        """Return the length by which the legend is laid out: beside a fork, the arena is smaller than its words."""
        return self.size * (1.55 if self.fork else 1.0)

    def legend_rows(self) -> list[list[tuple[float, str, colours.Colour]]]:
        """Return the rows of the legend: words with their place along x, from the arena's left side."""
        width = np.ptp(np.array(self.scenario.arena.vertices, float)[:, 0])
        rows: list[list[tuple[float, str, colours.Colour]]] = [[]]
        at = 0.0
        for word, shade in self._legend():
            wide = self.legend_unit * (0.07 + 0.02 * len(word))
            if at + wide > width and rows[-1]:
                rows.append([])
                at = 0.0
            rows[-1].append((at, word, shade))
            at += wide
        return rows if rows[0] else []

    def who(self, name: str) -> str:
        """Return what the agent in focus is called in a title: its name, or a word where it can change."""
        if name in self.chosen:
            dead = f" (dead after tick {self.died[name]})" if name in self.died else ""
            return self.chosen[name] + dead
        return f"{name} in focus" if self.groups[name].size > 1 or self.grows else self.names[name]


def losses(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the reported names that are losses, and the others."""
    lost = [word for word in words if word.startswith("loss")]
    return lost, [word for word in words if word not in lost]
