"""Files of a user's own may import the files beside them, as in a script."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def importable_beside(path: Path) -> Iterator[None]:
    """Let the file at `path` import modules of its folder first, as `python path` would, while it is run.

    A module of the same name from another such folder is loaded anew. The folder stays the last one in which Python
    looks, for imports within functions.
    """
    folder = str(path.absolute().parent)
    others = set(_folders) - {folder}
    for name, module in list(sys.modules.items()):
        top, file = name.partition(".")[0], getattr(module, "__file__", None)
        from_other = file is not None and any(Path(file).is_relative_to(other) for other in others)
        if from_other and _is_in(folder, top):
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


def _is_in(folder: str, name: str) -> bool:
    return Path(folder, f"{name}.py").is_file() or Path(folder, name, "__init__.py").is_file()
