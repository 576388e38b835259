"""A world of self-regulated agents: continuous homeostatic reinforcement learning for many."""

from ecology.env import Ecology, Group, Tick, parallel_env
from ecology.errors import EcologyError
from ecology.scenario import Scenario
from ecology.spec import (
    Action,
    Arena,
    Drift,
    Growth,
    Need,
    Oscillation,
    Relocation,
    Resource,
    Season,
    Species,
    consume,
    go_to,
    move,
    rest,
    sleep,
    turn,
)
from ecology.state import State

__all__ = [
    "Action",
    "Arena",
    "Drift",
    "Ecology",
    "EcologyError",
    "Group",
    "Growth",
    "Need",
    "Oscillation",
    "Relocation",
    "Resource",
    "Scenario",
    "Season",
    "Species",
    "State",
    "Tick",
    "consume",
    "go_to",
    "move",
    "parallel_env",
    "rest",
    "sleep",
    "turn",
]
__version__ = "0.1.0"
