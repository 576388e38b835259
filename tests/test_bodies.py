"""Bodies: set points that move, the form of the drive, and stages of life."""

import dataclasses
import math

import numpy as np
import pytest
from worlds import ask, everything, from_python, kind, square, start

from ecology import (
    Adaptation,
    EcologyError,
    Empathy,
    Need,
    Resource,
    Stage,
    consume,
    contract,
    go_to,
    move,
    physiology,
    scenarios,
)
from ecology.agents import make

LEVER = Resource(name="lever", position=(4.0, 4.0), radius=1.0)


def user(adaptation, *, dt=1.0, rate=0.1, **words):
    """Return one body beside an unlimited resource, which it can take in at `rate`; its set point moves."""
    need = Need(**{"name": "drug", "set_point": 2.0, "bounds": (0.0, 50.0), "set_range": (1.0, 8.0), **words},
                adaptation=adaptation)  # fmt: skip
    species = kind("user", consume("lever", {"drug": rate}), needs=(need,), position=(4.0, 4.0))
    return square(species, resources=(LEVER,), dt=dt)


def lived(env, action, ticks):
    """Do one action for so many ticks; return the set point after each."""
    found = []
    for _ in range(ticks):
        env.step_arrays(ask(env, user=action))
        found.append(float(env.state_view.set_point[0, 0]))
    return np.array(found)


# ---- set points that move ----------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.25, 1.0, 2.0])
def test_intake_raises_a_set_point_and_time_brings_it_back(dt):
    """It rises by gain x intake - recovery x time, falls by the recovery alone, and stays at what it was."""
    env = start(user(Adaptation(gain=0.5, recovery=0.02), dt=dt))
    up = lived(env, "consume_lever", round(40 / dt))
    time = dt * np.arange(1, len(up) + 1)
    assert up == pytest.approx(2.0 + (0.5 * 0.1 - 0.02) * time)
    down = lived(env, "rest", round(100 / dt))
    assert down == pytest.approx(np.maximum(3.2 - 0.02 * dt * np.arange(1, len(down) + 1), 2.0))


@pytest.mark.parametrize("dt", [0.25, 1.0, 3.0])
def test_an_offset_relaxes_exponentially(dt):
    """After intake it falls to x*_0 as exp(-t/20), whatever the tick, and never beyond the set_range."""
    env = start(user(Adaptation(gain=100.0, relaxation=0.05), dt=dt))
    assert lived(env, "consume_lever", math.ceil(2 / dt))[-1] == pytest.approx(8.0)
    down = lived(env, "rest", round(60 / dt))
    assert down == pytest.approx(2.0 + 6.0 * np.exp(-0.05 * dt * np.arange(1, len(down) + 1)))


@pytest.mark.parametrize("dt", [0.5, 1.0, 4.0])
def test_a_clock_moves_a_set_point(dt):
    """It is x*_0 + swing sin(2 pi t / period + phase) at every tick, for newborns as well."""
    env = start(user(Adaptation(swing=0.8, period=24.0, phase=1.0), dt=dt))
    assert env.state_view.set_point[0, 0] == pytest.approx(2.0 + 0.8 * math.sin(1.0))
    found = lived(env, "rest", round(60 / dt))
    time = dt * np.arange(1, len(found) + 1)
    assert found == pytest.approx(2.0 + 0.8 * np.sin(2 * np.pi * time / 24 + 1.0))
    env.set_state(alive=np.array([False]))
    env.settle("user", (1.0, 1.0))
    assert env.state_view.set_point[0, 0] == pytest.approx(found[-1])


def test_a_moving_set_point_is_perceived_as_deviation_and_felt():
    """The first component of zeta is x - x*, the drive follows it, and the observation space holds it."""
    env = start(user(Adaptation(gain=0.5)))
    low, high = env.groups["user"].layout.low[0], env.groups["user"].layout.high[0]
    assert (low, high) == (0.0 - 8.0, 50.0 - 1.0)
    for _ in range(20):
        tick = env.step_arrays(ask(env, user="consume_lever"))
        now = env.state_view
        delta = now.internal[0, 0] - now.set_point[0, 0]
        assert tick.observations["user"][0, 0] == pytest.approx(delta)
        assert tick.drive[0] == pytest.approx(math.sqrt(0.001 + delta**2))


@pytest.mark.parametrize(("hours", "last"), [(1.0, 100.0), (6.0, None)])
def test_intake_escalates_with_long_access_alone(hours, last):
    """Keramati et al. 2017: h*(k+1) = h*(k) + .09 x .126 h*(k) x hours - 3.456 a day, but never below 100.

    A body that takes a dose of 50 whenever it is half a dose short, in trials of 4 s taken ten at a time.
    """
    dose, leak, trials = 50.0, 0.007, 21_600
    need = Need(
        name="drug", set_point=100.0, start=100.0, leak=leak, bounds=(0.0, 400.0), set_range=(100.0, 200.0),
        adaptation=Adaptation(gain=0.0018, recovery=0.00016),
    )  # fmt: skip
    species = kind("user", consume("lever", {"drug": dose / 10}), needs=(need,), position=(4.0, 4.0))
    env = start(square(species, resources=(LEVER,), dt=10.0))
    press, idle = ask(env, user="consume_lever"), ask(env, user="rest")
    expected, days = 100.0, 4
    for _ in range(days):
        expected = max(expected + 0.09 * 0.126 * expected * hours - 3.456, 100.0)
        for t in range(trials // 10):
            now = env.state_view
            short = now.set_point[0, 0] - now.internal[0, 0] > dose / 2
            env.step_arrays(press if short and t * 10 < 900 * hours else idle)
    assert env.state_view.set_point[0, 0] == pytest.approx(expected, rel=0.03)
    assert last is None or env.state_view.set_point[0, 0] == pytest.approx(last, rel=0.01)
    assert last is not None or env.state_view.set_point[0, 0] > 108


def test_a_rule_moves_set_points_within_their_range():
    """What a rule says is the set point from then on; beyond the set_range it is told so."""

    def rule(world, rng):
        outcome = world.no_effect()
        outcome.set_point = world.state.set_point + 0.5
        return outcome

    env = start(dataclasses.replace(user(None), rule=rule))
    assert lived(env, "rest", 3) == pytest.approx([2.5, 3.0, 3.5])
    with pytest.raises(EcologyError, match="set point of 'drug' of 'user'"):
        lived(env, "rest", 20)


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        ({"adaptation": Adaptation(gain=1.0)}, "needs a set_range"),
        ({"set_range": (2.5, 3.0)}, "include the set point"),
        ({"set_range": (-1.0, 3.0)}, "within the bounds"),
        ({"set_range": (2.0, 2.0)}, "set_range must be"),
        ({"set_range": (1.0, 3.0), "adaptation": Adaptation(swing=1.5)}, "leaves the set_range"),
        ({"weight": 0.0}, "weight must be positive"),
        ({"excess": -1.0}, "excess must not be negative"),
    ],
)
def test_needs_that_cannot_be_are_refused(words, rule):
    """A range includes the set point and lies within the bounds, and what moves a set point has a range."""
    with pytest.raises(EcologyError, match=rule):
        Need(name="food", set_point=2.0, bounds=(0.0, 4.0), **words)


def test_adaptations_that_cannot_be_are_refused():
    """Rates are not negative, and something moves."""
    for words in ({}, {"gain": math.nan}, {"gain": 1, "recovery": -1}, {"swing": 1, "period": 0}, {"swing": -1}):
        with pytest.raises(EcologyError, match="Adaptation"):
            Adaptation(**words)


# ---- the form of the drive -----------------------------------------------------------------------

NEEDS = (
    Need(name="a", set_point=2.0, bounds=(0.0, 6.0), weight=2.0, excess=0.25),
    Need(name="b", set_point=3.0, bounds=(0.0, 6.0)),
    Need(name="c", set_point=1.0, bounds=(0.0, 6.0), regulated=False, weight=5.0),
)
FORMS = [(2.0, 1.0), (2.0, 2.0), (4.0, 4 / 3), (1.5, 1.0), (1.0, 1.0), (3.0, 2.0)]  # power, exponent


def formed(power, exponent, **words):
    """Return two bodies whose drive has a form of its own."""
    species = kind("body", move("walk", 0.1), needs=NEEDS, drive_power=power, drive_exponent=exponent, count=2, **words)
    return square(species)


def by_hand(delta, power, exponent):
    """Return the drive of one deviation (3,)."""
    a = 2.0 * (0.25 if delta[0] > 0 else 1.0) * abs(delta[0]) ** power
    return (0.001 + a + abs(delta[1]) ** power) ** (exponent / power)


@pytest.mark.parametrize(("power", "exponent"), FORMS)
def test_the_drive_has_its_form_in_the_world_and_in_every_learner(power, exponent):
    """World, learner, kernel and its slope (by differences), and the torch device agree with the formula."""
    rng = np.random.default_rng(0)
    env = start(formed(power, exponent))
    group, species = env.groups["body"], env.scenario.species[0]
    mind = make("hjb", group, np.random.SeedSequence(0), {})
    from ecology.agents.hjb.devices.cpu import encoding, first_order

    senses = mind.encoding
    drive, slope = from_python(encoding.drive), from_python(first_order.add_drive_slope)
    for _ in range(20):
        internal = rng.uniform(0.2, 5.8, (2, 3))
        tick = env.set_state(internal=internal)
        delta = internal[0] - [2.0, 3.0, 1.0]
        expected = by_hand(delta, power, exponent)
        assert tick.drive[0] == pytest.approx(expected)
        assert float(physiology.drive_of(species, np.where([1, 1, 0], delta, 0.0))) == pytest.approx(expected)
        zeta = tick.observations["body"][0].astype(np.float32)
        assert float(mind.drive(zeta)) == pytest.approx(expected, rel=1e-5)
        own, climb = np.zeros_like(zeta), np.zeros_like(zeta)
        assert float(drive(senses, zeta, own)) == pytest.approx(expected, rel=1e-5)
        slope(senses, zeta, own, climb)
        for v in range(3):
            step = np.zeros(3)
            step[v] = 1e-6
            ahead, behind = by_hand(delta + step, power, exponent), by_hand(delta - step, power, exponent)
            assert climb[v] == pytest.approx((ahead - behind) / 2e-6, rel=1e-3, abs=1e-4)
        assert (climb[3:] == 0).all()


def test_torch_knows_the_form_of_the_drive():
    """The device for GPUs has the same drive, and a slope that is finite at the set point."""
    torch = pytest.importorskip("torch")
    from ecology.agents.hjb.devices.torch import encoding

    for power, exponent in FORMS:
        env = start(formed(power, exponent))
        mind = make("hjb", env.groups["body"], np.random.SeedSequence(0), {})
        known = encoding.on_device(mind.encoding, torch.device("cpu"))
        zeta = torch.zeros(2, len(env.groups["body"].layout.names))
        zeta[0, :3] = torch.tensor([0.7, -1.2, 3.0])
        zeta.requires_grad_()
        found = encoding.drive(known, zeta)
        assert found.detach().numpy() == pytest.approx(
            [by_hand(np.array(d), power, exponent) for d in ([0.7, -1.2, 3.0], [0.0, 0.0, 0.0])], rel=1e-4
        )
        found.sum().backward()
        assert torch.isfinite(zeta.grad).all()


@pytest.mark.parametrize("form", ["sum", "average"])
def test_empathy_feels_the_form_of_the_others_drive(form):
    """Sum form: w times the other's own drive. Average form: the drive of mixed deviations; learners know both."""
    env = start(formed(3.0, 1.5, empathy=Empathy(weight=0.4, form=form)))
    tick = env.set_state(internal=np.array([[1.0, 4.0, 1.0], [4.0, 2.5, 0.0]]))
    one, other = np.array([-1.0, 1.0, 0.0]), np.array([2.0, -0.5, 0.0])
    mixed = by_hand(0.6 * one + 0.4 * other, 3.0, 1.5)
    added = by_hand(one, 3.0, 1.5) + 0.4 * by_hand(other, 3.0, 1.5)
    assert tick.drive[0] == pytest.approx(added if form == "sum" else mixed)
    mind = make("random", env.groups["body"], np.random.SeedSequence(0), {})
    assert mind.drive(tick.observations["body"])[0] == pytest.approx(tick.drive[0], rel=1e-5)


# ---- stages of life ------------------------------------------------------------------------------

GROWING = (
    Stage(name="young", speed=0.5, size=0.5, metabolism=2.0),
    Stage(name="adult", age=10.0),
    Stage(name="old", age=20.0, speed=0.25, size=2.0, metabolism=0.5),
)


@pytest.mark.parametrize("dt", [0.5, 1.0])
def test_speed_and_metabolism_change_with_age(dt):
    """Way and decay are the action's and the need's, times the factor of the stage in which the tick begins."""
    need = Need(name="food", set_point=9.0, decay=0.1, bounds=(0.0, 9.0))
    env = start(square(kind("body", move("walk", 0.1), needs=(need,), stages=GROWING, position=(1.0, 1.0), heading=0.0),
                       dt=dt))  # fmt: skip
    for _ in range(round(30 / dt)):
        env.step_arrays(ask(env, body="walk"))
    assert env.state_view.position[0, 0] == pytest.approx(1.0 + 0.1 * (5.0 + 10.0 + 2.5))
    assert env.state_view.internal[0, 0] == pytest.approx(9.0 - 0.1 * (20.0 + 10.0 + 5.0))


def test_a_walk_to_a_resource_still_ends_in_it():
    """A go_to by a body that is twice as fast stops at the resource; it does not run past it."""
    fast = (Stage(name="fast", speed=2.5),)
    lever = dataclasses.replace(LEVER, radius=0.05)
    env = start(square(kind("body", go_to("lever", 0.3), stages=fast, position=(1.0, 4.0)), resources=(lever,)))
    places = []
    for _ in range(6):
        env.step_arrays(ask(env, body="go_to_lever"))
        places.append(env.state_view.position[0, 0])
    assert places == pytest.approx([1.75, 2.5, 3.25, 4.0, 4.0, 4.0], abs=1e-6)


def test_diet_changes_with_age():
    """What a stage cannot is closed in its mask, and open from the next stage on; rest is always open."""
    stages = (Stage(name="young", cannot=("consume_lever",)), Stage(name="adult", age=10.0))
    env = start(square(kind("body", consume("lever", {"food": 0.1}), stages=stages, position=(4.0, 4.0)),
                       resources=(LEVER,)))  # fmt: skip
    open_ = []
    for _ in range(12):
        tick = env.step_arrays(ask(env, body="rest"))
        open_.append(tick.masks["body"][0].tolist())
    assert open_ == [[True, False]] * 9 + [[True, True]] * 3


def test_size_changes_with_age():
    """A body that walks against one that rests stops at the sum of their radii, which grow with age."""
    bodies = kind("body", move("walk", 0.1), stages=GROWING, count=2, radius=0.4, solid=True)
    for age, factor in ((0.0, 0.5), (12.0, 1.0), (21.0, 2.0)):
        env = start(square(dataclasses.replace(bodies, stages=tuple(
            dataclasses.replace(stage, speed=1.0, age=stage.age * 1000) for stage in GROWING
        ))), position=np.array([[2.0, 4.0], [5.0, 4.0]]), heading=np.zeros(2), age=np.full(2, 1000 * age))  # fmt: skip
        actions = np.array([1, 0])
        for _ in range(40):
            env.step_arrays(actions)
            gap = env.state_view.position[1, 0] - env.state_view.position[0, 0]
            if gap < 0.81 * factor:
                break
        assert gap == pytest.approx(0.8 * factor, rel=0.06)


@pytest.mark.parametrize(
    ("stages", "rule"),
    [
        ((Stage(name="late", age=1.0),), "the first from 0 on"),
        ((Stage(name="a"), Stage(name="b")), "follow each other by age"),
        ((Stage(name="a"), Stage(name="a", age=2.0)), "name of its own"),
        ((Stage(name="a", cannot=("wlak",)),), "Did you mean 'walk'"),
        ((Stage(name="a", cannot=("rest",)),), "no action but rest"),
        ((Stage(name="a", speed=1e4),), "moves a body by at most"),
        ((Stage(name="a", size=100.0),), "finds no room"),
    ],
)
def test_stages_that_cannot_be_are_refused(stages, rule):
    """Stages begin at 0, rise in age, name actions that are there, and fit into the arena."""
    with pytest.raises(EcologyError, match=rule):
        square(kind("body", move("walk", 0.1), stages=stages))
    for words in ({"speed": -1.0}, {"size": 0.0}, {"age": -1.0}, {"metabolism": math.inf}):
        with pytest.raises(EcologyError, match="stage"):
            Stage(name="a", **words)


# ---- all of it -----------------------------------------------------------------------------------


def lively(**words):
    """Return the world in which everything happens, its bodies with moving set points, a drive and stages of theirs."""
    world = everything(**words)
    hunters, grazers, ghosts = world.species
    food, calm, dirt = grazers.needs
    moving = Adaptation(gain=0.3, recovery=0.01, swing=0.2, period=30.0)
    food = dataclasses.replace(food, set_range=(1.0, 3.5), adaptation=moving, weight=2.0, excess=0.5)
    calm = dataclasses.replace(calm, set_range=(0.0, 2.0), adaptation=Adaptation(gain=-0.5, relaxation=0.1))
    stages = (
        Stage(name="young", speed=0.6, size=0.5, metabolism=1.5, cannot=("consume_fungus", "give_prey")),
        Stage(name="adult", age=8.0),
        Stage(name="old", age=40.0, speed=0.5, size=1.3),
    )
    grazers = dataclasses.replace(grazers, needs=(food, calm, dirt), stages=stages, drive_power=3.0)
    hunters = dataclasses.replace(
        hunters, stages=(Stage(name="cub", cannot=("bite_prey",)), Stage(name="hunter", age=5.0, speed=1.2))
    )
    return dataclasses.replace(world, species=(hunters, grazers, ghosts))


@pytest.mark.parametrize("holds", contract.CHECKS)
def test_lively_bodies_keep_the_contract(holds):
    """With everything on, accounts close, snapshots and copies go on bit for bit, and the mask is honoured."""
    contract.CHECKS[holds](lively(), 80)


def test_moving_set_points_live_in_a_small_tick_and_on_a_torus():
    """The contract's snapshot and account hold in other ticks and without walls too."""
    for words in ({"dt": 0.1}, {"walls": False}):
        contract.CHECKS["every account closes"](lively(**words), 60)
        contract.CHECKS["a snapshot continues bit for bit"](lively(**words), 60)


def test_worlds_without_them_hold_nothing_more():
    """A state without moving set points has no array of them, and no stages are looked at."""
    env = start(everything())
    model = env.world.model
    assert env.state_view.set_point is None
    assert (model.moving, model.stages, model.body.form) == (None, None, None)


def test_fawns_of_the_meadow_are_slow_and_hungry_until_they_are_grown():
    """In `scavengers` with a childhood, a young grazer walks at 0.6 of the speed and loses 1.3 times the energy."""
    env = start(scenarios.load("scavengers", childhood=50.0, mortality=0.0))
    rows = env.groups["grazer"].slots
    living = np.flatnonzero(env.state_view.alive[rows])
    for age, walk, loss in ((10.0, 0.072, 1.3 * 0.0025), (60.0, 0.12, 0.0025)):
        env.set_state(age=np.full(env.size, age))
        before = env.state_view.copy()
        env.step_arrays(ask(env, grazer="walk"))
        now = env.state_view
        way = np.linalg.norm(now.position - before.position, axis=1)[rows][living]
        assert np.median(way) == pytest.approx(walk)  # walls stop a few
        assert (before.internal - now.internal)[rows][living, 0] == pytest.approx(loss)
    assert not scenarios.load("scavengers").species[0].stages


@pytest.mark.parametrize("holds", contract.CHECKS)
def test_a_meadow_with_fawns_keeps_the_contract(holds):
    """Accounts close, and snapshots and copies go on bit for bit, as bodies grow."""
    contract.CHECKS[holds](scenarios.load("scavengers", childhood=20.0, grazers=10, scavengers=3, side=7.0), 60)
