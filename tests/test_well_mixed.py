"""The well-mixed world against Lotka and Volterra: averages, period, Volterra's principle, kinetics."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import ecology
from ecology import move, rest, scenarios

PREY, GROWTH, MORTALITY = 500, 0.03, 0.015  # at rest: 500 prey and 1000 predators
CULLING = 0.005
BETA = MORTALITY / PREY
SEEDS, PERIODS = 2, 3
# margins of means over SEEDS lives, some four standard errors: in the lives of seeds 0 to 3 mean numbers spread by
# less than 1.7 %, and the rate at which a life turns by less than 8.6 %
OFF, OFF_RATE = 0.05, 0.25
DENSITIES = ((100, 400), (400, 100), (200, 200), (400, 400))  # prey and predators, in a world whose reach is 1
SPEED = 3.0  # of walkers


def period(alpha: float, gamma: float) -> float:
    """Return the period of small cycles."""
    return 2 * math.pi / math.sqrt(alpha * gamma)


def area(env: ecology.Ecology) -> float:
    """Return the area of a square torus."""
    return env.scenario.arena.vertices[2][0] ** 2


def lives(culling: float, displacement: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of prey and predators (seeds, ticks, 2) over some periods, and the slots (2,)."""
    changes = {"growth": GROWTH, "mortality": MORTALITY, "culling": culling, "displacement": displacement}
    world = scenarios.load("well_mixed", prey=PREY, **changes)
    prey, predators = world.species
    roomy = dataclasses.replace(prey, capacity=2 * prey.slots)  # a wide cycle comes near the slots that it has
    env = ecology.parallel_env(dataclasses.replace(world, species=(roomy, predators)))
    rows = [env.groups[name].slots for name in ("prey", "predator")]
    ticks = round(PERIODS * period(GROWTH - culling, MORTALITY + culling))
    wanted = np.zeros(env.size, np.int64)  # rest: the world makes a bite of it where there is prey in reach
    wanted[rows[1]] = env.groups["predator"].actions.index("bite_prey")
    found = np.zeros((SEEDS, ticks, 2))
    for seed in range(SEEDS):
        tick = env.reset_arrays(seed)
        for k in range(ticks):
            open_ = np.concatenate([tick.masks["prey"][:, 0] & False, tick.masks["predator"][:, 1]])
            tick = env.step_arrays(np.where(open_, wanted, 0))
            found[seed, k] = [np.count_nonzero(tick.alive[r]) for r in rows]
    return found, np.array([r.stop - r.start for r in rows])


@pytest.fixture(scope="module")
def free() -> tuple[np.ndarray, np.ndarray]:
    """Return lives without culling, begun a fifth off rest."""
    return lives(0.0, 1.2)


@pytest.fixture(scope="module")
def culled() -> tuple[np.ndarray, np.ndarray]:
    """Return lives with extra mortality of both, begun about at rest."""
    return lives(CULLING, (MORTALITY + CULLING) / MORTALITY)


def averages(numbers: np.ndarray, alpha: float, gamma: float) -> np.ndarray:
    """Return the mean numbers of each life, as over whole cycles, (seeds, 2).

    d ln P / dt = beta N - gamma: over any time T the mean of N is gamma / beta + ln(P_T / P_0) / (beta T), and
    the last term is zero over a whole cycle. It is taken off here, and its like off the mean of P.
    """
    change = np.log(numbers[:, -1] / numbers[:, 0]) / (BETA * numbers.shape[1])
    return numbers.mean(axis=1) + np.stack([-change[:, 1], change[:, 0]], axis=1)


def at_rest(alpha: float, gamma: float, culling: float) -> np.ndarray:
    """Return N and P at rest in ticks of dt = 1, worked out by hand.

    Of the prey, a share e^-q stays unbitten, e^-culling of that survives, and each bears with 1 - e^-growth. A
    predator that bites, and has survived its hazard, is two. With N prey a predator has one in reach with
    1 - e^(-beta N), and q bites fall on each prey. For short ticks this is gamma / beta and alpha / beta.
    """
    birth = alpha + culling
    bitten = 1 - math.exp(culling) / (2 - math.exp(-birth))
    ratio = (math.exp(gamma) - 1) / bitten  # N / P
    n = -math.log(1 + math.log(1 - bitten) * ratio) / BETA
    return np.array([n, n / ratio])


@pytest.mark.parametrize(("name", "culling"), [("free", 0.0), ("culled", CULLING)])
def test_cycle_averages_are_the_numbers_at_rest(name, culling, request):
    """Mean numbers are (gamma / beta, alpha / beta), up to what a tick's length does and to 5 % of chance."""
    numbers, slots = request.getfixturevalue(name)
    alpha, gamma = GROWTH - culling, MORTALITY + culling
    means = averages(numbers, alpha, gamma)
    expected = at_rest(alpha, gamma, culling)
    equations = np.array([gamma, alpha]) / BETA
    assert expected == pytest.approx(equations, rel=GROWTH + MORTALITY)
    assert np.all(np.abs(means.mean(axis=0) / expected - 1) < OFF), (means, expected)
    assert np.all(numbers.max(axis=(0, 1)) < slots - 0.1 * slots), "the slots are nearly taken: capacity plays a part"


def test_extra_mortality_of_both_raises_the_prey(free, culled):
    """Volterra's principle: who kills prey and predators alike has more prey and fewer predators.

    By the equations the prey are (gamma + culling) / gamma = 4/3 as many, the predators 5/6; held to half of that.
    """
    before, after = averages(free[0], GROWTH, MORTALITY), averages(culled[0], GROWTH - CULLING, MORTALITY + CULLING)
    prey, predators = np.median(after, axis=0) / np.median(before, axis=0)
    assert prey > 1 + CULLING / MORTALITY / 2
    assert predators < 1 - CULLING / GROWTH / 2


def test_small_cycles_have_their_period(free):
    """Around rest, (sqrt(gamma) ln N, sqrt(alpha) ln P) turns once in 2 pi / sqrt(alpha gamma)."""
    numbers, _ = free
    n, p = np.moveaxis(np.log(numbers / at_rest(GROWTH, MORTALITY, 0.0)), -1, 0)
    angle = np.unwrap(np.arctan2(math.sqrt(GROWTH) * p, math.sqrt(MORTALITY) * n))
    turns = (angle[:, -1] - angle[:, 0]) / (2 * math.pi)  # prey first, predators after: to the left
    rate = turns / numbers.shape[1] * period(GROWTH, MORTALITY)
    assert abs(rate.mean() - 1) < OFF_RATE


def bodies(n: int, p: int, **changes) -> ecology.Ecology:
    """Return the world of n prey and p predators that stay as many and bite nobody, with `changes` to it."""
    world = scenarios.load("well_mixed", prey=200, growth=0.02, mortality=0.02)
    hunter = world.species[1]
    harmless = (move("walk", SPEED), rest(), dataclasses.replace(hunter.actions[1], chance=0.0))
    species = tuple(
        dataclasses.replace(s, count=count, capacity=None, birth=None, hazard=None, actions=harmless[:keep])
        for s, count, keep in zip(world.species, (n, p), (2, 3), strict=True)
    )
    return ecology.parallel_env(dataclasses.replace(world, species=species, **changes))


def deviates(found: list[float], expected: list[float]) -> np.ndarray:
    """Return by how many standard deviations counts, the last their sum, lie off those expected (Poisson)."""
    counts, means = (np.append(values, np.sum(values)) for values in (found, expected))
    return np.abs(counts - means) / np.sqrt(means)


def test_the_scattered_meet_in_proportion_to_the_product_of_densities():
    """Of P predators, P (1 - e^(-pi r^2 N / A)) have prey in reach: as N P, as long as they are few."""
    ticks, found, expected = 150, [], []
    for n, p in DENSITIES:
        env = bodies(n, p)
        tick = env.reset_arrays(seed=n + p)
        found.append(0.0)
        for _ in range(ticks):
            tick = env.step_arrays(np.ones(env.size, np.int64))
            found[-1] += np.count_nonzero(tick.masks["predator"][:, 2])
        expected.append(ticks * p * -math.expm1(-math.pi * n / area(env)))
    assert np.all(deviates(found, expected) < 5), (found, expected)


def test_walkers_meet_in_proportion_to_the_product_of_densities():
    """Bodies that walk straight in any direction come within reach r N P 2 r <v> / A times per unit of time.

    <v> = 4 v / pi is the mean speed at which two close in (kinetic theory of a gas in the plane).
    """
    ticks, dt, found, expected = 150, 0.1, [], []  # dt: short on the way through a reach
    for n, p in DENSITIES:
        env = bodies(n, p, rule=None, dt=dt)
        env.reset_arrays(seed=n + p)
        side, before, new = math.sqrt(area(env)), None, 0
        for _ in range(ticks + 1):
            place = env.state_view.position
            gap = np.abs(place[:n, None] - place[None, n:])
            near = np.square(np.minimum(gap, side - gap)).sum(axis=-1) <= 1.0
            new += 0 if before is None else np.count_nonzero(near & ~before)
            before = near
            env.step_arrays(np.zeros(env.size, np.int64))
        found.append(new)
        expected.append(ticks * dt * n * p * 2 * (4 * SPEED / math.pi) / area(env))
    assert np.all(deviates(found, expected) < 5), (found, expected)
