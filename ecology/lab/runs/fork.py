"""A fork: the same world lived on from one tick with one thing changed, so that two futures can be compared."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ecology import Ecology, EcologyError, Scenario, faults
from ecology.agents import checkpoint
from ecology.changes import inside
from ecology.errors import nearest
from ecology.lab.runs.folder import CHECKPOINT, CONFIG, KEPT
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import Plan, read_config, resolve
from ecology.observers.base import Observer
from ecology.spec import Oscillation
from ecology.state import CAUSES, Ints

Place = tuple[float, float]


@dataclass(frozen=True)
class Change:
    """What differs in a fork."""

    settings: Mapping[str, Any] = field(default_factory=dict)  # of the scenario and of learners
    remove: Sequence[str] = ()  # names of agents
    move: Mapping[str, Place] = field(default_factory=dict)  # new places of resources
    do: Sequence[str] = ()  # interventions


def fork(run: Run, at: int, out: Path, change: Change, *, observers: Sequence[Observer] = (), **settings: Any) -> Run:
    """Return a run to `out` that continues the world of `run` from tick `at`, not yet started.

    `run` is as opened; it goes to the last state that is known at or before `at` and lives on from
    there, watched by `observers`. The `settings` are those of `resolve` that are not of the world: ticks, device,
    record, keep_every; the run's own without. Raises EcologyError where the change does not fit.
    """
    plan = resolve(config=read_config(run.folder / CONFIG), changes=change.settings, copies=run.plan.copies, **settings)
    record = {"run": str(run.folder.absolute()), "at": at, "changes": dict(change.settings)}
    record |= {"remove": list(change.remove), "move": {name: list(place) for name, place in change.move.items()}}
    record |= {"do": list(change.do)} if change.do else {}
    forked = _prepare(run, plan, out, record)
    go_to(run, at, observers)
    parts = run.parts()
    arrays, values = parts["world"]
    model, state = run.env.world.model, run.env.world.state
    gone = np.unique(np.array([model.slot_of(name, state) for name in change.remove], np.int64))
    parts["world"] = _change_arrays(run.env, arrays, gone, change.move), values
    forked.schedule.entries = list(run.schedule.entries[: run.schedule.done])
    _become(forked, parts)
    for species, learner in forked.learners.items():  # as if they had died in the last tick
        rows = forked.env.groups[species].slots
        mine = gone[(gone >= rows.start) & (gone < rows.stop)]
        if mine.size:
            learner.died(mine - rows.start)
    for text in change.do:
        forked.do(text)
    return forked


def fork_from(run: Run, parts: dict[str, checkpoint.Part], plan: Plan, out: Path, record: Mapping[str, Any]) -> Run:
    """Return a run to `out` with `plan`, not yet started, that continues from the state `parts` of `run`."""
    run.check_words(parts)
    forked = _prepare(run, plan, out, record)
    _become(forked, parts)
    return forked


def _prepare(run: Run, plan: Plan, out: Path, record: Mapping[str, Any]) -> Run:
    """Check that the plan of a fork fits `run`, and return the fork as a new run."""
    if plan.ticks <= record["at"]:
        raise EcologyError(
            f"a fork at tick {record['at']} that lives to tick {plan.ticks} has no future; give more --ticks."
        )
    forked = Run(dataclasses.replace(plan, forked=dict(record)), out)
    forked.check_folder()
    _check_changes(run.scenario, forked.scenario)
    return forked


def _become(forked: Run, parts: dict[str, checkpoint.Part]) -> None:
    """Restore a fork from `parts`."""
    try:
        forked.become(parts)
    except Exception as error:
        raise EcologyError(
            f"the run cannot continue with these settings ({faults.describe(error)}). A fork changes numbers; "
            "it cannot add or remove parts of the world or change the shape of a learner."
        ) from error


def go_to(run: Run, at: int, observers: Sequence[Observer]) -> None:
    """Bring `run` to the tick `at`: restored from the last state before it that opens, and lived on."""
    states = _states(run)
    usable = [tick for tick in states if tick <= at <= run.plan.ticks]
    if not usable:
        raise EcologyError(
            f"the run {str(run.folder)!r} cannot be forked at tick {at}: its states are known at tick "
            f"{', '.join(map(str, sorted(states))) or '(none)'}, and it lives to tick {run.plan.ticks}. Give an --at "
            f"from {min(states, default=0)} to {run.plan.ticks}."
        )
    parts = states[max(usable)]
    if parts is not None:
        run.become(parts)
    run.live_on(at, observers)


def _states(run: Run) -> dict[int, dict[str, checkpoint.Part] | None]:
    """Return the states of a run that are known, by tick; None of a birth, which is lived again.

    A checkpoint that is damaged is none: whichever is gone on from, the life is the same.
    """
    found: dict[int, dict[str, checkpoint.Part] | None] = {} if run.plan.forked else {0: None}
    newest = run.folder / CHECKPOINT
    for where in [*(run.folder / KEPT).glob("[0-9]*"), checkpoint.previous_of(newest), newest]:
        try:
            parts = checkpoint.read(where)
            run.check_words(parts)
            found[int(parts["tally"][1]["tick"])] = parts
        except (EcologyError, KeyError, TypeError, ValueError):
            continue
    return found


def _check_changes(before: Scenario, after: Scenario) -> None:
    """Raise EcologyError where a setting changes what a fork cannot, or what only a beginning knows."""
    if before.dt != after.dt:
        raise EcologyError(f"a fork keeps the length of a tick, {before.dt!r}; got dt {after.dt!r}.")
    for was, now in zip(before.species, after.species, strict=False):
        if was.name == now.name and was.slots != now.slots:
            raise EcologyError(
                f"a fork cannot change how many slots there are: {was.name!r} has {was.slots}, got {now.slots}. Leave "
                "out what changes its count or capacity, or start a new run."
            )
    for old, new in zip(before.resources, after.resources, strict=False):
        if old.name == new.name and old.count != new.count:
            raise EcologyError(
                f"a fork cannot change how many patches there are: {old.name!r} has {old.count}, got {new.count}. "
                "Leave out what changes its count, or start a new run."
            )
        if old.name == new.name and old.position != new.position:
            raise EcologyError(
                f"a setting places the resource {old.name!r} at the start only; move it by --move {old.name}=x,y."
            )


def _change_arrays(
    env: Ecology, arrays: Mapping[str, np.ndarray], gone: Ints, move: Mapping[str, Place]
) -> dict[str, np.ndarray]:
    """Return the arrays of a snapshot of `env` without those in the slots `gone` (k,), resources being moved."""
    arrays = {name: array.copy() for name, array in arrays.items()}
    arrays["alive"][gone] = False
    arrays["cause"][gone] = CAUSES.index("rule")
    patches, resources = env.world.model.patches, {each.name: each for each in env.scenario.resources}
    for name, place in move.items():
        owner, _, number = name.partition(".")
        if owner not in patches:
            raise EcologyError(f"there is no resource {owner!r} to move. {nearest(owner, patches)}")
        resource = resources[owner]
        if not (number or "0").isdecimal() or int(number or 0) >= resource.count or (resource.count > 1) > bool(number):
            raise EcologyError(
                f"the resource {owner!r} has {resource.count} patches, counted from 0; write "
                f"--move {owner}{'.0' if resource.count > 1 else ''}=x,y, got {name!r}."
            )
        if isinstance(resource.motion, Oscillation):
            raise EcologyError(f"the resource {owner!r} oscillates between two places of its own; it cannot be moved.")
        if not inside(env.scenario, np.array([place], float))[0]:
            raise EcologyError(f"the place {place!r} for the resource {owner!r} lies outside the arena.")
        arrays["resource_position"][patches[owner].start + int(number or 0)] = place
    return arrays
