"""FixedSlots: a world of births and deaths for libraries that require a fixed list of agents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from ecology.env import Ecology, float32_below
from ecology.errors import EcologyError, nearest
from ecology.model import Group
from ecology.spec import require
from ecology.state import Floats, Ints
from ecology.world import Tick


class FixedSlots(ParallelEnv):
    """The slots of a world as PettingZoo agents, `{species}_slot_{i}`: the list never changes (black death).

    An empty slot observes zeros, can only rest and gets the reward 0. A death closes a slot and gives its
    last reward; a newborn starts a new life in a slot, with reward 0 on that tick. No slot terminates;
    at the world's horizon all are truncated. `infos[name]` holds Ecology's `drive` and `closed`, and
    `alive`, `born` (in this tick) and `agent`, the name of the agent in the slot or None.
    """

    metadata: ClassVar[dict[str, Any]] = {**Ecology.metadata, "name": "ecology_fixed_slots"}

    def __init__(self, env: Ecology, *, flatten: bool = False, pad: bool = False, names: bool = True) -> None:
        """Wrap `env`, which must not be stepped directly from now on.

        `flatten`: an observation is one Box, float32 (D + A,): zeta, then the action mask. `pad`: all
        species have the spaces of the largest D and A; what is added to an observation is 0, and an
        added action is closed and means rest. `names` False leaves `agent` out of infos, for
        libraries that take numbers only.
        """
        require(isinstance(env, Ecology), f"FixedSlots takes an Ecology, `ecology.parallel_env(...)`, got {env!r}.")
        self.env = env
        self.flatten, self.pad, self.names = flatten, pad, names
        self.render_mode = env.render_mode
        groups = env.groups.values()
        self._group_of = {f"{g.name}_slot_{row}": g for g in groups for row in range(g.size)}  # in the order of slots
        self.possible_agents = list(self._group_of)
        self.agents: list[str] = []
        self.action_spaces = {name: spaces.Discrete(self._width(g)[1]) for name, g in self._group_of.items()}
        boxes = {g.name: self._space(g) for g in groups}
        self.observation_spaces = {name: boxes[g.name] for name, g in self._group_of.items()}
        self._rest = np.array([g.kinds.index("rest") for g in self._group_of.values()], np.int64)  # (N,)
        self._actions = np.array([len(g.actions) for g in self._group_of.values()], np.int64)  # (N,)
        self._ticks = 0

    def observation_space(self, agent: str) -> spaces.Space:
        """Return Dict(observation Box float32 (D,), action_mask Box int8 (A,)), or Box (D + A,) if `flatten`."""
        return self.observation_spaces[self._check_name(agent)]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return Discrete(A)."""
        return self.action_spaces[self._check_name(agent)]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Start a new episode; without a seed, from one that the world draws or derives from the last."""
        tick = self.env.reset_arrays(seed)
        self._ticks = 0
        self.agents = list(self.possible_agents)
        return self._observe(tick)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Advance one tick; every slot needs an action, that of an empty one is ignored."""
        require(bool(self.agents), "the world has not begun, or its horizon is reached; call reset.")
        tick = self.env.step_arrays(self._read_actions(actions))
        self._ticks += 1
        over = self.env.horizon is not None and self._ticks >= self.env.horizon
        observations, infos = self._observe(tick)
        lived = (tick.alive & ~tick.born) | tick.died
        rewards = dict(zip(self.possible_agents, np.where(lived, tick.reward, 0.0).tolist(), strict=True))
        self.agents = [] if over else list(self.possible_agents)
        return (
            observations,
            rewards,
            dict.fromkeys(self.possible_agents, False),
            dict.fromkeys(self.possible_agents, over),
            infos,
        )

    @property
    def seed(self) -> int | None:
        """Return the seed that the world was last reset with; None before the first reset."""
        return self.env.seed

    @property
    def state_space(self) -> spaces.Box:
        """Return the Box of `state()`."""
        return self.env.state_space

    def state(self) -> np.ndarray:
        """Return the world's global view, float32."""
        return self.env.state()

    def render(self) -> np.ndarray | None:
        """Return the world's picture."""
        return self.env.render()

    def close(self) -> None:
        """Close the world."""
        self.env.close()

    def _check_name(self, agent: str) -> str:
        if agent not in self._group_of:
            raise EcologyError(f"there is no slot {agent!r}. {nearest(str(agent), self._group_of)}")
        return agent

    def _width(self, group: Group) -> tuple[int, int]:
        """Return D and A as the slots of `group` show them."""
        shown = list(self.env.groups.values()) if self.pad else [group]
        return max(len(g.layout.low) for g in shown), max(len(g.actions) for g in shown)

    def _space(self, group: Group) -> spaces.Space:
        """Return the observation space of the slots of `group`; zero, what an empty slot observes, is in it."""
        shown = list(self.env.groups.values()) if self.pad else [group]
        d, a = self._width(group)
        low = np.min([_pad(float32_below(np.minimum(g.layout.low, 0.0))[None], d)[0] for g in shown], axis=0)
        high = np.max([_pad(-float32_below(-np.maximum(g.layout.high, 0.0))[None], d)[0] for g in shown], axis=0)
        if self.flatten:
            zeros, ones = np.zeros(a, np.float32), np.ones(a, np.float32)
            return spaces.Box(np.concatenate([low, zeros]), np.concatenate([high, ones]), dtype=np.float32)
        return spaces.Dict(
            {"observation": spaces.Box(low, high, dtype=np.float32), "action_mask": spaces.Box(0, 1, (a,), np.int8)}
        )

    def _read_actions(self, actions: Mapping[str, Any]) -> Ints:
        """Return actions (N,) of the world: rest for an added action."""
        require(isinstance(actions, Mapping), f"actions are a dict, name to action, got {actions!r}.")
        missing = [name for name in self.possible_agents if name not in actions]
        require(not missing, f"every slot needs an action, empty ones too; missing: {', '.join(missing[:5])}.")
        for name, action in actions.items():
            space = self.action_space(name)
            require(
                bool(space.contains(action)),
                f"the action of {name} must be a whole number from 0 to {space.n - 1}, got {action!r}.",
            )
        wanted = np.array([int(actions[name]) for name in self.possible_agents], np.int64)
        return np.where(wanted < self._actions, wanted, self._rest)

    def _observe(self, tick: Tick) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
        """Return the observations and infos of all slots."""
        observations: list[Any] = []
        for group in self.env.groups.values():
            d, a = self._width(group)
            lives = tick.alive[group.slots][:, None]
            only_rest = np.array([kind == "rest" for kind in group.kinds])
            zeta = _pad(np.where(lives, tick.observations[group.name], np.float32(0.0)), d)
            mask = _pad(np.where(lives, tick.masks[group.name], only_rest).astype(np.int8), a)
            if self.flatten:
                observations += list(np.concatenate([zeta, mask], axis=1, dtype=np.float32))
            else:
                observations += [{"observation": z, "action_mask": m} for z, m in zip(zeta, mask, strict=True)]
        infos: dict[str, dict[str, Any]] = {}
        for slot, name in enumerate(self.possible_agents):
            alive = bool(tick.alive[slot])
            infos[name] = {
                "drive": float(tick.drive[slot]) if alive else 0.0,
                "closed": bool(tick.closed[slot]),
                "alive": alive,
                "born": bool(tick.born[slot]),
            }
            if self.names:
                infos[name]["agent"] = self.env.name_of(slot) if alive else None
        return dict(zip(self.possible_agents, observations, strict=True)), infos


def _pad(rows: Floats | np.ndarray, width: int) -> np.ndarray:
    """Return rows (n, m) with zeros added to the right, (n, width)."""
    return np.pad(rows, ((0, 0), (0, width - rows.shape[1])))
