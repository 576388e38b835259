"""The lives behind the certificate's cases of commons and colony, and what is made of them."""

import json
import math

import numpy as np
import pytest

from ecology import Ecology, scenarios
from ecology.agents import checkpoint
from ecology.lab import cli
from ecology.lab.certificate import crowds, part_store
from ecology.lab.certificate.cases import all_cases
from ecology.lab.certificate.part_store import PartStore


def test_a_life_is_that_of_a_run(tmp_path):
    """What is lived for the table is what `ecology run` lives with the same seed, bit for bit."""
    words = ["--set", "weight=0.5", "--ticks", "150", "--seed", "3", "--no-record", "--quiet"]
    with pytest.raises(SystemExit):
        cli.main(["run", "colony", *words, "--out", str(tmp_path / "run")])
    alone = checkpoint.read(tmp_path / "run/checkpoint")["world"][0]
    state, rows = crowds.run_life("colony", 3, 150, lambda _, now: (now.tick, now.own_drive[0]), weight=0.5)
    for name, array in state.arrays().items():
        np.testing.assert_array_equal(array, alone[name], err_msg=name)
    assert rows[:, 0].tolist() == list(range(1, 151))
    assert rows[-1, 1] == state.own_drive[0]


def test_the_closed_form_is_the_recursion():
    """ln(n q / (n q - growth E0)) / ln(1 + growth) is the tick at which E' = (1 + growth) E - n q is below zero."""
    assert crowds.most() == pytest.approx(15)
    assert math.isinf(crowds.emptying_time(15))
    for n in (16, 18, 24):
        left, tick = 300.0, 0
        while left > 0:
            left, tick = min(300.0, 1.0005 * left - 0.01 * n), tick + 1
        assert tick == math.ceil(crowds.emptying_time(n))


def test_a_pool_is_emptied_once(monkeypatch):
    """The tick is the first after which nothing is left; what each ate is over the ticks until then."""
    _, rows = crowds.run_life("commons", 0, 20, lambda *_: (0.0,), n=4)
    assert rows.shape == (20, 1)
    state = type("State", (), {"eaten": np.array([6.0])})
    seen = np.array([[2.0, 0.1], [1.0, 0.1], [0.0, 0.3], [0.0, 0.5]])
    monkeypatch.setattr(crowds, "run_life", lambda *_, **__: (state, seen))
    assert crowds.commons(2, 0, 4) == {"empty": 3, "stock": 0.0, "eaten": 1.0, "drive": 0.4}
    seen[2:, 0] = 0.5
    assert crowds.commons(2, 0, 4) == {"empty": None, "stock": 0.5, "eaten": 0.75, "drive": 0.4}


def test_the_dead_of_a_colony_have_no_drive(monkeypatch):
    """Means are over those alive and the ticks in which somebody is; of nobody there is none."""
    nan = math.nan
    seen = np.array([[1, 1, 9, 9, 1], [1, 1, 9, 9, 1], [0.5, 1, 0.2, 0.4, 0.5], [0, 1, nan, 0.6, 0.0]])
    monkeypatch.setattr(crowds, "run_life", lambda *_, **__: (None, seen))
    found = crowds.colony(0.0, 0, 4)
    assert found == pytest.approx({"brood alive": 0, "nurses alive": 1, "brood": 0.2, "nurses": 0.5, "gives": 0.25})
    seen[2:, 2] = nan
    assert crowds.colony(0.0, 0, 4)["brood"] is None


def test_a_colony_is_looked_at_without_its_dead():
    """Where brood or nurses have died, what is seen of a tick is of the others."""
    env = Ecology(scenarios.load("colony"))
    env.reset_arrays(0)
    internal = env.state_view.internal.copy()
    internal[[1, 3], 0] = 0.0  # a nurse and one of the brood
    env.set_state(internal=internal)
    env.step_arrays(np.zeros(env.size, np.int64))
    state = env.state_view
    assert np.flatnonzero(~state.alive).tolist() == [1, 3]
    young, old = state.own_drive[[4, 5]].mean(), state.own_drive[[0, 2]].mean()
    assert crowds._colony_now(env, state) == pytest.approx((2 / 3, 2 / 3, young, old, 0.0))


def pool(empty, stock=0.0):
    """Return what became of a pool."""
    return {"empty": empty, "stock": stock, "eaten": 0.009, "drive": 0.2}


def test_rows_and_table_of_the_pool():
    """Where every pool is kept and where it is emptied is compared with the closed form; the table has all."""
    done = {f"{n}-seed-{seed}": pool(None, 300.0) for n in (12, 14) for seed in range(3)}
    done |= {f"{n}-seed-{seed}": pool(round(crowds.emptying_time(n)) + 9 * seed - 9) for n in (18, 20, 24)
             for seed in range(3)}  # fmt: skip
    done |= {"16-seed-0": pool(4900), "16-seed-1": pool(None, 60.0), "16-seed-2": pool(None, 60.0)}
    case = all_cases()["commons_learners"]
    assert {part.key for part in case.parts()} == set(done)
    rows = case.rows(done)
    assert [row.says() for row in rows] == ["agrees"] * 7
    assert rows[0].ours == [5000.0] * 3
    assert (rows[-1].ours, rows[-1].closed) == ([14], pytest.approx(15))
    lines = case.table(done).splitlines()
    assert len(lines) == 2 + 6
    assert "| 16 | 2 of 3 | 4900, -, - | 5547 | 40 | 0.0090 | 0.20 |" in lines
    assert len({line.count("|") for line in lines}) == 1
    late = {key: pool(4999) if key.startswith("24") else value for key, value in done.items()}
    assert case.rows(late)[4].says() == "differs from the closed form"


def test_rows_and_table_of_the_colony():
    """A row for every weight and number, without a verdict, and a table with the values of every seed."""
    life = {"brood alive": 1.0, "nurses alive": 2 / 3, "brood": 0.2, "nurses": 0.4, "gives": 0.25}
    done = {f"{weight:g}-seed-{seed}": life for weight in (0.0, 0.25, 0.5, 1.0, 2.0) for seed in range(4)}
    case = all_cases()["colony"]
    assert [part.key for part in case.parts()] == list(done)
    rows = case.rows({**done, "0-seed-1": {**life, "brood": None}})
    assert [len(row.ours) for row in rows] == [4] * 5 + [3] + [4] * 4
    assert {row.says() for row in rows} == {"no number to compare with"}
    table = case.table({**done, "0-seed-1": {**life, "brood alive": 0.0, "brood": None}})
    assert (
        "| 0 | 75% (100%, 0%, 100%, 100%) | 67% (67%, 67%, 67%, 67%) | 0.20 (0.00) | 0.40 (0.00) | 0.25 (0.00) |"
        in table.splitlines()
    )


def test_tables_are_written_beside_the_certificate(tmp_path, monkeypatch, capsys):
    """`ecology reproduce` writes a case's table under its name, made from the lives that are kept."""
    monkeypatch.setattr(crowds, "NUMBERS", (3,))
    monkeypatch.setattr(crowds, "TICKS", 12)
    monkeypatch.setattr(crowds.commons, "__defaults__", (12,))
    for again in range(2):
        with pytest.raises(SystemExit):
            cli.main(["reproduce", "commons_learners", "--out", str(tmp_path)])
        assert ("3 of 3  commons_learners 3-seed-2" in capsys.readouterr().err) == (again == 0)
    assert "| 3 | 3 of 3 | -, -, - | - | 300 |" in (tmp_path / "commons_learners.md").read_text()
    assert part_store.unfinished_parts(all_cases()["commons_learners"], PartStore(tmp_path)) == []
    assert json.loads((tmp_path / "parts/commons_learners/3-seed-0.json").read_text())["value"]["empty"] is None
