"""The decision that the agent in focus acts on, from when it is made until the next one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from ecology.observers.census import Choice
from ecology.observers.panels.base import Batch, Panel, Watch, time_columns
from ecology.observers.scene import Scene

NUMBERS = ("next_drive", "slope", "total", "score", "open")  # of a decision, in the recording


class DecisionTable(Panel):
    """Writes what the agent in focus weighed, as a table and as numbers."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._choices: list[Choice] = []  # since the last sample

    def is_there(self) -> bool:
        """Return whether the mind of the species shows its decisions."""
        return self.scene.decides[self.name]

    def follow(self, watch: Watch) -> None:
        """Note the decision where it has just been made, and where a sample is taken."""
        decision = watch.decision(self.name)
        if decision is not None and (watch.sampled or decision.age == 1):
            self._note(watch, decision)

    def _note(self, watch: Watch, decision: Any) -> None:
        state = watch.state
        self._choices = [each for each in self._choices if each.tick != state.tick]
        self._choices.append(Choice(state.tick, state.time, watch.focus.name(self.name), decision))

    def sample(self, watch: Watch) -> Any:
        """Return the decisions since the last sample, and whether there is nobody any more who decides."""
        found, self._choices = self._choices, []
        return found, watch.focus.slots[self.name] < 0 and self.name in watch.changed

    def draw(self, rec: rr.RecordingStream, batch: Batch) -> None:
        """Write the decisions."""
        found, entity = batch.of(self), f"focus/{self.name}/decision"
        gone = [i for i, (_, is_gone) in enumerate(found) if is_gone]
        if gone:
            words, kinds = ["nobody is in focus"] * len(gone), ["text/markdown"] * len(gone)
            rec.send_columns(entity, batch.at(gone), rr.TextDocument.columns(text=words, media_type=kinds))
        choices = [choice for some, _ in found for choice in some]
        if not choices:
            return
        told = [choice.decision for choice in choices]
        numbers = {
            key: np.concatenate([np.asarray(getattr(d, key), bool if key == "open" else float) for d in told])
            for key in NUMBERS
        }
        each, text = [len(d.options) for d in told], [decision_text(choice) for choice in choices]
        rec.send_columns(
            entity,
            time_columns(np.array([c.tick for c in choices]), np.array([c.time for c in choices])),
            [
                *rr.TextDocument.columns(text=text, media_type=["text/markdown"] * len(text)),
                *rr.AnyValues.columns(**{key: pa.array(value) for key, value in numbers.items()}).partition(each),
                *rr.AnyValues.columns(taken=pa.array([d.taken for d in told])),
            ],
        )

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the table."""
        return [rrb.TextDocumentView(origin=f"/{self.base}/decision", name="decision in force")]


def decision_text(choice: Choice) -> str:
    """Return a decision in Markdown: what was taken and when, and a table with the least score first."""
    d = choice.decision
    taken, since = d.options[d.taken], choice.tick - d.age
    how_far = f"tick {d.age}" + ("" if d.length is None else f" of {max(d.length, d.age)}")
    marks = ["**explored**"] * bool(d.explored) + ["**nothing learned yet**"] * (not d.learned)
    if d.recalled:
        marks.append("not in focus when it chose: scores by what it knows now")
    order = np.argsort(np.where(d.open, d.score, np.inf), kind="stable")
    rows = [
        f"**{choice.name}**: **{taken}**, chosen at {since:,}, {how_far}"
        + "".join(f"; {mark}" for mark in marks)
        + f"; -ln(γ) J = {d.value:.3f}",
        "",
        "| option | next drive | dJ/dζ·f | sum | score |",
        "|---|---|---|---|---|",
    ]
    for i in order:
        numbers = [f"{value[i]:.3f}" for value in (d.next_drive, d.slope, d.total, d.score)] if d.open[i] else ["-"] * 4
        cells = [d.options[i] if d.open[i] else f"~~{d.options[i]}~~ closed", *numbers]
        if i == d.taken:
            cells = [f"**{cell}**" for cell in (f"▶ {cells[0]}", *cells[1:])]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)
