"""The configuration of an archipelago's run: the archipelago with its settings, and the plan of every island."""

from __future__ import annotations

import dataclasses
import functools
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ecology import Archipelago, EcologyError, scenarios
from ecology.errors import nearest
from ecology.lab.runs import source
from ecology.lab.runs.folder import check_files
from ecology.lab.runs.gate import Gate
from ecology.lab.runs.run_config import RECORD_EVERY, Plan, resolve, toml_value

CONFIG = "archipelago.toml"  # in the folder of its run
ISLANDS = "islands"  # folder of the islands' runs
SNAPSHOT_EVERY = 10_000  # ticks
STREAM = 2_000  # first word of the spawn keys of an archipelago
ISLAND, EXCHANGE, POOL, PLACE = range(4)  # second word: whose random numbers


@dataclass(frozen=True, kw_only=True)
class Voyage:
    """The configuration of an archipelago's run; archipelago.toml holds exactly this."""

    archipelago: str  # name, or path of a file
    settings: Mapping[str, Any]  # of the archipelago
    ticks: int
    seed: int = 0
    device: str = "cpu"
    record: bool = True
    record_every: int = RECORD_EVERY
    snapshot_every: int = SNAPSHOT_EVERY  # ticks between two common snapshots, at least
    keep_every: int = 0  # ticks between two common snapshots that are kept for good; 0 keeps none
    forked: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # of which run, when, and what was changed
    copies: Path | None = None  # folder to load the user's own code from, None: its place; not in the config

    def __post_init__(self) -> None:
        for key, low in (("ticks", 1), ("seed", 0), ("record_every", 1), ("snapshot_every", 1), ("keep_every", 0)):
            value = getattr(self, key)
            if type(value) is not int or value < low:
                raise EcologyError(f"{key} must be a whole number of at least {low}, got {value!r}.")

    @functools.cached_property
    def world(self) -> Archipelago:
        """Return the archipelago, loaded once."""
        return scenarios.load_archipelago(source.locate(self.archipelago, self.copies), **self.settings)

    @functools.cached_property
    def plans(self) -> list[Plan]:
        """Return the plans of the islands; EcologyError where their worlds do not fit each other."""
        world = self.world
        plans = [self.plan_of(number) for number in range(len(world.islands))]
        world.check_worlds([plan.load() for plan in plans])
        for name in world.moving:
            minds = [plan.learners[name] for plan in plans]
            if any(mind != minds[0] for mind in minds):
                raise EcologyError(
                    f"{name!r} moves between islands, which have different learners or learner settings for it; give "
                    "all islands the same."
                )
        return plans

    @property
    def code(self) -> list[str]:
        """Return the archipelago, the scenarios and the learners, by their names or files."""
        return list(dict.fromkeys([self.archipelago, *(name for plan in self.plans for name in plan.code)]))

    def plan_of(self, number: int) -> Plan:
        """Return the plan of one island; whether it fits the others is not checked."""
        island = self.world.islands[number]
        place = {"number": number, "islands": len(self.world.islands), "species": self.world.moving}
        return resolve(
            _beside(island.scenario, self.archipelago),
            config={"island": place},
            changes=island.settings,
            learners=[_learner(word, self.archipelago) for word in island.learners],
            copies=self.copies,
            ticks=self.ticks,
            seed=island_seed(self.seed, number),
            device=self.device,
            record=self.record,
            record_every=self.record_every,
            checkpoint_every=self.ticks,
        )

    def next_stop(self, tick: int) -> int:
        """Return the tick after `tick` at which the islands next wait for each other."""
        rhythms = [self._ticks(self.world.every)] if self.world.migrations else []
        rhythms += [self.generation] if self.world.pool is not None else []
        rhythms += [self.snapshot_every, self.keep_every]
        return min(self.ticks, *(tick + every - tick % every for every in rhythms if every))

    def exchanges(self, tick: int) -> bool:
        """Return whether migrants leave at `tick`."""
        return bool(self.world.migrations) and tick % self._ticks(self.world.every) == 0

    def breeds(self, tick: int) -> bool:
        """Return whether a generation ends at `tick`."""
        return self.world.pool is not None and tick % self.generation == 0

    @property
    def generation(self) -> int:
        """Return the ticks of a generation of the pool."""
        assert self.world.pool is not None
        return self._ticks(self.world.pool.generation)

    def _ticks(self, time: float) -> int:
        return max(1, round(time / self.plans[0].load().dt))

    def folder_of(self, out: Path, number: int) -> Path:
        """Return the folder of an island's run."""
        return out / ISLANDS / f"{number:0{len(str(len(self.world.islands) - 1))}d}"

    def to_toml(self) -> str:
        """Return the text of archipelago.toml."""
        words = {key: getattr(self, key) for key in PLAIN} | {"settings": dict(self.settings)}
        words |= {"forked": dict(self.forked)} if self.forked else {}
        return tomli_w.dumps(toml_value(words, ""))


PLAIN = {
    "archipelago": str, "ticks": int, "seed": int, "device": str, "record": bool, "record_every": int,
    "snapshot_every": int, "keep_every": int,
}  # fmt: skip


def resolve_voyage(name: str, changes: Mapping[str, Any], **flags: Any) -> Voyage:
    """Build the configuration from user input: the archipelago `name` with `changes`, and `flags` (None: not given)."""
    placed = os.path.abspath(name) if source.is_file(name) else name
    world = scenarios.load_archipelago(placed, **changes)
    given = {key: value for key, value in flags.items() if value is not None}
    settings = {key: value for key, value in world.settings.items() if key != "ticks"}
    if "ticks" in world.settings:  # a setting of that name is the length of the run
        settings["ticks"] = given.get("ticks", world.ticks)
    return Voyage(archipelago=placed, settings=settings, **{"ticks": world.ticks, **given})


def read_voyage(folder: Path, ticks: int | None = None, gate: Gate | None = None) -> Voyage:
    """Read the configuration of the run in `folder`, with other `ticks` if given; run its code if `gate` admits it."""
    words = read_words(folder)
    copies = source.choose(folder, None if gate is None else gate.choice)
    if gate is not None:
        gate.admit([words["archipelago"]], copies)
    if ticks is not None:
        words["ticks"] = ticks
        words["settings"] |= {"ticks": ticks} if "ticks" in words["settings"] else {}
    voyage = Voyage(**words, copies=copies)
    if gate is not None:
        names = [_beside(island.scenario, voyage.archipelago) for island in voyage.world.islands]
        words_ = [word for island in voyage.world.islands for word in island.learners]
        gate.admit([*names, *(_learner(word, voyage.archipelago).rpartition("=")[2] for word in words_)], copies)
    return voyage


def read_words(folder: Path) -> dict[str, Any]:
    """Return the contents of archipelago.toml; raise EcologyError if it is not valid."""
    path = folder / CONFIG
    check_files(folder)
    try:
        words = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EcologyError(f"the folder {str(folder)!r} holds no archipelago ({CONFIG}: {error.strerror}).") from error
    except ValueError as error:
        raise EcologyError(f"{str(path)!r} is not TOML: {error}.") from error
    known = {**PLAIN, "settings": dict, "forked": dict}
    for key, value in words.items():
        if key not in known:
            raise EcologyError(f"{str(path)!r} has an unknown key {key!r}. {nearest(key, known)}")
        if type(value) is not known[key]:
            raise EcologyError(f"{str(path)!r}: {key} is a {known[key].__name__}, got {value!r}.")
    for key in ("archipelago", "ticks", "settings"):
        if key not in words:
            raise EcologyError(f"{str(path)!r} has no {key}; restore the file.")
    return words


def island_seed(seed: int, number: int) -> int:
    """Return the seed of the island `number`, whatever the number of islands."""
    return int(stream(seed, ISLAND, number).generate_state(1, np.uint64)[0] >> np.uint64(33))


def stream(seed: int, *words: int) -> np.random.SeedSequence:
    """Return the seed of an archipelago's random numbers for one concern, tick and what else `words` say."""
    return np.random.SeedSequence(seed, spawn_key=(STREAM, *words))


def _beside(name: str, archipelago: str) -> str:
    """Return the scenario of an island; a file is named relative to that of the archipelago."""
    if not source.is_file(name) or os.path.isabs(name):
        return name
    home = Path(archipelago) if source.is_file(archipelago) else Path(scenarios.archipelago_file(archipelago))
    return str(home.absolute().parent / name)


def _learner(word: str, archipelago: str) -> str:
    """Return the learner of an island, "NAME" or "SPECIES=NAME"; a file as `_beside`."""
    species, sign, name = word.rpartition("=")
    return f"{species}{sign}{_beside(name, archipelago)}"
