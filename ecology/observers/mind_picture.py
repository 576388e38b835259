"""Picture of one agent's needs and current decision, drawn beside the arena of a film."""

from __future__ import annotations

import textwrap

import numpy as np

from ecology.observers.colours import need_colour
from ecology.observers.frame import Followed
from ecology.observers.plotting import Axes

OPTIONS = 8  # of a decision, at most
COLUMNS = (0, 1, 4)  # of its table: option, next drive, score
TITLE, NAME = 10, 8  # heights of the letters of an agent's name and of its needs, points
LETTER = 7.5  # height of a letter, points
WIDTH = 0.61  # of a letter, as a share of its height


class MindPicture:
    """Draws an agent frame after frame."""

    def __init__(self, needs: Axes, decision: Axes, longest: str) -> None:
        """Draw into two axes, with room for a title and for the `longest` name of a need."""
        self._needs, self._decision = needs, decision
        needs.set_title("name", fontsize=TITLE)
        needs.set_yticks([0], [longest], fontsize=NAME)

    def draw(self, who: Followed | None) -> None:
        """Draw the agent's present state; draw nothing if there is no agent."""
        self._needs.clear()
        self._decision.clear()
        self._decision.set_axis_off()
        if who is None:
            return
        names = [need.name for need in who.species.needs]
        shades = [tuple(part / 255 for part in need_colour(i)) for i in range(len(names))]
        rows = np.arange(len(names))[::-1]
        self._needs.barh(rows, np.nan_to_num(who.needs), color=shades, height=0.7)
        regulated = np.array([need.regulated for need in who.species.needs])
        self._needs.plot(who.target[regulated], rows[regulated], "|", color="black", markersize=14, markeredgewidth=2)
        self._needs.set_yticks(rows, names, fontsize=NAME)
        highest = [
            max(need.set_point, need.bounds[1] if np.isfinite(need.bounds[1]) else 0) for need in who.species.needs
        ]
        self._needs.set_xlim(min(0.0, float(np.nanmin(np.append(who.needs, 0.0)))), 1.05 * max(*highest, 1e-9, 0.0))
        lives = bool(np.isfinite(who.place).all())
        self._needs.set_title(who.name if lives else f"{who.name} is not alive", fontsize=TITLE)
        figure = self._decision.get_figure(root=True)
        assert figure is not None
        points = self._decision.bbox.width * 72 / figure.dpi
        text = _plain(who.decision, int(points / (WIDTH * LETTER)))
        self._decision.text(0, 1, text, family="monospace", fontsize=LETTER, va="top")


def _plain(text: str, wide: int) -> str:
    """Return a decision in Markdown as lines of plain text, of at most `wide` letters where they are no table."""
    if not text:
        return "no decision was recorded"
    found, rows = [], []
    for line in text.replace("**", "").replace("~~", "").splitlines():
        if line.startswith("|"):
            cells = [cell.strip() for cell in line.strip("|").split("|")]
            if not set(line) <= set("|-"):
                rows.append(cells)
        elif line:
            found += textwrap.wrap(line, wide)
    table = rows[: 1 + OPTIONS]
    table = [row for row in table if len(row) == len(table[0])] if table else []
    table = [[row[i] for i in COLUMNS] for row in table if len(row) > max(COLUMNS)]
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))] if table else []
    lines = [" ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)) for row in table]
    return "\n".join([*found, "", *lines])
