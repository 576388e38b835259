"""`ecology evaluate`: what it writes, keeps and prints."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest
from conftest import Command

from ecology import agents, errors
from ecology.lab.cli.commands import evaluate


def test_evaluate_measures_and_draws(short: Command, ecology: Command) -> None:
    """`ecology evaluate` restores the learner, and writes evaluation.json and figures to the run's folder."""
    assert short("seasons", "--out", "mine")[0] == 0
    code, out, err = ecology("evaluate", "mine", "--ticks", "100", "--places", "1", "--quiet")
    assert (code, out, err) == (0, "", "")
    report = json.loads(Path("mine/evaluation.json").read_text())
    assert (report["scenario"], report["learner"], report["ticks"], report["skip"]) == (
        "seasons",
        "random",
        100,
        10,
    )
    assert report["mean_drive"].keys() >= {"learned", "planner", "camping", "greedy", "random", "rest"}
    drawn = {path.name for path in Path("mine/figures").iterdir()}
    assert drawn >= {"internal_states.png", "trajectory.png", "baselines.png"}
    code, _, err = ecology("evaluate", "mine", "--species", "agnt")
    assert code == 2
    assert "'agent'" in err


def test_an_evaluation_is_replaced_by_its_like_alone(ecology: Command, quick_evaluation: None) -> None:
    """Other ticks, places, seeds and devices are refused, with what is there; --again and the same words replace it."""
    run = ("run", "predator_prey", "--ticks", "30", "--learner", "random", "--no-record", "--quiet", "--out", "mine")
    assert ecology(*run, "--set", "prey=3", "--set", "predators=2")[0] == 0
    evaluate = ("evaluate", "mine", "--quiet", "--places", "1", "--ticks")
    assert ecology(*evaluate, "50") == (0, "", "")

    def files() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in Path("mine").rglob("*") if path.is_file()}

    before = files()
    for words, told in (
        (("40",), "ticks 50 instead of 40"),
        (("50", "--places", "2"), "places 1 instead of 2"),
        (("50", "--seed", "7", "--ticks", "60"), "seed 1000 instead of 7, ticks 50 instead of 60"),
    ):
        code, _, err = ecology(*evaluate, *words)
        assert code == 2
        assert f"the folder 'mine' holds an evaluation that was made with {told}; give --again" in err
        assert files() == before
    Path("mine/evaluation.json").write_text(before[Path("mine/evaluation.json")].decode().replace('"cpu"', '"cuda"'))
    assert "made with device 'cuda' instead of 'cpu'; " in ecology(*evaluate, "50")[2]
    Path("mine/evaluation.json").write_bytes(before[Path("mine/evaluation.json")])
    assert ecology(*evaluate, "50") == (0, "", "")
    assert ecology(*evaluate, "40", "--again") == (0, "", "")
    assert json.loads(Path("mine/evaluation.json").read_text())["ticks"] == 40
    Path("mine/evaluation.json").write_text("[]")
    assert "is damaged" in ecology(*evaluate, "40")[2]
    assert Path("mine/evaluation.json").read_text() == "[]"


def test_every_species_has_an_evaluation_of_its_own(ecology: Command, quick_evaluation: None) -> None:
    """That of a species other than the first lies in a folder of its name within the run's, in every world."""
    run = ("run", "predator_prey", "--ticks", "30", "--learner", "random", "--no-record", "--quiet", "--out", "mine")
    assert ecology(*run, "--set", "prey=3", "--set", "predators=2")[0] == 0
    evaluate = ("evaluate", "mine", "--quiet", "--places", "1", "--ticks", "50")
    for words, folder, species in (
        ((), "mine", "prey"),
        (("--species", "prey"), "mine", "prey"),
        (("--species", "predator"), "mine/of-predator", "predator"),
        (
            ("--species", "predator", "--set", "wound=1.0"),
            "mine/of-predator-in-predator_prey-wound=1.0",
            "predator",
        ),
    ):
        assert ecology(*evaluate, *words) == (0, "", "")
        assert json.loads(Path(folder, "evaluation.json").read_text())["species"] == species
        assert Path(folder, "figures").is_dir()
    assert {path.parent.name for path in Path("mine").rglob("evaluation.json")} == {
        "mine", "of-predator", "of-predator-in-predator_prey-wound=1.0",
    }  # fmt: skip


def test_an_evaluation_is_there_when_it_is_whole(
    short: Command, ecology: Command, monkeypatch: pytest.MonkeyPatch, quick_evaluation: None
) -> None:
    """evaluation.json is written last, names the learner as the plan does, and not where anything fails."""
    from ecology.agents import figures

    chance = {"chance": ("ecology.agents.baselines", "Random", None, "")}
    monkeypatch.setattr(agents, "LEARNERS", {**agents.LEARNERS, **chance})
    assert short("seasons", "--out", "mine", "--learner", "chance")[0] == 0
    evaluate = ("evaluate", "mine", "--ticks", "50", "--places", "1", "--quiet")

    def fail(*_: object) -> None:
        raise OSError("no space")

    with monkeypatch.context() as patch:
        patch.setattr(figures, "draw_evaluation", fail)
        code, _, err = ecology(*evaluate)
    assert code == 2
    assert "'mine' cannot be written (no space)" in err
    assert "Traceback" not in err
    assert not Path("mine/evaluation.json").exists()
    Path("mine/metrics.parquet").write_bytes(b"PAR1")
    code, _, err = ecology(*evaluate)
    assert code == 2
    assert "metrics.parquet" in err
    assert "Traceback" not in err
    assert not Path("mine/evaluation.json").exists()
    Path("mine/metrics.parquet").unlink()
    assert ecology(*evaluate)[0] == 0
    assert json.loads(Path("mine/evaluation.json").read_text())["learner"] == "chance"


def test_an_evaluation_that_cannot_be_kept_is_not_begun(
    short: Command, ecology: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file in the place of the figures, and a folder in which no file can be made, are told before the measuring."""
    from ecology.agents import evaluation

    def never(*_: object, **__: object) -> None:
        raise AssertionError("it was measured")

    assert short("seasons", "--out", "mine")[0] == 0
    before = set(Path("mine").iterdir())
    monkeypatch.setattr(evaluation, "evaluate", never)
    Path("mine/figures").write_text("mine")
    code, _, err = ecology("evaluate", "mine", "--quiet")
    assert code == 2
    assert "'mine/figures' is a file" in err
    assert "Traceback" not in err
    assert Path("mine/figures").read_text() == "mine"
    Path("mine/figures").unlink()
    monkeypatch.setattr(errors.tempfile, "TemporaryFile", _refused)
    for more in ((), ("--in", "paper")):
        code, _, err = ecology("evaluate", "mine", "--quiet", *more)
        assert code == 2
        assert "Permission denied" in err
        assert "Traceback" not in err
    assert set(Path("mine").iterdir()) == before


def _refused(*_: object, **__: object) -> None:
    raise PermissionError(errno.EACCES, "Permission denied")


@pytest.mark.parametrize(("gap", "words"), [(-7.35, "worse than camping"), (0.5, "50% of the way")])
def test_worse_than_camping_is_said_plainly(capsys: pytest.CaptureFixture[str], gap: float, words: str) -> None:
    """A learner below the first yardstick is not said to be a share of the way to the second."""
    report = {
        "scenario": "paper",
        "ticks": 10,
        "device": "cpu",
        "mean_drive": {},
        "regulated": {"below": None, "of": "camping"},
        "as_lived": None,
        "worst_block": {"learned": None, "learned_epsilon_0": None},
        "stuck": {"learned": None, "learned_epsilon_0": None},
        "closed_gap": gap,
        "deviation_maps": None,
    }
    evaluate._say_findings({**report, "probe": {}, "deviation_check": None})
    out = capsys.readouterr().out
    assert words in out
    assert "-735" not in out
