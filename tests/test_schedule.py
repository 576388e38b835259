"""The schedule of a scenario: what happens when, to whom, and that it is a part of the world that everybody runs."""

import dataclasses
import json

import numpy as np
import pytest
from worlds import everything, kind, square

import ecology
from ecology import Cue, EcologyError, Event, Growth, Need, Resource, Session, consume, contract, move
from ecology.agents import loop, make
from ecology.interventions import intervene
from ecology.lab.runs.interventions import as_schedule
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.schedule import ScheduledTick, Timetable

GRASS = Resource(name="grass", position=(2.0, 2.0), stock=1.0, capacity=4.0, growth=Growth(rate=0.1))


def meadow(**words):
    """Return one eater beside a stock that grows by a tenth per unit of time."""
    food = Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0), set_range=(1.0, 3.0))
    eater = kind(
        "eater", consume("grass", {"food": 0.1}), move("walk", 0.1), needs=(food,), position=(2.0, 2.0), heading=0.0,
        cues=("light",), sees=("grass",),
    )  # fmt: skip
    return square(eater, resources=(GRASS,), cues=(Cue(name="light"),), **words)


def rests(env, ticks):
    """Rest for so many ticks; return the ticks."""
    return [env.step_arrays(np.zeros(env.size, np.int64)) for _ in range(ticks)]


def sentences(tick):
    """Return what is said of every event of a tick."""
    return [effect.said for _, effect in tick.effects] if isinstance(tick, ScheduledTick) else []


def told(ticks):
    """Return the line of every event of some ticks."""
    return [text for tick in ticks if isinstance(tick, ScheduledTick) for text, _ in tick.effects]


def test_a_stock_that_is_emptied_every_so_often_is_a_sawtooth():
    """Emptied at 10, 15, 20 and 25, and growing by 0.1 in between, it is 0.1 times the time since."""
    env = ecology.parallel_env(meadow(schedule=(Event(do="empty grass", at=10, every=5, until=25),)))
    env.reset_arrays(0)
    stocks = []
    for _ in range(40):
        rests(env, 1)
        stocks.append(env.state_view.stock[0])
    expected = [
        min(1.0 + 0.1 * t, 4.0) if t < 10 else 0.1 * (t - min(10 + 5 * ((t - 10) // 5), 25)) for t in range(1, 41)
    ]
    assert stocks == pytest.approx(expected)
    assert env.state_view.grown[0] == pytest.approx(stocks[-1] - 1.0)


@pytest.mark.parametrize("dt", [0.1, 0.5, 1.0, 3.0])
def test_events_come_at_their_time_whatever_the_tick(dt):
    """They follow the tick that ends nearest to their time, each once."""
    scenario = meadow(
        schedule=(Event(do="show light on", at=6, every=6), Event(do="show light off", at=9, every=6)), dt=dt
    )
    env = ecology.parallel_env(scenario)
    env.reset_arrays(0)
    shown = []
    for _ in range(round(36 / dt)):
        shown += [(env.state_view.time, said) for tick in rests(env, 1) for said in sentences(tick)]
    assert [time for time, _ in shown] == pytest.approx([6 + 3 * k for k in range(11)], abs=dt / 2)
    assert [said for _, said in shown] == ["light shows 1", "light shows 0"] * 5 + ["light shows 1"]


def test_a_cue_is_sensed_in_the_tick_that_it_is_shown():
    """The observation after the tick has it, before the agent acts again; so has the one after a reset."""
    env = ecology.parallel_env(meadow(schedule=(Event(do="show light on"), Event(do="show light 0.25", at=3))))
    at = env.groups["eater"].layout.names.index("light")
    seen = [env.reset_arrays(0).observations["eater"][0, at]]
    seen += [tick.observations["eater"][0, at] for tick in rests(env, 4)]
    assert seen == [1.0, 1.0, 1.0, 0.25, 0.25]


def test_a_set_point_that_is_shifted_is_felt():
    """The deviation falls by the shift, the drive follows, and the fall of the drive is in the reward of the tick."""
    env = ecology.parallel_env(meadow(schedule=(Event(do="shift eater food 3", at=5),)))
    before = env.reset_arrays(0)
    for t, tick in enumerate(rests(env, 8), 1):
        x = 2.0 - 0.01 * t
        delta = x - (3.0 if t >= 5 else 2.0)
        assert tick.observations["eater"][0, 0] == pytest.approx(delta)
        assert tick.drive[0] == pytest.approx(np.sqrt(0.001 + delta**2))
        assert tick.reward[0] == pytest.approx(before.drive[0] - tick.drive[0])
        before = tick


def test_what_is_not_felt_is_in_no_reward():
    """An event with felt=False changes the drive, but no reward pays for it."""
    env = ecology.parallel_env(meadow(schedule=(Event(do="set eater food 1", at=2, felt=False),)))
    first = env.reset_arrays(0)
    ticks = rests(env, 2)
    assert ticks[1].drive[0] > 0.9
    assert ticks[1].reward[0] == pytest.approx(ticks[0].drive[0] - np.sqrt(0.001 + 0.02**2))
    assert first.drive[0] < 0.1


def test_trials_and_sessions():
    """Trials follow each other by their length and gap, sessions in their order; each begins with an event."""
    sessions = (
        Session(name="train", trials=2, length=10, gap=2, events=(Event(do="show light on", at=4, every=3),)),
        Session(name="probe", length=5, events=(Event(do="refill grass", at=1),)),
    )
    env = ecology.parallel_env(meadow(sessions=sessions, schedule=(Event(do="empty grass", at=12),)))
    first = env.reset_arrays(0)
    at = {env.state_view.tick: [first]}
    for _ in range(40):
        tick = rests(env, 1)
        at[env.state_view.tick] = tick
    happened = {t: lines for t, ticks in at.items() if (lines := told(ticks))}
    assert happened == {
        0: ["trial 1 of train"], 4: ["show light on"], 7: ["show light on"],
        12: ["empty grass", "trial 2 of train"], 16: ["show light on"], 19: ["show light on"],
        24: ["trial 1 of probe"], 25: ["refill grass"],
    }  # fmt: skip
    trials = [env.timetable.trial(t) for t in (0, 11, 12, 23, 24, 40)]
    assert trials == [("train", 1)] * 2 + [("train", 2)] * 2 + [("probe", 1)] * 2


def test_random_gaps_have_their_mean_and_are_the_seed_s():
    """Gaps between 2,000 trials are exponential: mean and standard deviation are both the gap, to 4 sigma."""
    scenario = meadow(sessions=(Session(name="s", trials=2_000, length=1, gap=30, random=True),))

    def begins(seed):
        timetable = Timetable(scenario)
        timetable.start(seed)
        return np.array([due.tick for due in timetable.take(10**6)])

    gaps = np.diff(begins(1)) - 1
    assert gaps.mean() == pytest.approx(30, abs=4 * 30 / np.sqrt(2_000))
    assert gaps.std() == pytest.approx(30, abs=4 * 30 / np.sqrt(1_000))
    assert (begins(1) == begins(1)).all()
    assert not (begins(1) == begins(2)).all()


def test_a_timetable_starts_anywhere():
    """Started after any tick, it goes on with the same events as one that came there by itself."""
    events = (Event(do="show light on", at=1.3, every=2.7), Event(do="empty grass", at=7))
    scenario = meadow(schedule=events, sessions=(Session(name="s", trials=9, length=3, gap=1, random=True),), dt=0.7)
    one = Timetable(scenario)
    one.start(3)
    whole = one.take(200)
    for after in range(-1, 60):
        other = Timetable(scenario)
        other.start(3, after=after)
        assert other.next == min(due.tick for due in whole if due.tick > after)
        assert other.take(200) == [due for due in whole if due.tick > after]


def test_an_agent_that_is_gone_stops_nothing():
    """An event whose agent has died, or for which there is no slot, says so and the world goes on."""
    events = (Event(do="remove eater_0", at=2), Event(do="set eater food 1", at=4), Event(do="remove eater_0", at=5))
    env = ecology.parallel_env(meadow(schedule=events))
    env.reset_arrays(0)
    ticks = rests(env, 6)
    assert ticks[1].died[0]
    assert "could not be done: no eater lives" in ticks[3].effects[0][1].said
    assert "could not be done: no agent 'eater_0' lives" in ticks[4].effects[0][1].said


def test_a_newcomer_takes_no_slot_of_the_same_tick():
    """An agent that is removed and one that is put at one tick are two, in two slots, or the second finds no room."""
    events = (Event(do="remove eater_0", at=2), Event(do="put eater 1 1", at=2), Event(do="put eater 1 1", at=3))
    env = ecology.parallel_env(meadow(schedule=events))
    assert env.open_population
    env.reset(seed=0)
    assert env.step({"eater_0": 0})[2] == {"eater_0": False}
    assert env.step({"eater_0": 0})[2] == {"eater_0": True}
    assert env.agents == []
    rests(env, 1)
    assert env.agents == ["eater_1"]


def test_a_number_of_the_scenario_changes_and_comes_back():
    """From its event on the decay is another, the snapshot knows, and a reset takes it back."""
    scenario = meadow(schedule=(Event(do="change eater.food.decay 0.05", at=3),))
    env, other = ecology.parallel_env(scenario), ecology.parallel_env(scenario)
    for _ in range(2):
        env.reset_arrays(0)
        rests(env, 3)
        assert env.state_view.internal[0, 0] == pytest.approx(1.97)
        arrays, values = env.snapshot()
        other.restore(arrays, json.loads(json.dumps(values)))
        for world in (env, other):
            rests(world, 2)
            assert world.state_view.internal[0, 0] == pytest.approx(1.87)
            assert world.scenario.species[0].needs[0].decay == 0.05
    env.reset_arrays(0)
    assert env.scenario.species[0].needs[0].decay == 0.01


@pytest.mark.parametrize(
    ("event", "rule"),
    [
        ("fly away", "there is no intervention 'fly'"),
        ("empty gras", "Did you mean 'grass'"),
        ("empty eater", "there is no resource 'eater'"),
        ("move grass 9 9", "outside the arena"),
        ("put eator 1 1", "there is no species 'eator'"),
        ("set eater fod 1", "no need 'fod'"),
        ("set eater food 5", "lies between 0 and 4"),
        ("shift eater food 3.5", "set_range, 1 to 3"),
        ("show lihgt on", "there is no cue"),
        ("show light 2", "from 0 to 1"),
        ("learning eater maybe", "on or off"),
        ("empathy eater off", "has no empathy"),
        ("change eater.food.decai 1", "Did you mean 'decay'"),
        ("change eater.food.noise -1", "noise must not be negative"),
        ("change eater.name 1", "is no number"),
        ("change eater 1", "eater.radius"),
        ("refill grass 9", "between 0 and its capacity"),
    ],
)
def test_a_schedule_that_cannot_be_is_refused_when_the_scenario_is_made(event, rule):
    """Every name and number of an event is checked before anything runs, also within a session."""
    for words in (
        {"schedule": (Event(do=event, at=5),)},
        {"sessions": (Session(name="s", length=9, events=(Event(do=event),)),)},
    ):
        with pytest.raises(EcologyError) as error:
            meadow(**words)
        assert rule in str(error.value)


@pytest.mark.parametrize(
    ("path", "rule"),
    [
        ("eater.food.bounds", "is no number"),
        ("eater.view_range", "what eater perceives"),
        ("eater.drive_exponent", "drive"),
        ("eater.count", "count"),
        ("eater.food.set_point", "what eater perceives"),
    ],
)
def test_what_agents_know_of_themselves_cannot_change(path, rule):
    """A change of slots, of the observation space or of the drive is refused, and the world is as it was."""
    env = ecology.parallel_env(meadow())
    env.reset_arrays(0)
    with pytest.raises(EcologyError) as error:
        intervene(env, f"change {path} 2.5")
    assert rule in str(error.value)
    assert env.scenario == meadow()


@pytest.mark.parametrize(
    "words",
    [
        {"at": -1.0}, {"every": 0.0}, {"at": 5.0, "every": 1.0, "until": 4.0}, {"until": 9.0}, {"at": float("nan")},
    ],
)  # fmt: skip
def test_times_that_cannot_be_are_refused(words):
    """An event names its times by rules, and a session its length, trials and gap."""
    with pytest.raises(EcologyError):
        Event(do="empty grass", **words)
    for wrong in (
        {"length": 0.0},
        {"trials": 0},
        {"gap": -1.0},
        {"random": True},
        {"events": (Event(do="x", at=2.0),)},
    ):
        with pytest.raises(EcologyError):
            Session(**{"name": "s", "length": 1.0, **wrong})


def busy():
    """Return the world in which everything happens, with a schedule in which everything is done."""
    world = everything()
    species = tuple(dataclasses.replace(s, cues=("light",)) if s.name == "prey" else s for s in world.species)
    events = (
        Event(do="empty grass", at=10, every=20), Event(do="show light on", at=5, every=10),
        Event(do="show light off", at=8, every=10), Event(do="put prey 2 4", at=7, every=9, felt=False),
        Event(do="remove prey_8", at=12), Event(do="change prey.birth.rate 0.3", at=15),
        Event(do="empathy hunter off", at=20), Event(do="set prey food 2.5", at=9, every=30),
        Event(do="move grass.1 2 6", at=11),
    )  # fmt: skip
    trial = Session(name="one", length=10, trials=3, events=(Event(do="move prey_10 3 3", at=2),), gap=3, random=True)
    return dataclasses.replace(world, cues=(Cue(name="light"),), species=species, schedule=events, sessions=(trial,))


@pytest.mark.parametrize("holds", contract.CHECKS)
def test_a_busy_schedule_keeps_the_contract(holds):
    """Births, deaths, moves, cues and changes by the schedule leave every account closed and every copy exact."""
    contract.CHECKS[holds](busy(), 80)


def test_a_learner_experiences_what_is_felt():
    """It learns of a shift as the outcome of its tick, but not of being moved; then it is told that it was."""

    class Notes:
        """Keep what a learner is told."""

        def __init__(self, group):
            self.group, self.learning, self.seconds, self.seen, self.cut = group, True, 0.0, [], []

        def act(self, observations, masks):
            return np.zeros(self.group.size, np.int64)

        def learn(self, transition):
            self.seen.append(transition.next_observations[0, 0])

        def interrupted(self, slots):
            self.cut.append((len(self.seen), slots.tolist()))

        def report(self):
            return {}

    x = 2.0 - 0.01 * np.arange(1, 7)
    for felt in (True, False):
        events = (Event(do="shift eater food 3", at=2, felt=felt), Event(do="move eater_0 5 5", at=4, felt=felt))
        env = ecology.parallel_env(meadow(schedule=events))
        mind = Notes(env.groups["eater"])
        loop.run(env, {"eater": mind}, env.reset_arrays(0), 6)
        target = np.array([2.0, 3.0 if felt else 2.0, 3.0, 3.0, 3.0, 3.0])
        assert mind.seen == pytest.approx(x - target)
        assert mind.cut == ([(4, [0])] if felt else [(2, [0]), (4, [0])])


def test_a_schedule_can_freeze_learners():
    """`learning SPECIES off` at a time, also at the start, is passed on, and a run that resumes still knows."""
    env = ecology.parallel_env(meadow(schedule=(Event(do="learning eater off"), Event(do="learning eater on", at=3))))
    mind = make("algorithm1", env.groups["eater"], np.random.SeedSequence(0), {})
    tick = env.reset_arrays(0)
    tick = loop.run(env, {"eater": mind}, tick, 2)
    assert not mind.learning
    loop.run(env, {"eater": mind}, tick, 1)
    assert mind.learning


SCENARIO = '''"""Prey on grass."""
import dataclasses
from ecology import scenarios
{more}
def build(ticks: int = 40):
    """Return it."""
    world = scenarios.load("predator_prey")
    return dataclasses.replace(world, ticks=ticks, name="meadow"{schedule})
'''


@pytest.mark.parametrize("learner", ["random", "lean"])
def test_a_log_becomes_a_schedule(tmp_path, learner):
    """`ecology script` turns the interventions of a run into a schedule whose run is the same, learners included."""
    (tmp_path / "meadow.py").write_text(SCENARIO.format(more="", schedule=""))
    run = Run(resolve(str(tmp_path / "meadow.py"), learners=[learner], record=False), tmp_path / "a")
    run.start()
    deeds = {
        3: "move grass.0 2 2",
        7: "set prey energy 0.5",
        9: "remove prey_3",
        15: "put prey 3 3",
        20: "learning prey off",
    }

    class Doer(ecology.observers.base.Observer):
        """Intervene at its ticks."""

        def watch(self, state, tick, minds):
            if state.tick in deeds:
                run.do(deeds[state.tick])

    run.live([Doer()])
    text = as_schedule(tmp_path / "a", 1.0)
    schedule = text[text.index("from ecology") :]
    (tmp_path / "again.py").write_text(SCENARIO.format(more=schedule, schedule=", schedule=SCHEDULE"))
    again = Run(resolve(str(tmp_path / "again.py"), learners=[learner], record=False), tmp_path / "b")
    again.start()
    again.live()
    one, other = run.parts(), again.parts()
    assert one.keys() == other.keys()
    for part in one:
        for name, values in one[part][0].items():
            assert np.array_equal(values, other[part][0][name], equal_nan=True), (part, name)


def test_events_are_recorded_with_session_trial_cues_and_set_points(tmp_path):
    """The metrics have a column for each, and events where interventions stand; the recording tells them."""
    from ecology.observers.readback import column
    from ecology.observers.recorder import Recorder, read
    from ecology.observers.rerun import RerunObserver

    sessions = (Session(name="train", trials=2, length=4, events=(Event(do="shift eater food 3", at=1),)),)
    env = ecology.parallel_env(meadow(sessions=sessions, schedule=(Event(do="show light on", at=3),)))
    mind = make("random", env.groups["eater"], np.random.SeedSequence(0), {})
    watchers = (Recorder(tmp_path / "m.parquet", 1), RerunObserver(tmp_path / "r.rrd", every=1))
    loop.run(env, {"eater": mind}, env.reset_arrays(0), 6, watchers)
    table = read(tmp_path / "m.parquet").to_pydict()
    assert table["session"] == ["train"] * 6
    assert table["trial"] == [1, 1, 1, 2, 2, 2]
    assert table["set_points.food"] == [2.0, 3.0, 3.0, 3.0, 3.0, 3.0]
    assert table["cues.light"] == [0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
    assert table["interventions"][:2] == ["tick 0: trial 1 of train", "tick 1: shift eater food 3"]
    events = column(tmp_path / "r.rrd", "/events/interventions", "TextLog:text")
    assert [each[0] for each in events.values()][-1] == "5  the set point of food of eater was shifted to 3"
    shown = column(tmp_path / "r.rrd", "/population/measures", "Scalars:scalars")
    assert [float(value[0]) for value in shown.values()] == [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0]
