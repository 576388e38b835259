"""What a user gets wrong gives one clear error: the rule, the value, and what to do."""

import dataclasses
import math

import numpy as np
import pytest

import ecology
from ecology import (
    Action,
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
    agents,
    consume,
    go_to,
    move,
    rest,
    scenarios,
    sleep,
    spec,
    turn,
)

SQUARE = Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4)))
FOOD = Need(name="food", set_point=2.0)


BERRIES = Resource(name="berries", position=(1.0, 1.0))


def species(**words):
    """Return a species that is right but for `words`."""
    return Species(**{"name": "agent", "needs": (FOOD,), "actions": (rest(),), **words})


def scenario(**words):
    """Return a scenario that is right but for `words`; words of the species are passed on to it."""
    own = {"name", "arena", "resources", "species", "dt", "ticks", "day", "rule", "measures"}
    of_species = {key: words.pop(key) for key in list(words) if key not in own}
    parts = {"name": "tiny", "arena": SQUARE, "resources": (BERRIES,), "species": (species(**of_species),)}
    return Scenario(**{**parts, **words})


def test_the_tiny_scenario_is_right():
    """Without a wrong word, the scenario of this file is accepted: each error below is its own word's."""
    assert scenario(actions=(rest(), consume("berries", {"food": 0.1}))).name == "tiny"


# (what is wrong, words that the message must contain: the rule and the value)
WRONG = {
    # arena
    "walls cross": (lambda: Arena(vertices=((0, 0), (4, 4), (4, 0), (0, 4))), ["walls", "cross", "2 2"]),
    "walls overlap": (
        lambda: Arena(vertices=((0, 0), (4, 0), (4, 4), (4, 0), (0, 4))),
        ["walls", "overlap"],
    ),
    "walls are open": (lambda: Arena(vertices=((0, 0), (4, 0))), ["at least 3", "got 2"]),
    "walls enclose nothing": (lambda: Arena(vertices=((0, 0), (2, 0), (4, 0))), ["walls"]),
    "first vertex repeated": (
        lambda: Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 0))),
        ["repeated", "(0, 0)", "leave it out"],
    ),
    "a vertex of three": (lambda: Arena(vertices=((0, 0, 0), (4, 0), (4, 4))), ["(x, y)", "(0, 0, 0)"]),
    "an infinite vertex": (lambda: Arena(vertices=((0, 0), (math.inf, 0), (4, 4))), ["finite", "inf"]),
    # need
    "bounds exclude the set point": (
        lambda: Need(name="food", set_point=5.0, bounds=(0.0, 4.0)),
        ["'food'", "(0.0, 4.0)", "set point 5.0", "widen"],
    ),
    "bounds exclude the start": (
        lambda: Need(name="food", set_point=2.0, start=9.0, bounds=(0.0, 4.0)),
        ["'food'", "(0.0, 4.0)", "start 9.0"],
    ),
    "bounds are upside down": (
        lambda: Need(name="food", set_point=2.0, bounds=(4.0, 0.0)),
        ["low < high", "(4.0, 0.0)"],
    ),
    "a floor above the start": (
        lambda: Need(name="food", set_point=2.0, floor=2.5),
        ["floor 2.5", "start 2.0"],
    ),
    "a floor that saves from death": (
        lambda: Need(name="food", set_point=2.0, floor=0.5, lethal=True),
        ["floor 0.5", "lethal"],
    ),
    "decay is not a number": (lambda: Need(name="food", set_point=2.0, decay="slow"), ["decay", "'slow'"]),
    "decay is NaN": (lambda: Need(name="food", set_point=2.0, decay=math.nan), ["decay", "nan"]),
    "noise is negative": (lambda: Need(name="food", set_point=2.0, noise=-0.1), ["noise", "-0.1"]),
    "a need has two words": (lambda: Need(name="blood sugar", set_point=2.0), ["'blood sugar'", "word"]),
    "a season without length": (lambda: Season(amplitude=0.5, period=0.0), ["period", "positive", "0.0"]),
    # action
    "a negative speed": (lambda: move("walk", -0.1), ["'walk'", "speed", "-0.1"]),
    "a speed of words": (lambda: move("walk", "fast"), ["'walk'", "speed", "'fast'"]),
    "an infinite turn": (lambda: turn("spin", math.inf), ["'spin'", "turn", "inf"]),
    "a negative sleep": (lambda: sleep(duration=-5.0), ["duration", "-5.0"]),
    "a control of NaN": (lambda: rest(control={"food": math.nan}), ["food", "nan"]),
    "a walk to a resource": (lambda: move("walk", 0.1, resource="berries"), ["'walk'", "resource"]),
    "a walk that does not walk": (lambda: move("walk", 0.0), ["'walk'", "positive speed", "0.0"]),
    "a turn that does not turn": (lambda: turn("spin", 0.0), ["'spin'", "rate"]),
    "a way to nowhere": (lambda: move("walk", 0.1, direction=math.inf), ["'walk'", "direction", "inf"]),
    "a collapse at NaN": (
        lambda: species(actions=(rest(), sleep(duration=1.0)), collapse={"food": math.nan}),
        ["food", "nan"],
    ),
    "a heading of infinity": (lambda: species(heading=math.inf), ["heading", "inf"]),
    "nobody": (lambda: scenario(count=0), ["at least one agent", "count 0"]),
    "a need named like a place": (
        lambda: scenario(needs=(Need(name="x", set_point=1.0),)),
        ["zeta", "['x']", "rename"],
    ),
    "a sense named twice": (lambda: scenario(senses=("position", "position")), ["['x', 'y']", "once"]),
    "a walk across the world": (
        lambda: scenario(actions=(rest(), move("leap", 1e6))),
        ["'leap'", "1000000.0", "200 radii", "lower the speed"],
    ),
    # resource
    "a resource without size": (
        lambda: Resource(name="berries", position=(1, 1), radius=0.0),
        ["'berries'", "radius", "0.0"],
    ),
    "a resource in space": (lambda: Resource(name="berries", position=(1, 1, 1)), ["(x, y)", "(1, 1, 1)"]),
    # species
    "no need": (lambda: species(needs=()), ["'agent'", "at least one need"]),
    "two needs of one name": (lambda: species(needs=(FOOD, FOOD)), ["need", "['food']", "twice"]),
    "two actions of one name": (
        lambda: species(actions=(rest(), move("walk", 0.1), move("walk", 0.2))),
        ["action", "['walk']", "twice"],
    ),
    "no rest": (lambda: species(actions=(move("walk", 0.1),)), ["exactly one rest action"]),
    "two rests": (lambda: species(actions=(rest(), rest("idle"))), ["exactly one rest action"]),
    "collapse without sleep": (lambda: species(collapse={"food": 3.0}), ["collapse", "sleep"]),
    "a negative count": (lambda: species(count=-1), ["count", "-1"]),
    "half an agent": (lambda: species(count=1.5), ["count", "1.5"]),
    "a body without size": (lambda: species(radius=0.0), ["radius", "0.0"]),
    "a view of 400 degrees": (lambda: species(view_angle=7.0), ["view_angle", "2 pi", "7.0"]),
    "a blind view": (lambda: species(view_range=0.0), ["view_range", "0.0"]),
    "a half-hearted commitment": (lambda: species(commitment="maybe"), ["'free'", "'committed'", "'maybe'"]),
    "a drive without epsilon": (lambda: species(drive_epsilon=0.0), ["drive_epsilon", "0.0"]),
    # scenario
    "no species": (lambda: scenario(species=()), ["at least one species"]),
    "two species of one name": (lambda: scenario(species=(species(), species())), ["['agent']", "twice"]),
    "two resources of one name": (
        lambda: scenario(resources=(BERRIES, BERRIES)),
        ["resource", "['berries']", "twice"],
    ),
    "time stands still": (lambda: scenario(dt=0.0), ["dt", "positive", "0.0"]),
    "half a tick": (lambda: scenario(ticks=2.5), ["ticks", "whole", "2.5"]),
    "a resource outside": (
        lambda: scenario(resources=(Resource(name="berries", position=(5.0, 1.0)),)),
        ["'berries'", "(5.0, 1.0)", "outside", "inside the walls"],
    ),
    "a birth outside": (lambda: scenario(position=(5.0, 1.0)), ["'agent'", "(5.0, 1.0)", "outside"]),
    "a birth in the wall": (lambda: scenario(position=(3.95, 1.0)), ["(3.95, 1.0)", "radius 0.1", "wall"]),
    "a body larger than the room": (lambda: scenario(radius=2.5), ["radius 2.5", "no room"]),
    "an unknown need in a control": (
        lambda: scenario(actions=(rest(), move("walk", 0.1, control={"fod": 1.0}))),
        ["'walk'", "'fod'", "control", "'food'"],
    ),
    "an unknown need in an intake": (
        lambda: scenario(actions=(rest(), consume("berries", {"foot": 1.0}))),
        ["'consume_berries'", "'foot'", "Did you mean 'food'"],
    ),
    "an unknown need in closes_at": (
        lambda: scenario(actions=(rest(), move("walk", 0.1, closes_at={"tired": 1.0}))),
        ["'tired'", "closes_at", "food"],
    ),
    "an unknown need in opens_from": (
        lambda: scenario(actions=(rest(), sleep(duration=1.0, opens_from={"foods": 1.0}))),
        ["'foods'", "opens_from", "Did you mean 'food'"],
    ),
    "an unknown need in collapse": (
        lambda: scenario(actions=(rest(), sleep(duration=1.0)), collapse={"fodo": 1.0}),
        ["collapse", "'fodo'", "Did you mean 'food'"],
    ),
    "an unknown resource": (
        lambda: scenario(actions=(rest(), go_to("beries", 0.1))),
        ["'go_to_beries'", "'beries'", "Did you mean 'berries'"],
    ),
    "an unknown sense": (lambda: scenario(senses=("postion",)), ["'postion'", "Did you mean 'position'"]),
    "a clock without a day": (lambda: scenario(senses=("clock",)), ["'clock'", "day"]),
    # world
    "not a scenario": (lambda: ecology.parallel_env("paper"), ["Scenario", "'paper'", "scenarios.load"]),
    "no horizon": (lambda: ecology.parallel_env(scenario(), horizon=0), ["horizon", "positive", "0"]),
    "an unknown render mode": (
        lambda: ecology.parallel_env(scenario(), render_mode="ansi"),
        ["render_mode", "'ansi'"],
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_word_is_named(what):
    """A scenario that contradicts itself is refused with the rule and the value."""
    make, words = WRONG[what]
    with pytest.raises(EcologyError) as caught:
        make()
    for word in words:
        assert word in str(caught.value), str(caught.value)


# (a wrong type, words that the message must contain: class and field, what it must be, the value)
WRONG_TYPES = {
    "a hazard of a rate": (
        lambda: species(hazard=0.0002),
        ["species 'agent'", "hazard must be a Hazard or None", "0.0002"],
    ),
    "a season of a number": (
        lambda: Need(name="food", set_point=2.0, season=3),
        ["need 'food'", "season must be a Season or None", "got 3"],
    ),
    "no settings of a learner": (lambda: species(learner_settings=None), ["learner_settings must be a dict", "None"]),
    "a list of settings": (lambda: species(learner_settings=[1]), ["learner_settings must be a dict", "[1]"]),
    "a forgotten comma after a need": (
        lambda: species(needs=(FOOD)),
        ["needs must be a tuple of Need: write needs=(Need(...),)", "name='food'"],
    ),
    "a forgotten comma after an action": (
        lambda: species(actions=rest()),
        ["actions must be a tuple of Action: write actions=(Action(...),)"],
    ),
    "a forgotten comma after a species": (
        lambda: scenario(species=species()),
        ["scenario 'tiny'", "species must be a tuple of Species: write species=(Species(...),)"],
    ),
    "a forgotten comma after neighbours": (
        lambda: species(neighbours=Neighbours(count=2)),
        ["neighbours must be a tuple of Neighbours: write neighbours=(Neighbours(...),)", "count=2"],
    ),
    "a forgotten comma after a name": (
        lambda: scenario(sees=("berries")),
        ["sees must be a tuple of strings: write sees=('berries',)", "got 'berries'"],
    ),
    "a name among neighbours": (
        lambda: Neighbours(species="agent"),
        ["Neighbours: species must be a tuple of strings", "write species=('agent',)"],
    ),
    "a resource among needs": (lambda: species(needs=(FOOD, BERRIES)), ["needs[1] must be a Need", "'berries'"]),
    "a number among names": (lambda: species(sees=("berries", 3)), ["sees[1] must be a string", "got 3"]),
    "a number among senses": (
        lambda: species(senses=("position", 3)),
        ["senses[1] must be a string or a Gauge or a Rays", "3"],
    ),
    "a count of True": (lambda: species(count=True), ["count must be a whole number", "True"]),
    "a rate of True": (lambda: Need(name="food", set_point=2.0, decay=True), ["decay must be a number", "True"]),
    "a flag of 1": (lambda: species(solid=1), ["solid must be True or False", "got 1"]),
    "a name of 3": (lambda: species(name=3), ["name must be a string", "got 3"]),
    "an intake of a number": (lambda: consume("berries", 0.1), ["control must be a dict of numbers by name", "0.1"]),
    "an intake of words": (lambda: consume("berries", {"food": "much"}), ["control['food']", "a number", "'much'"]),
    "a need that is not named": (lambda: consume("berries", {1: 0.1}), ["a key of control must be a string", "got 1"]),
    "a kind that there is not": (lambda: Action(name="walk", kind="walk"), ["kind must be 'rest' or", "'walk'"]),
    "bounds of one number": (lambda: Need(name="food", set_point=2.0, bounds=(0.0,)), ["bounds must be (low, high)"]),
    "bounds of a number": (lambda: Need(name="food", set_point=2.0, bounds=0.0), ["bounds must be a pair of numbers"]),
    "a vertex of words": (lambda: Arena(vertices=((0, 0), (4, "0"), (4, 4))), ["vertices[1][1]", "a number", "'0'"]),
    "an arena of vertices": (lambda: scenario(arena=((0, 0), (4, 0), (4, 4))), ["arena must be an Arena"]),
    "a motion of a number": (
        lambda: Resource(name="berries", motion=0.1),
        ["motion must be an Oscillation or a Drift or a Relocation or None", "0.1"],
    ),
    "a rule of words": (lambda: scenario(rule="tag"), ["rule must be a function or None", "'tag'"]),
    "measures of numbers": (lambda: scenario(measures={"stock": 3}), ["measures['stock'] must be a function", "got 3"]),
}


@pytest.mark.parametrize("what", WRONG_TYPES)
def test_a_wrong_type_is_named(what):
    """A field of the wrong type is refused with its class, what it must be and the value."""
    make, words = WRONG_TYPES[what]
    with pytest.raises(EcologyError) as caught:
        make()
    for word in words:
        assert word in str(caught.value), str(caught.value)
    assert len(str(caught.value)) < 300


FIELDS = {
    Action: {"name": "idle", "kind": "rest"},
    Arena: {"vertices": SQUARE.vertices},
    Birth: {"rate": 0.1},
    ecology.Adaptation: {"gain": 0.1},
    ecology.Cue: {"name": "light"},
    ecology.Event: {"do": "empty berries"},
    ecology.Session: {"name": "training", "length": 9.0},
    ecology.Stage: {"name": "cub"},
    ecology.Trait: {"name": "mark", "of": "none", "bounds": (0.0, 1.0)},
    Crowding: {"within": 1.0, "control": {"food": -0.1}},
    Door: {"name": "gate", "start": (1.0, 1.0), "end": (2.0, 1.0)},
    Drift: {"spread": 0.1},
    Empathy: {"weight": 1.0},
    Exposure: {"field": "air", "slowing": 0.5},
    Fault: {"of": "x", "noise": 0.1},
    Field: {"name": "air"},
    Gauge: {"field": "air"},
    Growth: {"rate": 0.1},
    Hazard: {"rate": 0.1},
    Hearing: {"channel": "alarm", "range": 2.0},
    Need: {"name": "food", "set_point": 2.0},
    Neighbours: {},
    Oscillation: {"to": (1.0, 1.0), "period": 9.0},
    Rays: {"range": 2.0},
    Remains: {"resource": "berries", "body": 0.5},
    Resource: {"name": "berries"},
    Seeding: {"rate": 0.1},
    Trace: {"of": "x", "rate": 0.1},
    Scenario: {"name": "tiny", "arena": SQUARE, "species": (species(),)},
    Season: {"amplitude": 0.5, "period": 9.0},
    Species: {"name": "agent", "needs": (FOOD,), "actions": (rest(),)},
}


def test_all_words_are_among_those_whose_types_are_tried():
    """The words of `ecology.spec` that have fields, and the scenario, are all in `FIELDS`."""
    found = {word for word in vars(spec).values() if dataclasses.is_dataclass(word) and dataclasses.fields(word)}
    assert found | {Scenario} == set(FIELDS)


@pytest.mark.parametrize(
    ("word", "field"), [(word, field.name) for word in FIELDS for field in dataclasses.fields(word)]
)
def test_the_type_of_every_field_is_checked(word, field):
    """No field of any word takes what is of no type that a scenario knows; the error names the field."""
    word(**FIELDS[word])
    with pytest.raises(EcologyError, match=rf"{field} must be .*, got <object"):
        word(**{**FIELDS[word], field: object()})


@pytest.mark.parametrize("name", ["owner", "rate", "maturity", "within", "weight", "radius", "speed"])
def test_a_need_may_have_the_name_of_a_field(name):
    """A need is called as one likes: where its amounts are checked, the names of fields are no other need's."""
    amounts = {name: 1.0}
    species(
        needs=(Need(name=name, set_point=2.0),),
        actions=(rest(control=amounts), sleep(duration=1.0, opens_from=amounts)),
        collapse=amounts,
        birth=Birth(rate=0.1, threshold=amounts, cost=amounts),
        crowding=Crowding(within=1.0, control=amounts),
        empathy=Empathy(weight=1.0, needs=amounts),
    )


# ---- scenario files and settings ---------------------------------------------------------


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("def build(:\n", ["my_world.py", "SyntaxError"]),
        ("import a_package_that_is_not_there\n", ["my_world.py", "a_package_that_is_not_there"]),
        ("x = 1 / 0\n", ["my_world.py", "ZeroDivisionError"]),
        ("x = 1\n", ["my_world.py", "must define a function `build`"]),
        ("build = 3\n", ["my_world.py", "must define a function `build`"]),
        ("def build():\n    return 3\n", ["must return an ecology.Scenario", "int"]),
        ("def build():\n    return {}['food']\n", ["cannot be built", "KeyError"]),
        ("import sys\ndef build():\n    sys.exit(3)\n", ["cannot be built", "my_world.py, line 3", "SystemExit: 3"]),
        ("def build(size):\n    return size\n", ["'size'", "default"]),
        ("def build(**settings):\n    return settings\n", ["'settings'", "default"]),
    ],
)
def test_a_scenario_file_that_does_not_work_is_named(tmp_path, source, words):
    """A file that does not parse, run, or define a scenario is refused with its name and the reason."""
    path = tmp_path / "my_world.py"
    path.write_text(source)
    with pytest.raises(EcologyError) as caught:
        scenarios.load(str(path))
    for word in words:
        assert word in str(caught.value), str(caught.value)


def test_a_scenario_file_that_works_is_loaded(tmp_path):
    """A file given by its path is a scenario like those that ship, settings included."""
    path = tmp_path / "my_world.py"
    path.write_text(
        "from ecology.scenarios.paper import build as paper\n"
        "def build(decay: float = 0.001):\n    return paper(decay=decay)\n"
    )
    assert scenarios.settings(str(path)) == {"decay": 0.001}
    assert scenarios.load(str(path), decay=0.003).species[0].needs[0].decay == 0.003


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("papr", ["'papr'", "Did you mean 'paper'"]),
        ("season", ["'season'", "Did you mean 'seasons'"]),
        ("zzz", ["'zzz'", "paper", "seasons", ".py"]),
        ("nowhere/my_world.py", ["nowhere/my_world.py", "no scenario file"]),
        ("cli", ["'cli'"]),
    ],
)
def test_an_unknown_scenario_is_answered_with_the_nearest(name, words):
    """An unknown scenario is refused with the nearest known names."""
    with pytest.raises(EcologyError) as caught:
        scenarios.load(name)
    for word in words:
        assert word in str(caught.value), str(caught.value)


def test_a_file_named_without_its_ending_is_suggested(tmp_path, monkeypatch):
    """A name that is no scenario, but that of a file without .py, is answered with the file."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_world.py").write_text("def build():\n    pass\n")
    with pytest.raises(EcologyError, match=r"no scenario 'my_world'. Did you mean the file 'my_world.py'\?"):
        scenarios.load("my_world")


@pytest.mark.parametrize("learner", ["hjb", "lean", "algorithm1", "qvalue", "random"])
def test_an_unknown_setting_of_a_learner_names_the_learner(learner):
    """The learner that is blamed for an unknown setting is the one asked for, not the class that it shares."""
    world = scenario(learner=learner, learner_settings={"gama": 1})
    group = ecology.parallel_env(world).groups["agent"]
    with pytest.raises(EcologyError, match=rf"the learner {learner} has no setting 'gama'"):
        agents.make(learner, group, np.random.SeedSequence(0), world.species[0].learner_settings)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"decya": 0.1}, ["no setting 'decya'", "Did you mean 'decay'"]),
        ({"decay": "slow"}, ["'decay'", "'slow'", "0.002"]),
        ({"decay": True}, ["'decay'", "True"]),
        ({"decay": math.nan}, ["decay", "nan"]),
        ({"decay": math.inf}, ["decay", "inf"]),
        ({"heading": 1}, ["'heading'", "1"]),
        ({"heading": "yes"}, ["'heading'", "'yes'"]),
        ({"ticks": 10.5}, ["'ticks'", "10.5"]),
        ({"ticks": 0}, ["ticks", "positive", "0"]),
        ({"ticks": -5}, ["ticks", "positive", "-5"]),
        ({"dt": 0}, ["dt", "positive", "0"]),
        ({"dt": -1.0}, ["dt", "positive", "-1.0"]),
        ({"set_points": (1.0,) * 5}, ["set_points", "1 to 4", "(1.0, 1.0, 1.0, 1.0, 1.0)"]),
        ({"set_points": 3.0}, ["'set_points'", "3.0"]),
        ({"set_points": (1.0, 2.0, 3.0, "four")}, ["set_point", "'four'"]),
        ({"set_points": (1.0, 2.0, 3.0, -4.0)}, ["need_4", "bounds", "(0.0, -8.0)"]),
        ({"view_angle": 10.0}, ["view_angle", "2 pi", "10.0"]),
        ({"view_range": 0.0}, ["view_range", "positive", "0.0"]),
        ({"commitment": "maybe"}, ["'free'", "'committed'", "'maybe'"]),
        ({"commitment": 3}, ["'commitment'", "3"]),
    ],
)
def test_a_wrong_setting_is_named(settings, words):
    """An unknown setting, one of the wrong type or out of range is refused with its name and value."""
    with pytest.raises(EcologyError) as caught:
        scenarios.load("paper", **settings)
    for word in words:
        assert word in str(caught.value), str(caught.value)


def test_an_unknown_arena_of_the_reference_is_named():
    """`paper_reference` knows two arenas."""
    with pytest.raises(EcologyError, match=r"'MEDIUM', 'EASY', got 'HARD'"):
        scenarios.load("paper_reference", arena="HARD")


# ---- actions -----------------------------------------------------------------------------


@pytest.fixture
def env():
    """Return a started world of three agents, the last of them dead."""
    env = ecology.parallel_env(
        scenario(
            count=3,
            needs=(Need(name="food", set_point=2.0, bounds=(0.0, 4.0), lethal=True),),
            actions=(rest(), move("walk", 0.1)),
        )
    )
    env.reset(seed=0)
    internal = env.state_view.internal.copy()
    internal[2] = -1.0
    env.set_state(internal=internal)
    env.step(dict.fromkeys(env.agents, 0))
    assert env.agents == ["agent_0", "agent_1"]
    return env


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        ({"agent_0": 0}, ["every living agent needs an action", "missing: agent_1"]),
        ({}, ["missing: agent_0, agent_1"]),
        ({"agent_0": 0, "agent_1": 0, "agent_7": 0}, ["no agent 'agent_7'", "agent_0"]),
        ({"agent_0": 0, "agent_1": 0, "agent_2": 0}, ["life of 'agent_2' is over", "env.agents"]),
        ({"agent_0": 0, "agent_1": 2}, ["agent_1", "from 0 to 1", "got 2"]),
        ({"agent_0": -1, "agent_1": 0}, ["agent_0", "from 0 to 1", "got -1"]),
        ({"agent_0": 0.0, "agent_1": 0}, ["agent_0", "whole number", "0.0"]),
        ({"agent_0": "walk", "agent_1": 0}, ["agent_0", "whole number", "'walk'"]),
        ({"agent_0": None, "agent_1": 0}, ["agent_0", "whole number", "None"]),
        ({"agent_0": True, "agent_1": 0}, ["agent_0", "whole number", "True"]),
        ({"agent_0": np.array([1]), "agent_1": 0}, ["agent_0", "whole number", "array([1])"]),
        ([0, 0], ["dict", "[0, 0]"]),
    ],
)
def test_a_wrong_action_is_named_and_nothing_happens(env, actions, words):
    """An action that is missing, foreign, not whole or out of range is refused; the world stands still."""
    before = env.state_view.copy()
    with pytest.raises(EcologyError) as caught:
        env.step(actions)
    for word in words:
        assert word in str(caught.value), str(caught.value)
    for name, values in before.arrays().items():
        assert np.array_equal(values, env.state_view.arrays()[name]), name
    assert env.state_view.tick == before.tick


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        (np.zeros(2, np.int64), ["3 whole numbers", "(2,)"]),
        (np.zeros(3), ["whole numbers", "float64"]),
        (np.array([0, 9, 0]), ["agent_1", "from 0 to 1", "got 9"]),
        (np.array([-1, 0, 0]), ["agent_0", "got -1"]),
    ],
)
def test_a_wrong_array_of_actions_is_named(env, actions, words):
    """The same holds for actions as an array, one a slot."""
    with pytest.raises(EcologyError) as caught:
        env.step_arrays(actions)
    for word in words:
        assert word in str(caught.value), str(caught.value)


@pytest.mark.parametrize("one", [1, np.int64(1), np.int8(1), np.array(1), np.uint8(1)])
def test_every_whole_number_is_an_action(env, one):
    """Whole numbers of Python and of numpy are actions."""
    *_, infos = env.step({"agent_0": one, "agent_1": 0})
    assert infos["agent_0"]["closed"] is False
    assert env.state_view.action[0] == 1


def test_a_world_that_has_not_started_says_so():
    """Before reset there is nothing to step, to see or to put."""
    env = ecology.parallel_env(scenario())
    for too_early in (
        lambda: env.step({}),
        lambda: env.step_arrays(np.zeros(1, np.int64)),
        lambda: env.state_view,
        lambda: env.state(),
        lambda: env.set_state(),
    ):
        with pytest.raises(EcologyError, match="call reset"):
            too_early()


@pytest.mark.parametrize("seed", [-1, 1.5, "one"])
def test_a_wrong_seed_is_named(seed):
    """A seed is a whole number of at least 0."""
    env = ecology.parallel_env(scenario())
    with pytest.raises(EcologyError, match="seed must be a whole number") as caught:
        env.reset(seed=seed)
    assert repr(seed) in str(caught.value)


def test_an_unknown_agent_has_no_space(env):
    """Asking for the space of an agent that there is not names the nearest."""
    for space in (env.observation_space, env.action_space):
        with pytest.raises(EcologyError, match=r"no agent 'agnt_1'.*'agent_1'"):
            space("agnt_1")


def test_a_wrong_probe_is_named(env):
    """`set_state` knows the fields of the state and their shapes."""
    with pytest.raises(EcologyError, match=r"no array 'positon'.*'position'"):
        env.set_state(positon=np.zeros((3, 2)))
    with pytest.raises(EcologyError, match=r"shape \(3, 2\), got \(2,\)"):
        env.set_state(position=np.zeros(2))
    env.set_state(position=np.full((3, 2), 2.0))
    assert (env.state_view.position == 2.0).all()


def test_errors_are_value_errors():
    """Whoever catches ValueError catches these."""
    assert issubclass(EcologyError, ValueError)
