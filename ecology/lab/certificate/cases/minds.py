"""How well and how soon the learner regulates in `paper`: measured by `ecology reproduce minds` alone."""

from __future__ import annotations

from ecology.lab.certificate.case import Case

ORDER = 11


def case() -> Case:
    """Return the case."""
    return Case(
        "minds",
        "how well and how soon the learner regulates in `paper`, over many seeds",
        list,
        lambda _: [],
        ["It takes hours and runs only when it is named: ecology reproduce minds."],
    )
