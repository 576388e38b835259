"""Matplotlib for files and arrays: no window, no pyplot, whatever backend the surroundings ask for.

The only module that imports matplotlib. A notebook sets MPLBACKEND for the commands that its cells start, to a backend
that this Python may not have; matplotlib then cannot be imported.
"""
# ruff: noqa: E402  (matplotlib is first imported by a function)

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path
from typing import Any


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

from matplotlib import color_sequences, colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import ScalarFormatter

__all__ = [
    "Axes",
    "Circle",
    "EllipseCollection",
    "Figure",
    "FigureCanvasAgg",
    "Line2D",
    "LineCollection",
    "ListedColormap",
    "Normalize",
    "Polygon",
    "ScalarFormatter",
    "ScalarMappable",
    "color_sequences",
    "colormaps",
    "new_figure",
    "save_figure",
]

ENDINGS = (".svg", ".pdf")  # of the files beside a PNG, for papers


def new_figure(size: tuple[float, float], **settings: Any) -> Figure:
    """Return an empty figure of `size` (inches) that draws to files and arrays."""
    figure = Figure(figsize=size, layout="constrained", **settings)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path, dpi: float) -> None:
    """Write a figure to the PNG file `path`, and beside it as SVG and PDF, each atomically."""
    for target in (path, *(path.with_suffix(ending) for ending in ENDINGS)):
        # without the date, so that the same figure gives the same file
        dated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(target.suffix)
        beside = target.with_name(target.name + ".new")
        figure.savefig(beside, dpi=dpi, format=target.suffix[1:], metadata=dated)
        beside.replace(target)
