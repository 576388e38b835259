"""Lookahead of the agent in focus: its plan as a path over the arena, the forecast of f, and the outcome."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from ecology.decision import Decision
from ecology.ground import plane_of
from ecology.observers.panels.base import Batch, Panel, Watch, last, set_tick
from ecology.observers.scene import Scene

PLAN, GHOST = (255, 210, 63), (190, 150, 255)
CAME_TICKS = 60  # for which a line from the forecast to what came is shown


class Ahead(Panel):
    """Draws the lookahead's best plan, the forecast end of the current movement (the ghost), and the last misses."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._made: tuple[int, int] = (-1, -1)  # serial and tick of the decision that is in force
        self._shown: tuple[int, int] | None = None  # the decision whose plan was last drawn
        self._hoped: np.ndarray | None = None  # (2,) where it was to lead
        self._misses: list[tuple[int, np.ndarray]] = []  # tick, and forecast and arrival (2, 2)

    def is_there(self) -> bool:
        """Return whether the mind of the species shows its decisions, and senses where it is."""
        return self.scene.decides[self.name] and "x" in self.scene.groups[self.name].layout.names

    def _place(self, states: np.ndarray) -> np.ndarray:
        """Return the places (n, 2) of states (n, D)."""
        names = self.scene.groups[self.name].layout.names
        return np.asarray(states, float)[..., [names.index("x"), names.index("y")]]

    def follow(self, watch: Watch) -> None:
        """Compare the forecast with the outcome when a new decision is made."""
        decision = watch.decision(self.name)
        if decision is None or decision.age != 1 or decision.zeta is None:
            return
        serial, state = watch.focus.serials[self.name], watch.state
        if self._made == (serial, state.tick):
            return
        here = self._place(decision.zeta)
        if self._hoped is not None and self._made[0] == serial:
            gap = plane_of(self.scene.scenario.arena).gap(self._hoped[None], here[None])[0]
            self._misses.append((state.tick, np.stack([self._hoped, self._hoped + gap])))
        self._made, self._hoped = (serial, state.tick), self._forecast(decision)

    def _forecast(self, decision: Decision) -> np.ndarray | None:
        return None if decision.after is None else self._place(decision.after[decision.taken])

    def sample(self, watch: Watch) -> Any:
        """Return the path of the plan and the ghost where they are looked at closely, and the misses since the last."""
        misses, self._misses = self._misses, []
        decision, nothing = watch.decision(self.name), np.empty((0, 2))
        if decision is None:
            return nothing, nothing, misses
        if not watch.closely:  # a plan is shown for as long as it holds
            return (None, None, misses) if self._shown == self._made else (nothing, nothing, misses)
        self._shown = self._made
        plan, ghost = watch.plan(self.name), self._forecast(decision)
        path = np.empty((0, 2)) if plan is None else self._place(plan.states)
        return path, np.empty((0, 2)) if ghost is None else ghost[None], misses

    def open(self, rec: rr.RecordingStream) -> None:
        """Give them their colours."""
        wide = rr.Radius.ui_points(1.4)
        path = rr.LineStrips2D.from_fields(colors=[PLAN], radii=wide, draw_order=17)
        rec.log(f"world/plan/{self.name}", path, static=True)
        half = 1.3 * self.scene.radius(self.species)
        ghost = rr.Ellipses2D.from_fields(
            half_sizes=[[half, half]], colors=[GHOST], line_radii=rr.Radius.ui_points(1.2), draw_order=18
        )
        rec.log(f"world/forecast/{self.name}", ghost, static=True)
        miss = rr.LineStrips2D.from_fields(colors=[GHOST], radii=rr.Radius.ui_points(0.7), draw_order=16)
        rec.log(f"world/came/{self.name}", miss, static=True)

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw them."""
        for s, (path, ghost, misses) in zip(batch.samples, batch.of(self), strict=True):
            for tick, line in misses:
                set_tick(rec, tick)
                rec.log(f"world/came/{self.name}", rr.LineStrips2D.from_fields(strips=[line]))
            if path is None:
                continue
            set_tick(rec, s["tick"])
            strips = [path] if len(path) else []
            rec.log(f"world/plan/{self.name}", rr.LineStrips2D.from_fields(strips=strips))
            centre = ghost if len(ghost) else np.full((1, 2), np.nan)  # without one it would be drawn at the origin
            rec.log(f"world/forecast/{self.name}", rr.Ellipses2D.from_fields(centers=centre))

    def overrides(self) -> dict[Any, Any]:
        """Show the last misses."""
        return {f"world/came/{self.name}": last(CAME_TICKS)}
