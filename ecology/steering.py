"""Continuous actions beside the discrete ones: speed and turn rate for outside learners, and a grid of them for f/J.

A body that moves along its heading can do so at any speed and turn rate that its species' moves and turns reach.
`steered` puts this into one Box per agent, as libraries of continuous control want it. `steer_grid` is the same for
learners that choose among actions.
"""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from pettingzoo import ParallelEnv

from ecology.env import Ecology, parallel_env
from ecology.errors import EcologyError
from ecology.model import Group
from ecology.scenario import Scenario
from ecology.spec import Action, move, require
from ecology.state import Floats


def steer_grid(speed: float, turn: float, *, speeds: int = 1, turns: int = 3, **rest_of: Any) -> tuple[Action, ...]:
    """Return moves on a grid of `speeds` up to `speed` and `turns` turn rates from -`turn` to `turn`, radians.

    An odd number of turns includes going straight on. Other fields of an action, such as `control`, apply to all moves.
    """
    require(speeds >= 1 and turns >= 1, f"a grid has at least one speed and one turn, got {speeds!r} and {turns!r}.")
    rates = np.linspace(-turn, turn, turns) if turns > 1 else np.zeros(1)
    return tuple(
        move(f"steer_{i + 1}_{j + 1}", speed * (i + 1) / speeds, turn=float(rate), **rest_of)
        for i in range(speeds)
        for j, rate in enumerate(rates)
    )


class _Reach:
    """What the body of one species can do: its moves by speed, and its other actions."""

    def __init__(self, group: Group, directions: Floats) -> None:
        kinds = np.array(group.kinds)
        moves = np.flatnonzero((kinds == "move") & np.isnan(directions))
        self.moves = moves[np.argsort(group.speeds[moves], kind="stable")]
        self.speeds = group.speeds[self.moves]
        self.turn = float(np.abs(group.turns).max())
        self.others = np.flatnonzero((kinds != "move") & (kinds != "turn"))
        k = len(self.others)
        low = np.array([0.0, -self.turn, *([-1.0] * k)], np.float32)
        high = np.array([self.speeds[-1] if moves.size else 0.0, self.turn, *([1.0] * k)], np.float32)
        self.space = gymnasium.spaces.Box(low, high, dtype=np.float32)

    def choose(self, action: Floats, mask: np.ndarray) -> tuple[int, float, float]:
        """Return the index of the action, and the speed and turn rate of a move, NaN of another."""
        score = np.where(mask[self.others], action[2:], -np.inf)
        best = int(score.argmax()) if score.size else -1
        if best >= 0 and score[best] > 0:
            return int(self.others[best]), np.nan, np.nan
        open_ = self.moves[mask[self.moves]]
        if not open_.size:
            return int(self.others[best]) if best >= 0 else int(mask.argmax()), np.nan, np.nan
        fast = np.flatnonzero(self.speeds[mask[self.moves]] >= action[0] - 1e-6)
        return int(open_[fast[0] if fast.size else -1]), float(action[0]), float(action[1])


class Steered(ParallelEnv):
    """A world in which every agent's action is one vector: speed, turn rate, and a score for every other action.

    If the highest score of an open action is above 0, that action is executed. Otherwise the body moves along its
    heading at the given speed and turn rate, and pays for the slowest of its moves that is at least as fast.
    """

    metadata: ClassVar[dict[str, Any]] = {"name": "ecology_steered", "render_modes": ["rgb_array"],
                                          "is_parallelizable": True}  # fmt: skip

    def __init__(self, env: Ecology) -> None:
        """Wrap a world; some species of it must have a move along its heading."""
        self.env = env
        tables = zip(env.groups.values(), env.world.model.tables, strict=True)
        self._reach = {group.name: _Reach(group, table.direction) for group, table in tables}
        if not any(reach.moves.size for reach in self._reach.values()):
            raise EcologyError(
                f"no species of {env.scenario.name!r} can be steered: none has a move along its heading; give one "
                'move("walk", speed), or act with the discrete actions.'
            )
        self.render_mode = env.render_mode
        if not env.open_population:
            self.possible_agents = env.possible_agents

    @property
    def agents(self) -> list[str]:  # type: ignore[override]
        """Return the names of the living."""
        return self.env.agents

    def observation_space(self, agent: str) -> gymnasium.spaces.Space:
        """Return the Box of zeta; the mask of the other actions is in `infos`."""
        return self.env.observation_space(agent)["observation"]

    def action_space(self, agent: str) -> gymnasium.spaces.Box:
        """Return Box(2 + k): speed, turn rate, and a score from -1 to 1 for each of k actions but moves and turns."""
        return self._reach[self.env.species_of(agent)].space

    def others(self, species: str) -> tuple[str, ...]:
        """Return the names of the actions that have a score, in their order."""
        group = self.env.groups[species]
        return tuple(group.actions[i] for i in self._reach[species].others)

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Start a new episode."""
        return self._bare(*self.env.reset(seed, options))

    def step(self, actions: dict[str, Any]) -> Any:
        """Advance one tick; every living agent needs a vector of its action space."""
        env, masks = self.env, self.env.world.perception.masks if self.env.world.started else {}
        steering, chosen = np.full((env.size, 2), np.nan), dict[str, Any]()
        for name in env.agents:
            if name not in actions:
                raise EcologyError(f"every living agent needs an action; missing: {name}.")
            species = env.species_of(name)
            group, reach, slot = env.groups[species], self._reach[species], env._slots[name]
            vector = np.asarray(actions[name], float)
            if vector.shape != reach.space.shape or not np.isfinite(vector).all():
                raise EcologyError(
                    f"the action of {name} is {reach.space.shape[0]} finite numbers, speed, turn rate and a score for "
                    f"{', '.join(self.others(species))}, got {actions[name]!r}."
                )
            chosen[name], *steering[slot] = reach.choose(vector, masks[species][slot - group.slots.start])
        observations, *between, infos = env.step({**actions, **chosen}, steering)
        observations, infos = self._bare(observations, infos)
        return observations, *between, infos

    @staticmethod
    def _bare(observations: dict[str, Any], infos: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return observations as arrays of zeta, and infos that have the masks."""
        full = {name: {**infos[name], "action_mask": each["action_mask"]} for name, each in observations.items()}
        return {name: each["observation"] for name, each in observations.items()}, full

    @property
    def seed(self) -> int | None:
        """Return the seed that the world was last reset with; None before the first reset."""
        return self.env.seed

    @property
    def state_space(self) -> gymnasium.spaces.Box:
        """Return the Box of `state()`."""
        return self.env.state_space

    def state(self) -> np.ndarray:
        """Return the world's global view, float32."""
        return self.env.state()

    def render(self) -> Any:
        """Return a picture."""
        return self.env.render()

    def close(self) -> None:
        """Close the world."""
        self.env.close()


def steered(scenario: Scenario, **words: Any) -> Steered:
    """Return the world of `scenario` with continuous actions; `words` are those of `parallel_env`."""
    return Steered(parallel_env(scenario, **words))
