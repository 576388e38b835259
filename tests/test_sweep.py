"""A sweep: many runs that are lived once, whatever is killed, and one table and figure of them."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from conftest import PATIENCE, hearing

from ecology import EcologyError
from ecology.lab.cli import main
from ecology.lab.runs import sweep as sweeps
from ecology.lab.runs.folder import lock
from ecology.lab.runs.run import open_run

WORLD = """
import os, pathlib, signal, sys
from ecology import Arena, EcologyError, Need, Resource, Scenario, Species, consume, rest

def build(decay=0.01, kills=0, orphaned=0, refuses=False, pairs=(1, 2), ticks=60, evaluated=0):
    here = pathlib.Path(__file__).parent
    if "ecology.lab.cli.worker" in sys.orig_argv:  # in the process of a run, not in the sweep's own
        if evaluated:
            worker = sys.modules["__main__"]
            worker.EVALUATED, worker.SKIPPED = evaluated, evaluated // 10
        folder = pathlib.Path(sys.orig_argv[-1])
        with open(here / "attempts", "a") as file:
            file.write(f"{folder.name}\\n")
        if (here / "attempts").read_text().split().count(folder.name) <= kills:
            os.kill(os.getpid(), signal.SIGKILL)
        if (here / "attempts").read_text().split().count(folder.name) <= orphaned:
            os.kill(os.getppid(), signal.SIGKILL)
        if refuses:
            raise EcologyError("the world refuses to be.")
    need = Need(name="food", set_point=2.0, decay=decay, noise=0.02, bounds=(0.0, 4.0))
    agent = Species(name="agent", needs=(need,), actions=(rest(), consume("berries", {"food": 0.1})),
                    learner="random", position=(1.0, 1.0))
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(agent,),
                    resources=(Resource(name="berries", position=(1.0, 1.0)),), ticks=ticks)
"""

Sweep = Callable[..., tuple[int, str, str]]


@pytest.fixture
def sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Sweep:
    """Return `ecology sweep world.py --out out` in an empty folder: more words -> exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    Path("world.py").write_text(WORLD)

    def type_(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as left:
            main(["sweep", "world.py", "--out", "out", *words])
        return int(left.value.code or 0), *capsys.readouterr()

    return type_


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Live runs in this process instead of one of their own, and return the list of those begun."""
    begun: list[str] = []

    def attempt(cell: sweeps.Cell, stop: threading.Event) -> tuple[int, str]:
        begun.append(cell.name)
        run = open_run(cell.folder)
        run.resume()
        run.live()
        return 0, ""

    monkeypatch.setattr(sweeps, "by_process", attempt)
    return begun


def rows(out: str = "out") -> dict[str, list[Any]]:
    """Return the table of the sweep in the folder `out`."""
    return pq.read_table(f"{out}/sweep.parquet").to_pydict()


@pytest.mark.parametrize(
    ("text", "seeds"),
    [("0:4", [0, 1, 2, 3]), ("7", [7]), ("1,4,9:12", [1, 4, 9, 10, 11]), ("3,3,2:4", [3, 2])],
)
def test_seeds_are_ranges_and_lists(text: str, seeds: list[int]) -> None:
    """FIRST:END without END, single seeds, and lists of both, each seed once."""
    assert sweeps.seeds_of(text) == seeds


@pytest.mark.parametrize("text", ["", "a", "4:2", "3:3", "-1:2", "0:1:2", "1,", "0:99999999999"])
def test_bad_seeds_are_one_clear_error(sweep: Sweep, text: str) -> None:
    """What is no list of seeds gives exit code 2, names what was typed and leaves nothing."""
    code, _, err = sweep("--seeds", text)
    assert code == 2
    assert f"got {text!r}" in err
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a=1,2.5", [1, 2.5]),
        ("a=true,false", [True, False]),
        ("a=[1, 2],[3, 4]", [[1, 2], [3, 4]]),
        ("a=free,committed", ["free", "committed"]),
        ("a='x,y',z", ["x,y", "z"]),
        ('a="x,y",z', ["x,y", "z"]),
        ('a="x\\",y",z', ['x",y', "z"]),
        ("a=don't,won't", ["don't", "won't"]),
        ("a='open,z", ["'open", "z"]),
        ("a=1,2,", [1, 2]),
        ("a=1,1.0,2,1", [1, 2]),
        ("a=1,true,True", [1, True]),
        ("a=.5,1.", [0.5, 1.0]),
        ("a=None,3", [None, 3]),
        ("a=(1, 2),[1, 2],[3, .4]", [(1, 2), [3, 0.4]]),
        ('a="x,y"', ["x,y"]),
        ("a = 3", [3]),
    ],
)
def test_values_are_toml_or_words(text: str, values: list[Any]) -> None:
    """Commas outside of quotes and brackets separate values; values that mean the same are there once."""
    key, found = sweeps.values_of(text)
    assert key == "a"
    assert repr(found) == repr(values)


def test_values_that_mean_the_same_are_one_run(sweep: Sweep, tmp_path: Path) -> None:
    """A setting written in two ways, and a learner given twice, are lived once."""
    cells = sweeps.cells_of(
        str(tmp_path / "world.py"), tmp_path / "out", seeds=[0], ticks=5,
        settings=dict([sweeps.values_of("decay=1,1.0,1e0"), sweeps.values_of("pairs=[1, 2],(1, 2)")]),
        learners=["random,rest,random"],
    )  # fmt: skip
    assert [cell.varied["learner"] for cell in cells] == ["random", "rest"]


def test_a_sweep_leaves_a_table_and_a_figure(sweep: Sweep, quick: list[str]) -> None:
    """A row per run holds settings, learner, seed and what summary.json says; the intervals are Student's."""
    words = ("--seeds", "0:2", "--set", "decay=0.05", "--learner", "random,rest", "--workers", "1")
    code, out, err = sweep(*words, "--set", "pairs=[1, 2],[3, 4]", "--ticks", "40", "--quiet")
    assert (code, out, err) == (0, "", "")
    table = rows()
    assert len(quick) == len(table["run"]) == 2 * 2 * 2
    assert table["set.decay"] == [0.05] * 8
    assert table["set.pairs"].count([3, 4]) == 4
    for i, name in enumerate(table["run"]):
        summary = json.loads(Path("out/runs", name, "summary.json").read_text())
        assert summary["seed"] == table["seed"][i]
        assert summary["learner"]["agent"] == table["learner.agent"][i]
        assert summary["mean_drive"] == table["mean_drive"][i]
        assert summary["mean_abs_deviation"]["agent"]["food"] == table["mean_abs_deviation.agent.food"][i]
        assert table["ticks"][i] == summary["ticks"] == 40
        assert f"learner={table['learner.agent'][i]}" in name
    assert Path("out/sweep.png").read_bytes()[:4] == b"\x89PNG"
    cells = sweeps.cells_of("world.py", Path("out").absolute(), seeds=[0, 1], settings={"decay": [0.01, 0.05]})
    drives = ((1.0, 2.0), (3.0, 3.0))
    found = sweeps.points(sweeps.Outcome(cell, {"mean_drive": drives[i // 2][i % 2]}) for i, cell in enumerate(cells))
    t = 12.7062047  # of 1 degree of freedom, 97.5 %
    assert (found[0].mean, found[0].low, found[0].high) == pytest.approx((1.5, 1.5 - t * 0.5, 1.5 + t * 0.5))
    assert (found[1].low, found[1].high) == (3.0, 3.0)


def test_a_finished_run_is_never_run_twice(sweep: Sweep, quick: list[str]) -> None:
    """The same command again runs nothing, a larger sweep the new runs alone, and both tell of all."""
    words = ("--set", "decay=0.01,0.05", "--workers", "1")
    assert sweep(*words, "--seeds", "0:2")[0] == 0
    assert len(quick) == 4
    first, picture = rows(), Path("out/sweep.png").read_bytes()
    code, out, _ = sweep(*words, "--seeds", "0:2")
    assert code == 0
    assert "4 of 4 runs are whole" in out
    assert (len(quick), rows(), Path("out/sweep.png").read_bytes()) == (4, first, picture)
    assert sweep(*words, "--seeds", "0:3")[0] == 0
    assert quick[4:] == ["decay=0.01_seed=2", "decay=0.05_seed=2"]
    assert len(rows()["run"]) == 6
    # a run that was stopped is resumed, not restarted
    folder = Path("out/runs/decay=0.01_seed=1")
    summary = json.loads((folder / "summary.json").read_text())
    (folder / "summary.json").write_text(json.dumps(summary | {"stopped_at": 60, "ticks": 30}))
    kept = (folder / "checkpoint/checkpoint.json").read_bytes()
    assert sweep(*words, "--seeds", "0:3")[0] == 0
    assert quick[6:] == ["decay=0.01_seed=1"]
    assert (folder / "checkpoint/checkpoint.json").read_bytes() == kept
    assert json.loads((folder / "summary.json").read_text())["mean_drive"] == summary["mean_drive"]


@pytest.mark.one_seed("runs of a sweep are lived by other processes")
def test_what_was_learned_is_measured_after_the_run(sweep: Sweep, quick_evaluation: None) -> None:
    """With --evaluate the table holds the drive that `ecology evaluate` finds; what is lived is not lived again."""
    words = ("--set", "evaluated=400")
    assert sweep(*words, "--seeds", "0")[0] == 0
    lived = rows()
    code, out, err = sweep(*words, "--seeds", "0,4", "--evaluate")
    assert code == 0, err
    assert "learned drive" in out
    table = rows()
    assert {key: table[key][:1] for key in lived} == lived  # its seconds too
    run = Path("out/runs/seed=4")
    with pytest.raises(SystemExit, match="0"):
        main(["evaluate", str(run), "--ticks", "400", "--places", "1", "--quiet"])
    told = json.loads((run / "evaluation.json").read_text())
    assert table["learned_drive"][1] == pytest.approx(told["mean_drive"]["learned"]["mean"])
    assert table["learned_drive"][0] != table["learned_drive"][1]


@pytest.mark.parametrize(
    ("words", "edit", "named"),
    [
        (("--ticks", "70"), None, "ticks"),
        (("--set", "decay=0.02"), None, "settings"),
        (("--learner", "rest"), None, "learners"),
        ((), ("noise=0.02", "noise=0.03"), "the scenario file"),
    ],
)
def test_runs_of_another_sweep_are_refused(
    sweep: Sweep, quick: list[str], words: tuple[str, ...], edit: tuple[str, str] | None, named: str
) -> None:
    """Runs that were told something else are neither mixed in nor overwritten: exit code 2 names the difference."""
    assert sweep("--seeds", "0:1")[0] == 0
    before = {path: path.read_bytes() for path in Path("out").rglob("*") if path.is_file()}
    if edit:
        Path("world.py").write_text(WORLD.replace(*edit))
    code, _, err = sweep("--seeds", "0:2", *words)
    assert code == 2
    assert f"it differs in {named}" in err
    assert {path: path.read_bytes() for path in Path("out").rglob("*") if path.is_file()} == before


def test_a_table_loses_no_row(sweep: Sweep, quick: list[str]) -> None:
    """A sweep without all runs of the table is refused and writes nothing; one with all of them, and more, goes on."""
    words = ("--set", "decay=0.01,0.05")
    assert sweep(*words, "--seeds", "0:2")[0] == 0
    before = {path: path.read_bytes() for path in Path("out").rglob("*") if path.is_file()}
    for fewer in (
        ("--seeds", "0:2", "--ticks", "30"),
        (*words, "--seeds", "0:1"),
        ("--seeds", "0:2"),
    ):
        code, _, err = sweep(*fewer)
        assert code == 2
        assert "'" + str(Path("out").absolute()) + "' holds a sweep of 4 runs" in err
        assert "Give another --out" in err
        assert {path: path.read_bytes() for path in Path("out").rglob("*") if path.is_file()} == before
    assert "2 of which this one leaves out: " in sweep(*words, "--seeds", "0:1")[2]
    shutil.rmtree("out/runs")  # the table alone is left: the same sweep is lived again, another is refused
    code, _, err = sweep(*words, "--seeds", "0:2", "--ticks", "30")
    assert code == 2
    assert "4 of which this one leaves out: " in err
    del quick[:]
    assert sweep("--set", "decay=0.01,0.05,0.1", "--seeds", "0:2")[0] == 0
    assert len(quick) == len(rows()["run"]) == 6
    Path("out/sweep.parquet").write_bytes(b"mine")
    assert "is damaged" in sweep(*words, "--seeds", "0:2")[2]


def test_what_cannot_be_measured_keeps_its_row(sweep: Sweep, quick: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a sweep is stopped while it measures, the lives that the table had stay in it."""
    assert sweep("--seeds", "0:2")[0] == 0
    before = rows()
    monkeypatch.setattr(sweeps, "by_process", lambda *_: (sweeps.USER_ERROR, "no"))
    assert sweep("--seeds", "0:2", "--evaluate")[0] == 2
    assert rows() == before


def test_a_sweep_is_not_written_into_a_run(sweep: Sweep) -> None:
    """A folder that holds a run is refused as --out, and stays as it is."""
    assert sweep("--seeds", "0")[0] == 0
    run = Path("out/runs/seed=0")
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    code, _, err = sweep("--seeds", "0", "--out", str(run))
    assert code == 2
    assert "holds a run" in err
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--set", "decy=1"], "'decay'"),
        (["--set", "decay=0.1,much"], "'much'"),
        (["--set", "decay"], "KEY=VALUE"),
        (["--set", "decay="], "KEY=VALUE"),
        (["--set", "decay=0.1", "--set", "decay=0.2,0.3"], "write --set decay=0.1,0.2,0.3 alone"),
        (["--learner", "random,randon"], "'random'"),
        (["--learner", "agnt=rest"], "'agent'"),
        (["--ray", "local"], "pip install -e '.[ray]'"),
    ],
)
def test_bad_words_are_one_clear_error(
    sweep: Sweep, monkeypatch: pytest.MonkeyPatch, words: list[str], named: str
) -> None:
    """A bad word gives exit code 2 before anything is run."""
    monkeypatch.setitem(sys.modules, "ray", None)
    code, _, err = sweep(*words)
    assert code == 2
    assert named in err
    assert "Traceback" not in err
    assert not Path("out/runs").exists()


def attempts() -> list[str]:
    """Return the names of the runs in the order in which their processes built the world."""
    return Path("attempts").read_text().split()


def test_a_killed_run_is_gone_on_with_and_the_rest_lives(sweep: Sweep, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that is killed is begun again, to the same end; after so many deaths the run is named, exit code 1."""
    monkeypatch.setattr(sweeps, "RETRIES", 1)
    code, out, err = sweep("--seeds", "0:1", "--set", "kills=0,1,99", "--workers", "2")
    assert code == 1
    assert "2 of 3 runs are whole" in out
    assert "kills=99_seed=0 failed: its process died 2 times, at last with exit code -9" in err
    assert "Traceback" not in err
    tried = attempts()
    assert tried.count("kills=99_seed=0") == 2
    table = rows()
    assert table["set.kills"] == [0, 1]
    assert table["mean_drive"][0] == table["mean_drive"][1]


def test_a_run_that_fails_by_itself_is_not_repeated(sweep: Sweep) -> None:
    """An error that another attempt would not change is told once, in its own words, with exit code 2."""
    code, _, err = sweep("--seeds", "0:1", "--set", "refuses=true,false", "--workers", "1")
    assert code == 2
    assert "failed: ecology: the world refuses to be." in err
    assert attempts().count("refuses=True_seed=0") == 1
    assert rows()["set.refuses"] == [False]


def _alive(marker: str) -> list[int]:
    """Return the processes whose words hold `marker`."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if marker.encode() in path.read_bytes() and int(path.parent.name) != os.getpid():
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="asks the system which processes there are")
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGKILL])
def test_a_sweep_that_ends_leaves_nobody_running(sweep: Sweep, tmp_path: Path, signum: signal.Signals) -> None:
    """Ctrl-C stops the runs, keeps what is finished and its table; where the sweep is killed, its runs stop too."""
    out = tmp_path / "out"
    with hearing(signum):
        process = subprocess.Popen(
            [sys.executable, "-m", "ecology.lab.cli", "sweep", "world.py", "--out", str(out), "--seeds", "0",
             "--set", "ticks=60,3000000", "--workers", "2"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    short, long = sweeps.cells_of("world.py", out, seeds=[0], settings={"ticks": [60, 3000000]})
    until = time.monotonic() + PATIENCE
    while not ((long.folder / "checkpoint").exists() and sweeps.finished_summary(short)) and time.monotonic() < until:
        time.sleep(0.05)
    process.send_signal(signum)
    try:
        said, errors = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    while _alive(str(out)) and time.monotonic() < until + 20:
        time.sleep(0.05)
    assert not _alive(str(out))
    assert "Traceback" not in errors
    summary = json.loads((long.folder / "summary.json").read_text())
    assert summary["stopped_by"] == "SIGTERM"
    assert summary["stopped_at"] == summary["ticks"]
    if signum == signal.SIGINT:
        assert process.returncode == 130
        assert "the same command resumes" in said
        assert pq.read_table(out / "sweep.parquet")["ticks"].to_pylist() == [60]
    assert sweeps.finished_summary(short)
    assert not sweeps.finished_summary(long)


def test_two_processes_in_one_folder_are_kept_apart(sweep: Sweep, quick: list[str]) -> None:
    """While one process writes to a folder, another is refused with exit code 2."""
    assert sweep("--seeds", "0:1")[0] == 0
    with lock(Path("out")):
        code, _, err = sweep("--seeds", "0:2")
    assert code == 2
    assert "another process is writing to the folder" in err
    with lock(Path("out/runs/seed=0")), pytest.raises(SystemExit, match="2"):
        main(["run", "--resume", "out/runs/seed=0", "--ticks", "80"])
    started = time.monotonic()
    with (
        lock(Path("out")),
        pytest.raises(EcologyError, match="another process"),
        lock(Path("out"), patience=0.3),
    ):
        pass
    assert time.monotonic() - started >= 0.3


def test_a_sweep_lives_on_ray(sweep: Sweep) -> None:
    """On a Ray cluster the same runs come to the same, and a worker that is killed is replaced."""
    pytest.importorskip("ray", reason="the extra ray is not installed")
    words = ("--seeds", "5", "--set", "kills=0,1", "--set", "orphaned=0,1")
    command = [sys.executable, "-m", "ecology.lab.cli", "sweep", "world.py", *words]
    done = subprocess.run(
        [*command, "--out", "out", "--ray", "local"], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 0, done.stderr
    on_ray, usual = rows(), attempts().count("kills=0_orphaned=0_seed=5")
    assert attempts().count("kills=1_orphaned=0_seed=5") == usual + 1
    assert attempts().count("kills=0_orphaned=1_seed=5") > usual
    assert len(on_ray["run"]) == 4
    code, _, err = sweep("--seeds", "5", "--out", "here")  # the same without Ray
    assert code == 0, err
    assert {*on_ray["mean_drive"]} == {*rows("here")["mean_drive"]}


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nowhere", "ray://127.0.0.1:1", "127.0.0.1:99999"])
def test_a_cluster_that_is_not_there_is_one_clear_error(sweep: Sweep, address: str) -> None:
    """An address at which nobody answers gives exit code 2 and names it."""
    pytest.importorskip("ray", reason="the extra ray is not installed")
    code, _, err = sweep("--ray", address)
    assert code == 2
    assert f"{address!r}" in err
    assert "Traceback" not in err
