"""Those who act: learners and the policies that they are measured against."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.base import Learner
from ecology import EcologyError, Group
from ecology.errors import nearest

# name -> module, class, the mapping in the module that holds its settings where they are not the
# defaults, and a line for `ecology list`; loaded when asked for
LEARNERS: Mapping[str, tuple[str, str, str | None, str]] = {
    "hjb": (
        "agents.hjb",
        "HJB",
        None,
        "f and J learned online, acting by the Hamilton-Jacobi-Bellman equation",
    ),
    "algorithm1": (
        "agents.hjb",
        "HJB",
        "ALGORITHM1",
        "the paper's Algorithm 1 as printed, without additions",
    ),
    "lean": (
        "agents.hjb",
        "HJB",
        "LEAN",
        "hjb with little work per agent, for many agents",
    ),
    "random": ("agents.baselines", "Random", None, "every open action with the same probability"),
    "rest": ("agents.baselines", "Rest", None, "does nothing for as long as its body lets it"),
    "greedy": ("agents.baselines", "Greedy", None, "the least predicted drive one tick ahead"),
    "qvalue": ("agents.baselines", "QValue", None, "the least mean drive seen after an action"),
}


def learner_class(name: str) -> type[Learner]:
    """Return the class of the learner `name`."""
    if name not in LEARNERS:
        raise EcologyError(f"there is no learner {name!r}. {nearest(name, LEARNERS)}")
    module, cls, _, _ = LEARNERS[name]
    return getattr(importlib.import_module(module), cls)


def settings(name: str) -> dict[str, Any]:
    """Return the settings of the learner `name` with their defaults."""
    cls = learner_class(name)
    module, _, preset, _ = LEARNERS[name]
    return {**cls.defaults(), **(getattr(importlib.import_module(module), preset) if preset else {})}


def make(
    name: str, group: Group, seed: np.random.SeedSequence, settings_: Mapping[str, Any], device: str = "cpu"
) -> Learner:
    """Return a learner `name` for the slots of `group`; `settings_` where they are not the defaults.

    It computes on `device` if it can, else on the CPU. EcologyError where the device is not here.
    """
    cls = learner_class(name)
    words = {"device": device} if cls.devices else {}
    return cls.with_settings(group, seed, {**settings(name), **settings_}, **words)
