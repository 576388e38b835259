"""The compiled kernels, and torch on stacked weights, against the plain learner: equal scores, losses and weights."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from plain_learner import PlainAgent, as_row
from worlds import from_python

from ecology import Ecology, EcologyError, agents, scenarios
from ecology.agents import hjb, kernels, loop
from ecology.agents.device import Cpu, Device
from ecology.agents.hjb import ALGORITHM1, HJB
from ecology.agents.kernels import Senses
from ecology.agents.torch_device import Torch
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
    "beam": 16,
}
PRINTED = {**ALGORITHM1, "width": 16}
VARIANTS: dict[str, dict[str, Any]] = {
    "default": SMALL,
    "algorithm1": PRINTED,
    "algorithm1 from batches, with place cells": {**PRINTED, "replay": True, **SMALL},
    "algorithm1 that learns the value": {**PRINTED, "learn_value": True},
    "lazy heads": {**SMALL, "batch_f": 5, "lazy_heads": True},
    "algorithm1 with heads that move on": {**PRINTED, "lazy_heads": False},
    "without target network and weight": {**SMALL, "target_network": False, "relative_weight": False},
    "without the min": {**SMALL, "minimum_in_loss": False},
    "first-order score": {**SMALL, "finite_difference": False},
    "lean": {**hjb.LEAN, "place_cells": 8, "memory": 60},
    "nothing imagined": {**SMALL, "imagined": 0.0},
    "less optimistic": {**SMALL, "optimism": 0.4},
    "not optimistic": {**SMALL, "optimism": 0.0},
    "one movement ahead": {**SMALL, "depth": 1, "errors": 0},
    "one movement ahead, errors corrected": {**SMALL, "depth": 1},
    "two movements ahead, nothing corrected": {**SMALL, "depth": 2, "errors": 0},
    "a narrow beam": {**SMALL, "beam": 1},
    "J itself": {**SMALL, "learn_value": False},
    "a target that does not explore": {**SMALL, "target_explores": False},
}


def on_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let learners compute by torch, and let it raise where a tensor is taken for an array, as a GPU's would."""

    def refuse(*_: object) -> None:
        raise TypeError("a tensor on a device is no array")

    monkeypatch.setattr("ecology.agents.device.make", lambda _, senses, n: Torch("cpu", senses))
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


def learned(settings: dict[str, Any], n: int = 3) -> HJB:
    """Return n agents with random networks and memories of different lengths."""
    scenario = scenarios.load("paper")
    many = dataclasses.replace(scenario.species[0], count=n, position=None)
    group = Ecology(dataclasses.replace(scenario, species=(many,))).groups["agent"]
    learner = agents.make("hjb", group, np.random.SeedSequence(4), {"learning_rate": 3e-3, **settings})
    assert isinstance(learner, HJB)
    rng = np.random.default_rng(0)
    arrays, values = learner.state()
    arrays = {name: array.copy() for name, array in arrays.items()}
    for name, network in (("f", learner.f), ("J", learner.J)):
        arrays[name][:, -network.last :] = rng.normal(scale=0.3, size=(n, network.last))
    arrays["target"] = arrays["J"].copy()
    if learner.settings.target_network:
        arrays["target"] += rng.normal(scale=0.05, size=arrays["J"].shape)
    if learner.hopes:
        arrays["marked"] = rng.integers(1, 6, n)
        arrays["marks"][:, :2] = rng.uniform(0, 6, arrays["marks"][:, :2].shape)
        arrays["marks"][:, 2] = rng.uniform(0.1, 1.0, arrays["marks"][:, 2].shape)
    size = learner.settings.errors
    if size:
        arrays["trace.count"] = np.array([size + 3, 5, size])[np.arange(n) % 3]
        arrays["clock"] = np.full(n, 900)
        where = learner.senses.where
        arrays["trace.where"] = rng.uniform(
            *(edge[where] for edge in (group.layout.low, group.layout.high)), (n, size, len(where))
        ).astype(np.float32)
        arrays["trace.movement"] = rng.integers(0, learner.count, (n, size)).astype(np.int16)
        arrays["trace.error"] = rng.normal(scale=0.3, size=(n, size, learner.components + 1)).astype(np.float32)
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
            learner.memory.add(np.array([slot]), zeta, movement, after, rng.uniform(1, 20, 1), open_)
    learner._hope()
    return learner


def compare_updates(learner: HJB, updates: int = 6) -> None:
    """Update the learner and plain agents with the same random numbers; slot 1 pauses once."""
    plain = [PlainAgent(learner, slot) for slot in range(learner.size)]
    s = learner.settings
    b, bf = (s.batch, s.batch_f) if s.replay else (1, 1)
    m = round(s.imagined * b)
    before = learner.state()[0]["J"].copy()
    for k in range(updates):
        twin = np.random.default_rng()
        twin.bit_generator.state = learner.generator.bit_generator.state
        uniform = twin.random((learner.size, b + bf + m * learner.components + m + m // 2), np.float32)
        normal = twin.standard_normal((learner.size, m // 2, learner.components), np.float32)
        ready = np.array([True, k != 2, True])[: learner.size]
        learner._update(ready)
        for slot in np.flatnonzero(ready):
            losses = plain[slot].update(uniform[slot], normal[slot], float(learner.rate()[slot]))
            assert losses == pytest.approx((learner.loss_f[slot], learner.loss_j[slot]), rel=1e-3)
    after = learner.state()[0]
    for slot, agent in enumerate(plain):
        for name, network in (("f", agent.f), ("J", agent.J), ("target", agent.slow)):
            assert np.allclose(as_row(network), after[name][slot], atol=1e-4)
        assert np.abs(after["J"][slot] - before[slot]).max() > 4e-3  # it has learned something
    counts = np.array([updates, updates - 1, updates])[: learner.size, None]
    assert (after["adam_J.steps"] == counts).all()
    assert (after["adam_f.steps"][:, 0] == counts[:, 0]).all()
    assert (after["adam_f.steps"][:, 1:] < counts).any() == s.lazy_heads


@pytest.mark.parametrize("variant", VARIANTS)
def test_an_update_equals_the_plain_one(variant: str, computes: str) -> None:
    """After some updates of three agents, every weight is that of modules with automatic gradients, to 1e-4."""
    compare_updates(learned(VARIANTS[variant]))


@pytest.mark.parametrize("exponent", [1.0, 2.0, 3.0])
def test_an_update_with_felt_components_equals_the_plain_one(exponent: float, monkeypatch, computes: str) -> None:
    """The same where the drive has another exponent, weights and components felt, added to needs or to itself."""
    plain_terms = hjb.drive_terms

    def terms(layout):
        mix, felt, _ = plain_terms(layout)
        mix[0, 0], mix[6, 1], felt[7] = 0.7, 1.0, 0.2
        return mix, felt, exponent

    monkeypatch.setattr("ecology.agents.hjb.drive_terms", terms)
    monkeypatch.setattr("plain_learner.drive_terms", terms)
    compare_updates(learned(SMALL))


@pytest.mark.parametrize("name", ["algorithm1", "hjb"])
def test_what_an_update_scores_ahead_is_what_is_decided_on(name: str, computes: str) -> None:
    """Scores from the pass of an update are those of a decision on the same state, and decisions use them."""
    env = Ecology(scenarios.load("predator_prey"))
    settings = (
        {**SMALL, "update_every": 2.0, "persistence": 1, "depth": 1, "errors": 0, "warm_up": 4, "tries": 0}
        if name == "hjb"
        else PRINTED
    )
    group = env.groups["prey"]
    learner = agents.make(name, group, np.random.SeedSequence(1), settings)
    others = agents.make("random", env.groups["predator"], np.random.SeedSequence(2), {})
    tick, ahead, asked = env.reset_arrays(seed=1), learner.ahead, 0
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
                learner.movement[decided], learner.moves.open(tick.masks["prey"])[decided].argmax(axis=1)
            )
            assert not ahead.open.any()
            asked += decided.size
    assert asked > 20


@pytest.mark.parametrize("variant", VARIANTS)
def test_scores_equal_the_plain_ones(variant: str, computes: str) -> None:
    """The score of every open movement is the plain one, infinity where it is closed; slopes and f too."""
    learner = learned(VARIANTS[variant])
    rng = np.random.default_rng(1)
    layout = learner.group.layout
    zeta = rng.uniform(layout.low, layout.high, (3, learner.components)).astype(np.float32)
    open_ = rng.random((3, learner.count)) < 0.5
    score = learner.scores(np.array([2, 0, 1]), zeta, open_)
    far = learner.settings.depth > 1 or learner.settings.errors > 0
    for row, slot in enumerate((2, 0, 1)):
        plain = PlainAgent(learner, slot)
        at = torch.from_numpy(zeta[row : row + 1])
        if far:
            with torch.no_grad():
                expected = plain.look_ahead(at[0], open_[row])
        else:
            expected = plain.scores(at, plain.slow).detach().numpy()[0]
        assert np.isinf(score[row][~open_[row]]).all()
        assert score[row][open_[row]] == pytest.approx(expected[open_[row]], rel=1e-3, abs=1e-4)
        slope = plain.slope(at, plain.slow).detach().numpy()
        assert learner.slope(slot, zeta[row : row + 1]) == pytest.approx(slope, rel=1e-3, abs=1e-4)
        change, duration = plain.changes(at)
        found = learner.predict(slot, zeta[row : row + 1])
        assert found["change"] == pytest.approx(change.detach().numpy(), rel=1e-3, abs=1e-5)
        assert found["duration"] == pytest.approx(duration.detach().numpy(), rel=1e-3)
        told = learner.weigh(slot, zeta[row], np.ones(len(learner.group.actions), bool))
        if far:
            with torch.no_grad():
                expected = plain.look_ahead(at[0], np.ones(learner.count, bool))
        assert told.score == pytest.approx(expected, rel=1e-3, abs=1e-4)


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
        monkeypatch.setattr("ecology.agents.device.WORKERS", workers)
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


@pytest.mark.skipif(not kernels.X86, reason="other processors take subnormal numbers at full speed")
def test_no_moment_becomes_subnormal() -> None:
    """Moments without a gradient end at zero, not at numbers for which the processor slows down; only kernels do so.

    Weights that nothing trains are many: heads of actions seldom taken, units that are never on.
    """
    least = np.finfo(np.float32).tiny
    learner = learned({**PRINTED, "lazy_heads": False})
    for network in (learner.f, learner.J):
        network.first[:] = network.second[:] = 2 * least
    learner._update(np.ones(3, bool))
    learner.scores(np.arange(3), learner.began, learner.was_open)
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
    exp32 = from_python(kernels.exp32)
    found = np.array([exp32(v) for v in x])
    assert np.abs(found / np.exp(x.astype(float)) - 1).max() < 3e-7


def test_memory_draws_the_share_from_the_newest() -> None:
    """The last part of a batch lies among the newest decisions, the first anywhere in life; the ring wraps."""
    uniform, at = np.random.default_rng(0).random(1000, np.float32), np.empty(1000, np.int64)
    positions = from_python(kernels.positions)
    positions(250, 100, uniform, 400, 10, at)
    age = (249 - at) % 100  # 0: the newest
    assert age.max() == 99
    assert age[600:].max() == 9
    assert len(np.unique(age[600:])) == 10
    assert age[:600].max() > 90
    positions(250, 1, uniform, 400, 10, at)
    assert not at.any()


def test_a_fork_and_an_evaluation_compute_where_they_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--device` of fork and evaluate is where their learners are, and what they write says so; the CPU by default."""
    asked: list[str] = []

    def make(name: str, senses: Senses, n: int) -> Device:
        asked.append(name)
        return Cpu(senses, n)

    monkeypatch.setattr("ecology.agents.device.make", make)
    monkeypatch.setattr("ecology.agents.evaluation.BASELINES", ())
    monkeypatch.setattr("ecology.agents.evaluation.horizon", lambda *_: 10)
    monkeypatch.setattr("ecology.agents.evaluation.LONGEST", 10)
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
