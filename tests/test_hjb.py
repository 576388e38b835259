"""The f/J learner: its parts against plain versions, and what it learns against known answers."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

import agents
import scenarios
from agents import loop
from agents.base import DivergedError
from agents.hjb import ALGORITHM1, HJB
from agents.memory import Memory
from agents.movements import adaptive, single_ticks
from agents.networks import Adam, Perceptrons
from ecology import Arena, Ecology, EcologyError, Need, Resource, Scenario, Species, consume, move, rest

SEED = np.random.SeedSequence(3)
SMALL = {"width": 24, "batch": 32, "batch_f": 32, "place_cells": 16, "memory": 500}


def toy(**words: object) -> Scenario:
    """Return a room where food is within reach everywhere: one need, eat or rest, nothing else to sense."""
    need = Need(name="energy", set_point=2.0, decay=0.02, bounds=(0.0, 4.0))
    species = Species(
        name="eater",
        needs=(need,),
        actions=(rest(), consume("food", {"energy": 0.1}, closes_at={"energy": 4.0})),
        senses=(),
        position=(1.0, 1.0),
        heading=0.0,
        **words,  # type: ignore[arg-type]
    )
    room = Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2)))
    food = Resource(name="food", position=(1.0, 1.0), radius=3.0)
    return Scenario(name="toy", arena=room, resources=(food,), species=(species,))


def best_deviation(gamma: float, holds: dict[str, int], grid: np.ndarray) -> np.ndarray:
    """Return -ln(gamma) J* of the toy on a grid of x by value iteration, movements held as the learner holds them.

    The discounted drive within a movement is summed tick by tick (trapezoid), not by its ends.
    """

    def step(x: np.ndarray, eats: bool) -> np.ndarray:
        return np.clip(x + (0.1 * eats - 0.02), 0.0, 4.0)

    def drive(x: np.ndarray) -> np.ndarray:
        return np.sqrt(0.001 + (x - 2.0) ** 2)

    paths = []
    for action, ticks in holds.items():
        x, cost = grid, np.zeros_like(grid)
        for k in range(ticks):
            after = step(x, action == "consume_food")
            cost += gamma**k * (1 - gamma) * 0.5 * (drive(x) + drive(after))
            x = after
        paths.append((x, cost, gamma**ticks))
    value = np.full_like(grid, 1.0)
    for _ in range(4000):
        value = np.min([cost + keep * np.interp(x, grid, value) for x, cost, keep in paths], axis=0)
    return value


def test_learned_deviation_function_converges_to_the_best_one() -> None:
    """In a world small enough for value iteration, -ln(gamma) J comes within 5 % of J* all over its range."""
    scenario = toy()
    env = Ecology(scenario)
    group = env.groups["eater"]
    settings = {"gamma": 0.97, "life": 14_000.0, "width": 32, "pause": 3.0, "meal": 2.0, "memory": 4000}
    learner = agents.make("hjb", group, SEED, {**settings, "update_every": 1.0})
    loop.run(env, {"eater": learner}, env.reset_arrays(0), 14_000)
    grid = np.linspace(0.0, 4.0, 801)
    best = best_deviation(0.97, {"rest": 3, "consume_food": 2}, grid)
    lived = (grid > 0.2) & (grid < 2.8)  # where needs are imagined: -x* to 0.4 x*
    learned = learner.deviation(0, (grid[lived] - 2.0)[:, None])
    error = np.abs(learned - best[lived])
    assert best[lived].max() > 5 * best[lived].min()  # there is something to learn
    assert error.mean() < 0.05 * best[lived].mean()


def test_it_walks_to_the_food_from_either_side() -> None:
    """In a corridor with food in the middle, a hungry agent's best movement leads to it from both ends."""
    species = Species(
        name="walker",
        needs=(Need(name="energy", set_point=2.0, decay=0.01, bounds=(0.0, 4.0)),),
        actions=(
            rest(),
            move("east", 0.1, direction=0.0),
            move("west", 0.1, direction=math.pi),
            consume("food", {"energy": 0.1}, closes_at={"energy": 4.0}),
        ),
        senses=("position",),
        heading=0.0,
    )
    scenario = Scenario(
        name="corridor",
        arena=Arena(vertices=((0, 0), (6, 0), (6, 1), (0, 1))),
        resources=(Resource(name="food", position=(3.0, 0.5), radius=0.5),),
        species=(species,),
    )
    env = Ecology(scenario)
    learner = agents.make("hjb", env.groups["walker"], SEED, {"life": 8000.0, "update_every": 4.0, "gamma": 0.98})
    loop.run(env, {"walker": learner}, env.reset_arrays(1), 8000)
    learner.evaluating(0.0)
    chosen = {}
    for x in (0.6, 1.6, 4.4, 5.4):
        internal = np.array([[0.2]])
        tick = env.put(position=np.array([[x, 0.5]]), internal=internal)
        learner.begin()
        action = learner.act(tick.observations["walker"], tick.masks["walker"])[0]
        chosen[x] = env.groups["walker"].actions[action]
    assert chosen == {0.6: "east", 1.6: "east", 4.4: "west", 5.4: "west"}


# ---- parts against plain versions ----------------------------------------------------------


def paper_learner(**settings: object) -> tuple[Ecology, HJB]:
    """Return the paper's world and a small learner in it."""
    env = Ecology(scenarios.load("paper"))
    learner = agents.make("hjb", env.groups["agent"], SEED, {**SMALL, **settings})
    assert isinstance(learner, HJB)
    return env, learner


def test_stacked_networks_and_adam_equal_separate_ones() -> None:
    """Three agents in one stack learn exactly what three torch modules with torch's own Adam learn."""
    generator = torch.Generator().manual_seed(0)
    stack = Perceptrons(3, (4, 8, 8, 2), torch.nn.functional.silu, generator)
    for weight in stack.weights[-2:]:
        weight.data.uniform_(-1, 1, generator=generator)
    modules = []
    for i in range(3):
        sizes = [(4, 8), (8, 8), (8, 2)]
        layers = [torch.nn.Linear(*size) for size in sizes]
        for k, layer in enumerate(layers):
            layer.weight.data = stack.weights[2 * k][i].detach().T.clone()
            layer.bias.data = stack.weights[2 * k + 1][i, 0].detach().clone()
        modules.append(torch.nn.Sequential(layers[0], torch.nn.SiLU(), layers[1], torch.nn.SiLU(), layers[2]))
    rates = (1e-2, 3e-3, 0.0)
    adam = Adam(stack.weights)
    plain = [torch.optim.Adam(m.parameters(), lr=r or 1e-3) for m, r in zip(modules, rates, strict=True)]
    for _ in range(20):
        x, y = torch.randn(3, 5, 4, generator=generator), torch.randn(3, 5, 2, generator=generator)
        loss = (stack(x) - y).square().mean((1, 2))
        adam.step(torch.autograd.grad(loss.sum(), stack.weights), torch.tensor(rates))
        for i in range(2):
            plain[i].zero_grad()
            (modules[i](x[i]) - y[i]).square().mean().backward()
            plain[i].step()
    for i in range(3):
        assert torch.allclose(stack(x)[i], modules[i](x[i]), atol=1e-4)
    assert adam.steps.tolist() == [20, 20, 0]  # the third, with rate 0, has not moved


def test_slope_is_the_derivative_of_the_deviation_function() -> None:
    """dJn/dzeta agrees with central differences of Jn, place cells included."""
    env, learner = paper_learner(adaptive_steps=False, update_every=4.0)
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 300)
    zeta = torch.tensor([[[-0.5, -1.0, -0.2, -2.0, 0.3, 0.4, 3.2, 2.2, 0.7]]])
    slope = learner.slope(zeta)[0, 0]
    for i in range(zeta.shape[-1]):
        step = torch.zeros_like(zeta)
        step[..., i] = 2e-2
        difference = (learner.deviation_at(zeta + step) - learner.deviation_at(zeta - step)) / 4e-2
        assert slope[i].item() == pytest.approx(difference.item(), abs=2e-3)


def test_score_over_a_movement_tends_to_the_papers_score() -> None:
    """For a short movement, score - Jn = -ln(gamma) tau (d + dJ/dzeta . f - Jn) up to order tau^2."""
    env, learner = paper_learner(adaptive_steps=False, place_cells=0)
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 300)
    gamma, zeta = learner.settings.gamma, torch.tensor([[[-0.5, -1.0, -0.2, -2.0, 0.3, 0.4, 3.2, 2.2, 0.7]]])
    change, duration = learner.changes(zeta)
    short = (duration[0, 0] < 2.0) & (change[0, 0, :, -1].abs() < 0.3)  # all but sleep and turns
    assert short.sum() >= 5
    whole = learner.scores(zeta) - learner.deviation_at(zeta)[..., None]
    rate = change / duration[..., None]
    first = learner.drive(zeta)[..., None] + (learner.slope(zeta)[:, :, None] * rate).sum(-1) / -math.log(gamma)
    limit = -math.log(gamma) * duration * (first - learner.deviation_at(zeta)[..., None])
    whole, limit = whole[0, 0, short].detach().numpy(), limit[0, 0, short].detach().numpy()
    assert whole == pytest.approx(limit, abs=2e-3)
    assert np.abs(limit).max() > 1e-2


def test_algorithm_1_scores_as_printed() -> None:
    """The bare setting ranks actions by d(zeta + f dt) + dJ/dzeta . f and holds each for one tick."""
    env = Ecology(scenarios.load("paper"))
    learner = agents.make("algorithm1", env.groups["agent"], SEED, {})
    assert isinstance(learner, HJB)
    assert learner.moves.names == env.groups["agent"].actions
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 100)
    assert learner.decisions[0] >= 100 - 2 * 50  # every tick, but for those asleep
    zeta = torch.tensor([[[-0.5, -1.0, -0.2, -2.0, 0.3, 0.4, 3.2, 2.2, 0.7]]])
    change, duration = learner.changes(zeta)
    f = change / duration[..., None]
    J_slope = learner.slope(zeta) / -math.log(learner.settings.gamma)  # noqa: N806  (the paper's J)
    expected = learner.drive(zeta[:, :, None] + f) + (J_slope[:, :, None] * f).sum(-1)
    assert torch.allclose(learner.scores(zeta), expected, atol=1e-5)


@pytest.mark.parametrize("name", [name for name, value in ALGORITHM1.items() if value is False or value == 0])
def test_every_addition_can_be_switched_off_alone(name: str) -> None:
    """Each option of the learner that Algorithm 1 lacks is optional, and the rest still learns."""
    env, learner = paper_learner(**{name: ALGORITHM1[name]})
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 1600)
    assert np.isfinite(learner.loss_f).all()
    assert np.isfinite(learner.loss_j).all()


def test_movements_last_what_they_say() -> None:
    """A move is held for a stride, a turn goes with the walk after it, sleep lasts its minimal duration."""
    env, _ = paper_learner()
    group = env.groups["agent"]
    moves = adaptive(group, bearings=True)
    length = dict(zip(moves.names, moves.ticks.tolist(), strict=True))
    assert length["walk"] == [10, 0]
    assert length["consume_food_1"] == [5, 0]
    assert length["turn_left_144_walk"] == [2, 10]
    assert "turn_left" not in moves.names
    assert "turn_left" in adaptive(group, bearings=False).names
    assert single_ticks(group).ticks.sum() == len(group.actions)
    assert moves.length[moves.names.index("sleep")] == 50


def test_explored_walks_go_on() -> None:
    """Walks explored at random are longer than a stride, by a zeta law; other movements happen once."""

    def strides(persistence: int) -> list[int]:
        env, learner = paper_learner(epsilon=1.0, epsilon_final=1.0, persistence=persistence)
        chosen: list[str] = []
        decisions, tick = 0, env.reset_arrays(0)
        for _ in range(4000):
            tick = loop.run(env, {"agent": learner}, tick, 1)
            if learner.decisions[0] > decisions:
                decisions = int(learner.decisions[0])
                chosen.append(learner.moves.names[learner.movement[0]])
        text = "".join("w" if name == "walk" else "." for name in chosen)
        return [len(run) for run in text.split(".") if run]

    once, on = strides(1), strides(8)
    assert np.mean(once) < 1.5
    assert np.mean(on) > 1.5
    assert max(on) >= 5


def test_memory_draws_the_share_from_the_newest() -> None:
    """The last part of a batch lies among the newest decisions, the first anywhere in life; the ring wraps."""
    memory = Memory(1, 100, 1, 1)
    one = np.zeros(1, np.int64)
    for k in range(250):
        memory.add(
            one, np.array([[k]], np.float32), one, np.array([[k]], np.float32), np.ones(1), np.ones((1, 1), bool)
        )
    at = memory.sample(1000, 10, 0.4, torch.Generator().manual_seed(0))
    drawn = memory.take(at)[0][0, :, 0].numpy()
    assert drawn.min() >= 150
    assert drawn[600:].min() >= 240
    assert drawn[:600].min() < 160
    assert memory.take(memory.newest())[0].item() == 249


def test_a_life_goes_on_from_its_state() -> None:
    """A learner restored from its state lives on exactly as the one that was never stopped."""
    env, learner = paper_learner()
    tick = loop.run(env, {"agent": learner}, env.reset_arrays(0), 700)
    twin_env, twin = paper_learner()
    twin_env.restore(*env.snapshot())
    twin.restore(*learner.state())
    loop.run(env, {"agent": learner}, tick, 300)
    loop.run(twin_env, {"agent": twin}, tick, 300)
    assert np.array_equal(env.state_view.internal, twin_env.state_view.internal)
    assert np.array_equal(env.state_view.position, twin_env.state_view.position)
    for mine, other in zip(learner.state()[0].values(), twin.state()[0].values(), strict=True):
        assert np.array_equal(mine, other, equal_nan=True)


def test_agents_learn_each_for_itself() -> None:
    """A gradient step of one agent leaves the networks of the other exactly as they are."""
    env, _ = paper_learner()
    group = dataclasses.replace(env.groups["agent"], slots=slice(0, 2))
    learner = agents.make("hjb", group, SEED, SMALL)
    assert isinstance(learner, HJB)
    rng = np.random.default_rng(0)
    for slot in (0, 1):
        for _ in range(40):
            zeta = rng.normal(size=(1, learner.components)).astype(np.float32)
            all_open = np.ones((1, learner.count), bool)
            learner.memory.add(np.array([slot]), zeta, np.zeros(1, np.int64), zeta + 0.1, np.ones(1), all_open)
    before = [w.detach().clone() for w in (*learner.f.weights, *learner.J.weights)]
    for _ in range(3):  # the first step moves the output layer alone, which starts at zero
        learner._update(np.array([False, True]))
    after = [*learner.f.weights, *learner.J.weights]
    assert all(torch.equal(a[0], b[0]) for a, b in zip(after, before, strict=True))
    assert not torch.equal(after[0][1], before[0][1])


def test_it_acts_only_within_the_mask() -> None:
    """No action that the learner asks for is ever closed."""
    env, learner = paper_learner()
    loop.run(env, {"agent": learner}, env.reset_arrays(0), 2000)
    assert env.state_view.closed.sum() == 0


def test_a_number_that_is_not_finite_stops_the_run() -> None:
    """A network with NaN raises DivergedError that names the slot and says what to do."""
    env, learner = paper_learner()
    tick = loop.run(env, {"agent": learner}, env.reset_arrays(0), 400)
    with torch.no_grad():
        learner.J.weights[0][0, 0, 0] = math.nan
    with pytest.raises(DivergedError, match="learning_rate"):
        loop.run(env, {"agent": learner}, tick, 200)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"gama": 0.9}, "Did you mean 'gamma'"),
        ({"gamma": 1.5}, "between 0 and 1, both excluded, got 1.5"),
        ({"width": 0}, "width must be 1 or more, got 0"),
        ({"batch_f": -1}, "batch_f must be 1 or more, got -1"),
        ({"pause": math.nan}, "pause must be positive and finite, got nan"),
        ({"life": math.inf}, "life must be positive and finite, got inf"),
        ({"place_width": 1e-30}, "place_width must be a length of at least 0.001"),
        ({"width": 6.5}, "width is of type int, got 6.5"),
        ({"replay": 1}, "replay is of type bool, got 1"),
    ],
)
def test_bad_settings_are_refused(settings: dict[str, object], message: str) -> None:
    """A setting that is unknown, of the wrong type or out of range is one clear error."""
    env = Ecology(scenarios.load("paper"))
    with pytest.raises(EcologyError, match=message):
        agents.make("hjb", env.groups["agent"], SEED, settings)
