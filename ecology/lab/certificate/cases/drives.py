"""Random and resting agents in the authors' own world."""

from __future__ import annotations

from ecology.lab.certificate import authors
from ecology.lab.certificate.case import Case

ORDER = 2


def case() -> Case:
    """Return the case."""
    return Case(
        "drives",
        "random and resting agents in the authors' own world",
        lambda: authors.parts(False),
        authors.rows,
    )
