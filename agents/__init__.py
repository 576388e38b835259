"""Learners, and the policies that they are compared with."""

from __future__ import annotations

import functools
import importlib
import importlib.util
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ecology import faults
from ecology.agents.base import Learner
from ecology.beside import importable_beside
from ecology.errors import EcologyError, nearest

if TYPE_CHECKING:
    from ecology.env import Ecology
    from ecology.model import Group
    from ecology.world import Tick

# name -> module, class, the mapping in the module that holds its settings where they are not the
# defaults, and a line for `ecology list`; loaded when asked for
LEARNERS: Mapping[str, tuple[str, str, str | None, str]] = {
    "hjb": (
        "ecology.agents.hjb",
        "HJB",
        None,
        "f and J learned online, acting by the Hamilton-Jacobi-Bellman equation",
    ),
    "algorithm1": (
        "ecology.agents.hjb",
        "HJB",
        "ALGORITHM1",
        "the paper's Algorithm 1 as printed, without additions",
    ),
    "lean": (
        "ecology.agents.hjb",
        "HJB",
        "LEAN",
        "hjb with little work per agent, for many agents",
    ),
    "inferring": (
        "ecology.agents.hjb.inferring",
        "Inferring",
        None,
        "hjb that infers what others feel from signs it knows of itself",
    ),
    "crowd": (
        "ecology.agents.hjb",
        "HJB",
        "CROWD",
        "hjb with a small memory and little work per agent, for thousands of agents",
    ),
    "random": ("ecology.agents.baselines", "Random", None, "every open action with the same probability"),
    "rest": ("ecology.agents.baselines", "Rest", None, "does nothing for as long as its body lets it"),
    "greedy": ("ecology.agents.baselines", "Greedy", None, "the least predicted drive one tick ahead"),
    "qvalue": ("ecology.agents.baselines", "QValue", None, "the least mean drive seen after an action"),
}

HERE = Path(__file__).parent
faults.HOUSE.add(str(HERE))
faults.SHIPPED.update(map(str, (HERE / "baselines.py", *(HERE / "hjb").glob("*.py"))))


def learner_class(name: str) -> type[Learner]:
    """Return the class of the learner `name`, or of one in a file: "path.py", or "path.py:Class" where it has several.

    Loading a file runs its code: load only files that you trust.
    """
    if name in LEARNERS:
        module, cls, _, _ = LEARNERS[name]
        return getattr(importlib.import_module(module), cls)
    own = re.fullmatch(r"(.+\.py)(?::(\w+))?", name)
    if not own:
        raise EcologyError(
            f"there is no learner {name!r}. {nearest(name, LEARNERS)} One of your own is given by the path of its "
            "file, as my_learner.py, or as my_learner.py:Class."
        )
    path = Path(own[1]).absolute()
    if not path.is_file():
        raise EcologyError(f"there is no learner file {own[1]!r}; give the path of a .py file.")
    found = _classes(path, path.stat().st_mtime_ns)
    wanted = [own[2]] if own[2] else list(found)
    if len(wanted) != 1 or wanted[0] not in found:
        raise EcologyError(
            f"a learner file defines a subclass of ecology.agents.base.Learner, and of several one is named, as "
            f"{path.name}:Class; {own[1]!r} defines {', '.join(found) or 'none'}, and {own[2] or 'none'} is named."
        )
    return found[wanted[0]]


@functools.lru_cache
def _classes(path: Path, changed: int) -> dict[str, type[Learner]]:  # noqa: ARG001  (a file that changed is another)
    """Return the learners that the file at `path` defines, by name."""
    spec = importlib.util.spec_from_file_location(f"ecology.agents._loaded_{path.stem}", path)
    assert spec is not None  # it ends in .py
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = loaded  # dataclasses look their module up
    try:
        with importable_beside(path):
            spec.loader.exec_module(loaded)
    except SyntaxError as error:
        raise EcologyError(f"the learner file {str(path)!r} is no Python: {error}.") from error
    return {
        key: each
        for key, each in vars(loaded).items()
        if isinstance(each, type) and issubclass(each, Learner) and each.__module__ == spec.name
    }


def settings(name: str) -> dict[str, Any]:
    """Return the settings of the learner `name` with their defaults."""
    cls = learner_class(name)
    module, _, preset, _ = LEARNERS.get(name, ("", "", None, ""))
    return {**cls.defaults(), **(getattr(importlib.import_module(module), preset) if preset else {})}


def make(
    name: str, group: Group, seed: np.random.SeedSequence, settings_: Mapping[str, Any], device: str = "cpu"
) -> Learner:
    """Return a learner `name` for the slots of `group`; `settings_` where they are not the defaults.

    It computes on `device` if it can, else on the CPU. EcologyError where the device is not here, or a
    setting is not the learner's.
    """
    cls, known = learner_class(name), settings(name)
    for key in settings_:
        if key not in known:  # told here: several learners are of one class
            raise EcologyError(f"the learner {name} has no setting {key!r}. {nearest(key, known)}")
    for trait in group.inherited:
        if trait.setting not in cls.heritable:
            can = f"it can be {', '.join(cls.heritable)}" if cls.heritable else "no setting of it can be"
            raise EcologyError(
                f"the trait {trait.name!r} of {group.name!r} is of learner.{trait.setting}, which cannot be a trait of "
                f"the learner {name}: {can}. Choose another learner or another number."
            )
    words = {"device": device} if cls.devices else {}
    return cls.with_settings(group, seed, {**known, **settings_}, **words)


class LoadedRun(NamedTuple):
    """A run as its last checkpoint left it: the first three arguments of `agents.loop.run`."""

    env: Ecology
    learners: dict[str, Learner]  # by species
    tick: Tick


def load(
    folder: str | Path,
    *,
    frozen: bool = False,
    epsilon: float = 0.05,
    device: str | None = None,
    source: str | None = None,
    trust: bool = False,
) -> LoadedRun:
    """Return the world and the learners of a run folder, as its last checkpoint left them.

    `loop.run(*agents.load("runs/paper-0"), ticks=1_000)` continues the run exactly, in memory; the folder stays as it
    is. With `frozen` the learners stop learning and explore with `epsilon`, as in `ecology evaluate`. They compute on
    `device`, or where the run's did. Raises EcologyError where `folder` holds no run or no whole checkpoint.

    A run of a scenario file runs the code of that file. If the file has changed since or is missing, EcologyError is
    raised unless `source` says which code to run: "kept", the copy in the run's folder, or "current", the file.
    Code that you have not run before on this machine is run only with `trust`.
    """
    runs = importlib.import_module("ecology.lab.runs.run")  # the floor above, which knows run folders
    run = runs.open_run(Path(folder), device=device, choice=source, trust=trust)
    run.restore()
    if frozen:
        for learner in run.learners.values():
            learner.evaluating(epsilon)
    return LoadedRun(run.env, run.learners, run.tick)
