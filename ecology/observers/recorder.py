"""Metrics in columns: one row per sampled tick and living agent, in a parquet file.

During the run, rows go to `metrics.parquet.parts/`, a folder of complete parquet files and nothing else, which
any parquet reader opens as one table: a part is written beside the folder and moved into it when it is complete. `end`
joins them into `metrics.parquet` and removes the folder. A run that is killed leaves the folder, and with it everything
but the last half minute: `read` opens either. Where both exist, the joined file is complete and the folder left over.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from ecology.env import Ecology
from ecology.errors import EcologyError, describe_refusal, is_from_system, readable
from ecology.observers.base import Mind
from ecology.scenario import Scenario
from ecology.spec import require
from ecology.state import State
from ecology.world import Tick

ROWS = 65_536  # of a part, at most, and of a row group of the joined file
SECONDS = 30.0  # of the clock between parts, at most
DEEDS = "interventions"  # column of a run with any: those since the last sampled tick
FIXED = ("tick", "time", "agent", "species", "x", "y", "heading", "drive", "own_drive", "reward", "action", DEEDS)
MEASURE = "measures."  # before the name of a scenario's measure
LOAD = "load."  # before the name of what is carried
CUE, SET_POINT = "cues.", "set_points."  # before the name of a cue, and of a need whose set point moves
TRAIT = "traits."  # before the name of a trait
TRIALS = ("session", "trial")  # columns of a scenario with sessions


class Recorder:
    """Writes ticks, bodies, internal states and the numbers that learners report to `metrics.parquet`.

    Columns: tick, time, agent, species, x, y, heading, one per internal variable under its need's
    name, drive (what is felt of others included), own_drive (without that), reward, action, one per
    resource that agents carry (`load.NAME`), one per measure of the scenario (`measures.NAME`,
    the same in every row of a tick), one per cue (`cues.NAME`), per set point
    that moves (`set_points.NEED`) and per trait (`traits.NAME`), session and trial in a scenario with sessions, and one
    per number that a learner reports. A run with interventions, or whose scenario has a schedule, has
    `interventions` too: those since the last sampled tick, null
    where there was none. A variable that a species does not have is null. Memory is bounded by `ROWS` rows.
    """

    def __init__(
        self, path: Path | str, every: int = 10, *, resume: bool = False, deeds: Iterable[tuple[int, str]] = ()
    ) -> None:
        """Write to `path` every `every` ticks; with `resume`, after the rows up to the present tick.

        deeds: interventions since the last sampled tick, which no row has yet: tick and text.
        """
        self._path, self._every, self._resume = Path(path), every, resume
        self._parts = parts_of(self._path)
        self._unfinished = self._parts.with_suffix(".unfinished")  # beside the folder, which readers open as it is
        require(
            isinstance(every, int) and every > 0,
            f"a recorder samples every so many ticks, a whole number of at least 1; got {every!r}.",
        )
        self._rows: dict[str, list[np.ndarray]] = {}
        self._count, self._number, self._since = 0, 0, time.monotonic()
        self._deeds = list(deeds)
        exists = self._path.exists() or self._parts.exists()
        require(
            resume or not exists,
            f"there are metrics at {str(self._path)!r} already; choose another folder, or resume that run.",
        )

    def begin(self, env: Ecology, minds: Mapping[str, Mind]) -> None:
        """Open the parts; a resumed recording keeps its rows up to the present tick."""
        species = env.scenario.species
        counts = [s.slots for s in species]
        needs = list(dict.fromkeys(need.name for s in species for need in s.needs))
        check_columns(env.scenario, minds)
        self._scenario = env.scenario
        carried = {name for s in species for name in s.carries}
        self._hauled = [k for k, r in enumerate(env.scenario.resources) if r.name in carried]
        self._groups = [(group.name, group.slots) for group in env.groups.values()]
        self._species_of = np.repeat(np.arange(len(species)), counts)
        self._species = np.array([s.name for s in species])
        # which column of the state holds each named need, -1 where a species has none
        place = [{need.name: i for i, need in enumerate(s.needs)} for s in species]
        self._need_at = {name: np.array([p.get(name, -1) for p in place]) for name in needs}
        actions = list(dict.fromkeys(a.name for s in species for a in s.actions))
        moving = {need.name for s in species for need in s.needs if need.set_range is not None}
        self._set_point_at = {name: at for name, at in self._need_at.items() if name in moving}
        self._timetable = env.timetable
        traits = list(dict.fromkeys(trait.name for s in species for trait in s.traits))
        columns = [{trait.name: i for i, trait in enumerate(s.traits)} for s in species]
        self._trait_at = {name: np.array([each.get(name, -1) for each in columns]) for name in traits}
        self._actions = pa.array(actions)
        self._action_at = np.zeros((len(species), max(len(s.actions) for s in species)), np.int32)
        for i, s in enumerate(species):
            self._action_at[i, : len(s.actions)] = [actions.index(a.name) for a in s.actions]
        for left in (self._unfinished, self._parts.with_suffix(".joined")):  # of a run that was killed, or a link
            left.unlink(missing_ok=True)
        if self._resume:
            self._go_on(env.state_view.tick)
        self._parts.mkdir(parents=True, exist_ok=True)

    def _go_on(self, tick: int) -> None:
        """Keep the rows up to `tick` as the first part; at any time they are there once and whole."""
        kept = sources(self._path)
        if not kept:
            return
        self._join_parts(kept, until=tick)
        self._parts.mkdir(parents=True)
        self._path.replace(self._parts / "part-000000.parquet")

    def intervened(self, state: State, text: str, said: str) -> None:
        """Note an intervention: the rows of the next sampled tick have it."""
        self._deeds.append((state.tick, text))

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Take the rows of a sampled tick."""
        if state.tick % self._every:
            return
        slots = np.flatnonzero(state.alive)
        if not slots.size:
            return
        rows = {
            "tick": np.full(len(slots), state.tick),
            "time": np.full(len(slots), state.time),
            "serial": state.serial[slots],
            "slot": slots,
            "position": state.position[slots],
            "heading": state.heading[slots],
            "internal": state.internal[slots],
            "drive": tick.drive[slots],
            "own_drive": state.own_drive[slots],
            "reward": tick.reward[slots],
            "action": tick.action[slots],
        }
        if state.load is not None:
            for k in self._hauled:
                rows[LOAD + self._scenario.resources[k].name] = state.load[slots, k]
        for name, measured in zip(self._scenario.measures, self._scenario.measure(state), strict=True):
            rows[MEASURE + name] = np.full(len(slots), measured)
        for cue, value in zip(self._scenario.cues, () if state.cue is None else state.cue, strict=True):
            rows[CUE + cue.name] = np.full(len(slots), value)
        if state.trait is not None:
            rows["trait"] = state.trait[slots]
        if state.set_point is not None:
            rows["set_point"] = state.set_point[slots]
        if self._timetable is not None and self._scenario.sessions:
            for word, value in zip(TRIALS, self._timetable.trial(state.tick), strict=True):
                rows[word] = np.full(len(slots), value, object if isinstance(value, str) else None)
        if self._deeds:
            rows[DEEDS] = np.full(len(slots), "; ".join(f"tick {at}: {text}" for at, text in self._deeds), object)
            self._deeds = []
        values: dict[str, np.ndarray] = {}
        for name, span in self._groups:
            for word, value in minds[name].report().items():
                values.setdefault(word, np.full(len(state.alive), np.nan))[span] = value
        rows.update({f"report {word}": value[slots] for word, value in values.items()})
        if self._rows and rows.keys() != self._rows.keys():  # a mind reports something new
            self._write()
        for name, value in rows.items():
            self._rows.setdefault(name, []).append(value)
        self._count += len(slots)
        if self._count >= ROWS or time.monotonic() - self._since > SECONDS:
            self._write()

    def flush(self) -> None:
        """Write the rows so far, at a checkpoint: a run that is killed later continues after them."""
        self._write()

    def end(self) -> None:
        """Join the parts into the one file."""
        self._write()
        parts = sources(self._path)
        if parts:
            self._join_parts(parts)
        else:
            shutil.rmtree(self._parts, ignore_errors=True)

    def _join_parts(self, parts: Iterable[Path], until: int | None = None) -> None:
        """Put the rows of `parts` (up to the tick `until`) in the one file, and remove the folder."""
        joined = self._parts.with_suffix(".joined")
        try:
            _join(parts, joined, until)
            joined.replace(self._path)
        except (EcologyError, OSError) as error:
            with contextlib.suppress(OSError):  # where nothing can be written, nothing can be removed
                joined.unlink()
            if isinstance(error, EcologyError) or not is_from_system(error):
                raise
            raise EcologyError(
                f"the metrics {str(self._path)!r} cannot be written in one file ({describe_refusal(error)}). No row is "
                "lost. Make room for a second copy of them, or allow writing there; then run the same command again."
            ) from error
        if self._parts.exists():
            shutil.rmtree(self._parts)

    def _next_part(self) -> Path:
        self._number += 1
        return self._parts / f"part-{self._number:06d}.parquet"

    def _write(self) -> None:
        """Write the rows at hand as one complete part."""
        self._since = time.monotonic()
        if not self._count:
            return
        rows = {name: np.concatenate(values) for name, values in self._rows.items()}
        self._rows, self._count = {}, 0
        target, unfinished = self._next_part(), self._unfinished
        try:
            pq.write_table(self._table(rows), unfinished, compression="zstd")
            unfinished.replace(target)
        finally:
            with contextlib.suppress(OSError):
                unfinished.unlink(missing_ok=True)

    def _table(self, rows: dict[str, np.ndarray]) -> pa.Table:
        species = self._species_of[rows["slot"]]
        serials, which = np.unique(rows["serial"], return_inverse=True)
        kinds = np.zeros(len(serials), int)
        kinds[which] = species
        names = pa.array([f"{self._species[k]}_{s}" for k, s in zip(kinds, serials, strict=True)])

        def variable(at: np.ndarray, of: str = "internal") -> pa.Array:
            column = at[species]
            value = rows[of].astype(np.float32)[np.arange(len(column)), np.maximum(column, 0)]
            return pa.array(value, mask=column < 0)

        def word(codes: np.ndarray, words: pa.Array) -> pa.Array:
            return pa.DictionaryArray.from_arrays(codes.astype(np.int32), words).dictionary_decode()

        def number(value: np.ndarray) -> pa.Array:
            return pa.array(value.astype(np.float32), from_pandas=True)

        columns = {
            "tick": pa.array(rows["tick"], pa.int64()),
            "time": pa.array(rows["time"], pa.float64()),
            "agent": word(which, names),
            "species": word(species, pa.array(self._species)),
            "x": number(rows["position"][:, 0]),
            "y": number(rows["position"][:, 1]),
            "heading": number(rows["heading"]),
            **{name: variable(at) for name, at in self._need_at.items()},
            "drive": number(rows["drive"]),
            "own_drive": number(rows["own_drive"]),
            "reward": number(rows["reward"]),
            "action": word(self._action_at[species, rows["action"]], self._actions),
            **{name: number(rows[name]) for name in rows if name.startswith(LOAD)},
            **{name: pa.array(rows[name]) for name in rows if name.startswith((MEASURE, CUE))},
            **{TRAIT + name: variable(at, "trait") for name, at in self._trait_at.items()},
            **{SET_POINT + name: variable(at, "set_point") for name, at in self._set_point_at.items()},
            **{name: pa.array(rows[name].tolist()) for name in TRIALS if name in rows},
            **{name: pa.array(rows[name].tolist(), pa.string()) for name in rows if name == DEEDS},
        }
        for name, value in rows.items():
            key = name.removeprefix("report ")
            if key != name:
                require(
                    key not in columns,
                    f"a mind reports {key!r}, which is the name of another column of the metrics; "
                    "report it under another name.",
                )
                columns[key] = number(value)
        return pa.table(columns)


def check_columns(scenario: Scenario, minds: Mapping[str, Mind]) -> None:
    """Raise EcologyError where two columns of the metrics would have one name."""
    needs = {need.name for species in scenario.species for need in species.needs}
    words = {word for mind in minds.values() for word in mind.report()}
    fixed = {*FIXED, *(TRIALS if scenario.sessions else ()), *(MEASURE + name for name in scenario.measures)}
    clash = sorted(needs & {*fixed, *words})
    require(not clash, f"the needs {clash} have names of other columns of the metrics; rename them.")
    clash = sorted(words & fixed)
    require(not clash, f"minds report {clash}, names of other columns of the metrics; report them under other names.")


def read(path: Path | str) -> pa.Table:
    """Return the metrics at `path`, from the joined file or from the parts of a run that was stopped.

    Raises EcologyError where there are none, where one cannot be read, and where one is damaged.
    """
    found = sources(Path(path))
    require(bool(found), f"there are no metrics at {str(path)!r}; give the metrics.parquet of a run.")
    tables = []
    for part in found:
        with _explain_damage(part):
            tables.append(pq.read_table(part))
    with _explain_mismatch(found):
        return pa.concat_tables(tables, promote_options="default")


@contextlib.contextmanager
def _explain_damage(file: Path) -> Iterator[None]:
    """Turn what the parquet reader raises of one file into an EcologyError that says whether it is damaged."""
    try:
        with readable("the metrics file", file):
            yield
    except MemoryError:  # one of Arrow's exceptions, too
        raise
    except (pa.ArrowException, OSError) as error:
        raise EcologyError(
            f"the metrics file {str(file)!r} is damaged ({str(error).splitlines()[0]}). Move this one file away to "
            "continue without its rows; all others are kept."
        ) from error


@contextlib.contextmanager
def _explain_mismatch(files: Iterable[Path]) -> Iterator[None]:
    """Turn what Arrow raises of files of different kinds into an EcologyError."""
    try:
        yield
    except MemoryError:
        raise
    except (pa.ArrowException, KeyError) as error:
        names = ", ".join(repr(str(file)) for file in files)
        raise EcologyError(
            f"the metrics files {names} are not all of this run ({str(error).splitlines()[0]}); move those of other "
            "runs away."
        ) from error


def parts_of(path: Path) -> Path:
    """Return the folder that holds the parts of the metrics at `path` while they are written."""
    return path.with_name(path.name + ".parts")


def sources(path: Path) -> list[Path]:
    """Return the files that hold the metrics at `path`, oldest rows first."""
    return [path] if path.is_file() else sorted(parts_of(path).glob("part-*.parquet"))


def _join(parts: Iterable[Path], target: Path, until: int | None = None) -> None:
    """Write the rows of `parts` (up to the tick `until`) to `target`, in row groups of `ROWS`."""
    parts, schemas = list(parts), []
    for part in parts:
        with _explain_damage(part):
            schemas.append(pq.read_schema(part).remove_metadata())
    with _explain_mismatch(parts):
        schema = pa.unify_schemas(schemas)
    with _explain_mismatch(parts), pq.ParquetWriter(target, schema, compression="zstd") as writer:
        waiting = schema.empty_table()
        for batch in _batches(parts):
            table = pa.Table.from_batches([batch])
            if until is not None:
                table = table.filter(pc.less_equal(table["tick"], until))
            waiting = pa.concat_tables([waiting, table], promote_options="default").select(schema.names)
            while waiting.num_rows >= ROWS:
                writer.write_table(waiting.slice(0, ROWS).combine_chunks())
                waiting = waiting.slice(ROWS)
        if waiting.num_rows:
            writer.write_table(waiting.combine_chunks())


def _batches(parts: Iterable[Path]) -> Iterator[pa.RecordBatch]:
    for part in parts:
        with _explain_damage(part), pq.ParquetFile(part) as file:
            if file.num_row_groups:  # a run that was stopped before its first sample has left none
                yield from file.iter_batches(ROWS)
