"""Expectation J of the agent in focus, against the drive that followed."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import census, colours
from ecology.observers.panels.base import Batch, Panel, Watch, scalars, series, time_columns
from ecology.observers.scene import Scene


class Expectation(Panel):
    """Draws -ln(gamma) J and, at the same tick, the discounted drive that followed."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._past = census.Expectations()

    def is_there(self) -> bool:
        """Return whether the mind of the species shows its decisions."""
        return self.scene.decides[self.name]

    def follow(self, watch: Watch) -> None:
        """Take in the drive of a tick."""
        serial, state = watch.focus.serials[self.name], watch.state
        self._past.follow(serial, state.tick, state.drive[watch.focus.slots[self.name]])

    def sample(self, watch: Watch) -> Any:
        """Return J and what was met of what was expected before, None where nothing is decided."""
        decision, row, state = watch.decision(self.name), watch.row(self.name), watch.state
        if watch.tick is None or decision is None:
            return None
        value = watch.minds[self.name].deviation(row, watch.tick.observations[self.name][row : row + 1])
        met = self._past.judge(state.tick, float(decision.gamma), watch.env.dt)
        return decision.value if value is None else float(value[0]), met

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves."""
        series(rec, f"learning/{self.name}/J", ["-ln(gamma) J"], [colours.PALETTE[0]])
        series(rec, f"learning/{self.name}/met", ["drive met afterwards, discounted"], [colours.PALETTE[1]])

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        found = batch.of(self)
        at = [i for i, each in enumerate(found) if each is not None]
        if not at:
            return
        scalars(rec, f"learning/{self.name}/J", batch.at(at), np.array([[found[i][0]] for i in at]))
        met = [each for i in at for each in found[i][1]]
        if met:
            ticks, value = (np.array(part) for part in zip(*met, strict=True))
            scalars(rec, f"learning/{self.name}/met", time_columns(ticks), value[:, None])

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plot, of the focus alone."""
        if self.name in self.scene.chosen:
            return []
        return [
            self.plot(
                f"/learning/{self.name}",
                "J orange, drive met light blue",
                contents=[f"+ /learning/{self.name}/J", f"+ /learning/{self.name}/met"],
            )
        ]
