"""GymEnv: a world of one agent as a Gymnasium environment."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np

from ecology.env import Ecology
from ecology.scenario import Scenario
from ecology.spec import require
from ecology.state import Bools
from ecology.world import Tick


class GymEnv(gymnasium.Env):
    """A world of one agent: observations are zeta, float32 (D,), actions indices, rewards the decrease of the drive.

    `action_masks()` returns which actions are open, as sb3-contrib's MaskablePPO expects it, and
    `info["action_mask"]` holds the same. A closed action becomes rest, and `info["closed"]` says so;
    `info["drive"]` is the drive. The agent's death terminates an episode, the world's horizon truncates it.
    `world` is the Ecology underneath.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 30}  # type: ignore[misc]

    def __init__(self, scenario: Scenario, *, horizon: int | None = None, render_mode: str | None = None) -> None:
        """Build the world of `scenario`; EcologyError unless it has one slot."""
        self.world = Ecology(scenario, horizon=horizon, render_mode=render_mode)
        require(
            self.world.size == 1,
            f"a Gymnasium environment has one agent, scenario {scenario.name!r} has room for {self.world.size}; "
            "use `ecology.parallel_env(scenario)`, or `ecology.fixed.FixedSlots` around it.",
        )
        self.render_mode = render_mode
        (self._group,) = (group for group in self.world.groups.values() if group.size)
        space = self.world.observation_space(f"{self._group.name}_0")
        self.observation_space = space["observation"]
        self.action_space = self.world.action_space(f"{self._group.name}_0")
        self._tick: Tick | None = None
        self._over = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start a new episode; without a seed, from one that the world draws or derives from the last."""
        self._tick = self.world.reset_arrays(seed)
        super().reset(seed=self.world.seed)
        self._over = False
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Advance one tick."""
        require(
            self._tick is not None and not self._over,
            "the episode has not begun, or it is over; call reset before step.",
        )
        require(
            bool(self.action_space.contains(action)),
            f"the action must be a whole number from 0 to {len(self._group.actions) - 1}, got {action!r}.",
        )
        self._tick = tick = self.world.step_arrays(np.array([int(action)], np.int64))
        died = bool(tick.died[0])
        reached = self.world.horizon is not None and self.world.state_view.tick >= self.world.horizon
        self._over = died or reached
        return self._observation(), float(tick.reward[0]), died, reached, self._info()

    def action_masks(self) -> Bools:
        """Return which actions are open, (A,); a dead agent can only rest."""
        require(self._tick is not None, "the episode has not begun; call reset before action_masks.")
        assert self._tick is not None
        if not self._tick.alive[0]:
            return np.array([kind == "rest" for kind in self._group.kinds])
        return self._tick.masks[self._group.name][0].copy()

    def render(self) -> np.ndarray | None:  # type: ignore[override]
        """Return a picture of the world, uint8 (height, width, 3), for render_mode "rgb_array"."""
        return self.world.render()

    def close(self) -> None:
        """Close the world."""
        self.world.close()

    def _observation(self) -> np.ndarray:
        assert self._tick is not None
        return self._tick.observations[self._group.name][0].copy()

    def _info(self) -> dict[str, Any]:
        assert self._tick is not None
        return {
            "action_mask": self.action_masks().astype(np.int8),
            "drive": float(self._tick.drive[0]),
            "closed": bool(self._tick.closed[0]),
        }


def gym_env(scenario: Scenario, *, horizon: int | None = None, render_mode: str | None = None) -> GymEnv:
    """Return the world of `scenario`, which has one agent, as a Gymnasium environment."""
    return GymEnv(scenario, horizon=horizon, render_mode=render_mode)
