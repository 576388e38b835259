"""The certificate: what is compared with what, and that nothing done is done twice."""

import json

import numpy as np
import pytest

from ecology import Ecology, EcologyError, scenarios
from ecology.agents.base import Learner
from ecology.lab import cli
from ecology.lab.certificate import authors, cases, empathic, episodes, part_store, report
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.certificate.cases.trap import forages, rescues, rests
from ecology.lab.certificate.part_store import PartStore


@pytest.fixture
def tiny(monkeypatch):
    """Return a case of two parts that counts how often each is done, put in the place of all others."""
    done = []

    def part(key, value, words=None):
        def compute():
            done.append(key)
            if value is None:
                raise KeyboardInterrupt
            return [value]

        return Part(key, words or {"ticks": 5}, 1.0, compute)

    parts = [part("one", 1.0), part("two", 2.0)]
    case = Case("tiny", "a small case", lambda: parts, lambda found: [Row(k, v, closed=v[0]) for k, v in found.items()])
    monkeypatch.setattr(cases, "all_cases", lambda: {"tiny": case})
    return parts, done, part


def test_what_is_done_is_kept_and_not_done_again(tiny, tmp_path, capsys):
    """The same command typed again does nothing and prints the same certificate."""
    _, done, _ = tiny
    for _ in range(2):
        _run(tmp_path)
    assert done == ["one", "two"]
    out = capsys.readouterr()
    assert out.out.count("agrees") == 4
    assert "about 2 s" in out.err
    assert "tiny: a small case; done" in out.err
    table = (tmp_path / report.TABLE).read_text()
    assert table.splitlines()[2] == "| tiny | one | - | 1 | 1 | - | 1 | agrees |"


def _run(folder, *names):
    with pytest.raises(SystemExit) as end:
        cli.main(["reproduce", *names, "--out", str(folder)])
    assert end.value.code == 0


def test_a_part_made_with_other_parameters_is_made_again(tiny, tmp_path):
    """A kept part counts only where what it depends on is the same, and where its file is whole."""
    parts, done, part = tiny
    _run(tmp_path)
    parts[0] = part("one", 3.0, {"ticks": 6})
    (tmp_path / "parts" / "tiny" / "two.json").write_text("{")
    _run(tmp_path)
    assert done == ["one", "two", "one", "two"]
    assert json.loads((tmp_path / "parts" / "tiny" / "one.json").read_text())["value"] == [3.0]


def test_a_stop_keeps_what_is_done(tiny, tmp_path, capsys):
    """Ctrl-C ends with 130 and says how to go on; the parts before it are not done again."""
    parts, done, part = tiny
    parts[1] = part("two", None)
    with pytest.raises(SystemExit) as end:
        cli.main(["reproduce", "--out", str(tmp_path)])
    assert end.value.code == 130
    assert "the same command resumes" in capsys.readouterr().err
    parts[1] = part("two", 2.0)
    _run(tmp_path)
    assert done == ["one", "two", "two"]


def test_the_certificate_is_a_table_of_numbers_too(tiny, tmp_path):
    """The parquet table has a row per row, with closed form, mean, interval and verdict."""
    from pyarrow import parquet

    _run(tmp_path, "tiny")
    rows = parquet.read_table(tmp_path / report.PARQUET).to_pylist()
    assert [(row["what"], row["closed_form"], row["mean"], row["n"], row["verdict"]) for row in rows] == [
        ("one", 1.0, 1.0, 1, "agrees"),
        ("two", 2.0, 2.0, 1, "agrees"),
    ]


def test_an_unknown_name_is_refused(tmp_path, capsys):
    """A name that is no case is refused with the nearest one, before anything is written."""
    with pytest.raises(SystemExit) as end:
        cli.main(["reproduce", "food_shar", "--out", str(tmp_path / "out")])
    assert end.value.code == 2
    assert "food_share" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_told(tiny, tmp_path, capsys):
    """A file in the place of the folder gives one message and exit code 2."""
    (tmp_path / "file").write_text("")
    with pytest.raises(SystemExit) as end:
        cli.main(["reproduce", "--out", str(tmp_path / "file")])
    assert end.value.code == 2
    assert "is a file where a folder is to be written" in capsys.readouterr().err


def test_verdicts():
    """The interval decides where there is chance, the tolerance where there is none; a wide one decides nothing."""
    sample = [9.0, 10.0, 11.0]  # mean 10, interval 10 +- 2.48
    assert Row("", sample).interval() == pytest.approx((10 - 2.484, 10 + 2.484), abs=1e-3)
    assert Row("", sample, closed=12.4).says() == "agrees"
    assert Row("", sample, closed=12.6).says() == "differs from the closed form"
    assert Row("", sample, closed=9.0).says() == "not distinguishable from the closed form"
    assert Row("", [300.0, 3000.0], closed=3000.0).says() == "not distinguishable from the closed form"
    assert Row("", [1.0], closed=1.1, tolerance=0.2).says() == "agrees"
    assert Row("", [1.0], closed=1.1, tolerance=0.05).says() == "differs from the closed form"
    # standard errors 0.577 and 0.447, together 0.73; 4.9 degrees of freedom: +- 1.88
    assert Row("", sample, theirs=(11.8, 2.0, 20)).says() == "agrees"
    assert Row("", sample, theirs=(12.0, 2.0, 20), closed=12.0).says() == "differs from theirs"
    assert Row("", sample, theirs=(12.0, 30.0, 20), closed=9.0).says() == (
        "not distinguishable from the closed form and theirs"
    )
    assert Row("", [5.0, 5.0], theirs=(5.0, 0.0, 20), closed=4.0).says() == "differs from the closed form"
    assert Row("", [5.0, 5.0], theirs=(6.0, 0.0, 20), closed=4.0).says() == "differs from the closed form and theirs"
    assert Row("", sample, verdict="no number to compare with").says() == "no number to compare with"


def test_every_case_can_be_told_before_it_is_done():
    """Names, what is compared and for how long are there without doing anything; keys of parts are their own."""
    for name, case in cases.all_cases().items():
        parts = case.parts()
        assert case.name == name
        assert case.about
        assert case.rows({}) == []
        assert len({part.key for part in parts}) == len(parts)
        assert parts or case.notes
        assert all(part.seconds > 0 for part in parts)
        json.dumps([dict(part.parameters) for part in parts])


@pytest.mark.parametrize("name", ["theory", "commons"])
def test_short_cases_agree_with_their_closed_forms(name, tmp_path):
    """The drive under constant intake, and the most eaters that a pool bears."""
    case, kept = cases.all_cases()[name], PartStore(tmp_path)
    for part in part_store.unfinished_parts(case, kept):
        kept.do(case, part)
    rows = part_store.rows(case, kept)
    assert rows
    assert all(row.says() == "agrees" for row in rows)


def test_the_yardsticks_of_the_trap(monkeypatch):
    """Who rests starves with accidents or without; who forages lives on without; who rescues feeds the other."""
    from ecology.scenarios import trap

    words = {"condition": "none"}
    for accident in (trap.ACCIDENT, 0.0):
        monkeypatch.setattr(trap, "ACCIDENT", accident)
        lives, _ = episodes.run_scripted("trap", words, rests, 1, 2, 1500)
        assert max(lives[0]) <= 1200  # at most 1 + 0.2 of energy, 0.001 a tick
    assert episodes.run_scripted("trap", words, forages, 1, 2, 1500)[0] == [[1500, 1500]]
    for policy, helped in ((forages, False), (rescues, True)):
        env = Ecology(scenarios.load("trap"))
        env.reset_arrays(0)
        env.step_arrays(rests(env))
        place = np.array([[-0.8, 0.7], [0.8, -0.7]])
        env.set_state(internal=np.array([[1.0, 1.0], [0.25, 0.0]]), position=place)
        for _ in range(40):
            env.step_arrays(policy(env))
        assert (env.state_view.internal[1].sum() > 0.3) == helped  # food in hand, or eaten
        assert (env.state_view.received[1, 1] > 0) == helped


def test_learners_of_the_trap_are_held_to_who_does_nothing():
    """Without a number from elsewhere, a row says whether its interval lies above the lives of those who rest."""
    done = {"scripted-rests": [800.0, 820.0], "hjb-none": [700.0, 1000.0, 900.0], "hjb-full": [1500.0, 1510.0, 1505.0]}
    says = {row.what: row.says() for row in cases.all_cases()["trap"].rows(done)}
    assert says == {
        "ticks lived, doing nothing, 2 lives": "scripted",
        "ticks lived, f/J, none": "not distinguishable from doing nothing",
        "ticks lived, f/J, full": "better than doing nothing",
    }
    del done["scripted-rests"]
    assert {row.says() for row in cases.all_cases()["trap"].rows(done)} == {"no number to compare with"}


def test_a_walk_to_food_is_one_action(monkeypatch):
    """Counted by actions, a walk to food is met once, with the drive at its end; counted by ticks, at every tick."""
    env = Ecology(scenarios.load("paper_reference", arena="EASY", heading=False, start=(2.0, 2.0)))
    env.reset_arrays(0)
    go, drives = np.array([env.groups["agent"].actions.index("go_to_food_1")]), []
    while not drives or env.state_view.bound_for[0] >= 0:
        drives.append(float(env.step_arrays(go).drive[0]))
    assert 20 < len(drives) < 30  # 2.4 lengths to the circle at 0.1 a tick

    class Goes(Learner):
        def act(self, observations, masks):
            return go

    monkeypatch.setattr(authors.agents, "make", lambda name, group, seed, _: Goes(group, seed))
    assert authors.mean_drive("EASY", "random_actions", 0, 1, 0) == drives[-1]
    assert authors.mean_drive("EASY", "random", 0, 9, 4) == pytest.approx(np.mean(drives[4:9]), abs=1e-12)


def test_f_and_j_learn_to_share_only_where_they_feel_it():
    """After 600 ticks of food_share, agents that feel their partner's drive keep both alive, others let it die.

    Over seven pairs that learn each for itself, lives have their median near the 14.5 ticks of who always eats
    in one condition, and near the cap of 200 in the other.
    """
    lived = {c: episodes.hjb("food_share", {"condition": c}, 7, 600, 200) for c in ("cognitive", "affective")}
    median = {c: np.median([np.mean(lengths) for lengths in found]) for c, found in lived.items()}
    assert median["cognitive"] < 60
    assert median["affective"] > 120


def test_ppo_without_the_library_is_told():
    """Where Stable-Baselines3 is missing, PPO says which extra it needs; where it is there, it learns a little."""
    words = {"count": 2, "steps": 64, "scale": 1.0, "cap": 50, "seed": 0}
    learning = {"n_steps": 16, "batch_size": 16}
    if empathic.has_ppo():
        assert all(0 < n <= 50 for n in episodes.ppo("food_share", {}, learning, **words))
    else:
        with pytest.raises(EcologyError, match="'sb3'"):
            episodes.ppo("food_share", {}, learning, **words)
        assert all("ppo" not in part.key for part in cases.all_cases()["food_share"].parts())
        assert "left out" in cases.all_cases()["food_share"].notes[0]
