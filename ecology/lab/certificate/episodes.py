"""Lives that end and begin again, in several worlds of one scenario at once: what the empathy set-ups are learned in.

The first species of the scenario acts, the others rest; a life ends when anyone dies. K worlds, n actors each.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ecology import Ecology, EcologyError, agents, scenarios
from ecology.agents.base import Learner, Transition
from ecology.state import Bools, Floats, Ints

TESTS = 5  # worlds in which PPO is measured
SHORT = 20  # lives that are measured where they are short

Policy = Callable[[Ecology], Ints]  # actions of all actors in a world


class Worlds:
    """K worlds of one scenario: as many pairs as it has in one Ecology, each reset when it ends.

    A pair is the n actors of the first species and their share of the others; actors are rows, pair by pair.
    """

    def __init__(self, name: str, settings: Mapping[str, Any], count: int, seed: int, cap: int) -> None:
        """Start `count` worlds of the scenario `name`; a life ends after `cap` ticks at the latest."""
        together = "pairs" in scenarios.settings(name)
        self.envs = [
            Ecology(scenarios.load(name, **settings, **({"pairs": count} if together else {})))
            for _ in range(1 if together else count)
        ]
        self.nursery = Ecology(scenarios.load(name, **settings))  # where lives begin
        self.count, self.cap, self.pairs = count, cap, count // len(self.envs)
        groups = list(self.envs[0].groups.values())
        self.n, self.slots = groups[0].size // self.pairs, groups[0].slots
        self.group = dataclasses.replace(groups[0], slots=slice(0, self.n * count))
        self.pair = np.concatenate([np.arange(g.size) * self.pairs // g.size for g in groups])  # (N,) of each slot
        self.rest = np.concatenate([np.full(g.size, g.kinds.index("rest")) for g in groups])  # (N,)
        self.rest_of_one = np.array([g.kinds.index("rest") for g in groups for _ in range(g.size // self.pairs)])
        self.rng = np.random.default_rng([seed, count])
        ticks = [env.reset_arrays(int(self.rng.integers(2**31))) for env in self.envs]
        ticks = [env.step_arrays(self.rest) for env in self.envs]  # the first tick of a life draws how it starts
        self.zeta = np.concatenate([tick.observations[self.group.name] for tick in ticks])
        self.masks = np.concatenate([tick.masks[self.group.name] for tick in ticks])
        self.lived = np.zeros(count, np.int64)

    def begin(self, ended: Ints) -> None:
        """Begin new lives in the worlds `ended` (k,)."""
        self.lived[ended] = 0
        for e in np.unique(ended // self.pairs).tolist():
            env, tick = self.envs[e], None
            if self.pairs == 1:
                env.reset_arrays(int(self.rng.integers(2**31)))
                tick = env.step_arrays(self.rest)
            else:
                changed = {name: getattr(env.state_view, name).copy() for name in ("internal", "position", "age")}
                for pair in ended[ended // self.pairs == e] % self.pairs:
                    self.nursery.reset_arrays(int(self.rng.integers(2**31)))
                    self.nursery.step_arrays(self.rest_of_one)
                    mine = self.pair == pair
                    born = self.nursery.state_view
                    shift = changed["position"][mine][-1] - born.position[-1]  # those who rest stand still
                    changed["internal"][mine], changed["age"][mine] = born.internal, born.age
                    changed["position"][mine] = born.position + shift
                alive = env.state_view.alive | np.isin(self.pair, ended % self.pairs)
                tick = env.set_state(alive=alive, **changed)
            rows = slice(e * self.pairs * self.n, (e + 1) * self.pairs * self.n)
            self.zeta[rows], self.masks[rows] = tick.observations[self.group.name], tick.masks[self.group.name]

    def step(self, actions: Ints) -> tuple[Floats, Bools, Bools, Ints]:
        """Advance all by a tick: rewards (K n,), whose life ended by death (K,) or the cap (K,), executed (K n,)."""
        ticks = []
        for asked, env in zip(np.split(actions, len(self.envs)), self.envs, strict=True):
            own = self.rest.copy()
            own[self.slots] = asked
            ticks.append(env.step_arrays(own))
        name, pairs = self.group.name, np.bincount(self.pair)
        alive = np.concatenate([np.bincount(self.pair, tick.alive) == pairs for tick in ticks])
        self.zeta = np.concatenate([tick.observations[name] for tick in ticks])
        self.masks = np.concatenate([tick.masks[name] for tick in ticks])
        self.lived += 1
        reward, executed = (
            np.concatenate([getattr(tick, what)[self.slots] for tick in ticks]) for what in ("reward", "action")
        )
        return reward, ~alive, alive & (self.lived >= self.cap), executed

    def lives(self, act: Callable[[], Ints], least: int) -> list[list[int]]:
        """Return the lengths of the next `least` lives in every world, under act() -> (K n,), in ticks."""
        found: list[list[int]] = [[] for _ in range(self.count)]
        self.begin(np.arange(self.count))
        while any(len(lengths) < least for lengths in found):
            _, dead, capped, _ = self.step(act())
            ended = np.flatnonzero(dead | capped)
            for k in ended.tolist():
                found[k].append(int(self.lived[k]))
            if ended.size:
                self.begin(ended)
        return [lengths[:least] for lengths in found]


def measure_lives(worlds: Worlds, act: Callable[[], Ints]) -> list[list[int]]:
    """Return the lengths of lives per world: of one where lives are long, of SHORT more where they are not."""
    first = worlds.lives(act, 1)
    return first if np.mean(first) > worlds.cap / 10 else worlds.lives(act, SHORT)


def run_scripted(
    name: str, settings: Mapping[str, Any], policy: Policy, count: int, lives: int, cap: int, seed: int = 0
) -> tuple[list[list[int]], Ints]:
    """Return the lengths of `lives` lives in `count` worlds under `policy`, and how often each took which action."""
    worlds = Worlds(name, settings, count, seed, cap)
    taken = np.zeros((count, len(worlds.group.actions)), np.int64)

    def act() -> Ints:
        actions = policy(worlds.envs[0])
        taken[np.arange(count), actions] += 1
        return actions

    return worlds.lives(act, lives), taken


def hjb(name: str, settings: Mapping[str, Any], count: int, ticks: int, cap: int, seed: int = 0) -> list[list[int]]:
    """Return the lengths of lives in each of `count` worlds, not exploring, after f/J learned for `ticks` ticks.

    Each actor learns for itself, from its own world alone; they are stacked for speed.
    """
    worlds = Worlds(name, settings, count, seed, cap)
    own = worlds.envs[0].scenario.species[0].learner_settings
    learner: Learner = agents.make("hjb", worlds.group, np.random.SeedSequence([seed, count, 1]), own)
    for _ in range(ticks):
        before, open_ = worlds.zeta.copy(), worlds.masks.copy()
        _, dead, capped, executed = worlds.step(learner.act(before, open_))
        ended = np.flatnonzero(dead | capped)
        over = np.repeat(dead | capped, worlds.n)
        learner.learn(
            Transition(
                before, open_, executed, worlds.zeta.copy(), worlds.masks.copy(), ~over, np.repeat(dead, worlds.n)
            )
        )
        if ended.size:
            learner.died(np.flatnonzero(over))  # what was under way ends with the life; what is known stays
            worlds.begin(ended)
    learner.evaluating(0.0)
    return measure_lives(worlds, lambda: learner.act(worlds.zeta, worlds.masks))


def ppo(
    name: str,
    settings: Mapping[str, Any],
    learning: Mapping[str, Any],
    *,
    count: int,
    steps: int,
    scale: float,
    cap: int,
    seed: int,
) -> list[int]:
    """Return the lengths of lives after PPO (Stable-Baselines3) learned from `steps` steps.

    One policy acts for all actors of `count` worlds and sees no action mask; its reward is `scale` times the
    world's, `learning` are the library's settings. Actions are drawn from the policy, also when
    measured. EcologyError without the library.
    """
    try:
        import torch
        from stable_baselines3 import PPO
        from stable_baselines3.common.vec_env import VecEnv
    except ImportError as error:
        raise EcologyError("PPO needs Stable-Baselines3; install the extra 'sb3'.") from error
    from gymnasium.spaces import Box, Discrete

    class Many(VecEnv):
        """The worlds as Stable-Baselines3 wants them, an environment per actor."""

        def __init__(self) -> None:
            self.worlds = Worlds(name, settings, count, seed, cap)
            rows, d = self.worlds.zeta.shape
            acts = len(self.worlds.group.actions)
            super().__init__(rows, Box(-np.inf, np.inf, (d,), np.float32), Discrete(acts))

        def reset(self) -> np.ndarray:
            self.worlds.begin(np.arange(count))
            return self.worlds.zeta.copy()

        def step_async(self, actions: np.ndarray) -> None:
            self.actions = actions

        def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
            reward, dead, capped, _ = self.worlds.step(self.actions)
            over = np.repeat(dead | capped, self.worlds.n)
            infos: list[dict[str, Any]] = [{} for _ in over]
            for row in np.flatnonzero(over):
                infos[row] = {
                    "terminal_observation": self.worlds.zeta[row].copy(),
                    "TimeLimit.truncated": bool(capped[row // self.worlds.n]),
                }
            if over.any():
                self.worlds.begin(np.flatnonzero(dead | capped))
            return self.worlds.zeta.copy(), (scale * reward).astype(np.float32), over, infos

        def close(self) -> None:
            """Nothing to release."""

        def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
            return [getattr(self, attr_name, None)] * self.num_envs

        def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
            raise NotImplementedError

        def env_method(self, method_name: str, *args: Any, indices: Any = None, **named: Any) -> list[Any]:
            raise NotImplementedError

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            return [False] * self.num_envs

    torch.set_num_threads(1)
    learner = PPO("MlpPolicy", Many(), seed=seed, device="cpu", **learning)
    learner.learn(steps)
    test = Worlds(name, settings, TESTS if count > 1 else 1, 1_000_000 + seed, cap)
    return [n for lengths in measure_lives(test, lambda: learner.predict(test.zeta)[0]) for n in lengths]
