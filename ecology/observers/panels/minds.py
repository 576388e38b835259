"""Decisions of all agents, if there are few."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from ecology.observers.census import Choice
from ecology.observers.panels.base import Batch, Panel, Watch, time_columns
from ecology.observers.panels.decision import decision_text
from ecology.observers.scene import EVERYBODY, Scene


class Minds(Panel):
    """Records every decision when it is made, so that a viewer can look back at it."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._choices: list[Choice] = []  # since the last sample

    def is_there(self) -> bool:
        """Return whether there are several, few enough, with minds that show their decisions."""
        size = sum(group.size for group in self.scene.groups.values())
        return self.scene.decides[self.name] and 1 < size <= EVERYBODY

    def follow(self, watch: Watch) -> None:
        """Note the decisions that were made in this tick."""
        state, rows = watch.state, self.scene.groups[self.name].slots
        for row in np.flatnonzero(state.alive[rows]).tolist():
            decision = watch.minds[self.name].decision(row)
            if decision is not None and decision.age == 1:
                name = f"{self.name}_{state.serial[rows.start + row]}"
                self._choices.append(Choice(state.tick, name, decision))

    def sample(self, watch: Watch) -> Any:
        """Return the decisions since the last sample."""
        found, self._choices = self._choices, []
        return found

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Write them, by agent."""
        by: dict[str, list[Choice]] = {}
        for choice in (choice for some in batch.of(self) for choice in some):
            by.setdefault(choice.name, []).append(choice)
        for name, choices in by.items():
            times = time_columns(np.array([c.tick for c in choices]))
            texts = [decision_text(choice) for choice in choices]
            documents = rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
            rec.send_columns(f"minds/{name}/decision", times, documents)
