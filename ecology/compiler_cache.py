"""How loops are compiled, and a folder for them, also where neither the install folder nor the home can be written.

A compiled loop stands in the file of its topic. Every such file calls `use_cache` first.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import os
import shutil
import stat
import tempfile
import types
from pathlib import Path
from typing import Any

import numba

from ecology.errors import EcologyError

_inlined: dict[str, tuple[Path, ...]] = {}  # by file, the files of the functions that are compiled into its own

PLACES = ("/dev/shm",)  # tried where Python finds no temporary folder, as in a container without a writable /tmp


def use_cache(file: str, *inlined: str) -> None:
    """Make sure that Numba can keep the compiled functions of the source `file`; call it before the first of them.

    Functions of the sources `inlined` are compiled into those of `file`: see `keep_compiled`.

    Numba keeps them beside the source, in the user's cache or in NUMBA_CACHE_DIR. Where it can write to none of these,
    NUMBA_CACHE_DIR becomes a temporary folder of this user, for this process and those that it starts. Raises
    EcologyError where no folder can be written.
    """
    _inlined[file] = tuple(map(Path, inlined))
    if not _can_cache(file):
        folder = str(_temporary_folder())
        os.environ["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]


def compiled(function: Any) -> Any:
    """Compile a loop that Python calls."""
    return keep_compiled(numba.njit(no_cfunc_wrapper=True)(function), _inlined[function.__code__.co_filename])  # type: ignore[call-overload]


def within(function: Any) -> Any:
    """Compile a loop that only other loops call."""
    quick = numba.njit(no_cfunc_wrapper=True, no_cpython_wrapper=True)  # type: ignore[call-overload]
    return keep_compiled(quick(function), _inlined[function.__code__.co_filename])


def keep_compiled(function: Any, sources: tuple[Path, ...]) -> Any:
    """Let Numba keep the compiled code of `function` on disk until its own source or one of `sources` changes.

    Numba looks at the file of a function alone, not at the files of what is compiled into it. Here the code is kept
    under a digest of all of them. Returns `function`, a dispatcher that was made without `cache`.
    """
    function.enable_caching()
    own = Path(function.py_func.__code__.co_filename)
    function._cache._cache_file._source_stamp = _digest((own, *sources))
    return function


def is_kept(function: Any) -> bool:
    """Return whether compiled code of `function`, made by its present sources, is on disk."""
    return bool(function._cache._cache_file._load_index())


@functools.lru_cache
def _digest(sources: tuple[Path, ...]) -> str:
    """Return a digest of what is written in `sources`."""
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sources)).hexdigest()


def _can_cache(file: str) -> bool:
    """Return whether Numba finds a folder for the functions of `file`."""

    def probe() -> None: ...

    stand_in = types.FunctionType(probe.__code__.replace(co_filename=file), globals(), "probe")
    try:
        numba.njit(cache=True)(stand_in)
    except RuntimeError:  # "no locator available"
        return False
    return True


def _temporary_folder() -> Path:
    """Return a folder that only this user can write: the same in every process, or else one for this process.

    Numba runs what it reads there, and anyone may have made a folder of that name.
    """
    name = f"ecology-numba-{os.getuid()}" if hasattr(os, "getuid") else "ecology-numba"
    roots: list[str] = []
    with contextlib.suppress(OSError):
        roots.append(tempfile.gettempdir())
    for root in [*roots, *PLACES]:
        folder = Path(root) / name
        with contextlib.suppress(OSError):
            with contextlib.suppress(FileExistsError):
                folder.mkdir(mode=0o700)
            if _is_private(folder):
                tempfile.TemporaryFile(dir=folder).close()
                return folder
        with contextlib.suppress(OSError):
            own = Path(tempfile.mkdtemp(prefix=f"{name}-", dir=root))
            atexit.register(_remove, own, os.getpid())
            return own
    raise EcologyError(
        "compiled functions cannot be kept: no folder here can be written, a temporary one neither. Set "
        "NUMBA_CACHE_DIR or TMPDIR to a folder that can be written."
    )


def _is_private(folder: Path) -> bool:
    """Return whether `folder` is a folder of this user, and no link, that nobody else can write."""
    found = folder.lstat()
    if not hasattr(os, "getuid"):  # Windows: temporary folders are the user's own
        return stat.S_ISDIR(found.st_mode)
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022


def _remove(folder: Path, process: int) -> None:
    """Remove `folder` at the end of the process that made it."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
