"""The run of an archipelago: it advances the islands from stop to stop, exchanges agents, and writes the run folder."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shutil
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ecology import EcologyError, Migration
from ecology.errors import nearest, writable
from ecology.lab.islands import exchange
from ecology.lab.islands.hosts import Fleet, Handle, Opening
from ecology.lab.islands.island import Census, Travellers, check_species, join
from ecology.lab.islands.plan import (
    CONFIG,
    EXCHANGE,
    ISLANDS,
    PLACE,
    POOL,
    Voyage,
    read_voyage,
    resolve_voyage,
    stream,
)
from ecology.lab.runs import source
from ecology.lab.runs.folder import KEPT, RECORDING, SUMMARY, check_links, replace_text, write_json
from ecology.lab.runs.gate import Gate
from ecology.lab.runs.stopping import Interrupt

if TYPE_CHECKING:
    from ecology.observers.overview import Overview

COMMON = "common.json"  # which snapshot all islands have
LEDGER = "exchanges.jsonl"  # which agents went where, and what was bred, a line per exchange
WRITES = (CONFIG, COMMON, LEDGER, SUMMARY, RECORDING, ISLANDS)


class ArchipelagoRun:
    """An archipelago in its folder. Building one checks everything and writes nothing; then `live`."""

    def __init__(self, voyage: Voyage, folder: Path, common: int | None = None) -> None:
        """Start a new run, or resume from the `common` snapshot."""
        self.voyage, self.folder, self.now = voyage, folder, common or 0
        self._common = common
        for name in voyage.world.moving:
            check_species(voyage.plans, name)
        self.fleet: Fleet | None = None
        self._overview: Overview | None = None
        self._ledger: list[str] = []  # lines since the last common snapshot
        self._interrupt = Interrupt()
        self.migrated, self.refused, self.generations = 0, 0, 0
        self.seconds = dict.fromkeys(("islands", "exchange", "snapshots"), 0.0)  # by the clock of this run
        self.steps = 0  # of agents, lived in this run
        self.worked: list[float] = []  # CPU seconds of the slowest island of every stretch, over the mean

    @property
    def islands(self) -> range:
        """Return the numbers of the islands."""
        return range(len(self.voyage.plans))

    def check_folder(self) -> None:
        """Raise EcologyError where the folder already holds a run."""
        holds = [name for name in (*WRITES, "config.toml") if (self.folder / name).exists()]
        if holds:
            raise EcologyError(
                f"the folder {str(self.folder)!r} already holds a run ({', '.join(holds)}); give another --out, or "
                f"continue it with --resume {self.folder}."
            )

    def _write(self) -> None:
        with writable(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
            source.keep(self.voyage.code, self.folder, self.voyage.copies)
            replace_text(self.folder / CONFIG, self.voyage.to_toml())

    def live(
        self, make: Callable[[Path], Handle], hosts: int, say: Callable[[str], None] = lambda _: None
    ) -> dict[str, Any]:
        """Run to the last tick with hosts that `make` starts, and return the summary.

        Raises StoppedError on a signal: the islands then stop together, and `--resume` continues the run.
        """
        if self._common is None:
            self.check_folder()
        else:
            check_links(self.folder)
            self._cut()
        self._write()
        self.fleet = fleet = Fleet(
            lambda: make(self.folder), len(self.voyage.plans), hosts, self._opening, self._common
        )
        began = time.perf_counter()
        with writable(self.folder), contextlib.ExitStack() as at_end:
            at_end.callback(fleet.close)
            at_end.callback(self._interrupt.end)
            self._interrupt.listen()
            if self.voyage.record:
                at_end.callback(self._show_from().close)
            fleet.open()
            if self._common is None:
                self._snapshot()
            self._watch(fleet.call("census", self._all()))
            while self.now < self.voyage.ticks and not self._interrupt.signum:
                self._stretch()
                say(f"tick {self.now:,} of {self.voyage.ticks:,}")
            if self._common != self.now:
                self._snapshot()
            summaries = fleet.call("close", self._all())
            summary = self._summary(summaries, time.perf_counter() - began)
            write_json(self.folder / SUMMARY, summary)
        self._interrupt.check()
        return summary

    def _opening(self, number: int) -> Opening:
        """Return how an island opens at the first start."""
        forked = self.voyage.forked
        if not forked:
            return ("start",)
        origin = self.voyage.folder_of(Path(forked["run"]), number)
        record = {**forked, "run": str(origin), "remove": [], "move": {}}
        return "fork", origin, forked["at"], record

    def _show_from(self) -> Overview:
        from ecology.observers.overview import Overview  # slow to load

        worlds = [plan.load() for plan in self.voyage.plans]
        world = self.voyage.world
        passing = ["passed"] * bool(world.migrations) + ["pool"] * (world.pool is not None)
        self._overview = Overview(self.folder / RECORDING, world.name, worlds, passing, after=self._common)
        return self._overview

    # ---- from stop to stop -------------------------------------------------------------------

    def _all(self, *words: Any) -> dict[int, tuple[Any, ...]]:
        return dict.fromkeys(self.islands, words)

    def _stretch(self) -> None:
        """Advance to the next stop, and perform the exchanges and snapshots that are due there."""
        assert self.fleet is not None
        voyage, before = self.voyage, self.now
        began = time.perf_counter()
        census = self.fleet.call("advance", self._all(voyage.next_stop(self.now)))
        self.now = census[0].tick
        self.seconds["islands"] += (lived := time.perf_counter()) - began
        spent = [island.seconds for island in census.values()]
        self.worked.append(max(spent) / max(float(np.mean(spent)), 1e-9))
        self.steps += (self.now - before) * sum(sum(island.alive.values()) for island in census.values())
        self._watch(census)
        if voyage.breeds(self.now):
            self._breed(census)
        if voyage.exchanges(self.now):
            for number, migration in enumerate(voyage.world.migrations):
                self._migrate(number, migration, census)
        self.seconds["exchange"] += (passed := time.perf_counter()) - lived
        due = self.now % voyage.snapshot_every == 0 or (voyage.keep_every and self.now % voyage.keep_every == 0)
        if due or self.now == voyage.ticks:
            self._snapshot()
        self.seconds["snapshots"] += time.perf_counter() - passed

    def _watch(self, census: Mapping[int, Census]) -> None:
        if self._overview is not None:
            counts = [census[i] for i in self.islands]
            self._overview.watch(
                self.now,
                [each.place for each in counts],
                [each.alive for each in counts],
                [each.drive for each in counts],
            )

    def _migrate(self, number: int, migration: Migration, census: Mapping[int, Census]) -> None:
        """Let agents of one species leave and arrive."""
        assert self.fleet is not None
        counts = [census[i].moving[migration.species] for i in self.islands]
        seed = stream(self.voyage.seed, EXCHANGE, self.now, number)
        moves = exchange.draw_moves(migration, counts, self.voyage.world.every, seed)
        leaving = {
            i: (migration.species, moves.slot[moves.origin == i]) for i in self.islands if (moves.origin == i).any()
        }
        packed: dict[int, Travellers] = self.fleet.call("depart", leaving) if leaving else {}
        row = np.zeros(len(moves.to), np.int64)  # of each in the group that left with it
        for i in leaving:
            row[moves.origin == i] = np.arange(np.count_nonzero(moves.origin == i))
        arriving = {}
        for i in map(int, np.unique(moves.to)):
            mine = moves.to == i
            groups = [packed[o].take(row[mine & (moves.origin == o)].tolist()) for o in np.unique(moves.origin[mine])]
            arriving[i] = join(groups), stream(self.voyage.seed, PLACE, self.now, number, i)
        if arriving:
            self.fleet.call("arrive", arriving)
        self.migrated, self.refused = self.migrated + len(moves.to), self.refused + moves.refused
        self._tell(
            species=migration.species,
            migrants=np.column_stack([moves.serial, moves.origin, moves.to]).tolist(),
            refused=moves.refused,
        )
        if self._overview is not None:
            self._overview.show_migrants(self.now, moves.origin, moves.to, moves.refused)

    def _breed(self, census: Mapping[int, Census]) -> None:
        """End a generation and breed the next one from the pool."""
        pool = self.voyage.world.pool
        assert pool is not None
        assert self.fleet is not None
        counts = [census[i].moving[pool.species] for i in self.islands]
        species = next(s for s in self.voyage.plans[0].load().species if s.name == pool.species)
        brood = exchange.draw_brood(pool, species.traits, counts, stream(self.voyage.seed, POOL, self.now))
        orders = {
            i: (pool.species, brood.parents[i], brood.traits[i], stream(self.voyage.seed, PLACE, self.now, i))
            for i in self.islands
        }
        self.fleet.call("breed", orders)
        self.generations += 1
        self._tell(species=pool.species, **brood.report)
        if self._overview is not None:
            self._overview.show_generation(self.now, brood.report.get("traits", {}))

    def _tell(self, **words: Any) -> None:
        self._ledger.append(json.dumps({"tick": self.now, **words}))

    # ---- what is kept ------------------------------------------------------------------------

    def _snapshot(self) -> None:
        """Write a snapshot of all islands; once all have it, it becomes the common one, and the last one is removed."""
        assert self.fleet is not None
        if self._overview is not None:
            self._overview.flush()
        self.fleet.call("save", self._all())
        with (self.folder / LEDGER).open("a", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in self._ledger)
        self._ledger = []
        replace_text(self.folder / COMMON, json.dumps({"tick": self.now, **self._counts()}) + "\n")
        keep, last = self.voyage.keep_every, self._common
        gone = [] if last is None or (keep and last % keep == 0) else [last]
        self._common = self.now
        self.fleet.commit(self.now)
        if gone:
            self.fleet.call("drop", self._all(gone))

    def _counts(self) -> dict[str, int]:
        return {"migrated": self.migrated, "refused": self.refused, "generations": self.generations}

    def _cut(self) -> None:
        """Remove the lines of the ledger that are later than the common snapshot."""
        record = json.loads((self.folder / COMMON).read_text(encoding="utf-8"))
        self.migrated, self.refused, self.generations = (int(record.get(key, 0)) for key in self._counts())
        path = self.folder / LEDGER
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        kept = [line for line in lines if line.endswith("}") and json.loads(line)["tick"] <= self.now]
        replace_text(path, "".join(f"{line}\n" for line in kept))

    def _summary(self, summaries: Mapping[int, Mapping[str, Any]], wall: float) -> dict[str, Any]:
        assert self.fleet is not None
        keys = ("seed", "mean_drive", "mean_drive_last_tenth", "deaths", "births", "population")
        exchange_share = self.seconds["exchange"] / max(sum(self.seconds.values()), 1e-9)
        return {
            "archipelago": self.voyage.archipelago,
            "seed": self.voyage.seed,
            "ticks": self.now,
            **({"stopped_by": signal.Signals(signum).name} if (signum := self._interrupt.signum) else {}),
            **self._counts(),
            "hosts_lost": self.fleet.lost,
            "wall_seconds": round(wall, 3),
            "seconds": {key: round(value, 3) for key, value in self.seconds.items()},
            "exchange_share": exchange_share,
            "slowest_island": float(np.mean(self.worked)) if self.worked else None,
            "agent_steps_per_second": self.steps / max(sum(self.seconds.values()), 1e-9),
            "islands": [{key: summaries[i][key] for key in keys} for i in self.islands],
        }


def start(name: str, changes: Mapping[str, Any], out: Path | None, **flags: Any) -> ArchipelagoRun:
    """Return the run of an archipelago, not yet begun, to `out` or "runs/NAME-SEED"."""
    voyage = resolve_voyage(name, changes, **flags)
    run = ArchipelagoRun(voyage, out or Path("runs") / f"{Path(voyage.archipelago).stem}-{voyage.seed}")
    run.check_folder()
    return run


def resume(folder: Path, ticks: int | None, gate: Gate) -> ArchipelagoRun:
    """Return the run in `folder`, ready to resume from its last common snapshot."""
    voyage = read_voyage(folder, ticks, gate)
    common = common_tick(folder)
    if common is None:
        for name in (LEDGER, RECORDING, ISLANDS, CONFIG):  # it was killed before its first snapshot
            path = folder / name
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)
    elif voyage.ticks <= common:
        raise EcologyError(f"the run {str(folder)!r} has reached its last tick; pass more --ticks to continue.")
    return ArchipelagoRun(voyage, folder, common)


def fork(
    folder: Path, at: int, changes: Mapping[str, Any], out: Path | None, ticks: int | None, gate: Gate
) -> ArchipelagoRun:
    """Return a run to `out` that continues the run in `folder` from tick `at`."""
    before = read_voyage(folder, None, gate)
    first = before.folder_of(folder, 0)
    known = sorted(int(path.name) for path in (first / KEPT).glob("[0-9]*") if path.name.isdecimal())
    if at not in known:
        raise EcologyError(
            f"the archipelago {str(folder)!r} has common snapshots at tick {', '.join(map(str, known)) or '(none)'}, "
            f"not at {at}; give one of those, or run with --keep-every N."
        )
    for key in changes:
        if key not in before.settings:
            raise EcologyError(f"the archipelago has no setting {key!r}. {nearest(key, before.settings)}")
    record = {"run": str(folder.absolute()), "at": at, "changes": dict(changes)}
    settings = {**before.settings, **changes}
    if ticks is not None and "ticks" in settings:
        settings["ticks"] = ticks
    voyage = dataclasses.replace(before, settings=settings, ticks=ticks or before.ticks, forked=record)
    if voyage.ticks <= at:
        raise EcologyError(f"a fork at tick {at} that lives to tick {voyage.ticks} has no future; give more --ticks.")
    if len(voyage.plans) != len(before.plans):
        raise EcologyError(
            f"a fork keeps the islands: there were {len(before.plans)}, and would be {len(voyage.plans)}; start a new "
            "run."
        )
    run = ArchipelagoRun(voyage, out or folder.absolute().with_name(f"{folder.absolute().name}-at-{at}"))
    run.now = at
    run.check_folder()
    return run


def common_tick(folder: Path) -> int | None:
    """Return the tick of the last snapshot that all islands have; None where there is none."""
    path = folder / COMMON
    try:
        tick = json.loads(path.read_text(encoding="utf-8"))["tick"]
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise EcologyError(f"{str(path)!r} is damaged ({error}); start a new run.") from error
    if type(tick) is not int or tick < 0:
        raise EcologyError(f"{str(path)!r} names the tick {tick!r}; start a new run.")
    return tick


__all__ = ["ArchipelagoRun", "common_tick", "fork", "resume", "start"]
