"""The runs of a sweep as jobs of a Slurm cluster, through submitit; or as jobs on this machine, to try it out."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ecology.errors import EcologyError
from ecology.lab.runs.sweep import Attempt, Cell, in_own_process

LOCAL, DEFAULT = "local", "default"  # in the place of a partition: jobs on this machine, the cluster's own default
LOOK = 1.0  # seconds between two looks at a job
AT_ONCE = 1_000  # jobs that wait or run at a time: Slurm itself decides when each starts
LOGS = "slurm"  # folder of the jobs' own files, in that of the sweep


def by_slurm(
    partition: str, out: Path, *, gpus: float = 0.0, memory: float = 0.0, minutes: int | None = None
) -> tuple[Attempt, Callable[[], int]]:
    """Return a function that runs a job on a Slurm `partition`, and the number of jobs to submit at a time.

    A job takes one CPU, `gpus` GPUs, `memory` GiB and `minutes`, or the partition's default where not given. A job
    that ends before its run, because its time is over or its node failed, is submitted again and resumes the run.
    """
    try:
        import submitit
    except ImportError as error:
        raise EcologyError(
            "--slurm needs the package submitit, which is not installed; run in the project's folder: "
            "pip install -e '.[slurm]'"
        ) from error
    if partition != LOCAL and shutil.which("sbatch") is None:
        raise EcologyError(
            f"--slurm {partition!r} needs Slurm's command sbatch, which is not found; run this on a login node of the "
            f"cluster, or pass --slurm {LOCAL} to run the jobs on this machine."
        )
    if gpus != int(gpus):
        raise EcologyError(f"Slurm gives whole GPUs to a job, got --gpus-per-run {gpus!r}; give a whole number.")
    executor = submitit.AutoExecutor(out / LOGS, cluster=LOCAL if partition == LOCAL else "slurm")
    needs: dict[str, Any] = {"name": "ecology", "cpus_per_task": 1}
    needs |= {"gpus_per_node": int(gpus)} if gpus else {}
    needs |= {"mem_gb": memory} if memory else {}
    needs |= {"timeout_min": minutes} if minutes else {}
    needs |= {"slurm_partition": partition} if partition not in (LOCAL, DEFAULT) else {}
    executor.update_parameters(**needs)
    submitting = threading.Lock()

    def attempt(cell: Cell, stop: threading.Event) -> tuple[int, str]:
        with submitting:
            job = executor.submit(in_job, cell.folder, cell.evaluate, cell.source)
        while not job.done():
            if stop.wait(LOOK):
                job.cancel()
                return -1, "stopped"
        try:
            code, said = job.result()
        except (submitit.core.utils.FailedJobError, submitit.core.utils.UncompletedJobError) as error:
            return -1, str(error).strip().partition("\n")[0]
        return code, said

    return attempt, lambda: AT_ONCE


def in_job(folder: Path, evaluate: bool, source: str | None) -> tuple[int, str]:
    """Execute a run on a node of the cluster; cancelling the job stops the run, which can be resumed."""
    return in_own_process(folder, evaluate, source, threading.Event())
