"""The plan of a run: the scenario, its settings and its learners, resolved from what a user typed."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import importlib.metadata
import json
import math
import os
import platform
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import tomli_w

import ecology
from ecology import EcologyError, Scenario, agents, scenarios
from ecology.archipelago import as_island
from ecology.errors import nearest
from ecology.heredity import learner_traits
from ecology.lab.runs import source
from ecology.lab.runs.folder import CONFIG
from ecology.lab.runs.gate import Gate

CHECKPOINT_EVERY = 10_000  # ticks
RECORD_EVERY = 10  # ticks
PACKAGE = "ecology-sandbox"  # the name under which the project is installed


@dataclass(frozen=True, kw_only=True)
class Choice:
    """The learner of a species, with every setting resolved."""

    name: str
    settings: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class Plan:
    """All settings of a run, resolved; config.toml holds exactly this."""

    scenario: str  # name, or path of a file
    settings: Mapping[str, Any]  # of the scenario
    learners: Mapping[str, Choice]  # by species
    ticks: int
    seed: int = 0
    device: str = "cpu"
    record: bool = True  # whether metrics and a recording are written
    record_every: int = RECORD_EVERY  # ticks between two rows of an agent
    record_detail: str = "auto"  # of the recording: full, lean, or by the number of agents
    checkpoint_every: int = CHECKPOINT_EVERY  # ticks
    keep_every: int = 0  # ticks between two checkpoints that are kept for good; 0 keeps none
    forked: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # of which run, when, and what was changed
    island: Mapping[str, Any] = dataclasses.field(default_factory=dict)  # which of how many, and who migrates
    copies: Path | None = None  # folder to load the user's own code from, None: its place; not in the config
    world: Scenario | None = dataclasses.field(default=None, compare=False, repr=False)  # as loaded, not in the config

    @property
    def code(self) -> list[str]:
        """Return the scenario and the learners, by their names or files."""
        return [self.scenario, *(choice.name for choice in self.learners.values())]

    def load(self) -> Scenario:
        """Return the scenario of the run, loaded once."""
        if self.world is not None:
            return self.world
        changes, name = dict(self.settings), source.locate(self.scenario, self.copies)
        if "ticks" in scenarios.settings(name):
            changes["ticks"] = self.ticks
        return as_island(source.with_origins(scenarios.load(name, **changes), self.copies), self.island)

    def to_toml(self) -> str:
        """Return the text of config.toml."""
        world = self.load()
        words = {
            **{key: getattr(self, key) for key in PLAIN},
            "settings": self.settings,
            "learners": {
                species: {"name": choice.name, "settings": choice.settings} for species, choice in self.learners.items()
            },
            **({"forked": self.forked} if self.forked else {}),
            **({"island": self.island} if self.island else {}),
            "made_with": {
                "world": world_digest(world),
                "dt": float(world.dt),
                "python": platform.python_version(),
                **versions(),
            },
        }
        again = (
            "ecology fork, as [forked] says" if self.forked else "ecology run --config config.toml --out ANOTHER_FOLDER"
        )
        head = f"# Repeat this run with: {again}\n"
        return (
            head + "# [made_with] says what it was made with and is not read.\n" + tomli_w.dumps(toml_value(words, ""))
        )


PLAIN = {  # keys of config.toml that are not tables, and what they are
    "scenario": str,
    "ticks": int,
    "seed": int,
    "device": str,
    "record": bool,
    "record_every": int,
    "record_detail": str,
    "checkpoint_every": int,
    "keep_every": int,
}
TABLES = ("settings", "learners", "forked", "island", "made_with")
# fields that are younger than checkpoints, which know nothing of them: left out where they hold their default
LATER: Mapping[str, Mapping[str, Any]] = {
    "Arena": {"holes": (), "doors": ()},
    "Need": {"set_range": None, "adaptation": None, "weight": 1.0, "excess": 1.0, "feeds": {}},
    "Adaptation": {"by": None},
    "Resource": {"decay": 0.0, "gone_below": None, "present": None, "seeding": None},
    "Scenario": {
        "cues": (),
        "schedule": (),
        "sessions": (),
        "memory": {},
        "fields": (),
        **{"props": None, "sample_every": None, "until_extinct": False, "numbering": (0, 1)},
    },
    "Species": {
        **{"cues": (), "stages": (), "drive_power": 2.0, "traits": ()},
        **{"remains": None, "exposures": (), "faults": (), "carries": {}},
    },
    "Birth": {"parents": 1, "mates_within": math.inf, "limit": math.inf},
    "Neighbours": {"action": False, "kin": False, "identity": 0},
    "Action": {"emits": {}, "into": None, "amount": 0.0, "drain": {}, "by_stock": False, "cue": None},
}


def read_config(path: Path) -> dict[str, Any]:
    """Return the words of a config.toml; EcologyError where it is not one."""
    try:
        words = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise EcologyError(f"the config {str(path)!r} cannot be read: {error.strerror}.") from error
    except ValueError as error:  # TOML and UTF-8
        raise EcologyError(f"the config {str(path)!r} is not TOML: {error}.") from error
    for key, value in words.items():
        if key not in PLAIN and key not in TABLES:
            raise EcologyError(
                f"the config {str(path)!r} has an unknown key {key!r}. {nearest(key, [*PLAIN, *TABLES])}"
            )
        kind = PLAIN.get(key, dict)
        if type(value) is not kind:
            raise EcologyError(f"the config {str(path)!r}: {key} is a {kind.__name__}, got {value!r}.")
    island = words.get("island", {"number": 0, "islands": 1, "species": []})
    kinds = {key: type(value) for key, value in island.items()}
    if kinds != {"number": int, "islands": int, "species": list} or not 0 <= island["number"] < island["islands"]:
        raise EcologyError(
            f"the config {str(path)!r}: [island] holds the number of the island, of how many islands, and the species "
            f"that migrate, got {island!r}."
        )
    for species, choice in words.get("learners", {}).items():
        good = isinstance(choice, dict) and set(choice) <= {"name", "settings"} and isinstance(choice.get("name"), str)
        if not good or not isinstance(choice.get("settings", {}), dict):
            raise EcologyError(
                f"the config {str(path)!r}: [learners.{species}] holds a name and a table settings, got {choice!r}."
            )
    return words


def resolve(
    scenario: str | None = None,
    *,
    config: Mapping[str, Any] | None = None,
    changes: Mapping[str, Any] | None = None,
    learners: Sequence[str] = (),
    copies: Path | None = None,
    gate: Gate | None = None,
    **flags: Any,
) -> Plan:
    """Return the plan of a run from what a user typed.

    `config` is as `read_config` returned it; `changes` are settings by name, those of learners as
    "learner.KEY" or "SPECIES.learner.KEY"; `learners` are "NAME" or "SPECIES=NAME"; `flags` are the
    plan's other fields, None where not given. What was typed goes before the config, the config
    before the scenario's defaults. The user's own code is loaded from the folder `copies`, if given. What the
    config names is run if the `gate` admits it.
    """
    words, changes = dict(config or {}), dict(changes or {})
    words |= {key: value for key, value in flags.items() if value is not None}
    if scenario is None:
        scenario = words.get("scenario")
        if scenario is None:
            raise EcologyError(
                f"name a scenario to run. Known: {', '.join(scenarios.names())}, or a path to a .py file."
            )
        _admit(gate, [scenario], copies)
    elif words.get("scenario", scenario) != scenario:
        raise EcologyError(
            f"the config is of the scenario {words['scenario']!r}, not {scenario!r}; leave the scenario out."
        )
    tweaks = {key: changes.pop(key) for key in list(changes) if "." in key}
    settings = {**words.get("settings", {}), **changes}
    file = source.locate(scenario, copies)
    if "ticks" in scenarios.settings(file):  # a setting of that name is the length of the run
        if flags.get("ticks") is None and "ticks" in changes:
            words["ticks"] = changes["ticks"]
        if "ticks" in words:
            settings["ticks"] = words["ticks"]
    ticks = words.get("ticks")
    island = words.get("island", {})
    world = as_island(source.with_origins(scenarios.load(file, **settings), copies), island)
    chosen = _choose_learners(world, words.get("learners", {}), learners)
    ticks = world.ticks if ticks is None else ticks
    typed = {_full_name(word.rpartition("=")[2]) for word in learners}
    _admit(gate, [name for name, _ in chosen.values() if name not in typed], copies)
    resolved = _apply_tweaks(world, chosen, tweaks, copies)
    _check_device(words.get("device", "cpu"), {source.locate(name, copies) for name, _ in resolved.values()})
    plan = Plan(
        scenario=_full_name(scenario),
        settings={key: value for key, value in world.settings.items() if key != "ticks"},
        learners={owner: Choice(name=name, settings=own) for owner, (name, own) in resolved.items()},
        ticks=ticks,
        forked=words.get("forked", {}),
        island=island,
        copies=copies,
        **{
            "record_every": world.sample_every or RECORD_EVERY,
            **{key: words[key] for key in PLAIN if key in words and key not in ("scenario", "ticks")},
        },
    )
    for key, low in (("ticks", 1), ("seed", 0), ("record_every", 1), ("checkpoint_every", 1), ("keep_every", 0)):
        if getattr(plan, key) < low:
            raise EcologyError(f"{key} must be a whole number of at least {low}, got {getattr(plan, key)!r}.")
    if plan.record_detail not in ("auto", "full", "lean"):
        raise EcologyError(f"record_detail is auto, full or lean, got {plan.record_detail!r}.")
    as_run = world.settings.get("ticks", ticks) == ticks
    return dataclasses.replace(plan, world=world if as_run else plan.load())


def _choose_learners(
    world: Scenario, given: Mapping[str, Any], learners: Sequence[str]
) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return name and settings of the learner of every species: as typed, else as `given` in a config, else its own."""
    chosen = {}
    for species in world.species:
        of_config = given.get(species.name, {})
        default = _full_name(species.learner)
        name = _full_name(of_config.get("name", default))
        own = of_config.get("settings", species.learner_settings if name == default else {})
        chosen[species.name] = (name, dict(own))
    for word in learners:
        species_name, _, name = word.rpartition("=")
        name = _full_name(name)
        for owner in _owners(species_name, chosen):
            if chosen[owner][0] != name:
                chosen[owner] = (name, {})
    for unknown in given.keys() - chosen.keys():
        raise EcologyError(f"[learners.{unknown}]: there is no such species. {nearest(unknown, chosen)}")
    return chosen


def _admit(gate: Gate | None, names: Iterable[str], copies: Path | None) -> None:
    """Ask the gate, if there is one, whether the code of `names` may be run."""
    if gate is not None:
        gate.admit(map(_full_name, names), copies)


def _full_name(name: str) -> str:
    """Return the name of a scenario or a learner; where it is a file, by its whole path."""
    return os.path.abspath(name) if source.is_file(name) else name


Chosen = dict[str, tuple[str, dict[str, Any]]]  # species -> learner, settings


def _owners(species: str, chosen: Chosen) -> list[str]:
    """Return the species that are meant: the one named, or all where none is."""
    if species and species not in chosen:
        raise EcologyError(f"there is no species {species!r} to learn in. {nearest(species, chosen)}")
    return [species] if species else list(chosen)


def _apply_tweaks(world: Scenario, chosen: Chosen, tweaks: Mapping[str, Any], copies: Path | None) -> Chosen:
    """Return every learner with its defaults filled in and `tweaks` applied."""
    inherited = {species.name: learner_traits(species) for species in world.species}
    defaults = {owner: agents.settings(source.locate(name, copies)) for owner, (name, _) in chosen.items()}
    full = {owner: (name, {**defaults[owner], **own}) for owner, (name, own) in chosen.items()}
    for key, value in tweaks.items():
        match = re.fullmatch(r"(?:(\w+)\.)?learner\.(\w+)", key)
        if match is None:
            raise EcologyError(f"a setting is written KEY, learner.KEY or SPECIES.learner.KEY, got {key!r}.")
        owners = _owners(match[1] or "", chosen)
        takers = [owner for owner in owners if match[2] in defaults[owner]]
        if not takers:
            names = sorted({full[owner][0] for owner in owners})
            known = sorted({setting for owner in owners for setting in defaults[owner]})
            raise EcologyError(
                f"the learner {' and '.join(names)} has no setting {match[2]!r}. {nearest(match[2], known)}"
            )
        for owner in takers:
            for trait in inherited[owner]:
                if trait.setting == match[2]:
                    raise EcologyError(
                        f"{key} is inherited: the trait {trait.name!r} of {owner!r} gives every agent a number of its "
                        "own. Set the trait's start in the scenario instead."
                    )
            if value is None and defaults[owner][match[2]] is not None:  # no config holds it
                raise EcologyError(f"the setting {key!r} is like {defaults[owner][match[2]]!r}; got None.")
            full[owner][1][match[2]] = value
    return full


def _check_device(device: str, learners: Iterable[str]) -> None:
    """Raise EcologyError where it is no device, or none of the learners computes on one."""
    if device == "cpu":
        return
    from ecology.agents.hjb import devices  # slow to load

    devices.check_device(device)
    if not any(agents.learner_class(name).devices for name in learners):
        able = [name for name in agents.LEARNERS if agents.learner_class(name).devices]
        raise EcologyError(
            f"the learner {' and '.join(map(repr, sorted(learners)))} computes on the CPU alone, "
            f"{', '.join(able)} on any device; leave out --device {device}."
        )


def world_digest(world: Scenario) -> str:
    """Return a digest of all that a scenario says of its world, whatever the length of the run."""
    words = words_of(world, ticks=1, settings={}, props=None, sample_every=None, until_extinct=False)
    return hashlib.sha256(json.dumps(words, sort_keys=True).encode()).hexdigest()


def words_of(value: Any, **changes: Any) -> Any:
    """Return frozen words as JSON holds them: the same in every process, whatever the order of a mapping.

    `changes` are values of fields of `value` that are taken instead of its own.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        words = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)} | changes
        later = LATER.get(type(value).__name__, {})
        return {name: words_of(each) for name, each in words.items() if name not in later or each != later[name]}
    if isinstance(value, Mapping):
        return {str(key): words_of(each) for key, each in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [words_of(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    plain = value is None or isinstance(value, (str, bool, int, float))
    if plain:
        return value
    # a scenario file's module, by the name that it had when the first checkpoints were written
    return re.sub(r" at 0x[0-9a-fA-F]+", "", repr(value)).replace("ecology.scenarios._loaded_", "scenarios._loaded_")


@functools.cache  # reads the metadata of some twenty packages
def versions() -> Mapping[str, str]:
    """Return the versions of the project and of what it depends on, as installed."""
    found = {"ecology": ecology.__version__}
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):
        for requirement in importlib.metadata.requires(PACKAGE) or []:
            name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
            if "extra ==" not in requirement:
                found[name] = importlib.metadata.version(name)
    return MappingProxyType(found)


def toml_value(value: Any, where: str) -> Any:
    """Return what TOML holds in the place of `value`; None is left out."""
    if isinstance(value, Mapping):
        return {str(k): toml_value(v, f"{where}.{k}".lstrip(".")) for k, v in value.items() if v is not None}
    if isinstance(value, (list, tuple)):
        return [toml_value(v, where) for v in value]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (str, bool, int, float)):
        return value
    raise EcologyError(
        f"the setting {where} cannot be written to {CONFIG}: a setting is a number, a word, true or false, "
        f"or a list of those, got {value!r}."
    )
