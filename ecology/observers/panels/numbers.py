"""The other numbers that a species' minds report, mean over the living: epsilon, decisions."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from ecology.observers.panels.losses import Reported


class Numbers(Reported):
    """Draws a plot per number."""

    part = "numbers"

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the plots."""
        found: list[rrb.View | rrb.Container] = []
        for word in self.words:
            lines = rr.SeriesLines.from_fields(visible_series=[other == word for other in self.words])
            found.append(self.plot(f"/{self.entity}", word, overrides={self.entity: lines}))
        return found
