"""Event log: births, deaths, bites, gifts, meals, sleep, and interventions."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import TimelineColumn

from ecology.observers import census, colours
from ecology.observers.panels.base import Batch, Panel, Watch, time_columns
from ecology.observers.scene import FAINT, MARKED

LINES = {True: 20, False: 5}  # per kind and sample, of few agents and of many; the rest is counted
DEED = 0xFFD23FFF  # colour of an intervention


class Events(Panel):
    """Writes every event if there are few agents; otherwise the first of each kind, and the number of others."""

    def sample(self, watch: Watch) -> Any:
        """Return the events and the interventions."""
        return watch.happened, watch.deeds

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Write the lines."""
        found = batch.of(self)
        deeds = [deed for _, some in found for deed in some]
        if deeds:
            self._write(rec, "interventions", [(tick, "intervention", words) for tick, words in deeds])
        for name in self.scene.groups:
            rows: list[tuple[int, str, str]] = []
            for s, (happened, _) in zip(batch.samples, found, strict=True):
                rows += self._rows(name, s, happened)
            if rows:
                self._write(rec, name, rows)

    def _rows(self, name: str, s: Any, happened: Any) -> list[tuple[int, str, str]]:
        """Return the lines of a species of one sample: tick, kind, words."""
        groups, group, focus = list(self.scene.groups.values()), self.scene.groups[name], s["focus"][name]
        rows = [(s["tick"], "focus", f"now in focus: {focus['name']}")] if focus["anew"] else []
        most, left = LINES[self.scene.few], dict[str, int]()
        for event in happened:
            mine = (event.slot >= group.slots.start) & (event.slot < group.slots.stop)
            for i in np.flatnonzero(mine):
                left[event.kind] = left.get(event.kind, 0) + 1
                if left[event.kind] <= most:
                    words = census.words(self.scene.scenario, groups, event, int(i))
                    rows.append((event.tick, event.kind, words))
        more = {kind: many - most for kind, many in left.items() if many > most}
        return rows + [(s["tick"], kind, f"and {many} more {name} {kind}") for kind, many in more.items()]

    def _write(self, rec: rr.RecordingStream, name: str, rows: list[tuple[int, str, str]]) -> None:
        ticks, kinds, texts = zip(*rows, strict=True)
        shades = colours.pack(np.array([MARKED.get(kind, FAINT) for kind in kinds], np.uint8))
        if name == "interventions":
            shades = np.full(len(rows), DEED, np.uint32)
        entries = [f"{tick:,}  {words}" for tick, words in zip(ticks, texts, strict=True)]
        lines = rr.TextLog.columns(text=entries, level=kinds, color=shades)
        rec.send_columns(f"events/{name}", time_columns(np.array(ticks)), lines)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the log."""
        ticks = TimelineColumn("tick", visible=False)  # its column would be too narrow: the words tell it
        columns = rrb.TextLogColumns(timeline_columns=[ticks], text_log_columns=["Body"])
        return [rrb.TextLogView(origin="/events", name="events", columns=columns)]
