"""Sight of the agent in focus: its field of view and lines of sight, with a ring around it and its name beside it."""

from __future__ import annotations

import numpy as np
import rerun as rr

from ecology.observers.census import FocusSamples
from ecology.observers.panels.base import LifePanel, time_columns
from ecology.observers.scene import FAINT, INK


class Sight(LifePanel):
    """Draws them in the plane."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Give them their colours."""
        thin = rr.Radius.ui_points(0.4)
        lines = rr.LineStrips2D.from_fields(colors=[FAINT], radii=thin, draw_order=15)
        rec.log(f"world/{self.base}", lines, static=True)
        half = 1.45 * self.scene.radius(self.species)
        ring = rr.Ellipses2D.from_fields(
            half_sizes=[[half, half]], colors=[INK], line_radii=rr.Radius.ui_points(1.2), draw_order=22
        )
        rec.log(f"world/{self.base}/ring", ring, static=True)
        label = rr.Points2D.from_fields(radii=1e-4, colors=[INK], show_labels=True, draw_order=30)
        rec.log(f"world/{self.base}/name", label, static=True)

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw the view field and the lines of sight, and the name of one of several."""
        times, strips, lengths = time_columns(life.tick), [], []
        for at, outline, sight in zip(life.place, life.field, life.sight, strict=True):
            seen = [np.stack([at, there]) for there in sight] + ([outline] if len(outline) else [])
            strips += seen
            lengths.append(len(seen))
        rec.send_columns(f"world/{self.base}", times, rr.LineStrips2D.columns(strips=strips).partition(lengths))
        rings = rr.Ellipses2D.columns(centers=life.place)
        rec.send_columns(f"world/{self.base}/ring", times, rings)
        if self.scene.crowd:
            place = life.place - [0.0, 1.2 * self.scene.radius(self.species)]
            labels = rr.Points2D.columns(positions=place, labels=life.names)
            rec.send_columns(f"world/{self.base}/name", times, labels)
