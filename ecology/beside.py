"""Files of a user's own may import the files beside them, as in a script."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def importable_beside(path: Path) -> Iterator[None]:
    """Let the file at `path` import modules of its folder first, as `python path` would, while it is run.

    A module of the same name from another such folder is loaded again. The folder stays the last one in which Python
    looks, for imports within functions.
    """
    folder = str(path.absolute().parent)
    others = tuple(f"{other}{os.sep}" for other in _folders if other != folder)
    here = _names_in(folder) if others else set()
    for name, module in sys.modules.copy().items():  # a copy: garbage collection may import meanwhile
        if name.partition(".")[0] in here - {"ecology"} and str(getattr(module, "__file__", None)).startswith(others):
            del sys.modules[name]
    if folder not in sys.path:
        sys.path.append(folder)
    _folders[folder] = None
    sys.path.insert(0, folder)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):
            sys.path.remove(folder)  # the first one; the last one stays


_folders: dict[str, None] = {}  # in which files of a user's own were run


def _names_in(folder: str) -> set[str]:
    """Return the names of the modules and packages that lie in a folder."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        return {
            entry.name.removesuffix(".py")
            for entry in entries
            if entry.name.endswith(".py") or os.path.isfile(os.path.join(entry.path, "__init__.py"))
        }
    return set()
