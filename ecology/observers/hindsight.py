"""What a recording holds of any agent, drawn after the fact as the life of the agent in focus is.

Bodies are recorded all, a row per slot: their places, headings, variables, actions and drives. What only
the agent in focus shows, its decision and its lines of sight, was recorded for whoever that was, and
is said to be missing of others. The life is drawn as a layer: a small recording of the same identity
with entities of its own (chosen/AGENT, world/chosen/AGENT) and a layout, which viewers add to the
recording. Of several layouts in a file one is shown by chance, so the recording's own is left out.
"""

from __future__ import annotations

import dataclasses
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from ecology import physiology
from ecology.env import Ecology
from ecology.ground import ground_of
from ecology.observers import census, maps, shapes
from ecology.observers.census import HUNGRIEST, FocusSamples, without_functions
from ecology.observers.focus_requests import AGENTS, Click
from ecology.observers.layout import FORKED, blueprint, life_panels
from ecology.observers.panels.base import time_columns
from ecology.observers.readback import chunks, plain, recording_id, replace_layout
from ecology.observers.recording_file import open_stream
from ecology.observers.scene import DEAD, FEW, Scene
from ecology.scenario import Scenario
from ecology.spec import require

Column = tuple[np.ndarray, np.ndarray]  # ticks (n,) and values (n, ...)


class Hindsight:
    """Finds agents in a recording and draws their lives."""

    def __init__(
        self,
        recording: Path,
        scenario: Scenario,
        name: str,
        relive: Callable[[str, int], Mapping[int, str]] | None = None,
    ) -> None:
        """Look into the file `recording` of a run of `scenario`, which is called `name`.

        relive: works out again what an agent weighed about a tick, and returns it by tick; None leaves it unknown.
        """
        self._relive = relive
        self._path, self._lock = recording, threading.Lock()
        self._identity = recording_id(recording)
        env = Ecology(scenario)
        self._groups = {name: group for name, group in env.groups.items() if group.size}
        entities = {chunk.entity_path for chunk in chunks(recording)}
        self._serials = {name: self._column(f"{AGENTS}/{name}", "serial") for name in self._groups}
        ticks = next(iter(self._serials.values()))[0] if self._groups else np.zeros(1, int)
        require(len(ticks) > 0, f"the recording {str(recording)!r} holds no agent of this scenario.")
        drives = self._column(f"{AGENTS}/{next(iter(self._groups))}", "drive")
        few = env.size <= FEW
        self._scene = Scene(
            scenario=without_functions(scenario),
            groups=self._groups,
            names={name: f"{name}_{serial[0][0]}" for name, (_, serial) in self._serials.items()},
            first=None,
            reported={name: self._reported_names(name) for name in env.groups},
            mapped={name: any(path.startswith(f"/world/maps/{name}/") for path in entities) for name in env.groups},
            decides={name: f"/focus/{name}/decision" in entities for name in env.groups},
            coupled=tuple(name for name in env.groups if f"/population/coupling/{name}" in entities),
            measures=census.plotted_names(scenario),
            grows=env.open_population,
            marks=self._marks(scenario),
            grid=maps.cover(scenario.arena),
            run=name,
            every=int(np.diff(ticks[:2]).sum()) or 1,
            maps_every=0,
            **(self._fork() if f"/{FORKED}/world/walls" in entities else {}),
            full=len(drives[0]) > 0,
            few=few,
            lived_until=self._find_last_tick(),
            span=(int(ticks[0]), int(ticks[-1])),
            has_props=any(path.startswith("/world/props/") for path in entities),
        )

    def who(self, click: Click) -> str | None:
        """Return the name of the clicked agent, which had the slot at that tick; None if no agent was clicked."""
        for name, (ticks, serials) in self._serials.items():
            if click.entity == f"{AGENTS}/{name}" and click.row < serials.shape[1]:
                row = len(ticks) if click.tick is None else int(np.searchsorted(ticks, click.tick, side="right"))
                serial = int(serials[max(row - 1, 0), click.row])
                return f"{name}_{serial}" if serial >= 0 else None
        return None

    def hear(self, click: Click) -> bytes | str | None:
        """Return the layer of the agent that was clicked, or a message if there is none."""
        name = self.who(click)
        if name is None:
            when = "then" if click.tick is None else f"at tick {click.tick:,.0f}"
            return f"Nobody was there {when}: click a body, or press f and write a name."
        return self.layer(name, None if click.tick is None else round(click.tick)) if self._scene.crowd else None

    def layer_named(self, word: str) -> bytes | None:
        """Return the layer of an agent by name; EcologyError for one that the recording does not hold."""
        return self.layer(word)

    def write_view(self, word: str | None, target: Path) -> Path:
        """Write the recording, with the layer of `word` in the place of its own layout, to the new file `target`."""
        with tempfile.TemporaryDirectory() as folder:
            layer = Path(folder) / "layer.rrd"
            layer.write_bytes(self.layer(word))
            return replace_layout(self._path, layer, target, self._scene.application)

    def layer(self, word: str | None = None, tick: int | None = None) -> bytes:
        """Return the layer, a recording, that shows an agent by name, or first the focus of a species.

        Where decisions can be worked out again, they are about `tick`, or at the end of the agent's life. Raises
        EcologyError for a name that the recording does not hold.
        """
        species, serial = (None, None) if word is None else self._meant(word)
        if not self._scene.crowd:  # one agent, which was in focus all the time
            serial = None
        chosen = {} if species is None or serial is None else {species: f"{species}_{serial}"}
        scene = dataclasses.replace(self._scene, first=species, chosen=chosen)
        with self._lock, tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "layer.rrd"
            rec = open_stream(scene.application, self._identity, named=False)
            rec.set_sinks(rr.FileSink(str(path)))
            rec.set_log_time_enabled(False)
            if species is not None and serial is not None:
                last = self._draw(rec, scene, species, serial, tick)
                if last < self._serials[species][0][-1]:
                    scene = dataclasses.replace(scene, died={species: last})
            rec.send_blueprint(blueprint(scene))
            rec.flush()
            rec.disconnect()
            return path.read_bytes()

    def _meant(self, word: str) -> tuple[str, int | None]:
        """Return the species and the serial that `word` means, no serial of a species."""
        if word in self._groups:
            return word, None
        species, _, number = word.rpartition("_")
        known = species in self._groups and number.isdecimal()
        require(
            known and bool((self._serials[species][1] == int(number)).any()),
            f"focus: the recording holds no agent {word!r} at any recorded tick; give the name of one that it shows, "
            f"or a species ({', '.join(self._groups)})"
            + (f". {HUNGRIEST!r} is of a run that is alive." if word == HUNGRIEST else "."),
        )
        return species, int(number)

    def _draw(self, rec: rr.RecordingStream, scene: Scene, name: str, serial: int, tick: int | None) -> int:
        """Draw the life of an agent, and after it a row of nothing; return the last recorded tick that it lived."""
        group, who = self._groups[name], f"{name}_{serial}"
        species, entity = scene.scenario.species[group.index], f"{AGENTS}/{name}"
        ticks, serials = self._serials[name]
        row, slot = np.nonzero(serials == serial)
        if row[-1] + 1 < len(ticks):  # where another has the slot, nothing of this one is left to be seen
            row, slot = np.append(row, row[-1] + 1), np.append(slot, slot[-1])

        def of(component: str) -> np.ndarray:
            return self._rows(entity, component, ticks[row], slot)

        x = np.stack([of(need.name) for need in species.needs], axis=1).astype(float)
        place, way = of("Points2D:positions").astype(float), of("Arrows2D:vectors")
        angle, lives = np.arctan2(way[:, 1], way[:, 0]), np.isfinite(x).all(axis=1) & (serials[row, slot] == serial)
        fixed = np.array([need.set_point for need in species.needs])
        target = np.tile(fixed, (len(x), 1))
        for i, name_ in enumerate(census.moving(species)):
            if name_:
                target[:, i] = of(name_)
        delta = np.where([n.regulated for n in species.needs], x - target, 0.0)
        own = physiology.drive_of(species, delta)
        if scene.full:
            drive, reward = of("drive").astype(float), of("reward").astype(float)
        else:  # what it felt of others was not recorded
            drive, reward, own = own, None, np.full(len(own), np.nan)
        ground = ground_of(scene.scenario.arena)
        field = [shapes.view_field(species, p, a, ground) if live else np.empty((0, 2))
                 for p, a, live in zip(place, angle, lives, strict=True)]  # fmt: skip
        for value in (x, place, drive, own, *([] if reward is None else [reward])):
            value[~lives] = np.nan
        mean = None
        if group.size > 1:
            known, means = self._column("/population/drive", "Scalars:scalars")
            i = 3 * list(self._groups).index(name)
            mean = np.array([dict(zip(known, means[:, i], strict=True)).get(tick, np.nan) for tick in ticks[row]])
        life = FocusSamples(
            tick=ticks[row],
            internal=x,
            set_point=target,
            drive=drive,
            own=None if species.empathy is None else own,
            mean=mean,
            reward=reward,
            action=np.where(lives, of("action"), DEAD),
            place=place,
            names=[who] * len(row),
            field=field,
            sight=[np.empty((0, 2))] * len(row),
        )
        for panel in life_panels(scene, name):
            panel.open(rec)
            panel.draw_life(rec, life)
        if scene.decides[name] and lives.any():
            self._write_decisions(rec, name, who, ticks[row[lives]], tick)
        return int(ticks[row[lives]][-1] if lives.any() else ticks[row[0]])

    def _write_decisions(
        self, rec: rr.RecordingStream, name: str, who: str, ticks: np.ndarray, tick: int | None
    ) -> None:
        """Write what the agent weighed where it was in focus, and elsewhere that it was not."""
        known, texts = self._column(f"/minds/{who}/decision", "TextDocument:text")
        every = len(known) > 0  # where there were few, everybody's decisions are recorded, when they were made
        if not every:
            known, texts = self._column(f"/focus/{name}/decision", "TextDocument:text")
        its = {tick: text for tick, (text,) in zip(known, texts, strict=True) if text.startswith(f"**{who}**")}
        when = f"It was in focus within ticks {min(its)} to {max(its)}." if its else "It never was in focus."
        note = f"**{who}** was not in focus here, and what it weighed was not recorded. {when}"
        if self._relive is not None and not every:
            again = self._relive(who, int(ticks[-1]) if tick is None else tick)
            its = {**again, **its}
            note += f" Ticks {min(again)} to {max(again)} were worked out again." if again else ""
        between = [tick for tick in its if ticks[0] <= tick <= ticks[-1]]  # decisions are recorded at every tick
        ticks = np.union1d(ticks, np.array(between, ticks.dtype))
        shown = np.array([its.get(tick, note) for tick in ticks], object)
        if every:
            ticks, shown = np.array(sorted(its)), np.array([its[tick] for tick in sorted(its)], object)
        new = np.flatnonzero(np.append(True, shown[1:] != shown[:-1]))
        rec.send_columns(
            f"chosen/{who}/decision",
            time_columns(ticks[new]),
            rr.TextDocument.columns(text=shown[new].tolist(), media_type=["text/markdown"] * len(new)),
        )

    def _marks(self, scenario: Scenario) -> tuple[str, ...]:
        """Return the kinds of marks that the legend names; deaths by a rule are not known without the rule."""
        words: set[str] = set()
        for chunk in chunks(self._path, content="/world/legend/**", components="Points2D:labels", is_static=True):
            words.update(chunk.to_record_batch().column("Points2D:labels").to_pylist()[-1] or ())
        kinds = {kind for kind, word in shapes.KINDS.items() if word in words}
        return tuple(kind for kind in shapes.KINDS if kind in kinds | set(shapes.mark_kinds(scenario)))

    def _find_last_tick(self) -> int | None:
        """Return the last recorded tick at which anybody lived; None where somebody does at the end."""
        last, end = -1, 0
        for name in self._groups:
            ticks, places = self._column(f"{AGENTS}/{name}", "Points2D:positions")
            alive = np.isfinite(places).any(axis=tuple(range(1, places.ndim)))
            last, end = max(last, int(ticks[alive].max(initial=-1))), max(end, int(ticks.max(initial=0)))
        return last if 0 <= last < end else None

    @property
    def lived_until(self) -> int | None:
        """Return the last recorded tick at which anybody lived, None where somebody does at the end."""
        return self._scene.lived_until

    def _fork(self) -> dict[str, Any]:
        """Return what the other future is called that the recording shows too, and from which tick on it does."""
        ticks, texts = self._column("/futures/text", "TextDocument:text")
        if not len(texts):
            return {"fork": "the fork"}
        return {"fork": str(texts[0][0]).partition("**")[2].partition("**")[0], "forked_at": int(ticks[0])}

    def _reported_names(self, name: str) -> tuple[str, ...]:
        """Return the numbers that a species' mind reported, by name."""
        found: list[str] = []
        for part in ("losses", "numbers"):
            for chunk in chunks(
                self._path, content=f"/learning/{name}/{part}", components="SeriesLines:names", is_static=True
            ):
                found += chunk.to_record_batch().column("SeriesLines:names").to_pylist()[-1]
        return tuple(found)

    def _column(self, entity: str, component: str) -> Column:
        """Return a component by tick, in order: (n,) and (n, instances, ...)."""
        found = list(self._parts(entity, component))
        if not found:
            return np.zeros(0, int), np.zeros((0, 0))
        ticks = np.concatenate([part[0] for part in found])
        ticks, last = np.unique(ticks[::-1], return_index=True)  # of two at one tick, the last
        return ticks, np.concatenate([part[1] for part in found])[::-1][last]

    def _rows(self, entity: str, component: str, ticks: np.ndarray, slot: np.ndarray) -> np.ndarray:
        """Return a component of the instance `slot` (n,) at `ticks` (n,), which rise, (n, ...)."""
        found: np.ndarray | None = None
        for known, values in self._parts(entity, component):
            at = np.searchsorted(ticks, known).clip(max=len(ticks) - 1)
            is_recorded = ticks[at] == known
            if found is None:
                found = np.full(
                    (len(ticks), *values.shape[2:]), np.nan if values.dtype.kind == "f" else 0, values.dtype
                )
            found[at[is_recorded]] = values[is_recorded, slot[at[is_recorded]]]
        assert found is not None
        return found

    def _parts(self, entity: str, component: str) -> Iterator[Column]:
        """Give a component chunk by chunk: ticks (n,) and values (n, instances, ...)."""
        for chunk in chunks(self._path, content=entity, components=component, is_static=False):
            batch = chunk.to_record_batch()
            column = batch.column(component)
            known = column.is_valid().to_numpy(zero_copy_only=False)
            ticks = batch.column("tick").to_numpy(zero_copy_only=False)[known]
            values = plain(column.flatten())
            two = pa.types.is_fixed_size_list(column.type.value_type)
            if len(ticks):
                yield ticks, values.reshape(len(ticks), -1, 2) if two else values.reshape(len(ticks), -1)
