"""What the certificate is made of: cases, their parts, and rows that compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

if TYPE_CHECKING:
    from ecology.observers.plotting import Figure

CONFIDENCE = 0.95  # of every interval
WIDE = 0.25  # half width of an interval, as a share of the number in it, from which it says nothing


@dataclass(frozen=True)
class Part:
    """A piece of a case that is done once: `compute` returns what JSON holds, from `parameters` alone."""

    key: str
    parameters: Mapping[str, Any]  # what it depends on; a part that was made from others is made again
    seconds: float  # measured on one core
    compute: Callable[[], Any]


@dataclass(frozen=True)
class Row:
    """One result: theirs (mean, SD, number), the closed form, and ours, a sample of one number per seed."""

    what: str
    ours: Sequence[float]
    theirs: tuple[float, float | None, int | None] | None = None
    closed: float | None = None
    tolerance: float | None = None  # of a result without chance, absolute; None: the interval decides
    verdict: str | None = None  # given where nothing is compared

    def mean(self) -> float:
        """Return the mean of ours."""
        return float(np.mean(self.ours))

    def spread(self) -> float | None:
        """Return the standard deviation of ours."""
        return float(np.std(self.ours, ddof=1)) if len(self.ours) > 1 else None

    def interval(self) -> tuple[float, float] | None:
        """Return the interval of the mean of ours, by Student's t."""
        if len(self.ours) < 2:
            return None
        half = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(self.ours) - 1)) * float(stats.sem(self.ours))
        return self.mean() - half, self.mean() + half

    def bounds(self) -> tuple[float, float]:
        """Return the interval of the mean; of a single number, the number twice."""
        return self.interval() or (self.mean(), self.mean())

    def says(self) -> str:
        """Return the verdict: whether ours agrees with the closed form and with theirs, or what it differs from."""
        if self.verdict is not None:
            return self.verdict
        found: dict[str, list[str]] = {"differs from": [], "not distinguishable from": []}
        for name, fits in (("the closed form", self._fits()), ("theirs", self._like_theirs())):
            if fits is not True:
                found["differs from" if fits is False else "not distinguishable from"].append(name)
        return "; ".join(f"{word} {' and '.join(names)}" for word, names in found.items() if names) or "agrees"

    def _fits(self) -> bool | None:
        """Return whether ours agrees with the closed form (also without one), None where the interval is wide."""
        if self.closed is None:
            return True
        if self.tolerance is not None:
            return abs(self.mean() - self.closed) <= self.tolerance
        low, high = self.bounds()
        return _within(self.closed, low, high)

    def _like_theirs(self) -> bool | None:
        """Return whether ours agrees with theirs (also without them), None where the interval is wide."""
        if self.theirs is None:
            return True
        mean, spread, count = self.theirs
        if self.tolerance is not None or spread is None or count is None:
            low, high = self.bounds()
            slack = self.tolerance or 0.0
            return low - slack <= mean <= high + slack
        # Welch's interval of the difference, about ours
        a, b = spread**2 / count, (self.spread() or 0.0) ** 2 / len(self.ours)
        if a + b == 0:
            return self.mean() == mean
        freedom = (a + b) ** 2 / (a**2 / (count - 1) + b**2 / max(len(self.ours) - 1, 1))
        half = float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom)) * math.sqrt(a + b)
        return _within(mean, self.mean() - half, self.mean() + half)


def _within(value: float, low: float, high: float) -> bool | None:
    """Return whether an interval holds `value`; None where it does, but would hold much else too."""
    if not low - 1e-9 <= value <= high + 1e-9:
        return False
    return True if high - low <= 2 * WIDE * abs(value) else None


@dataclass(frozen=True)
class Case:
    """A result from elsewhere, by name."""

    name: str
    about: str  # what is compared, and whose it is
    parts: Callable[[], list[Part]]
    rows: Callable[[Mapping[str, Any]], list[Row]]  # by the keys of the parts; parts may be missing
    notes: list[str] = field(default_factory=list)
    table: Callable[[Mapping[str, Any]], str] | None = None  # in Markdown, of what the rows do not hold
    figure: Callable[[Mapping[str, Any], Figure], None] | None = None  # draws what a paper would print
