"""FixedSlots: the same agents all the time, whoever dies and is born in them."""

import dataclasses

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test

from ecology import Arena, Birth, Ecology, EcologyError, Need, Resource, Scenario, Species, consume, move, rest, turn
from ecology.fixed import FixedSlots

LIFE = 10  # ticks that a prey lives without food
BIRTH = 15  # tick from which on prey bear
SHAPES = [{}, {"flatten": True}, {"pad": True}, {"flatten": True, "pad": True}]
WALK, REST, EAT = 0, 1, 3  # of the prey


class Gift(Ecology):
    """A world in which every slot, empty or not, gets 7 more reward in every tick."""

    def step_arrays(self, actions):
        """Advance one tick."""
        tick = super().step_arrays(actions)
        return dataclasses.replace(tick, reward=tick.reward + 7.0)


@pytest.fixture
def world():
    """Return a maker of a world of three slots of prey, two of them lived in, and three hunters.

    Prey starve unless they eat; who has lived until BIRTH bears one offspring a tick while a slot is free.
    """

    def make(kind=Ecology, **options):
        hunger = Need(name="food", set_point=2.0, start=0.1 * LIFE - 0.05, decay=0.1, bounds=(0.0, 4.0), lethal=True)
        calm = Need(name="calm", set_point=1.0)
        prey = Species(
            name="prey",
            count=2,
            capacity=3,
            needs=(hunger, calm),
            actions=(move("walk", 0.1), rest(), turn("turn_left", 1.0), consume("grass", {"food": 0.1})),
            birth=Birth(rate=1e9, maturity=BIRTH - 0.5),
        )
        hunter = Species(
            name="hunter",
            count=3,
            needs=(calm,),
            actions=(move("walk", 0.1), turn("left", 1.0), rest()),
            senses=("heading",),
        )
        meadow = Resource(name="grass", position=(3.0, -3.0), radius=9.0)
        arena = Arena(vertices=((1, -5), (5, -5), (5, -1), (1, -1)))
        return kind(Scenario(name="meadow", arena=arena, resources=(meadow,), species=(prey, hunter)), **options)

    return make


def live(slots, ticks, actions=None):
    """Return what the last of some ticks brought; who is not in `actions` takes the action 1."""
    wanted = dict.fromkeys(slots.possible_agents, 1) | (actions or {})
    for _ in range(ticks):
        told = slots.step(wanted)
    return told


@pytest.mark.parametrize("shape", SHAPES)
def test_pettingzoo_accepts_it(world, shape):
    """PettingZoo's parallel_api_test passes while agents die, with and without a horizon."""
    parallel_api_test(FixedSlots(world(), **shape), num_cycles=3 * LIFE)
    parallel_api_test(FixedSlots(world(horizon=2 * LIFE), **shape), num_cycles=3 * LIFE)


@pytest.mark.parametrize("shape", SHAPES)
def test_all_that_is_observed_lies_in_its_space(world, shape):
    """Observations of the living and of empty slots lie in spaces that stay the same objects."""
    slots = FixedSlots(world(), **shape)
    spaces = {name: slots.observation_space(name) for name in slots.possible_agents}
    rng = np.random.default_rng(1)
    births = 0
    observations, _ = slots.reset(seed=1)
    for _ in range(2 * BIRTH):
        for name, space in spaces.items():
            assert slots.observation_space(name) is space
            assert space.contains(observations[name]), (name, observations[name], space)
        wanted = {name: int(rng.integers(slots.action_space(name).n)) for name in slots.agents}
        observations, *_, infos = slots.step(wanted | {"prey_slot_1": EAT})
        births += sum(info["born"] for info in infos.values())
    assert births > 0


def test_the_agents_are_the_slots(world):
    """There is one agent a slot, named after its species, before, during and after every life."""
    slots = FixedSlots(world())
    expected = ["prey_slot_0", "prey_slot_1", "prey_slot_2", "hunter_slot_0", "hunter_slot_1", "hunter_slot_2"]
    assert slots.possible_agents == expected
    slots.reset(seed=0)
    for _ in range(2 * BIRTH):
        told = live(slots, 1, {"prey_slot_1": EAT})
        assert slots.agents == expected
        assert all(list(part) == expected for part in told)


def test_the_living_are_told_what_the_world_tells(world):
    """Observation, mask, reward, drive and name of a living agent are the world's own, number for number."""
    slots, plain = FixedSlots(world()), world()
    rng = np.random.default_rng(1)
    (_, infos), tick = slots.reset(seed=3), plain.reset_arrays(seed=3)
    assert not any(info["born"] for info in infos.values())
    for _ in range(LIFE - 1):
        wanted = {name: int(rng.integers(slots.action_space(name).n)) for name in slots.agents}
        observations, rewards, _, _, infos = slots.step(wanted)
        tick = plain.step_arrays(np.array(list(wanted.values())))
        for slot, name in enumerate(slots.agents):
            if name == "prey_slot_2":  # empty
                continue
            species, row = name.split("_slot_")
            assert np.array_equal(observations[name]["observation"], tick.observations[species][int(row)])
            assert np.array_equal(observations[name]["action_mask"], tick.masks[species][int(row)])
            assert "action_mask" not in infos[name], "the mask is in the observation alone"
            assert rewards[name] == tick.reward[slot]
            assert infos[name]["drive"] == tick.drive[slot]
            assert infos[name]["closed"] == tick.closed[slot]
            assert infos[name]["agent"] == plain.name_of(slot)
            assert infos[name]["alive"]


@pytest.mark.parametrize("shape", SHAPES)
def test_a_dead_slot_is_black(world, shape):
    """From its death on a slot observes zeros, may only rest and gets 0; its death brings its last reward."""
    slots, plain = FixedSlots(world(Gift), **shape), world(Gift)
    slots.reset(seed=0)
    plain.reset_arrays(seed=0)
    eating, asked = {"prey_slot_1": EAT}, np.array([1, EAT, 1, 1, 1, 1])
    for tick in range(1, BIRTH):
        observations, rewards, terminations, truncations, infos = live(slots, 1, eating)
        truth = plain.step_arrays(asked)
        assert not any(terminations.values())
        assert not any(truncations.values())
        assert infos["prey_slot_0"]["alive"] == (tick < LIFE)
        assert infos["prey_slot_1"]["alive"]
        for name in ["prey_slot_2"] + ["prey_slot_0"] * (tick >= LIFE):
            info, seen = infos[name], observations[name]
            mask = seen[-slots.action_space(name).n :] if slots.flatten else seen["action_mask"]
            assert list(np.flatnonzero(mask)) == [REST]
            assert info["agent"] is None
            assert not info["alive"]
            assert info["drive"] == 0.0
            zeta = seen[: -len(mask)] if slots.flatten else seen["observation"]
            assert not zeta.any()
        assert truth.died[0] == (tick == LIFE)
        assert rewards["prey_slot_0"] == (truth.reward[0] if tick <= LIFE else 0.0)
        assert rewards["prey_slot_2"] == 0.0
        assert rewards["prey_slot_1"] == truth.reward[1] > 6.0


def test_what_an_empty_slot_does_is_ignored(world):
    """Whatever the dead are made to do, the living live the same."""
    worlds = [FixedSlots(world()), FixedSlots(world())]
    for slots, action in zip(worlds, (WALK, EAT), strict=True):
        slots.reset(seed=0)
        live(slots, LIFE)
        live(slots, LIFE, {"prey_slot_0": action, "prey_slot_1": action})
    a, b = (slots.env.state_view.arrays() for slots in worlds)
    assert not a["alive"][0]
    assert all(np.array_equal(a[name], b[name]) for name in a)


def test_a_newborn_starts_a_new_life_in_a_slot(world):
    """A birth is told once, without a reward, in the first free slot, and the newborn has a name that nobody had."""
    slots = FixedSlots(world(Gift))
    _, infos = slots.reset(seed=0)
    names = {info["agent"] for info in infos.values()}
    assert names == {"prey_0", "prey_1", "hunter_2", "hunter_3", "hunter_4", None}
    births = {BIRTH: ("prey_slot_0", "prey_5"), BIRTH + 1: ("prey_slot_2", "prey_6")}
    for tick in range(1, BIRTH + 5):
        observations, rewards, _, _, infos = live(slots, 1, {"prey_slot_1": EAT})
        born = [(name, infos[name]["agent"]) for name in slots.agents if infos[name]["born"]]
        assert born == ([births[tick]] if tick in births else [])
        for name, _ in born:
            assert infos[name]["alive"]
            assert observations[name]["observation"][0] == np.float32(0.1 * LIFE - 0.05 - 2.0)
            assert observations[name]["action_mask"].all()
            assert rewards[name] == 0.0
    assert infos["prey_slot_0"]["agent"] == "prey_5"
    assert rewards["prey_slot_0"] > 6.0


def test_padded_spaces_are_common_and_an_added_action_is_rest(world):
    """With `pad` all species have one space each of observations and actions; what is added is 0, closed, and rest."""
    slots, plain = FixedSlots(world(), pad=True), FixedSlots(world())
    assert len({str(slots.action_space(name)) for name in slots.possible_agents}) == 1
    first, last = slots.observation_space("prey_slot_0"), slots.observation_space("hunter_slot_0")
    assert first == last
    assert plain.observation_space("prey_slot_0") != plain.observation_space("hunter_slot_0")
    observations, _ = slots.reset(seed=0)
    plain_observations, _ = plain.reset(seed=0)
    seen, short = observations["hunter_slot_0"], plain_observations["hunter_slot_0"]
    for part in ("observation", "action_mask"):
        assert np.array_equal(seen[part][: len(short[part])], short[part])
        assert not seen[part][len(short[part]) :].any()
    before = slots.env.state_view.copy()
    live(slots, 1, {"hunter_slot_0": 3, "hunter_slot_1": WALK})
    after = slots.env.state_view
    moved = (after.position != before.position).any(axis=1)
    assert list(moved[3:]) == [False, True, False]
    assert list(after.heading[3:] != before.heading[3:]) == [False, False, True]


def test_a_flat_observation_is_zeta_and_the_mask(world):
    """With `flatten` an observation is one vector: zeta, then the action mask."""
    flat, deep = FixedSlots(world(), flatten=True), FixedSlots(world())
    (flat_seen, _), (deep_seen, _) = flat.reset(seed=0), deep.reset(seed=0)
    for name, seen in deep_seen.items():
        assert flat_seen[name].dtype == np.float32
        assert np.array_equal(flat_seen[name], np.concatenate([seen["observation"], seen["action_mask"]]))


def test_infos_without_names_are_numbers(world):
    """With `names` False everything in infos is a number or an array of them."""
    slots = FixedSlots(world(), names=False)
    _, infos = slots.reset(seed=0)
    assert all(np.asarray(value).dtype.kind in "fbiu" for info in infos.values() for value in info.values())


def test_the_horizon_truncates_all_and_no_step_follows(world):
    """At the world's horizon all slots, empty ones too, are truncated; only a reset leads on."""
    slots = FixedSlots(world(horizon=LIFE + 2))
    slots.reset(seed=0)
    *_, truncations, _ = live(slots, LIFE + 1)
    assert not any(truncations.values())
    _, _, terminations, truncations, _ = live(slots, 1)
    assert all(truncations.values())
    assert not any(terminations.values())
    assert slots.agents == []
    with pytest.raises(EcologyError, match="call reset"):
        live(slots, 1)
    slots.reset()
    *_, truncations, _ = live(slots, LIFE + 1)
    assert not any(truncations.values())
    assert slots.agents == slots.possible_agents


def test_resets_without_a_seed_are_a_series(world):
    """A reset without a seed derives one from the last, so that episodes differ and a series of them repeats."""
    slots, again = FixedSlots(world()), FixedSlots(world())
    series = [[each.reset(seed=seed)[0] for seed in (4, None, None)] for each in (slots, again)]
    seen = [[observations["prey_slot_0"]["observation"] for observations in episodes] for episodes in series]
    assert len({each.tobytes() for each in seen[0]}) == 3
    np.testing.assert_array_equal(*seen)
    np.testing.assert_array_equal(again.reset(seed=slots.seed)[0]["prey_slot_0"]["observation"], seen[0][-1])


@pytest.mark.parametrize(
    ("actions", "words"),
    [
        ({"prey_slot_0": 1}, ["every slot", "prey_slot_1"]),
        ({"prey_slot_9": 1}, ["no slot 'prey_slot_9'", "prey_slot_0"]),
        ({"prey_slot_0": 4}, ["prey_slot_0", "0 to 3", "4"]),
        ({"prey_slot_0": 0.5}, ["prey_slot_0", "whole number", "0.5"]),
        ({"prey_slot_0": [1, 2]}, ["prey_slot_0", "whole number"]),
        (1, ["dict"]),
    ],
)
def test_bad_actions_are_refused(world, actions, words):
    """A missing, unknown or impossible action is one error that says which."""
    slots = FixedSlots(world())
    slots.reset(seed=0)
    if isinstance(actions, dict) and words[0] != "every slot":
        actions = dict.fromkeys(slots.agents, 1) | actions
    with pytest.raises(EcologyError) as refused:
        slots.step(actions)
    assert all(word in str(refused.value) for word in words), refused.value


def test_only_a_world_is_wrapped(world):
    """What is no Ecology is refused."""
    with pytest.raises(EcologyError, match="takes an Ecology"):
        FixedSlots(FixedSlots(world()))
