"""A world of self-regulated agents: continuous homeostatic reinforcement learning for many."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ecology.archipelago import Archipelago, Island, Migration, Pool
    from ecology.env import Ecology, parallel_env
    from ecology.errors import EcologyError
    from ecology.meetings import Outcome, World
    from ecology.model import Group
    from ecology.scenario import Scenario
    from ecology.single import GymEnv, gym_env
    from ecology.spec import (
        Action,
        Adaptation,
        Arena,
        Birth,
        Crowding,
        Cue,
        Door,
        Drift,
        Empathy,
        Event,
        Exposure,
        Fault,
        Field,
        Gauge,
        Growth,
        Hazard,
        Hearing,
        Need,
        Neighbours,
        Oscillation,
        Rays,
        Relocation,
        Remains,
        Resource,
        Season,
        Seeding,
        Session,
        Species,
        Stage,
        Trace,
        Trait,
        act,
        bite,
        consume,
        drop,
        give,
        go_to,
        move,
        rest,
        sleep,
        take,
        turn,
    )
    from ecology.state import State
    from ecology.steering import Steered, steer_grid, steered
    from ecology.world import Tick

__all__ = [
    "Action",
    "Adaptation",
    "Archipelago",
    "Arena",
    "Birth",
    "Crowding",
    "Cue",
    "Door",
    "Drift",
    "Ecology",
    "EcologyError",
    "Empathy",
    "Event",
    "Exposure",
    "Fault",
    "Field",
    "Gauge",
    "Group",
    "Growth",
    "GymEnv",
    "Hazard",
    "Hearing",
    "Island",
    "Migration",
    "Need",
    "Neighbours",
    "Oscillation",
    "Outcome",
    "Pool",
    "Rays",
    "Relocation",
    "Remains",
    "Resource",
    "Scenario",
    "Season",
    "Seeding",
    "Session",
    "Species",
    "Stage",
    "State",
    "Steered",
    "Tick",
    "Trace",
    "Trait",
    "World",
    "act",
    "bite",
    "consume",
    "drop",
    "give",
    "go_to",
    "gym_env",
    "move",
    "parallel_env",
    "rest",
    "sleep",
    "steer_grid",
    "steered",
    "take",
    "turn",
]
__version__ = "0.2.0.dev0"

# name -> module, of all others ecology.spec; loaded at the first use, so that what needs no world starts at once
_HOMES = {
    "Archipelago": "archipelago",
    "Ecology": "env",
    "EcologyError": "errors",
    "Group": "model",
    "GymEnv": "single",
    "Island": "archipelago",
    "Migration": "archipelago",
    "Outcome": "meetings",
    "Pool": "archipelago",
    "Scenario": "scenario",
    "State": "state",
    "Steered": "steering",
    "Tick": "world",
    "World": "meetings",
    "gym_env": "single",
    "parallel_env": "env",
    "steer_grid": "steering",
    "steered": "steering",
}

if not TYPE_CHECKING:  # type checkers find a misspelt name

    def __getattr__(name: str) -> Any:
        """Load a name of `__all__`."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{__name__}.{_HOMES.get(name, 'spec')}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    """Return all names, loaded or not."""
    return sorted({*globals(), *__all__})
