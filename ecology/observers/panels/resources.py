"""Resources: their circles, stocks and names."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from ecology.ground.outline import polygon_of
from ecology.observers import colours, maps, shapes
from ecology.observers.panels.base import Batch, Panel, Watch, lay
from ecology.observers.scene import BACKGROUND, STEPS, Scene

FINE = 400  # cells along the longer side of a floor that a resource covers
OPAQUE = 110  # of 255, where it is full
LINE = 0.055  # height of a line of words on the first screen, as a share of the arena


class Resources(Panel):
    """Draws the resources again where they have moved, and how full the finite ones are."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        kinds = scene.scenario.resources
        self._patches = [r for r in kinds for _ in range(r.count)]
        self._kind = np.repeat(np.arange(len(kinds)), [r.count for r in kinds])
        self._radii = np.array([r.radius for r in self._patches], np.float32)
        self._everywhere = [k for k, r in enumerate(kinds) if shapes.covers(scene.scenario, r)]
        self._single = [k for k, r in enumerate(kinds) if r.count == 1 and k not in self._everywhere]
        self._finite = not all(r.constant for r in self._patches)
        self._before: np.ndarray | None = None  # where they were last drawn

    def is_there(self) -> bool:
        """Return whether there are resources."""
        return bool(self._patches)

    def sample(self, watch: Watch) -> Any:
        """Return where they are, and how full."""
        places = shapes.patches(self.scene.scenario, watch.state).astype(np.float32)
        places = np.where(np.isin(self._kind, self._everywhere)[:, None], np.nan, places)  # the floor shows them
        return places, shapes.fullness(self.scene.scenario, watch.state).astype(np.float32)

    def open(self, rec: rr.RecordingStream) -> None:
        """Give them their colours and names."""
        kinds, shades = self.scene.scenario.resources, colours.resource_colours(self.scene.scenario)
        each = [shades[k] for k in self._kind]
        thin = rr.Radius.ui_points(1.0 if len(self._patches) > len(shades) else 1.5)
        line = rr.Ellipses2D.from_fields(colors=each, line_radii=thin, draw_order=8)
        rec.log("world/resources", line, static=True)
        # a dark rim, so that a circle stands out from a map of its own colour
        rim = rr.Ellipses2D.from_fields(colors=[BACKGROUND], line_radii=rr.Radius.ui_points(3.0), draw_order=7)
        rec.log("world/resources/rim", rim, static=True)
        full = rr.Points2D.from_fields(colors=[colours.darken(s, 0.5) for s in each], draw_order=6)
        rec.log("world/resources/stock", full, static=True)
        for k in self._everywhere:
            self._flood(rec, kinds[k].name, shades[k])
        words = rr.Points2D.from_fields(
            radii=1e-4,
            labels=[kinds[k].name for k in self._single],
            colors=[shades[k] for k in self._single],
            show_labels=True,
            draw_order=30,
        )
        rec.log("world/resources/names", words, static=True)

    def _flood(self, rec: rr.RecordingStream, name: str, shade: colours.Colour) -> None:
        """Lay the colour of a resource that is everywhere on the floor."""
        fine = maps.cover(self.scene.scenario.arena, FINE)
        image = np.zeros((*fine.inside.shape, 4), np.uint8)
        image[fine.inside] = (*colours.darken(shade, 0.5), OPAQUE)
        entity = f"world/resources/everywhere/{name}"
        lay(rec, entity, fine.corner, (fine.cell, fine.cell))
        rec.log(entity, rr.Image(image, draw_order=-25), static=True)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw where they have moved to, and their stocks."""
        found, number = batch.of(self), len(self._patches)
        place = np.stack([each[0] for each in found])  # (n, R, 2)
        before = np.concatenate([place[:1] if self._before is None else self._before[None], place[:-1]])
        moved = np.flatnonzero(~((place == before) | (np.isnan(place) & np.isnan(before))).all(axis=(1, 2)))
        if self._before is None:
            moved = np.union1d([0], moved)
        self._before = place[-1]
        if moved.size:
            self._move(rec, batch, moved, place[moved])
        if self._finite:
            full = (STEPS * np.sqrt(np.stack([each[1] for each in found]))).round() / STEPS * self._radii
            stock = rr.Points2D.columns(radii=full.astype(np.float32).reshape(-1)).partition([number] * len(found))
            rec.send_columns("world/resources/stock", batch.times, stock)
        for k in self._everywhere:
            opacity = np.stack([each[1][self._kind == k] for each in found]).reshape(-1)
            entity = f"world/resources/everywhere/{self.scene.scenario.resources[k].name}"
            rec.send_columns(entity, batch.times, rr.Image.columns(opacity=opacity))

    def _move(self, rec: rr.RecordingStream, batch: Batch, rows: np.ndarray, place: np.ndarray) -> None:
        """Draw the patches at `place` (k, R, 2) in the samples `rows` (k,)."""
        times, parts, at = batch.at(rows), [len(self._patches)] * len(rows), place.reshape(-1, 2)
        half = np.tile(np.stack([self._radii, self._radii], axis=1), (len(rows), 1))
        circles = [*rr.Ellipses2D.columns(centers=at, half_sizes=half).partition(parts)]
        rec.send_columns("world/resources", times, circles)
        rec.send_columns("world/resources/rim", times, circles)
        if self._finite:
            rec.send_columns("world/resources/stock", times, rr.Points2D.columns(positions=at).partition(parts))
        first = [int(np.flatnonzero(self._kind == k)[0]) for k in self._single]
        beside: list[tuple[float, float]] = []
        for i, (p, k) in enumerate((p, k) for p in place for k in first):
            x, y = self._beside(p[k], self._radii[k], len(self._patches[k].name))
            while (x, y) in beside[i - i % len(first) :]:  # of another resource at the same place
                y -= LINE * self.scene.size
            beside.append((x, y))
        if beside:
            words = rr.Points2D.columns(positions=beside).partition([len(first)] * len(rows))
            rec.send_columns("world/resources/names", times, words)

    def _beside(self, centre: np.ndarray, radius: float, letters: int) -> tuple[float, float]:
        """Return where a word may hang below or above a circle without lying on a wall."""
        import shapely  # slow to load

        walls = polygon_of(self.scene.scenario.arena).boundary
        size = max(walls.bounds[2] - walls.bounds[0], walls.bounds[3] - walls.bounds[1])
        half, tall = 0.009 * size * letters, 0.04 * size  # of the word, as the first screen shows it
        x, y = map(float, centre)
        left, _, right, _ = walls.bounds
        if 2.2 * half < right - left:
            x = min(max(x, left + 1.1 * half), right - 1.1 * half)
        for gap in np.arange(0.0, 0.3, 0.01) * size:
            for top in (y - radius - gap, y + radius + gap + tall):
                if not walls.intersects(shapely.box(x - half, top - tall, x + half, top)):
                    return x, top
        return x, y - radius
