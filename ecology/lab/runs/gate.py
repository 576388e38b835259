"""Whether the code that a run folder names may be run: only if this user has run it before, or says so.

What a user runs from the command line or from Python is noted in a list of that user, in the format of `sha256sum`: a
line "DIGEST  PATH" for every file. The code that a folder names is compared with the list before any of it is run.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from importlib.machinery import all_suffixes
from pathlib import Path

from ecology import EcologyError, agents, faults, scenarios
from ecology.errors import readable
from ecology.lab.runs import source
from ecology.lab.runs.trust import File, note, read_list

IMPORTABLE = tuple(all_suffixes())  # endings of the files that Python imports
CACHE = "__pycache__"  # Python would run what it finds there in the place of the source


@dataclass(frozen=True)
class Gate:
    """Lets the code of a run folder in, or raises EcologyError: see `admit`."""

    choice: str | None = None  # of `source.choose`
    trust: bool = False  # whether to run code that this user has not run before
    say: Callable[[str], None] | None = None  # is told whose code is run, a line for each file
    _said: set[File] = field(default_factory=set)

    def admit(self, names: Iterable[str], copies: Path | None) -> None:
        """Raise EcologyError unless all that the scenarios and learners `names` would run, from `copies`, may be run.

        What ships may always be run, a file in its place if this user has run it from there, and a copy if this user
        has run a file of the same contents. With the choice `source.CURRENT`, a file in its place may have changed
        since. Where `trust` lets other code in, it is noted.
        """
        named = [name for name in names if ".py" in name and not _is_shipped(name)]
        for name in named:
            if not source.is_file(name):
                raise EcologyError(f"a scenario or learner file is named by a path ending in .py, got {name!r}.")
        if not named:
            return
        beside = [] if copies is None else _check_copies(copies)
        files = list(dict.fromkeys([*_files(named, copies), *beside]))
        known = read_list()
        digests, paths = {each.sha256 for each in known}, {each.path for each in known}
        if copies is not None:
            inside = f"{copies.absolute()}{os.sep}"
            new = [
                each
                for each in files
                if not (each.sha256 in digests if each.path.startswith(inside) else each in known)
            ]
        elif self.choice == source.CURRENT and all(each.path in paths for each in _files(named, copies, alone=True)):
            new = []
        else:
            new = [each for each in files if each not in known]
        if new and not self.trust:
            raise EcologyError(
                f"the run names code that does not ship with this program and that you have not run before: "
                f"{'; '.join(f'{each.path!r} (sha256 {each.sha256})' for each in new)}. Such code can do whatever you "
                "can. Read it, and pass --trust to run it."
            )
        if self.say is not None:
            for each in [each for each in files if each not in self._said]:
                self.say(f"runs the code of {each.path} (sha256 {each.sha256})")
            self._said.update(files)
        note(new)


def _is_shipped(name: str) -> bool:
    """Return whether a scenario or a learner is one of those that ship, by its name or its file."""
    if name in scenarios.names() or name in scenarios.archipelago_names() or name in agents.LEARNERS:
        return True
    return source.is_file(name) and os.path.abspath(source.split(name)[0]) in faults.SHIPPED


def _files(names: Iterable[str], copies: Path | None, *, alone: bool = False) -> list[File]:
    """Return the files that `names` would run, or those `alone` that are named; a file that is missing is left out."""
    found: dict[File, None] = {}
    for name in names:
        file = Path(source.split(source.locate(name, copies))[0]).absolute()
        if file.is_file():
            for path in [file] if alone else sorted(source.modules(file)):
                found[_file(path)] = None
    return list(found)


def _file(path: Path) -> File:
    with readable("the source file", path):
        return File(str(path), hashlib.sha256(path.read_bytes()).hexdigest())


def _check_copies(copies: Path) -> list[File]:
    """Return all code in a folder of copies, after removing what Python has compiled there.

    Any of it may be imported, by whatever is imported. Raises EcologyError where some of it was not copied.
    """
    wanted, found = source.paths_of_copies(copies), []
    if copies.is_symlink():
        raise EcologyError(f"{str(copies)!r} is a link, and not the folder that was written when the run started.")
    for folder, folders, files in os.walk(copies):
        for name in [each for each in folders if each == CACHE]:
            folders.remove(name)
            try:
                shutil.rmtree(Path(folder, name))
            except OSError as error:
                raise EcologyError(
                    f"{str(Path(folder, name))!r} cannot be removed ({error.strerror}), and Python would run what lies "
                    "in it; remove it."
                ) from error
        for name in [each for each in files if each.endswith(IMPORTABLE)]:
            if (path := Path(folder, name)).relative_to(copies).as_posix() not in wanted:
                raise EcologyError(f"{str(path)!r} is no copy that was made when the run started; move it away.")
            found.append(_file(path.absolute()))
        for name in folders:
            if (path := Path(folder, name)).is_symlink():
                raise EcologyError(f"{str(path)!r} is a link, and no copy that was made when the run started.")
    return found
