"""Scripted agents in the shipped experiments meet the closed forms, and each check fails in a world that is altered."""

import math

import numpy as np
import pytest

from ecology.lab.certificate import answers
from ecology.lab.certificate.case import Row
from ecology.lab.certificate.cases import (
    addiction,
    all_cases,
    anticipation,
    choice,
    enrichment,
    heat,
    hunting,
    inferred,
    kin,
    laws,
    night,
    patches,
    two_pools,
)

NAMES = (
    "addiction", "anticipation", "choice", "enrichment", "heat", "hunting", "inferred", "kin", "laws", "night",
    "patches", "two_pools",
)  # fmt: skip


def verdicts(module, done):
    """Return what the rows of a case say of the parts that are done."""
    return [row.says() for row in module.case().rows(done)]


@pytest.mark.parametrize("name", NAMES)
def test_every_case_draws_a_figure_of_whatever_is_done(name):
    """A figure is drawn without any part too, so that a run that was stopped has one."""
    from ecology.observers.plotting import new_figure

    case = all_cases()[name]
    figure = new_figure((6, 4))
    case.figure({}, figure)
    assert figure.axes


def test_cooling_ahead_saves_from_the_load():
    """The peaks and drives of the equation, and 48 ticks to death without; a weaker load gives other numbers."""
    done = {f"ahead-{k}": heat.measure_scripted(k) for k in (0, 16)}
    assert set(verdicts(heat, done)) == {"agrees"}
    assert [heat._begins(np.array(done[f"ahead-{k}"]["path"])) for k in (0, 16)] == [0, 16]
    weaker = {f"ahead-{k}": heat.measure_scripted(k, load=6.0) for k in (0, 16)}
    assert "differs from the closed form" in "".join(verdicts(heat, weaker))


def test_shivering_follows_its_kinetics():
    """Temperatures in a day, and overheating without the ethanol; the days swapped are told apart."""
    path = anticipation.day(True, False)
    assert verdicts(anticipation, {"scripted-1-0": path}) == ["agrees"] * len(anticipation.AT)
    assert "agrees" not in verdicts(anticipation, {"scripted-1-1": path})


def test_intake_escalates_with_long_access():
    """Infusions and set point after twelve days of six hours; those of one hour are none of these."""
    long, short = addiction.measure_scripted(6.0), addiction.measure_scripted(1.0)
    found = verdicts(addiction, {"scripted-6": long, "scripted-1": short})
    assert found[1] == found[3] == "agrees"
    assert "agrees" not in verdicts(addiction, {"scripted-6": short, "scripted-1": long})
    assert short["set_point"][-1] == pytest.approx(100, abs=0.5)
    assert addiction.most_without() == pytest.approx(2.9, abs=0.05)


def test_the_drive_decides():
    """Risk, deprivation and dose by the drive in the world; a doubled drink is another boundary."""
    done = {f"gamble-{x:g}": choice.gamble(x) for x in (0.0, 2.0)}
    done |= {"deprivation-0.04": choice.preferences(0.02, 0.04), "dose": choice.meals()}
    assert set(verdicts(choice, done)) == {"agrees"}
    assert "differs from the closed form" in verdicts(choice, {"deprivation-0.04": choice.preferences(0.02, 0.01)})


def test_curvature_sets_the_spread():
    """The SD of a softmax walk in the world is that of detailed balance, and of no other exponent."""
    ours = [choice.spread(2.0, seed) for seed in range(3)]
    assert np.mean(ours) == pytest.approx(choice.stationary(2.0), rel=0.1)
    assert choice.stationary(4 / 3) > 2 * np.mean(ours)


def test_agents_are_free_and_ideal():
    """Numbers match inputs at 4:1; agents that go anywhere do not."""
    free, blind = two_pools.measure_scripted(4.0, 0.0), two_pools.measure_scripted(4.0, 1.0)
    assert free["left"] / free["right"] == pytest.approx(4.0, rel=0.15)
    assert free["intake left"] == pytest.approx(free["intake right"], rel=0.1)
    assert blind["left"] / blind["right"] < 2
    assert two_pools.slope_of(0.0, 90_000) == pytest.approx(1.0, abs=1e-3)
    assert two_pools.slope_of(0.1, 90_000) == pytest.approx(0.836, abs=1e-3)
    assert two_pools.slope_of(0.0) == pytest.approx(1.0425, abs=1e-3)  # 24, 32, 39 and 43 of 48


def test_patches_are_left_when_charnov_says():
    """The residence of an agent that knows its mean rate; travel of 5 and of 20 are told apart."""
    done = {f"scripted-{t}": patches.measure_scripted(t) for t in (5, 20)}
    assert set(verdicts(patches, done)) == {"agrees"}
    assert "agrees" not in verdicts(patches, {"scripted-5": done["scripted-20"], "scripted-20": done["scripted-5"]})
    assert [patches.charnov(t) for t in (5, 80)] == pytest.approx([12.65, 38.74], abs=0.01)
    assert patches.best_discounted_residence(20, 0.999999) == pytest.approx(patches.charnov(20), abs=0.1)


def test_hunters_take_what_holling_says():
    """At one density the catch is a N / (1 + a h N); with half the handling time it is not."""

    def rate(handling):
        return 0.02 * 1.0 / (1 + 0.02 * handling * 1.0)

    found = hunting.measure_scripted(1.0, 0)
    assert found == pytest.approx(rate(60.0), rel=0.1)
    assert abs(found - rate(30.0)) > 0.2 * found
    assert hunting.fit({n: 0.02 * n / (1 + 1.2 * n) for n in (0.5, 1, 4)}) == pytest.approx((0.02, 60.0))


def test_giving_spreads_by_relatedness():
    """From r = 1 with c/b = .3 giving spreads, from r = 0 it goes, and the Price equation closes to 1e-12."""
    kind, strange = (kin.evolve(r, 0.3, 0, generations=25) for r in (1.0, 0.0))
    assert kind["share"][-1] > 0.8
    assert strange["share"][-1] < 0.4
    assert max(kind["price"], strange["price"]) < 1e-12
    assert kin.threshold({0.0: 0.1, 0.5: 0.9}) == pytest.approx(0.25)


def test_learners_of_kin_are_bred_as_scripted_agents_are(monkeypatch):
    """The Price equation closes for learners too, and their rows say from which relatedness on they give."""
    monkeypatch.setattr(kin, "FAMILIES", 4)
    monkeypatch.setattr(kin, "BRED", 3)
    life = kin.evolve_learners(0.5, 0.6, 0)
    assert [len(life[what]) for what in ("mean", "share", "given")] == [3, 3, 3]
    assert life["price"] < 1e-12
    assert all(0 <= share <= 1 for share in life["given"])
    level = dict(zip(kin.RELATED, (0.0, 0.1, 0.4, 0.7, 1.0), strict=True))  # half from r = .58 on
    done = {
        f"learned-0.6-{r:g}-{seed}": {"mean": [r], "share": [share], "given": [1.0], "price": 0.0}
        for r, share in level.items()
        for seed in range(answers.SEEDS)
    }
    rows = {row.what: row for row in kin.case().rows(done)}
    assert rows["f/J: relatedness from which half of the weights are above c/b, c/b 0.6"].mean() == pytest.approx(
        7 / 12
    )
    assert rows["f/J: relatedness from which half of all acts are gifts, c/b 0.6"].mean() == 0.0


def test_predators_learn_to_hunt_in_enrichment():
    """Lineages learn to take most of the possible bites, and rows of learners that are as theory says agree."""
    life = enrichment.measure_learner(150.0, 0, ticks=500)
    assert life["taken"] > 0.5
    done = {
        f"learned-{k:g}-{seed}": {**life, "taken": 0.8, "cv": k / 500, "prey": enrichment.N_REST / 0.8}
        for k in enrichment.AMONG
        for seed in range(answers.SEEDS)
    }
    gone = f"learned-{enrichment.AMONG[-1]:g}-0"
    done[gone] = {**done[gone], "extinct": True, "taken": 0.0}  # predators that have died out count for nothing
    done |= {f"scripted-{k:g}-0": {**life, "cv": k / 400} for k in enrichment.CAPACITIES}  # varies by 0.6 from 240 on
    rows = {row.what.split(",")[0]: row for row in enrichment.case().rows(done) if row.what.startswith("f/J")}
    assert rows["f/J: prey at rest"].says() == "agrees"
    assert rows["f/J: K from which prey vary by 0.6"].closed == pytest.approx(1.25)
    assert rows["f/J: K from which prey vary by 0.6"].mean() == pytest.approx(300 / 240)
    assert enrichment.crossing({100.0: 0.1, 200.0: 0.2}) == 200.0


def test_hunters_that_learn_are_compared_early_and_late():
    """The catch of a learner is that of a block of its life, not of all of it."""
    blocks = [float(k) for k in range(hunting.LIVED // hunting.BLOCK)]
    found = hunting.case().rows({f"learned-1-{seed}": blocks for seed in range(8)})
    assert [row.mean() for row in found] == [1.0, blocks[-1]]


def test_nights_are_survived_by_the_larger_z():
    """Sleep of 8.1 and 15.9 h, and the switch to patchy meals below the budget."""
    done = {"sleep-0": night.sleeps(0.0)}
    for start in (0.5, 1.5):
        done |= {f"budget-{start:g}-{m}": [night.survives(start, m, s) for s in range(2)] for m in ("steady", "patchy")}
    rows = night.case().rows(done)
    assert [row.closed for row in rows[:2]] == pytest.approx([15.9, 8.1], abs=0.05)
    assert {row.says() for row in rows[:2]} == {"agrees"}
    for row in rows[2:]:
        assert row.mean() == pytest.approx(row.closed, abs=0.1)
    alive = {key: np.mean(value) for key, value in done.items() if key.startswith("budget")}
    assert alive["budget-0.5-patchy"] > alive["budget-0.5-steady"] + 0.1
    assert alive["budget-1.5-patchy"] < alive["budget-1.5-steady"] - 0.1


def test_small_laws():
    """The lower R* wins, and the variance and the growth are those of their formulas, and of no other numbers."""
    won = laws.competition(0)
    assert won["thrifty"] > won["wasteful"]
    assert laws.noise(0) == pytest.approx(0.9, rel=0.15)
    rate = np.mean([laws.growth(seed) for seed in range(4)])
    assert rate == pytest.approx(laws.euler_lotka(), rel=0.25)
    assert rate < 0.75 * laws.BEARS  # without maturity
    assert laws.gini(np.array([1.0, 1.0])) == 0
    assert laws.gini(np.array([0.0, 1.0])) == pytest.approx(0.5)


def test_signs_are_known_from_oneself():
    """A learner that has seen its own display infers a low partner from a low display, and nothing from the truth."""
    env, minds, tick = inferred._train({"weight": 0.5, "senses": "signs"}, 0, 300)
    mind = minds["possessor"]
    zeta = np.repeat(tick.observations["possessor"], 2, axis=0)[:2]
    low, high = (mind.group.layout.low[mind.others[0]], mind.group.layout.high[mind.others[0]])
    assert low < high
    told = []
    for sign in (low, high):
        one = zeta[:1].copy()
        one[:, mind.others], one[:, mind.felt] = sign, 99.0
        told.append((float(mind.infer(one)[0]), float(mind.read(one)[0, mind.felt])))
    assert told[0][0] > told[1][0] + 0.5
    assert told[0][1] == pytest.approx(mind.cares * told[0][0], rel=1e-5)
    assert mind.cares == pytest.approx(0.5, rel=1e-6)
    assert env.size == 2


def test_rows_without_comparison_say_so():
    """The line of the least squares, and Phi."""
    assert answers.fit_line([0, 1, 2], [1, 3, 5]) == pytest.approx((2, 1))
    assert answers.phi(0) == 0.5
    assert answers.binomial(3, 0.5) == pytest.approx([1 / 8, 3 / 8, 3 / 8, 1 / 8])
    assert math.isnan(patches.residence([False] * 10, 0.0)["stay"])
    assert Row("", [1.0], closed=1.0, tolerance=0.1).says() == "agrees"
