"""Copies of a world, and worlds in other processes, go on as the original does, bit for bit."""

import copy
import inspect
import pickle
import subprocess
import sys
import threading

import numpy as np
import pytest
from worlds import everything, kind, square, start

import ecology
from ecology import Ecology, EcologyError, physics, scenarios
from ecology.fixed import FixedSlots

PICKLED = {"deep": copy.deepcopy, "pickled": lambda world: pickle.loads(pickle.dumps(world))}
TOLD = '"""Helpers of a scenario file, beside it."""\n\nMEAL = 0.25\n\n\ndef meal(n):\n    return [[MEAL]] * n\n'
OWN = """
import math
import dataclasses
from ecology import Arena, Need, Scenario, Species, rest
from beside_it import meal

@dataclasses.dataclass
class Table:
    meals: float = 2.0

TABLE = Table()

def rule(world, rng):
    outcome = world.no_effect()
    outcome.received[:] = TABLE.meals * rng.random() * np.array(meal(len(outcome.received)))
    return outcome

import numpy as np

def build(count: int = 3):
    need = Need(name="food", set_point=2.0, decay=0.01)
    agent = Species(name="agent", needs=(need,), actions=(rest(),), count=count, solid=False)
    square = Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)))
    return Scenario(
        name="own", arena=square, species=(agent,), rule=rule,
        measures={"fed": lambda state: TABLE.meals * float(state.internal.mean())},
    )
"""


def go_on(env, ticks, seed):
    """Return all that is seen in some ticks of random actions, as bytes."""
    rng = np.random.default_rng(seed)
    masks, seen = env.world.perception.masks, []
    for _ in range(ticks):
        wanted = np.zeros(env.size, np.int64)
        for group in env.groups.values():
            wanted[group.slots] = np.argmax(rng.random(masks[group.name].shape) * masks[group.name], axis=1)
        tick = env.step_arrays(wanted)
        masks = tick.masks
        seen += [values.tobytes() for values in env.state_view.arrays().values()]
        seen += [values.tobytes() for values in tick.observations.values()]
        seen.append(repr(env.scenario.measure(env.state_view)).encode())
    return b"".join(seen)


@pytest.mark.parametrize("how", PICKLED)
@pytest.mark.parametrize("before", [0, 3, physics.REBUILD - 1, physics.REBUILD, physics.REBUILD + 5])
def test_a_copy_goes_on_whenever_it_is_taken(how, before):
    """Contacts are carried, also where the solver has just been rebuilt; a copy of the copy goes on, too."""
    env = start(everything())
    go_on(env, before, 1)
    twin = PICKLED[how](env)
    second = PICKLED[how](twin)
    expected = go_on(env, 20, 2)
    assert go_on(twin, 20, 2) == expected
    assert go_on(second, 20, 2) == expected


@pytest.mark.parametrize("how", PICKLED)
def test_a_copy_goes_on_where_a_world_was_put(how):
    """A world whose bodies were put elsewhere, on each other, has copies that push them apart in the same way."""
    env = start(square(kind(count=40, solid=True, radius=0.4), side=6.0))
    env.set_state(position=3.0 + 0.01 * np.random.default_rng(0).random((40, 2)))
    twin = PICKLED[how](env)
    assert go_on(twin, 10, 0) == go_on(env, 10, 0)


@pytest.mark.parametrize("how", PICKLED)
def test_a_copy_and_its_original_share_nothing_that_changes(how):
    """What one of them does, the reset, the random streams and the spaces' own included, the other does not notice."""
    env, same = start(everything()), start(everything())
    env.reset(seed=0)
    same.reset(seed=0)
    spaces = [env.action_space(name) for name in env.agents[:1]]
    spaces[0].seed(3)
    twin = PICKLED[how](env)
    assert twin.agents == env.agents
    go_on(twin, 30, 7)
    drawn = [int(twin.action_space(name).sample()) for name in env.agents[:1] for _ in range(5)]
    assert go_on(env, 30, 8) == go_on(same, 30, 8)
    assert [int(spaces[0].sample()) for _ in range(5)] == drawn
    assert env.scenario.name == twin.scenario.name


@pytest.mark.parametrize("how", PICKLED)
def test_a_world_that_was_drawn_or_never_started_is_copied(how):
    """A picture is no part of a copy, and draws again; a world before its first reset is copied, too."""
    env = ecology.parallel_env(square(kind()), render_mode="rgb_array")
    PICKLED[how](env).reset(seed=0)
    env.reset(seed=0)
    shown = env.render()
    np.testing.assert_array_equal(PICKLED[how](env).render(), shown)


@pytest.mark.parametrize("how", PICKLED)
def test_slots_are_copied(how):
    """FixedSlots go on with the world that they wrap."""
    slots = FixedSlots(ecology.parallel_env(scenarios.load("predator_prey", prey=5, predators=3), horizon=50))
    slots.reset(seed=0)
    for _ in range(10):
        slots.step(dict.fromkeys(slots.agents, 0))
    twin = PICKLED[how](slots)
    for _ in range(10):
        one, two = (each.step(dict.fromkeys(each.agents, 1)) for each in (slots, twin))
        assert repr(one) == repr(two)


def test_a_subclass_is_copied():
    """A world of a subclass stays one, with what it has besides."""

    env = Watched(square(kind()))
    env.reset(seed=0)
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert type(twin) is Watched
        assert twin.notes == ["a"]
        assert twin.notes is not env.notes


class Watched(Ecology):
    """A world that keeps notes."""

    def __init__(self, scenario):
        super().__init__(scenario)
        self.notes = ["a"]


@pytest.mark.one_seed("the fresh interpreter draws numbers of its own")
def test_a_fresh_interpreter_goes_on(tmp_path, monkeypatch):
    """Every world with functions of its own, shipped or a user's of two files, goes on in a process without them."""
    folder, elsewhere = tmp_path / "mine", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    (folder / "own.py").write_text(OWN)
    (folder / "beside_it.py").write_text(TOLD)
    monkeypatch.syspath_prepend(str(folder))
    worlds = {name: scenarios.load(name) for name in scenarios.names()}
    worlds = {name: each for name, each in worlds.items() if each.rule or each.measures}
    assert {"trap", "well_mixed"} <= worlds.keys()
    worlds["own"] = scenarios.load(str(folder / "own.py"))
    carried, expected = {}, {}
    for name, scenario in worlds.items():
        env = ecology.parallel_env(scenario)
        env.reset_arrays(seed=1)
        go_on(env, 5, 1)
        carried[name] = env, scenario
    (elsewhere / "carried").write_bytes(pickle.dumps(carried))
    for name, (env, scenario) in carried.items():
        again = ecology.parallel_env(scenario)
        again.reset_arrays(seed=2)
        expected[name] = go_on(env, 10, 3), go_on(again, 10, 3)
    (elsewhere / "expected").write_bytes(pickle.dumps(expected))
    for path in folder.iterdir():
        path.rename(elsewhere / f"{path.name}.gone") if path.is_file() else None
    code = (
        "import pickle, numpy as np, ecology\n"
        + inspect.getsource(go_on)
        + (
            "carried = pickle.load(open('carried', 'rb')); expected = pickle.load(open('expected', 'rb'))\n"
            "carried = pickle.loads(pickle.dumps(carried))  # passed on once more\n"
            "for name, (env, scenario) in carried.items():\n"
            "    again = ecology.parallel_env(scenario)\n"
            "    again.reset_arrays(seed=2)\n"
            "    assert (go_on(env, 10, 3), go_on(again, 10, 3)) == expected[name], name\n"
            "print(*carried)\n"
        )
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=elsewhere, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) == worlds.keys()


def test_every_scenario_is_pickled_as_it_is():
    """Unpickled, a scenario without functions equals the original; one with them keeps all else."""
    for name in scenarios.names():
        scenario = scenarios.load(name)
        for other in (copy.deepcopy(scenario), pickle.loads(pickle.dumps(scenario))):
            for field in ("name", "arena", "species", "resources", "dt", "ticks", "day", "settings"):
                assert getattr(other, field) == getattr(scenario, field)
            assert other.measures.keys() == scenario.measures.keys()
        assert copy.deepcopy(scenario).rule is scenario.rule


def test_a_rule_that_cannot_leave_its_process_is_told():
    """What a rule holds and cannot be pickled is one error that names the scenario."""
    lock = threading.Lock()

    def rule(world, rng):
        with lock:
            return world.no_effect()

    with pytest.raises(EcologyError, match=r"'square' cannot be pickled.*rule or measures"):
        pickle.dumps(square(kind(), rule=rule))
