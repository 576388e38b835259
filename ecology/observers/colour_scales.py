"""Matplotlib and its colour scales, whatever backend the surroundings ask for.

A notebook sets MPLBACKEND for the commands that its cells start, to a backend that this Python may not have; matplotlib
then cannot be imported. So the rest of the project imports it through this module, or `plotting`, which loads more.
"""
# ruff: noqa: E402  (matplotlib is first imported by a function)

from __future__ import annotations

import contextlib
import os
import sys


def _import_matplotlib() -> None:
    """Import matplotlib with any MPLBACKEND; one that can be used still holds for the user's own plots."""
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = backend


if "matplotlib" not in sys.modules:
    _import_matplotlib()

from matplotlib import colormaps

__all__ = ["colormaps"]
