"""Worlds small enough to work out by hand, and how to live in them."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # many small arrays: threads only cost
if "PYTEST_XDIST_WORKER" not in os.environ:  # the list of code that the user has run is not of these tests
    _state = tempfile.TemporaryDirectory()
    os.environ["XDG_STATE_HOME"] = _state.name

import numpy as np
import pytest

from ecology import Arena, Ecology, Need, Resource, Scenario, Species, Tick, consume, contract, go_to, move, rest, turn

PATIENCE = 300.0  # seconds that a test waits for another process; only a failing test waits that long
Command = Callable[..., tuple[int, str, str]]  # words -> exit code, stdout, stderr
LUCK = 1_000_003  # mixed in with the number that `--luck` gives, so that no seed becomes another one in use


@contextlib.contextmanager
def hearing(signum: signal.Signals) -> Iterator[None]:
    """Let processes that are started meanwhile hear a signal, also where `nohup` or a shell has it ignored."""
    if signal.getsignal(signum) is not signal.SIG_IGN:
        yield
        return
    signal.signal(signum, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signum, signal.SIG_IGN)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of these tests."""
    parser.addoption("--golden", action="store_true", help="write golden trajectories that are missing or have changed")
    parser.addoption(
        "--luck",
        type=int,
        default=0,
        metavar="N",
        help="mix N into every random seed; a test that fails now depends on the luck of its seed",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Mix the number that `--luck` gives into every seed that is made from now on in this process.

    It goes into the spawn key, so that a seed's entropy, which worlds and runs record, stays what was given. The seeds
    are plain ones: a copy of one in another process, or a child of it, is the same there.
    """
    config.addinivalue_line("markers", "one_seed(reason): holds for one seed by design; `--luck` skips it")
    luck = config.getoption("--luck")
    if not luck:
        return
    plain, default_rng, mark = np.random.SeedSequence, np.random.default_rng, (LUCK, luck)

    class Mixing(type):
        def __call__(cls, entropy: Any = None, *, spawn_key: Any = (), **words: Any) -> np.random.SeedSequence:
            mixed = tuple(spawn_key[:2]) == mark
            return plain(entropy, spawn_key=spawn_key if mixed else (*mark, *spawn_key), **words)

        def __instancecheck__(cls, seed: Any) -> bool:
            return isinstance(seed, plain)

    class SeedSequence(plain, metaclass=Mixing):  # type: ignore[valid-type, misc]
        pass

    def mixed_rng(seed: Any = None) -> np.random.Generator:
        whole = isinstance(seed, (plain, np.random.BitGenerator, np.random.Generator))
        return default_rng(seed if whole else SeedSequence(seed))

    np.random.SeedSequence, np.random.default_rng = SeedSequence, mixed_rng  # type: ignore[misc, assignment]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip tests of one seed where `--luck` gives them another."""
    for item in items if config.getoption("--luck") else ():
        for marker in item.iter_markers("one_seed"):
            item.add_marker(pytest.mark.skip(reason=f"--luck: {marker.args[0]}"))


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile what the tests use before several workers would do so at once."""
    if hasattr(session.config, "workerinput") or not session.config.getoption("numprocesses", None):
        return
    words = [sys.executable, str(Path(__file__).parent / "compile_kernels.py")]
    for process in [subprocess.Popen([*words, what]) for what in ("worlds", "learners")]:
        process.wait()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the seed of the order, which pytest-randomly prints only in a longer report."""
    seed = config.getoption("randomly_seed", None)
    if seed is not None and config.getoption("randomly_reorganize"):
        terminalreporter.write_line(f"random order; to repeat it: pytest --randomly-seed={seed}")


@pytest.fixture
def room() -> Callable[..., Scenario]:
    """Return a maker of a square room with one species; its words can be replaced one by one."""

    def make(
        *,
        side: float = 10.0,
        needs: tuple[Need, ...] = (Need(name="food", set_point=2.0),),
        actions: tuple[Any, ...] | None = None,
        food: tuple[float, float] = (5.0, 5.0),
        vertices: tuple[tuple[float, float], ...] | None = None,
        dt: float = 1.0,
        **species: Any,
    ) -> Scenario:
        arena = Arena(vertices=vertices or ((0, 0), (side, 0), (side, side), (0, side)))
        if actions is None:
            actions = (
                rest(),
                move("walk", 0.1),
                turn("turn_left", np.pi / 2),
                consume("berries", {needs[0].name: 0.1}),
                go_to("berries", 0.1),
            )
        return Scenario(
            name="room",
            arena=arena,
            resources=(Resource(name="berries", position=food),),
            species=(Species(**{"name": "agent", "needs": needs, "actions": actions, **species}),),
            dt=dt,
        )

    return make


@pytest.fixture
def index() -> Callable[..., int]:
    """Return the index of an action by its name."""

    def find(env: Ecology, action: str, species: str | None = None) -> int:
        group = env.groups[species or next(iter(env.groups))]
        return group.actions.index(action)

    return find


@pytest.fixture
def act(index: Callable[..., int]) -> Callable[..., Tick]:
    """Return a hand that makes every agent of a one-species world do the same for some ticks."""

    def do(env: Ecology, action: str, ticks: int = 1) -> Tick:
        wanted = np.full(env.size, index(env, action))
        for _ in range(ticks):
            tick = env.step_arrays(wanted)
        return tick

    return do


@pytest.fixture
def random_actions() -> Callable[..., np.ndarray]:
    """Return a chooser of one action per slot, open in its mask, or any (`open_only` False)."""
    return contract.choose


@pytest.fixture
def ecology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the command line in an empty folder."""
    from ecology.lab.cli import main

    monkeypatch.chdir(tmp_path)

    def type_(*words: str) -> tuple[int, str, str]:
        code = 0
        try:
            main(words)
        except SystemExit as left:
            code = int(left.code or 0)
        return code, *capsys.readouterr()

    return type_


@pytest.fixture(autouse=True)
def png_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let this process write figures once, not as SVG and PDF too, which takes three times as long."""
    monkeypatch.setattr("ecology.observers.plotting.ENDINGS", ())


@pytest.fixture
def quick_evaluation(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let evaluations in this process live no baselines, and follow no future for long."""
    monkeypatch.setattr("ecology.agents.evaluation.BASELINES", ())
    monkeypatch.setattr("ecology.agents.evaluation.horizon", lambda *_: 10)
    monkeypatch.setattr("ecology.agents.evaluation.LONGEST", 10)


@pytest.fixture
def short(ecology: Command) -> Command:
    """Return a short run with a learner that needs no time, and more words."""
    return lambda *words: ecology("run", "--ticks", "30", "--learner", "random", "--no-record", *words)


@pytest.fixture
def crowd(tmp_path: Path) -> Callable[..., Any]:
    """Return a maker of runs of a crowd that touches all the time, not yet begun."""
    from runs import make_crowd

    return lambda folder, ticks, **words: make_crowd(tmp_path, folder, ticks, **words)
