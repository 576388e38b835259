"""Note over the arena that no agent is alive any more."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from ecology.observers.panels.base import Batch, Panel, Watch, set_tick, text
from ecology.observers.scene import INK, Scene


class Nobody(Panel):
    """Writes the note, with the tick since which it holds."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._since: int | None = None  # tick at which no living agent was first found
        self._said = False

    def is_there(self) -> bool:
        """Return whether anybody can die."""
        return "died" in self.scene.marks

    def sample(self, watch: Watch) -> Any:
        """Return the tick since which no agent is alive, None if one is."""
        if watch.state.alive.any():
            self._since = None
        elif self._since is None:
            deaths = [event.tick for event in watch.happened if event.kind == "died"]
            self._since = max(deaths, default=watch.state.tick)
        return self._since

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Write the note, or clear it."""
        (low, bottom), (high, top) = self.scene.scenario.arena.extent
        for s, since in zip(batch.samples, batch.of(self), strict=True):
            if (since is not None) == self._said:
                continue
            self._said = since is not None
            set_tick(rec, s["tick"])
            where = np.array([[(low + high) / 2, (bottom + top) / 2]])
            words = [f"nobody lives any more, since tick {since:,}"] if since is not None else []
            rec.log("world/nobody", *text(where[: len(words)], words, [INK] * len(words)))
