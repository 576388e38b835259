"""How loops are compiled, and a folder for them, also where neither the install folder nor the home can be written.

A compiled loop stands in the file of its topic. Every such file calls `use_cache` first.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import inspect
import os
import shutil
import stat
import tempfile
import types
import typing
from collections.abc import Callable
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
    """Compile a loop that Python calls, by position.

    Numba takes microseconds to recognise a record in a call, but a twentieth of one for an array. So a parameter whose
    annotation is a NamedTuple is passed field by field, and put together again within. Such a loop can only be called
    by Python.
    """
    sources = _inlined[function.__code__.co_filename]
    hints = {name: _evaluate(function, name) for name in inspect.signature(function).parameters}
    if not any(_is_record(hint) for hint in hints.values()):
        return keep_compiled(numba.njit(no_cfunc_wrapper=True)(function), sources)  # type: ignore[call-overload]
    known: dict[str, Any] = {"__name__": function.__module__}
    known["loop"] = numba.njit(no_cfunc_wrapper=True, no_cpython_wrapper=True)(function)  # type: ignore[call-overload]
    taken, given, built = [], [], []
    for name, hint in hints.items():
        fields, whole, parts = _spread(name, name, hint, known)
        taken += fields
        built.append(whole)
        given += parts
    exec(f"def fields({', '.join(taken)}):\n    return loop({', '.join(built)})", known)
    records = {Path(inspect.getfile(each)) for each in known.values() if _is_record(each)}
    flat = known["fields"]
    flat.__qualname__ = function.__qualname__
    code = function.__code__
    flat.__code__ = flat.__code__.replace(co_filename=code.co_filename, co_firstlineno=code.co_firstlineno)
    known["fields"] = keep_compiled(numba.njit(no_cfunc_wrapper=True)(flat), (*sources, *sorted(records)))  # type: ignore[call-overload]
    exec(f"def call({', '.join(hints)}):\n    return fields({', '.join(given)})", known)
    call = functools.wraps(function)(known["call"])
    call.dispatcher = known["fields"]  # type: ignore[attr-defined]
    return call


def _evaluate(function: Any, parameter: str) -> Any:
    """Return what the annotation of a parameter says, None where there is none."""
    hint = function.__annotations__.get(parameter)
    return eval(hint, function.__globals__) if isinstance(hint, str) else hint


def _is_record(hint: Any) -> bool:
    return isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields")


def _spread(name: str, way: str, hint: Any, known: dict[str, Any]) -> tuple[list[str], str, list[str]]:
    """Return a parameter field by field: the fields' names, how it is built of them, and how a call takes them of it.

    The classes that it is built of are added to what is `known`.
    """
    if not _is_record(hint):
        return [name], name, [way]
    known[hint.__name__] = hint
    hints = typing.get_type_hints(hint)
    if not any(map(_is_record, hints.values())):
        names = [f"{name}_{field}" for field in hint._fields]
        return names, f"{hint.__name__}({', '.join(names)})", [f"*{way}"]
    parts = [_spread(f"{name}_{field}", f"{way}.{field}", hints[field], known) for field in hint._fields]
    fields, taken = ([each for part in parts for each in part[k]] for k in (0, 2))
    return fields, f"{hint.__name__}({', '.join(whole for _, whole, _ in parts)})", taken


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
    file = function._cache._cache_file
    file._source_stamp, file._load_index = _digest((own, *sources)), functools.partial(_load_index, file._load_index)
    return function


def _load_index(load: Callable[[], Any]) -> Any:
    """Return the index of kept code; empty if an older version wrote it and a class in it has another name now."""
    try:
        return load()
    except (AttributeError, ImportError):
        return {}


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
    """Return whether `folder` is a folder of this user, not a link, and not writable by others."""
    found = folder.lstat()
    if not hasattr(os, "getuid"):  # Windows: temporary folders are the user's own
        return stat.S_ISDIR(found.st_mode)
    return stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o022


def _remove(folder: Path, process: int) -> None:
    """Remove `folder` at the end of the process that made it."""
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
