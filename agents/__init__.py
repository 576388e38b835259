"""Those who act: learners and the policies that they are measured against."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.base import Learner
from ecology import EcologyError, Group
from ecology.errors import nearest

# name -> module and class; loaded when asked for, so that `ecology list` is quick
LEARNERS: Mapping[str, tuple[str, str]] = {
    "hjb": ("agents.hjb", "HJB"),
    "random": ("agents.baselines", "Random"),
    "rest": ("agents.baselines", "Rest"),
    "greedy": ("agents.baselines", "Greedy"),
}


def learner_class(name: str) -> type[Learner]:
    """Return the class of the learner `name`."""
    if name not in LEARNERS:
        raise EcologyError(f"there is no learner {name!r}. {nearest(name, LEARNERS)}")
    module, cls = LEARNERS[name]
    return getattr(importlib.import_module(module), cls)


def settings(name: str) -> dict[str, Any]:
    """Return the settings of the learner `name` with their defaults."""
    return learner_class(name).defaults()


def make(name: str, group: Group, seed: np.random.SeedSequence, settings: Mapping[str, Any]) -> Learner:
    """Return a learner `name` for the slots of `group`, with its settings."""
    cls = learner_class(name)
    return cls.with_settings(group, seed, settings)
