"""Scenarios: a file in this folder that defines `build` is a scenario; there is no registry."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Mapping
from importlib.abc import SourceLoader
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import cloudpickle
import gymnasium

from ecology import faults
from ecology.beside import importable_beside
from ecology.errors import EcologyError, describe_refusal, nearest
from ecology.typed import plain

if TYPE_CHECKING:
    from ecology import Archipelago, GymEnv, Scenario

HERE = Path(__file__).parent
ARCHIPELAGOS = HERE / "archipelagos"
faults.HOUSE.add(str(HERE))
EPISODE = 1000  # ticks after which a Gymnasium episode of a scenario is truncated, unless told otherwise


def names() -> list[str]:
    """Return the names of the scenarios that ship, sorted."""
    return _stems(HERE)


def archipelago_names() -> list[str]:
    """Return the names of the archipelagos that ship, sorted."""
    return _stems(ARCHIPELAGOS)


def _stems(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.py") if not path.stem.startswith("_"))


def archipelago_file(name: str) -> str:
    """Return the path of the shipped archipelago `name`; else `name` itself, taken as a path."""
    return str(ARCHIPELAGOS / f"{name}.py") if name in archipelago_names() else name


def module(name: str) -> ModuleType:
    """Return the module of the scenario `name`, or of the file at the path `name`.

    Loading a scenario file runs its code: load only files that you trust. A file is run once per process, and again
    after it was changed.
    """
    path = _path_of(name)
    try:
        within = _package_of(path.resolve())
        loaded = _load_file(path) if within is None else importlib.import_module(f"{within}.{path.stem}")
    except EcologyError:
        raise
    except (Exception, SystemExit) as error:
        raise faults.wrap(f"the scenario file {str(path)!r} does not run", error) from error
    if not callable(getattr(loaded, "build", None)):
        raise EcologyError(
            f"the scenario file {str(path)!r} must define a function `build` that returns an ecology.Scenario."
        )
    return loaded


def _package_of(path: Path) -> str | None:
    """Return the package of a file that ships as a scenario or an archipelago; None of other files."""
    if path.parent == HERE.resolve() and path.stem in names():
        return __name__
    if path.parent == ARCHIPELAGOS.resolve() and path.stem in archipelago_names():
        return f"{__name__}.archipelagos"
    return None


def _path_of(name: str) -> Path:
    """Return the path of the file that holds the scenario `name`; EcologyError where there is none."""
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
        return path
    if name in names():
        return HERE / f"{name}.py"
    if name in archipelago_names():
        return ARCHIPELAGOS / f"{name}.py"
    beside = f"{name}.py"
    known = [*names(), *archipelago_names()]
    meant = f"Did you mean the file {beside!r}?" if os.path.isfile(beside) else nearest(name, known)
    raise EcologyError(
        f"there is no scenario {name!r}. {meant} A file of your own is given by its path, ending in .py."
    )


_loaded: dict[str, tuple[str, ModuleType]] = {}  # whole path of a file -> digest of what it held, and its module


def _load_file(path: Path) -> ModuleType:
    """Return the module of a file that does not ship, run unless it has been; whatever its code raises."""
    whole = os.path.abspath(path)
    with importable_beside(path):
        text = path.read_bytes()
        digest = hashlib.sha256(text).hexdigest()
        known, loaded = _loaded.get(whole, ("", None))
        if loaded is None or known != digest:
            loaded = _run_file(path, text)
            _loaded[whole] = digest, loaded
        else:
            sys.modules[loaded.__name__] = loaded  # another file of this name may have been loaded since
    _pickle_by_value(loaded, path.parent)
    return loaded


def _run_file(path: Path, text: bytes) -> ModuleType:
    """Return a new module in which `text`, what the file at `path` holds, was run."""
    spec = importlib.util.spec_from_file_location(f"{__name__}._loaded_{path.stem}", path)
    if spec is None or not isinstance(spec.loader, SourceLoader):
        raise EcologyError(f"the scenario file {str(path)!r} cannot be loaded as Python.")
    loaded = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = loaded  # dataclasses look their module up
    exec(spec.loader.source_to_code(text, os.path.abspath(path)), loaded.__dict__)
    return loaded


def _pickle_by_value(loaded: ModuleType, folder: Path) -> None:
    """Let the functions of a scenario file, and of modules beside it, be pickled whole: other processes lack them."""
    home = os.path.abspath(folder)
    beside = [
        other
        for name, other in sys.modules.copy().items()  # a thread may import something meanwhile
        if "." not in name and name != "__main__" and _folder_of(other) == home
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
    from ecology.archipelago import Archipelago  # slow to load
    from ecology.scenario import Scenario

    built = _build(name, changes)
    if isinstance(built, Archipelago):
        raise EcologyError(f"{name!r} is an archipelago, and not one world; run it with: ecology archipelago {name}")
    if not isinstance(built, Scenario):
        raise EcologyError(
            f"`build` of the scenario {name!r} must return an ecology.Scenario, got {type(built).__name__}."
        )
    return built


def load_archipelago(name: str, /, **changes: Any) -> Archipelago:
    """Return the archipelago `name` (or of the file at that path) with `changes` to its settings."""
    from ecology.archipelago import Archipelago  # slow to load

    built = _build(archipelago_file(name), changes)
    if not isinstance(built, Archipelago):
        raise EcologyError(
            f"`build` of the archipelago {name!r} must return an ecology.Archipelago, got {type(built).__name__}; one "
            f"world is run with: ecology run {name}"
        )
    return built


def _build(name: str, changes: Mapping[str, Any]) -> Any:
    """Return the result of `build` of a file, with the settings resolved."""
    build = module(name).build
    defaults = _defaults(name, build)
    resolved = {**defaults, **_check_settings(name, defaults, changes, _open_ended(build))}
    try:
        built = build(**resolved)
    except EcologyError:
        raise
    except (Exception, SystemExit) as error:
        raise faults.wrap(f"the scenario {name!r} cannot be built with {changes}", error) from error
    has_settings = dataclasses.is_dataclass(built) and hasattr(built, "settings") and not isinstance(built, type)
    return dataclasses.replace(built, settings=resolved) if has_settings else built


def _defaults(name: str, build: Callable[..., Any]) -> dict[str, Any]:
    parameters = inspect.signature(build).parameters
    for key, parameter in parameters.items():
        if parameter.default is inspect.Parameter.empty:
            raise EcologyError(
                f"every parameter of `build` is a setting with a default; in scenario {name!r} {key!r} has none."
            )
    return {key: parameter.default for key, parameter in parameters.items()}


def _open_ended(build: Callable[..., Any]) -> frozenset[str]:
    """Return the parameters of `build` that are a tuple of any length, by their annotation: tuple[float, ...]."""
    said = {key: str(parameter.annotation) for key, parameter in inspect.signature(build).parameters.items()}
    return frozenset(key for key, text in said.items() if text.startswith("tuple[") and text.endswith(", ...]"))


def _check_settings(
    name: str, defaults: Mapping[str, Any], changes: Mapping[str, Any], open_ended: frozenset[str] = frozenset()
) -> dict[str, Any]:
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
            good = isinstance(value, (tuple, list)) and (key in open_ended or len(value) == len(default))
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
    from ecology.single import gym_env  # slow to load

    return gym_env(load(name, **changes), horizon=horizon, render_mode=render_mode)


def _register() -> None:
    """Register every scenario that ships with Gymnasium, as "ecology/NAME-v0"; `make` loads it."""
    faults.SHIPPED.update(map(str, ARCHIPELAGOS.glob("*.py")))
    for name in names():
        faults.SHIPPED.add(str(HERE / f"{name}.py"))
        id_ = f"ecology/{name}-v0"
        if id_ not in gymnasium.registry:
            gymnasium.register(
                id_, entry_point="ecology.scenarios:make_gym", max_episode_steps=EPISODE, kwargs={"name": name}
            )


_register()
