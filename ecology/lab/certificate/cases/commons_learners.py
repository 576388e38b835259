"""How many learners a common pool sustains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ecology.lab.certificate import crowds
from ecology.lab.certificate.case import Case, Row
from ecology.lab.certificate.crowds import lives_of, parts_of

ORDER = 5


def _rows(done: Mapping[str, Any]) -> list[Row]:
    lives, ticks = lives_of(done), crowds.TICKS
    found = []
    for n, of in lives.items():
        emptied = [float(life["empty"] or ticks) for life in of]
        closed = min(crowds.emptying_time(n), ticks)
        found.append(Row(f"ticks until the pool of {n:g} learners is empty, {ticks:,} at most", emptied, closed=closed))
    kept = [n for n, of in lives.items() if all(life["empty"] is None for life in of)]
    if kept and len(lives) == len(crowds.NUMBERS):
        what = "most learners of whom every pool is kept"
        found.append(Row(what, [max(kept)], closed=crowds.most(), tolerance=1.0))  # n is tried in steps of 2
    return found


def case() -> Case:
    """Return the case."""
    return Case(
        "commons_learners",
        "how many learners a common pool sustains, against eaters that take what they need, n decay <= delta E0",
        lambda: parts_of("commons", crowds.commons, crowds.NUMBERS, 4.0),
        _rows,
        table=lambda done: crowds.commons_table(lives_of(done)),
    )
