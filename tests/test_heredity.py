"""Heredity: what children have from their parents, what it does, and that the Price equation closes."""

import dataclasses
import math

import numpy as np
import pytest
from worlds import ask, everything, kind, square, start

from ecology import Birth, EcologyError, Empathy, Hazard, Need, Trait, contract, heredity, move

MARK = Trait(name="mark", of="none", bounds=(-50.0, 50.0), start=0.0, spread=1.0)


def breeders(*traits, parents=1, count=40, capacity=80, **words):
    """Return a population that bears and dies by chance, and does nothing else."""
    birth = Birth(rate=0.1, parents=parents)
    return square(kind("body", move("walk", 0.1), count=count, capacity=capacity, birth=birth,
                       hazard=Hazard(rate=0.05), traits=traits or (MARK,), **words))  # fmt: skip


def generations(env, number, ticks):
    """Yield, per generation of so many ticks, the state before and after, and from whom everybody alive descends."""
    for _ in range(number):
        before = env.state_view
        sources = {int(s): (int(s),) for s in before.serial[before.alive]}
        first = dict(sources)
        for _ in range(ticks):
            tick = env.step_arrays(np.zeros(env.size, np.int64))
            now = env.state_view
            for slot in np.flatnonzero(tick.born).tolist():
                whom = [int(now.parent[slot])]
                if now.second is not None and now.second[slot] >= 0:
                    whom.append(int(now.second[slot]))
                # half of what each parent descends from; listed twice where both descend from one
                several = [sources[w] * (math.lcm(*(len(sources[x]) for x in whom)) // len(sources[w])) for w in whom]
                sources[int(now.serial[slot])] = tuple(source for each in several for source in each)
        now = env.state_view
        yield before, now, {s: sources[s] for s in map(int, now.serial[now.alive])}, first


def equation(before, now, sources, column=0):
    """Return the Price equation of a trait between two states."""
    z = {int(s): float(t) for s, t in zip(before.serial[before.alive], before.trait[before.alive, column], strict=True)}
    after = {int(s): (float(t), sources[int(s)])
             for s, t in zip(now.serial[now.alive], now.trait[now.alive, column], strict=True)}  # fmt: skip
    return heredity.price(z, after)


@pytest.mark.parametrize("parents", [1, 2])
def test_the_price_equation_closes_in_every_generation(parents):
    """The change of the mean is selection + transmission to 1e-12, for every trait, with mutation and two parents."""
    traits = (MARK, dataclasses.replace(MARK, name="other", mutation=0.3))
    env = start(breeders(*traits, parents=parents), 4)
    changes = []
    for before, now, sources, _ in generations(env, 20, 4):
        for column in range(2):
            found = equation(before, now, sources, column)
            mean = now.trait[now.alive, column].mean() - before.trait[before.alive, column].mean()
            assert found.change == pytest.approx(mean, abs=1e-14)
            assert abs(found.selection + found.transmission - found.change) < 1e-12
            changes.append(abs(found.change))
            if parents == 1 and column == 0:
                assert abs(found.transmission) < 1e-12  # no mutation: children are as their parents
    assert max(changes) > 0.05


def test_a_wrong_parent_is_noticed():
    """Without mutation, nothing is transmitted but what is: a child that is ascribed to another is a change."""
    env = start(breeders(), 4)
    before, now, sources, _ = next(iter(generations(env, 1, 10)))
    child = next(serial for serial, whom in sources.items() if whom != (serial,))
    other = next(int(s) for s in before.serial[before.alive] if int(s) != sources[child][0])
    assert abs(equation(before, now, {**sources, child: (other,)}).transmission) > 1e-6
    with pytest.raises(EcologyError, match="has no parent"):
        equation(before, now, {**sources, child: (10_000,)})


def test_a_child_is_its_parent_plus_a_mutation():
    """Over many births the change has mean 0 and the mutation's standard deviation; without one it is 0."""
    traits = (dataclasses.replace(MARK, mutation=0.5), dataclasses.replace(MARK, name="same"))
    env = start(breeders(*traits, count=100, capacity=200), 1)
    changes, kept = [], {}
    for _ in range(150):
        now = env.state_view
        kept.update({int(s): now.trait[i] for i, s in enumerate(now.serial) if now.alive[i]})
        tick = env.step_arrays(np.zeros(env.size, np.int64))
        now = env.state_view
        changes += [now.trait[slot] - kept[int(now.parent[slot])] for slot in np.flatnonzero(tick.born).tolist()]
    changes = np.array(changes)
    n = len(changes)
    assert n > 300
    assert (changes[:, 1] == 0).all()
    assert abs(changes[:, 0].mean()) < 4 * 0.5 / math.sqrt(n)
    assert changes[:, 0].std() == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(2 * n))


def test_bounds_hold():
    """However large the mutation, no trait leaves its bounds, and some lie on them."""
    trait = Trait(name="mark", of="none", bounds=(0.0, 1.0), mutation=3.0, spread=3.0)
    env = start(breeders(trait), 2)
    for _ in range(60):
        env.step_arrays(np.zeros(env.size, np.int64))
        alive = env.state_view.trait[env.state_view.alive]
        assert ((alive >= 0) & (alive <= 1)).all()
    assert set(np.unique(alive)) >= {0.0, 1.0}


def test_each_of_two_parents_gives_about_half_of_the_traits():
    """With 30 markers and no mutation every value is one parent's, and each gives between a quarter and the rest."""
    traits = [dataclasses.replace(MARK, name=f"m{i}") for i in range(30)]
    env = start(breeders(*traits, parents=2), 3)
    shares, kept = [], {}
    for _ in range(60):
        now = env.state_view
        kept.update({int(s): now.trait[i] for i, s in enumerate(now.serial) if now.alive[i]})
        tick = env.step_arrays(np.zeros(env.size, np.int64))
        now = env.state_view
        for slot in np.flatnonzero(tick.born).tolist():
            assert now.second[slot] >= 0
            mother, father = kept[int(now.parent[slot])], kept[int(now.second[slot])]
            assert ((now.trait[slot] == mother) | (now.trait[slot] == father)).all()
            if (mother != father).all():
                shares.append((now.trait[slot] == mother).mean())
    assert len(shares) > 20
    assert np.mean(shares) == pytest.approx(0.5, abs=4 * 0.5 / math.sqrt(30 * len(shares)))


def test_the_mate_is_the_nearest_that_is_fit():
    """Of three, the nearest one is the second parent; one that is unfit is no mate, and beyond mates_within none is."""
    for within, food, expected in (
        (math.inf, 2.0, {0: 1, 1: 0, 2: 1}),
        (math.inf, 0.5, {0: 2, 2: 0}),
        (1.5, 2.0, {0: 1, 1: 0}),
    ):
        birth = Birth(rate=1e9, parents=2, mates_within=within, threshold={"food": 1.0})
        env = start(
            square(kind("body", count=3, capacity=9, birth=birth, traits=(MARK,))),
            position=np.array([[1.0, 1.0], [2.0, 1.0], [5.0, 1.0], *[[4.0, 4.0]] * 6]),
            internal=np.array([[2.0], [food], [2.0], *[[0.0]] * 6]),
        )  # fmt: skip
        tick = env.step_arrays(np.zeros(9, np.int64))
        now = env.state_view
        assert {int(now.parent[s]): int(now.second[s]) for s in np.flatnonzero(tick.born)} == expected


def bodies(*traits, **words):
    """Return two bodies with other traits each."""
    need = Need(name="food", set_point=2.0, decay=0.01, bounds=(0.0, 4.0), set_range=(0.5, 3.5))
    return square(kind("body", move("walk", 0.1), needs=(need,), count=2, traits=traits, heading=0.0, **words))


def test_every_body_has_its_own_decay_speed_and_set_point():
    """What each loses and walks in a tick, and what it feels, is by its own trait."""
    traits = (
        Trait(name="burn", of="food.decay", bounds=(0.0, 0.1)),
        Trait(name="legs", of="speed", bounds=(0.5, 3.0)),
        Trait(name="target", of="food.set_point", bounds=(1.0, 3.0), start=1.5),
    )
    env = start(bodies(*traits), position=np.array([[1.0, 1.0], [1.0, 5.0]]))
    assert env.state_view.trait.tolist() == [[0.01, 1.0, 1.5]] * 2
    assert env.state_view.set_point.tolist() == [[1.5], [1.5]]
    trait = np.array([[0.03, 2.0, 1.5], [0.05, 0.5, 1.5]])
    env.set_state(trait=trait)
    tick = env.step_arrays(ask(env, body="walk"))
    now = env.state_view
    assert now.internal[:, 0] == pytest.approx([1.97, 1.95])
    assert now.position[:, 0] == pytest.approx([1.2, 1.05])
    assert tick.drive == pytest.approx(np.sqrt(0.001 + (now.internal[:, 0] - 1.5) ** 2))
    assert tick.observations["body"][:, 0] == pytest.approx(now.internal[:, 0] - 1.5)


def test_what_the_scenario_does_not_have_can_be_inherited():
    """A leak, an ageing and a noise of 0 in the scenario are at work where a body has its own."""
    for of, low, value, expected in (("leak", 0.0, 0.1, 1.79), ("ageing", 0.0, 50.0, 1.98)):
        env = start(bodies(Trait(name="t", of=f"food.{of}", bounds=(low, 100.0 if of == "ageing" else 0.5))))
        env.set_state(trait=np.array([[value], [0.0]]))
        for _ in range(1 if of == "leak" else 2):
            env.step_arrays(ask(env, body="rest"))
        now = env.state_view.internal[:, 0]
        assert now[0] == pytest.approx(expected if of == "leak" else 1.99 - 0.01 * 51)
        assert now[1] == pytest.approx(1.99 if of == "leak" else 1.98)
    env = start(bodies(Trait(name="t", of="food.noise", bounds=(0.0, 1.0))))
    env.set_state(trait=np.array([[0.5], [0.0]]))
    env.step_arrays(ask(env, body="rest"))
    assert env.state_view.internal[1, 0] == pytest.approx(1.99)
    assert abs(env.state_view.internal[0, 0] - 1.99) > 1e-3


def test_kin_are_those_of_either_parent():
    """With two parents, both feel their child, and siblings of one shared parent feel each other."""
    kin = Empathy(weight=1.0, kin=True, perceived=False)
    env = start(breeders(MARK, parents=2, count=4, capacity=8, empathy=kin))
    while not (env.state_view.second >= 0).any():
        env.step_arrays(np.zeros(8, np.int64))
    now = env.state_view
    child = int(np.argmax(now.second >= 0))
    weights, slots = env.coupling("body")
    felt = {int(now.serial[slots[j]]) for j in np.flatnonzero(weights[child]) if slots[j] != child}
    living = set(now.serial[now.alive].tolist())
    assert {int(now.parent[child]), int(now.second[child])} & living <= felt


def test_every_body_has_its_own_weight_of_empathy():
    """In the sum form the drive is the own one plus one's own weight times the other's."""
    trait = Trait(name="care", of="empathy.weight", bounds=(0.0, 1.0))
    env = start(bodies(trait, empathy=Empathy(weight=0.3)))
    tick = env.set_state(internal=np.array([[1.0], [3.0]]), trait=np.array([[0.25], [0.0]]))
    own = math.sqrt(0.001 + 1.0)
    assert tick.drive == pytest.approx([1.25 * own, own])
    assert env.coupling("body")[0] == pytest.approx(np.array([[1.0, 0.25], [0.0, 1.0]]))


def test_newcomers_and_settlers_begin_as_founders_do():
    """Who arrives or is put into the world has a trait drawn around its start, and its own set point."""
    target = Trait(name="target", of="food.set_point", bounds=(1.0, 3.0), start=2.5, spread=0.2)
    world = bodies(target, capacity=40, arrival=1.0)
    env = start(world)
    for _ in range(20):
        env.step_arrays(ask(env, body="rest"))
    _, slot = env.settle("body", (1.0, 1.0))
    now = env.state_view
    values = now.trait[now.alive, 0]
    assert len(values) > 10
    assert values.mean() == pytest.approx(2.5, abs=4 * 0.2 / math.sqrt(len(values)))
    assert len(np.unique(values)) == len(values)
    assert (now.set_point[now.alive, 0] == values).all()
    assert now.alive[slot]


@pytest.mark.parametrize(
    ("trait", "rule"),
    [
        (Trait(name="t", of="fod.decay", bounds=(0, 1)), "Did you mean 'food.decay'"),
        (Trait(name="t", of="food.bounds", bounds=(0, 1)), "cannot be inherited"),
        (Trait(name="t", of="food.decay", bounds=(0.5, 1)), "outside its bounds"),
        (Trait(name="t", of="food.set_point", bounds=(0, 3)), "wider set_range"),
        (Trait(name="t", of="speed", bounds=(-1, 3)), "must lie from 0"),
        (Trait(name="t", of="speed", bounds=(0, 1e4)), "moves a body by at most"),
        (Trait(name="t", of="empathy.weight", bounds=(0, 1)), "sum form"),
        (Trait(name="t", of="none", bounds=(0, 1), start=2.0), "outside its bounds"),
    ],
)
def test_traits_that_cannot_be_are_refused(trait, rule):
    """A trait is of a number that its species has, and its bounds are such that the number may have."""
    with pytest.raises(EcologyError, match=rule):
        bodies(trait)


def test_words_that_cannot_be_are_refused():
    """Bounds rise, mutation and spread are at least 0, names and fields are told once; there are 1 or 2 parents."""
    for words in ({"bounds": (1, 0)}, {"mutation": -1.0}, {"spread": -1.0}, {"bounds": (0, math.inf)}):
        with pytest.raises(EcologyError, match="trait 't'"):
            Trait(**{"name": "t", "of": "none", "bounds": (0, 1), **words})
    with pytest.raises(EcologyError, match="appear twice"):
        bodies(MARK, MARK)
    for words in ({"parents": 3}, {"mates_within": 1.0}, {"parents": 2, "mates_within": 0.0}):
        with pytest.raises(EcologyError, match="Birth"):
            Birth(rate=1.0, **words)


def evolving(**words):
    """Return the world in which everything happens, with heredity in prey, of two parents, and in hunters."""
    world = everything(**words)
    hunters, grazers, ghosts = world.species
    food, *others = grazers.needs
    traits = (
        Trait(name="target", of="food.set_point", bounds=(1.2, 3.2), mutation=0.1, spread=0.2),
        Trait(name="legs", of="speed", bounds=(0.5, 1.5), mutation=0.1),
        Trait(name="burn", of="food.decay", bounds=(0.0, 0.1), mutation=0.01),
        Trait(name="mark", of="none", bounds=(0.0, 1.0), spread=0.3),
    )
    birth = dataclasses.replace(grazers.birth, parents=2, mates_within=5.0)
    needs = (dataclasses.replace(food, set_range=(1.0, 3.5)), *others)
    grazers = dataclasses.replace(grazers, needs=needs, traits=traits, birth=birth)
    care = Trait(name="care", of="empathy.weight", bounds=(0.0, 1.0), mutation=0.1)
    return dataclasses.replace(world, species=(dataclasses.replace(hunters, traits=(care,)), grazers, ghosts))


@pytest.mark.parametrize("holds", contract.CHECKS)
def test_evolving_worlds_keep_the_contract(holds):
    """With traits, mates and mutations on, accounts close, and snapshots and copies go on bit for bit."""
    contract.CHECKS[holds](evolving(), 80)


def test_traits_are_recorded(tmp_path):
    """Metrics have a column per trait, the summary its mean, the recording its mean and its histogram over time."""
    from ecology.agents import loop, make
    from ecology.lab.runs.run_summary import RunSummary
    from ecology.observers import census
    from ecology.observers.readback import chunks, column
    from ecology.observers.recorder import Recorder, read
    from ecology.observers.rerun import RerunObserver

    world = evolving()
    env = start(world)
    minds = {name: make("random", group, np.random.SeedSequence(1), {}) for name, group in env.groups.items()}
    totals = RunSummary(world, env, minds)
    watchers = (totals, Recorder(tmp_path / "m.parquet", 5), RerunObserver(tmp_path / "r.rrd", every=5))
    loop.run(env, minds, env.reset_arrays(0), 20, watchers)
    now, rows = env.state_view, env.groups["prey"].slots
    living = now.trait[rows][now.alive[rows]]
    table = {name: np.array(column) for name, column in read(tmp_path / "m.parquet").to_pydict().items()}
    last = (table["tick"] == 20) & (table["species"] == "prey")
    assert table["traits.burn"][last].astype(float) == pytest.approx(living[:, 2], rel=1e-6)
    assert [*table["traits.burn"][table["species"] == "ghost"]] == [None] * (table["species"] == "ghost").sum()
    told = totals.summary()["population"]["prey"]["traits"]
    assert told["target"]["mean"] == pytest.approx(living[:, 0].mean())
    names = census.plotted_names(world)
    shown = list(column(tmp_path / "r.rrd", "/population/measures", "Scalars:scalars").values())[-1]
    assert shown[names.index("mean legs of prey")] == pytest.approx(living[:, 1].mean())
    assert any(chunk.num_rows for chunk in chunks(tmp_path / "r.rrd", content="/population/traits/prey/legs"))
    told_of = column(tmp_path / "r.rrd", "/events/prey", "TextLog:text").values()
    births = [line for lines in told_of for line in lines if "child of" in line]
    assert births
    assert all(" and prey_" in line for line in births)


def test_worlds_without_traits_hold_nothing_more():
    """No array, no random stream and no factor is there without heredity."""
    env = start(everything())
    now, model = env.state_view, env.world.model
    assert (now.trait, now.partner, now.second, model.heredity, model.mates) == (None, None, None, None, False)
    assert heredity.STREAM not in env.snapshot()[1]["rng"]
