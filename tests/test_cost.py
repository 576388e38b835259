"""What was learned against what it cost: read off the tables of sweeps."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from ecology.lab.bench import cost
from ecology.lab.runs.sweep import write_table


@pytest.fixture
def folders(tmp_path: Path) -> list[Path]:
    """Return the folders of two sweeps: two choices with two seeds, and another learner with one."""
    common = {"scenario": "paper", "ticks": 1000, "population.agent.mean": 2.0, "population.agent.end": 2}
    rows = [
        common | {"learner.agent": "hjb", "set.decay": 0.01, "set.learner.update_every": every, "seed": seed,
                  "learned_drive": drive, "cpu_seconds": world + learner, "learner_cpu_seconds": learner}
        for every, seed, drive, world, learner in [
            (2, 0, 1.0, 4.0, 4.0), (2, 1, 2.0, 8.0, 16.0), (8, 0, 3.0, 2.0, 0.5), (8, 1, 4.5, 6.0, 1.5)
        ]
    ]  # fmt: skip
    other = rows[0] | {"learner.agent": "lean", "learned_drive": 2.5, "set.learner.width": 16}
    del other["set.learner.update_every"]
    for name, table in (("every", rows), ("lean", [other])):
        (tmp_path / name).mkdir()
        write_table(tmp_path / name / "sweep.parquet", table)
    return [tmp_path / "every", tmp_path / "lean"]


def test_a_choice_has_its_cost_and_its_drives(folders: list[Path]) -> None:
    """Costs are per agent and tick of a machine as quiet as it ever was; a name is learner and what it was told."""
    found = {point.label: point for point in cost.points(folders)}
    assert list(found) == ["hjb, update_every 2", "lean, width 16", "hjb, update_every 8"]
    assert found["hjb, update_every 2"].drives == {0: 1.0, 1: 2.0}
    quiet = 1e3 * 2.0 / (1000 * 2)  # the world's part of the run in which that was least
    assert found["hjb, update_every 2"].learner == pytest.approx(quiet * 1.5)  # median of 4 / 4 and 16 / 8
    assert found["hjb, update_every 2"].tick == pytest.approx(quiet * 2.5)
    assert found["hjb, update_every 8"].learner == pytest.approx(quiet * 0.25)
    table = cost.table(list(found.values())).splitlines()
    assert table[2] == "| 1 | `hjb, update_every 2` | 1.500 | 2.500 | 1.00 | 2.00 | 2.00 |"
    assert table[3].endswith("| 2.50 | - | 2.50 |")


def test_the_figure_is_drawn(
    folders: list[Path], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command prints the table and leaves a picture, camping in the world of the sweeps beside it."""
    lines: list[float] = []
    draw = cost.draw_costs
    monkeypatch.setattr(cost, "draw_costs", lambda path, found, line: (lines.append(line), draw(path, found, line)))
    out = folders[0].parent / "cost.png"
    monkeypatch.setattr(sys, "argv", ["cost", *map(str, folders), "--out", str(out)])
    cost.main()
    assert out.read_bytes()[:4] == b"\x89PNG"
    assert lines == [pytest.approx(3.72, abs=0.01)]
    assert "`lean, width 16`" in capsys.readouterr().out
