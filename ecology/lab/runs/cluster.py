"""The runs of a sweep on a Ray cluster."""

from __future__ import annotations

import contextlib
import logging
import math
import os
import platform
import re
import socket
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ecology.errors import EcologyError
from ecology.lab.runs.sweep import Attempt, Cell, in_own_process

KNOCK = 10.0  # seconds for which a Ray cluster may take to accept a connection
AHEAD = 16  # runs that wait at a Ray cluster beyond what it holds now: an autoscaler adds nodes for them


def join(address: str) -> Any:
    """Join a Ray cluster ("local" starts one on this machine), and return the package; EcologyError on failure."""
    try:
        import ray
    except ImportError as error:
        raise EcologyError(
            "--ray needs the package ray, which is not installed; run in the project's folder: pip install -e '.[ray]'"
        ) from error
    if address not in ("local", "auto"):  # ray itself would wait for somebody to answer for many minutes
        _knock(address)
    said: list[str] = []
    try:
        with contextlib.nullcontext() if address == "local" else _errors_of_ray(said):
            ray.init(None if address == "local" else address, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, ValueError, RuntimeError, ray.exceptions.RayError) as error:
        reason = str(error).strip().partition("\n")[0]
        if isinstance(error, getattr(ray.exceptions, "AuthenticationError", ())) or any(
            "AuthToken" in line for line in said
        ):
            raise EcologyError(_token_wanted(address)) from error
        if address == "auto":
            advice = "start a cluster with `ray start --head`, or give local or HOST:PORT"
        else:
            advice = f"check that Ray {ray.__version__} runs there, with Python {platform.python_version()} as here"
        raise EcologyError(f"--ray {address!r}: Ray cannot join a cluster ({reason}); {advice}.") from error
    return ray


def capacity(ray: Any, needs: Mapping[str, float]) -> int:
    """Return how many runs with these `needs` fit on the nodes that a cluster has now."""
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    return sum(min(int(node.get(key, 0.0) / need + 1e-9) for key, need in needs.items() if need) for node in nodes)


def by_ray(address: str, *, gpus: float = 0.0, memory: float = 0.0) -> tuple[Attempt, Callable[[], int]]:
    """Return a function that runs on a Ray cluster ("local" starts one here), and one that counts the runs to start.

    A run takes one CPU, `gpus` GPUs and `memory` GiB of the cluster. The count asks the cluster every time, so nodes
    that join later are used.
    """
    ray = join(address)
    needs = {"CPU": 1.0, "GPU": gpus, "memory": memory * 2**30}
    task = ray.remote(num_cpus=1, num_gpus=gpus, memory=int(needs["memory"]), max_retries=0)(_in_worker)

    def attempt(cell: Cell, stop: threading.Event) -> tuple[int, str]:
        under_way = task.remote(cell.folder, cell.evaluate, cell.source)
        while not ray.wait([under_way], timeout=0.2)[0]:
            if stop.is_set():
                ray.cancel(under_way)
        try:
            return ray.get(under_way)
        except ray.exceptions.RayError as error:
            return -1, str(error).strip().partition("\n")[0]

    if not capacity(ray, needs):
        wanted = f"1 CPU, {gpus:g} GPUs and {memory:g} GiB of memory for a run"
        if address == "local":
            has = ray.cluster_resources()
            raise EcologyError(
                f"this machine does not have {wanted}: it has {has.get('CPU', 0):g} CPUs, {has.get('GPU', 0):g} GPUs "
                f"and {has.get('memory', 0) / 2**30:.1f} GiB; ask for less."
            )
        logging.getLogger("ecology").warning(
            "no node of the cluster has %s; the sweep waits until one joins. Ctrl-C stops it.", wanted
        )
    known = [0]

    def count() -> int:
        with contextlib.suppress(OSError, RuntimeError, ray.exceptions.RayError):  # of a cluster that is lost runs tell
            known[0] = capacity(ray, needs)
        return known[0] + AHEAD

    return attempt, count


def gpus_per_run(
    elsewhere: str | None, device: str | None, gpus: float | None, memory: float | None, *, per: str = "run"
) -> float:
    """Return the GPUs that a run takes of a cluster `elsewhere`; raise EcologyError if options are inconsistent.

    Their names end in what they are given `per`.
    """
    for option, value in ((f"--gpus-per-{per}", gpus), (f"--memory-per-{per}", memory)):
        if elsewhere is None and value is not None:
            raise EcologyError(
                f"{option} requires --ray or --slurm; give --ray local to share out this machine, or drop it."
            )
        if value is not None and not math.isfinite(value):
            raise EcologyError(f"{option} is a finite number, got {value!r}.")
    on_gpu = device is not None and device.startswith("cuda")
    if elsewhere is not None and on_gpu and device != "cuda":
        raise EcologyError(f"the cluster chooses the GPU of every run: give --device cuda with it, not {device}.")
    if on_gpu and gpus == 0:
        raise EcologyError(f"--device cuda needs a GPU, or a part of one: give --gpus-per-{per} above 0, or drop it.")
    if gpus is not None and gpus > 1 and gpus != int(gpus):
        raise EcologyError(f"--gpus-per-{per} is a part of one GPU or a whole number of them, got {gpus!r}.")
    return float(on_gpu) if gpus is None else gpus


def _knock(address: str) -> None:
    """Raise EcologyError where `address` is none of a Ray cluster, or where nothing answers at it."""
    match = re.fullmatch(r"(?:ray://)?(?:\[([0-9a-fA-F:.]+)\]|([^\s:/\[\]]+)):(\d{1,5})", address)
    if match is None or not 0 < int(match[3]) < 2**16:
        raise EcologyError(
            f"--ray takes local, auto, HOST:PORT or ray://HOST:PORT with a port from 1 to 65535, got {address!r}."
        )
    try:
        socket.create_connection((match[1] or match[2], int(match[3])), timeout=KNOCK).close()
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise EcologyError(
            f"--ray {address!r}: nothing answers there ({reason}); give the HOST:PORT that `ray start --head` printed, "
            "whose port is 6379 by default."
        ) from error


def _token_wanted(address: str) -> str:
    """Return the message for a Ray cluster that refuses those without its token."""
    given = [name for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH") if os.environ.get(name)]
    if os.environ.get("RAY_AUTH_MODE", "").lower() != "token":
        missing = "RAY_AUTH_MODE is not set to token"
    elif given:
        missing = f"it refuses the one in {given[0]}"
    else:
        missing = "RAY_AUTH_TOKEN is not set"
    return (
        f"--ray {address!r}: the Ray cluster wants a token, and {missing}. Set RAY_AUTH_MODE=token and "
        "RAY_AUTH_TOKEN=TOKEN, with the token that the cluster was started with, and type the command again."
    )


@contextlib.contextmanager
def _errors_of_ray(lines: list[str]) -> Iterator[None]:
    """Keep from the screen what is written to file descriptor 2, and append it to `lines`.

    Ray's compiled part writes there that a token is missing; its exception says only that it could not connect.
    """
    sys.stderr.flush()
    with tempfile.TemporaryFile() as kept, contextlib.ExitStack() as at_end:
        usual = os.dup(2)
        at_end.callback(os.close, usual)
        os.dup2(kept.fileno(), 2)
        try:
            yield
        finally:
            sys.stderr.flush()
            os.dup2(usual, 2)
            kept.seek(0)
            lines += kept.read().decode(errors="replace").splitlines()


def _in_worker(folder: Path, evaluate: bool, source: str | None) -> tuple[int, str]:
    """Live a run on a machine of the cluster; a cancelled task stops it as Ctrl-C would."""
    return in_own_process(folder, evaluate, source, threading.Event())
