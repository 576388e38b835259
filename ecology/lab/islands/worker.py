"""The process of a host: `python -P -m ecology.lab.islands.worker FILE_DESCRIPTOR FOLDER`."""

from __future__ import annotations

import contextlib
import signal
import sys
from multiprocessing.connection import Connection
from typing import Any

from ecology.errors import EcologyError
from ecology.lab.islands.hosts import Host
from ecology.lab.runs.stopping import StoppedError


def serve(line: Connection, host: Host) -> None:
    """Execute the calls that arrive on the connection until it closes."""
    with contextlib.suppress(EOFError, OSError):  # the archipelago has ended
        while True:
            method, calls = line.recv()
            answer: tuple[str, Any]
            try:
                answer = "done", host.call(method, calls)
            except EcologyError as error:
                answer = "error", str(error)
            except StoppedError:  # this process was killed, not the archipelago
                answer = "lost", None
            line.send(answer)


if __name__ == "__main__":
    for name in ("SIGINT", "SIGHUP"):  # of the terminal, which the archipelago hears too; Windows has no SIGHUP
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    serve(Connection(int(sys.argv[1])), Host(sys.argv[2]))
