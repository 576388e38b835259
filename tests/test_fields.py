"""Fields over the plane against closed forms: what they are, how they spread, how they are sensed, what they do."""

import math

import numpy as np
import pytest
from worlds import ask, assert_refused, kind, square, start

from ecology import (
    Arena,
    Door,
    EcologyError,
    Exposure,
    Field,
    Gauge,
    Need,
    Resource,
    fields,
    go_to,
    move,
    parallel_env,
)

HALL = Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)))


def compiled(env, i=0):
    """Return a field of a world."""
    return env.world.model.fields.each[i]


def at(env, *points, i=0):
    """Return the values of a field at points."""
    return fields.sample(compiled(env, i), env.state_view, np.array(points, float))


def lived(env, ticks, **wanted):
    """Let `ticks` pass and return the state."""
    for _ in range(ticks):
        env.step_arrays(ask(env, **wanted))
    return env.state_view


# ---- what it is --------------------------------------------------------------------------------


def test_a_function_and_a_grid_say_the_same():
    """A plane given as a function and as a grid has equal values and gradients within the centres of cells."""
    centres = np.arange(0.5, 8)
    grid = 2 * centres[None, :] - centres[:, None] + 3
    of_grid = Field(name="grid", values=grid)
    of_function = Field(name="function", values=lambda x, y, t: 2 * x - y + 3)
    env = start(square(kind(), fields=(of_grid, of_function)))
    points = np.random.default_rng(0).uniform(0.5, 7.5, (100, 2))
    np.testing.assert_allclose(at(env, *points, i=0), at(env, *points, i=1), rtol=1e-12)
    np.testing.assert_allclose(at(env, *points), 2 * points[:, 0] - points[:, 1] + 3, rtol=1e-12)
    inner = np.clip(points, 1.0, 7.0)
    for i in (0, 1):
        slope = fields.slope(compiled(env, i), env.state_view, env.world.model.plane, inner)
        np.testing.assert_allclose(slope, np.tile([2.0, -1.0], (100, 1)), rtol=1e-6)


def test_a_field_is_kept_within_its_bounds_and_follows_time():
    """What lies beyond low or high is sensed as these; a function is given the time of the tick."""
    warmth = Field(name="warmth", values=lambda x, y, time: 10 * x - time, low=0.0, high=5.0)
    env = start(square(kind(), fields=(warmth,), dt=0.5))
    assert at(env, (0.2, 1), (4, 1)).tolist() == [2.0, 5.0]
    lived(env, 3)
    assert at(env, (0.2, 1), (0.1, 1)).tolist() == [0.5, 0.0]


# ---- how it spreads ----------------------------------------------------------------------------


def moments(env):
    """Return total, and variance along x and y, of the field that changes."""
    cells = compiled(env).cells
    ny, nx = cells.count
    values = env.state_view.grid.reshape(ny, nx)
    total = values.sum() * cells.size.prod()
    found = [total]
    for axis, n, size in ((0, nx, cells.size[0]), (1, ny, cells.size[1])):
        share, place = values.sum(axis=axis) / values.sum(), (np.arange(n) + 0.5) * size
        mean = (share * place).sum()
        found.append((share * (place - mean) ** 2).sum())
    return found


def test_a_point_spreads_as_the_heat_equation_says():
    """The variance of a diffusing point grows by 2 D t along each axis, and its total falls by the decay alone."""
    grid = np.zeros((41, 41))
    grid[20, 20] = 1.0
    smell = Field(name="smell", values=grid, diffusion=0.02, decay=0.01)
    env = start(square(kind(), fields=(smell,)))
    total, *_ = moments(env)
    lived(env, 20)
    after, x, y = moments(env)
    assert after == pytest.approx(total * math.exp(-0.01 * 20), rel=1e-12)
    assert x == pytest.approx(2 * 0.02 * 20, rel=1e-4)
    assert y == pytest.approx(2 * 0.02 * 20, rel=1e-4)


@pytest.mark.parametrize("walls", [True, False])
def test_a_wave_fades_at_its_rate(walls):
    """A cosine, which no wall or seam disturbs, fades by exp(-D k^2 t), to 1 %."""
    n, d, t = 64, 0.05, 10
    k = (1 if walls else 2) * math.pi / 8
    x = (np.arange(n) + 0.5) / n * 8
    field = Field(name="wave", values=np.tile(np.cos(k * x), (n, 1)), diffusion=d)
    env = start(square(kind(), walls=walls, fields=(field,)))
    lived(env, t)
    values = env.state_view.grid.reshape(n, n)
    np.testing.assert_allclose(values, np.tile(np.cos(k * x), (n, 1)) * math.exp(-d * k * k * t), atol=0.01)


def test_sources_give_what_they_say():
    """Living bodies and patches that hold something give their rate; the total is what was given, less what faded."""
    food = Resource(name="food", position=(2.0, 2.0), stock=1.0)
    empty = Resource(name="empty", position=(5.0, 5.0), stock=0.0, capacity=1.0)
    smell = Field(name="smell", diffusion=0.1, sources={"food": 0.5, "agent": 0.25, "empty": 9.0}, cells=16)
    env = start(square(kind(count=3), resources=(food, empty), fields=(smell,)))
    lived(env, 10)
    assert moments(env)[0] == pytest.approx(10 * (0.5 + 3 * 0.25), rel=1e-12)
    assert at(env, (2, 2))[0] > at(env, (7, 2))[0]


def test_nothing_flows_through_a_wall():
    """Behind a wall from side to side but for a gap there is less than in front; behind holes nothing is lost."""
    split = Arena(vertices=HALL.vertices, walls=(((4.0, 0.0), (4.0, 7.0)),), holes=(((1, 5), (2, 5), (2, 6), (1, 6)),))
    smell = Field(name="smell", diffusion=0.2, sources={"food": 1.0}, cells=24)
    food = Resource(name="food", position=(3.0, 1.0))
    env = start(square(kind(), arena=split, resources=(food,), fields=(smell,)))
    lived(env, 30)
    assert moments(env)[0] == pytest.approx(30.0, rel=1e-12)
    front, behind = at(env, (3.8, 1.0), (4.2, 1.0))
    assert front > 1.0
    assert behind < 1e-3 * front


# ---- how it is sensed ----------------------------------------------------------------------------


def test_value_and_gradient_are_sensed_from_the_heading():
    """The gradient is told along the heading and to its left, whatever way the body looks."""
    warmth = Field(name="warmth", values=lambda x, y, t: 3 * x + 4 * y, low=0.0, high=100.0, scale=10.0)
    for heading, ahead, left in ((0.0, 3.0, 4.0), (math.pi / 2, 4.0, -3.0), (math.pi, -3.0, -4.0)):
        species = kind(position=(1.0, 2.0), heading=heading, senses=(Gauge(field="warmth", gradient=True),))
        env = parallel_env(square(species, fields=(warmth,)))
        tick = env.reset_arrays(seed=0)
        assert env.groups["agent"].layout.names[1:] == ("warmth", "warmth_ahead", "warmth_left")
        np.testing.assert_allclose(tick.observations["agent"][0, 1:], [11.0, ahead, left], rtol=1e-4)


# ---- what it does --------------------------------------------------------------------------------


def test_a_body_takes_on_the_temperature_around_it():
    """With a leak and a control of 1 / tau a need follows Newton's law of cooling, to the Euler step."""
    heat = Need(name="heat", set_point=36.0, start=36.0, leak=0.01, bounds=(0.0, 50.0))
    species = kind(needs=(heat,), exposures=(Exposure(field="air", control={"heat": 0.01}),))
    env = start(square(species, fields=(Field(name="air", values=20.0),)))
    state = lived(env, 100)
    assert state.internal[0, 0] == pytest.approx(20 + 16 * (1 - 0.01) ** 100, rel=1e-12)


def test_mud_slows_and_darkness_dims():
    """Speed falls by the share that the field says at the place where the step begins; so does the range of sight."""
    mud = Field(name="mud", values=lambda x, y, t: np.where(x < 4, 0.0, 1.0))
    light = Field(name="light", values=lambda x, y, t: np.where(x < 4, 1.0, 0.25))
    food = Resource(name="food", position=(6.5, 4.0))
    species = kind(
        "agent", move("walk", 0.5, direction=0.0), go_to("food", 0.5), position=(3.0, 4.0), view_range=4.0,
        sees=("food",),
        exposures=(Exposure(field="mud", slowing=0.8), Exposure(field="light", reference=1.0, dimming=-1.0)),
    )  # fmt: skip
    env = start(square(species, fields=(mud, light), resources=(food,)))
    assert env.state_view.seen.all()
    assert lived(env, 2, agent="walk").position[0, 0] == pytest.approx(4.0)
    assert not env.state_view.seen.any()  # 2.5 away, and 1 is what it sees
    assert lived(env, 5, agent="walk").position[0, 0] == pytest.approx(4.5)


def test_a_world_with_fields_goes_on_after_a_snapshot():
    """The grid is in the snapshot: a world that is left and entered continues bit for bit."""
    smell = Field(name="smell", diffusion=0.1, decay=0.02, sources={"agent": 0.3}, cells=10)
    scenario = square(kind("agent", move("walk", 0.2)), fields=(smell,))
    env = start(scenario)
    lived(env, 5, agent="walk")
    other = parallel_env(scenario)
    other.restore(*env.snapshot())
    for world in (env, other):
        lived(world, 5, agent="walk")
    assert np.array_equal(env.state_view.grid, other.state_view.grid)


WRONG = {
    "a function that diffuses": (lambda: Field(name="a", values=max, diffusion=1.0), ["function", "grid"]),
    "rows of two lengths": (lambda: Field(name="a", values=((1.0, 2.0), (1.0,))), ["equally long", "[1, 2]"]),
    "a grid of NaN": (lambda: Field(name="a", values=((1.0, math.nan),)), ["finite", "nan"]),
    "low above high": (lambda: Field(name="a", low=2.0, high=1.0), ["low", "2.0", "1.0"]),
    "an exposure to nothing": (lambda: Exposure(field="a"), ["'a'", "does nothing"]),
    "a gauge of nothing": (lambda: Gauge(field="a", value=False), ["nothing", "'a'"]),
    "an unknown source": (
        lambda: square(kind(), fields=(Field(name="a", sources={"agnt": 1.0}),)), ["'agnt'", "agent"],
    ),
    "an unknown field": (
        lambda: square(kind(senses=(Gauge(field="b"),)), fields=(Field(name="air"),)), ["gauge", "'b'", "air"],
    ),
    "no fields": (lambda: square(kind(exposures=(Exposure(field="b", slowing=1.0),))), ["'b'", "no fields"]),
    "an unknown need": (
        lambda: square(kind(exposures=(Exposure(field="a", control={"fod": 1.0}),)), fields=(Field(name="a"),)),
        ["'fod'", "food"],
    ),
    "two of one name": (lambda: square(kind(), fields=(Field(name="a"), Field(name="a"))), ["field", "['a']", "twice"]),
}  # fmt: skip


@pytest.mark.parametrize("what", WRONG)
def test_a_mistake_is_told(what):
    """The message names the rule and the value."""
    assert_refused(*WRONG[what])


def test_a_function_that_returns_no_numbers_is_told():
    """The message says what is expected and what came."""
    bad = Field(name="air", values=lambda x, y, t: np.zeros(len(x) + 1))
    with pytest.raises(EcologyError, match=r"'air'.*finite numbers, one for each of the 1 places"):
        start(square(kind(senses=(Gauge(field="air"),)), fields=(bad,)))


# ---- what is drawn -------------------------------------------------------------------------------


def test_fields_doors_and_patches_that_come_are_drawn_and_recorded(tmp_path):
    """A picture changes with the field, a recording has the closed doors of every tick, and no patch that is gone."""
    from ecology.agents import loop, make
    from ecology.observers import places, readback
    from ecology.observers.frame import frame
    from ecology.observers.rerun import RerunObserver

    arena = Arena(vertices=HALL.vertices, doors=(Door(name="d", start=(4, 0), end=(4, 8), period=4.0),))
    smell = Field(name="smell", sources={"agent": 1.0}, diffusion=0.1)
    food = Resource(name="food", count=2, stock=1.0, decay=0.5, gone_below=0.2)
    scenario = square(
        kind("agent", move("walk", 0.2), learner="random"), arena=arena, resources=(food,), fields=(smell,)
    )
    env = parallel_env(scenario, render_mode="rgb_array")
    minds = {"agent": make("random", env.groups["agent"], np.random.SeedSequence(0), {})}
    tick = env.reset_arrays(0)
    before = env.render()
    level = places.levels(env.world.model, env.state_view, places.grid_of(arena))["smell"]
    assert level.max() == 0
    observer = RerunObserver(path=tmp_path / "recording.rrd", every=1)
    loop.run(env, minds, tick, 12, [observer])
    assert places.levels(env.world.model, env.state_view, places.grid_of(arena))["smell"].max() > 100
    assert (env.render() != before).any()
    shown = readback.frames(tmp_path, scenario, 1)
    assert [len(f.doors) for f in shown] == [1 - (t % 4 < 2) for t in range(1, 13)]
    gone = [bool(np.isnan(f.patches).all()) for f in shown]
    assert gone == [t > 3 for t in range(1, 13)]
    assert len(frame(scenario, env.state_view).doors) == 0
