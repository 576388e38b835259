"""Sampler of a world for a viewer: it finds the agents in focus and collects the events and every panel's sample."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ecology.env import Ecology
from ecology.errors import EcologyError
from ecology.ground import plane_of
from ecology.model import Group
from ecology.observers import census, colours, maps, shapes
from ecology.observers.base import Mind
from ecology.observers.census import Census, Focus, Happening
from ecology.observers.layout import panels
from ecology.observers.panels.base import Panel, Watch
from ecology.observers.scene import DEAD, EVERYBODY, FEW, Scene
from ecology.state import State
from ecology.world import Tick

FOCUS_TICKS = 500  # after which the hungriest is looked for again
CLOSE = 10  # samples between two plans, and between two maps of J at the present state
SECONDS = 0.2  # of the clock between them, while a viewer is attached
SPARSE = 20  # samples between two age structures, and between two coupling matrices, at most
SOON = 5  # samples of a run after which these are one sample further apart


class Sampling(NamedTuple):
    """How often and how closely the world of a run is sampled."""

    run: str  # name
    every: int  # ticks
    maps_every: int  # ticks
    detail: str | None = None  # "full" or "lean", by the number of agents if None


class Sampler:
    """Follows a world from tick to tick, and copies what a sample shows."""

    def __init__(
        self,
        env: Ecology,
        minds: Mapping[str, Mind],
        kinds: Sequence[type[Panel]] | None = None,
        *,
        asked: Sequence[str] = (),
        before: tuple[Sequence[int], Sequence[int]] | None = None,
        how: Sampling,
        watched: Callable[[], bool] = lambda: False,
    ) -> None:
        """Follow `env` for the panels `kinds`, all of the layout for None.

        asked: agents to bring into focus. before: who was born and died by now, by species. watched: whether a viewer
        is attached, which is shown plans as they are made.
        """
        self._env, self._minds, self._every = env, minds, how.every
        self.focus, self._census = Focus.of(env, asked), Census(env, before)
        self.focus.look(env.state_view)
        self.scene = self._make_scene(how, mapped=kinds is None)
        self.panels = panels(self.scene, kinds)
        self._followers = [panel for panel in self.panels if type(panel).follow is not Panel.follow]
        self._happened: list[Happening] = []
        self._changed: set[str] = set()  # species whose focus is another since the last sample
        self._top = colours.Top(env.scenario)
        self._sampled, self._ground = 0, env.world.model.ground
        self.closest = -1  # tick at which it was last looked at closely
        self._is_watched, self._close = watched, -math.inf  # by the clock, when it was last looked at closely
        self._did = (-1, -1)  # slot and action of the one that is shown first
        self.tick: Tick | None = None  # the last one
        self.deeds: list[tuple[int, str]] = []  # interventions since the last sample
        self._follow()

    def _make_scene(self, how: Sampling, *, mapped: bool) -> Scene:
        """Return what is drawn of a world and its minds; maps of J only where it is `mapped`."""
        env, minds, groups, scenario = self._env, self._minds, self._env.groups, self._env.scenario
        few, grid = env.size <= FEW, maps.cover(scenario.arena)
        return Scene(
            scenario=census.without_functions(scenario),
            groups={name: group for name, group in groups.items() if group.size},
            names={name: self.focus.name(name) for name in groups},
            first=self.focus.first,
            reported={name: tuple(minds[name].report()) for name in groups},
            mapped={name: mapped and self._has_maps(group, grid) for name, group in groups.items()},
            decides={name: bool(groups[name].size) and minds[name].decides for name in groups},
            coupled=tuple(name for name in groups if env.coupling(name) is not None),
            measures=census.plotted_names(scenario),
            grows=env.open_population,
            marks=tuple(shapes.mark_kinds(scenario)),
            grid=grid,
            run=how.run,
            every=how.every,
            maps_every=how.maps_every,
            full=(how.detail or ("full" if few else "lean")) == "full",
            few=few,
            has_props=scenario.props is not None,
        )

    def _has_maps(self, group: Group, grid: maps.Grid) -> bool:
        if not group.size:
            return False
        row = max(self.focus.slots[group.name] - group.slots.start, 0)
        species = self._env.scenario.species[group.index]
        return maps.deviation_maps(species, group, self._minds[group.name], row, grid) is not None

    def watch(self, state: State, tick: Tick, *, sampled: bool, turned: bool = False) -> Watch:
        """Look at a tick; return what a sample is taken from."""
        self.tick = tick
        self.refocus(state, anew=turned or state.tick % FOCUS_TICKS == 0)
        slots = np.array(list(self.focus.slots.values()), np.int64)
        self._happened += self._census.watch(state, tick, None if self.scene.few else slots[slots >= 0])
        look = self.look(state, sampled=sampled, turned=turned)
        self.follow(look)
        return look

    def follow(self, look: Watch) -> None:
        """Pass a tick to the panels that follow every tick."""
        if self.tick is not None:
            for panel in self._followers:
                panel.follow(look)

    def refocus(self, state: State, *, anew: bool) -> None:
        """Find the agents in focus."""
        changed = self.focus.look(state, anew=anew)
        self._changed.update(changed)
        if changed:
            self._follow()

    def turn(self, who: str) -> str | None:
        """Bring `who` into focus; return the reason if that is impossible, else None."""
        try:
            self.focus.turn(self._env, who)
        except EcologyError as error:
            return str(error)
        return None

    def _follow(self) -> None:
        """Let the minds keep the decisions of those in focus, and of everybody where there are few."""
        for name, group in self.scene.groups.items():
            if self.scene.decides[name]:
                slot = self.focus.slots[name]
                focus = [slot - group.slots.start] if slot >= 0 else []
                self._minds[name].follow(range(group.size) if self._env.size <= EVERYBODY else focus)

    @property
    def shown_first(self) -> str:
        """Return the species whose life is shown first."""
        lively = [name for name in self.scene.groups if not self.scene.idle(name)]
        return self.focus.first or next(iter([*lively, *self.scene.groups]), "")

    def has_decided(self, state: State) -> bool:
        """Return whether the agent that is shown first made a decision in this tick, or does something else now."""
        name = self.shown_first
        slot = self.focus.slots.get(name, -1)
        before, self._did = self._did, (slot, int(state.action[slot]))
        if slot < 0:
            return False
        if self.scene.decides[name]:
            made = self._minds[name].decision(slot - self.scene.groups[name].slots.start)
            return made is not None and made.age == 1
        return self._did != before

    def look(self, state: State, *, sampled: bool = True, turned: bool = False, waits: bool = False) -> Watch:
        """Return what panels take their samples from; where the run waits, there is time to look closely."""
        # by the tick, so that a run that is resumed has the same; a young run's age structure soon changes
        samples = state.tick // self._every
        sparse = self._sampled == 0 or (
            state.tick % self._every == 0 and samples % min(SPARSE, 1 + samples // SOON) == 0
        )
        closely = sampled and (state.tick % (CLOSE * self._every) == 0 or turned or waits)
        if sampled and time.monotonic() - self._close > SECONDS and self._is_watched():
            closely, self._close = True, time.monotonic()
        self.closest = state.tick if closely else self.closest
        return Watch(
            env=self._env,
            minds=self._minds,
            scene=self.scene,
            focus=self.focus,
            census=self._census,
            state=state,
            tick=self.tick,
            sampled=sampled,
            sparse=sparse,
            closely=closely,
            turned=turned,
            changed=frozenset(self._changed),
            happened=self._happened,
            deeds=self.deeds,
        )

    def sample(self, look: Watch) -> dict[str, Any]:
        """Copy what a sample shows; before the first tick, the world as it stands."""
        state, tick, alive = look.state, look.tick, look.state.alive
        acted = alive if tick is not None else alive & (state.tick > 0)
        sample: dict[str, Any] = {
            "tick": state.tick,
            "place": np.where(alive[:, None], state.position, np.nan).astype(np.float32),
            "heading": state.heading.astype(np.float32),
            "internal": np.where(alive[:, None], state.internal, np.nan).astype(np.float32),
            "drive": np.where(alive, state.drive, np.nan).astype(np.float32),
            "reward": np.where(alive, 0.0 if tick is None else tick.reward, np.nan).astype(np.float32),
            "serial": state.serial.astype(np.int32),
            "action": np.where(acted, state.action, DEAD).astype(np.uint8),
            "focus": {name: self._in_focus(name, state) for name in self.scene.groups},
        }
        sample["top"] = self._top.follow(sample["drive"])
        if state.set_point is not None:
            sample["set_point"] = np.where(alive[:, None], state.set_point, np.nan).astype(np.float32)
        sample["panels"] = {panel.key: panel.sample(look) for panel in self.panels}
        self._sampled += 1
        self.deeds, self._happened, self._changed = [], [], set()
        return sample

    def _in_focus(self, name: str, state: State) -> dict[str, Any]:
        """Return the agent of a species that is in focus, and what it sees."""
        slot = self.focus.slots[name]
        species = self.scene.scenario.species[self.scene.groups[name].index]
        shown: dict[str, Any] = {"slot": slot, "name": self.focus.name(name), "anew": name in self._changed}
        if slot < 0:
            return shown
        seen = np.concatenate([state.resource_position[state.seen[slot]], state.position[self._env.find_visible(slot)]])
        gap = plane_of(self.scene.scenario.arena).gap(state.position[slot], seen)
        shown["sight"] = state.position[slot] + gap
        shown["field"] = shapes.view_field(species, state.position[slot], float(state.heading[slot]), self._ground)
        shown["own"] = float(state.own_drive[slot])
        return shown
