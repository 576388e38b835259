"""Walls, what others do and who they are, signals, traces, noise and failure: each sense against a case worked out."""

import dataclasses
import math

import numpy as np
import pytest
from worlds import ask, assert_refused, kind, square, start

from ecology import (
    Arena,
    Birth,
    Fault,
    Hearing,
    Neighbours,
    Rays,
    Resource,
    Trace,
    act,
    contract,
    move,
    parallel_env,
    senses,
    turn,
    typed,
)
from ecology.senses import Component, Sense
from ecology.spec import SenseSpec


def sensed(env, species="agent", row=0):
    """Return the components of zeta of one agent by name, as they are now."""
    tick = env.set_state()
    zeta = tick.observations[species][row]
    return dict(zip(env.groups[species].layout.names, zeta.tolist(), strict=True))


def lived(env, ticks, **wanted):
    """Let `ticks` pass."""
    for _ in range(ticks):
        env.step_arrays(ask(env, **wanted))


# ---- walls -------------------------------------------------------------------------------------


def test_rays_measure_walls_from_the_heading():
    """In a square, four rays all around are the distances to the four sides; a hole is nearer."""
    species = kind(position=(2.0, 3.0), heading=0.0, senses=(Rays(range=20.0, count=4),))
    env = start(square(species))
    assert [sensed(env)[f"ray_{i}"] for i in (1, 2, 3, 4)] == pytest.approx([2.0, 3.0, 6.0, 5.0])
    env.set_state(heading=np.array([math.pi / 2]))
    assert [sensed(env)[f"ray_{i}"] for i in (1, 2, 3, 4)] == pytest.approx([3.0, 6.0, 5.0, 2.0])
    rock = Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)), holes=(((4, 2), (5, 2), (5, 5), (4, 5)),))
    env = start(
        square(kind(position=(2.0, 3.0), heading=0.0, senses=(Rays(range=4.0, count=3, spread=math.pi),)), arena=rock)
    )
    assert [sensed(env)[f"ray_{i}"] for i in (1, 2, 3)] == pytest.approx([3.0, 2.0, 4.0])


def test_a_slanted_ray_is_as_long_as_trigonometry_says():
    """Two rays 30 degrees to either side of a wall 2 away are 2 / cos 30 long; on a torus nothing is near."""
    ahead = Rays(range=9.0, count=2, spread=math.pi / 3)
    species = kind(position=(6.0, 4.0), heading=0.0, senses=(ahead,))
    long = 2.0 / math.cos(math.pi / 6)
    found = sensed(start(square(species)))
    assert [found["ray_1"], found["ray_2"]] == pytest.approx([long, long])
    found = sensed(start(square(species, walls=False)))
    assert [found["ray_1"], found["ray_2"]] == [9.0, 9.0]


# ---- others ------------------------------------------------------------------------------------


def test_what_the_nearest_does_is_sensed():
    """Exactly the action that the neighbour executed is 1, by its name, over all species that are sensed."""
    looks = kind("agent", position=(2.0, 2.0), neighbours=(Neighbours(count=2, action=True),), view_range=3.0)
    near = kind("near", move("east", 0.1, direction=0.0), turn("left", 0.1), position=(3.0, 2.0))
    far = kind("far", turn("left", 0.1), position=(4.0, 2.0))
    env = start(square(looks, near, far))
    lived(env, 1, near="east", far="left")
    found = {name: value for name, value in sensed(env).items() if "_does_" in name}
    assert {name for name, value in found.items() if value == 1.0} == {"other_1_does_east", "other_2_does_left"}
    assert set(found.values()) == {0.0, 1.0}
    assert "other_1_does_rest" in found
    assert "other_1_distance" in sensed(env)


def test_kin_and_identity_are_sensed():
    """A parent knows its child, siblings know each other, strangers are none; marks are the digits of the serial."""

    def bear(world, rng):
        outcome = world.no_effect()
        if world.state.tick == 0:
            outcome.births["agent"] = np.array([[3.0, 2.0], [2.0, 3.0]])
            outcome.parents["agent"] = np.array([0, 0])
        return outcome

    species = kind(
        count=2, capacity=4, birth=Birth(rate=0.0), neighbours=(Neighbours(count=3, kin=True, identity=3),), solid=False
    )
    env = start(square(species, rule=bear), position=np.array([[2.0, 2.0], [7.0, 7.0], [0.1, 0.1], [0.1, 0.1]]))
    lived(env, 1)
    state = env.state_view
    for row in range(4):
        found = sensed(env, row=row)
        order = np.argsort(np.hypot(*(state.position - state.position[row]).T), kind="stable")
        others = [slot for slot in order if slot != row]
        for place, slot in enumerate(others, 1):
            assert found[f"other_{place}_is_kin"] == float(row != 1 and slot != 1)
            marks = [found[f"other_{place}_mark_{i}"] for i in (1, 2, 3)]
            assert marks == [2.0 * ((int(state.serial[slot]) >> i) & 1) - 1.0 for i in range(3)]


# ---- signals -----------------------------------------------------------------------------------


def test_the_nearest_signal_in_range_is_heard():
    """Content, distance and bearing are those of the nearest that sends on the channel; 0 and the range without one."""
    calls = (act("call", emits={"alarm": 2.0}), act("whisper", emits={"alarm": -0.5}))
    hears = kind(position=(4.0, 4.0), heading=0.0, senses=(Hearing(channel="alarm", range=3.0),))
    left = kind("left", *calls, position=(4.0, 6.0))
    right = kind("right", *calls, position=(4.0, 3.0))
    env = start(square(hears, left, right))

    def heard(**wanted):
        lived(env, 1, **wanted)
        found = sensed(env)
        return [found["alarm"], found["alarm_distance"], found["alarm_bearing"]]

    assert heard() == [0.0, 3.0, 0.0]
    assert heard(left="call") == pytest.approx([2.0, 2.0, math.pi / 2])
    assert heard(left="call", right="whisper") == pytest.approx([-0.5, 1.0, -math.pi / 2])
    assert heard() == [0.0, 3.0, 0.0]
    env.set_state(position=np.array([[0.5, 4.0], [4.0, 6.0], [4.0, 3.0]]))
    assert heard(left="call", right="call") == [0.0, 3.0, 0.0]


# ---- traces ------------------------------------------------------------------------------------


def test_a_trace_fades_exponentially_from_the_last_large_value():
    """A cue of one tick leaves exp(-rate t); a smaller cue is lost in it, a larger one replaces it."""
    cues = {2: 2.0, 5: 0.5, 9: 1.9}
    calls = tuple(act(f"call_{i}", emits={"cue": value}) for i, value in cues.items())
    hears = kind(position=(4.0, 4.0), senses=(Hearing(channel="cue", range=9.0), Trace(of="cue", rate=0.1)))
    env = start(square(hears, kind("sender", *calls, position=(5.0, 4.0)), dt=0.5))
    expected = 0.0
    for t in range(1, 15):
        lived(env, 1, **({"sender": f"call_{t}"} if t in cues else {}))
        expected = max(cues.get(t, 0.0), expected * math.exp(-0.1 * 0.5))
        assert sensed(env)["cue_trace"] == pytest.approx(expected, rel=1e-6)
        assert sensed(env)["cue"] == pytest.approx(cues.get(t, 0.0))


def test_a_newborn_remembers_nothing():
    """Whoever takes the slot of a dead agent begins with a trace of 0."""

    def replace_it(world, rng):
        outcome = world.no_effect()
        outcome.killed[world.slots["agent"]] = world.state.tick == 2
        if world.state.tick == 4:
            outcome.births["agent"] = np.array([[4.0, 4.0]])
        return outcome

    senses = (Hearing(channel="cue", range=9.0), Trace(of="cue", rate=0.01))
    hears = kind(position=(4.0, 4.0), senses=senses, birth=Birth(rate=0.0))
    sender = kind("sender", act("call", emits={"cue": 1.0}), position=(5.0, 4.0))
    env = start(square(hears, sender, rule=replace_it))
    lived(env, 1, sender="call")
    assert sensed(env)["cue_trace"] == 1.0
    lived(env, 4)
    assert env.state_view.alive.all()
    assert sensed(env)["cue_trace"] == 0.0


# ---- noise and failure ---------------------------------------------------------------------------


def readings(fault, ticks, dt=1.0):
    """Return what 200 agents read of their x, which is 4, in each of `ticks` ticks, and the world."""
    species = kind(count=200, position=(4.0, 4.0), faults=(fault,))
    env = parallel_env(square(species, dt=dt))
    env.reset_arrays(seed=2)
    rest = ask(env)
    return np.array([env.step_arrays(rest).observations["agent"][:, 1] for _ in range(ticks)]), env


def test_noise_has_its_standard_deviation_and_is_white():
    """Mean, deviation and correlation from tick to tick are those of normal noise, to 5 standard errors."""
    found, env = readings(Fault(of="x", noise=0.3), 100)
    off, n = found - 4.0, found.size
    assert abs(off.mean()) < 5 * 0.3 / math.sqrt(n)
    assert off.std() == pytest.approx(0.3, abs=5 * 0.3 / math.sqrt(2 * n))
    assert abs((off[1:] * off[:-1]).mean()) < 5 * 0.09 / math.sqrt(n)
    assert (env.state_view.position == 4.0).all()  # what is read is another than what is


def test_noise_stays_within_the_bounds():
    """A reading is never outside the arena."""
    found, _ = readings(Fault(of="x", noise=50.0), 5)
    assert found.min() == 0.0
    assert found.max() == 8.0


@pytest.mark.parametrize("dt", [1.0, 0.2])
def test_a_sense_fails_its_share_of_the_time(dt):
    """A sense reads 0 for failure / (failure + repair) of the time, to 5 standard errors, for 1 / repair each."""
    failure, repair = 0.02, 0.08
    found, _ = readings(Fault(of="x", failure=failure, repair=repair), round(300 / dt), dt)
    late = found[round(100 / dt) :] == 0.0  # 10 times the time in which it forgets its start
    share = failure / (failure + repair)
    independent = 200 * 200 * (failure + repair) / 2
    assert late.mean() == pytest.approx(share, abs=5 * math.sqrt(share * (1 - share) / independent))
    begins = (late[1:] & ~late[:-1]).sum()
    assert late.sum() * dt / begins == pytest.approx(1 / repair, rel=0.1)


def test_readings_survive_a_snapshot_and_a_put():
    """What was drawn for a tick is in the state: a put reads the same again, and a world that is entered goes on."""
    species = kind(count=5, faults=(Fault(of="x", noise=0.3), Fault(of="y", failure=0.3, repair=0.3)),
                   senses=("position", Trace(of="x", rate=0.1)))  # fmt: skip
    scenario = square(species)
    env = parallel_env(scenario)
    env.reset_arrays(seed=1)
    tick = [env.step_arrays(ask(env)) for _ in range(9)][-1]
    assert np.array_equal(env.set_state().observations["agent"], tick.observations["agent"])
    other = parallel_env(scenario)
    assert np.array_equal(other.restore(*env.snapshot()).observations["agent"], tick.observations["agent"])
    for _ in range(5):
        one, two = env.step_arrays(ask(env)), other.step_arrays(ask(other))
        assert np.array_equal(one.observations["agent"], two.observations["agent"])
    for holds in ("the same seed gives the same run", "a copy continues bit for bit"):
        contract.CHECKS[holds](scenario, 20)


def test_worlds_without_them_have_nothing_of_it():
    """No array and no random stream is added."""
    env = start(square(kind(neighbours=(Neighbours(),)), resources=(Resource(name="food"),)))
    assert {"traces", "misread", "failed", "grid", "doors"}.isdisjoint(env.state_view.arrays())
    assert "senses" not in env.snapshot()[1]["rng"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Height(SenseSpec):
    """Parameters of a sense that a contributor adds: the height that is the zero."""

    zero: float = 0.0

    def __post_init__(self):
        typed.check_types(self)


class HeightSense(Sense):
    """Sense y above the zero."""

    def __init__(self, whose, sensed):
        self._rows, self._zero = whose.rows, sensed.zero
        self.components = (Component("height", "plain", 1.0, -math.inf, math.inf),)

    def write(self, zeta, column, model, state, seen):  # noqa: D102
        zeta[:, column] = state.position[self._rows, 1] - self._zero


def test_a_sense_with_parameters_is_a_class_and_an_entry(monkeypatch):
    """A scenario takes parameters from any file; without an entry the message says where it belongs."""
    species = kind(position=(2.0, 3.0), senses=("heading", Height(zero=1.0)))
    assert_refused(lambda: square(species), ["Height", "PARAMETRIC"])
    monkeypatch.setitem(senses.PARAMETRIC, Height, HeightSense)
    assert sensed(start(square(species)))["height"] == pytest.approx(2.0)


WRONG = {
    "rays without range": (lambda: Rays(range=0.0), ["range", "0.0"]),
    "no rays": (lambda: Rays(range=1.0, count=0), ["count", "0"]),
    "rays beyond a turn": (lambda: Rays(range=1.0, spread=7.0), ["spread", "7.0"]),
    "a trace of nothing": (lambda: square(kind(senses=("position", Trace(of="z", rate=1.0)))), ["trace", "'z'"]),
    "a trace that stays": (lambda: Trace(of="x", rate=0.0), ["rate", "0.0"]),
    "a fault of nothing": (lambda: square(kind(faults=(Fault(of="xx", noise=1.0),))), ["fault", "'xx'", "x"]),
    "a fault without fault": (lambda: Fault(of="x"), ["'x'", "neither"]),
    "a silent channel": (lambda: square(kind(senses=(Hearing(channel="a", range=1.0),))), ["'a'", "emits"]),
    "another channel": (
        lambda: square(kind("agent", act("call", emits={"alarm": 1.0}), senses=(Hearing(channel="alrm", range=1.0),))),
        ["'alrm'", "alarm"],
    ),
    "too long a name": (lambda: Neighbours(identity=40), ["identity", "40"]),
    "a content of NaN": (lambda: act("call", emits={"alarm": math.nan}), ["alarm", "nan"]),
    "a sense of no kind": (lambda: kind(senses=(3,)), ["senses[0]", "3"]),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_a_mistake_is_told(what):
    """The message names the rule and the value."""
    assert_refused(*WRONG[what])
