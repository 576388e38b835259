"""The decision that the agent in focus acts on, from when it is made until the next one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from ecology.decision import Decision
from ecology.observers.census import Choice
from ecology.observers.panels.base import Batch, Panel, Watch, time_columns
from ecology.observers.scene import Scene

SHOWN = ("deviation", "position")  # kinds of components whose forecast is compared with what came
NUMBERS = ("next_drive", "slope", "total", "score", "open")  # of a decision, in the recording


class DecisionTable(Panel):
    """Writes the decision of the agent in focus, as a table and as numbers."""

    each = True

    def __init__(self, scene: Scene, name: str = "") -> None:
        super().__init__(scene, name)
        self._choices: list[Choice] = []  # since the last sample
        self._plan: tuple[str, ...] = ()
        self._last: tuple[tuple[int, int], Decision | None] = ((-1, -1), None)  # serial and tick of the last one
        self._came: tuple[str, Sequence[tuple[str, float, float]]] = ("", ())

    def is_there(self) -> bool:
        """Return whether the mind of the species shows its decisions."""
        return self.scene.decides[self.name]

    def follow(self, watch: Watch) -> None:
        """Note the decision where it has just been made, and where a sample is taken."""
        decision, serial = watch.decision(self.name), watch.focus.serials[self.name]
        if decision is None or not (watch.sampled or decision.age == 1):
            return
        if decision.age == 1 and self._last[0] != (serial, watch.state.tick):
            self._judge(decision, serial, watch.state.tick)
        plan = watch.plan(self.name) if watch.closely else None
        if decision.age == 1 or plan is not None:
            self._plan = () if plan is None else plan.options
        state, name = watch.state, watch.focus.name(self.name)
        self._choices = [each for each in self._choices if each.tick != state.tick]
        self._choices.append(Choice(state.tick, name, decision, self._plan, *self._came))

    def _judge(self, decision: Decision, serial: int, tick: int) -> None:
        """When a new decision is made, compare the forecast of f for the previous option with the outcome."""
        (before, _), expected = self._last
        self._came = ("", ())
        if expected is not None and before == serial and expected.after is not None and decision.zeta is not None:
            forecast, layout = expected.after[expected.taken], self.scene.groups[self.name].layout
            shown = [i for i, kind in enumerate(layout.kinds) if kind in SHOWN]
            came = [(layout.names[i], float(forecast[i]), float(decision.zeta[i])) for i in shown]
            self._came = (expected.options[expected.taken], came)
        self._last = (serial, tick), decision

    def sample(self, watch: Watch) -> Any:
        """Return the decisions since the last sample, and whether the deciding agent is gone."""
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
        decisions = [choice.decision for choice in choices]
        numbers = {
            key: np.concatenate([np.asarray(getattr(d, key), bool if key == "open" else float) for d in decisions])
            for key in NUMBERS
        }
        each, text = [len(d.options) for d in decisions], [decision_text(choice) for choice in choices]
        rec.send_columns(
            entity,
            time_columns(np.array([c.tick for c in choices])),
            [
                *rr.TextDocument.columns(text=text, media_type=["text/markdown"] * len(text)),
                *rr.AnyValues.columns(**{key: pa.array(value) for key, value in numbers.items()}).partition(each),
                *rr.AnyValues.columns(taken=pa.array([d.taken for d in decisions])),
            ],
        )

    def views(self) -> list[rrb.View | rrb.Container]:
        """Return the table."""
        return [rrb.TextDocumentView(origin=f"/{self.base}/decision", name="decision in force")]


def headline(d: Decision, tick: int, *, bold: bool = False) -> str:
    """Return a summary of the decision in force at `tick`: "walk, chosen at 3,981, tick 4 of 10"."""
    mark = "**" if bold else ""
    how_far = f"tick {d.age}" + ("" if d.length is None else f" of {max(d.length, d.age)}")
    marks = ["explored"] * bool(d.explored) + ["nothing learned yet"] * (not d.learned)
    words = [f"{mark}{d.options[d.taken]}{mark}, chosen at {tick - d.age:,}, {how_far}"]
    words += [f"{mark}{each}{mark}" for each in marks]
    words += ["not in focus when it chose: scores by what it knows now"] * d.recalled
    return "; ".join(words)


def decision_text(choice: Choice) -> str:
    """Return a decision in Markdown: the option taken, when, and a table with the least score first."""
    d = choice.decision
    head = f"**{choice.name}**: " + headline(d, choice.tick, bold=True)
    order = np.argsort(np.where(d.open, d.score, np.inf), kind="stable")
    rows = [
        f"{head}; -ln(γ) J = {d.value:.3f}",
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
    if choice.plan:
        rows.insert(1, f"\nplan: {' → '.join(choice.plan)}")
    if choice.came:
        rows += ["", f"| after {choice.last} | f forecast | came |", "|---|---|---|"]
        rows += [f"| {name} | {forecast:.3f} | {came:.3f} |" for name, forecast, came in choice.came]
    return "\n".join(rows)
