"""What agents perceive: one file per sense, and zeta, all senses of a species side by side.

A sense of one's own is a class of one file here and an entry in `zeta.SENSES`, the names for `Species.senses`.
"""

from __future__ import annotations

from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.senses.zeta import (
    SENSES,
    Gaze,
    Layout,
    compile_gaze,
    farthest,
    layout,
    observe,
    remember,
    show_fatal_needs,
)

__all__ = [
    "SENSES",
    "Component",
    "Gaze",
    "Layout",
    "Perceiver",
    "Perception",
    "Sense",
    "compile_gaze",
    "farthest",
    "layout",
    "observe",
    "remember",
    "show_fatal_needs",
]
