"""Shares of each need in the own drive of the agent in focus, on one scale."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology import physiology
from ecology.observers import colours
from ecology.observers.census import FocusSamples
from ecology.observers.panels.base import LifePanel, scalars, series, time_columns
from ecology.spec import Species


class Shares(LifePanel):
    """Draws a curve per need; their sum is the drive."""

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        needs = self.species.needs
        shades = [colours.need_colour(i) for i in range(len(needs))]
        series(rec, f"{self.base}/shares", [need.name for need in needs], shades)

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw them."""
        scalars(
            rec,
            f"{self.base}/shares",
            time_columns(life.tick),
            drive_shares(self.species, life.internal - life.target),
        )

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot."""
        return [self.recent("shares", "what it wants: shares of its drive")]


def drive_shares(species: Species, delta: np.ndarray) -> np.ndarray:
    """Return the share of each need in the own drive at x - x* (n, V), (n, V) in drive units; their sum is the drive.

    The share of a need is d |c_i delta_i|^n / sum_j |c_j delta_j|^n: which need the drive is about. Without any
    deviation it is 0, and NaN where delta is, where nobody lives.
    """
    regulated, lives = np.array([need.regulated for need in species.needs]), np.isfinite(delta).all(1, keepdims=True)
    delta = np.where(regulated & lives, delta, 0.0)
    below, above = physiology.drive_factors(species)
    square = np.abs(delta * np.where(delta > 0, above, below)) ** species.drive_power
    total = square.sum(axis=1, keepdims=True)
    drive = physiology.drive_of(species, delta)[:, None]
    shares = np.divide(drive * square, total, out=np.zeros_like(square), where=total > 0)
    return np.where(lives, shares, np.nan)
