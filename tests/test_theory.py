"""The paper's theory, section "Theoretical results", on real trajectories and on grids."""

import itertools

import numpy as np
import pytest

import ecology
from ecology import Need, Species, physiology, rest, scenarios

GAMMA = 0.99  # per unit of time


# ---- the lemma V = d + ln(gamma) J -------------------------------------------------------


def live(name, policy, dt=1.0, time=300.0, **settings):
    """Return rewards (K,) and drives (K + 1,) of a life under policy(group, mask, time, rng)."""
    env = ecology.parallel_env(scenarios.load(name, dt=dt, **settings))
    tick = env.reset_arrays(seed=3)
    group, rng = env.groups["agent"], np.random.default_rng(3)
    rewards, drives = [], [float(tick.drive[0])]
    for k in range(round(time / dt)):
        tick = env.step_arrays(np.array([policy(group, tick.masks["agent"][0], k * dt, rng)]))
        rewards.append(float(tick.reward[0]))
        drives.append(float(tick.drive[0]))
    return np.array(rewards), np.array(drives)


def at_random(group, mask, time, rng):
    """Do anything that is open."""
    return rng.choice(np.flatnonzero(mask))


def resting(group, mask, time, rng):
    """Do nothing."""
    return group.kinds.index("rest")


def eating(group, mask, time, rng):
    """Eat what is there, else go where something is seen, else turn or walk."""
    for kind in ("consume", "go_to", "turn", "move"):
        found = [i for i, k in enumerate(group.kinds) if k == kind and mask[i]]
        if found:
            return found[0]
    return group.kinds.index("rest")


def camping(resource):
    """Return the policy that goes to one resource and eats there whenever it can."""

    def policy(group, mask, time, rng):
        for name in (f"consume_{resource}", f"go_to_{resource}"):
            if mask[group.actions.index(name)]:
                return group.actions.index(name)
        return group.kinds.index("rest")

    return policy


def value_and_deviation(rewards, drives, dt):
    """Return V and J over the life, by the trapezoid rule for J and by each reward's own tick for V."""
    k = np.arange(len(drives))
    discount = GAMMA ** (k * dt)
    j = float(np.sum(discount[:-1] * drives[:-1] + discount[1:] * drives[1:]) * dt / 2)
    # the reward of a tick, -d'(t) dt, falls between its two ends: discounted at its start
    v = float(np.sum(discount[:-1] * rewards))
    return v, j


def lemma_gap(rewards, drives, dt):
    """Return V - (d + ln(gamma) J), what the end of the life leaves out taken into account."""
    v, j = value_and_deviation(rewards, drives, dt)
    left_out = GAMMA ** (dt * len(rewards)) * drives[-1]
    return v - (drives[0] - left_out + np.log(GAMMA) * j)


@pytest.mark.parametrize("name", ["paper", "paper_reference", "seasons"])
@pytest.mark.parametrize("policy", [at_random, resting, eating])
def test_the_lemma_holds_along_lives(name, policy):
    """V = d + ln(gamma) J up to the error of the sums, which shrinks in proportion to dt."""
    gaps = []
    for dt in (1.0, 0.5, 0.25):
        rewards, drives = live(name, policy, dt)
        assert np.ptp(drives) > 0.1
        # d is of order 1 and the discounting of a reward is off by half a tick: -ln(gamma) dt / 2
        gaps.append(abs(lemma_gap(rewards, drives, dt)) / np.abs(np.diff(drives)).sum())
        assert gaps[-1] < 0.6 * -np.log(GAMMA) * dt
    if policy is resting and name != "seasons":  # the same life whatever dt: the error itself can be compared
        for coarse, fine in itertools.pairwise(gaps):
            assert 0.4 < fine / coarse < 0.6


def test_the_most_rewarded_policy_is_the_least_deviating():
    """Policies from one start rank by V exactly as they rank by -J."""
    policies = [resting, eating, camping("food_1"), camping("food_2")]
    found = []
    for policy in policies:
        rewards, drives = live("paper_reference", policy, time=1500.0, arena="EASY")
        found.append(value_and_deviation(rewards, drives, 1.0))
    v, j = np.array(found).T
    assert np.diff(np.sort(j)).min() > 1.0, "the policies must differ for their order to say anything"
    assert np.array_equal(np.argsort(-v), np.argsort(j))


# ---- closed forms of d(t) and r(t) -------------------------------------------------------


def drive_at(t, m, delta):
    """Return d(t) = sqrt(t^2 m^2 + 2 t m delta_1 + |delta_0|^2), the paper's closed form."""
    delta = np.asarray(delta, float)
    return np.sqrt(t**2 * m**2 + 2 * t * m * delta[..., 0] + np.sum(delta**2, axis=-1))


def reward_at(t, m, delta):
    """Return r(t) = -(delta_1 + t m) m / d(t), the paper's closed form."""
    return -(np.asarray(delta, float)[..., 0] + t * m) * m / drive_at(t, m, delta)


DELTAS = [(-1.0, -2.0, 0.5), (-1.0, 0.0, 0.0), (0.5, -1.0, 2.0), (-0.2, 3.0, 0.0), (2.0, 0.1, -0.1)]


@pytest.mark.parametrize("m", [0.1, 0.7])
@pytest.mark.parametrize("delta", DELTAS)
def test_the_body_follows_the_closed_forms(delta, m):
    """With constant intake m of need 1 and no decay, the body's drive is d(t) and its reward rate r(t)."""
    needs = tuple(
        Need(name=f"need_{i}", set_point=5.0, start=5.0 + deviation, bounds=(0.0, 20.0))
        for i, deviation in enumerate(delta)
    )
    species = Species(name="eater", needs=needs, actions=(rest(),), drive_epsilon=1e-12)
    body = physiology.compile_bodies((species,), len(needs))
    rng, age = np.random.default_rng(0), np.zeros(1)
    control, internal, dt = np.array([[m, 0.0, 0.0]]), body.start, 0.01
    before = physiology.drive(physiology.deviation(body, internal), body.epsilon)[0]
    for k in range(300):
        internal = physiology.advance(body, internal, control, k * dt, age, dt, rng)
        now = physiology.drive(physiology.deviation(body, internal), body.epsilon)[0]
        assert now == pytest.approx(drive_at((k + 1) * dt, m, delta), rel=1e-9, abs=1e-6)
        middle = (k + 0.5) * dt
        if drive_at(middle, m, delta) > 0.05:  # r jumps where d touches 0
            assert (before - now) / dt == pytest.approx(reward_at(middle, m, delta), abs=2e-4)
        before = now


# ---- the three sign tables ---------------------------------------------------------------

# a grid of |delta_1|, |delta_2| and t m, m = 0.3; no point lies at d = 0
SIZES_1 = np.linspace(0.1, 3.0, 12)
SIZES_2 = np.linspace(0.05, 3.0, 12)
TIMES = np.linspace(0.0, 8.0, 21)
M, H = 0.3, 1e-5


def grid(sign_1, sign_2):
    """Return t and |delta_1|, |delta_2| on the grid, and the deviation they make with the signs given."""
    t, one, two = np.meshgrid(TIMES, SIZES_1, SIZES_2, indexing="ij")
    return t, one, two, lambda a, b: np.stack([sign_1 * a, sign_2 * b], axis=-1)


@pytest.mark.parametrize("sign_2", [-1, 1])
@pytest.mark.parametrize("sign_1", [-1, 1])
def test_deprivation_raises_the_reward_and_excess_lowers_it(sign_1, sign_2):
    """First table: dr/d|delta_1| <= 0 where delta_1 >= 0, and >= 0 where delta_1 <= 0."""
    t, one, two, delta = grid(sign_1, sign_2)
    slope = (reward_at(t, M, delta(one + H, two)) - reward_at(t, M, delta(one - H, two))) / (2 * H)
    assert (sign_1 * slope <= 1e-9).all()
    assert (np.abs(slope) > 1e-6).any()


@pytest.mark.parametrize("sign_2", [-1, 1])
@pytest.mark.parametrize("sign_1", [-1, 1])
def test_another_need_damps_the_reward(sign_1, sign_2):
    """Second table: dr/d|delta_2| <= 0 while delta_1 + t m <= 0, and >= 0 from there on."""
    t, one, two, delta = grid(sign_1, sign_2)
    slope = (reward_at(t, M, delta(one, two + H)) - reward_at(t, M, delta(one, two - H))) / (2 * H)
    beyond = sign_1 * one + t * M
    assert (slope[beyond <= 0] <= 1e-9).all()
    assert (slope[beyond >= 0] >= -1e-9).all()
    assert (slope[beyond > 0.1] > 0).any()
    if sign_1 < 0:
        assert (slope[beyond < -0.1] < 0).any()


@pytest.mark.parametrize("sign_2", [-1, 1])
@pytest.mark.parametrize("sign_1", [-1, 1])
def test_a_dose_helps_up_to_the_set_point(sign_1, sign_2):
    """Third table: dd/d(t m) <= 0 while delta_1 + t m <= 0, and >= 0 from there on."""
    t, one, two, delta = grid(sign_1, sign_2)
    h = H / M  # in time: t m moves by H
    slope = (drive_at(t + h, M, delta(one, two)) - drive_at(t - h, M, delta(one, two))) / (2 * H)
    beyond = sign_1 * one + t * M
    assert (slope[beyond <= -H] <= 1e-9).all()
    assert (slope[beyond >= H] >= -1e-9).all()
    assert slope == pytest.approx(beyond / drive_at(t, M, delta(one, two)), abs=1e-6)


def test_the_reward_of_a_mouthful_follows_the_tables():
    """In the world of `paper` hunger makes a mouthful worth more, another need worth less, excess a loss."""
    env = ecology.parallel_env(scenarios.load("paper", decay=0.0))
    env.reset_arrays(seed=0)
    eat = env.groups["agent"].actions.index("consume_food_2")

    def mouthful(delta_2, delta_4):
        internal = np.array([[1.0, 2.0 + delta_2, 3.0, 4.0 + delta_4, 0.0, 0.0]])
        env.set_state(internal=internal, position=np.array([[3.5, 1.5]]))
        return float(env.step_arrays(np.array([eat])).reward[0])

    assert mouthful(-1.5, -1.0) > mouthful(-0.5, -1.0) > 0
    assert mouthful(-1.0, -0.5) > mouthful(-1.0, -2.0) > 0
    assert mouthful(0.5, -1.0) < 0
    assert mouthful(1.5, -1.0) < mouthful(0.5, -1.0)
    assert mouthful(0.5, -2.0) > mouthful(0.5, -0.5)
