"""The user's own code behind a run: a copy in the run's folder, and the choice between that and the files in place.

A user's own code is a scenario file, a learner file, and the modules that they import from beside them.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import hashlib
import json
import os
import re
import shutil
import sys
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

from ecology import EcologyError, Scenario, faults
from ecology.errors import readable
from ecology.lab.runs import trust

SOURCE = "source"  # folder in a run's folder
ORIGINS = "origins.json"  # in it: where each file came from, and its digest
KEPT, CURRENT = "kept", "current"  # the copies, or the files in their places
PARSING = threading.Lock()  # Python 3.11 counts the depth of two trees that are read at once as one


class Origin(NamedTuple):
    """Where a copied file came from, and the digest of what it held."""

    path: str
    sha256: str


def is_file(name: str) -> bool:
    """Return whether a scenario or a learner is named by its file, as "path.py" or "path.py:Class"."""
    return re.search(r"\.py(:\w+)?$", name) is not None


def choose(folder: Path, choice: str | None = None) -> Path | None:
    """Return the folder to load the own code of the run in `folder` from; None: the files in their places.

    Without a choice, raise EcologyError if one of the files is missing, or has changed since the run started.
    """
    copies = folder / SOURCE
    if choice not in (None, KEPT, CURRENT):
        raise EcologyError(f"the source of a run is {KEPT} or {CURRENT}, got {choice!r}.")
    if choice == CURRENT:
        return None
    origins = _read(copies)
    if choice == KEPT:
        if origins is None:
            raise EcologyError(
                f"the run {str(folder)!r} has no copy of its source: there is no {ORIGINS} in {str(copies)!r}. Drop "
                f"--source {KEPT}."
            )
        for name, origin in origins.items():
            if _digest(copies / name) != origin.sha256:
                raise EcologyError(
                    f"{str(copies / name)!r} is no longer the copy of {origin.path!r} that was made when the run "
                    f"started. Restore it, or pass --source {CURRENT} to use the files in their places."
                )
        return copies
    for origin in (origins or {}).values():
        digest = _digest(Path(origin.path))
        if digest is None:
            raise EcologyError(
                f"the run {str(folder)!r} was started from {origin.path!r}, which is no longer there. Put the file "
                f"back, or pass --source {KEPT} to use the copy in {str(copies)!r}."
            )
        if digest != origin.sha256:
            raise EcologyError(
                f"{origin.path!r} has changed since the run {str(folder)!r} used it. Undo the change, pass --source "
                f"{KEPT} to use the copy in {str(copies)!r}, or pass --source {CURRENT} to use the file as it is now."
            )
    return None


def locate(name: str, copies: Path | None) -> str:
    """Return what to load for the scenario or learner `name`: the file in its place, or its copy in `copies`."""
    if copies is None or not is_file(name):
        return name
    file, cls = split(name)
    for kept, origin in (_read(copies) or {}).items():
        if origin.path == file:
            return f"{copies / kept}{cls}"
    return name


def with_origins(world: Scenario, copies: Path | None) -> Scenario:
    """Return a scenario that was loaded from `copies`, in which learner files beside it are named by their places."""
    if copies is None:
        return world
    origins = _read(copies) or {}
    homes = {(copies / kept).absolute().parent: Path(origin.path).parent for kept, origin in origins.items()}
    species = []
    for each in world.species:
        if is_file(each.learner):
            path = Path(each.learner).absolute()
            each = dataclasses.replace(each, learner=str(homes.get(path.parent, path.parent) / path.name))
        species.append(each)
    return dataclasses.replace(world, species=tuple(species))


def keep(names: Iterable[str], folder: Path, copies: Path | None = None, *, tick: int = 0) -> None:
    """Copy the own code behind the scenario and the learners `names`, loaded from `copies`, to the run in `folder`.

    If the run went to `tick` with other code, that stays in source-until-TICK.
    """
    texts = dict(_collect(names, copies))
    origins = {name: Origin(path, hashlib.sha256(text).hexdigest()) for name, (path, text) in texts.items()}
    target, fresh, former = folder / SOURCE, folder / f"{SOURCE}.new", folder / f"{SOURCE}-until-{tick}"
    if copies is None:
        trust.note(trust.File(*origin) for origin in origins.values())
    with contextlib.suppress(EcologyError):  # damaged, and replaced
        if not texts or origins == _read(target):
            return
    shutil.rmtree(fresh, ignore_errors=True)
    for name, (_, text) in texts.items():
        (fresh / name).parent.mkdir(parents=True, exist_ok=True)
        (fresh / name).write_bytes(text)
    record = {name: origin._asdict() for name, origin in origins.items()}
    (fresh / ORIGINS).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    if target.exists() and tick and not former.exists():
        target.rename(former)
    elif target.exists():  # no tick of the run came from it
        shutil.rmtree(target)
    fresh.rename(target)


def paths_of_copies(copies: Path) -> set[str]:
    """Return what a folder of copies is to hold: the paths in it, those of the list of origins included."""
    return {ORIGINS, *(_read(copies) or {})}


def is_foreign(folder: Path) -> bool:
    """Return whether `folder` holds a folder named as the copies are, but none of a run."""
    return (folder / SOURCE).exists() and not (folder / SOURCE / ORIGINS).is_file()


def split(name: str) -> tuple[str, str]:
    """Return the file of "path.py:Class", and ":Class" or nothing."""
    end = name.rindex(".py") + len(".py")
    return name[:end], name[end:]


def _digest(path: Path) -> str | None:
    """Return the digest of a file; None if it is not there."""
    try:
        with readable("the source file", path):
            return hashlib.sha256(path.read_bytes()).hexdigest()
    except FileNotFoundError:
        return None


def _read(copies: Path) -> dict[str, Origin] | None:
    """Return where the files in a folder of copies came from, by their path in it; None if there are no copies."""
    path = copies / ORIGINS
    try:
        with readable("the list of sources", path):
            text = path.read_text(encoding="utf-8")
        found = {name: Origin(str(entry["path"]), str(entry["sha256"])) for name, entry in json.loads(text).items()}
        if away := [name for name in found if os.path.isabs(name) or ".." in Path(name).parts]:
            raise ValueError(f"{away[0]!r} lies elsewhere")
        return found
    except FileNotFoundError:
        return None
    except EcologyError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise EcologyError(
            f"the list of sources {str(path)!r} is damaged ({error}); pass --source {CURRENT} to use the files in "
            "their places."
        ) from error


def _collect(names: Iterable[str], copies: Path | None) -> Iterator[tuple[str, tuple[str, bytes]]]:
    """Yield the path of every copy, where its file belongs, and what it holds.

    Files of one folder stay together, so that they find each other: those of the first folder at the top, others in
    folders with numbers, which no module has as its name.
    """
    places: dict[Path, str] = {}  # folder that is loaded from -> folder of its copies
    for name in names:
        if is_file(name):
            home = Path(split(name)[0]).parent
            file = Path(split(locate(name, copies))[0])
            place = places.setdefault(file.parent, f"{len(places) + 1}/" if places else "")
            for path in [file, *sorted(modules(file) - {file})]:
                beside = path.relative_to(file.parent)
                yield f"{place}{beside.as_posix()}", (str(home / beside), path.read_bytes())


def modules(file: Path) -> set[Path]:
    """Return `file` and the modules beside it that it imports, directly or through one another, or has imported."""
    folder, found = file.parent, {file}
    waiting = [file]
    while waiting:
        for name in _imports(waiting.pop(), folder):
            for path in _files_of(folder, name):
                if path not in found:
                    found.add(path)
                    waiting.append(path)
    for name, module in sys.modules.copy().items():  # imported by a name that is not written out
        loaded = getattr(module, "__file__", None) or ""
        if loaded.startswith(f"{folder}{os.sep}") and Path(loaded) in _files_of(folder, name):
            found.add(Path(loaded))
    return found


def _imports(file: Path, folder: Path) -> Iterator[str]:
    """Yield the names that a file imports, as seen from `folder`; those of `from a import b` as a and as a.b."""
    package = file.relative_to(folder).parts[:-1]
    try:
        with PARSING:
            tree = ast.parse(file.read_bytes())
    except (SyntaxError, ValueError):  # a file that Python cannot read, imported when it is too late to say so
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield base
            yield from (f"{base}.{alias.name}".lstrip(".") for alias in node.names)


def _files_of(folder: Path, name: str) -> list[Path]:
    """Return the files in `folder` that the import of `a.b` runs: of the package a, and of the module b in it."""
    parts = name.split(".")
    paths = [folder.joinpath(*parts[: i + 1]) for i in range(len(parts))]
    files = [file for path in paths for file in (path.with_name(f"{path.name}.py"), path / "__init__.py")]
    return [file for file in files if file.is_file() and not faults.is_foreign(str(file))]
