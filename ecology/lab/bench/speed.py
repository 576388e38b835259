"""A benchmark: agent-steps per second against the number of agents, of this world and of others, side by side.

Every curve's point is a process of its own, started as `python -P -m ecology.lab.bench.speed WHAT AGENTS` or, for other
people's worlds, as `other_worlds.py`. All are pinned to one core with one thread each, and take turns: in every round
each is timed for a moment, after a loop that is always the same, so that a machine that changes its speed changes
it for all. Time is the process's own, which other programs on the machine do not lengthen.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ecology import Ecology, EcologyError, agents, parallel_env, scenarios
from ecology.agents.base import Transition
from ecology.errors import nearest, writable
from ecology.lab.bench.other_worlds import DRAWN, MARK, MISSING, WORLDS, serve
from ecology.lab.runs.run_config import versions
from ecology.lab.runs.sweep import DPI, write_table

TABLE, FIGURE = "bench.parquet", "bench.png"
ARRAYS, DICTS = "arrays", "dicts"  # this world without learning, through either interface
PLAIN = "plain"  # algorithm1 on the plain device
BORDER = "-dicts"  # after a learner's name: it learns through the dicts, which are stacked for it
# who learns if nobody is named
LEARNERS = ("lean", "algorithm1", f"algorithm1{BORDER}", PLAIN)
LEARNERS_UP_TO = 1_000  # agents
PLAIN_UP_TO = 100  # agents
WORLD = "commons"
SETTINGS: Mapping[str, Any] = {"walls": True, "neighbours": 8}
RICH = 25.0  # capacity of the pool per agent, units of intake: it does not run dry while it is measured
LEAST = 2  # ticks of a window
LEARNS = 16  # ticks of a window in which someone learns, who may update its networks once in so many
LIVED = 1_000  # ticks that who learns has lived before: until all have memories enough, and weights that have settled
CALIBRATION = 200_000  # turns of the loop that is always the same
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")


# ---- one point -----------------------------------------------------------------------------------


def world(n: int) -> Ecology:
    """Return the world that is measured: `commons` with walls, sight and the eight nearest sensed, n agents."""
    return parallel_env(scenarios.load(WORLD, n=n, capacity=RICH * n, **SETTINGS))


def stepping(what: str, n: int) -> Callable[[], int]:
    """Return one tick of n agents under random actions, by `arrays` or `dicts`, or with a learner by its name."""
    env = world(n)
    (group,) = env.groups.values()
    drawn = np.random.default_rng(0).integers(0, len(group.actions), (DRAWN, n))
    turn = 0
    if what == ARRAYS:
        env.reset_arrays(seed=0)

        def step() -> int:
            nonlocal turn
            turn += 1
            env.step_arrays(drawn[turn % DRAWN])
            return n

    elif what == DICTS:
        env.reset(seed=0)
        chosen = [dict(zip(env.agents, row.tolist(), strict=True)) for row in drawn]

        def step() -> int:
            nonlocal turn
            turn += 1
            env.step(chosen[turn % DRAWN])
            return n

    else:
        from ecology.agents import loop  # slow to load

        name = "algorithm1" if what == PLAIN else what.removesuffix(BORDER)
        own = env.scenario.species[0].learner_settings if what == "hjb" else {}  # as `ecology run` would
        learner = agents.make(name, group, np.random.SeedSequence(0), own, "plain" if what == PLAIN else "cpu")
        tick = env.reset_arrays(seed=0)
        if what != PLAIN:
            tick = loop.run(env, {group.name: learner}, tick, LIVED)
        if what.endswith(BORDER):
            return _through_dicts(env, learner)

        def step() -> int:
            nonlocal tick
            tick = loop.run(env, {group.name: learner}, tick, 1)
            return n

    return step


def _through_dicts(env: Ecology, learner: Any) -> Callable[[], int]:
    """Return one tick of a learner that uses the world's dicts, as PettingZoo's users do."""

    def stacked(observations: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        parts = observations.values()
        zeta = np.concatenate([each["observation"] for each in parts]).reshape(len(parts), -1)
        masks = np.concatenate([each["action_mask"] for each in parts]).reshape(len(parts), -1)
        return zeta, masks.astype(bool)

    learner.begin()
    zeta, masks = stacked(env.reset(seed=0)[0])

    def step() -> int:
        nonlocal zeta, masks
        actions = learner.act(zeta, masks)
        observations, _, dead, _, _ = env.step(dict(zip(env.agents, actions.tolist(), strict=True)))
        after, open_ = stacked(observations)
        alive = ~np.fromiter(dead.values(), bool, len(dead))
        learner.learn(
            Transition(
                observations=zeta,
                masks=masks,
                actions=actions,
                next_observations=after,
                next_masks=open_,
                alive=alive,
                died=~alive,
            )
        )
        zeta, masks = after, open_
        return len(alive)

    return step


def calibrate() -> float:
    """Return the seconds that the loop takes that is always the same."""
    begun = time.process_time()
    total = 0
    for i in range(CALIBRATION):
        total += i * i
    return time.process_time() - begun


# ---- all of them ---------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class TimedWorld:
    """One world with so many agents, to be timed by the process `command`."""

    name: str
    agents: int
    command: tuple[str, ...]
    least: int = LEAST  # ticks of a window


def points(counts: Sequence[int], learners: Sequence[str], against: Mapping[str, str]) -> list[TimedWorld]:
    """Return what is to be timed; `against` are the other worlds, each with the Python that has it."""
    found = []
    for name in learners:
        if name != PLAIN:
            agents.learner_class(name.removesuffix(BORDER))
    for name in against:
        if name not in WORLDS:
            raise EcologyError(f"there is no world {name!r} to compare with. {nearest(name, WORLDS)}")
    here = (sys.executable, "-P", "-m", "ecology.lab.bench.speed")
    for name in (ARRAYS, DICTS, *learners):
        most = max(counts)
        if name in learners:
            most = PLAIN_UP_TO if name == PLAIN else LEARNERS_UP_TO
        least = LEARNS if name in learners else LEAST
        found += [
            TimedWorld(name=name, agents=n, command=(*here, name, str(n)), least=least) for n in counts if n <= most
        ]
    script = str(Path(__file__).with_name("other_worlds.py"))
    for name, python in against.items():
        _, least, most = WORLDS[name]
        fitting = [n for n in counts if least <= n <= most] or [least]
        found += [TimedWorld(name=name, agents=n, command=(python, script, name, str(n))) for n in fitting]
    return found


class Process:
    """A point's process, from when it is ready until it is started."""

    def __init__(self, point: TimedWorld) -> None:
        """Start it and wait until its world stands."""
        self.point = point
        try:
            self.process = subprocess.Popen(
                point.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                env=os.environ | ONE_THREAD,
            )  # fmt: skip
        except OSError as error:
            raise EcologyError(f"the Python {point.command[0]!r} cannot be started: {error.strerror}.") from error
        answer = self._answer()
        self.agents, self.version = int(answer["agents"]), str(answer["version"])

    def _answer(self) -> dict[str, Any]:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith(MARK):
                return json.loads(line.removeprefix(MARK))
        said = self.process.communicate()[1].strip().splitlines() or ["it said nothing"]
        point = self.point
        if self.process.returncode == MISSING:
            how = "`pip install -e '.[bench]'`, run in the project's folder"
            if point.name.startswith("waterworld"):
                how = "an environment of its own, `pip install pettingzoo==1.25.0 pymunk==6.11.1 pygame scipy`"
            raise EcologyError(
                f"the world {point.name} is not there: {said[-1]}. It needs {how}; a Python elsewhere is given with "
                f"--python {point.name}=PATH."
            )
        raise EcologyError(f"the world {point.name} with {point.agents} agents failed: {said[-1]}")

    def time(self, seconds: float, least: int) -> dict[str, Any]:
        """Return the result of a window of at least so many seconds and ticks."""
        assert self.process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # what it died of is told below
            self.process.stdin.write(f"{seconds} {least}\n")
            self.process.stdin.flush()
        return self._answer()

    def end(self) -> None:
        """Close its standard input, at which it ends, and wait for it."""
        if self.process.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.communicate(timeout=10.0)
        if self.process.poll() is None:
            self.process.kill()
            self.process.communicate()  # waits, and closes its pipes


@contextlib.contextmanager
def pin_to_core(core: int | None) -> Iterator[int | None]:
    """Keep this process, and those that it starts, on one core; give which, None where this cannot be said."""
    if not hasattr(os, "sched_setaffinity"):
        yield None
        return
    own = os.sched_getaffinity(0)
    core = max(own) if core is None else core
    if core not in own:
        raise EcologyError(f"--core must be one that this process may use ({', '.join(map(str, sorted(own)))}).")
    os.sched_setaffinity(0, {core})
    try:
        yield core
    finally:
        os.sched_setaffinity(0, own)


def measure(
    wanted: Sequence[TimedWorld], *, rounds: int, seconds: float, tell: Callable[[str], None]
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return a row for every window of every point, and the versions of all that took part."""
    rows: list[dict[str, Any]] = []
    with contextlib.ExitStack() as stack:
        processes: dict[TimedWorld, Process] = {}
        found = dict(versions())
        for point in sorted(wanted, key=lambda point: point.name not in WORLDS):  # first what may not be installed
            tell(f"{point.name}, {point.agents} agents: building")
            processes[point] = process = Process(point)
            stack.callback(process.end)
            if process.version:
                found[point.name] = process.version
        ready = [processes[point] for point in wanted]
        for process in ready:  # what is compiled or cached at first is not timed
            tell(f"{process.point.name}, {process.agents} agents: warming up")
            process.time(seconds, process.point.least)
        for turn in range(rounds):
            for process in ready:
                tell(f"round {turn + 1} of {rounds}: {process.point.name}, {process.agents} agents")
                calibration = calibrate()
                window = process.time(seconds, process.point.least)
                rows.append(
                    {"name": process.point.name, "agents": process.agents, "round": turn}
                    | window
                    | {
                        "agent_steps_per_second": window["agent_steps"] / window["cpu_seconds"],
                        "calibration_seconds": calibration,
                    }
                )
    return rows, found


@dataclass(frozen=True, kw_only=True)
class Speed:
    """Agent-steps per second of one point, over rounds."""

    name: str
    agents: int
    median: float
    low: float  # quartiles
    high: float


def speeds(rows: Sequence[Mapping[str, Any]]) -> list[Speed]:
    """Return the medians and quartiles by name and agents, in the order in which they were measured."""
    found: dict[tuple[str, int], list[float]] = {}
    for row in rows:
        found.setdefault((row["name"], row["agents"]), []).append(row["agent_steps_per_second"])
    return [
        Speed(name=name, agents=n, median=float(middle), low=float(low), high=float(high))
        for (name, n), values in found.items()
        for low, middle, high in [np.quantile(values, (0.25, 0.5, 0.75))]
    ]


def write(out: Path, rows: Sequence[Mapping[str, Any]], used: Mapping[str, str]) -> list[Path]:
    """Write the table and the figure into the folder `out`, and return their paths."""
    with writable(out):
        out.mkdir(parents=True, exist_ok=True)
        write_table(out / TABLE, [{**row, "versions": json.dumps(used)} for row in rows])
        draw_speeds(out / FIGURE, speeds(rows), used)
    return [out / TABLE, out / FIGURE]


def name_with_version(name: str, version: str) -> str:
    """Return a name with its version, which may begin with it."""
    return version if version.startswith(name) else f"{name} {version}"


def draw_speeds(path: Path, found: Sequence[Speed], used: Mapping[str, str]) -> None:
    """Draw agent-steps per second over agents, a line for each name, with quartiles."""
    from ecology.observers.plotting import new_figure, save_figure, style  # slow to load

    figure = new_figure((9.0, 4.6))
    ax = figure.add_subplot()
    for i, name in enumerate(dict.fromkeys(speed.name for speed in found)):
        line = sorted((speed for speed in found if speed.name == name), key=lambda speed: speed.agents)
        middle = np.array([speed.median for speed in line])
        spread = np.array([[speed.median - speed.low, speed.high - speed.median] for speed in line]).T
        label = f"ecology, {name}" if name in (ARRAYS, DICTS) else f"ecology, {name.removesuffix(BORDER)} learning"
        if name.endswith(BORDER):
            label += " through dicts"
        if name in WORLDS:
            label = name_with_version(name, used[name])
        elif name == PLAIN:
            label = "ecology, algorithm1 learning on the plain device"
        ax.errorbar(
            [speed.agents for speed in line], middle, spread, capsize=3, linewidth=1.3, markersize=4, label=label,
            **style(i).words,
        )  # fmt: skip
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_xlabel("agents")
    ax.set_ylabel("agent-steps per second, one core")
    ax.set_title("Median, bars: quartiles over rounds of one run, each world in turn", fontsize=11)
    ax.grid(alpha=0.3, linewidth=0.5)
    ax.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    save_figure(figure, path, DPI)


if __name__ == "__main__":
    _what, _n = sys.argv[1], int(sys.argv[2])
    serve(_what, _n, stepping(_what, _n))
