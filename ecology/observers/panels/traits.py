"""The distribution of every trait."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun.blueprint as rrb

from ecology.observers import census
from ecology.observers.panels.ages import Bars, bar_views
from ecology.observers.panels.base import Watch


class Traits(Bars):
    """Draws the traits of the living."""

    entity = "population/traits"

    def sample(self, watch: Watch) -> Any:
        """Return the classes by species and trait."""
        if not watch.sparse:
            return None
        found = census.histograms(self.scene.scenario, watch.state)
        return {name: (middle, np.ptp(middle[:2]), number) for name, (middle, number) in found.items()}

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return a chart per trait."""
        titles = [
            (f"{s.name}/{trait.name}", f"{trait.name} of {s.name} ({trait.of})")
            for s in self.scene.scenario.species
            for trait in s.traits
        ]
        return bar_views(self.entity, titles)
