"""The measures of many seeds: what they are, that they resume, and the table of what must hold."""

import json
import threading
from pathlib import Path

import numpy as np
import pytest

from ecology import EcologyError
from ecology.agents import evaluation, lives
from ecology.lab import cli
from ecology.lab.certificate import minds
from ecology.lab.runs.folder import write_json

SMALL = {f"learner.{key}": value for key, value in {"width": 8, "batch": 8, "batch_f": 8, "memory": 200}.items()}


@pytest.fixture
def short(monkeypatch):
    """Make every measure short."""
    for name, value in {"PROBES": 1, "PROBE_TICKS": 40, "STARTS": 1, "PER_MOVEMENT": 1}.items():
        monkeypatch.setattr(evaluation, name, value)
    monkeypatch.setattr(lives, "WINDOW", 200)
    monkeypatch.setattr(minds, "ADAPTS", 300)
    monkeypatch.setattr(minds, "PROBES", 1)


def seed(number=0, **changes):
    """Return the measures of a seed as JSON holds them."""
    frozen = {"mean_drive": 0.6, "worst_block": 1.5, "stuck": [], "bias_life": -0.02, "bias_starts": -0.08}
    frozen |= {"least_explained": 0.9, "spearman": 0.97, "minima_within_1": 4, "probe": 0.95}
    told = {
        "seed": number, "ticks": 60_000, "life": 20_000, "frozen": frozen, "greedy": {"mean_drive": 0.45},
        "lived": {"last_tenth": 0.8, "regulated_from": 5_000}, "moved": {"recovered_after": 2_500},
    }  # fmt: skip
    for path, value in changes.items():
        part, _, key = path.partition("__")
        told[part] = {**told[part], key: value}
    return told


def table(*seeds):
    """Return the rows of a table by what they measure."""
    return {row[0]: dict(zip(minds.HEAD, row, strict=True)) for row in minds.rows(seeds)}


def test_a_seed_is_measured_whole_and_only_once(short, tmp_path, monkeypatch):
    """Every target finds its measure; a second call does nothing again, and one that was stopped takes what is left."""
    heard = []
    told = minds.measure_seed(3, 400, SMALL, life=400, folder=tmp_path / "run", tell=heard.append)
    assert heard == ["training", *minds.MEASURES]
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert (told["seed"], told["ticks"], told["life"]) == (3, 400, 400)
    for target in minds.TARGETS:
        assert target.key in told[target.part], target.what
    assert minds.is_done(tmp_path / "run", 400)
    assert not minds.is_done(tmp_path / "run", 500)

    path = tmp_path / "run" / minds.DONE
    part = {key: value for key, value in told.items() if key != "greedy"}
    write_json(path, part)
    heard.clear()
    again = minds.measure_seed(3, 400, SMALL, life=400, folder=tmp_path / "run", tell=heard.append)
    assert heard == ["greedy"]
    assert {**again, "seconds": 0} == {**told, "seconds": 0}
    with pytest.raises(EcologyError, match="differs in seed"):
        minds.measure_seed(4, 400, SMALL, life=400, folder=tmp_path / "run")


def test_a_moved_food_lies_at_the_other_end():
    """The place can be reached, a walk of nearly eight lengths from where the food was, and is on no other food."""
    from ecology.agents.planner import Paths
    from ecology.scenarios import load

    world = load("paper")
    food = next(each for each in world.resources if each.name == minds.MOVED)
    paths = Paths(world.arena, world.species[0].radius)
    others = [each for each in world.resources if each.name != minds.MOVED]
    far = float(paths.distance(np.array([food.position]), minds.PLACE)[0])
    assert 7.5 < far < 9.0
    assert all(np.hypot(*np.subtract(minds.PLACE, each.position)) > 2.0 for each in others)


def test_median_and_worst_are_held_to_what_must_be():
    """A measure is reached where both median and worst are; a tick that never came is the worst."""
    good = table(*[seed(i) for i in range(3)])
    assert {row["reached"] for row in good.values()} == {"yes"}
    found = table(
        seed(0), seed(1, frozen__mean_drive=0.97, frozen__bias_life=-0.2), seed(2, lived__regulated_from=None),
        seed(3, frozen__worst_block=2.1, frozen__least_explained=0.79),
    )  # fmt: skip
    missed = {what: row for what, row in found.items() if row["reached"] == "no"}
    assert {what.partition(",")[0]: row["worst seed"] for what, row in missed.items()} == {
        "mean drive": "1",
        "first tick from which the running mean (2": "2",
        "worst block of 1": "3",
        "least share of change explained by f": "3",
    }
    drive = found["mean drive, epsilon 0.05"]
    assert (drive["must be"], drive["here (median / worst)"]) == ("0.70 / 0.95", "0.60 / 0.97")
    late = found["first tick from which the running mean (2,000 ticks) stays below 2.0"]
    assert late["here (median / worst)"] == "5,000 / never"
    assert found["bias of J along a life"]["here (median / worst)"] == "-0.02 / -0.20"
    never = table(seed(0, moved__recovered_after=None))
    assert "never / never" in {row["here (median / worst)"] for row in never.values()}


def test_what_is_measured_otherwise_lies_elsewhere(tmp_path, monkeypatch):
    """Another arithmetic, length or setting is another folder; comments in the code are not."""
    monkeypatch.delenv("NUMBA_CPU_NAME", raising=False)

    def folder(ticks=5000, life=4000, settings=None):
        return minds.jobs(tmp_path, [7], ticks, life, settings or {})[0].folder

    there = folder()
    assert there == folder()
    others = {folder(6000), folder(life=5000), folder(settings={"learner.width": 8})}
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    others.add(folder())
    assert len(others | {there}) == 5
    with pytest.raises(EcologyError, match="--life must be at least 2000"):
        folder(life=1999)
    with pytest.raises(EcologyError, match="no setting 'widht'"):
        folder(settings={"learner.widht": 8})


def test_all_code_that_decides_how_a_run_goes_is_in_the_digest():
    """A change of a kernel, a sense or the geometry counts as other code; the laboratory and the viewer do not."""
    found = {"/".join(path.parts[-2:]) for path in minds.code_files()}
    assert {"cpu/lookahead.py", "hjb/learner.py", "senses/others.py", "ground/walls.py", "ecology/world.py"} <= found
    assert {"certificate/minds.py", "observers/page.py", "scenarios/paper.py", "agents/figures.py"}.isdisjoint(found)


def test_a_seed_that_fails_is_told(tmp_path):
    """A process that cannot measure its seed ends with the reason."""
    job = minds.Job(seed=0, ticks=3000, life=2000, settings={"learner.widht": 1}, folder=tmp_path / "seed-0")
    assert "has no setting 'widht'" in minds.work(job, threading.Event())[1]


@pytest.fixture
def at_once(monkeypatch):
    """Have seeds measured at once, and return those that were; seed 5 cannot be."""
    done = []

    def work(job, stop):
        done.append(job.seed)
        if job.seed == 5:
            return job, "it broke"
        job.folder.mkdir(parents=True)
        write_json(job.folder / minds.DONE, seed(job.seed) | {"life": job.life, "ticks": job.ticks})
        return job, ""

    monkeypatch.setattr(minds, "work", work)
    return done


def ends(*words):
    """Return the exit code of `ecology reproduce WORDS`."""
    with pytest.raises(SystemExit) as end:
        cli.main(["reproduce", *words])
    return end.value.code


def test_minds_prints_what_must_hold_beside_what_was_found(at_once, tmp_path, capsys, monkeypatch):
    """One table on the screen, as Markdown and as JSON; a second call with more seeds measures those alone."""
    monkeypatch.setenv("NUMBA_CPU_NAME", "generic")
    words = ("minds", "--ticks", "3000", "--life", "2000", "--workers", "1", "--out", str(tmp_path))
    assert ends(*words, "--seeds", "0:2") == 0
    out = capsys.readouterr()
    assert "2 seeds, 2 of them to measure; about" in out.err
    assert "1 of 2  seed 0: mean drive 0.60, worst block 1.50, with epsilon 0 0.45; about" in out.err
    text = (tmp_path / "minds-generic.md").read_text()
    assert text in out.out
    assert f"{minds.processor()['processor']}, compiled for generic" in text
    assert "| mean drive, epsilon 0.05 | 0.98 / 2.65 | 0.70 / 0.95 | 0.60 / 0.60 | 0 | yes |" in text
    assert ends(*words, "--seeds", "0:4") == 0
    assert at_once == [0, 1, 2, 3]
    told = json.loads((tmp_path / "minds-generic.json").read_text())
    assert [each["seed"] for each in told["seeds"]] == [0, 1, 2, 3]
    assert (told["ticks"], told["life"], told["numba_cpu_name"]) == (3000, 2000, "generic")
    assert not (tmp_path / "certificate.md").exists()

    capsys.readouterr()
    assert ends(*words, "--seeds", "4:6") == 2
    assert "1 of 2 seeds were not measured. seed 5: it broke" in capsys.readouterr().err


def test_options_of_minds_need_its_name(tmp_path, capsys):
    """An option of `minds` without it is refused, and nothing is written."""
    for words in (("theory", "--seeds", "0:2"), ("--ticks", "3000"), ("theory", "--set", "learner.width=8")):
        assert ends(*words, "--out", str(tmp_path / "out")) == 2
        assert f"{words[-2]} is an option of `ecology reproduce minds`" in capsys.readouterr().err
    assert not Path(tmp_path / "out").exists()
