"""Hosts of islands: a host holds some of them, a fleet holds all. A lost host is started again.

A host is a process on this machine or an actor on a Ray cluster. Every host executes its calls in order. So a host that
was lost can repeat the calls that its islands received since the last common snapshot.
"""

from __future__ import annotations

import contextlib
import multiprocessing.connection
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from ecology import EcologyError, faults
from ecology.lab.islands.island import IslandRun
from ecology.lab.islands.plan import Voyage, read_voyage

RETRIES = 3  # times that a host is started again between two common snapshots
WORKER = "ecology.lab.islands.worker"
Calls = Mapping[int, Sequence[Any]]  # island -> arguments
Opening = tuple[Any, ...]  # "start"; "resume", TICK; "fork", FOLDER, TICK, WORDS


class LostError(Exception):
    """A host has ended, and the progress of its islands since the last common snapshot is lost."""


class Host:
    """Holds islands in its own process and executes calls on them."""

    def __init__(self, folder: str) -> None:
        self._folder = Path(folder)
        self._voyage: Voyage | None = None
        self._islands: dict[int, IslandRun] = {}

    def call(self, method: str, calls: Mapping[int, Sequence[Any]]) -> dict[int, Any]:
        """Call `method` of islands, "open" first, and return what each returned."""
        found = {}
        for number, words in calls.items():
            try:
                found[number] = self._open(number, *words) if method == "open" else self._do(number, method, words)
            except Exception as error:
                cause = error if isinstance(error, EcologyError) else faults.user_fault(error)
                if cause is None:
                    raise
                raise EcologyError(f"island {number}: {cause}") from error
        return found

    def _do(self, number: int, method: str, words: Sequence[Any]) -> Any:
        return getattr(self._islands[number], method)(*words)

    def _open(self, number: int, how: str, *words: Any) -> Any:
        voyage = self._voyage = self._voyage or read_voyage(self._folder)
        folder = voyage.folder_of(self._folder, number)
        if how != "resume":
            shutil.rmtree(folder, ignore_errors=True)  # of a start that went no further
        island = IslandRun(voyage.plan_of(number), folder, voyage.world.pool, shown=voyage.record)
        self._islands[number] = island
        return getattr(island, how)(*words)


class Handle(Protocol):
    """Proxy of a host: it answers calls in the order in which they were sent, and raises LostError if it has ended."""

    def send(self, method: str, calls: Calls) -> None:
        """Let it begin."""

    def answer(self) -> dict[int, Any]:
        """Wait for what it returns; EcologyError where an island failed."""

    def close(self) -> None:
        """End it."""


class ProcessHost:
    """A host in a single-threaded process, which ends when this process does."""

    def __init__(self, folder: Path) -> None:
        mine, theirs = multiprocessing.connection.Pipe()
        self._line = mine
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        with theirs:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", WORKER, str(theirs.fileno()), str(folder)],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                env={**os.environ, **threads},
                start_new_session=True,  # Ctrl-C reaches only the archipelago, which ends at the next stop
            )

    def send(self, method: str, calls: Calls) -> None:
        """Let it begin."""
        try:
            self._line.send((method, calls))
        except OSError as error:
            raise LostError from error

    def answer(self) -> dict[int, Any]:
        """Wait for what it returns."""
        try:
            kind, content = self._line.recv()
        except (EOFError, OSError) as error:
            raise LostError from error
        if kind == "lost":
            raise LostError
        if kind == "error":
            raise EcologyError(content)
        return content

    def close(self) -> None:
        """End it: it ends by itself when the line does."""
        self._line.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(5.0)
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
            self.process.wait()


class RayHost:
    """A host as an actor of a Ray cluster, on any of its nodes."""

    def __init__(self, ray: Any, folder: Path, *, gpus: float, memory: float) -> None:
        self._ray = ray
        remote = ray.remote(
            num_cpus=1, num_gpus=gpus, memory=int(memory * 2**30), max_restarts=0, scheduling_strategy="SPREAD"
        )
        self._actor = remote(Host).remote(str(folder))
        self._under_way: Any = None

    def send(self, method: str, calls: Calls) -> None:
        """Let it begin."""
        self._under_way = self._actor.call.remote(method, dict(calls))

    def answer(self) -> dict[int, Any]:
        """Wait for what it returns."""
        try:
            return self._ray.get(self._under_way)
        except self._ray.exceptions.RayTaskError as error:
            cause = error.as_instanceof_cause()
            if isinstance(cause, EcologyError):
                raise EcologyError(getattr(error.cause, "args", [str(cause)])[0]) from error
            raise
        except self._ray.exceptions.RayError as error:  # the actor, its node, or the connection
            raise LostError from error

    def close(self) -> None:
        """End it."""
        with contextlib.suppress(Exception):
            self._ray.kill(self._actor)


class Fleet:
    """All islands of an archipelago, spread over hosts."""

    def __init__(
        self,
        make: Callable[[], Handle],
        islands: int,
        hosts: int,
        opening: Callable[[int], Opening],
        common: int | None,
    ) -> None:
        """Spread `islands` over `hosts` that `make` starts, opened by `opening` or at the `common` snapshot."""
        self._make, self._opening, self._common = make, opening, common
        self._share = [list(range(host, islands, hosts)) for host in range(min(hosts, islands))]
        self._hosts: list[Handle | None] = [None] * len(self._share)
        self._log: list[tuple[str, Calls]] = []  # since the last common snapshot
        self._lives = [RETRIES] * len(self._share)
        self.lost = 0  # hosts that were lost and started again

    def open(self) -> None:
        """Start all hosts and open all islands."""
        for host in range(len(self._share)):
            self._hosts[host] = self._make()
            self._send(host, "open", self._openings(host))
        for host in range(len(self._share)):
            try:
                self._answer(host)
            except LostError:
                self._revive(host)

    def call(self, method: str, calls: Calls) -> dict[int, Any]:
        """Call `method` of islands on all hosts at once, and return what each island returned."""
        self._log.append((method, calls))
        lost, found = set(), {}
        for host, share in enumerate(self._share):
            try:
                self._send(host, method, _some(calls, share))
            except LostError:
                lost.add(host)
        for host, share in enumerate(self._share):
            try:
                if host not in lost and _some(calls, share):
                    found.update(self._answer(host))
            except LostError:
                lost.add(host)
        for host in sorted(lost):
            found.update(self._revive(host))
        return found

    def commit(self, tick: int) -> None:
        """Take the snapshots of `tick` as the last common ones: nothing before needs to be repeated."""
        self._common, self._log, self._lives = tick, [], [RETRIES] * len(self._share)

    def close(self) -> None:
        """End all hosts."""
        for host in self._hosts:
            if host is not None:
                host.close()

    def _send(self, host: int, method: str, calls: Calls) -> None:
        handle = self._hosts[host]
        assert handle is not None
        if calls:
            handle.send(method, calls)

    def _answer(self, host: int) -> dict[int, Any]:
        handle = self._hosts[host]
        assert handle is not None
        return handle.answer()

    def _openings(self, host: int) -> Calls:
        share = self._share[host]
        if self._common is not None:
            return dict.fromkeys(share, ("resume", self._common))
        return {number: self._opening(number) for number in share}

    def _revive(self, host: int) -> dict[int, Any]:
        """Start a lost host again and repeat its calls; return the result of the last one."""
        while self._lives[host]:
            self._lives[host] -= 1
            self.lost += 1
            if (old := self._hosts[host]) is not None:
                old.close()
            self._hosts[host] = self._make()
            try:
                found: dict[int, Any] = {}
                for method, calls in [("open", self._openings(host)), *self._log]:
                    if mine := _some(calls, self._share[host]):
                        self._send(host, method, mine)
                        found = self._answer(host)
                    else:
                        found = {}
                return found
            except LostError:
                continue
        raise EcologyError(
            f"the host of the islands {', '.join(map(str, self._share[host]))} ended {1 + RETRIES} times since the "
            "common snapshot; if memory is short, give fewer --workers or smaller learner memories, and resume."
        )


def _some(calls: Calls, share: Sequence[int]) -> Calls:
    return {number: calls[number] for number in share if number in calls}
