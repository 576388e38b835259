"""The defaults of evaluations and sweeps."""

from __future__ import annotations

EVALUATION_SEED = 1_000  # added to the run's seed: an evaluation draws other numbers than the life
EVALUATED = 10_000  # ticks of every life of an evaluation
SKIPPED = 1_000  # ticks of a life from birth that are not measured, or its first tenth if that is less
