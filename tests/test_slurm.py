"""Sweeps as jobs of Slurm: what is asked of it, what is submitted again, and real jobs on this machine."""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from ecology import EcologyError
from ecology.lab.cli import main
from ecology.lab.runs import slurm, sweep


class FailedJobError(Exception):
    """A job whose node failed."""


@pytest.fixture
def submitit(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Return a stand-in for the package: `asked` are parameters, `fails` how many jobs end before their run."""
    module = SimpleNamespace(asked={}, submitted=[], cancelled=[], fails=0, done=True)

    class Job:
        def done(self) -> bool:
            return module.done

        def cancel(self) -> None:
            module.cancelled.append(self)

        def result(self) -> tuple[int, str]:
            if len(module.submitted) <= module.fails:
                raise FailedJobError("node n3 failed\nand more")
            return 0, ""

    class Executor:
        def __init__(self, folder: Path, cluster: str) -> None:
            module.folder, module.cluster = folder, cluster

        def update_parameters(self, **needs: Any) -> None:
            module.asked.update(needs)

        def submit(self, function: Any, *words: Any) -> Job:
            module.submitted.append((function, *words))
            return Job()

    module.AutoExecutor = Executor
    module.core = SimpleNamespace(
        utils=SimpleNamespace(FailedJobError=FailedJobError, UncompletedJobError=FailedJobError)
    )
    monkeypatch.setitem(sys.modules, "submitit", module)
    monkeypatch.setattr(slurm.shutil, "which", lambda name: f"/usr/bin/{name}")
    return module


def cell(folder: Path) -> sweep.Cell:
    """Return a short run of a sweep."""
    return sweep.cells_of("commons", folder, seeds=[0], settings={}, ticks=20)[0]


def test_a_job_asks_for_what_a_run_needs(submitit: SimpleNamespace, tmp_path: Path) -> None:
    """Partition, CPU, GPUs, memory and time go to Slurm; its own default stays where nothing is said."""
    slurm.by_slurm("gpu", tmp_path, gpus=2.0, memory=3.5, minutes=90)
    assert submitit.cluster == "slurm"
    assert submitit.asked == {
        "name": "ecology", "cpus_per_task": 1, "gpus_per_node": 2, "mem_gb": 3.5, "timeout_min": 90,
        "slurm_partition": "gpu",
    }  # fmt: skip
    submitit.asked.clear()
    slurm.by_slurm("default", tmp_path)
    assert submitit.asked == {"name": "ecology", "cpus_per_task": 1}
    with pytest.raises(EcologyError, match=r"whole GPUs to a job, got --gpus-per-run 0\.5"):
        slurm.by_slurm("gpu", tmp_path, gpus=0.5)


def test_a_job_that_fails_is_submitted_again(submitit: SimpleNamespace, tmp_path: Path) -> None:
    """A node that fails costs no run: the next job resumes it, a few times."""
    submitit.fails = 2
    attempt, count = slurm.by_slurm("gpu", tmp_path)
    assert count() == slurm.AT_ONCE
    outcome = sweep._run_cell(cell(tmp_path), attempt, threading.Event())
    assert len(submitit.submitted) == 3
    assert outcome.failed.startswith("its folder")  # no job ran here, so it is not seen
    submitit.fails, submitit.submitted[:] = 99, []
    outcome = sweep._run_cell(cell(tmp_path), attempt, threading.Event())
    assert len(submitit.submitted) == 1 + sweep.RETRIES
    assert "node n3 failed" in outcome.failed
    assert "and more" not in outcome.failed


def test_a_sweep_that_stops_cancels_its_jobs(submitit: SimpleNamespace, tmp_path: Path) -> None:
    """They are cancelled, and can be resumed."""
    submitit.done = False
    attempt, _ = slurm.by_slurm("gpu", tmp_path)
    stop = threading.Event()
    stop.set()
    assert attempt(cell(tmp_path), stop) == (-1, "stopped")
    assert len(submitit.cancelled) == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--slurm", "gpu", "--ray", "local"], "two ways"),
        (["--minutes-per-run", "5"], "requires --slurm"),
        (["--slurm", "gpu", "--device", "cuda:1"], "the cluster chooses the GPU"),
        (["--slurm", "gpu"], "sbatch, which is not found"),
    ],
)
def test_what_slurm_cannot_do_is_refused(
    words: list[str],
    says: str,
    submitit: SimpleNamespace,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One message, exit code 2, and nothing is written."""
    monkeypatch.setattr(slurm.shutil, "which", lambda name: None)
    with pytest.raises(SystemExit) as left:
        main(["sweep", "commons", "--ticks", "20", "--out", str(tmp_path / "out"), *words])
    assert left.value.code == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_jobs_run_on_this_machine(tmp_path: Path) -> None:
    """`--slurm local` runs real jobs of submitit; each run is whole."""
    pytest.importorskip("submitit")
    words = ["--ticks", "20", "--seeds", "0", "--learner", "random", "--slurm", "local", "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as left:
        main(["sweep", "commons", "--quiet", *words])
    assert left.value.code == 0
    assert (tmp_path / "out/sweep.parquet").exists()
