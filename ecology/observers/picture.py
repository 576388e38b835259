"""A picture of the world, without a viewer: what `env.render()` returns."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ecology.observers.colours import highest_drive, resource_colours, scale, shaded, species_colour
from ecology.scenario import Scenario
from ecology.state import State

SIZE, DPI = (8.0, 6.0), 100  # inches, pixels per inch


def draw(scenario: Scenario, state: State) -> np.ndarray:
    """Return the arena, resources and bodies (with heading, coloured by drive), uint8 (600, 800, 3).

    A finite resource is drawn as full as its stock is; one that is empty or unavailable is a ring.
    """
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    vertices = np.array(scenario.arena.vertices, dtype=float)
    axes.set_facecolor("0.82")
    axes.fill(*vertices.T, facecolor="white", edgecolor="black", linewidth=2, zorder=1)
    for i, (resource, colour) in enumerate(zip(scenario.resources, resource_colours(scenario), strict=True)):
        place, face = state.resource_position[i], _unit(colour)
        full = 1.0 if math.isinf(resource.most) else float(state.stock[i]) / max(resource.most, 1e-12)
        full *= float(state.available[i])
        if not resource.constant:
            _circles(axes, place[None], resource.radius, "none", edge=face, zorder=2)
        _circles(axes, place[None], resource.radius, [face], alpha=0.45 * full, zorder=2)
        axes.annotate(resource.name, place - [0, resource.radius], ha="center", va="top", fontsize=8, zorder=5)
    drives = ScalarMappable(Normalize(0, highest_drive(scenario)), ListedColormap(scale("plasma") / 255))
    start, handles = 0, []
    for i, species in enumerate(scenario.species):
        rows = np.arange(start, start + species.count)[state.alive[start : start + species.count]]
        start += species.count
        edge = _unit(shaded(species_colour(i), 0.15 if i == 0 else 1.0))
        place, angle, tip = state.position[rows], state.heading[rows], 2.2 * species.radius
        _circles(axes, place, species.radius, drives.to_rgba(state.drive[rows]), edge=edge, zorder=4)
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        axes.plot(*np.stack([place, place + tip * way]).transpose(2, 0, 1), color=edge, lw=1.5, zorder=4)
        label = f"{species.name} ({len(rows)})"
        handles.append(Line2D([], [], marker="o", ls="", mfc="none", mec=edge, mew=1.5, label=label))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    margin = 0.04 * float((high - low).max())
    axes.set(
        xlim=(low[0] - margin, high[0] + margin),
        ylim=(low[1] - margin, high[1] + margin),
        aspect="equal",
        xlabel="x (length)",
        ylabel="y (length)",
    )
    figure.suptitle(f"{scenario.name}, tick {state.tick}, time {state.time:g}", fontsize=11)
    figure.legend(handles=handles, loc="outside lower right", ncols=4, frameon=False, fontsize=9)
    figure.colorbar(drives, ax=axes, label="drive", shrink=0.8)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _circles(axes, centres, radius, faces, *, edge="none", alpha=1.0, zorder=1) -> None:
    """Draw circles of `radius` in the units of the plane at `centres` (n, 2)."""
    wide = np.full(len(centres), 2 * radius)
    axes.add_collection(
        EllipseCollection(
            wide,
            wide,
            np.zeros(len(centres)),
            units="xy",
            offsets=centres,
            offset_transform=axes.transData,
            facecolors=faces,
            edgecolors=edge,
            linewidths=1.5,
            alpha=alpha,
            zorder=zorder,
        )
    )


def _unit(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    r, g, b = colour
    return r / 255, g / 255, b / 255
