"""The sense of a trace: a fading memory of another component of zeta."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ecology import elementary
from ecology.senses.base import Component, Perceiver, Perception, Sense
from ecology.spec import Trace
from ecology.state import Floats, State

if TYPE_CHECKING:
    from ecology.model import Model


class TraceSense(Sense):
    """Sense the largest value that a component had, fading since; `state.traces` holds it."""

    def __init__(self, whose: Perceiver, sensed: Trace) -> None:
        """Compile the trace, whose component is not known yet: see `bind`."""
        self._rows, self.sensed = whose.rows, sensed
        self.source = -1  # column of zeta
        self.place = -1  # column of `state.traces`
        self.components = (Component(f"{sensed.of}_trace", "plain", 1.0, -math.inf, math.inf),)

    def bind(self, components: Mapping[str, tuple[int, Component]], place: int) -> None:
        """Find the component that is remembered; the scenario refuses an unknown one."""
        self.place = place
        if self.sensed.of in components:
            self.source, one = components[self.sensed.of]
            self.components = (
                Component(f"{self.sensed.of}_trace", "plain", one.scale, min(one.low, 0.0), max(one.high, 0.0)),
            )

    def write(self, zeta: np.ndarray, column: int, model: Model, state: State, seen: Perception) -> None:
        """Write the trace."""
        assert state.traces is not None
        zeta[:, column] = state.traces[self._rows, self.place]


def follow(model: Model, state: State, observed: Mapping[str, np.ndarray]) -> None:
    """Let all traces fade for a tick, and take up what is `observed`, zeta (n, D) by species."""
    last = state.traces
    assert last is not None
    traces: Floats = last.copy()
    for spec in model.observation_specs:
        for sense in spec.traces:
            rows = spec.rows
            faded = traces[rows, sense.place] * elementary.exp(-sense.sensed.rate * model.dt)
            now = observed[spec.species.name][:, sense.source].astype(float)
            traces[rows, sense.place] = np.where(np.abs(now) >= np.abs(faded), now, faded)
    state.traces = np.where(state.alive[:, None], traces, last)
