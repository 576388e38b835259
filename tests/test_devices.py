"""The compiled kernels, and torch on stacked weights, against the plain device: equal scores, losses and weights."""

from __future__ import annotations

import ast
import dataclasses
import functools
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from worlds import from_python

from ecology import Ecology, EcologyError, agents, scenarios
from ecology.agents import hjb, loop
from ecology.agents.base import drive_terms
from ecology.agents.hjb import ALGORITHM1, HJB, devices
from ecology.agents.hjb.devices import Device
from ecology.agents.hjb.devices.cpu.arithmetic import exp32
from ecology.agents.hjb.devices.cpu.device import Cpu
from ecology.agents.hjb.devices.cpu.learning import positions
from ecology.agents.hjb.devices.cpu.llvm import X86
from ecology.agents.hjb.devices.plain.device import Plain
from ecology.agents.hjb.devices.records import Encoding
from ecology.agents.hjb.devices.torch.device import Torch
from ecology.agents.hjb.plan import best_plan
from ecology.lab.cli import main
from ecology.lab.runs.folder import CONFIG
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import resolve

SMALL = {
    "width": 16,
    "batch": 12,
    "batch_f": 20,
    "place_cells": 8,
    "memory": 60,
    "recent": 20,
    "errors": 12,
    "beam": 6,
}
PRINTED = {**ALGORITHM1, "width": 16}
VARIANTS: dict[str, dict[str, Any]] = {
    "default": SMALL,
    "algorithm1": PRINTED,
    "algorithm1 from batches, with place cells": {**PRINTED, "replay": True, **SMALL},
    "algorithm1 that learns the value": {**PRINTED, "learn_value": True},
    "lazy heads": {**SMALL, "batch_f": 5, "lazy_heads": True},
    "algorithm1 with heads that move on": {**PRINTED, "lazy_heads": False},
    "without target network and weight": {**SMALL, "target_network": False, "relative_weight": 0},
    "without the min": {**SMALL, "minimum_in_loss": False},
    "first-order score": {**SMALL, "finite_difference": False},
    "lean": {**hjb.LEAN, "place_cells": 8, "memory": 60},
    "nothing imagined": {**SMALL, "imagined": 0.0, "imagined_f": 0.0},
    "f imagined more than J": {**SMALL, "imagined_f": 0.7},
    "less optimistic": {**SMALL, "optimism": 0.4},
    "not optimistic": {**SMALL, "optimism": 0.0},
    "one movement ahead": {**SMALL, "depth": 1, "errors": 0},
    "one movement ahead, errors corrected": {**SMALL, "depth": 1},
    "two movements ahead, nothing corrected": {**SMALL, "depth": 2, "errors": 0},
    "a narrow beam": {**SMALL, "beam": 1},
    "J itself": {**SMALL, "learn_value": False},
    "a target that does not explore": {**SMALL, "target_explores": False},
    "the drive on the way": {**SMALL, "option_cost": True},
    "the drive on the way, one movement ahead": {**SMALL, "option_cost": True, "depth": 1, "errors": 0},
}
UPDATES = 6


def on_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let learners compute by torch, and let it raise where a tensor is taken for an array, as a GPU's would."""

    def refuse(*_: object) -> None:
        raise TypeError("a tensor on a device is no array")

    make = devices.make
    monkeypatch.setattr(devices, "make", lambda name, e, n: make(name, e, n) if name == "plain" else Torch(e, "cpu"))
    monkeypatch.setattr(torch.Tensor, "__array__", refuse)


@pytest.fixture(params=["kernels", "torch"])
def computes(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Let learners compute by kernels, and then by torch; its device is the CPU, but shares nothing with NumPy.

    For both, random numbers are those of the learner's own generator.
    """
    if request.param == "torch":
        on_torch(monkeypatch)
        monkeypatch.setattr(Torch, "uniform", lambda self, g, shape: self.on(g.random(shape, np.float32)))
        monkeypatch.setattr(Torch, "normal", lambda self, g, shape: self.on(g.standard_normal(shape, np.float32)))
    return request.param


def learned(settings: dict[str, Any], n: int = 3, device: str = "cpu") -> HJB:
    """Return n agents with random networks and memories of different lengths."""
    scenario = scenarios.load("paper")
    many = dataclasses.replace(scenario.species[0], count=n, position=None)
    group = Ecology(dataclasses.replace(scenario, species=(many,))).groups["agent"]
    learner = agents.make("hjb", group, np.random.SeedSequence(4), {"learning_rate": 3e-3, **settings}, device)
    assert isinstance(learner, HJB)
    rng = np.random.default_rng(0)
    arrays, values = learner.state()
    arrays = {name: array.copy() for name, array in arrays.items()}
    for name, network in (("f", learner.f), ("J", learner.J)):
        arrays[name][:, -network.last :] = rng.normal(scale=0.3, size=(n, network.last))
    arrays["target"] = arrays["J"].copy()
    if learner.settings.target_network:
        arrays["target"] += rng.normal(scale=0.05, size=arrays["J"].shape)
    if learner.curious:
        arrays["marked"] = rng.integers(1, 6, n)
        arrays["marks"][:, :2] = rng.uniform(0, 6, arrays["marks"][:, :2].shape)
        arrays["marks"][:, 2] = rng.uniform(0.1, 1.0, arrays["marks"][:, 2].shape)
    size = learner.settings.errors
    if size:
        arrays["trace.count"] = np.array([size + 3, 5, size])[np.arange(n) % 3]
        arrays["clock"] = np.full(n, 900)
        where = learner.encoding.where
        arrays["trace.where"] = rng.uniform(
            *(edge[where] for edge in (group.layout.low, group.layout.high)), (n, size, len(where))
        ).astype(np.float32)
        arrays["trace.movement"] = rng.integers(0, learner.count, (n, size)).astype(np.int16)
        arrays["trace.error"] = rng.normal(scale=0.3, size=(n, size, learner.encoding.outputs)).astype(np.float32)
        arrays["trace.possible"] = rng.random((n, size, learner.count)) < 0.6
        arrays["trace.time"] = rng.uniform(0, 900, (n, size)).astype(np.float32)
    if learner.cells:
        arrays["cell_count"] = rng.integers(1, learner.cells + 1, n)
        arrays["cell_centre"] = rng.uniform(0, 6, arrays["cell_centre"].shape).astype(np.float32)
    learner.restore(arrays, values)
    low, high = group.layout.low, group.layout.high
    for slot in range(n):
        for _ in range(30 + 40 * slot):
            zeta, after = (rng.uniform(low, high)[None].astype(np.float32) for _ in range(2))
            movement = rng.integers(-1, learner.count, 1)
            open_ = rng.random((1, learner.count)) < 0.5
            open_[0, max(movement[0], 0)] = True
            lasts = rng.uniform(1, 20, 1)
            excess = rng.normal(scale=0.3, size=1) if learner.encoding.costed else None
            learner.memory.add(np.array([slot]), zeta, movement, after, lasts, open_, excess)
    learner._set_optimism()
    return learner


def update(learner: HJB) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Update three agents, slot 1 pausing once; yield the two losses of those that were updated."""
    for k in range(UPDATES):
        ready = np.array([True, k != 2, True])
        learner._update(ready)
        yield learner.loss_f[ready], learner.loss_j[ready]


@functools.cache
def plain_updates(variant: str) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray, dict[str, np.ndarray]]:
    """Return the losses on the plain device, and its J before and its arrays after the updates."""
    plain = learned(VARIANTS[variant], device="plain")
    assert isinstance(plain.device, Plain)
    before = plain.J.weights.copy()
    return list(update(plain)), before, plain.state()[0]


def compare_updates(variant: str) -> None:
    """Update agents here and on the plain device with the same random numbers."""
    learner = learned(VARIANTS[variant])
    assert not isinstance(learner.device, Plain)
    losses, before, expected = plain_updates(variant)
    for found, wanted in zip(update(learner), losses, strict=True):
        for one, other in zip(found, wanted, strict=True):
            assert one == pytest.approx(other, rel=1e-3)
    after = learner.state()[0]
    for name in ("f", "J", "target"):
        # Adam's first step has the size of the learning rate also where a gradient cancels to rounding errors
        gap = np.abs(expected[name] - after[name])
        assert np.mean(gap > 1e-4) < 1e-3
        assert gap.max() < learner.settings.learning_rate / 10
    assert (np.abs(after["J"] - before).max(axis=1) > 4e-3).all()  # each has learned something
    counts = np.array([UPDATES, UPDATES - 1, UPDATES])[:, None]
    assert (after["adam_J.steps"] == counts).all()
    assert (after["adam_f.steps"][:, 0] == counts[:, 0]).all()
    assert (after["adam_f.steps"][:, 1:] < counts).any() == learner.settings.lazy_heads
    for name in ("adam_f.steps", "adam_J.steps"):
        assert np.array_equal(after[name], expected[name])


@pytest.mark.parametrize("variant", VARIANTS)
def test_an_update_equals_the_plain_one(variant: str, computes: str) -> None:
    """After some updates of three agents, the weights are those of modules with automatic gradients, to 1e-4."""
    compare_updates(variant)


@pytest.mark.parametrize("exponent", [1.0, 2.0, 3.0])
def test_an_update_with_felt_components_equals_the_plain_one(exponent: float, monkeypatch, computes: str) -> None:
    """The same where the drive has another exponent, weights and components felt, added to needs or to itself."""
    plain_terms = drive_terms

    def terms(layout):
        mix, felt, _ = plain_terms(layout)
        mix[0, 0], mix[6, 1], felt[7] = 0.7, 1.0, 0.2
        return mix, felt, exponent

    monkeypatch.setattr("ecology.agents.hjb.encoding.drive_terms", terms)
    plain_updates.cache_clear()  # it knows nothing of these terms
    compare_updates("default")
    plain_updates.cache_clear()


@pytest.mark.parametrize("name", ["algorithm1", "hjb"])
def test_what_an_update_scores_ahead_is_what_is_decided_on(name: str, computes: str) -> None:
    """Scores from the pass of an update are those of a decision on the same state, and decisions use them."""
    env = Ecology(scenarios.load("predator_prey"))
    rare = {"update_every": 2.0, "persistence": 1, "depth": 1, "errors": 0, "warm_up": 4, "tries": 0, "reluctance": 0.0}
    settings = {**SMALL, **rare} if name == "hjb" else PRINTED
    group = env.groups["prey"]
    learner = agents.make(name, group, np.random.SeedSequence(1), settings)
    others = agents.make("random", env.groups["predator"], np.random.SeedSequence(2), {})
    tick, ahead, asked = env.reset_arrays(seed=1), learner.lookahead, 0
    for _ in range(60):
        tick = loop.run(env, {"prey": learner, "predator": others}, tick, 1)
        rows = np.flatnonzero(ahead.open.any(axis=1) & tick.alive[group.slots])
        zeta, mask = tick.observations["prey"][rows], tick.masks["prey"][rows]
        assert np.array_equal(ahead.zeta[rows], zeta)
        assert np.array_equal(ahead.open[rows], learner.moves.open(mask))
        if rows.size:
            found = learner.scores(rows, zeta, ahead.open[rows])
            np.testing.assert_allclose(ahead.score[rows], found, rtol=1e-5, atol=1e-6)
            ahead.score[rows] = np.where(ahead.open[rows], 1.0, np.inf)  # all alike: the first that is open is taken
            ahead.score[rows, ahead.open[rows].argmax(axis=1)] = 0.0
            learner.exploration = 0.0
            before = learner.decisions.copy()
            learner.act(tick.observations["prey"], tick.masks["prey"])
            decided = rows[learner.decisions[rows] > before[rows]]
            assert np.array_equal(
                learner.execution.movement[decided], learner.moves.open(tick.masks["prey"])[decided].argmax(axis=1)
            )
            assert not ahead.open.any()
            asked += decided.size
    assert asked > 20


def test_the_plan_that_is_shown_is_the_lookaheads_best() -> None:
    """Its score is the least of the scores that the agent compares, and it begins with the movement that has it."""
    learner = learned({})
    layout, rng = learner.group.layout, np.random.default_rng(3)
    for slot in range(3):
        zeta = rng.uniform(layout.low, layout.high).astype(np.float32)
        open_ = rng.random(learner.count) < 0.5
        score = learner.scores(np.array([slot]), zeta[None], open_[None])[0]
        plan = best_plan(learner, slot, zeta, open_)
        assert plan is not None
        assert plan.score == pytest.approx(score.min(), rel=1e-3)
        assert plan.options[0] == learner.moves.names[int(score.argmin())]
        assert plan.states.shape == (len(plan.options) + 1, learner.components)
        assert len(plan.options) == learner.settings.depth
    learner.memory.count[:] = 0  # at the first decision nothing is remembered
    assert best_plan(learner, 0, zeta, open_) is not None


def answers(learner: HJB) -> dict[str, np.ndarray]:
    """Return what a learner with random networks says of three states, by question."""
    rng = np.random.default_rng(1)
    layout = learner.group.layout
    zeta = rng.uniform(layout.low, layout.high, (3, learner.components)).astype(np.float32)
    open_ = rng.random((3, learner.count)) < 0.5
    slots = np.array([2, 0, 1])
    score = learner.scores(slots, zeta, open_)
    assert np.isinf(score[~open_]).all()
    movement = np.array([0, learner.count - 1, 1])
    found = {"scores": score[open_], "expected": learner.device.expect(learner.weights, slots, zeta, movement)}
    for row, slot in enumerate(slots.tolist()):
        at = zeta[row : row + 1]
        predicted = learner.predict(slot, at)
        found[f"deviation {slot}"], found[f"slope {slot}"] = learner.deviation(slot, at), learner.slope(slot, at)
        found[f"change {slot}"], found[f"duration {slot}"] = predicted["change"], predicted["duration"]
    found["weighed"] = learner.weigh(1, zeta[2], np.ones(len(learner.group.actions), bool)).score
    return found


@functools.cache
def plain_answers(variant: str) -> dict[str, np.ndarray]:
    """Return the answers of the plain device."""
    return answers(learned(VARIANTS[variant], device="plain"))


@pytest.mark.parametrize("variant", VARIANTS)
def test_scores_equal_the_plain_ones(variant: str, computes: str) -> None:
    """The score of every open movement is the plain one, infinity where it is closed; slopes and f too."""
    expected = plain_answers(variant)
    finer = {"expected": 1e-5, "change": 1e-5, "duration": 1e-12}  # than the 1e-4 of scores and J
    for question, found in answers(learned(VARIANTS[variant])).items():
        bound = finer.get(question.split()[0], 1e-4)
        assert found == pytest.approx(expected[question], rel=1e-3, abs=bound), question


CHAPTERS = ("encoding", "networks", "first_order", "scores", "lookahead", "learning", "adam", "update")


def functions(device: str, chapter: str) -> list[str]:
    """Return the functions of a chapter of a device, in order."""
    source = Path(devices.__file__).parent / device / f"{chapter}.py"
    return [node.name for node in ast.parse(source.read_text()).body if isinstance(node, ast.FunctionDef)]


@pytest.mark.parametrize("chapter", CHAPTERS)
def test_devices_are_one_book(chapter: str) -> None:
    """Chapters and functions have the same names in the same order; the kernels add what gradients by hand need."""
    plain, on_torch, kernels = (functions(device, chapter) for device in ("plain", "torch", "cpu"))
    shared = [name for name in plain if name in kernels]
    assert [name for name in kernels if name in shared] == shared
    assert [name for name in on_torch if name in shared] == shared
    assert len(shared) >= {"encoding": 2, "adam": 1}.get(chapter, 4)
    assert set(plain) <= set(on_torch)
    folders = [Path(devices.__file__).parent / device for device in ("plain", "torch", "cpu")]
    only_kernels = {"llvm", "arithmetic", "compiler"}
    for folder in folders:
        assert {path.stem for path in folder.glob("[!_]*.py")} - only_kernels == {*CHAPTERS, "device"}


def test_the_encoding_is_that_of_the_layout() -> None:
    """Units, bounds and the drive of total deprivation follow from the layout of the senses alone."""
    learner = learned(SMALL)
    layout, s, found = learner.group.layout, learner.settings, learner.encoding
    kinds = np.array(layout.kinds)
    need, angle, placed = kinds == "deviation", kinds == "angle", kinds == "position"
    unit = np.where(need | (kinds == "felt"), 0.1, 0.5) * layout.scale
    unit[angle] = 1.0
    assert found.unit == pytest.approx([*unit, s.stride])
    assert found.low[~angle] == pytest.approx(np.maximum(layout.low, -1e30)[~angle])
    assert found.high[~angle] == pytest.approx(np.minimum(layout.high, 1e30)[~angle])
    assert (found.high[angle] == 1e30).all()
    assert found.centre == pytest.approx(np.where(placed, (layout.low + layout.high) / 2, 0))
    worst = np.sqrt((layout.scale[need & layout.regulated & (layout.low < 0)] ** 2).sum())
    assert (found.centre_j, found.spread_j) == pytest.approx((0.45 * worst, 0.55 * worst))
    assert found.sharp == pytest.approx(1 / s.place_width**2)


@pytest.mark.parametrize("rows", [2, 40, 3_000])
def test_many_states_at_once_are_as_one_by_one(rows: int, computes: str) -> None:
    """J, its slope and f at any number of states are those at each of them alone; memory in use is not given away."""
    learner = learned(SMALL)
    layout = learner.group.layout
    zeta = np.random.default_rng(1).uniform(layout.low, layout.high, (rows, learner.components)).astype(np.float32)
    some = [0, rows // 2, rows - 1]
    for ask in (learner.deviation, learner.slope, lambda slot, at: learner.predict(slot, at)["change"]):
        together = ask(1, zeta)
        assert len(together) == rows
        for row in some:
            assert together[row] == pytest.approx(ask(1, zeta[row : row + 1])[0], rel=1e-3, abs=1e-4)


def test_a_life_on_another_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """A learner on torch lives, gives birth, is stopped, goes on the same, and goes on by kernels as well."""
    scenario = scenarios.load("paper", ticks=400)
    many = dataclasses.replace(scenario.species[0], count=4, position=None)
    env = Ecology(dataclasses.replace(scenario, species=(many,)))
    words = {**SMALL, "update_every": 4.0, "inherit": True, "mutation": 0.1, "epsilon": 0.2}

    def make() -> HJB:
        learner = agents.make("hjb", env.groups["agent"], np.random.SeedSequence(4), words)
        assert isinstance(learner, HJB)
        return learner

    by_kernels = make()
    on_torch(monkeypatch)
    learner, twin = make(), make()
    for name, array in learner.state()[0].items():
        assert np.array_equal(array, by_kernels.state()[0][name], equal_nan=True), name
    tick = loop.run(env, {"agent": learner}, env.reset_arrays(0), 300)
    learner.died(np.array([0, 1]))
    learner.born(np.array([0, 1]), np.array([-1, 2]))
    assert (learner.state()[0]["cell_count"] > 0).tolist() == [False, True, True, True]
    layout = env.groups["agent"].layout
    told = learner.weigh(2, tick.observations["agent"][2], tick.masks["agent"][2])
    assert np.isfinite(told.score).all()
    assert np.isfinite(told.error[np.array(layout.kinds) == "deviation"]).any()
    here, (arrays, values) = env.snapshot(), learner.state()
    arrays = {name: array.copy() for name, array in arrays.items()}
    for other in (twin, by_kernels):
        other.restore(arrays, values)
    ends = {}
    for name, each in (("on", learner), ("again", twin), ("kernels", by_kernels)):
        env.restore(*here)
        loop.run(env, {"agent": each}, tick, 100)
        ends[name] = each.state()[0]
    for name, array in ends["on"].items():
        assert np.array_equal(array, ends["again"][name], equal_nan=True), name
        assert array.dtype == ends["kernels"][name].dtype
        assert array.shape == ends["kernels"][name].shape
    assert (ends["kernels"]["adam_J.steps"][2:] > arrays["adam_J.steps"][2:]).all()
    assert np.isfinite(ends["kernels"]["loss_j"][2:]).all()


def test_a_run_of_a_device_that_is_not_here_goes_on_elsewhere(tmp_path: Path) -> None:
    """A run whose device is missing is refused with what is there; told another device, it is restored and goes on."""
    out = tmp_path / "run"
    choice = {"learners": ["hjb"], "changes": {"learner.width": 4, "learner.memory": 50}}
    it = Run(resolve("paper", ticks=20, record=False, **choice), out)
    it.start()
    it.live()
    config = out / CONFIG
    config.write_text(config.read_text().replace('device = "cpu"', 'device = "cuda:99"'))
    with pytest.raises(EcologyError, match="no device 'cuda:99' here; there is cpu"):
        open_run(out, 30)
    again = open_run(out, 30, "cpu")
    again.resume()
    assert again.live()["ticks"] == 30
    assert 'device = "cpu"' in config.read_text()


def test_threads_make_no_difference(monkeypatch) -> None:
    """Twenty agents updated by one thread and by four are bit for bit the same."""
    found = []
    for workers in (1, 4):
        monkeypatch.setattr("ecology.agents.hjb.devices.cpu.device.WORKERS", workers)
        learner = learned(SMALL, n=20)
        assert isinstance(learner.device, Cpu)
        assert (learner.device.threads is None) == (workers == 1)
        for _ in range(3):
            learner._update(np.ones(20, bool))
        found.append((learner.f.weights, learner.J.weights, learner.loss_j))
    for one, four in zip(*found, strict=True):
        assert np.array_equal(one, four)


def test_agents_do_not_depend_on_each_other() -> None:
    """An update of one agent leaves all of the others as it was, and what it comes to is the same without them."""
    together, alone = learned(SMALL), learned(SMALL)
    before = together.f.weights.copy(), together.J.weights.copy(), together.f.second.copy()
    together._update(np.array([True, True, True]))
    alone._update(np.array([False, True, False]))
    for i, (one, all_) in enumerate(((alone.f, together.f), (alone.J, together.J))):
        assert np.array_equal(one.weights[1], all_.weights[1])
        assert np.array_equal(one.weights[[0, 2]], before[i][[0, 2]])
        assert one.steps[:, 0].tolist() == [0, 1, 0]
    assert np.isnan(alone.loss_f[[0, 2]]).all()


@pytest.mark.skipif(not X86, reason="other processors take subnormal numbers at full speed")
def test_no_moment_becomes_subnormal() -> None:
    """Moments without a gradient end at zero, not at numbers for which the processor slows down; only kernels do so.

    Weights that nothing trains are many: heads of actions seldom taken, units that are never on.
    """
    least = np.finfo(np.float32).tiny
    learner = learned({**PRINTED, "lazy_heads": False})
    for network in (learner.f, learner.J):
        network.first[:] = network.second[:] = 2 * least
    learner._update(np.ones(3, bool))
    learner.scores(np.arange(3), learner.execution.began, learner.execution.was_open)
    for _ in range(8):
        learner._update(np.ones(3, bool))
    for network in (learner.f, learner.J):
        for moments in (network.first, network.second):
            assert not ((moments != 0) & (np.abs(moments) < least)).any()
    assert (learner.f.first == 0).mean() > 0.5
    assert (np.array([least / 4], np.float32) * np.float32(2)).item() == least / 2  # here it counts as before


def test_exp_is_exact_to_float32() -> None:
    """e^x of the kernels is within 3e-7 of e^x, relatively, from -80 to 80."""
    x = np.linspace(-80, 80, 4001, dtype=np.float32)
    exponential = from_python(exp32)
    found = np.array([exponential(v) for v in x])
    assert np.abs(found / np.exp(x.astype(float)) - 1).max() < 3e-7


def test_memory_draws_the_share_from_the_newest() -> None:
    """The last part of a batch lies among the newest decisions, the first anywhere in life; the ring wraps."""
    uniform, at = np.random.default_rng(0).random(1000, np.float32), np.empty(1000, np.int64)
    draw = from_python(positions)
    draw(250, 100, uniform, 400, 10, at)
    age = (249 - at) % 100  # 0: the newest
    assert age.max() == 99
    assert age[600:].max() == 9
    assert len(np.unique(age[600:])) == 10
    assert age[:600].max() > 90
    draw(250, 1, uniform, 400, 10, at)
    assert not at.any()


def test_a_fork_and_an_evaluation_compute_where_they_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], quick_evaluation: None
) -> None:
    """`--device` of fork and evaluate is where their learners are, and what they write says so; the CPU by default."""
    asked: list[str] = []
    monkeypatch.setattr("ecology.agents.figures.draw_evaluation", lambda *_: [])

    def make(name: str, encoding: Encoding, n: int) -> Device:
        asked.append(name)
        return Cpu(encoding, n)

    monkeypatch.setattr(devices, "make", make)
    monkeypatch.chdir(tmp_path)
    small = ("--set", "learner.width=4", "--set", "learner.memory=50", "--set", "learner.batch=4")

    def type_(*words: str) -> str:
        asked.clear()
        with pytest.raises(SystemExit) as left:
            main(words)
        assert left.value.code in (0, None)
        return capsys.readouterr().out

    type_("run", "shifted", "--learner", "hjb", *small, "--ticks", "60", "--no-record", "--quiet", "--out", "run")
    type_("fork", "run", "--at", "30", "--device", "cuda", "--out", "other", "--quiet")
    assert asked == ["cuda", "cuda"]  # of the past that is lived again, and of the fork
    assert 'device = "cuda"' in Path("other/config.toml").read_text()
    type_("fork", "other", "--at", "40", "--out", "again", "--quiet")
    assert set(asked) == {"cuda"}  # as the run
    assert "on cpu" in type_("evaluate", "other", "--ticks", "30", "--places", "1")
    assert set(asked) == {"cpu"}
    assert json.loads(Path("other/evaluation.json").read_text())["device"] == "cpu"
    words = ("evaluate", "other", "--ticks", "30", "--places", "1", "--device", "cuda")
    assert "on cuda" in type_(*words, "--again")
    assert asked[0] == "cuda"
    assert json.loads(Path("other/evaluation.json").read_text())["device"] == "cuda"
