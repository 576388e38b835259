"""What a recording holds, read back."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from rerun.chunk import RrdReader

from ecology.errors import EcologyError, readable
from ecology.observers import census, colours
from ecology.observers.frame import Followed, Frame
from ecology.observers.recording_file import cut
from ecology.observers.scene import MARKED, STEPS
from ecology.observers.viewer import (
    RECORDING,
    is_complete,
    join_recordings,
    merge_recordings,
    open_recording,
    recording_parts,
    resumed_path,
)
from ecology.scenario import Scenario
from ecology.spec import Species, require


def holds_recording(path: Path) -> bool:
    """Return whether a file, closed, holds a recording: its layout alone is none."""
    try:
        return bool(RrdReader(str(path)).recordings())
    except RuntimeError:
        return False


def recording_id(path: Path) -> str:
    """Return the identity of the recording at `path`."""
    with readable("the recording", path):
        path.open("rb").close()
    try:
        return RrdReader(str(path)).recordings()[0].recording_id
    except (RuntimeError, IndexError) as error:
        raise EcologyError(
            f"the recording {str(path)!r} is damaged ({error}); move it away to start a new one."
        ) from error


def chunks(path: Path, **which: Any) -> Iterator[Any]:
    """Give the chunks of a recording, or those that a filter lets through; EcologyError where one cannot be read."""
    try:
        stream = RrdReader(str(path)).stream()
        yield from stream.filter(**which) if which else stream
    except (RuntimeError, ValueError) as error:
        raise EcologyError(f"the recording is damaged ({error}); record the run again.") from error


def span(path: Path) -> tuple[int, int]:
    """Return the first and the last tick of a recording, a whole file; EcologyError where there is none."""
    first, last = np.inf, -np.inf
    for chunk in chunks(path, is_static=False):
        if "tick" not in chunk.timeline_names or not chunk.num_rows:
            continue
        ticks = chunk.to_record_batch().column("tick")
        first, last = min(first, pc.min(ticks).as_py()), max(last, pc.max(ticks).as_py())
    require(first <= last, "the recording is damaged and holds no tick; record the run again.")
    return int(first), int(last)


def prepare_to_resume(path: Path, tick: int, application: str) -> tuple[Path, str, bool]:
    """Make the recording at `path` ready to continue after `tick`: what was recorded later is left out.

    Returns where the rest is written, the recording's identity, and whether it has no layout and needs one.
    """
    target = resumed_path(path)
    if target.exists() or not is_complete(path):  # the run was killed
        join_recordings(recording_parts(path), path)
    identity = recording_id(path)
    return target, identity, cut(path, tick, application, identity)


def replace_layout(path: Path, layer: Path, target: Path, application: str) -> Path:
    """Write the recording at `path`, with what `layer` holds in the place of its layout, to `target`, which it may be.

    Of several layouts in a file, one is shown by chance.
    """
    with tempfile.TemporaryDirectory() as folder:
        bare = Path(folder) / RECORDING
        RrdReader(str(path)).stream().write_rrd(str(bare), application_id=application, recording_id=recording_id(path))
        return merge_recordings([bare, layer], target)


def follow(run: Path | str, scenario: Scenario, frames: Sequence[Frame], who: str | None = None) -> list[Frame]:
    """Add to the frames of a run the needs and the decision of the agent `who`, or of the first living agent."""
    with open_recording(run) as source:
        entities = {s.name: f"/world/agents/{s.name}" for s in scenario.species if s.slots}
        serials = {name: column(source, entity, "serial") for name, entity in entities.items()}
        species, serial = _meant(scenario, serials, frames, who)
        name = f"{species.name}_{serial}"
        needs = {need.name: column(source, entities[species.name], need.name) for need in species.needs}
        moving = census.moving(species)
        targets = {word: column(source, entities[species.name], word) for word in moving if word}
        places = column(source, entities[species.name], "Points2D:positions")
        recorded = column(source, f"/minds/{name}/decision", "TextDocument:text")
        recorded = recorded or column(source, f"/focus/{species.name}/decision", "TextDocument:text")
        texts = {tick: str(text[0]) for tick, text in recorded.items() if str(text[0]).startswith(f"**{name}**")}
    found = []
    for shown in frames:
        slot = np.flatnonzero(np.asarray(serials[species.name][shown.tick]) == serial)
        place, x = np.full(2, np.nan), np.full(len(species.needs), np.nan)
        target = np.array([need.set_point for need in species.needs], float)
        if slot.size:
            place = np.reshape(places[shown.tick], (-1, 2))[slot[0]]
            x = np.array([of[shown.tick][slot[0]] for of in needs.values()], float)
            for i, word in enumerate(moving):
                target[i] = targets[word][shown.tick][slot[0]] if word else target[i]
        text = _latest(texts, shown.tick) or "" if np.isfinite(place).all() else ""
        followed = Followed(name, place.astype(float), species, x, target, text)
        found.append(dataclasses.replace(shown, followed=followed))
    return found


def _meant(
    scenario: Scenario, serials: Mapping[str, Mapping[int, Any]], frames: Sequence[Frame], who: str | None
) -> tuple[Species, int]:
    """Return species and serial of the named agent; raise EcologyError if the frames do not contain it."""
    known = {s.name: s for s in scenario.species}
    if who is None:
        name = next(iter(serials))
        return known[name], int(serials[name][frames[0].tick][0])
    name, _, number = who.rpartition("_")
    is_name = name in serials and number.isdecimal()
    is_name = is_name and any(int(number) in np.asarray(serials[name][shown.tick]) for shown in frames)
    require(
        is_name,
        f"--follow: there is no agent {who!r} in these ticks; give the name of one, as {next(iter(serials))}_0.",
    )
    return known[name], int(number)


def frames(run: Path | str, scenario: Scenario, first: int | None = None, last: int | None = None) -> list[Frame]:
    """Return what was recorded of a run (its folder or recording) from the tick `first` to `last`, both included.

    Without `first`, as many ticks as a film has by default. Drives are as fine as their colours.
    """
    from ecology.observers.film import FRAMES  # slow to load

    with open_recording(run) as source:
        groups: list[tuple[slice, dict[int, Any], dict[int, Any], dict[int, Any]]] = []
        start = 0
        for species in scenario.species:
            entity, rows = f"/world/agents/{species.name}", slice(start, start + species.slots)
            level = column(source, entity, "Points2D:class_ids") or column(source, entity, "Arrows2D:class_ids")
            places, ways = (column(source, entity, name) for name in ("Points2D:positions", "Arrows2D:vectors"))
            if species.slots:
                groups.append((rows, places, ways, level))
            start += species.slots
        known = [set(part) for _, *parts in groups for part in parts]  # one cut short may hold a place without heading
        ticks = np.array(sorted(set.intersection(*known) if known else ()), int)
        ticks = ticks[(ticks >= (first or 0)) & (ticks <= (np.inf if last is None else last))]
        ticks = ticks[-FRAMES:] if first is None else ticks
        shape = (len(ticks), start)
        place, angle, drive = np.full((*shape, 2), np.nan), np.zeros(shape), np.zeros(shape)
        highest = column(source, "/world/legend/numbers", "top")
        tops = [_latest(highest, tick) for tick in ticks]
        fixed = colours.highest_drive(scenario)  # of a recording of an earlier version
        for rows, places, ways, level in groups:
            for i, tick in enumerate(ticks):
                place[i, rows] = np.reshape(places[tick], (-1, 2))
                way = np.reshape(ways[tick], (-1, 2))
                angle[i, rows] = np.arctan2(way[:, 1], way[:, 0])
                top = fixed if tops[i] is None else float(tops[i][0])
                drive[i, rows] = np.asarray(level[tick]) * top / (STEPS - 1)
        patches = column(source, "/world/resources", "Ellipses2D:centers")
        stock = column(source, "/world/resources/stock", "Points2D:radii")
        doors = column(source, "/world/doors", "LineStrips2D:strips") if scenario.arena.doors else {}
        marks = {kind: column(source, f"/world/marks/{kind}", "LineStrips2D:strips") for kind in MARKED}
    time_of = scenario.dt * ticks
    radii = np.array([r.radius for r in scenario.resources for _ in range(r.count)])
    found = []
    for i, tick in enumerate(ticks):
        full = _latest(stock, tick)
        found.append(
            Frame(
                tick=int(tick),
                time=float(time_of[i]),
                position=place[i],
                heading=angle[i],
                drive=drive[i],
                patches=np.reshape(_latest(patches, tick), (-1, 2)) if patches else np.empty((0, 2)),
                full=np.ones(len(radii)) if full is None else (np.asarray(full) / radii) ** 2,
                doors=[np.reshape(line, (-1, 2)) for line in _latest(doors, tick) or ()],
                marks={k: [np.reshape(strip, (-1, 2)) for strip in of.get(int(tick), ())] for k, of in marks.items()},
            )
        )
    return found


def column(path: Path, entity: str, component: str) -> dict[int, Any]:
    """Return the values of a component of a recording by tick, in order; `path` is a whole file."""
    found: dict[int, Any] = {}
    for chunk in chunks(path, content=entity, components=component, is_static=False):
        batch = chunk.to_record_batch()
        ticks, values = batch.column("tick").to_pylist(), batch.column(component)
        found |= {tick: plain(values[i].values) for i, tick in enumerate(ticks) if values[i].is_valid}
    return dict(sorted(found.items()))


def plain(values: Any) -> Any:
    """Return an Arrow array as NumPy, nested ones of one length flattened; strips of points as a list of those."""
    if pa.types.is_list(values.type):
        return [plain(each.values) for each in values]
    if pa.types.is_fixed_size_list(values.type):
        return plain(values.flatten())
    return values.to_numpy(zero_copy_only=False)


def _latest(column: Mapping[int, Any], tick: int) -> Any:
    """Return the last value at or before `tick`, None without."""
    before = [at for at in column if at <= tick]
    return column[before[-1]] if before else None
