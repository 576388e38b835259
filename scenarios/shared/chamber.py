"""A chamber in which bodies cannot move, for experiments on needs alone."""

from __future__ import annotations

from typing import Any

from ecology import Arena

CHAMBER = Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2)))
MIDDLE = (1.0, 1.0)
STILL: dict[str, Any] = {"position": MIDDLE, "heading": 0.0, "solid": False, "senses": ()}  # of a species
# of hjb: there is nowhere to go, so it needs no place cells and no walks that explore; one decision a tick
LEARNER = {
    "adaptive_steps": False, "width": 32, "batch": 64, "batch_f": 64, "memory": 20_000, "updates": 1,
    "update_every": 2.0, "place_cells": 0, "depth": 1, "errors": 0, "epsilon": 0.3, "epsilon_final": 0.05,
    "youth": 2_000.0,
}  # fmt: skip
