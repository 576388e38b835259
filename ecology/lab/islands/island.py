"""One island: a run that advances from stop to stop; agents leave and arrive at the stops."""

from __future__ import annotations

import contextlib
import shutil
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ecology import EcologyError, Pool
from ecology.agents import checkpoint
from ecology.archipelago import ALIVE
from ecology.lab.runs import fork as forks
from ecology.lab.runs.folder import KEPT, lock
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import Plan, read_config
from ecology.lab.runs.run_config import resolve as resolve_run
from ecology.lab.runs.twins import recorders

PATIENCE = 60.0  # seconds for which an island waits for the host that held it to end
SHOWN = 2_000  # agents of an island whose places are told, at most
Arrays = Mapping[str, np.ndarray]


@dataclass
class Count:
    """The living agents of one species on an island, in the order of their slots."""

    slots: np.ndarray  # (k,)
    serial: np.ndarray  # (k,)
    drive: np.ndarray  # (k,)
    age: np.ndarray  # (k,)
    free: int  # slots that nobody lives in
    founders: int  # agents with which the species started
    fitness: np.ndarray | None = None  # (k,) where it breeds from a pool
    trait: np.ndarray | None = None  # (k, T)


@dataclass
class Census:
    """The state of an island at a stop: the data by which agents are chosen to leave, and the data of the overview."""

    tick: int
    alive: dict[str, int]  # by species
    drive: dict[str, float]  # mean of the living, by species
    moving: dict[str, Count]  # species that migrate or breed from a pool
    seconds: float  # of CPU time since the last stop
    place: dict[str, np.ndarray] = field(default_factory=dict)  # (k, 3) x, y, drive of the living, where it is shown


@dataclass
class Travellers:
    """Agents on their way to another island: their bodies, and what they have learned."""

    species: str
    bodies: Arrays
    minds: Arrays

    def take(self, rows: Sequence[int]) -> Travellers:
        """Return some of them."""
        return Travellers(
            self.species,
            {name: array[list(rows)] for name, array in self.bodies.items()},
            {name: array[list(rows)] for name, array in self.minds.items()},
        )


def join(groups: Sequence[Travellers]) -> Travellers:
    """Join groups of travellers of one species; memories are as wide as the fullest one."""
    minds = {}
    for name in groups[0].minds:
        parts = [group.minds[name] for group in groups]
        wide = np.max([part.shape[1:] for part in parts], axis=0)
        padded = [
            np.pad(part, [(0, 0), *((0, int(most) - here) for most, here in zip(wide, part.shape[1:], strict=True))])
            if tuple(wide) != part.shape[1:]
            else part
            for part in parts
        ]
        minds[name] = np.concatenate(padded)
    bodies = {name: np.concatenate([group.bodies[name] for group in groups]) for name in groups[0].bodies}
    return Travellers(groups[0].species, bodies, minds)


class IslandRun:
    """A run of an archipelago that is in progress, with its folder."""

    def __init__(self, plan: Plan, folder: Path, pool: Pool | None, *, shown: bool) -> None:
        self.plan, self.folder, self._pool, self._shown = plan, folder, pool, shown
        self._stack = contextlib.ExitStack()

    def start(self) -> None:
        """Start a new run."""
        self.run = Run(self.plan, self.folder)
        self._begin(resume=False)

    def resume(self, tick: int) -> None:
        """Resume from the common snapshot of `tick`; later ticks are discarded."""
        self.run = run = Run(self.plan, self.folder)
        run.schedule.read()
        kept = self.folder / KEPT
        run.restore(kept / str(tick))
        for later in [path for path in kept.glob("[0-9]*") if path.name.isdecimal() and int(path.name) > tick]:
            shutil.rmtree(later)
        self._begin(resume=True)

    def fork(self, source: Path, tick: int, record: Mapping[str, Any]) -> None:
        """Start, in a folder of its own, from the common snapshot of the island whose run is in `source`."""
        before = Run(resolve_run(config=read_config(source / "config.toml"), copies=self.plan.copies), source)
        self.run = forks.fork_from(before, checkpoint.read(source / KEPT / str(tick)), self.plan, self.folder, record)
        self._begin(resume=False)

    def _begin(self, *, resume: bool) -> None:
        observers = recorders(self.run, resume=resume)
        if not resume:
            self.run.start()
        self._stack.enter_context(lock(self.folder, PATIENCE))
        self._stack.enter_context(self.run.under_way(observers))

    def advance(self, tick: int) -> Census:
        """Advance to `tick`, and return the census."""
        began = time.process_time()
        try:
            self.run.advance(tick - self.run.now)
        except BaseException:
            self._stack.__exit__(*sys.exc_info())  # says what is told of errors, and closes all files
            raise
        return self.census(time.process_time() - began)

    def census(self, seconds: float = 0.0) -> Census:
        """Return the census of the island at a stop, after CPU `seconds` since the last one."""
        state, env = self.run.env.state_view, self.run.env
        alive, drive, place, moving = {}, {}, {}, {}
        for species, group in zip(env.scenario.species, env.groups.values(), strict=True):
            slots = group.slots.start + np.flatnonzero(state.alive[group.slots])
            alive[species.name] = len(slots)
            drive[species.name] = float(state.drive[slots].mean()) if slots.size else float("nan")
            if self._shown:
                some = slots[:SHOWN]
                place[species.name] = np.column_stack([state.position[some], state.drive[some]]).astype(np.float32)
            if species.name in self.plan.island["species"]:
                count = moving[species.name] = Count(
                    slots=slots,
                    serial=state.serial[slots],
                    drive=state.drive[slots],
                    age=state.age[slots],
                    free=group.size - len(slots),
                    founders=species.count,
                )
                if self._pool is not None and self._pool.species == species.name:
                    names = [need.name for need in species.needs]
                    at = None if self._pool.fitness == ALIVE else names.index(self._pool.fitness)
                    low = 0.0 if at is None else species.needs[at].bounds[0]
                    count.fitness = np.ones(len(slots)) if at is None else state.internal[slots, at] - low
                    count.trait = None if state.trait is None else state.trait[slots, : len(species.traits)]
        return Census(self.run.now, alive, drive, moving, seconds, place)

    # ---- between two ticks -----------------------------------------------------------------

    def depart(self, species: str, slots: np.ndarray) -> Travellers:
        """Remove the agents in `slots` from this island and return them."""
        learner, rows = self.run.learners[species], self.run.env.groups[species].slots
        minds = learner.pack(slots - rows.start)
        self.run.tick, bodies = self.run.env.take_out(slots)
        learner.died(slots - rows.start)
        return Travellers(species, bodies, minds)

    def arrive(self, group: Travellers, seed: np.random.SeedSequence) -> None:
        """Add travellers to this island."""
        learner, rows = self.run.learners[group.species], self.run.env.groups[group.species].slots
        self.run.tick, slots = self.run.env.bring_in(group.species, group.bodies, np.random.default_rng(seed))
        learner.unpack(slots - rows.start, group.minds)
        learner.interrupted(slots - rows.start)

    def breed(self, species: str, parents: np.ndarray, traits: np.ndarray | None, seed: np.random.SeedSequence) -> None:
        """End a generation: replace all agents of `species` by newborns."""
        env, learner = self.run.env, self.run.learners[species]
        rows, state = env.groups[species].slots, env.state_view
        gone = rows.start + np.flatnonzero(state.alive[rows])
        alive = state.alive.copy()
        alive[gone] = False
        changes: dict[str, Any] = {"alive": alive}
        if self._pool is not None and self._pool.renew:
            finite = np.isfinite(state.stock)
            start = env.world.model.resources.stock if env.world.model.appearing is None else state.stock
            changes["grown"] = state.grown + np.where(finite, np.where(finite, start, 0.0) - state.stock, 0.0)
            changes["stock"] = np.where(finite, start, state.stock)
        env.set_state(**changes)
        learner.died(gone - rows.start)
        self.run.tick, slots = env.breed(species, parents, traits, np.random.default_rng(seed))
        learner.born(slots - rows.start, np.full(len(slots), -1))

    # ---- what is kept ------------------------------------------------------------------------

    def save(self) -> None:
        """Write the recording up to the present tick, then a snapshot."""
        self.run.keep_at(self.folder / KEPT / str(self.run.now))

    def drop(self, ticks: Sequence[int]) -> None:
        """Remove the snapshots of `ticks`."""
        for tick in ticks:
            shutil.rmtree(self.folder / KEPT / str(tick), ignore_errors=True)

    def close(self) -> dict[str, Any]:
        """End the run as it is, and return its summary."""
        self.run.keep_at()
        self._stack.close()
        return self.run.summary()


def check_species(plans: Sequence[Plan], name: str) -> None:
    """Raise EcologyError where agents of a species cannot go from any island to any other."""
    groups = []
    for plan in plans:
        species = next(s for s in plan.load().species if s.name == name)
        traits = [(trait.name, trait.of, trait.bounds) for trait in species.traits]
        needs = [(need.name, need.bounds) for need in species.needs]
        groups.append((needs, traits, [action.name for action in species.actions]))
    for i, group in enumerate(groups):
        if group != groups[0]:
            raise EcologyError(
                f"{name!r} moves between islands, and has other needs, traits or actions on island {i} than on island "
                "0; give all islands the same."
            )
