"""What is no error: numbers of NumPy, and names that look like others."""

import dataclasses

import numpy as np
import pytest

import ecology
from ecology import (
    Arena,
    Birth,
    Crowding,
    Door,
    Drift,
    EcologyError,
    Empathy,
    Exposure,
    Fault,
    Field,
    Gauge,
    Growth,
    Hazard,
    Hearing,
    Need,
    Neighbours,
    Oscillation,
    Rays,
    Remains,
    Resource,
    Scenario,
    Season,
    Seeding,
    Species,
    Trace,
    consume,
    go_to,
    move,
    rest,
    scenarios,
    sleep,
    spec,
    turn,
)

# ---- what is fine --------------------------------------------------------------------------------

SQUARE = Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4)))
FOOD = Need(name="food", set_point=2.0)


WORDS = (
    Season(amplitude=0.5, period=10.0, phase=1.0),
    Need(name="food", set_point=2.0, start=1.0, decay=0.1, noise=0.25, bounds=(0.0, 4.0)),
    ecology.bite("prey", reach=0.5, chance=0.5, gain={"food": 1.0}, damage={"food": 0.5}, duration=2.0),
    ecology.give("prey", {"food": 0.5}, reach=0.5, efficiency=0.5),
    consume("berries", {"food": 0.5}, opens_from={"food": 0.0}, closes_at={"food": 3.0}),
    move("walk", 0.5, direction=1.0, control={"food": -0.5}),
    Growth(rate=0.5),
    Oscillation(to=(1.0, 2.0), period=10.0),
    Drift(spread=0.5),
    Resource(name="berries", position=(1.0, 1.0), radius=0.5, stock=2.0, capacity=3.0, availability=0.5),
    Resource(name="berries", count=3, stock=2.0, decay=0.5, gone_below=0.25, present=2),
    Seeding(rate=0.5, offspring=0.25, reach=2.0),
    Remains(resource="berries", needs={"food": 0.5}, body=2.0),
    SQUARE,
    Door(name="gate", start=(1.0, 1.0), end=(2.0, 1.0), period=4.0, open_for=0.25, phase=0.5),
    Field(name="air", values=((1.0, 0.5),), low=0.0, high=2.0, diffusion=0.5, sources={"berries": 0.25}, cells=8),
    Exposure(field="air", reference=1.0, control={"food": 0.5}, slowing=0.25, dimming=-0.5),
    Gauge(field="air"),
    Rays(range=2.0, count=4, spread=1.5),
    Hearing(channel="alarm", range=2.0),
    Trace(of="x", rate=0.5),
    Fault(of="x", noise=0.5, failure=0.25, repair=0.125),
    ecology.take("berries", 0.5),
    Birth(rate=0.5, threshold={"food": 1.0}, cost={"food": 0.5}, maturity=2.0),
    Hazard(rate=0.5, ageing=0.25),
    ecology.Adaptation(gain=0.5, recovery=0.25, relaxation=0.5, swing=0.5, period=2.0, phase=0.5),
    ecology.Cue(name="light", start=0.5),
    ecology.Event(do="empty berries", at=0.5, every=2.0, until=4.5),
    ecology.Session(name="training", length=8.0, trials=3, gap=2.0),
    ecology.Stage(name="cub", speed=0.5, size=0.5, metabolism=2.0),
    ecology.Trait(name="mark", of="none", bounds=(0.0, 1.0), mutation=0.5, start=0.25, spread=0.5),
    Crowding(within=1.0, control={"food": -0.5}),
    Neighbours(count=2),
    Empathy(weight=0.5, matrix=((0.0, 1.0), (1.0, 0.0)), needs={"food": 0.5}, within=2.0),
    Species(name="agent", needs=(FOOD,), actions=(rest(),), count=2, capacity=3, position=(1.0, 1.0), heading=0.5,
            view_angle=1.5, learner_settings={"width": 16}),
    Scenario(name="room", arena=SQUARE, species=(Species(name="agent", needs=(FOOD,), actions=(rest(),)),), day=24.0),
)  # fmt: skip


def in_numpy(value, kind):
    """Return `value` with every number in it of the NumPy type `kind`, whole numbers of int64."""
    if isinstance(value, dict):
        return {key: in_numpy(part, kind) for key, part in value.items()}
    if isinstance(value, tuple):
        return tuple(in_numpy(part, kind) for part in value)
    if isinstance(value, bool):
        return np.bool_(value)
    return np.int64(value) if isinstance(value, int) else kind(value) if isinstance(value, float) else value


def python_types(value):
    """Return the types of all numbers in `value`."""
    if isinstance(value, (tuple, dict)):
        return [kind for part in (value.values() if isinstance(value, dict) else value) for kind in python_types(part)]
    return [type(value)]


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.float16, np.array])
@pytest.mark.parametrize("word", WORDS, ids=lambda word: type(word).__name__)
def test_numpy_scalars_are_numbers(word, kind):
    """Every field of every word takes NumPy's numbers, and holds Python's of the same value."""
    given = {field.name: getattr(word, field.name) for field in dataclasses.fields(word)}
    plain = {name: value for name, value in given.items() if not dataclasses.is_dataclass(value)}
    found = dataclasses.replace(word, **{name: in_numpy(value, kind) for name, value in plain.items()})
    for name, value in plain.items():
        if kind in (np.float64, np.array) or not isinstance(value, float) or float(kind(value)) == value:
            assert getattr(found, name) == value
        assert python_types(getattr(found, name)) == python_types(value), name


def test_every_word_is_in_the_list():
    """No word of a scenario with a number in it is left out of the test above."""
    words = {kind for kind in vars(spec).values() if dataclasses.is_dataclass(kind)} | {Scenario}
    assert words - {ecology.Relocation} == {type(word) for word in WORDS}


def test_a_setting_of_a_scenario_may_be_of_numpy():
    """A setting is the Python number, as the run's plan holds it."""
    for value in (np.int64(5), np.array(5)):
        count = scenarios.load("commons", n=value, growth=np.float32(0.25)).settings["n"]
        assert (count, type(count)) == (5, int)
    with pytest.raises(EcologyError, match="the setting 'n' of scenario 'commons' is like 12"):
        scenarios.load("commons", n=np.float64(2.5))


@pytest.mark.parametrize(
    ("action", "default"),
    [
        (lambda **name: rest(**name), "rest"),
        (lambda **name: sleep(duration=1.0, **name), "sleep"),
        (lambda **name: consume("grass", {"food": 1.0}, **name), "consume_grass"),
        (lambda **name: go_to("grass", 1.0, **name), "go_to_grass"),
        (lambda **name: ecology.bite("prey", reach=0.5, **name), "bite_prey"),
        (lambda **name: ecology.give("prey", {"food": 1.0}, reach=0.5, **name), "give_prey"),
        (lambda name="walk": move(name=name, speed=1.0), "walk"),
        (lambda name="left": turn(name=name, rate=1.0), "left"),
        (lambda name="call": ecology.act(name=name), "call"),
    ],
)
def test_every_action_takes_a_name(action, default):
    """Without a name it is called after what it does; an empty name is refused as ever."""
    assert action().name == default
    assert action(name="mine").name == "mine"
    with pytest.raises(EcologyError, match="a name is a Python word"):
        action(name="")


def test_a_setting_that_is_a_tuple_of_any_length_takes_any_length():
    """`tuple[float, ...]` takes fewer numbers than the default has; a scenario says how many it can use."""
    three = scenarios.load("paper", set_points=[1, 4.0, 2.0])
    assert [need.set_point for need in three.species[0].needs if need.name.startswith("need")] == [1.0, 4.0, 2.0]
    assert len(three.resources) == 3
    for wrong in ((), (1.0,) * 5):
        with pytest.raises(EcologyError, match="set_points are 1 to 4 numbers"):
            scenarios.load("paper", set_points=wrong)
    with pytest.raises(EcologyError, match="'start' of scenario 'paper_reference' is like"):
        scenarios.load("paper_reference", start=(1.0, 2.0, 3.0))
