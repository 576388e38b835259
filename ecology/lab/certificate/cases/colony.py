"""What becomes of a brood that is fed by nurses."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ecology.lab.certificate import crowds
from ecology.lab.certificate.case import Case, Row
from ecology.lab.certificate.crowds import lives_of, parts_of

ORDER = 6


def _rows(done: Mapping[str, Any]) -> list[Row]:
    given = "no number to compare with"
    return [
        Row(f"{what}, weight {weight:g}", of, verdict=given)
        for what, word in (("share of the brood alive at the end", "brood alive"), ("own drive of the brood", "brood"))
        for weight, lives in lives_of(done).items()
        if (of := [life[word] for life in lives if life[word] is not None])
    ]


def case() -> Case:
    """Return the case."""
    return Case(
        "colony",
        "what becomes of a brood that is fed by nurses, by how much they feel of it",
        lambda: parts_of("colony", crowds.colony, crowds.WEIGHTS, 5.0),
        _rows,
        table=lambda done: crowds.colony_table(lives_of(done)),
    )
