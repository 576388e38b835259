"""Model: everything about a world that never changes, compiled once from its scenario."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ecology import empathy, physiology, resources, senses
from ecology.actions import ActionTable, compile_actions, compile_cued
from ecology.appearing import Appearing, compile_appearing
from ecology.doors import Doors
from ecology.empathy import Coupling
from ecology.errors import EcologyError, nearest
from ecology.fields import Fields, compile_fields
from ecology.ground import Ground, Plane, ground_of
from ecology.hauling import Hauling, compile_hauling
from ecology.heredity import Heredity, LearnerTrait, compile_heredity, learner_traits
from ecology.life_stages import Stages, compile_stages
from ecology.physiology import Body
from ecology.powers import Slot, compile_memory
from ecology.resources import ResourceTable
from ecology.scenario import Scenario, puts
from ecology.senses import Layout, ObservationSpec
from ecology.setpoints import Moving, compile_moving
from ecology.sight import Vision, compile_vision
from ecology.spec import Hearing, Species
from ecology.state import Bools, Floats, Ints, State


@dataclass(frozen=True)
class Group:
    """The slots of one species and what its agents know of themselves."""

    name: str
    index: int  # of the species in the scenario
    slots: slice
    layout: Layout  # of zeta
    actions: tuple[str, ...]
    kinds: tuple[str, ...]  # of the actions
    speeds: Floats  # (A,)
    turns: Floats  # (A,) radians per unit of time
    durations: Floats  # (A,) minimal durations, units of time
    dt: float
    inherited: tuple[LearnerTrait, ...] = ()  # settings of the learner that are traits

    @property
    def size(self) -> int:
        """Return the number of slots."""
        return self.slots.stop - self.slots.start


@dataclass(frozen=True, eq=False)
class Model:
    """The constants of a world of N slots, V needs (the most of any species) and R patches."""

    scenario: Scenario
    dt: float
    size: int  # N
    plane: Plane
    ground: Ground
    groups: Mapping[str, Group]  # by species
    tables: tuple[ActionTable, ...]  # by species
    acting: tuple[tuple[Group, ActionTable], ...]  # every group with its actions
    species: tuple[tuple[Group, Species], ...]  # every group with its species
    observation_specs: tuple[ObservationSpec, ...]  # by species
    needs: Mapping[str, tuple[str, ...]]  # names by species, in the order of the columns
    patches: Mapping[str, slice]  # rows of the patches, by resource
    cues: Mapping[str, int]  # places of the cues, by name
    cued: tuple[Ints | None, ...] | None  # by species, the cue that each action waits for; None: no action waits
    yields: bool  # whether any meal depends on chance or on how full the patch is
    body: Body
    vision: Vision
    resources: ResourceTable
    couplings: tuple[Coupling, ...]  # of the species that have empathy
    radius: Floats  # (N,)
    solid: Bools  # (N,)
    species_of: Ints  # (N,)
    has_need: Bools  # (N, V) False in the columns that only pad
    choices: Ints  # (N,) number of actions
    looks: Bools  # (N,) whether empathy depends on whom the agent sees
    nobody: Ints  # (N,) -1; copied before it is written
    near: float  # distance within which anyone senses, meets or crowds another; 0: nobody does
    no_targets: Mapping[str, Ints]  # by species (n, A) -1; never written
    meets: bool  # whether bodies bite, give or crowd
    mortal: bool  # whether anyone can die
    grows: bool  # whether anyone can be born
    appearing: Appearing | None  # patches that spoil, come and go
    memory: Mapping[str, Slot]  # where the rule finds its own state, by name
    hauling: Hauling | None
    fields: Fields | None
    doors: Doors | None
    moving: Moving | None  # set points that move by themselves
    stages: Stages | None  # of life
    heredity: Heredity | None  # what is inherited
    mates: bool  # whether any birth takes two parents

    def __deepcopy__(self, memo: dict[int, Any]) -> Model:
        """Return this model: it never changes, so copies of a world share it."""
        return self

    def group(self, species: str) -> Group:
        """Return the group of a species; EcologyError where there is none."""
        if species not in self.groups:
            raise EcologyError(f"there is no species {species!r}. {nearest(str(species), self.groups)}")
        return self.groups[species]

    def coupling(self, species: str) -> Coupling | None:
        """Return the empathy of a species, None where it has none."""
        return next((each for each in self.couplings if each.species == species), None)

    def name_of(self, slot: int, serial: Ints) -> str:
        """Return the name of the agent in `slot`, given the `serial` (N,) of every slot."""
        return f"{self.scenario.species[self.species_of[slot]].name}_{int(serial[slot])}"

    def living(self, state: State) -> dict[str, int]:
        """Return the slots of the living agents by name, in the order of the slots."""
        return {self.name_of(slot, state.serial): slot for slot in np.flatnonzero(state.alive).tolist()}

    def slot_of(self, name: str, state: State) -> int:
        """Return the slot of the living agent `name`; EcologyError where no such agent lives."""
        living = self.living(state)
        if name not in living:
            raise EcologyError(f"no agent {name!r} lives at tick {state.tick}. {nearest(name, living)}")
        return living[name]

    def patch_names(self) -> list[str]:
        """Return the names of the R patches: the resource's, with a number from 0 on where it has several."""
        return [
            f"{r.name}.{patch}" if r.count > 1 else r.name for r in self.scenario.resources for patch in range(r.count)
        ]

    def founders(self) -> list[tuple[Species, range]]:
        """Return every species and the serials of its agents at the start."""
        found = []
        start, step = self.scenario.numbering
        for s in self.scenario.species:
            found.append((s, range(start, start + step * s.count, step)))
            start += step * s.count
        return found

    def serials(self, state: State, count: int) -> Ints:
        """Return the serials of the next `count` agents, (count,).

        They are those of this world alone, whatever its islands (`Scenario.numbering`), and greater than any that lived
        here: agents that arrived from elsewhere count.
        """
        first, step = self.scenario.numbering
        return state.next_serial + (first - state.next_serial) % step + step * np.arange(count)

    def like(self, other: Model) -> str:
        """Return in words where another model needs a state or senses of another shape, "" where it needs none."""
        for name, group in self.groups.items():
            theirs = other.groups[name]
            if (group.slots, group.actions) != (theirs.slots, theirs.actions):
                return f"the slots of {name}"
            mine, changed = group.layout, theirs.layout
            if any(
                not np.array_equal(getattr(mine, part), getattr(changed, part)) for part in ("low", "high", "scale")
            ):
                return f"the range of what {name} perceives"
            if (mine.epsilon, mine.exponent) != (changed.epsilon, changed.exponent):
                return f"the drive that {name} know"
        return "" if self.patches == other.patches else "the patches"

    def with_finite_stocks(self) -> Model:
        """Return this model with stocks that can run out, also where the scenario has unlimited ones only."""
        return replace(self, resources=replace(self.resources, constant=False, finite=True))


def compile_model(scenario: Scenario) -> Model:
    """Return the constants of the world of `scenario`."""
    species, arena = scenario.species, scenario.arena
    ground, dt = ground_of(arena), float(scenario.dt)
    width = max(len(s.needs) for s in species)
    counts = [s.slots for s in species]
    blocks = _blocks(counts)
    tables = tuple(compile_actions(s, scenario.resources, species) for s in species)
    observation_specs = tuple(
        senses.compile_observation_spec(s, rows, arena, scenario.resources, species, scenario.fields)
        for s, rows in zip(species, blocks, strict=True)
    )
    body = physiology.compile_bodies(species, width)
    groups = {
        s.name: Group(
            name=s.name,
            index=i,
            slots=blocks[i],
            layout=observation_specs[i].layout,
            actions=tables[i].names,
            kinds=tables[i].kinds,
            speeds=tables[i].speed,
            turns=tables[i].turn,
            durations=tables[i].duration,
            dt=dt,
            inherited=learner_traits(s),
        )
        for i, s in enumerate(species)
    }
    kinds = scenario.resources
    patches = dict(zip([r.name for r in kinds], _blocks([r.count for r in kinds]), strict=True))
    return Model(
        scenario=scenario,
        dt=dt,
        size=sum(counts),
        plane=ground.plane,
        ground=ground,
        groups=groups,
        tables=tables,
        acting=tuple(zip(groups.values(), tables, strict=True)),
        species=tuple(zip(groups.values(), species, strict=True)),
        observation_specs=observation_specs,
        needs={s.name: tuple(need.name for need in s.needs) for s in species},
        patches=patches,
        cues=(cues := {cue.name: i for i, cue in enumerate(scenario.cues)}),
        cued=compile_cued(species, cues),
        yields=any(a.by_stock or (a.kind == "consume" and a.chance < 1) for s in species for a in s.actions),
        body=body,
        vision=compile_vision(species, ground),
        resources=resources.compile_resources(kinds, arena, species),
        couplings=tuple(empathy.compile_coupling(species, blocks, width)),
        radius=np.repeat([float(s.radius) for s in species], counts),
        solid=np.repeat([s.solid for s in species], counts),
        species_of=np.repeat(np.arange(len(species)), counts),
        has_need=np.repeat([np.arange(width) < len(s.needs) for s in species], counts, axis=0),
        choices=np.repeat([len(s.actions) for s in species], counts),
        looks=np.repeat([s.empathy is not None and s.empathy.sight for s in species], counts),
        nobody=np.full(sum(counts), -1),
        no_targets={s.name: np.full((s.slots, len(s.actions)), -1) for s in species},
        near=_nearness(scenario, observation_specs),
        meets=any(s.crowding is not None or any(a.reach for a in s.actions) for s in species),
        mortal=body.deadly
        or scenario.rule is not None
        or any(s.hazard is not None or any(a.kind == "bite" for a in s.actions) for s in species),
        appearing=compile_appearing(scenario, patches, {g.name: g.slots for g in groups.values()}, width),
        memory=compile_memory(scenario.memory),
        hauling=compile_hauling(species, kinds, {g.name: g.slots for g in groups.values()}, patches),
        fields=compile_fields(scenario.fields, species, ground, patches, {g.name: g.slots for g in groups.values()}),
        doors=Doors(arena.doors) if arena.doors else None,
        grows=any(s.grows for s in species) or puts(scenario),
        moving=compile_moving(species, width),
        stages=compile_stages(species),
        heredity=compile_heredity(species, blocks),
        mates=any(s.birth is not None and s.birth.parents == 2 for s in species),
    )


def _blocks(counts: list[int]) -> list[slice]:
    """Return slices of `counts` rows each, one after the other."""
    ends = np.cumsum(counts).tolist()
    return [slice(end - count, end) for end, count in zip(ends, counts, strict=True)]


def _nearness(scenario: Scenario, observation_specs: tuple[ObservationSpec, ...]) -> float:
    """Return the distance within which agents sense, meet or crowd each other; 0: none do."""
    found = [0.0]
    for s, spec in zip(scenario.species, observation_specs, strict=True):
        if s.neighbours or (s.empathy is not None and s.empathy.sight):
            found.append(spec.far)
        found += [action.reach for action in s.actions]
        found += [sense.range for sense in s.senses if isinstance(sense, Hearing)]
        if s.crowding is not None:
            found.append(s.crowding.within)
    return max(found)
