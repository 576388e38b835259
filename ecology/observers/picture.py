"""A picture of the world, without a viewer: what `env.render()` returns, and what a film is made of."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from ecology.ground.outline import drawn_lines
from ecology.observers import maps, places, shapes
from ecology.observers.colours import highest_drive, resource_colours, scale, species_colour
from ecology.observers.frame import Frame, frame
from ecology.observers.mind_picture import MindPicture
from ecology.observers.plotting import (
    EllipseCollection,
    FigureCanvasAgg,
    Line2D,
    LineCollection,
    ListedColormap,
    Normalize,
    ScalarMappable,
    new_figure,
)
from ecology.scenario import Scenario
from ecology.state import State

SIZE, DPI = (800, 600), 100  # pixels, and pixels per inch
FINE = 400  # cells along the longer side of a floor that a resource covers
OPAQUE = 0.45  # where a resource is full
SHADES = {"born": "black", "died": "black", "bit": "#d55e00", "gave": "#009e73"}  # of marks


def draw_picture(scenario: Scenario, state: State) -> np.ndarray:
    """Return the world as one picture, uint8 (600, 800, 3): see `Picture`."""
    return Picture(scenario).draw(frame(scenario, state))


@dataclass(frozen=True)
class Shot:
    """Settings of a picture: size, camera and trails."""

    size: tuple[int, int] = SIZE  # pixels
    zoom: float | None = None  # zoom factor of a camera that follows an agent, None: the whole arena
    trail: int = 0  # frames of the trails
    beside: bool = False  # whether needs and decision of an agent stand beside the arena


class Picture:
    """Draws frame after frame of one world: what does not change is drawn once.

    A patch is filled as far as its stock is; one that is empty or unavailable is a ring. A resource that
    covers the whole room colours the floor, the stronger the fuller. Of one species, bodies are coloured
    by drive; of several, by species, and their headings by drive.
    """

    def __init__(self, scenario: Scenario, shot: Shot | None = None) -> None:
        """Draw the arena, the legend and the axes, as `shot` says."""
        self._scenario, self._shot = scenario, shot or Shot()
        wide, tall = self._shot.size
        self._figure = figure = new_figure((wide / DPI, tall / DPI), dpi=DPI)
        self._canvas = FigureCanvasAgg(figure)
        grid = figure.add_gridspec(2, 2, width_ratios=(1.5, 1), height_ratios=(1, 1.6)) if self._shot.beside else None
        self._axes = figure.add_subplot() if grid is None else figure.add_subplot(grid[:, 0])
        longest = max((need.name for species in scenario.species for need in species.needs), key=len, default="")
        self._mind = (
            None
            if grid is None
            else MindPicture(figure.add_subplot(grid[0, 1]), figure.add_subplot(grid[1, 1]), longest)
        )
        self._past: deque[np.ndarray] = deque(maxlen=max(self._shot.trail, 1))  # places, (N, 2), of the last frames
        axes = self._axes
        vertices = np.array(scenario.arena.vertices, dtype=float)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        axes.set_facecolor("0.82")
        edge = (
            {"edgecolor": "0.6", "linestyle": ":"} if scenario.arena.torus else {"edgecolor": "black", "linewidth": 2}
        )
        axes.fill(*vertices.T, facecolor="white", zorder=1, **edge)
        for hole in scenario.arena.holes:
            axes.fill(*np.array(hole, float).T, facecolor="0.82", zorder=1, **edge)
        for wall in scenario.arena.inner_walls:
            axes.plot(*np.array(wall, float).T, color="black", linewidth=2, zorder=1)
        margin = 0.04 * float((high - low).max())
        axes.set(
            xlim=(low[0] - margin, high[0] + margin),
            ylim=(low[1] - margin, high[1] + margin),
            aspect="equal",
            xlabel="x (length)",
            ylabel="y (length)",
        )
        self._mixed = len(scenario.species) > 1
        self._drives = ScalarMappable(Normalize(0, highest_drive(scenario)), ListedColormap(scale("plasma") / 255))
        figure.colorbar(self._drives, ax=axes, label=f"drive ({'heading' if self._mixed else 'body'})", shrink=0.8)
        self._shut = self._add(LineCollection([], colors="0.35", linewidths=3, zorder=1))
        self._fields = self._images() if scenario.fields else {}
        self._floors, self._walls = self._flooded()
        self._patches = self._resources()
        self._bodies = [self._species(i) for i in range(len(scenario.species))]
        self._marks = {
            kind: self._add(LineCollection([], colors=shade, linewidths=1.5, zorder=5))
            for kind, shade in SHADES.items()
        }
        figure.legend(handles=self._handles(), loc="outside lower center", ncols=5, frameon=False, fontsize=8)
        self._trails = self._add(LineCollection([], colors="0.45", linewidths=0.8, alpha=0.6, zorder=3))
        self._ring = self._add(LineCollection([], colors="black", linewidths=1.4, zorder=5))
        self._title = figure.suptitle("tick", fontsize=11, animated=True)
        self._canvas.draw()
        figure.set_layout_engine("none")
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)

    def draw(self, shown: Frame) -> np.ndarray:
        """Return the picture of a frame, uint8 (height, width, 3)."""
        self._follow(shown)
        if self._patches:
            rings, discs, names, radii = self._patches
            rings.set_offsets(shown.patches)
            discs.set_offsets(shown.patches)
            wide = 2 * radii * np.sqrt(shown.full)
            discs.set_widths(wide)
            discs.set_heights(wide)
            for i, name in names.items():
                name.set_position(shown.patches[i] - [0, radii[i]])
            for i, floor in self._floors.items():
                floor.set_alpha(shown.full[i])
        start, captions = 0, []
        for species, (bodies, headings, radius) in zip(self._scenario.species, self._bodies, strict=True):
            rows = slice(start, start + species.slots)
            start += species.slots
            lives = np.isfinite(shown.position[rows, 0])
            place, angle = shown.position[rows][lives], shown.heading[rows][lives]
            colour = self._drives.to_rgba(shown.drive[rows][lives])
            tip = place + 2.4 * radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
            bodies.set_offsets(place)
            headings.set_segments(list(np.stack([place, tip], axis=1)))
            if self._mixed:
                headings.set_color(colour)
            else:
                bodies.set_facecolor(colour)
            captions.append(f"{int(lives.sum())} {species.name}")
        for kind, lines in self._marks.items():
            lines.set_segments(list(shown.marks.get(kind, ())))
        who = ", ".join(captions)
        self._shut.set_segments(list(shown.doors))
        for i, (name, level) in enumerate(shown.fields.items()):
            if name in self._fields:
                self._fields[name].set_data(places.image(level, i))
        self._title.set_text(f"{self._scenario.name}, tick {shown.tick}, time {shown.time:g}: {who}")
        if self._mind is not None or self._moves(shown):  # what does not change elsewhere changes here
            if self._mind is not None:
                self._mind.draw(shown.followed)
            self._canvas.draw()
        else:
            self._canvas.restore_region(self._background)
        for artist in self._moving():
            self._axes.draw_artist(artist)
        self._figure.draw_artist(self._title)
        return np.asarray(self._canvas.buffer_rgba())[..., :3].copy()

    def _moves(self, shown: Frame) -> bool:
        """Return whether the camera follows an agent."""
        return self._shot.zoom is not None and shown.followed is not None

    def _follow(self, shown: Frame) -> None:
        """Draw the trails and the ring, and move the camera to the agent that it follows."""
        self._past.append(shown.position)
        if self._shot.trail:
            lines = np.stack(self._past, axis=1)  # (N, frames, 2)
            jumps = np.hypot(*np.diff(lines, axis=1).transpose(2, 0, 1)) > 0.3 * shapes.size(self._scenario)
            self._trails.set_segments([np.where(np.append(False, j)[:, None], np.nan, line)
                                       for line, j in zip(lines, jumps, strict=True)])  # fmt: skip
        who = shown.followed
        if who is None or not np.isfinite(who.place).all():
            self._ring.set_segments([])
            return
        angle = np.linspace(0, 2 * np.pi, 33)
        wide = 1.6 * shapes.radius(self._scenario, who.species)
        self._ring.set_segments([who.place + wide * np.stack([np.cos(angle), np.sin(angle)], axis=-1)])
        if self._shot.zoom is not None:
            half = 0.5 * shapes.size(self._scenario) / self._shot.zoom
            (x, y) = who.place
            self._axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half))

    def _moving(self) -> list[Any]:
        """Return what is redrawn in every frame, the lowest first."""
        found: list[Any] = [*self._floors.values(), *self._walls, *self._fields.values(), self._shut]
        if self._patches:
            rings, discs, names, _ = self._patches
            found += [discs, rings, *names.values()]
        found.append(self._trails)
        for bodies, headings, _ in self._bodies:
            found += [bodies, headings]
        found.append(self._ring)
        return found + list(self._marks.values())

    def _add(self, artist: Any) -> Any:
        artist.set_animated(True)
        self._axes.add_collection(artist, autolim=False)
        return artist

    def _circles(self, radii: np.ndarray, **how: Any) -> Any:
        """Return circles in the units of the plane, nowhere yet."""
        wide = 2 * np.asarray(radii, float)
        nowhere = np.full((max(len(wide), 1), 2), np.nan)
        return self._add(
            EllipseCollection(
                wide,
                wide,
                np.zeros(len(wide)),
                units="xy",
                offsets=nowhere,
                offset_transform=self._axes.transData,
                **how,
            )
        )

    def _images(self) -> dict[str, Any]:
        """Return the images of the fields, nothing in them yet."""
        grid = places.grid_of(self._scenario.arena)
        nothing = places.image(np.zeros(grid.inside.shape, np.uint8), 0)
        return {each.name: self._lay(nothing, grid) for each in self._scenario.fields}

    def _lay(self, image: np.ndarray, grid: maps.Grid) -> Any:
        """Lay an image of a grid on the floor."""
        left, bottom = grid.corner
        ends = (left, left + len(grid.x) * grid.cell, bottom, bottom + len(grid.y) * grid.cell)
        limits = self._axes.get_xlim(), self._axes.get_ylim()
        found = self._axes.imshow(image, extent=ends, origin="lower", animated=True, zorder=1.5)
        self._axes.set(xlim=limits[0], ylim=limits[1])
        return found

    def _flooded(self) -> tuple[dict[int, Any], list[Any]]:
        """Return the floors that resources cover, by patch, and the walls again, if there are any such floors."""
        scenario = self._scenario
        kinds, shades = scenario.resources, resource_colours(scenario)
        first = np.cumsum([0, *(r.count for r in kinds)])
        covering = [k for k, r in enumerate(kinds) if shapes.covers(scenario, r)]
        if not covering:
            return {}, []
        fine, floors = maps.cover(scenario.arena, FINE), {}
        for k in covering:
            image = np.zeros((*fine.inside.shape, 4))
            image[fine.inside] = (*_unit(shades[k]), OPAQUE)
            floors[int(first[k])] = self._lay(image, fine)
        torus = scenario.arena.torus
        lines = [] if torus else drawn_lines(scenario.arena)
        return floors, [self._add(LineCollection(lines, colors="black", linewidths=2, zorder=1.5))]

    def _resources(self) -> tuple[Any, Any, dict[int, Any], np.ndarray] | None:
        """Return rings, discs, names by patch and radii of the patches."""
        resources = self._scenario.resources
        if not resources:
            return None
        shades = [_unit(c) for c in resource_colours(self._scenario)]
        each = [shade for shade, r in zip(shades, resources, strict=True) for _ in range(r.count)]
        # those that cover the floor are not drawn as circles
        radii = np.array(
            [0.0 if shapes.covers(self._scenario, r) else r.radius for r in resources for _ in range(r.count)]
        )
        rings = self._circles(radii, facecolors="none", edgecolors=each, linewidths=1.5, zorder=2)
        discs = self._circles(radii, facecolors=each, edgecolors="none", alpha=OPAQUE, zorder=2)
        names, first = {}, 0
        for r in resources:
            if r.count == 1 and first not in self._floors:
                names[first] = self._axes.text(0, 0, r.name, ha="center", va="top", fontsize=8, animated=True)
            first += r.count
        return rings, discs, names, radii

    def _species(self, index: int) -> tuple[Any, Any, float]:
        """Return bodies and headings of a species, and the radius with which it is drawn."""
        species = self._scenario.species[index]
        radius = shapes.radius(self._scenario, species)
        face = _unit(species_colour(index)) if self._mixed else "none"
        bodies = self._circles(np.array([radius]), facecolors=face, edgecolors="0.15", linewidths=0.8, zorder=4)
        headings = self._add(LineCollection([], colors="0.15", linewidths=1.8, zorder=4))
        return bodies, headings, radius

    def _handles(self) -> list[Line2D]:
        """Return the legend's entries: species, patches, marks."""
        scenario = self._scenario

        def dot(label: str, face: Any, edge: Any) -> Line2D:
            return Line2D([], [], marker="o", ls="", mfc=face, mec=edge, label=label)

        def square(label: str, face: Any) -> Line2D:
            return Line2D([], [], marker="s", ls="", mfc=face, mec="none", label=label)

        found = [
            dot(s.name, _unit(species_colour(i)) if self._mixed else "none", "0.15")
            for i, s in enumerate(scenario.species)
        ]
        shades = [_unit(c) for c in resource_colours(scenario)]
        kinds = list(zip(scenario.resources, shades, strict=True))
        found += [dot(r.name, (*c, OPAQUE), c) for r, c in kinds if r.count > 1]
        found += [square(f"{r.name}: everywhere", (*c, OPAQUE)) for r, c in kinds if shapes.covers(scenario, r)]
        found += [square(each.name, _unit(places.field_colour(i))) for i, each in enumerate(scenario.fields)]
        signs: dict[str, Any] = {"born": {"marker": "o", "ls": "", "mfc": "none"}, "died": {"marker": "x", "ls": ""}}
        found += [  # bites and gifts are lines
            Line2D([], [], color=SHADES[kind], label=shapes.KINDS[kind], **signs.get(kind, {}))
            for kind in shapes.mark_kinds(scenario)
        ]
        return found


def _unit(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    r, g, b = colour
    return r / 255, g / 255, b / 255
