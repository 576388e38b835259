"""Scenarios: a file in this folder that defines `build` is a scenario; there is no registry."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import cloudpickle
import gymnasium

from ecology import EcologyError, GymEnv, Scenario, faults, gym_env
from ecology.beside import importable_beside
from ecology.errors import describe_refusal, nearest
from ecology.typed import plain

HERE = Path(__file__).parent
faults.HOUSE.add(str(HERE))
EPISODE = 1000  # ticks after which a Gymnasium episode of a scenario is truncated, unless told otherwise


def names() -> list[str]:
    """Return the names of the scenarios that ship, sorted."""
    return sorted(path.stem for path in HERE.glob("*.py") if not path.stem.startswith("_"))


def module(name: str) -> ModuleType:
    """Return the module of the scenario `name`, or of the file at the path `name`.

    Running a scenario file runs its code: load only files that you trust.
    """
    path = Path(name)
    if path.suffix == ".py":
        try:
            is_there = path.is_file()
        except OSError as error:
            raise EcologyError(
                f"the scenario file cannot be read ({describe_refusal(error)}); give another."
            ) from error
        if not is_there:
            raise EcologyError(f"there is no scenario file {name!r}; give the path of a .py file.")
    elif name in names():
        path = HERE / f"{name}.py"
    else:
        beside = f"{name}.py"
        meant = f"Did you mean the file {beside!r}?" if os.path.isfile(beside) else nearest(name, names())
        raise EcologyError(
            f"there is no scenario {name!r}. {meant} A file of your own is given by its path, ending in .py."
        )
    spec = importlib.util.spec_from_file_location(f"ecology.scenarios._loaded_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise EcologyError(f"the scenario file {str(path)!r} cannot be loaded as Python.")
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = loaded
    try:
        with contextlib.nullcontext() if path.parent == HERE else importable_beside(path):
            spec.loader.exec_module(loaded)
    except EcologyError:
        raise
    except (Exception, SystemExit) as error:
        raise faults.named(f"the scenario file {str(path)!r} does not run", error) from error
    _pickle_by_value(loaded, path.parent)
    if not callable(getattr(loaded, "build", None)):
        raise EcologyError(
            f"the scenario file {str(path)!r} must define a function `build` that returns an ecology.Scenario."
        )
    return loaded


def _pickle_by_value(loaded: ModuleType, folder: Path) -> None:
    """Let the functions of a scenario file, and of modules beside it, be pickled whole: other processes lack them."""
    home = os.path.abspath(folder)
    beside = [
        other
        for name, other in sys.modules.items()
        if folder != HERE and "." not in name and name != "__main__" and _folder_of(other) == home
    ]
    for each in (loaded, *beside):
        cloudpickle.register_pickle_by_value(each)


def _folder_of(module_: ModuleType) -> str | None:
    """Return the folder of the module's file; None of a package and of what has no file."""
    file = getattr(module_, "__file__", None)
    return None if file is None or hasattr(module_, "__path__") else os.path.dirname(os.path.abspath(file))


def settings(name: str) -> dict[str, Any]:
    """Return the settings of the scenario `name` with their defaults: the parameters of `build`."""
    return _defaults(name, module(name).build)


def load(name: str, /, **changes: Any) -> Scenario:
    """Return the scenario `name` (or the file at that path) with `changes` to its settings."""
    build = module(name).build
    defaults = _defaults(name, build)
    resolved = {**defaults, **_checked(name, defaults, changes)}
    try:
        scenario = build(**resolved)
    except EcologyError:
        raise
    except (Exception, SystemExit) as error:
        raise faults.named(f"the scenario {name!r} cannot be built with {changes}", error) from error
    if not isinstance(scenario, Scenario):
        raise EcologyError(
            f"`build` of the scenario {name!r} must return an ecology.Scenario, got {type(scenario).__name__}."
        )
    return dataclasses.replace(scenario, settings=resolved)


def _defaults(name: str, build: Callable[..., Any]) -> dict[str, Any]:
    parameters = inspect.signature(build).parameters
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty:
            raise EcologyError(
                f"every parameter of `build` is a setting with a default; in scenario {name!r} {key!r} has none."
            )
    return {key: parameter.default for key, parameter in parameters.items()}


def _checked(name: str, defaults: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    checked = {}
    for key, value in changes.items():
        if key not in defaults:
            raise EcologyError(f"the scenario {name!r} has no setting {key!r}. {nearest(key, defaults)}")
        default, value = defaults[key], plain(value)
        if isinstance(default, bool) or isinstance(value, bool):
            good = isinstance(default, bool) and isinstance(value, bool)
        elif isinstance(default, float):
            good = isinstance(value, (int, float))
            value = float(value) if good else value
        elif isinstance(default, tuple):
            good = isinstance(value, (tuple, list)) and len(value) == len(default)
            value = tuple(value) if good else value
        elif default is None:
            good = True
        else:
            good = isinstance(value, type(default))
        if not good:
            raise EcologyError(f"the setting {key!r} of scenario {name!r} is like {default!r}; got {value!r}.")
        checked[key] = value
    return checked


def make_gym(name: str, *, horizon: int | None = None, render_mode: str | None = None, **changes: Any) -> GymEnv:
    """Return the scenario `name`, with `changes` to its settings, as a Gymnasium environment."""
    return gym_env(load(name, **changes), horizon=horizon, render_mode=render_mode)


def _register() -> None:
    """Register every scenario that ships with Gymnasium, as "ecology/NAME-v0"; `make` loads it."""
    for name in names():
        faults.SHIPPED.add(str(HERE / f"{name}.py"))
        id_ = f"ecology/{name}-v0"
        if id_ not in gymnasium.registry:
            gymnasium.register(
                id_, entry_point="ecology.scenarios:make_gym", max_episode_steps=EPISODE, kwargs={"name": name}
            )


_register()
