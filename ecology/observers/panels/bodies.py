"""Bodies and headings of a species, a row per slot, with all that is recorded of every agent."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from ecology.observers import census, colours
from ecology.observers.panels.base import Batch, Panel
from ecology.observers.scene import DRIVE_SCALE, STEPS

COMPASS = 512  # directions in which a heading is drawn, and recorded for the viewer


class Bodies(Panel):
    """Draws the bodies of a species; of several species they have its colour, and headings show the drive."""

    each = True

    def open(self, rec: rr.RecordingStream) -> None:
        """Give bodies and headings their size and colour."""
        scene = self.scene
        shown = colours.scale(DRIVE_SCALE)[np.linspace(0, colours.SHADES - 1, STEPS).round().astype(int)]
        words = [f"drive at {100 * i / (STEPS - 1):.0f} % of the scale" for i in range(STEPS)]
        classes = [(i, word, c.tolist()) for i, (word, c) in enumerate(zip(words, shown, strict=True))]
        rec.log("world", rr.AnnotationContext(classes), static=True)
        colour, radius = scene.colour(self.name), scene.radius(self.species)
        # the other one is coloured by class: the drive
        of_body, of_arrow = ([colour], None) if scene.mixed else (None, [colour])
        points = rr.Points2D.from_fields(radii=radius, colors=of_body, show_labels=False, draw_order=20)
        rec.log(f"world/agents/{self.name}", points, static=True)
        arrows = rr.Arrows2D.from_fields(radii=0.2 * radius, colors=of_arrow, show_labels=False)
        rec.log(f"world/agents/{self.name}", arrows, static=True)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw places and headings; note internal variables, serial, action and, in full, drive and reward."""
        column, scene, group = batch.column, self.scene, self.scene.groups[self.name]
        rows, each = group.slots, [group.size] * len(batch.samples)
        numbers = {need.name: column["internal"][:, rows, k] for k, need in enumerate(self.species.needs)}
        for k, word in enumerate(census.moving(self.species)):
            if word:
                numbers[word] = column["set_point"][:, rows, k]
        extra = ("drive", "reward") if scene.full else ()
        numbers |= {key: column[key][:, rows] for key in (*extra, "serial", "action")}
        top = np.array([[s["top"]] for s in batch.samples])
        level = (np.clip(np.nan_to_num(column["drive"][:, rows]) / top, 0, 1) * (STEPS - 1)).round().astype(np.uint16)
        drive = {"class_ids": level.reshape(-1)}
        turn = 2 * np.pi / COMPASS
        angle = (column["heading"][:, rows] / turn).round() * turn
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32)  # (n, N, 2)
        arrow = (2.5 * scene.radius(self.species) * way).reshape(-1, 2)
        at = column["place"][:, rows].reshape(-1, 2)
        rec.send_columns(
            f"world/agents/{self.name}",
            batch.times,
            [
                *rr.Points2D.columns(positions=at, **({} if scene.mixed else drive)).partition(each),
                *rr.Arrows2D.columns(vectors=arrow, **(drive if scene.mixed else {})).partition(each),
                *rr.AnyValues.columns(**{key: pa.array(value.reshape(-1)) for key, value in numbers.items()}).partition(
                    each
                ),
            ],
        )

    def overrides(self) -> dict[Any, Any]:
        """Let arrows begin where bodies are: the positions are recorded once."""
        origin = VisualizerComponentMapping(
            target="Arrows2D:origins",
            source_kind=ComponentSourceKind.SourceComponent,
            source_component="Points2D:positions",
        )
        arrows = rr.Arrows2D.from_fields(draw_order=21).visualizer(mappings=[origin])
        return {f"world/agents/{self.name}": [rr.Points2D.from_fields().visualizer(), arrows]}
