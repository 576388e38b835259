"""The loop: whom it calls, when, and how often."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from ecology import Ecology, EcologyError, Scenario, agents
from ecology.agents import lives, loop
from ecology.agents.base import Learner
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers.base import Observer

SEED = np.random.SeedSequence(0)


class Log:
    """Writes down what is called, and raises in the calls named `fails`."""

    def __init__(self, name: str, calls: list[str], fails: str = "") -> None:
        self.name, self.calls, self.fails = name, calls, fails

    def _note(self, word: str) -> None:
        self.calls.append(f"{word} {self.name}")
        if word == self.fails:
            raise RuntimeError(f"{word} of {self.name} failed")

    def begin(self, env, minds):
        """Note the beginning."""
        self._note("begin")

    def watch(self, state, tick, minds):
        """Note a tick."""
        self._note("watch")

    def end(self):
        """Note the end."""
        self._note("end")


@pytest.fixture
def world(room: Callable[..., Scenario]) -> tuple[Ecology, dict[str, Learner]]:
    """Return a room and an agent that acts at random in it."""
    env = Ecology(room())
    return env, {"agent": agents.make("random", env.groups["agent"], SEED, {})}


def test_a_run_begins_and_ends_its_observers_once(world):
    """`begin` comes once before the first tick and `end` once after the last, in reverse order."""
    env, learners = world
    calls: list[str] = []
    tick = loop.run(env, learners, env.reset_arrays(0), 2, [Log("a", calls), Log("b", calls)])
    assert calls == ["begin a", "begin b", "watch a", "watch b", "watch a", "watch b", "end b", "end a"]
    del calls[:]
    loop.run(env, learners, tick, 0, [Log("a", calls)])
    assert calls == ["begin a", "end a"]


@pytest.mark.parametrize(
    ("first", "second", "called"),
    [
        ("begin", "", ["begin a"]),
        ("", "begin", ["begin a", "begin b", "end a"]),
        ("watch", "", ["begin a", "begin b", "watch a", "end b", "end a"]),
        ("", "end", ["begin a", "begin b", "watch a", "watch b", "end b", "end a"]),
    ],
)
def test_an_exception_ends_those_that_have_begun_once(world, first, second, called):
    """Whatever an observer raises reaches the caller after every observer that has begun was ended, once."""
    env, learners = world
    calls: list[str] = []
    with pytest.raises(RuntimeError, match="failed"):
        loop.run(env, learners, env.reset_arrays(0), 1, [Log("a", calls, first), Log("b", calls, second)])
    assert calls == called


def test_an_exception_of_a_learner_ends_the_observers(world):
    """A learner that returns no actions ends the run; its observers are ended once."""
    env, learners = world
    learners["agent"].act = lambda *_: "left"
    calls: list[str] = []
    with pytest.raises(EcologyError, match="must return 1 actions"):
        loop.run(env, learners, env.reset_arrays(0), 1, [Log("a", calls)])
    assert calls == ["begin a", "end a"]


def test_a_run_with_a_folder_begins_and_ends_its_observers_once(tmp_path):
    """A run that is cut into pieces by its checkpoints is one run for its observers, also where one of them fails."""
    for fails, ticks in (("", 7), ("watch", 1)):
        calls: list[str] = []
        plan = resolve("commons", ticks=7, learners=["random"], record=False, checkpoint_every=2)
        run = Run(plan, tmp_path / (fails or "whole"))
        run.start()
        if fails:
            with pytest.raises(EcologyError, match="watch of a failed"):
                run.live([Log("a", calls, fails)])
        else:
            run.live([Log("a", calls)])
        assert calls == ["begin a", *["watch a"] * ticks, "end a"]


def test_an_evaluation_begins_and_ends_nothing_twice(world, monkeypatch):
    """What is lived on in pieces calls neither `begin` nor `end` between them."""
    env, learners = world
    calls: list[str] = []
    monkeypatch.setattr(lives.LifeRecorder, "begin", lambda *_: calls.append("begin"))
    monkeypatch.setattr(lives.LifeRecorder, "end", lambda *_: calls.append("end"))
    lives.live(env, learners["agent"], env.reset_arrays(0), 3)
    assert calls == ["begin", "end"]


def test_an_observer_needs_only_what_it_does(world):
    """A class derived from Observer may define `watch` alone; `advance` calls nothing else of any observer."""

    class Count(Observer):
        ticks = 0

        def watch(self, state, tick, minds):
            self.ticks += 1

    env, learners = world
    count, calls = Count(), []
    tick = loop.run(env, learners, env.reset_arrays(0), 3, [count])
    loop.advance(env, learners, tick, 2, [count, Log("a", calls)])
    assert count.ticks == 5
    assert calls == ["watch a"] * 2


@pytest.mark.parametrize("observer", [lambda state, tick, minds: None, object(), Observer])
def test_what_is_no_observer_is_one_clear_error(world, observer):
    """Something without the three methods is refused before the first tick, with what to derive from."""
    env, learners = world
    tick = env.reset_arrays(0)
    with pytest.raises(EcologyError, match=r"observer.*ecology.observers.base.Observer"):
        loop.run(env, learners, tick, 1, [observer])
    assert env.state_view.tick == 0
