"""The contract that every scenario in the folder keeps, a new file being found by itself; and that it can be broken."""

import copy
import dataclasses

import numpy as np
import pytest
from worlds import coming, everything, kind, square

import ecology
from ecology import Ecology, EcologyError, appearing, contract, life, resources, scenarios, senses
from ecology.physics import Physics

AGENT_TICKS = 1000  # of each life, but from 20 to 60 ticks; `ecology check` lives longer
CROWDS = {
    "everything": everything(),
    "everything without walls": everything(walls=False),
    "everything among walls": everything(
        holes=(((1.0, 5.0), (2.5, 5.0), (2.5, 6.5), (1.0, 6.5)), ((6.4, 0.6), (7.4, 1.6), (5.6, 1.5))),
        inner=(((3.6, 3.0), (3.6, 2.2)), ((0.0, 3.0), (1.5, 4.0), (2.6, 3.2)), ((5.5, 4.0), (6.5, 6.0))),
    ),
    "things that come and go": coming(),
    "things that come and go on a torus": coming(walls=False),
    "everything in small ticks": everything(dt=0.1),
    "everything in large ticks": everything(walls=False, dt=10.0),
}


def load(name):
    """Return a scenario that ships, or one of the crowds."""
    return CROWDS.get(name) or scenarios.load(name)


@pytest.mark.parametrize("holds", contract.CHECKS)
@pytest.mark.parametrize("name", [*scenarios.names(), *CROWDS])
def test_the_contract_is_kept(name, holds):
    """Every scenario, and a world in which everything happens, passes every check."""
    scenario = load(name)
    size = sum(species.slots for species in scenario.species)
    contract.CHECKS[holds](scenario, max(20, min(60, AGENT_TICKS // size)))


@pytest.mark.parametrize("name", scenarios.names())
def test_it_is_named_as_its_file_and_says_what_it_is(name):
    """A scenario bears the name of its file, keeps its settings, and its file begins with a sentence."""
    scenario = scenarios.load(name)
    assert scenario.name == name
    assert dict(scenario.settings) == scenarios.settings(name)
    assert scenarios.module(name).__doc__.strip()


def test_the_state_cannot_be_written():
    """The state shown to watchers refuses to be written."""
    env = ecology.parallel_env(everything())
    env.reset_arrays(seed=0)
    for values in env.state_view.arrays().values():
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 0


# ---- a check that cannot fail is none ----------------------------------------------------------


def counting_rule():
    """Return a rule that keeps a count of its own from tick to tick, and feeds by it."""
    count = [0]

    def rule(world, rng):
        count[0] += 1
        outcome = world.no_effect()
        outcome.received[:] = 0.001 * count[0]
        return outcome

    return rule


def unseeded_rule(world, rng):
    """Draw from elsewhere than the generator."""
    outcome = world.no_effect()
    outcome.received[:] = np.random.default_rng().random()
    return outcome


@pytest.mark.parametrize("rule", [counting_rule(), unseeded_rule])
def test_a_rule_that_is_not_pure_is_found(rule):
    """A rule with a memory or with chance of its own breaks exactly what rests on the seed."""
    scenario = square(kind(count=3), rule=rule)
    broken = {holds: contract.reason(error) for holds, error in contract.check(scenario, 40) if error}
    assert set(broken) == {
        "dicts and arrays give one trajectory, births and deaths included",
        "the same seed gives the same run",
        "a snapshot continues bit for bit",
        "a copy continues bit for bit",
    }
    assert "does a rule keep something from tick to tick" in broken["the same seed gives the same run"]


def test_what_a_rule_raises_is_told():
    """An error of the scenario's own code is the reason, with its kind, and the other checks go on."""

    def rule(world, rng):
        raise KeyError("fod")

    found = list(contract.check(square(kind(), rule=rule), 5))
    assert [holds for holds, _ in found] == list(contract.CHECKS)
    still = ("the smallest body can reach all of the arena", "patches that are gone offer nothing")  # here nobody lives
    lives = [error for holds, error in found if holds not in still]
    assert {contract.reason(error) for error in lives} == {"KeyError: 'fod'"}


def damaged(name, change):
    """Return a method `name` of the world whose result goes through `change`."""
    whole = getattr(Ecology, name)

    def method(self, *arguments, **words):
        return change(whole(self, *arguments, **words))

    return Ecology, name, method


def without_one(five):
    """Return the five dicts without an observation."""
    observations, *others = five
    return (dict(list(observations.items())[1:]), *others)


def never_over(five):
    """Return the five dicts with nobody truncated."""
    return (*five[:3], dict.fromkeys(five[3], False), five[4])


def other_rewards(five):
    """Return the five dicts with rewards a little larger."""
    return (five[0], {name: reward + 1e-9 for name, reward in five[1].items()}, *five[2:])


def other_drives(five):
    """Return the five dicts with other drives in the infos."""
    return (*five[:4], {name: info | {"drive": 0.0} for name, info in five[4].items()})


def first_action(tick):
    """Return a tick that tells of other actions than were done."""
    return dataclasses.replace(tick, action=tick.action * 0 + 1)


def kept_and_written():
    """Return a change that writes into the reward of the tick before."""
    last = []

    def change(tick):
        if last:
            last[-1].reward[:] = 7.0
        last.append(tick)
        return tick

    return change


def returning_names():
    """Return a method that gives newborns a serial that was there before."""
    whole = life.start_lives

    def start_lives(model, state, new, position, heading):
        whole(model, state, new, position, heading)
        state.serial[new] = 0

    return life, "start_lives", start_lives


def less_eaten(*arguments, whole=resources.eat):
    """Return meals that take a tenth less from the stocks than bodies ingest."""
    ingested, eaten = whole(*arguments)
    return ingested, eaten * 0.9


def other_chance(parts):
    """Return the parts of an environment with random numbers of its own."""
    world = copy.copy(parts["world"])
    world._rng = {name: np.random.default_rng(0) for name in world._rng}
    return parts | {"world": world}


def far_off(zeta):
    """Return observations outside of their space."""
    zeta[:, 0] = 1e6
    return zeta


SABOTAGE = {
    "PettingZoo's own test passes": lambda: damaged("step", without_one),
    "observations and rewards are finite, observations inside their space": lambda: (
        senses,
        "observe",
        lambda *arguments, whole=senses.observe: far_off(whole(*arguments)),
    ),
    "the action mask is honoured": lambda: damaged("step_arrays", first_action),
    "infos have the drive and closed actions": lambda: damaged("step", other_drives),
    "dicts and arrays give one trajectory, births and deaths included": lambda: damaged("step", other_rewards),
    "a horizon truncates every agent": lambda: damaged("step", never_over),
    "returned arrays never change": lambda: damaged("step_arrays", kept_and_written()),
    "the same seed gives the same run": lambda: (
        life,
        "beside",
        lambda ground, position, radius, rng: position + np.random.default_rng().normal(size=position.shape) / 99,
    ),
    "a snapshot continues bit for bit": lambda: damaged(
        "snapshot", lambda it: (it[0] | {"hold": it[0]["hold"] * 0}, it[1])
    ),
    "a copy continues bit for bit": lambda: damaged("__getstate__", other_chance),
    "no body leaves the arena or goes through a wall": lambda: (
        Physics,
        "move",
        lambda self, position, velocity, dt, alive: (position + 9 * velocity * dt, 0),
    ),
    "the smallest body can reach all of the arena": lambda: (
        contract,
        "split_room",
        lambda arena, radius, whole=contract.split_room: whole(arena, radius + 1.6),
    ),
    "every account closes": lambda: (resources, "eat", less_eaten),
    "names are never used again": returning_names,
    "patches that are gone offer nothing": lambda: (
        appearing,
        "absent",
        lambda model, stock: np.zeros(len(stock), bool),
    ),
}


@pytest.mark.parametrize("holds", contract.CHECKS)
def test_every_check_can_fail(holds, monkeypatch):
    """A world that is damaged in the right place breaks the check, with a reason."""
    monkeypatch.setattr(*SABOTAGE[holds]())
    with pytest.raises((EcologyError, AssertionError, UserWarning, KeyError)) as broken:
        contract.CHECKS[holds](coming(), 80)
    assert str(broken.value)
