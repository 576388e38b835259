"""Lane with the actions of the agent in focus."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers import colours
from ecology.observers.census import FocusSamples
from ecology.observers.panels.base import LifePanel, last, time_columns
from ecology.observers.scene import DEAD, Scene

ACTION_TICKS = 100  # of the lane on the first screen


class Action(LifePanel):
    """Draws a mark wherever the agent changes its action."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._before = -2  # the action that was last drawn

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the actions."""
        words = [a.name for a in self.species.actions]
        shades = colours.pack(np.array(colours.action_colours(self.scene.scenario, self.species), np.uint8))
        lane = rr.StateConfiguration(values=words, labels=words, colors=shades)
        rec.log(f"{self.base}/action", lane, static=True)

    def draw_life(self, rec: rr.RecordingStream, life: FocusSamples) -> None:
        """Draw the changes."""
        before = np.concatenate([[self._before], life.action[:-1]])
        self._before = int(life.action[-1])
        changed = np.flatnonzero(life.action != before)
        if changed.size:
            words = [self.species.actions[a].name if a != DEAD else "" for a in life.action[changed]]
            times = time_columns(life.tick[changed])
            rec.send_columns(f"{self.base}/action", times, rr.StateChange.columns(state=words))

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the lane."""
        at = rrb.TimeRangeBoundary.cursor_relative
        latest = rrb.TimeAxis(link="Independent", view_range=rrb.TimeRange(start=at(seq=-ACTION_TICKS), end=at(seq=0)))
        return [
            rrb.StateTimelineView(
                origin=f"/{self.base}/action",
                name=f"action, last {ACTION_TICKS} ticks",
                time_ranges=last(ACTION_TICKS),
                time_view=latest,
            )
        ]
