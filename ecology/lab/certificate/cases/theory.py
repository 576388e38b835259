"""The drive under constant intake, against its closed form."""

from __future__ import annotations

import math

import numpy as np

from ecology import Need, Species, physiology, rest
from ecology.lab.certificate.case import Case, Part, Row

ORDER = 1


def _theory() -> float:
    """Return the largest error of d(t) and r(t) along lives with constant intake, section 3.2 of the paper."""
    worst, dt, m = 0.0, 0.01, 0.3
    for delta in ((-1.0, -2.0, 0.5), (-1.0, 0.0, 0.0), (0.5, -1.0, 2.0), (-0.2, 3.0, 0.0)):
        needs = tuple(
            Need(name=f"need_{i}", set_point=5.0, start=5.0 + x, bounds=(0.0, 20.0)) for i, x in enumerate(delta)
        )
        body = physiology.compile_bodies(
            (Species(name="eater", needs=needs, actions=(rest(),), drive_epsilon=1e-12),), 3
        )
        control, internal, rng = np.array([[m, 0.0, 0.0]]), body.start, np.random.default_rng(0)
        squared = float(np.square(delta).sum())
        for k in range(1, 301):
            internal = physiology.advance(body, internal, control, (k - 1) * dt, np.zeros(1), dt, rng)
            t = k * dt
            drive = physiology.drive(physiology.deviation(body, internal), body.epsilon)[0]
            worst = max(worst, abs(drive - math.sqrt(t**2 * m**2 + 2 * t * m * delta[0] + squared)))
    return worst


def case() -> Case:
    """Return the case."""
    return Case(
        "theory",
        "the drive under constant intake against its closed form (Laurencon et al. 2021, section 3.2)",
        lambda: [Part("d", {}, 2.0, lambda: [_theory()])],
        lambda done: [
            Row("largest error of d(t), 4 starts", ours, closed=0.0, tolerance=1e-9) for ours in done.values()
        ],
    )
