"""Other people's worlds under random actions, to be timed by `ecology bench`: python other_worlds.py WORLD AGENTS.

It is run as a file, in whatever Python has the library, and knows nothing of the rest of this project.
"""

from __future__ import annotations

import importlib.metadata
import itertools
import json
import sys
import time
from collections.abc import Callable, Mapping
from typing import Any

DRAWN = 16  # choices of actions, drawn beforehand and taken in turn
FOREVER = 10**9  # ticks: no world ends by the clock
MISSING = 3  # exit code where the library is not installed
MARK = "bench:"  # begins a line of the report; a library may print its own
# libraries, fewest and most agents that it is timed with
WORLDS: Mapping[str, tuple[tuple[str, ...], int, int]] = {
    "waterworld": (("pettingzoo", "pymunk"), 2, 100),
    "waterworld_few": (("pettingzoo", "pymunk"), 2, 100),
    "mpe2": (("mpe2",), 4, 100),
    "magent2": (("magent2",), 100, 2000),
    "vmas": (("vmas",), 4, 100),
}

Step = Callable[[], int]  # one tick of a world; returns how many agents acted in it


def serve(name: str, agents: int, step: Step, version: str = "") -> None:
    """Say that the world is ready, then time a window at every line of standard input, until it closes.

    A line holds the seconds and the fewest ticks of a window; the answer holds agent-steps, ticks and seconds of
    this process's own time and of the clock.
    """
    print(MARK + json.dumps({"name": name, "agents": agents, "version": version}), flush=True)
    for line in sys.stdin:
        seconds, least = line.split()
        steps = ticks = 0
        begun, clock = time.process_time(), time.perf_counter()
        while ticks < int(least) or time.process_time() - begun < float(seconds):
            steps += step()
            ticks += 1
        cpu, wall = time.process_time() - begun, time.perf_counter() - clock
        print(
            MARK + json.dumps({"agent_steps": steps, "ticks": ticks, "cpu_seconds": cpu, "wall_seconds": wall}),
            flush=True,
        )


def parallel(env: Any) -> tuple[int, Step]:
    """Return how many agents a PettingZoo world has, and its tick; the dead are left out, an empty world is reset."""
    env.reset(seed=0)
    many = len(env.agents)
    drawn = itertools.cycle([{name: env.action_space(name).sample() for name in env.agents} for _ in range(DRAWN)])

    def step() -> int:
        if not env.agents:
            env.reset()
        chosen = next(drawn)
        acting = {name: chosen[name] for name in env.agents}
        env.step(acting)
        return len(acting)

    return many, step


def waterworld(n: int) -> tuple[int, Step]:
    """PettingZoo's Waterworld, which left it after 1.25: 5 evaders and 10 poisons for every 2 pursuers, as it comes."""
    from pettingzoo.sisl import waterworld_v4

    return parallel(waterworld_v4.parallel_env(n_pursuers=n, n_evaders=n * 5 // 2, n_poisons=n * 5, max_cycles=FOREVER))


def waterworld_few(n: int) -> tuple[int, Step]:
    """The same with 5 evaders and 10 poisons, however many pursuers."""
    from pettingzoo.sisl import waterworld_v4

    return parallel(waterworld_v4.parallel_env(n_pursuers=n, max_cycles=FOREVER))


def mpe2(n: int) -> tuple[int, Step]:
    """MPE2's simple_tag, a quarter of it prey."""
    from mpe2 import simple_tag_v3

    prey = max(n // 4, 1)
    return parallel(simple_tag_v3.parallel_env(num_good=prey, num_adversaries=n - prey, max_cycles=FOREVER))


def magent2(n: int) -> tuple[int, Step]:
    """MAgent2's battle, a compiled grid, on the map that holds about as many."""
    from magent2.environments import battle_v4

    side = max(round((n / 0.08) ** 0.5), 12)
    return parallel(battle_v4.parallel_env(map_size=side, max_cycles=FOREVER))


def vmas(n: int) -> tuple[int, Step]:
    """VMAS's simple_tag in one world, a quarter of it prey."""
    import torch
    import vmas as library

    torch.set_num_threads(1)
    prey = max(n // 4, 1)
    env = library.make_env(
        "simple_tag", num_envs=1, device="cpu", seed=0, num_good_agents=prey, num_adversaries=n - prey
    )
    env.reset()
    drawn = itertools.cycle([[env.get_random_action(agent) for agent in env.agents] for _ in range(DRAWN)])

    def step() -> int:
        env.step(next(drawn))
        return len(env.agents)

    return len(env.agents), step


def main(name: str, agents: int) -> None:
    """Build a world and serve it."""
    worlds = (waterworld, waterworld_few, mpe2, magent2, vmas)
    try:
        many, step = {world.__name__: world for world in worlds}[name](agents)
    except ImportError as error:
        print(f"{error} (in {sys.executable})", file=sys.stderr)
        sys.exit(MISSING)
    libraries = (f"{library} {importlib.metadata.version(library)}" for library in WORLDS[name][0])
    serve(name, many, step, " with ".join(libraries))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
