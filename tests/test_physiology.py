"""The body against values worked out by hand: decay, control, time, noise, thresholds, reward."""

import itertools

import numpy as np
import pytest

import ecology
from ecology import Need, Season, consume, physiology, rest, scenarios, sleep
from ecology.scenarios.paper import COLLAPSE, RUN_UP_TO, TIRES_RUNNING, TIRES_WALKING, WAKING, WALK_UP_TO
from ecology.schedule import ScheduledTick


def start(scenario, seed=0):
    """Return the world of `scenario`, started."""
    env = ecology.parallel_env(scenario)
    env.reset_arrays(seed=seed)
    return env


def x(env, need=0):
    """Return the value of one need of the first agent."""
    return float(env.state_view.internal[0, need])


def test_decay_takes_a_quantity_per_unit_of_time(room, act):
    """Without an action x = x0 - decay t, and the bounds keep it."""
    env = start(room(needs=(Need(name="food", set_point=2.0, decay=0.03),)))
    act(env, "rest", 10)
    assert x(env) == pytest.approx(2.0 - 0.3, abs=1e-12)
    act(env, "rest", 100)
    assert x(env) == 0.0


def test_intake_is_a_quantity_per_unit_of_time(room, act):
    """Consuming inside the circle gives x = x0 + (intake - decay) t; the upper bound keeps it."""
    need = Need(name="food", set_point=2.0, start=1.0, decay=0.03, bounds=(0.0, 4.0))
    env = start(room(needs=(need,), position=(5.0, 5.0)))
    act(env, "consume_berries", 10)
    assert x(env) == pytest.approx(1.0 + 0.7, abs=1e-12)
    act(env, "consume_berries", 100)
    assert x(env) == 4.0


def test_a_leak_is_proportional(room, act):
    """With dx/dt = -leak x, n ticks of Euler give x0 (1 - leak dt)^n."""
    env = start(room(needs=(Need(name="food", set_point=2.0, leak=0.05),), dt=0.5))
    act(env, "rest", 7)
    assert x(env) == pytest.approx(2.0 * (1 - 0.025) ** 7, rel=1e-14)


def test_a_proportional_control_multiplies(room, act):
    """With dx/dt = (u - leak) x, n ticks of Euler give x0 (1 + (u - leak) dt)^n."""
    need = Need(name="food", set_point=2.0, leak=0.05, proportional=True)
    env = start(room(needs=(need,), position=(5.0, 5.0)))
    act(env, "consume_berries", 6)
    assert x(env) == pytest.approx(2.0 * 1.05**6, rel=1e-14)


def test_a_season_multiplies_decay(room, act):
    """Over a whole period a season takes what a steady decay takes; over half of one, 2/pi amplitude more."""
    dt, period, decay, amplitude = 0.25, 200.0, 0.004, 0.8
    need = Need(name="food", set_point=2.0, decay=decay, season=Season(amplitude=amplitude, period=period))
    env = start(room(needs=(need,), dt=dt))
    act(env, "rest", int(period / 2 / dt))
    lost = 2.0 - x(env)
    assert lost == pytest.approx(decay * period / 2 * (1 + amplitude * 2 / np.pi), rel=1e-4)
    act(env, "rest", int(period / 2 / dt))
    assert 2.0 - x(env) == pytest.approx(decay * period, rel=1e-10)


def test_ageing_hastens_decay(room, act):
    """With decay (1 + ageing age) x falls by decay (t + ageing t^2 / 2)."""
    dt, t, decay, ageing = 0.1, 50.0, 0.004, 0.05
    env = start(room(needs=(Need(name="food", set_point=2.0, decay=decay, ageing=ageing),), dt=dt))
    act(env, "rest", int(t / dt))
    assert 2.0 - x(env) == pytest.approx(decay * (t + ageing * t**2 / 2), rel=2 * dt / t)
    # the sum that Euler makes of it, exactly: ages 0, dt, ..., t - dt
    assert 2.0 - x(env) == pytest.approx(decay * (t + ageing * t * (t - dt) / 2), rel=1e-10)


@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_noise_is_a_wiener_process(room, dt):
    """After time t noise has mean 0 and variance noise^2 t, whatever dt."""
    t, sigma, agents = 16.0, 0.05, 4000
    need = Need(name="food", set_point=50.0, noise=sigma, bounds=(0.0, 100.0))
    body = physiology.compile_bodies(room(needs=(need,), count=agents).species, 1)
    rng = np.random.default_rng(5)
    internal, nothing, age = body.start, np.zeros((agents, 1)), np.zeros(agents)
    for _ in range(int(t / dt)):
        internal = physiology.advance(body, internal, nothing, 0.0, age, dt, rng)
    wander = internal[:, 0] - 50.0
    assert abs(wander.mean()) < 4 * sigma * np.sqrt(t / agents)
    assert wander.var() == pytest.approx(sigma**2 * t, rel=4 * np.sqrt(2 / agents))


def test_noise_of_neighbours_is_independent(room):
    """Each agent, and each tick, draws its own noise."""
    need = Need(name="food", set_point=50.0, noise=0.1, bounds=(0.0, 100.0))
    env = start(room(needs=(need,), count=40, actions=(rest(),)))
    steps = []
    for _ in range(40):
        before = env.state_view.internal[:, 0].copy()
        env.step_arrays(np.zeros(40, np.int64))
        steps.append(env.state_view.internal[:, 0] - before)
    steps = np.array(steps)
    assert len(np.unique(steps)) == steps.size
    assert abs(np.corrcoef(steps[:, 0], steps[:, 1])[0, 1]) < 0.6


def test_a_floor_lifts_and_bounds_hold(room, act):
    """A variable that falls below its floor is put back on it, above the set point though it may lie."""
    need = Need(name="fatigue", set_point=0.0, start=0.3, leak=0.5, floor=0.1)
    env = start(room(needs=(need,)))
    levels = []
    for _ in range(4):
        act(env, "rest")
        levels.append(x(env))
    assert levels == pytest.approx([0.15, 0.1, 0.1, 0.1])


def test_a_lethal_need_kills_beyond_its_bounds(room, act):
    """An agent dies on the tick that takes a lethal need out of its bounds, and not before."""
    need = Need(name="food", set_point=2.0, start=0.10, decay=0.03, bounds=(0.0, 4.0), lethal=True)
    env = start(room(needs=(need,)))
    tick = act(env, "rest", 3)
    assert tick.alive.all()
    tick = act(env, "rest")
    assert tick.died.all()
    assert not tick.alive.any()
    assert x(env) == pytest.approx(0.01), "a dead body keeps its last state"


def test_the_dead_leave_once(room):
    """A death is a termination with a last entry in all five dicts; the name is gone afterwards."""
    need = Need(name="food", set_point=2.0, start=0.05, decay=0.03, bounds=(0.0, 4.0), lethal=True)
    env = ecology.parallel_env(room(needs=(need,)))
    env.reset(seed=0)
    (name,) = env.agents
    env.step({name: 0})
    *five, infos = env.step({name: 0})
    assert all(set(part) == {name} for part in (*five, infos))
    assert five[2] == {name: True}
    assert env.agents == []
    assert all(part == {} for part in env.step({}))


def test_the_reward_telescopes(random_actions):
    """The rewards of a life add up to the drive at its start minus that at its end, but for what is not felt."""
    for name in scenarios.names():
        env = ecology.parallel_env(scenarios.load(name))
        if env.open_population:
            continue  # a slot holds more than one life
        tick = env.reset_arrays(seed=1)
        first, rng, total = tick.drive.copy(), np.random.default_rng(1), np.zeros(env.size)
        moved = 0.0
        for _ in range(300):
            tick = env.step_arrays(random_actions(env, tick, rng))
            total += tick.reward
            if isinstance(tick, ScheduledTick) and not tick.felt:
                total += tick.lived.drive - tick.drive
            moved += np.abs(tick.reward).sum()
        assert np.allclose(total, first - tick.drive, rtol=0, atol=1e-10), name
        assert moved > 0.01, name


def test_the_drive_is_the_length_of_the_deviation():
    """d = sqrt(0.001 + |delta|^2) over all six variables of the paper's agent."""
    env = ecology.parallel_env(scenarios.load("paper"))
    env.reset_arrays(seed=0)
    tick = env.set_state(internal=np.array([[0.5, 2.0, 4.0, 1.0, 2.0, 0.25]]))
    # delta = (-.5, 0, 1, -3, 2, .25)
    assert tick.drive[0] == pytest.approx(np.sqrt(0.001 + 0.25 + 1 + 9 + 4 + 0.0625), rel=1e-14)
    assert tick.observations["agent"][0, :6] == pytest.approx([-0.5, 0, 1, -3, 2, 0.25])


def test_an_unregulated_need_does_not_count(room):
    """A need that is not regulated is perceived but is no part of the drive."""
    needs = (Need(name="food", set_point=2.0), Need(name="warmth", set_point=1.0, start=0.2, regulated=False))
    env = ecology.parallel_env(room(needs=needs))
    tick = env.reset_arrays(seed=0)
    assert tick.drive[0] == pytest.approx(np.sqrt(0.001))
    assert tick.observations["agent"][0, 1] == pytest.approx(-0.8)


# ---- thresholds --------------------------------------------------------------------------


def open_actions(env, tick):
    """Return the names of the open actions of the only agent."""
    (group,) = env.groups.values()
    return {name for name, is_open in zip(group.actions, tick.masks[group.name][0], strict=True) if is_open}


@pytest.mark.parametrize(
    ("fatigue", "run", "walk"),
    [
        (RUN_UP_TO - 0.001, True, True),
        (RUN_UP_TO, False, True),
        (WALK_UP_TO - 0.001, False, True),
        (WALK_UP_TO, False, False),
    ],
)
def test_muscle_fatigue_closes_running_then_walking(fatigue, run, walk):
    """In `paper` muscle fatigue closes running, higher up walking, turning and going too; rest and sleep never."""
    env = ecology.parallel_env(scenarios.load("paper"))
    env.reset_arrays(seed=0)
    internal = env.state_view.internal.copy()
    internal[0, 4] = fatigue
    names = open_actions(env, env.set_state(internal=internal))
    assert ("run" in names) == run
    assert ({"walk", "turn_left", "turn_right", "go_to_food_2"} <= names) == walk
    assert ({"walk", "turn_left", "turn_right", "go_to_food_2"}.isdisjoint(names)) == (not walk)
    assert {"rest", "sleep"} <= names


def test_sleep_fatigue_leaves_only_sleep():
    """In `paper` sleep is the only action from its threshold of sleep fatigue, and even rest becomes sleep."""
    env = ecology.parallel_env(scenarios.load("paper"))
    env.reset_arrays(seed=0)
    internal = env.state_view.internal.copy()
    internal[0, 5] = COLLAPSE - 0.001
    assert len(open_actions(env, env.set_state(internal=internal))) > 1
    internal[0, 5] = COLLAPSE
    assert open_actions(env, env.set_state(internal=internal)) == {"sleep"}
    tick = env.step_arrays(np.array([env.groups["agent"].actions.index("rest")]))
    assert env.groups["agent"].actions[tick.action[0]] == "sleep"
    assert tick.closed[0]


def test_an_agent_that_never_rests_meets_every_threshold():
    """In `paper`, one that moves whenever it can sees running, then walking close, then only sleep left."""
    env = ecology.parallel_env(scenarios.load("paper"))
    tick = env.reset_arrays(seed=0)
    actions = env.groups["agent"].actions
    pace = [actions.index(name) for name in ("run", "walk", "turn_left")]
    met = {}
    for _ in range(env.scenario.ticks):
        muscle, sleepiness = env.state_view.internal[0, 4:]
        names = open_actions(env, tick)
        for what, closed in (
            ("run", "run" not in names and "walk" in names),
            ("walk", "walk" not in names and "rest" in names),
            ("all", names == {"sleep"}),
        ):
            if closed:
                met.setdefault(what, (muscle, sleepiness))
        if "all" in met:
            break
        choice = next((a for a in pace if tick.masks["agent"][0, a]), actions.index("rest"))
        tick = env.step_arrays(np.array([choice]))
    # each is met by less than a tick's fatigue
    assert 0 <= met["run"][0] - RUN_UP_TO < TIRES_RUNNING
    assert 0 <= met["walk"][0] - WALK_UP_TO < TIRES_WALKING
    assert 0 <= met["all"][1] - COLLAPSE < WAKING
    assert env.state_view.tick < env.scenario.ticks / 4


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.3])
def test_sleep_immobilises_for_its_duration(room, act, index, dt):
    """A sleep of 6 units of time is the only open action while it lasts; then it can be renewed, or left."""
    actions = (
        rest(),
        ecology.move("walk", 0.1),
        sleep(duration=6.0, control={"fatigue": -0.01}),
    )
    env = start(room(needs=(Need(name="fatigue", set_point=0.0, start=2.0),), actions=actions, dt=dt))
    where = env.state_view.position.copy()
    for _ in range(2):
        tick = act(env, "sleep")
        for _ in range(round(6 / dt) - 1):
            assert open_actions(env, tick) == {"sleep"}
            tick = act(env, "walk")
            assert tick.closed[0]
            assert tick.action[0] == index(env, "sleep")
        assert open_actions(env, tick) == {"rest", "walk", "sleep"}
    assert np.array_equal(env.state_view.position, where)
    assert x(env) == pytest.approx(2.0 - 2 * 6.0 * 0.01, rel=1e-12)


def test_sleep_opens_from_its_threshold(room):
    """An action with `opens_from` is closed below the value and open from it."""
    actions = (rest(), sleep(duration=2.0, opens_from={"fatigue": 1.0}))
    env = start(room(needs=(Need(name="fatigue", set_point=0.0),), actions=actions))
    assert open_actions(env, env.set_state(internal=np.array([[0.999]]))) == {"rest"}
    assert open_actions(env, env.set_state(internal=np.array([[1.0]]))) == {"rest", "sleep"}


def test_a_full_stomach_closes_consuming(room):
    """Consuming is closed from the value in its `closes_at`, and outside the circle."""
    actions = (rest(), consume("berries", {"food": 0.1}, closes_at={"food": 4.0}))
    env = start(room(actions=actions, position=(5.0, 5.0)))
    assert open_actions(env, env.set_state(internal=np.array([[3.999]]))) == {"rest", "consume_berries"}
    assert open_actions(env, env.set_state(internal=np.array([[4.0]]))) == {"rest"}
    env.set_state(internal=np.array([[2.0]]))
    assert open_actions(env, env.set_state(position=np.array([[5.0, 5.3]]))) == {"rest", "consume_berries"}
    assert open_actions(env, env.set_state(position=np.array([[5.0, 5.301]]))) == {"rest"}


# ---- time steps --------------------------------------------------------------------------

# what an agent does and for how long, the same in units of time whatever dt
DAY = (("walk", 4), ("turn_left", 2), ("run", 3), ("go_to_food_2", 12), ("consume_food_2", 20), ("rest", 9))


def lived(name, dt, **settings):
    """Return the internal state and position after three rounds of DAY, and the drive at every whole time."""
    env = ecology.parallel_env(scenarios.load(name, dt=dt, **settings))
    env.reset_arrays(seed=0)
    actions, drives = env.groups["agent"].actions, []
    for _ in range(3):
        for action, time in DAY:
            for _ in range(time):
                for _ in range(round(1 / dt)):
                    tick = env.step_arrays(np.array([actions.index(action)]))
                drives.append(float(tick.drive[0]))
    return env.state_view.internal[0].copy(), env.state_view.position[0].copy(), np.array(drives)


def test_halving_dt_halves_the_error():
    """The same actions in time, with proportional rates: the drive's error shrinks in proportion to dt."""
    _, _, truth = lived("paper_reference", 1 / 16, commitment="free")
    errors = [np.abs(lived("paper_reference", dt, commitment="free")[2] - truth).max() for dt in (1.0, 0.5, 0.25)]
    assert 1e-3 < errors[0] < 0.1
    for coarse, fine in itertools.pairwise(errors):
        assert 0.35 < fine / coarse < 0.65


def test_constant_rates_do_not_depend_on_dt():
    """With rates in quantities per unit of time only the tick at which something is reached differs."""
    _, place, truth = lived("paper", 1 / 16)
    for dt in (1.0, 0.5, 0.25):
        _, position, drives = lived("paper", dt)
        assert np.abs(drives - truth).max() < 0.02 * dt  # the drive moves by 0.1 per unit of time at most
        assert np.abs(position - place).max() < 0.1 * dt  # the walking speed


def test_speeds_and_turns_are_per_unit_of_time(room, act):
    """Walking, turning and eating for the same time lead to the same place and state, whatever dt."""
    ends = []
    for dt in (2.0, 1.0, 0.25, 0.1):
        need = Need(name="food", set_point=2.0, start=0.5, decay=0.01)
        env = start(room(needs=(need,), position=(2.0, 5.0), heading=0.0, dt=dt))
        act(env, "walk", round(30 / dt))
        act(env, "consume_berries", round(10 / dt))
        act(env, "turn_left", round(2 / dt))
        state = env.state_view
        assert state.time == pytest.approx(42)
        assert state.age[0] == pytest.approx(42)
        ends.append(np.concatenate([state.position[0], np.abs(state.heading), state.internal[0]]))
    assert ends[0] == pytest.approx([5.0, 5.0, np.pi, 0.5 + 1.0 - 0.42])
    for end in ends[1:]:
        assert end == pytest.approx(ends[0], abs=1e-9)
