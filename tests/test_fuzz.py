"""Whatever is typed, written or damaged: one clear error or a world that lives, never a traceback from inside.

`make fuzz` tries at least 5,000 cases; `make test` some hundred, the same every time.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import ecology
from ecology import Arena, EcologyError, Need, Resource, Scenario, Species, move, rest, scenarios
from ecology.agents import checkpoint
from ecology.lab.cli import main
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import PLAIN as PLAIN_KEYS
from ecology.lab.runs.run_config import TABLES, resolve

LONG = int(os.environ.get("ECOLOGY_FUZZ", "0"))  # cases of each test in the long setting
LIMIT = 60.0  # seconds after which a case hangs; compiling what is compiled takes some, once

fuzzed = settings(
    max_examples=LONG or 40,
    derandomize=not LONG,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)


@contextlib.contextmanager
def in_time() -> Iterator[None]:
    """Fail a case that hangs."""

    def ring(*_: object) -> None:
        raise TimeoutError(f"a case took more than {LIMIT} seconds")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def one_clear_error(error: EcologyError, refused: object = True) -> None:
    """Hold an error to the house's words: it says something, is no traceback, and something was `refused`."""
    assert refused, error
    assert str(error).strip()
    assert "Traceback" not in str(error)


def lives(world: Scenario) -> None:
    """Live three ticks at random; all that changes stays finite where it began so."""
    env = ecology.parallel_env(world)
    tick = env.reset_arrays(0)
    rng = np.random.default_rng(0)
    for _ in range(3):
        wanted = np.zeros(env.size, np.int64)
        for group in env.groups.values():
            wanted[group.slots] = rng.integers(0, len(group.actions), group.size)
        tick = env.step_arrays(wanted)
    state = env.state_view
    for name in ("position", "heading", "internal", "drive", "age"):
        assert np.isfinite(getattr(state, name)).all(), name
    for group in env.groups.values():
        assert tick.masks[group.name][state.alive[group.slots]].any(axis=1).all()


# ---- settings ----------------------------------------------------------------------------------

NUMBERS = st.one_of(
    st.floats(0, 2, width=16),
    st.integers(0, 12),
    st.integers(-5, 60),
    st.sampled_from([10**12, 10**30, -(10**30), 2**63]),
    st.floats(-10, 10, width=16),
    st.sampled_from([0.0, -0.0, 1e-300, 1e300, -1e300, float("nan"), float("inf"), -float("inf"), 5e-324]),
)
PLAIN = st.one_of(NUMBERS, st.booleans(), st.none(), st.text(max_size=6), st.sampled_from(["free", "committed", "hjb"]))
VALUES = st.recursive(
    PLAIN,
    lambda each: st.one_of(st.lists(each, max_size=5), st.dictionaries(st.text(max_size=4), each, max_size=2)),
    max_leaves=6,
)


@st.composite
def told(draw: st.DrawFn) -> tuple[str, dict[str, Any]]:
    """Draw a shipped scenario and values for some of its settings, now and then one that is unknown."""
    name = draw(st.sampled_from(scenarios.names()))
    like = scenarios.settings(name)
    known = sorted(like)
    keys = st.one_of(st.sampled_from(known), st.sampled_from(known), st.text(max_size=5))
    changes = {}
    for key in draw(st.lists(keys, max_size=4, unique=True)):
        usual = like.get(key)
        if isinstance(usual, tuple) and draw(st.booleans()):
            changes[key] = draw(st.lists(NUMBERS, min_size=len(usual), max_size=len(usual)))
        elif isinstance(usual, float) and draw(st.booleans()):
            changes[key] = usual * draw(st.floats(0.1, 10))
        else:
            changes[key] = draw(NUMBERS if isinstance(usual, (int, float)) and draw(st.booleans()) else VALUES)
    return name, changes


@fuzzed
@given(told())
@example(("paper", {}))
def test_settings_build_a_world_that_lives_or_one_error(given_: tuple[str, dict[str, Any]]) -> None:
    """Any values for the settings of a shipped scenario are refused in words, or make a world that lives."""
    name, changes = given_
    with in_time():
        try:
            plan = resolve(name, changes=changes, learners=["random"], ticks=3)
            run = Run(plan, Path(os.devnull))
        except EcologyError as error:
            one_clear_error(error, refused=changes)
        else:
            lives(run.scenario)


# ---- specs -------------------------------------------------------------------------------------

POLYGONS = st.lists(st.lists(st.lists(NUMBERS, min_size=2, max_size=2), max_size=5), max_size=3)
WORDS: dict[str, dict[str, st.SearchStrategy[Any]]] = {
    "need": {
        "name": st.sampled_from(["food", "x", "", "blood sugar", "drive", "clock"]),
        "set_point": NUMBERS, "decay": NUMBERS, "noise": NUMBERS, "start": NUMBERS, "floor": NUMBERS,
        "lethal": PLAIN, "regulated": PLAIN, "bounds": st.lists(NUMBERS, max_size=3),
    },
    "resource": {
        "name": st.sampled_from(["berries", "", "food"]), "position": st.lists(NUMBERS, max_size=3),
        "radius": NUMBERS, "stock": NUMBERS, "capacity": NUMBERS, "availability": NUMBERS,
    },
    "species": {
        "name": st.sampled_from(["agent", "", "a b"]), "count": NUMBERS, "radius": NUMBERS,
        "position": st.lists(NUMBERS, max_size=3), "heading": NUMBERS, "view_angle": NUMBERS, "view_range": NUMBERS,
        "drive_epsilon": NUMBERS, "commitment": PLAIN,
        "senses": st.lists(st.sampled_from(["position", "heading", "x"]), max_size=3),
        "collapse": st.dictionaries(st.sampled_from(["food", "x"]), NUMBERS, max_size=1), "learner": PLAIN,
        "learner_settings": VALUES, "hazard": PLAIN, "sees": PLAIN, "neighbours": VALUES, "needs": VALUES,
    },
    "move": {"name": PLAIN, "speed": NUMBERS, "direction": NUMBERS,
             "closes_at": st.dictionaries(st.sampled_from(["food", "x"]), NUMBERS, max_size=1)},
    "consume": {"resource": st.sampled_from(["berries", "bery"]),
                "intake": st.dictionaries(st.sampled_from(["food", "x"]), NUMBERS, max_size=2)},
    "growth": {"rate": NUMBERS, "kind": st.sampled_from(["linear", "logistic", "exponential", "none"])},
    "drift": {"spread": NUMBERS},
    "season": {"amplitude": NUMBERS, "period": NUMBERS, "phase": NUMBERS},
    "sleep": {"duration": NUMBERS, "opens_from": st.dictionaries(st.sampled_from(["food", "x"]), NUMBERS, max_size=1)},
    "bite": {"species": st.sampled_from(["agent", "agnt"]), "reach": NUMBERS, "chance": NUMBERS, "duration": NUMBERS,
             "gain": st.dictionaries(st.sampled_from(["food", "x"]), NUMBERS, max_size=2),
             "damage": st.dictionaries(st.sampled_from(["food", "x"]), NUMBERS, max_size=2)},
    "give": {"species": st.sampled_from(["agent", "agnt"]), "reach": NUMBERS, "efficiency": NUMBERS,
             "gives": st.dictionaries(st.sampled_from(["food", "x"]), NUMBERS, max_size=2)},
    "arena": {
        "vertices": st.lists(st.lists(NUMBERS, min_size=2, max_size=2), max_size=6),
        "walls": st.one_of(PLAIN, VALUES, POLYGONS), "holes": st.one_of(VALUES, POLYGONS),
    },
    "scenario": {"name": PLAIN, "dt": NUMBERS, "ticks": NUMBERS, "day": NUMBERS},
}  # fmt: skip
SPEC = """
from ecology import *
SPEC = {spec}
def build(ticks=3):
    def made(kind, maker, **words):
        words.update(SPEC.get(kind, {{}}))
        return maker(**words)
    season = made("season", Season, amplitude=0.5, period=10.0)
    need = made("need", Need, name="food", set_point=2.0, bounds=(0.0, 4.0), noise=0.1)
    actions = (rest(), made("move", move, name="walk", speed=0.1), turn("left", 0.5), go_to("berries", 0.2),
               made("consume", consume, resource="berries", intake={{"food": 0.1}}),
               made("sleep", sleep, duration=2.0), made("bite", bite, species="agent", reach=0.5, gain={{"food": 0.1}}),
               made("give", give, species="agent", reach=0.5, gives={{"food": 0.1}}))
    agent = made("species", Species, name="agent", needs=(need,), actions=actions, count=3, learner="random")
    growth = made("growth", Growth, rate=0.1, season=season)
    berries = (made("resource", Resource, name="berries", position=(1.0, 1.0), stock=2.0, growth=growth),
               Resource(name="fish", motion=made("drift", Drift, spread=0.1)))
    arena = made("arena", Arena, vertices=((0, 0), (4, 0), (4, 4), (0, 4)))
    return made("scenario", Scenario, name="world", arena=arena, species=(agent,), resources=berries)
"""


@st.composite
def specs(draw: st.DrawFn) -> dict[str, dict[str, Any]]:
    """Draw a few words that differ from a good world's."""
    spec: dict[str, dict[str, Any]] = {}
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(sorted(WORDS)))
        word = draw(st.sampled_from(sorted(WORDS[kind])))
        spec.setdefault(kind, {})[word] = draw(st.one_of(WORDS[kind][word], WORDS[kind][word], VALUES))
    return spec


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for the files of all cases."""
    return tmp_path_factory.mktemp("fuzz")


@fuzzed
@given(specs())
@example({})
@example({"arena": {"vertices": [[1, 58], [9, 1e-7], [3, 1], [2, 0], [1, 0], [-1e30, -1e30]]}})
@example({"arena": {"vertices": [[0.0, 0.0], [0.0, 1e300], [2.0, 0.0]]}})
@example({"species": {"position": [2, 2, 2]}})
@example({"season": {"period": 5e-324}})
@example({"growth": {"kind": "exponential", "rate": 1e12}})
@example({"resource": {"radius": 10**30}})
@example({"move": {"direction": -(10**30)}})
@example({"sleep": {"duration": 10**30}})
def test_a_spec_is_a_world_that_lives_or_one_error(folder: Path, spec: dict[str, dict[str, Any]]) -> None:
    """A scenario file of wrong words is refused in words, or makes a world that lives; a good one does."""
    path = folder / "spec.py"
    text = repr(spec)
    path.write_text("nan, inf = float('nan'), float('inf')\n" + SPEC.format(spec=text))
    said = ""
    with in_time():
        try:
            run = Run(resolve(str(path)), Path(os.devnull))
        except EcologyError as error:
            one_clear_error(error, refused=spec)
            said = str(error)
        else:
            lives(run.scenario)
    assert "cannot be built" not in said  # these would be Python's own words


# ---- actions -----------------------------------------------------------------------------------

HUNGRY = Scenario(
    name="hungry",
    arena=Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4))),
    resources=(Resource(name="berries", position=(1.0, 1.0)),),
    species=(
        Species(
            name="agent",
            needs=(Need(name="food", set_point=2.0, bounds=(0.0, 4.0), lethal=True),),
            actions=(rest(), move("walk", 0.1)),
            count=3,
        ),
    ),
)
NAMES = st.one_of(
    st.sampled_from(["agent_0", "agent_1", "agent_2", "agent_3", "agnt_0", ""]), st.integers(), st.none(), st.text()
)
ACTIONS = st.one_of(
    st.integers(0, 1), st.integers(-3, 3), VALUES,
    st.sampled_from([np.int8(1), np.array(1), np.array([1]), np.float32(1), np.bool_(True), np.array(None), b"1"]),
)  # fmt: skip


@fuzzed
@given(st.one_of(st.dictionaries(NAMES, ACTIONS, max_size=5), VALUES), st.booleans())
def test_actions_are_executed_or_nothing_happens(actions: Any, most: bool) -> None:
    """Missing, unknown, dead agents' and senseless actions are refused in words, and the world stands still."""
    env = ecology.parallel_env(HUNGRY)
    env.reset(seed=0)
    env.set_state(internal=np.array([[2.0], [2.0], [-1.0]]))
    env.step(dict.fromkeys(env.agents, 0))  # agent_2 dies
    if most and isinstance(actions, dict):
        actions = {"agent_0": 0, "agent_1": 1} | actions
    before, living = env.state_view.copy(), list(env.agents)
    with in_time():
        try:
            env.step(actions)
        except EcologyError as error:
            one_clear_error(error)
            assert env.state_view.tick == before.tick
            for name, value in before.arrays().items():
                assert np.array_equal(value, env.state_view.arrays()[name], equal_nan=True), name
        else:
            assert env.state_view.tick == before.tick + 1
            assert actions.keys() == set(living)


# ---- config files ------------------------------------------------------------------------------


@st.composite
def damage(draw: st.DrawFn, data: bytes) -> bytes:
    """Draw what is left of `data` after some bytes were changed, cut out, doubled or put in."""
    for _ in range(draw(st.integers(1, 3))):
        if not data:
            break
        at = draw(st.integers(0, len(data) - 1))
        size = draw(st.integers(1, min(40, len(data) - at)))
        how = draw(st.sampled_from(["flip", "cut", "end", "double", "put"]))
        if how == "flip":
            data = data[:at] + bytes([data[at] ^ (1 << draw(st.integers(0, 7)))]) + data[at + 1 :]
        elif how == "cut":
            data = data[:at] + data[at + size :]
        elif how == "end":
            data = data[:at]
        elif how == "double":
            data = data[: at + size] + data[at:]
        else:
            data = data[:at] + draw(st.binary(max_size=8)) + data[at:]
    return data


KEYS = st.sampled_from([*PLAIN_KEYS, *TABLES, "learners.agent", "settings.decay", "x"])


@fuzzed
@given(st.data())
def test_a_config_is_repeated_or_one_error(folder: Path, data: st.DataObject) -> None:
    """A damaged config runs or gives exit code 2; it stays as it was, and no half folder is left."""
    good = resolve("seasons", learners=["random"], ticks=3, record=False).to_toml()
    path, out = folder / "config.toml", folder / "out"
    if data.draw(st.booleans()):
        written = data.draw(damage(good.encode()))
    else:
        value = data.draw(VALUES)
        written = good.replace("[settings]", f"{data.draw(KEYS)} = {json.dumps(value)}\n[settings]").encode()
        written = written.replace(b"ticks = 3\n", b"", data.draw(st.integers(0, 1)))
    path.write_bytes(written)
    shutil.rmtree(out, ignore_errors=True)
    words = ["run", "--config", str(path), "--out", str(out), "--ticks", "3", "--no-record", "--quiet"]
    with in_time(), pytest.raises(SystemExit) as left:
        main(words)
    assert (left.value.code or 0) in (0, 2)
    assert path.read_bytes() == written
    assert out.exists() == (not left.value.code)


# ---- what is typed -----------------------------------------------------------------------------


@fuzzed
@given(
    st.sampled_from(["run", "sweep", "fork", "evaluate", "view", "new"]),
    st.lists(
        st.one_of(
            st.sampled_from(
                ["--seed", "--set", "--learner", "--at", "--move", "--remove", "--resume", "--seeds", "--out"]
            ),
            st.sampled_from(
                ["-1", "0", "a=1", "decay=[", "run", "x/y", "0:2", "crowd=1,1", "random", "agent=rest", ""]
            ),
            st.text(alphabet=st.characters(codec="utf-8", exclude_characters="/\x00"), max_size=8),
        ),
        max_size=4,
    ),
)
def test_what_is_typed_is_done_or_one_error(folder: Path, command: str, words: list[str]) -> None:
    """Any words after a command give a run of nothing, help or exit code 2."""
    here = Path.cwd()
    (folder / "typed").mkdir(exist_ok=True)
    os.chdir(folder / "typed")
    try:
        with in_time(), pytest.raises(SystemExit) as left:
            main([command, "no_such_scenario", *words])
        assert left.value.code in (None, 0, 2)
    finally:
        os.chdir(here)


# ---- checkpoints -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def whole(folder: Path) -> Path:
    """Return the folder of a run of 20 ticks with two checkpoints."""
    plan = resolve("seasons", learners=["random"], ticks=20, checkpoint_every=10, record=False)
    run = Run(plan, folder / "whole")
    run.start()
    run.live()
    return folder / "whole"


@fuzzed
@given(st.data())
def test_a_damaged_checkpoint_is_refused_and_the_previous_opens(whole: Path, data: st.DataObject) -> None:
    """Damaged bytes give one error that names the folder, nothing is lost, and the previous checkpoint lives on."""
    mine = whole.with_name("mine")
    shutil.rmtree(mine, ignore_errors=True)
    shutil.copytree(whole, mine)
    files = sorted((mine / "checkpoint").iterdir())
    file = data.draw(st.sampled_from(files))
    kind = data.draw(st.sampled_from(["damage", "damage", "remove", "swap", "value", "values"]))
    before = file.read_bytes()
    index = json.loads((mine / "checkpoint" / checkpoint.INDEX).read_text())
    if kind == "damage":
        file.write_bytes(data.draw(damage(before)))
    elif kind == "remove":
        file.unlink()
    elif kind == "swap":
        file.write_bytes(data.draw(st.sampled_from(files)).read_bytes())
    else:  # well-formed, and not what was written
        where = data.draw(st.sampled_from([index, index["digests"], index["values"], index["values"]["world"]]))
        where[data.draw(st.sampled_from(sorted(where)))] = data.draw(VALUES)
        if kind == "values" and isinstance(index.get("values"), dict):  # forged, digest and all
            index["digest"] = checkpoint._digest(index["values"])
        (mine / "checkpoint" / checkpoint.INDEX).write_text(json.dumps(index))
    left = {path: path.read_bytes() for path in mine.rglob("*") if path.is_file()}
    with in_time():
        said = ""
        try:
            open_run(mine, 30).resume()
        except EcologyError as error:
            one_clear_error(error)
            said = str(error)
        assert str(mine) in said or (kind != "remove" and not said)
        assert {path: path.read_bytes() for path in mine.rglob("*") if path.is_file()} == left
        again = open_run(mine, 21)
        again.resume(previous=True)
        assert again.now == 10
