"""Staying at one resource in the authors' own world."""

from __future__ import annotations

from ecology.lab.certificate import authors
from ecology.lab.certificate.case import Case

ORDER = 3


def case() -> Case:
    """Return the case."""
    return Case(
        "camping",
        "staying at one resource in the authors' own world",
        lambda: authors.parts(True),
        authors.rows,
    )
