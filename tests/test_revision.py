"""Memories that the world contradicts, and movements that open on the way."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from ecology import Ecology, agents, scenarios
from ecology.agents.hjb import HJB
from ecology.agents.hjb.devices import make
from ecology.agents.hjb.memory import Memory
from ecology.agents.hjb.revision import Revision, surrounded

PLACE, OTHER, SLOTS = np.array([1, 2]), np.array([4.0, 0.0]), np.array([0])
REST, MEAL, DRINK = range(3)
RING = [(0.3 * np.cos(a), 0.3 * np.sin(a)) for a in np.arange(12) * np.pi / 6]
MIDDLE = [(0.05, 0.0), (-0.05, 0.05), (0.0, -0.05), (0.02, 0.02)]


def paper_learner(**settings: Any) -> tuple[Ecology, HJB]:
    """Return a world and its learner, small."""
    env = Ecology(scenarios.load("paper"))
    few = {"width": 16, "batch": 16, "batch_f": 16, "memory": 400, **settings}
    learner = agents.make("hjb", env.groups["agent"], np.random.SeedSequence(3), few)
    assert isinstance(learner, HJB)
    return env, learner


@pytest.fixture(params=["cpu", "plain", "torch"])
def mind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> tuple[Memory, Revision]:
    """Return an empty memory of (need, x, y) and three movements on each device, and what corrects its meals."""
    encoding = paper_learner()[1].encoding
    device = make(request.param, encoding, 1) if request.param != "torch" else torch_device(encoding)
    memory = Memory(1, 64, 3, 3, device)
    return memory, Revision(memory, np.array([False, True, True]), PLACE, 1.0, 5)


def torch_device(encoding: Any) -> Any:
    """Return torch's own CPU device, which stands for a GPU."""
    from ecology.agents.hjb.devices.torch.device import Torch

    return Torch(encoding, "cpu")


def remember(memory: Memory, places: Iterable[Any], open_: list[bool], movement: int = REST) -> None:
    """Store a decision at each of `places`."""
    for x, y in places:
        zeta = np.array([[0.0, x, y]], np.float32)
        memory.add(SLOTS, zeta, np.array([movement]), zeta, np.ones(1), np.array([open_]))


def revise(mind: tuple[Memory, Revision], at: Any, open_: list[bool], times: int = 1) -> list[tuple[int, int]]:
    """Decide `times` at `at` with what is open there; return what is nowhere open any more."""
    lost = []
    for _ in range(times):
        remember(mind[0], [at], open_)
        zeta = np.array([[0.0, *at]], np.float32)
        lost += mind[1].revise(SLOTS, zeta, np.array([open_]))
    return lost


def meals(memory: Memory) -> np.ndarray:
    """Return in which memories a meal is open, oldest first."""
    return memory.device.off(memory.open)[0, : int(memory.count[0]), MEAL]


EVERY, NO_MEAL, ASLEEP = [True, True, True], [True, False, True], [True, False, False]


def test_a_food_that_has_gone_is_no_longer_remembered(mind: tuple[Memory, Revision]) -> None:
    """Five decisions in the middle of the place without a meal, and no memory says that one can be had there."""
    memory, _ = mind
    remember(memory, [*RING, *MIDDLE], EVERY)
    assert revise(mind, (0.01, 0.0), NO_MEAL, times=4) == []
    assert meals(memory).sum() == 16
    assert revise(mind, (0.01, 0.0), NO_MEAL) == [(0, MEAL)]
    assert not meals(memory).any()
    assert memory.device.off(memory.open)[0, :21, DRINK].all()  # what is open as before is remembered as before


def test_the_same_food_elsewhere_is_still_remembered(mind: tuple[Memory, Revision]) -> None:
    """Memories beyond the reach stay, and nothing is lost while they do."""
    memory, _ = mind
    remember(memory, [OTHER], EVERY)
    remember(memory, [*RING, *MIDDLE], EVERY)
    assert revise(mind, (0.01, 0.0), NO_MEAL, times=8) == []
    assert meals(memory).sum() == 1


def test_the_rim_of_a_place_is_no_reason_for_doubt(mind: tuple[Memory, Revision]) -> None:
    """Beside a food, where most memories are of meals but all on one side, a closed meal contradicts nothing."""
    memory, _ = mind
    remember(memory, [*RING, *MIDDLE, (0.29, 0.02), (0.29, -0.02)], EVERY)
    assert revise(mind, (0.31, 0.0), NO_MEAL, times=10) == []
    assert meals(memory).sum() == 18


@pytest.mark.parametrize(("open_", "why"), [(ASLEEP, "asleep"), (EVERY, "the meal is there")], ids=["asleep", "there"])
def test_nothing_is_doubted_where_nothing_is_missed(mind: tuple[Memory, Revision], open_: list[bool], why: str) -> None:
    """One open movement alone, as in sleep, says nothing of the place; a meal that is open is no surprise."""
    memory, _ = mind
    remember(memory, [*RING, *MIDDLE], EVERY)
    assert revise(mind, (0.01, 0.0), open_, times=10) == [], why
    assert meals(memory)[:16].all(), why


def test_a_meal_in_between_ends_the_doubt(mind: tuple[Memory, Revision]) -> None:
    """Only the newest memories in a row count: a food that comes and goes stays a food."""
    memory, _ = mind
    remember(memory, [*RING, *MIDDLE], EVERY)
    for _ in range(4):
        assert revise(mind, (0.01, 0.0), NO_MEAL, times=4) == []
        revise(mind, (0.1, 0.0), EVERY)
    assert meals(memory)[:16].all()


def test_a_wrong_doubt_is_taken_back(mind: tuple[Memory, Revision]) -> None:
    """Once the meal is open again, the memories in which one was eaten are as they were; others are not invented."""
    memory, _ = mind
    remember(memory, RING, EVERY, movement=MEAL)
    remember(memory, MIDDLE, EVERY)
    remember(memory, [OTHER], NO_MEAL)
    revise(mind, (0.01, 0.0), NO_MEAL, times=5)
    assert not meals(memory).any()
    revise(mind, (0.2, 0.0), EVERY)
    kept = meals(memory)
    assert kept[:12].all()
    assert not kept[12:-1].any()


def test_points_all_around() -> None:
    """The origin is inside the hull of points all around it, not of points on one side, nor of two."""
    ring = np.array(RING)
    assert surrounded(*ring.T)
    assert not surrounded(*(ring + np.array([0.31, 0.0])).T)
    assert not surrounded(*ring[[0, 6]].T)
    assert surrounded(*np.vstack([ring, np.zeros((2, 2))]).T)
    assert surrounded(*(ring + np.array([0.25, 0.0])).T)


def test_memories_of_an_earlier_tenant_do_not_count(mind: tuple[Memory, Revision]) -> None:
    """A newborn whose food has gone knows no other place, whatever the one before it in its slot knew."""
    memory, _ = mind
    remember(memory, [OTHER] * 40, EVERY)
    memory.count[:] = 0
    remember(memory, [*RING, *MIDDLE], EVERY)
    assert revise(mind, (0.01, 0.0), NO_MEAL, times=5) == [(0, MEAL)]


def test_what_is_lost_is_searched_for() -> None:
    """An agent whose food has gone is as curious as at birth, and tries the food and what is in sight again."""
    env, learner = paper_learner(doubt=2)
    learner.tried[:] = 1
    learner.curiosity.level[:], learner.curiosity.marked[:] = 0.1, 7
    names = learner.moves.names
    here, eat = env.reset_arrays(0).observations["agent"], names.index("consume_food_1")
    around = np.repeat(here, 12, axis=0).astype(np.float32)
    around[:, learner.encoding.place] += np.array(RING)
    open_ = np.ones((1, learner.count), bool)
    for zeta in (*around, *here, *here):
        learner.memory.add(SLOTS, zeta[None], np.array([0]), zeta[None], np.ones(1), open_)
    open_[0, eat] = False
    for _ in range(2):
        learner.memory.add(SLOTS, here, np.array([0]), here, np.ones(1), open_)
    learner._revise(SLOTS, here, open_)
    again = {names[movement] for movement in np.flatnonzero(learner.tried[0] == 0)}
    assert again == {"consume_food_1"} | {name for name in names if name.startswith("go_to")}
    assert (learner.curiosity.level[0], learner.curiosity.marked[0]) == (1.0, 0)


@pytest.mark.parametrize("notice", [True, False])
def test_what_opens_on_the_way_for_the_first_time_is_noticed(notice: bool) -> None:
    """A walk ends where a movement opens that was never made; one that was made, or was open before, ends no walk."""
    env, learner = paper_learner(notice=notice)
    names, masks = learner.moves.names, np.ones((1, len(env.groups["agent"].actions)), bool)
    walk, eat = names.index("walk"), names.index("consume_food_1")
    zeta = env.reset_arrays(0).observations["agent"]
    for tried, before, ends in ((0, False, True), (1, False, False), (0, True, False)):
        learner.tried[:] = 1
        learner.tried[0, eat] = tried
        was_open = np.ones((1, learner.count), bool)
        was_open[0, eat] = before
        learner.execution.start(SLOTS, np.array([walk]), zeta, was_open)
        learner.act(zeta, masks)
        assert (learner.execution.elapsed[0] == 1 and learner.execution.was_open[0, eat]) == (
            before or (ends and notice)
        )
