"""Worlds, minds and a witness for tests of observers."""
# ruff: noqa: D102

# ruff: noqa: D102

import dataclasses
import errno
import warnings

import numpy as np
import pytest

import ecology
from ecology import Ecology, scenarios
from ecology.agents.base import Learner
from ecology.agents.loop import advance
from ecology.decision import Decision

TICKS = 60


class Wanderer(Learner):
    """Takes any open action; knows the distance to each food as its deviation function."""

    def act(self, observations, masks):
        return np.array([self.rng.choice(np.flatnonzero(row)) if row.any() else 0 for row in masks])

    def report(self):
        numbers = np.arange(self.size, dtype=float)
        return {"loss_f": numbers + 1.0, "loss_J": numbers + 10.0, "epsilon": np.full(self.size, 0.25)}

    def deviation(self, slot, zeta):
        if self.group.layout.names[6:8] != ("x", "y"):
            return None
        return np.hypot(zeta[:, 6] - 0.5, zeta[:, 7] - 4.25) - zeta[:, :4].sum(axis=1)


class Blind(Wanderer):
    """Has no deviation function and reports nothing."""

    def report(self):
        return {}

    def deviation(self, slot, zeta):
        return None


class Witness:
    """Keeps a copy of every state, and tries to write on what it is shown."""

    def begin(self, env, minds):
        self.states = [env.state_view.copy()]
        self.ticks = [None]

    def watch(self, state, tick, minds):
        with pytest.raises(ValueError, match="read-only"):
            state.position[0] = 0.0
        self.states.append(state.copy())
        self.ticks.append(tick)

    def end(self):
        pass


def one():
    """Return the paper's world."""
    return scenarios.load("paper")


def many():
    """Return three prey and two predators; the predators have other needs, and can die of one."""
    scenario = one()
    prey = dataclasses.replace(scenario.species[0], name="prey", count=3, position=None, heading=None)
    food, *others = prey.needs[:4]
    hunger = dataclasses.replace(food, start=0.02, lethal=True)  # dies after 10 ticks without
    predator = dataclasses.replace(
        prey, name="predator", count=2, needs=(hunger, *others, *prey.needs[4:]), senses=("position",)
    )
    return dataclasses.replace(scenario, species=(prey, predator))


def village(ticks_of_life=60):
    """Return prey that bear, give and feel for each other, predators that bite, and patches of grass."""
    ways = (ecology.move("walk", 0.3), ecology.turn("left", 0.8))
    energy = ecology.Need(name="energy", set_point=2.0, decay=0.02, bounds=(0.0, 4.0))
    prey = ecology.Species(
        name="prey",
        needs=(energy,),
        actions=(
            ecology.rest(),
            *ways,
            ecology.consume("grass", {"energy": 0.2}),
            ecology.give("prey", {"energy": 0.1}, reach=1.0),
            ecology.sleep(duration=3.0),
        ),
        count=12,
        capacity=16,
        birth=ecology.Birth(rate=0.1, threshold={"energy": 1.0}, cost={"energy": 0.2}),
        hazard=ecology.Hazard(rate=1.0 / ticks_of_life),
        view_range=2.0,
        neighbours=(ecology.Neighbours(count=1),),
        empathy=ecology.Empathy(weight=0.1),
    )
    predator = ecology.Species(
        name="predator",
        needs=(energy,),
        actions=(ecology.rest(), *ways, ecology.bite("prey", reach=0.8, gain={"energy": 1.0})),
        count=3,
        arrival=0.2,
        capacity=5,
        hazard=ecology.Hazard(rate=0.02),
    )
    grass = ecology.Resource(name="grass", count=6, radius=0.6, stock=3.0, growth=ecology.Growth(rate=0.05))
    return ecology.Scenario(
        name="village",
        arena=ecology.Arena(vertices=((0, 0), (5, 0), (5, 5), (0, 5))),
        resources=(grass,),
        species=(prey, predator),
        measures={"crowding": lambda state: float(np.count_nonzero(state.alive)) / 25.0},
    )


def live(scenario, *observers, mind=Wanderer, ticks=TICKS, close=True):
    """Return the world after `ticks` ticks that `observers` watched."""
    env = Ecology(scenario)
    tick = env.reset_arrays(7)
    minds = {g.name: mind(g, np.random.SeedSequence(5)) for g in env.groups.values()}
    for observer in observers:
        observer.begin(env, minds)
    advance(env, minds, tick, ticks, observers)
    for observer in observers if close else ():
        observer.end()
    return env


@pytest.fixture(autouse=True)
def strict():
    """Make bad input to the viewer's library an error instead of a warning."""
    import rerun as rr

    rr.set_strict_mode(True)


def rerun_observer(*args, serve=None, connect=None, resume=False, requests=None, **kwargs):
    """Return a RerunObserver; rerun is loaded by the tests that use it."""
    from ecology.observers.rerun import Recorded, RerunObserver, Viewers

    run = Recorded(resume=resume, requests=requests)
    return RerunObserver(*args, viewers=Viewers(serve, connect), run=run, **kwargs)


def column(path, entity, component):
    """Return ticks (n,) and the values at them of a component in a recording."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "RRD file has no footer")  # what is sent to a viewer has none
        reader = RrdReader(str(path))
    ticks, values = [], []
    chunks = reader.stream().filter(content=entity, components=component, is_static=False)
    for chunk in chunks:
        batch = chunk.to_record_batch()
        ticks += batch.column("tick").to_pylist()
        values += batch.column(component).to_pylist()
    order = np.argsort(ticks, kind="stable")
    return np.asarray(ticks)[order], [values[i] for i in order]


def told(path, entity, component="Scalars:scalars"):
    """Return what a recording holds of a component by tick, each as an array."""
    return {int(tick): np.array(value) for tick, value in zip(*column(path, entity, component), strict=True)}


def choice(**words):
    """Return a decision between a rest, a walk that is closed, and a meal."""
    numbers = np.arange(3.0)
    usual = {
        "options": ("rest", "walk", "eat"), "open": np.array([True, False, True]), "next_drive": numbers,
        "slope": numbers + 1, "score": numbers + 3, "taken": 0, "explored": False, "learned": True, "value": 2.5,
        "gamma": 0.9, "error": np.full(14, 0.5),
    }  # fmt: skip
    return Decision(**{**usual, **words})


def refused(**_):
    """Refuse to make a file."""
    raise OSError(errno.EROFS, "Read-only file system")
