"""A world of self-regulated agents: continuous homeostatic reinforcement learning for many."""

from ecology.env import Ecology, parallel_env
from ecology.errors import EcologyError
from ecology.meetings import Outcome, World
from ecology.model import Group
from ecology.scenario import Scenario
from ecology.single import GymEnv, gym_env
from ecology.spec import (
    Action,
    Arena,
    Birth,
    Crowding,
    Drift,
    Empathy,
    Growth,
    Hazard,
    Need,
    Neighbours,
    Oscillation,
    Relocation,
    Resource,
    Season,
    Species,
    act,
    bite,
    consume,
    give,
    go_to,
    move,
    rest,
    sleep,
    turn,
)
from ecology.state import State
from ecology.world import Tick

__all__ = [
    "Action",
    "Arena",
    "Birth",
    "Crowding",
    "Drift",
    "Ecology",
    "EcologyError",
    "Empathy",
    "Group",
    "Growth",
    "GymEnv",
    "Hazard",
    "Need",
    "Neighbours",
    "Oscillation",
    "Outcome",
    "Relocation",
    "Resource",
    "Scenario",
    "Season",
    "Species",
    "State",
    "Tick",
    "World",
    "act",
    "bite",
    "consume",
    "give",
    "go_to",
    "gym_env",
    "move",
    "parallel_env",
    "rest",
    "sleep",
    "turn",
]
__version__ = "0.2.0.dev0"
