"""Decorators that compile the learner's kernels and keep the code on disk until one of their sources changes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba

from ecology import elementary
from ecology.compiler_cache import keep_compiled, use_cache

use_cache(__file__)
HERE = Path(__file__)
SOURCES = (*sorted(HERE.parent.glob("*.py")), HERE.parents[1] / "records.py", Path(elementary.__file__))
FLAGS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
# no fast mathematics: every operation is rounded as it is written, so all processors give the same bits


def compiled(function: Any) -> Any:
    """Compile a kernel that Python calls, which takes long where arguments are tuples of arrays."""
    return keep_compiled(numba.njit(**FLAGS)(function), SOURCES)


def within(function: Any) -> Any:
    """Compile a kernel that only other kernels call."""
    return keep_compiled(numba.njit(**FLAGS, no_cpython_wrapper=True)(function), SOURCES)  # type: ignore[call-overload]


def inlined(function: Any) -> Any:
    """Compile a kernel as a part of its only caller, which takes half as long as to optimise both, one in the other."""
    return numba.njit(**FLAGS, inline="always", no_cpython_wrapper=True)(function)  # type: ignore[call-overload]
