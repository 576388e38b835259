"""Matplotlib for files and arrays: no window, no pyplot, whatever backend the surroundings ask for; styles of series.

Only this module and `colour_scales`, which is quick to load, import matplotlib.
"""
# ruff: noqa: I001  (`colour_scales` comes first: it imports matplotlib safely)

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ecology.observers.colour_scales import colormaps
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
    "Style",
    "colormaps",
    "draw_means",
    "new_figure",
    "save_figure",
    "style",
]

ENDINGS = (".svg", ".pdf")  # of the files beside a PNG, for papers
# Okabe and Ito (2008), without the colours that are too light on white
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222")
MARKERS = ("o", "^", "s", "D", "v", "P", "X")
LINES: Sequence[Any] = ("-", (0, (5, 1.5)), (0, (1.5, 1)), "-.", (0, (7, 1.5, 1.5, 1.5, 1.5, 1.5)))
ASIDE = 0.015  # offset of the dots of seeds from their mean, as a share of the range of x


@dataclass(frozen=True)
class Style:
    """The look of a series: another colour, marker and line for each, so that no two differ by colour alone."""

    colour: str
    marker: str
    line: Any

    @property
    def words(self) -> dict[str, Any]:
        """Return it as arguments of `plot` and `errorbar`."""
        return {"color": self.colour, "marker": self.marker, "linestyle": self.line}


def style(index: int) -> Style:
    """Return the look of a series by its place among the series of a figure; the first 49 are all different."""
    marker = MARKERS[(index + index // len(COLOURS)) % len(MARKERS)]
    return Style(COLOURS[index % len(COLOURS)], marker, LINES[index % len(LINES)])


def draw_means(
    ax: Axes,
    x: Any,
    means: Any,
    bounds: Any,
    samples: Sequence[Sequence[float]],
    look: Style,
    *,
    wide: float,
    side: int = 1,
    **words: Any,
) -> None:
    """Draw means (n,) at `x` (n,) with their intervals, `bounds` (2, n), and the values of all seeds beside them.

    samples: the values at every x. wide: the range of x, by which dots are set aside, to the right, or to the
    left for `side` -1. words: of `errorbar`.
    """
    x, means, bounds = np.asarray(x, float), np.asarray(means, float), np.asarray(bounds, float)
    half = np.nan_to_num(np.abs(bounds - means))
    for at, values in zip(x, samples, strict=True):
        if len(values) > 1:
            aside = np.full(len(values), at + side * ASIDE * wide)
            ax.plot(aside, values, ".", color=look.colour, alpha=0.6, markersize=5.5, markeredgewidth=0, zorder=1.5)
    ax.errorbar(x, means, yerr=half, capsize=3, markersize=4.5, **{"linewidth": 1.3, **look.words, **words})


def new_figure(size: tuple[float, float], **settings: Any) -> Figure:
    """Return an empty figure of `size` (inches) that draws to files and arrays."""
    figure = Figure(figsize=size, layout="constrained", **settings)
    FigureCanvasAgg(figure)
    return figure


def save_figure(figure: Figure, path: Path, dpi: float) -> list[Path]:
    """Write a figure to the PNG file `path`, and beside it as SVG and PDF, each atomically; return the files."""
    targets = [path, *(path.with_suffix(ending) for ending in ENDINGS)]
    for target in targets:
        # without the date, so that the same figure gives the same file
        dated = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(target.suffix)
        beside = target.with_name(target.name + ".new")
        figure.savefig(beside, dpi=dpi, format=target.suffix[1:], metadata=dated)
        beside.replace(target)
    return targets
