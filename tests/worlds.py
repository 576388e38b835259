"""Worlds of several agents: bare ones to be worked out by hand, and one in which everything happens at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numba
import numpy as np
import pytest

from ecology import (
    Arena,
    Birth,
    Crowding,
    Door,
    Drift,
    Ecology,
    EcologyError,
    Empathy,
    Exposure,
    Fault,
    Field,
    Gauge,
    Growth,
    Hazard,
    Hearing,
    Need,
    Neighbours,
    Oscillation,
    Outcome,
    Rays,
    Relocation,
    Remains,
    Resource,
    Scenario,
    Season,
    Seeding,
    Species,
    Trace,
    World,
    act,
    bite,
    consume,
    drop,
    give,
    go_to,
    move,
    parallel_env,
    rest,
    sleep,
    take,
    turn,
)

SQUARE = ((0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0))
BAY = ((0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (4.4, 8.0), (4.4, 3.0), (3.6, 3.0), (3.6, 8.0), (0.0, 8.0))
WALK = 0.3


def kind(name: str = "agent", *acts: Any, **words: Any) -> Species:
    """Return a species of one need, food, that stays as it is; it rests and can do `acts`."""
    food = Need(name="food", set_point=2.0, bounds=(0.0, 4.0))
    return Species(**{"name": name, "needs": (food,), "actions": (rest(), *acts), "solid": False, **words})


def square(*species: Species, walls: bool = True, side: float = 8.0, **words: Any) -> Scenario:
    """Return an empty square with `species` in it."""
    corners = ((0.0, 0.0), (side, 0.0), (side, side), (0.0, side))
    return Scenario(**{"name": "square", "arena": Arena(vertices=corners, walls=walls), "species": species, **words})


def start(scenario: Scenario, seed: int = 0, **fields: Any) -> Ecology:
    """Return the world of `scenario`, started, with `fields` of the state put."""
    env = parallel_env(scenario)
    env.reset_arrays(seed=seed)
    if fields:
        env.set_state(**fields)
    return env


def ask(env: Ecology, **wanted: str) -> np.ndarray:
    """Return actions (N,): of each species named the action named, of the others rest."""
    actions = np.zeros(env.size, np.int64)
    for species, name in wanted.items():
        actions[env.groups[species].slots] = env.groups[species].actions.index(name)
    return actions


def signal(world: World, rng: np.random.Generator) -> Outcome:
    """Feed the prey that call, tire them of it, move one in ten callers to the west, and strike one in a hundred."""
    outcome = world.no_effect()
    rows, calls = world.slots["prey"], world.does("prey", "call")
    outcome.received[rows, world.column("prey", "food")] += 0.05 * world.dt * calls
    outcome.given[rows, world.column("prey", "calm")] += 0.02 * world.dt * calls
    drawn = rng.random((2, len(calls)))
    outcome.position = world.state.position.copy()
    outcome.position[rows, 0] -= 0.2 * (calls & (drawn[0] < 0.1))
    outside = ~world.inside(outcome.position)
    outcome.position[outside] = world.state.position[outside]
    outcome.killed[rows] = calls & (drawn[1] < 0.01)
    return outcome


def everything(
    *, walls: bool = True, dt: float = 1.0, vertices: Any = BAY, holes: Any = (), inner: Any = (), **prey: Any
) -> Scenario:
    """Return a world of three species with every word of a scenario in it; `prey` replaces words of the prey."""
    about = (
        rest(),
        move("walk", WALK),
        move("east", WALK, direction=0.0),
        turn("left", 0.7),
        turn("right", -0.7),
    )
    hunters = Species(
        name="hunter",
        count=4,
        capacity=9,
        needs=(
            Need(name="meat", set_point=3.0, decay=0.01, bounds=(0.0, 5.0), lethal=True),
            Need(name="sleepiness", set_point=0.0, decay=-0.01, bounds=(0.0, 4.0)),
        ),
        actions=(
            *about,
            bite("prey", reach=0.6, chance=0.4, gain={"meat": 1.0}, duration=4.0),
            sleep(duration=5.0, control={"sleepiness": -0.2}),
        ),
        collapse={"sleepiness": 3.0},
        birth=Birth(rate=0.05, threshold={"meat": 3.0}, cost={"meat": 1.5}, maturity=10.0),
        arrival=0.01,
        radius=0.15,
        view_angle=4.0,
        view_range=3.0,
        neighbours=(Neighbours(count=2, species=("prey",), heading=True), Neighbours(count=2)),
        empathy=Empathy(weight=0.3, within=2.0),
    )
    grazers = Species(
        **{
            "name": "prey",
            "count": 16,
            "capacity": 30,
            "needs": (
                Need(name="food", set_point=2.0, decay=0.02, bounds=(0.0, 4.0), lethal=True),
                Need(name="calm", set_point=1.0, leak=0.01, noise=0.02, floor=-0.5, bounds=(-1.0, 2.0)),
                Need(
                    name="dirt",
                    set_point=0.0,
                    decay=-0.01,
                    season=Season(amplitude=0.5, period=30.0),
                    ageing=0.01,
                    regulated=False,
                ),
            ),
            "actions": (
                *about,
                consume("grass", {"food": 0.2}),
                consume("fungus", {"food": 0.1, "calm": 0.1}, duration=3.0),
                go_to("grass", WALK),
                go_to("pond", WALK),
                consume("pond", {"calm": 0.1, "dirt": -0.2}),
                give("prey", {"food": 0.3}, reach=0.7, efficiency=0.8),
                give("ghost", {"calm": 0.1}, reach=0.7),
                act("call", control={"calm": -0.01}),
            ),
            "birth": Birth(rate=0.08, threshold={"food": 1.5}, cost={"food": 0.5}, maturity=5.0),
            "arrival": 0.02,
            "hazard": Hazard(rate=0.001, ageing=0.02),
            "view_range": 4.0,
            "view_angle": 5.0,
            "sees": ("grass", "fungus", "pond"),
            "opens": ("food", "dirt"),
            "neighbours": (Neighbours(count=3),),
            "empathy": Empathy(weight=0.4, form="average", needs={"calm": 0.5}, sight=True),
            "crowding": Crowding(within=0.5, control={"calm": -0.02}),
            "commitment": "committed",
            **prey,
        }
    )
    ghosts = Species(
        name="ghost",
        count=3,
        needs=(Need(name="calm", set_point=1.0, decay=0.01), Need(name="food", set_point=1.0, regulated=False)),
        actions=(*about, bite("hunter", reach=0.4, chance=0.1, damage={"meat": 0.5})),
        solid=False,
        empathy=Empathy(weight=0.5, species=("prey",), lesion="shuffled", lesion_at=20.0),
        drive_exponent=2.0,
        senses=("heading", "clock"),
    )
    return Scenario(
        name="everything",
        arena=Arena(vertices=vertices if walls else SQUARE, walls=inner if walls else False, holes=holes),
        resources=(
            Resource(
                name="grass", count=5, radius=0.6, stock=2.0, capacity=4.0, growth=Growth(kind="logistic", rate=0.05)
            ),
            Resource(name="fungus", radius=0.5, stock=1.0, motion=Relocation(), availability=0.8),
            Resource(name="pond", position=(2.0, 2.0), motion=Oscillation(to=(6.0, 2.0), period=50.0)),
            Resource(name="fly", stock=1.0, growth=Growth(rate=0.1), capacity=2.0, motion=Drift(spread=0.1)),
        ),
        species=(hunters, grazers, ghosts),
        dt=dt,
        day=40.0,
        rule=signal,
    )


def abundance(world: World, rng: np.random.Generator) -> Outcome:
    """Do what `signal` does; rot a patch, drop one, bear a hunter, slow and blind in turn, and keep a count of it."""
    outcome = signal(world, rng)
    state, count = world.state, int(world.memory["count"]) + 1
    outcome.memory = {"count": count, "where": world.memory["where"] * 0.9 + 0.1 * state.position[0]}
    outcome.stock = np.where(np.isfinite(state.stock), 0.01 - 0.02 * rng.random(len(state.stock)), 0.0)
    drawn = rng.uniform(0.5, 3.4, (2, 2))
    if count % 3 == 0:
        outcome.patches["berries"] = np.column_stack([drawn, [0.5, 1.0]])
    if count % 10 == 0:
        outcome.births["hunter"] = drawn[:1]
        outcome.parents["hunter"] = np.array([world.slots["hunter"].start])
    share = 0.5 + 0.5 * np.cos(count / 7.0)
    outcome.pace = np.full(len(state.alive), share)
    if world.doors:
        outcome.doors["hatch"] = count % 15 < 9
    outcome.sight = np.full(len(state.alive), 1.0 - 0.5 * share)
    return outcome


def _warm(x: np.ndarray, y: np.ndarray, time: float) -> np.ndarray:
    return 10.0 + x + 3.0 * np.sin(time / 9.0)


def coming(**words: Any) -> Scenario:
    """Return the world of everything, in which things spoil, come and go too."""
    world = everything(**words)
    hunters, prey, ghosts = world.species
    hunters = replace(hunters, remains=Remains(resource="carcass", needs={"meat": 0.5}))
    prey = replace(
        prey,
        remains=Remains(resource="carcass", needs={"food": 1.0, "calm": 0.5}, body=0.2),
        actions=(
            *(replace(a, emits={"alarm": 1.5}) if a.name == "call" else a for a in prey.actions),
            consume("berries", {"food": 0.3}),
            go_to("berries", WALK),
            take("berries", 0.4),
            drop("berries", 0.3),
            drop("berries", 0.3, into="larder", name="store"),
        ),
        carries={"berries": 1.0},
        sees=(*prey.sees, "berries", "carcass"),
    )
    resources = (
        *world.resources,
        Resource(name="larder", radius=0.8, stock=0.0, capacity=2.0),
        Resource(name="carcass", count=6, stock=0.0, capacity=1.5, decay=0.05, gone_below=0.1),
        Resource(name="berries", count=8, radius=0.5, stock=1.0, decay=0.02, gone_below=0.05, present=3,
                 growth=Growth(rate=0.01), seeding=Seeding(rate=0.02, offspring=0.02)),
    )  # fmt: skip
    fields = (
        Field(name="warmth", values=_warm, low=0.0, high=30.0, scale=10.0),
        Field(name="smell", diffusion=0.05, decay=0.02, sources={"hunter": 0.2, "carcass": 0.1}, cells=12),
        Field(name="mud", values=((0.0, 0.5), (1.0, 0.2))),
    )
    senses = (*hunters.senses, Gauge(field="smell", gradient=True), Trace(of="prey_1_distance", rate=0.05))
    hunters = replace(hunters, senses=senses, faults=(Fault(of="x", noise=0.1),))
    prey = replace(
        prey,
        senses=(
            *prey.senses,
            Gauge(field="warmth"),
            Gauge(field="smell", value=False, gradient=True),
            "load",
            Rays(range=3.0, count=5),
            Hearing(channel="alarm", range=2.5),
            Trace(of="alarm", rate=0.1),
        ),
        faults=(Fault(of="grass_distance", noise=0.2), Fault(of="grass_bearing", noise=0.1, failure=0.05, repair=0.2)),
        neighbours=(Neighbours(count=3, action=True, kin=True, identity=4),),
        exposures=(
            Exposure(field="warmth", reference=12.0, control={"calm": -0.001}),
            Exposure(field="mud", slowing=0.7, dimming=0.5),
        ),
    )
    arena = world.arena
    if not arena.torus:
        doors = (
            Door(name="gate", start=(3.6, 3.0), end=(3.6, 0.0), period=20.0),
            Door(name="hatch", start=(4.4, 3.0), end=(8.0, 3.0)),
        )
        arena = replace(arena, doors=doors)
    return replace(
        world, arena=arena, fields=fields, name="coming", species=(hunters, prey, ghosts), resources=resources,
        rule=abundance, memory={"count": 0, "where": (0.0, 0.0)},
    )  # fmt: skip


def assert_refused(build: Callable[[], object], words: Sequence[str]) -> None:
    """Hold `build` to raise an EcologyError whose message has all of `words`: the rule and the value."""
    with pytest.raises(EcologyError) as wrong:
        build()
    assert all(word in str(wrong.value) for word in words), wrong.value


def from_python(kernel: Any) -> Callable[..., Any]:
    """Return a function that calls a kernel which otherwise only other kernels call."""
    return numba.njit(lambda *args: kernel(*args))


# a file whose settings may be None
OPTIONAL = """
from ecology import Arena, Need, Scenario, Species, rest

def build(n=None, heading=False, decay=0.01):
    agent = Species(name="agent", needs=(Need(name="food", set_point=2.0, decay=decay),), actions=(rest(),))
    assert n is None or n == 3, n
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4))), species=(agent,))
"""
