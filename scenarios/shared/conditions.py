"""What the set-ups of Man and Yoshida have in common: the four conditions of empathy."""

from __future__ import annotations

from collections.abc import Sequence

from ecology import EcologyError

CONDITIONS = ("none", "cognitive", "affective", "full")
LEARNER = {  # of f/J: one decision a tick and a short memory, for worlds of a few states
    "adaptive_steps": False,
    "gamma": 0.9,
    "width": 32,
    "batch": 64,
    "batch_f": 64,
    "place_cells": 0,
    "imagined": 0.0,
    "imagined_f": 0.0,
    "depth": 1,
    "errors": 0,
    "recent_share": 0.4,
    "relative_weight": 2,
    "update_every": 4.0,
    "updates": 1,
    "epsilon": 0.5,
    "epsilon_final": 0.1,
    "youth": 500.0,
}


def empathy(condition: str) -> tuple[bool, bool]:
    """Return whether the partner's energy is perceived (cognitive), and whether its drive is felt (affective)."""
    if condition not in CONDITIONS:
        raise EcologyError(f"condition is one of {', '.join(map(repr, CONDITIONS))}, got {condition!r}.")
    return condition in ("cognitive", "full"), condition in ("affective", "full")


def square(middle: Sequence[float], half: float) -> list[tuple[float, float]]:
    """Return the outline of a square to draw, from its middle (x, y) and half its side."""
    x, y = middle
    return [
        (x - half, y - half),
        (x + half, y - half),
        (x + half, y + half),
        (x - half, y + half),
        (x - half, y - half),
    ]
