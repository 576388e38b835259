"""Comparison of a run with the fork that was made while it was watched."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.ground import plane_of
from ecology.observers import colours
from ecology.observers.panels.base import THIRD_PLOT, Batch, Ends, Panel, Watch, scalars, series
from ecology.observers.scene import Scene

TALL = 150  # points, of a plot on a small screen


class Futures(Panel):
    """Compares two worlds at the same tick: this run, and the fork."""

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._began, self._change = 0, ""
        self._first: int | None = None  # first tick at which an agent acted differently
        self._ends = {what: Ends(f"futures/{what}", TALL) for what in ("living", "drive", "apart")}

    def begin(self, tick: int, change: str) -> None:
        """Note when the futures part, and what is changed in the fork."""
        self._began, self._change = tick, change

    def compare(self, here: Watch, fork: Watch) -> Any:
        """Return the numbers of both futures, and a text with their differences."""
        sides, groups = (here.state, fork.state), self.scene.groups.values()
        living = [int(state.alive[g.slots].sum()) for g in groups for state in sides]
        drives = [self._mean(state.own_drive[g.slots][state.alive[g.slots]]) for g in groups for state in sides]
        one, other = sides
        both = one.alive & other.alive & (one.serial == other.serial)
        acts = int((both & (one.action != other.action)).sum()) if one.tick > self._began else 0
        if acts and self._first is None:
            self._first = one.tick
        gap = plane_of(self.scene.scenario.arena).gap(one.position[both], other.position[both])
        apart = self._mean(np.hypot(*gap.T)) if both.any() else np.nan
        text = self._text(here, fork, living, drives, (acts, int(both.sum()), apart))
        return {"living": living, "drive": drives, "apart": apart, "text": text}

    @staticmethod
    def _mean(value: np.ndarray) -> float:
        return float(value.mean()) if value.size else np.nan

    def _text(
        self, here: Watch, fork: Watch, living: list[int], drives: list[float], differs: tuple[int, int, float]
    ) -> str:
        acts, both, apart = differs
        rows = [
            f"**{self.scene.fork}** left **{self.scene.run}** at tick {self._began:,}"
            + (f": **{self._change}**" if self._change else ", unchanged"),
            "",
            f"| tick {here.state.tick:,} | {self.scene.run} | {self.scene.fork} |",
            "|---|---|---|",
        ]
        for i, name in enumerate(self.scene.groups):
            rows.append(f"| {name} alive | {living[2 * i]} | {living[2 * i + 1]} |")
            rows.append(f"| mean own drive of {name} | {_number(drives[2 * i])} | {_number(drives[2 * i + 1])} |")
        for name in self.scene.groups:
            rows += self._focus_rows(name, here, fork)
        since = "" if self._first is None else f", first seen at tick {self._first:,}"
        rows += [
            "",
            f"{acts} of {both} agents that live in both act otherwise{since}; they are {_number(apart)} apart.",
        ]
        return "\n".join(rows)

    def _focus_rows(self, name: str, here: Watch, fork: Watch) -> list[str]:
        """Return the rows of a species' focus in both futures."""
        species = self.scene.scenario.species[self.scene.groups[name].index]
        slots = [watch.focus.slots[name] for watch in (here, fork)]
        who = [watch.focus.name(name) for watch in (here, fork)]
        rows = [f"| in focus | {who[0]} | {who[1]} |"]
        states = (here.state, fork.state)

        def pair(what: str, values: list[str]) -> str:
            mark = "**" if values[0] != values[1] else ""
            return f"| {mark}{what}{mark} | {' | '.join(values)} |"

        acts = [species.actions[s.action[i]].name if i >= 0 else "-" for s, i in zip(states, slots, strict=True)]
        rows.append(pair("does", acts))
        for k, need in enumerate(species.needs):
            values = [_number(float(s.internal[i, k])) if i >= 0 else "-" for s, i in zip(states, slots, strict=True)]
            rows.append(pair(need.name, values))
        return rows

    def open(self, rec: rr.RecordingStream) -> None:
        """Name and colour the curves: of every species this run, then the fork, dimmed."""
        shades = [each for n in self.scene.groups for each in self._shades(n)]
        words = [word for name in self.scene.groups for word in (name, f"{name}, fork")]
        for what in ("living", "drive"):
            series(rec, f"futures/{what}", words, shades, [2.0, 1.2] * len(self.scene.groups))
        series(rec, "futures/apart", ["mean distance between an agent and itself"], [colours.PALETTE[0]])
        for each in self._ends.values():
            each.open(rec)

    def _shades(self, name: str) -> list[colours.Colour]:
        alone = len(self.scene.groups) == 1
        return [self.scene.colour(name), colours.PALETTE[1] if alone else colours.darken(self.scene.colour(name), 0.6)]

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Draw the comparisons."""
        found = [s["futures"] for s in batch.samples]
        for what, ends in self._ends.items():
            value = np.array([np.atleast_1d(each[what]) for each in found], float)
            scalars(rec, f"futures/{what}", batch.times, value)
            ends.draw(rec, batch.ticks, value)
        texts = [each["text"] for each in found]
        documents = rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
        rec.send_columns("futures/text", batch.times, documents)

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return what differs, and the curves of both."""
        names = {"living": "living (fork thin)", "drive": "own drive (fork thin)", "apart": "distance"}
        if sum(group.size for group in self.scene.groups.values()) == 1:
            del names["living"]
        at = self.scene.forked_at
        curves = [self.plot(f"/futures/{what}", name, THIRD_PLOT, since=at) for what, name in names.items()]
        return [
            rrb.TextDocumentView(origin="/futures/text", name="what differs"),
            rrb.Horizontal(*curves),
        ]


def _number(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{value:.3f}"
