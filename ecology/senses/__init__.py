"""What agents perceive: one file per sense, and zeta, all senses of a species side by side.

To add a sense, write a subclass of `Sense` in a file here and add an entry to `zeta.SENSES`, by its name in
`Species.senses`. A sense with parameters is an entry of `zeta.PARAMETRIC` instead: its file also has a frozen dataclass
of the parameters, a subclass of `SenseSpec`, which `ecology/__init__.py` exports.
"""

from __future__ import annotations

from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.senses.zeta import (
    PARAMETRIC,
    SENSES,
    Layout,
    ObservationSpec,
    compile_observation_spec,
    farthest,
    layout,
    observe,
    remember,
    show_fatal_needs,
)

__all__ = [
    "PARAMETRIC",
    "SENSES",
    "Component",
    "Layout",
    "ObservationSpec",
    "Perceiver",
    "Perception",
    "Sense",
    "compile_observation_spec",
    "farthest",
    "layout",
    "observe",
    "remember",
    "show_fatal_needs",
]
