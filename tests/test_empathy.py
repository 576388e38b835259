"""Affective empathy against its two formulas, by hand."""

import itertools
import math

import numpy as np
import pytest
from worlds import BAY, everything, kind, square, start

import ecology
from ecology import Arena, Birth, EcologyError, Empathy, Need, contract, physiology
from ecology.agents.base import drive_terms

EPSILON = 0.001
FAR = [[1.0, 1.0], [2.0, 1.0], [7.0, 7.0]]  # two near each other and one far away


def d(*delta, epsilon=EPSILON, exponent=1.0):
    """Return the drive of the deviations `delta`."""
    return (epsilon + sum(x * x for x in delta)) ** (exponent / 2)


def colony(*deltas, **words):
    """Return the world of agents with the set points 2 and 1 and the deviations `deltas` (n, 2), far apart in a row."""
    needs = (Need(name="food", set_point=2.0, bounds=(-9.0, 9.0)), Need(name="calm", set_point=1.0, bounds=(-9.0, 9.0)))
    put = {name: words.pop(name) for name in ("position", "heading", "alive", "serial", "parent") if name in words}
    scenario = square(kind(needs=needs, count=len(deltas), **words))
    return start(scenario, internal=np.add(deltas, [2.0, 1.0]), **put)


# ---- the two forms ---------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_sum_form(exponent):
    """drive_i = d(delta_i) + sum_j w d(delta_j), over the others."""
    deltas = [(1.0, 0.0), (0.0, -2.0), (3.0, 4.0)]
    env = colony(*deltas, empathy=Empathy(weight=0.3), drive_exponent=exponent)
    own = [d(*delta, exponent=exponent) for delta in deltas]
    assert env.state_view.own_drive == pytest.approx(own)
    assert env.state_view.drive == pytest.approx([a + 0.3 * (sum(own) - a) for a in own])


def test_the_average_form():
    """drive_i = d((1 - w) delta_i + w mean of the others' delta), need by need."""
    env = colony((1.0, 0.0), (0.0, -2.0), (-2.0, 4.0), empathy=Empathy(weight=0.4, form="average"))
    assert env.state_view.drive == pytest.approx(
        [
            d(0.6 * 1 + 0.4 * -1.0, 0.4 * 1.0),
            d(0.4 * -0.5, 0.6 * -2 + 0.4 * 2.0),
            d(0.6 * -2 + 0.4 * 0.5, 0.6 * 4 - 0.4),
        ]
    )


def test_weight_zero_is_no_empathy_and_weight_one_is_all():
    """With w = 0 the drive is one's own in both forms; with w = 1 the average is of the others alone."""
    deltas = [(1.0, 0.0), (0.0, -2.0)]
    for form in ("sum", "average"):
        env = colony(*deltas, empathy=Empathy(weight=0.0, form=form))
        assert env.state_view.drive == pytest.approx([d(1.0), d(2.0)])
    env = colony(*deltas, empathy=Empathy(weight=1.0, form="average"))
    assert env.state_view.drive == pytest.approx([d(2.0), d(1.0)])


def test_needs_weigh_differently():
    """Sum: a need of others that counts half is half in their d. Average: w_ij of it is half, w_ii the rest."""
    deltas = [(1.0, 3.0), (-1.0, 2.0)]
    env = colony(*deltas, empathy=Empathy(weight=0.4, needs={"calm": 0.5, "food": 0.0}))
    assert env.state_view.drive[0] == pytest.approx(d(1.0, 3.0) + 0.4 * d(0.0, 1.0))
    env = colony(*deltas, empathy=Empathy(weight=0.4, form="average", needs={"calm": 0.5, "food": 0.0}))
    assert env.state_view.drive[0] == pytest.approx(d(1.0, 0.8 * 3 + 0.2 * 2))


def test_the_matrix_is_a_factor_of_the_weight():
    """w_ij = weight m_ij, and m_ii counts for nothing; in the average form m weighs the others against each other."""
    deltas, matrix = [(1.0, 0.0), (0.0, -2.0), (3.0, 4.0)], ((5.0, 1.0, 0.0), (2.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    env = colony(*deltas, empathy=Empathy(weight=0.3, matrix=matrix))
    a, b, c = (d(*delta) for delta in deltas)
    assert env.state_view.drive == pytest.approx([a + 0.3 * b, b + 0.6 * a + 0.3 * c, c])
    env = colony(*deltas, empathy=Empathy(weight=0.3, form="average", matrix=matrix))
    middle = d(0.3 * (2 * 1 + 3) / 3, 0.7 * -2 + 0.3 * 4 / 3)
    assert env.state_view.drive == pytest.approx([d(0.7, 0.3 * -2), middle, d(3.0, 4.0)])


def test_nobody_felt_is_oneself_alone():
    """Alone, or with all others dead, both forms are d(delta)."""
    for form in ("sum", "average"):
        env = colony((1.0, 0.0), (5.0, 5.0), empathy=Empathy(weight=0.5, form=form), alive=[True, False])
        assert env.state_view.drive[0] == pytest.approx(d(1.0))


def test_another_species_is_felt_by_the_names_of_its_needs():
    """Feeling another species, its columns in another order, one need unknown to me and one of mine unknown to it."""
    mine = (Need(name="food", set_point=2.0), Need(name="calm", set_point=1.0))
    theirs = (Need(name="wool", set_point=1.0), Need(name="food", set_point=1.0), Need(name="dirt", set_point=0.0))
    put = {"internal": [[1.5, 3.0, 0.0], [4.0, 0.5, 0.0], [1.0, 3.0, 2.0]]}
    for form, drive in (
        ("average", d(0.5 * -0.5 + 0.5 * (-0.5 + 2.0) / 2, 2.0)),
        ("sum", d(-0.5, 2.0) + 0.5 * (d(3.0, -0.5) + d(2.0, 2.0))),
    ):
        dog = kind("dog", needs=mine, empathy=Empathy(weight=0.5, species=("sheep",), form=form))
        env = start(square(dog, kind("sheep", count=2, needs=theirs)), **put)
        assert env.state_view.drive[0] == pytest.approx(drive)
        assert env.state_view.drive[1:] == pytest.approx([d(3.0, -0.5), d(2.0, 2.0)])  # the sheep feel nothing


def test_a_need_that_is_not_regulated_is_not_felt():
    """What counts in nobody's drive does not come in through another's."""
    needs = (Need(name="food", set_point=2.0), Need(name="dirt", set_point=0.0, regulated=False))
    for form, drive in (("sum", d(1.0) + 0.5 * d(2.0)), ("average", d(0.5 * -1 + 0.5 * -2))):
        scenario = square(kind(needs=needs, count=2, empathy=Empathy(weight=0.5, form=form)))
        env = start(scenario, internal=[[1.0, 7.0], [0.0, 9.0]])
        assert env.state_view.drive[0] == pytest.approx(drive)


# ---- conditions ------------------------------------------------------------------------------


def felt(env):
    """Return who is felt in the sum form, each marked by a deviation of its own power of ten, (n,)."""
    drives = env.state_view.own_drive
    felt = env.state_view.felt[:, 0]
    found = []
    for value in felt:
        sets = [s for r in range(len(drives) + 1) for s in itertools.combinations(range(len(drives)), r)]
        found.append(next(s for s in sets if math.isclose(sum(drives[list(s)]), value, abs_tol=1e-9)))
    return found


MARKS = [(0.1, 0.0), (1.0, 0.0), (5.0, 0.0)]


def test_within_a_distance():
    """Only those at most that far are felt."""
    env = colony(*MARKS, empathy=Empathy(weight=1.0, within=1.0), position=FAR)
    assert felt(env) == [(1,), (0,), ()]
    env = colony(*MARKS, empathy=Empathy(weight=1.0, within=0.999), position=FAR)
    assert felt(env) == [(), (), ()]


def test_in_sight():
    """Only those in one's own view field are felt, with no wall between; seeing is not mutual."""
    words = {"empathy": Empathy(weight=1.0, sight=True), "view_angle": 1.0, "view_range": 4.0}
    env = colony(*MARKS, **words, position=FAR, heading=[0.0, 0.0, 0.0])
    assert felt(env) == [(1,), (), ()]
    scenario = square(kind(count=2, empathy=Empathy(weight=1.0, sight=True)), arena=Arena(vertices=BAY))
    for y, seen in ((5.0, False), (2.0, True)):
        env = start(scenario, position=[[3.0, y], [5.0, y]])
        assert (env.state_view.felt[:, 0] > 0).tolist() == [seen, seen]


def test_kin():
    """Parent, child and sibling are kin; founders are not, and a slot's former owner leaves no kin behind."""
    marks = [(0.025 * 3**i, 0.0) for i in range(6)]
    env = colony(
        *marks,
        empathy=Empathy(weight=1.0, kin=True),
        birth=Birth(rate=1e-9),
        serial=[0, 1, 7, 8, 9, 12],
        parent=[-1, -1, 0, 0, 7, 3],  # 7 and 8 are children of 0, 9 of 7; the parent of 12, number 3, is long gone
    )
    assert felt(env) == [(2, 3), (), (0, 3, 4), (0, 2), (2,), ()]


def test_conditions_hold_together():
    """Kin within the distance: both must be so."""
    env = colony(
        *MARKS, empathy=Empathy(weight=1.0, kin=True, within=2.0), position=FAR, serial=[0, 1, 2], parent=[-1, -1, 0]
    )
    assert felt(env) == [(), (), ()]
    env.set_state(position=[FAR[0], FAR[2], FAR[1]])
    assert felt(env) == [(2,), (), (0,)]


# ---- lesions ---------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["sum", "average"])
def test_lesions_begin_at_their_time(form):
    """Off is one's own drive from then on, sham changes nothing, shuffled feels as much of someone else."""
    marks = [(1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (6.0, 0.0)]
    matrix = tuple(tuple(float(j == (i ^ 1)) for j in range(4)) for i in range(4))  # partners by twos
    drives = {}
    for lesion in ("none", "sham", "off", "shuffled"):
        empathy = Empathy(weight=0.5, form=form, matrix=matrix, lesion=lesion, lesion_at=3.0)
        env = colony(*marks, empathy=empathy)
        drives[lesion] = [env.state_view.drive.copy()]
        for _ in range(5):
            env.step_arrays(np.zeros(4, np.int64))
            drives[lesion].append(env.state_view.drive.copy())
    drives = {lesion: np.array(series) for lesion, series in drives.items()}
    whole = drives["none"][0]
    assert np.array_equal(drives["sham"], drives["none"])
    for lesion in ("off", "shuffled"):
        assert np.array_equal(drives[lesion][:3], drives["none"][:3])
        assert (drives[lesion][3:] != whole).all()
    own = np.array([d(*mark) for mark in marks])
    assert np.allclose(drives["off"][3:], own)
    for i in range(4):  # of exactly one other, not the partner and not oneself
        others = [j for j in range(4) if j not in (i, i ^ 1)]
        wrong = [own[i] + 0.5 * own[j] if form == "sum" else d(0.5 * marks[i][0] + 0.5 * marks[j][0]) for j in others]
        assert any(np.allclose(drives["shuffled"][3:, i], value) for value in wrong)


@pytest.mark.parametrize("n", [3, 4, 7])
def test_shuffling_keeps_the_weights_of_all_who_feel(n):
    """Each row's weights are as large as before, on the living only, and none on oneself."""
    rng = np.random.default_rng(n)
    matrix = tuple(tuple(row) for row in rng.uniform(0.1, 1, (n, n)).round(3))
    env = colony(*[(1.0, 0.0)] * n, empathy=Empathy(weight=1.0, matrix=matrix, lesion="shuffled"))
    for alive in [np.ones(n, bool), np.arange(n) != 1]:
        env.set_state(alive=alive)
        coupling = env.world.model.couplings[0]
        weight = ecology.empathy.matrix(
            coupling, env.state_view, env.world.model.plane, None, None, env.world.lesion_order
        )
        before = coupling.weight * alive * alive[:, None]
        assert weight.sum(axis=1) == pytest.approx(before.sum(axis=1))
        assert (np.diag(weight) == 0).all()
        assert (weight[:, ~alive] == 0).all()


# ---- the coupling that is shown ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("form", "weights"),
    [
        ("sum", [[1.0, 0.5, 0.5], [0.5, 1.0, 0.5], [0.5, 0.5, 1.0]]),
        ("average", [[0.5, 0.25, 0.25], [0.25, 0.5, 0.25], [0.25, 0.25, 0.5]]),
    ],
)
def test_the_coupling_is_what_is_used(form, weights):
    """In the average form the others have the weight together; one's own weight is on the diagonal in both forms."""
    env = colony(*[(1.0, 0.0)] * 3, empathy=Empathy(weight=0.5, form=form))
    found, slots = env.coupling("agent")
    assert found.tolist() == weights
    assert slots.tolist() == [0, 1, 2]


def test_one_who_feels_nobody_has_all_the_weight_and_the_dead_have_none():
    """w_ii = 1 where nobody is near; rows and columns of the dead are 0."""
    env = colony(*MARKS, empathy=Empathy(weight=0.5, form="average", within=2.0), position=FAR)
    assert env.coupling("agent")[0].tolist() == [[0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]]
    env.set_state(alive=[True, False, True])
    assert env.coupling("agent")[0].tolist() == [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


def test_needs_have_weights_of_their_own():
    """A need that counts half has half the weight of others; the one that is felt most is shown where none is named."""
    env = colony(*[(1.0, 0.0)] * 3, empathy=Empathy(weight=0.5, form="average", needs={"food": 0.5}))
    assert env.coupling("agent", "food")[0][0].tolist() == [0.75, 0.125, 0.125]
    assert env.coupling("agent", "calm")[0][0].tolist() == [0.5, 0.25, 0.25]
    assert env.coupling("agent")[0][0].tolist() == [0.5, 0.25, 0.25]
    with pytest.raises(EcologyError, match=r"no need 'foot'. Did you mean 'food'"):
        env.coupling("agent", "foot")
    with pytest.raises(EcologyError, match=r"no species 'agnt'. Did you mean 'agent'"):
        env.coupling("agnt")
    assert colony((1.0, 0.0)).coupling("agent") is None


def test_the_drive_follows_from_the_coupling():
    """In a world in which everything happens, the weights that are shown give the drive of all who live."""
    env, rng = ecology.parallel_env(everything()), np.random.default_rng(0)
    tick = env.reset_arrays(seed=0)
    felt_now = dict.fromkeys(env.groups, 0)
    for _ in range(40):
        tick = env.step_arrays(contract.choose(env, tick, rng))
        now, alive = env.state_view, tick.alive
        delta = physiology.deviation(env.world.model.body, now.internal)
        for group, species in zip(env.groups.values(), env.scenario.species, strict=True):
            rows = group.slots
            weight, slots = env.coupling(group.name)
            felt_now[group.name] += np.count_nonzero(weight) - np.count_nonzero(alive[rows])
            assert np.array_equal(
                weight[np.arange(group.size), np.searchsorted(slots, np.arange(rows.start, rows.stop))] > 0, alive[rows]
            )
            if species.empathy.form == "sum":
                drive = weight @ now.own_drive[slots]
            else:
                together = np.zeros((group.size, delta.shape[1]))
                for column, need in enumerate(species.needs):
                    weight, slots = env.coupling(group.name, need.name)
                    together[:, column] = weight @ delta[slots, column]
                    assert weight.sum(axis=1) == pytest.approx(alive[rows].astype(float))
                drive = physiology.drive(
                    together, env.world.model.body.epsilon[rows], env.world.model.body.exponent[rows]
                )
            assert drive[alive[rows]] == pytest.approx(now.drive[rows][alive[rows]], rel=1e-9)
    assert all(felt_now.values())


# ---- what a learner relies on ----------------------------------------------------------------


@pytest.mark.parametrize("walls", [True, False])
def test_the_drive_follows_from_zeta(walls):
    """In a world in which everything happens, an agent that knows its layout computes its drive from zeta.

    For the sum form (hunters), the average form (prey) and quadratic drives (ghosts), to single precision.
    """
    env = start(everything(walls=walls), seed=2)
    rng = np.random.default_rng(2)
    felt = dict.fromkeys(env.groups, 0)
    for _ in range(80):
        asked = np.concatenate([rng.integers(len(g.actions), size=g.size) for g in env.groups.values()])
        tick = env.step_arrays(asked)
        for group in env.groups.values():
            mix, direct, exponent = drive_terms(group.layout)
            zeta = tick.observations[group.name].astype(float)
            known = (group.layout.epsilon + np.square(zeta @ mix).sum(axis=1)) ** (exponent / 2) + zeta @ direct
            alive, state = tick.alive[group.slots], env.state_view
            assert known[alive] == pytest.approx(tick.drive[group.slots][alive], rel=1e-5, abs=1e-5)
            felt[group.name] += (state.drive != state.own_drive)[group.slots][alive].sum()
    assert min(felt.values()) > 50


@pytest.mark.parametrize("form", ["sum", "average"])
def test_what_is_felt_can_be_hidden(form):
    """Without `perceived` zeta has no felt component, and the drive is felt all the same."""
    seen, hidden = (
        colony((1.0, 0.0), (3.0, 0.0), empathy=Empathy(weight=0.5, form=form, perceived=perceived))
        for perceived in (True, False)
    )
    assert np.array_equal(seen.state_view.drive, hidden.state_view.drive)
    extra = set(seen.groups["agent"].layout.names) - set(hidden.groups["agent"].layout.names)
    assert extra == ({"felt"} if form == "sum" else {"felt_food", "felt_calm"})


def test_the_reward_is_the_change_of_the_drive_that_is_felt():
    """Feeding another lowers one's own drive by w times the change of the other's."""
    scenario = square(
        kind("mother", empathy=Empathy(weight=0.5, species=("child",))),
        kind("child", ecology.act("eat", control={"food": 0.5})),
    )
    env = start(scenario, internal=[[2.0], [1.0]])
    tick = env.step_arrays(np.array([0, 1]))
    assert tick.reward == pytest.approx([0.5 * (d(1.0) - d(0.5)), d(1.0) - d(0.5)])


@pytest.mark.parametrize("form", ["sum", "average"])
def test_to_die_is_no_relief(form):
    """The last reward of one who felt with others is 0, as for one who did not, and its drive stays as it was."""

    def strike(world, rng):
        outcome = world.no_effect()
        outcome.killed[0] = True
        return outcome

    env = start(square(kind(count=2, empathy=Empathy(weight=0.5, form=form)), rule=strike), internal=[[2.0], [0.0]])
    drive = env.state_view.drive[0]
    assert drive > 0.5
    for _ in range(2):
        tick = env.step_arrays(np.zeros(2, np.int64))
        assert (tick.reward[0], tick.drive[0]) == (0.0, drive)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"needs": {"fod": 1.0}}, "names the need 'fod'. Did you mean 'food'"),
        ({"species": ("agents",)}, "names the species 'agents'"),
        ({"matrix": ((0.0, 1.0),)}, "must be 2 by 2"),
        ({"matrix": ((0.0, math.nan), (0.0, 0.0))}, "finite number"),
        ({"species": ("other",), "matrix": ((0.0, 1.0), (1.0, 0.0))}, "add 'agent' to its species"),
        ({"lesion": "shuffled"}, "at least 3 to shuffle"),
        ({"form": "average", "weight": 1.5}, "share from 0 to 1"),
    ],
)
def test_empathy_that_cannot_be_is_refused(words, message):
    """Contradictions in the words of empathy are named, with what to do."""
    with pytest.raises(EcologyError, match=message):
        square(kind(count=2, empathy=Empathy(**{"weight": 1.0, **words})), kind("other", count=2))
