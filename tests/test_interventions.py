"""Interventions: what is done to a world between two ticks, by whom it is refused, and that a run can repeat it."""
# ruff: noqa: D102

import contextlib
import json
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from worlds import kind, square, start

import ecology
from ecology import EcologyError, Growth, Need, Oscillation, Resource, consume, move
from ecology.interventions import VERBS, intervene
from ecology.lab.runs import interventions as logs
from ecology.lab.runs import run as runs
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import resolve
from ecology.observers import mailbox
from ecology.state import CAUSES
from ecology.verbs import USAGES, split


def meadow(**words):
    """Return a world of callers that feel for each other, listeners, berries, a pond and a fly that swings."""
    patches = (
        Resource(name="berries", count=2, stock=1.0, capacity=3.0, growth=Growth(rate=0.01)),
        Resource(name="pond", position=(4.0, 4.0)),
        Resource(name="fly", position=(2.0, 2.0), motion=Oscillation(to=(6.0, 2.0), period=50.0)),
    )
    needs = (
        Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0)),
        Need(name="tired", set_point=0.0, bounds=(0.0, 1.0)),
    )
    caller = kind("caller", move("walk", 0.3), consume("berries", {"food": 0.1}), count=2, needs=needs,
                  empathy=ecology.Empathy(weight=0.5))  # fmt: skip
    return square(caller, kind("listener", count=1, capacity=2, **words), resources=patches)


def grown():
    """Return the same, where listeners bear."""
    return meadow(birth=ecology.Birth(rate=1e-9))


# ---- the grammar -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "an intervention is one line"),
        ("   ", "an intervention is one line"),
        ("move caller_0\n1 1", "an intervention is one line"),
        ("x" * 300, "an intervention is one line"),
        ("mve caller_0 1 1", "Did you mean 'move'"),
        ("move caller_0 1", "'move' takes move AGENT X Y [DEGREES]  or  move RESOURCE[.N] X Y; got 'move caller_0 1'"),
        ("move caller_0 1 1 90 2", "'move' takes"),
        ("move caller_7 1 1", "no agent 'caller_7' lives at tick 0. Did you mean 'caller_1'"),
        ("move caller_0 one 1", "x must be a finite number, got 'one'"),
        ("move caller_0 nan 1", "x must be a finite number"),
        ("move caller_0 1 1e999", "y must be a finite number"),
        ("move caller_0 99 1", "the place (99, 1) lies outside the arena, which extends from (0, 0) to (8, 8)"),
        ("move caller_0 1 1 north", "the heading must be a finite number"),
        ("move berries 1 1", "name one, as berries.0"),
        ("move berries.2 1 1", "has 2 patches, counted from 0; there is no patch 2"),
        ("move fly 1 1", "oscillates"),
        ("move pond 1 1 90", "a resource has no heading"),
        ("move ponds 1 1", "Did you mean 'pond'"),
        ("refill pond", "is unlimited"),
        ("refill berries 9", "lies between 0 and its capacity, 3; got 9"),
        ("empty pond", "is unlimited"),
        ("put callers 1 1", "Did you mean 'caller'"),
        ("put caller 1 1", "all 2 slots of 'caller' are taken"),
        ("put listener 9 9", "lies outside the arena"),
        ("remove listener_9", "no agent 'listener_9' lives"),
        ("set caller_0 foood 1", "has no need 'foood'. Did you mean 'food'"),
        ("set caller_0 food 9", "the need 'food' lies between 0 and 4, got 9"),
        ("set caller_0 food much", "must be a finite number"),
        ("empathy listener 1", "the species 'listener' has no empathy; give one that has: caller"),
        ("empathy caller most", "a weight of empathy must be a finite number"),
        ("learning caller maybe", "switched on or off, got 'maybe'"),
    ],
)
def test_what_cannot_be_done_is_refused(text, said):
    """The error names what is wrong and what is allowed, and nothing has changed."""
    env = start(grown())
    before = env.state_view.copy()
    with pytest.raises(EcologyError) as error:
        intervene(env, text)
    assert said in str(error.value)
    for name, values in before.arrays().items():
        assert np.array_equal(values, env.state_view.arrays()[name]), name


def test_every_verb_has_its_usage():
    """What the page and the errors show are the verbs that there are, each with words that it takes."""
    assert {usage.split()[0] for usage in USAGES} == set(VERBS)
    for usage in USAGES:
        assert split(usage)[0] == usage.split()[0]


def test_things_are_where_they_were_put():
    """An agent and a resource are elsewhere, a body has what it was given, and a species feels less."""
    env = start(grown())
    effect = intervene(env, "move caller_1 1 2.5 90")
    state = env.state_view
    assert state.position[1].tolist() == [1.0, 2.5]
    assert state.heading[1] == pytest.approx(np.pi / 2)
    assert effect.changed == (1,)
    assert effect.said.endswith("to (1.00, 2.50)")
    assert intervene(env, "move berries.1 7 7").changed == ()
    assert env.state_view.resource_position[1].tolist() == [7.0, 7.0]
    intervene(env, "move pond_0 6 6")
    assert env.state_view.resource_position[2].tolist() == [6.0, 6.0]
    assert intervene(env, "set caller_0 food 0.5").changed == (0,)
    assert intervene(env, "set caller tired 1").changed == (0, 1)
    assert env.state_view.internal[:2].tolist() == [[0.5, 1.0], [2.0, 1.0]]
    felt = env.state_view.drive[1] - env.state_view.own_drive[1]
    assert felt == pytest.approx(0.5 * env.state_view.own_drive[0])
    intervene(env, "empathy caller 0.25")
    assert env.state_view.drive[1] - env.state_view.own_drive[1] == pytest.approx(felt / 2)
    intervene(env, "empathy caller off")
    assert env.state_view.drive[1] == env.state_view.own_drive[1]
    intervene(env, "empathy caller on")
    assert env.state_view.drive[1] - env.state_view.own_drive[1] == pytest.approx(felt)


def test_what_is_felt_in_shares_can_be_cut():
    """In the average form empathy is cut and restored, and its weight cannot be another."""
    agent = kind("agent", count=2, needs=(Need(name="food", set_point=2.0, bounds=(0.0, 4.0)),),
                 empathy=ecology.Empathy(weight=0.5, form="average"))  # fmt: skip
    env = start(square(agent))
    intervene(env, "set agent_0 food 0")
    felt = env.state_view.drive.copy()
    intervene(env, "empathy agent off")
    assert env.state_view.drive == pytest.approx(env.state_view.own_drive)
    assert not np.allclose(felt, env.state_view.own_drive)
    with pytest.raises(EcologyError, match="average form"):
        intervene(env, "empathy agent 0.25")
    intervene(env, "empathy agent on")
    assert env.state_view.drive == pytest.approx(felt)


def test_agents_come_and_go():
    """A new agent has a new name and a newborn's needs; where nobody is born, a dead one returns under its name."""
    env = start(grown())
    effect = intervene(env, "put listener 3 3 180")
    slot = effect.born[0]
    assert env.agents[-1] == env.name_of(slot) == "listener_3"
    assert env.state_view.position[slot].tolist() == [3.0, 3.0]
    assert env.state_view.heading[slot] == -np.pi
    assert intervene(env, "remove listener_2").died == (2,)
    assert CAUSES[env.state_view.cause[2]] == "rule"
    assert "listener_2" not in env.agents
    fixed = start(meadow())
    intervene(fixed, "remove listener_2")
    intervene(fixed, "put listener 1 1")
    assert fixed.agents[-1] == "listener_2"
    fixed.step_arrays(np.zeros(fixed.size, np.int64))


def test_accounts_stay_closed():
    """Start, what was taken in and what was given make what there is, of every stock and every body that lives."""
    env = start(grown())
    body, first = env.state_view.internal.copy(), env.state_view.stock.copy()
    rng = np.random.default_rng(1)
    deeds = ("set caller_0 food 0.3", "refill berries", "set caller tired 0.9", "empty berries.1",
             "refill berries.1 2.5", "set caller_1 food 3.5", "move caller_0 4 4")  # fmt: skip
    for deed in deeds:
        intervene(env, deed)
        for _ in range(5):
            env.step_arrays(rng.integers(0, 1, env.size))
    s = env.state_view
    np.testing.assert_allclose(s.internal[:2], (body + s.ingested + s.received - s.given - s.metabolised - s.lost)[:2])
    finite = np.isfinite(first)
    np.testing.assert_allclose(s.stock[finite], (first + s.grown - s.eaten)[finite])


# ---- a run -----------------------------------------------------------------------------------

DEEDS = {
    4: ["move grass.2 1.5 1.5", "set prey energy 1.2"],
    11: ["remove prey_8"],
    12: ["put prey 2.5 2.5", "learning prey off"],
    20: ["empathy prey 0.4", "empty grass.0"],
    26: ["learning prey on", "refill grass"],
}
TICKS = 40


class Doer:
    """An observer that intervenes at given ticks, from the thread of the run."""

    def __init__(self, run, deeds=DEEDS):
        self.run, self.deeds, self.told = run, deeds, []

    def begin(self, env, minds):
        pass

    def watch(self, state, tick, minds):
        for deed in self.deeds.get(state.tick, ()):
            assert self.run.do(deed) == ""

    def intervened(self, state, text, said):
        self.told.append((state.tick, said))

    def end(self):
        pass


@pytest.fixture
def world(tmp_path):
    """Return a file with the village, where nobody is eaten and slots are left: who is named below is there."""
    tests = Path(__file__).parent
    file = tmp_path / "hamlet.py"
    file.write_text(
        f"import sys\nsys.path.insert(0, {str(tests)!r})\n\n\ndef build(ticks: int = {TICKS}):\n"
        '    """A village."""\n    import dataclasses\n\n    from observed import village\n\n'
        "    world = village(1e9)\n    prey, predator = world.species\n"
        "    prey = dataclasses.replace(prey, capacity=100)\n"
        "    predator = dataclasses.replace(predator, actions=predator.actions[:3])\n"
        "    return dataclasses.replace(world, species=(prey, predator), ticks=ticks, measures={})\n"
    )
    return file


def plan(world, **words):
    """Return the plan of a run of the village that records nothing."""
    return resolve(str(world), learners=["random"], seed=5, **{"record": False, "ticks": TICKS, **words})


def end_of(run):
    """Return all that a run has become, but for its times."""
    parts = run.parts()
    return {part: arrays for part, (arrays, _) in parts.items()}, run.schedule.entries, parts["run"][1].get("frozen")


def same(first, second):
    """Hold two ends to be the same, bit for bit."""
    for part, arrays in first[0].items():
        for name, array in arrays.items():
            np.testing.assert_array_equal(array, second[0][part][name], err_msg=f"{part} {name}")
    assert first[1:] == second[1:]


@pytest.fixture
def lived(world, tmp_path):
    """Return a run of the village in which somebody intervened."""
    run = Run(plan(world, checkpoint_every=15), tmp_path / "first")
    run.start()
    doer = Doer(run)
    run.live([doer])
    assert [tick for tick, _ in doer.told] == [tick for tick, deeds in DEEDS.items() for _ in deeds]
    return run


def test_the_log_repeats_the_life(lived, world, tmp_path):
    """A run with the log of another has its life bit for bit; without, it has another."""
    log = (tmp_path / "first/interventions.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in log] == [{"tick": t, "do": d} for t, deeds in DEEDS.items() for d in deeds]
    again = Run(plan(world), tmp_path / "again")
    again.schedule.read(tmp_path / "first/interventions.jsonl")
    again.start()
    again.live()
    same(end_of(lived), end_of(again))
    assert (tmp_path / "again/interventions.jsonl").read_text().splitlines() == log
    assert json.loads((tmp_path / "again/summary.json").read_text())["interventions"] == len(log)
    alone = Run(plan(world), tmp_path / "alone")
    alone.start()
    alone.live()
    assert not np.array_equal(alone.env.state_view.position, again.env.state_view.position)
    assert not (tmp_path / "alone/interventions.jsonl").exists()
    assert "interventions" not in json.loads((tmp_path / "alone/summary.json").read_text())


@pytest.mark.parametrize("at", [12, 13, 27])
def test_a_run_that_stopped_resumes_among_its_interventions(lived, world, tmp_path, at):
    """Whether it is stopped or killed, what was done by the checkpoint is not done again, and the rest is."""

    class KilledError(Exception):
        pass

    class Stops(Doer):
        def watch(self, state, tick, minds):
            super().watch(state, tick, minds)
            if state.tick == at:
                raise KilledError

    run = Run(plan(world, checkpoint_every=10), tmp_path / "second")
    run.start()
    with pytest.raises(EcologyError, match="KilledError"):
        run.live([Stops(run)])
    done = [deed for tick, deeds in DEEDS.items() if tick <= at for deed in deeds]
    assert [entry.do for entry in logs.read_log(tmp_path / "second/interventions.jsonl")] == done
    later = {tick: deeds for tick, deeds in DEEDS.items() if tick > at}
    run = open_run(tmp_path / "second")
    run.resume()
    assert run.now == at // 10 * 10
    run.live([Doer(run, later)])
    same(end_of(lived), end_of(run))


def test_a_fork_has_the_past_of_its_run(lived, tmp_path):
    """The world at a tick is reached with all that was done before, and the log of the fork replays whole."""
    from ecology.lab.runs.fork import Change, fork

    forked = fork(open_run(tmp_path / "first"), 14, tmp_path / "fork", Change())
    assert forked.now == 14
    assert "prey_8" not in forked.env.agents
    assert forked.frozen == {"prey"}
    forked.start()
    forked.live([Doer(forked, {tick: deeds for tick, deeds in DEEDS.items() if tick >= 14})])
    for name, array in lived.env.state_view.arrays().items():
        np.testing.assert_array_equal(array, forked.env.state_view.arrays()[name], err_msg=name)
    log = logs.read_log(tmp_path / "fork/interventions.jsonl")
    assert [entry.tick for entry in log] == [4, 4, 11, 12, 12, 20, 20, 26, 26]


def test_another_thread_is_answered(world, tmp_path):
    """What a thread asks for is done at the end of a tick, or refused with the reason; after the run it is refused."""
    said = []

    class Asks(Doer):
        def watch(self, state, tick, minds):
            if state.tick == 5:
                for deed in ("move grass.1 2 2", "move grass.9 2 2"):
                    thread = threading.Thread(target=self.ask, args=(deed,))
                    thread.start()
                    while self.run.schedule.requests.empty():
                        time.sleep(0.001)
                    self.threads.append(thread)

        threads: list = []  # noqa: RUF012

        def ask(self, deed):
            try:
                said.append(self.run.do(deed))
            except EcologyError as error:
                said.append(str(error))

    run = Run(plan(world), tmp_path / "run")
    run.start()
    asks = Asks(run)
    run.live([asks])
    for thread in asks.threads:
        thread.join(10)
    assert sorted(said)[0].startswith("grass.1 was moved from")
    assert "there is no patch 9" in sorted(said)[1]
    assert [entry.tick for entry in run.schedule.entries] == [5]


def test_what_is_done_before_the_run_is_in_its_log(world, tmp_path):
    """An intervention before the first tick is done at tick 0, and the life that is repeated has it."""
    first = Run(plan(world), tmp_path / "first")
    assert first.do("move grass.1 2 2").startswith("grass.1 was moved")
    first.start()
    first.live()
    again = Run(plan(world), tmp_path / "again")
    again.schedule.read(tmp_path / "first/interventions.jsonl")
    again.start()
    again.live()
    same(end_of(first), end_of(again))


def test_a_second_terminal_is_answered(world, tmp_path, monkeypatch):
    """A run that lives does what a file in its folder asks for, and answers; garbage is no request."""
    monkeypatch.setattr(runs, "LOOK", 0.0)
    monkeypatch.setattr(mailbox, "PAUSE", 0.01)
    said = []

    def ask(deed):
        try:
            words = {"ended": "", "silent": ""}
            said.append(mailbox.request(tmp_path / "run", runs.DO, deed, lambda: True, **words))
        except EcologyError as error:
            said.append(str(error))

    class Asks(Doer):
        def watch(self, state, tick, minds):
            if state.tick == 3:
                (tmp_path / "run/do.json").write_text("garbage")
            if state.tick in (5, 8):
                deed = "empty grass" if state.tick == 5 else "empty gras"
                self.thread = threading.Thread(target=ask, args=(deed,))
                self.thread.start()
                while b'"do"' not in _bytes(tmp_path / "run/do.json"):
                    time.sleep(0.001)
            if state.tick in (7, 10):
                self.thread.join(10)

    def _bytes(file):
        with contextlib.suppress(OSError):
            return file.read_bytes()
        return b""

    run = Run(plan(world), tmp_path / "run")
    run.start()
    run.live([Asks(run)])
    assert said[0] == "tick 5: grass was emptied"
    assert "there is no resource 'gras'. Did you mean 'grass'" in said[1]
    assert not (tmp_path / "run/do.json").exists()


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["garbage"], "line 1: a line is"),
        (['{"tick": 1}'], "line 1: a line is"),
        (['{"tick": 5, "do": "empty grass"}', "", '{"tick": 4, "do": "empty grass"}'], "line 3: its tick"),
        (['{"tick": -1, "do": "empty grass"}'], "its tick is a whole number"),
        (['{"tick": true, "do": "empty grass"}'], "its tick is a whole number"),
        (['{"tick": 1, "do": "burn grass"}'], "there is no intervention 'burn'"),
        (['{"tick": 1, "do": 5}'], "an intervention is one line"),
    ],
)
def test_a_log_that_is_none_is_refused(tmp_path, lines, said):
    """The error names the file, the line and what is wrong with it."""
    file = tmp_path / "log.jsonl"
    file.write_text("\n".join(lines))
    with pytest.raises(EcologyError) as error:
        logs.read_log(file)
    assert said in str(error.value)
    assert "log.jsonl" in str(error.value)


def test_a_schedule_that_does_not_fit_stops_the_run(world, tmp_path):
    """The error names the intervention and its tick; the run up to there is kept."""
    run = Run(plan(world), tmp_path / "run")
    run.schedule.entries = [logs.Entry(7, "remove prey_999")]
    run.start()
    with pytest.raises(EcologyError, match=r"intervention 1 of the schedule, 'remove prey_999' at tick 7: no agent"):
        run.live()
    assert run.now == 7


# ---- what is written of them -----------------------------------------------------------------


def test_interventions_are_recorded(world, tmp_path):
    """Each is an event of the recording at its tick, and in the metrics at the next sample."""
    from observed import column

    from ecology.observers.recorder import Recorder, read
    from ecology.observers.rerun import RerunObserver

    run = Run(plan(world, ticks=24), tmp_path / "run")
    run.start()
    observers = [Recorder(tmp_path / "metrics.parquet", 5), RerunObserver(tmp_path / "life.rrd", every=5)]
    run.live([*observers, Doer(run)])
    ticks, texts = column(tmp_path / "life.rrd", "/events/interventions", "TextLog:text")
    assert ticks.tolist() == [4, 4, 11, 12, 12, 20, 20]
    assert texts[2] == ["11  prey_8 was removed"]
    table = read(tmp_path / "metrics.parquet")
    told = dict(zip(*(table[name].to_pylist() for name in ("tick", "interventions")), strict=True))
    assert told[10] is None
    assert told[15].startswith("tick 11: remove prey_8; tick 12: put prey 2.5 2.5; tick 12: ")
    assert set(told) == {5, 10, 15, 20}


def test_an_intervention_before_a_stop_is_in_the_metrics(world, tmp_path):
    """What was done after the last sample of a run that was stopped is in the first row of the run that resumes."""
    from ecology.lab.cli.live import make_observers
    from ecology.lab.runs.stopping import StoppedError
    from ecology.observers.control import Control
    from ecology.observers.recorder import read

    class Stops(Doer):
        def held(self):
            if self.run.now == 12 and self.told:
                signal.raise_signal(signal.SIGINT)
            elif self.run.now == 12:
                self.run.do("empty grass.0")

    run = Run(plan(world, record=True, ticks=24), tmp_path / "run")
    run.start()
    run.control = Control(paused=True)
    for _ in range(12):
        run.control.order("step")
    with pytest.raises(StoppedError):
        run.live([*make_observers(run, resume=False), Stops(run, {})])
    run = open_run(tmp_path / "run")
    run.resume()
    assert run.now == 12
    run.live(make_observers(run, resume=True))
    table = read(tmp_path / "run/metrics.parquet")
    told = dict(zip(*(table[name].to_pylist() for name in ("tick", "interventions")), strict=True))
    assert told == {10: None, 20: "tick 12: empty grass.0"}


def test_an_agent_does_not_learn_from_what_was_done_to_it():
    """An agent that was moved decides again, and remembers no walk that led it there."""
    from ecology import Ecology, agents, scenarios
    from ecology.agents.loop import advance

    env = Ecology(scenarios.load("paper"))
    mind = agents.make("algorithm1", env.groups["agent"], np.random.SeedSequence(2), {"adaptive_steps": True})
    tick = advance(env, {"agent": mind}, env.reset_arrays(1), 5)
    while mind.execution.left[0] <= 1:
        tick = advance(env, {"agent": mind}, tick, 1)
    decisions = mind.decisions[0]
    kept = mind.memory.count[0]
    x, y = env.state_view.resource_position[0].tolist()
    effect = intervene(env, f"move agent_0 {x} {y}")
    mind.interrupted(np.array(effect.changed))
    advance(env, {"agent": mind}, effect.tick, 1)
    assert mind.decisions[0] == decisions + 1
    assert mind.memory.count[0] == kept
    assert mind.execution.began[0][list(env.groups["agent"].layout.names).index("x")] == pytest.approx(x)
