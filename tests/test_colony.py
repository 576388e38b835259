"""`colony`: giving pays exactly where the closed form says, lesions do what they are named for."""

import math

import numpy as np
import pytest

import ecology
from ecology import scenarios
from ecology.scenarios.colony import GIVES, SET_POINT

HUNGRY = (-0.6, -1.0)  # deviations of nurse and brood


def pair(deviations=HUNGRY, **settings):
    """Return a nest with one nurse and one of the brood at the given deviations."""
    env = ecology.parallel_env(scenarios.load("colony", nurses=1, brood=1, **settings))
    env.reset_arrays(seed=0)
    env.set_state(internal=SET_POINT + np.array(deviations)[:, None])
    return env


def drive_after(env, action):
    """Return the nurse's coupled drive after one tick of `action` in the true world, which is put back."""
    arrays, values = env.snapshot()
    arrays = {name: np.array(value) for name, value in arrays.items()}
    wanted = np.array([env.groups["nurse"].actions.index(action), 0])
    drive = env.step_arrays(wanted).drive[0]
    env.restore(arrays, values)
    return drive


def one_step_choice(env):
    """Return what a nurse does that has the least coupled drive one tick ahead in mind."""
    return min(("rest", "give_brood"), key=lambda action: drive_after(env, action))


def threshold(deviations, decay, efficiency, form):
    """Return the weight from which giving pays one tick ahead, from d and the body's dynamics alone."""
    d = lambda delta: math.sqrt(0.001 + delta**2)  # noqa: E731
    own, other = (delta - decay for delta in deviations)
    if form == "sum":  # d(own - g) + w d(other + e g) = d(own) + w d(other)
        return (d(own - GIVES) - d(own)) / (d(other) - d(other + efficiency * GIVES))
    return 1 / (1 + efficiency)  # (1 - w) g = w e g, both below their set points


@pytest.mark.parametrize("form", ["sum", "average"])
@pytest.mark.parametrize("efficiency", [0.5, 0.8, 1.0])
@pytest.mark.parametrize("deviations", [HUNGRY, (-0.1, -1.5)])
def test_giving_pays_exactly_above_the_threshold_weight(form, efficiency, deviations):
    """One tick ahead in the true world, a nurse gives if and only if its weight exceeds the closed form."""
    env = pair(deviations)
    decay = env.scenario.settings["decay"]
    at = threshold(deviations, decay, efficiency, form)
    for weight, choice in ((0.0, "rest"), (0.99 * at, "rest"), (1.01 * at, "give_brood")):
        if form == "average" and weight > 1:
            continue
        env = pair(deviations, weight=weight, form=form, efficiency=efficiency)
        assert one_step_choice(env) == choice, weight


def test_the_threshold_is_one_over_the_efficiency_far_from_the_set_points():
    """For deprived bodies d is |delta|, so that w* = 1 / efficiency: the rule of thumb in the docstring."""
    assert threshold((-1.0, -1.0), 0.01, 0.8, "sum") == pytest.approx(1 / 0.8, rel=1e-3)


def test_a_sated_nurse_gives_without_empathy():
    """Above its set point, giving lowers a nurse's own drive: it pays at weight 0."""
    assert one_step_choice(pair((1.0, -1.0), weight=0.0)) == "give_brood"


def lesioned(lesion, ticks=3):
    """Return drive less own drive of three nurses beside a brood of three, each as hungry as no other, and env."""
    env = ecology.parallel_env(scenarios.load("colony", weight=1.0, lesion=lesion, lesion_at=2.0))
    env.reset_arrays(seed=0)
    env.set_state(internal=np.array([2.0, 2.0, 2.0, 1.5, 1.0, 0.5])[:, None])
    felt = []
    for _ in range(ticks):
        tick = env.step_arrays(np.zeros(env.size, np.int64))
        felt.append((tick.drive - env.state_view.own_drive)[:3])
    return np.array(felt), env


def test_lesions_begin_at_their_time():
    """Before it all nurses feel the brood; from then on `off` feels nothing, and `sham` feels on."""
    off, env = lesioned("off")
    sham, _ = lesioned("sham")
    brood = env.state_view.own_drive[3:].sum()
    assert (off[0] > 2.0).all()
    np.testing.assert_array_equal(off[1:], 0.0)
    np.testing.assert_allclose(sham[-1], brood)


def test_who_starves_dies_and_who_is_full_does_not():
    """A member with nothing left is dead a tick later; one at the upper bound lives on."""
    env = pair((0.0, 0.0))
    env.set_state(internal=np.array([[4.0], [0.005]]))
    for alive in (True, False):
        tick = env.step_arrays(np.zeros(2, np.int64))
        assert tick.alive.tolist() == [True, alive]


def test_only_cognitive_nurses_perceive_the_brood():
    """The setting adds the nearest one's place and hunger to zeta, and nothing else changes."""
    names = {
        on: ecology.parallel_env(scenarios.load("colony", cognitive=on)).groups["nurse"].layout.names
        for on in (True, False)
    }
    assert set(names[True]) - set(names[False]) == {"brood_1_distance", "brood_1_bearing", "brood_1_food"}
    assert set(names[False]) == {"food", "felt"}
