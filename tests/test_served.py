"""Viewers of a run, many or hostile, and a disk that fills up: none of them slows, hangs or changes a run."""

from __future__ import annotations

import contextlib
import errno
import resource
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ecology.agents import checkpoint
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers import proxy, recording_file, rerun, sampler, viewer
from ecology.observers.proxy import is_welcome

ENDING = 20.0  # seconds within which a run ends whatever its viewers do


def test_who_is_welcome() -> None:
    """A viewer, and pages of this machine; no page of another site, and none that was led here by another name."""
    assert is_welcome(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n")
    page = b"POST /x HTTP/1.1\r\nHost: %s\r\nOrigin: %s\r\n\r\n"
    assert is_welcome(page % (b"127.0.0.1:9876", b"http://127.0.0.1:9090"))
    assert is_welcome(page % (b"localhost:9876", b"http://localhost:9090"))
    assert is_welcome(b"GET / HTTP/1.1\r\nhost: [::1]:9876\r\n\r\n")
    assert not is_welcome(page % (b"127.0.0.1:9876", b"https://evil.example"))
    assert not is_welcome(page % (b"127.0.0.1:9876", b"null"))
    assert not is_welcome(page % (b"evil.example:9876", b"http://127.0.0.1:9090"))
    assert not is_welcome(b"POST /x HTTP/1.1\r\n\r\n")
    assert not is_welcome(b"")
    assert not is_welcome(b"\xff" * 100)


@pytest.fixture
def echo() -> Iterator[int]:
    """Give the port of a server that says a lot to everybody."""
    server = socket.create_server(("127.0.0.1", 0))

    def speak(link: socket.socket) -> None:
        with contextlib.suppress(OSError), link:
            while True:
                link.sendall(b"x" * 65_536)

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                threading.Thread(target=speak, args=(server.accept()[0],), daemon=True).start()

    threading.Thread(target=serve, daemon=True).start()
    yield int(server.getsockname()[1])
    server.close()


def connect(port: int, head: bytes = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n") -> socket.socket:
    """Return a connection that has said `head`."""
    link = socket.create_connection(("127.0.0.1", port), timeout=ENDING)
    link.sendall(head)
    return link


def test_the_proxy_bounds_and_sheds(echo: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of many a few are served, a client that reads nothing is shut out, and another page gets nothing."""
    monkeypatch.setattr(proxy, "SLOW", 0.5)
    monkeypatch.setattr(proxy, "CONNECTIONS", 4)
    port = viewer.free_port("127.0.0.1", 0)
    told: list[int] = []
    proxy.open_proxy("127.0.0.1", port, echo, told.append)
    with connect(port, b"POST /x HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://evil.example\r\n\r\n") as evil:
        assert evil.recv(1_000).startswith(b"HTTP/1.1 403")
    with contextlib.ExitStack() as stack:
        links = [stack.enter_context(connect(port)) for _ in range(4)]
        assert all(link.recv(10) for link in links)
        with contextlib.suppress(OSError), connect(port) as fifth:
            assert fifth.recv(10) == b""
        time.sleep(2.0)  # nobody reads on: all are shut out
        with connect(port) as late:
            assert late.recv(10)
    assert max(told) == 4  # connections, whenever their number changes
    with pytest.raises(OSError, match="in use"):
        proxy.open_proxy("127.0.0.1", port, echo)


def test_costly_samples_are_taken_while_somebody_watches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A run that is served plans for its picture only while a viewer is attached, beside what its recording holds."""
    monkeypatch.setattr(sampler, "SECONDS", 0.0)
    run = Run(resolve("predator_prey", learners=["random"], ticks=60, record=False), tmp_path / "served")
    run.start()
    observer = rerun.RerunObserver(every=1, viewers=rerun.Viewers(("127.0.0.1", 0)))
    observer.begin(run.env, run.learners)
    try:
        assert observer.url is not None
        port, state = int(observer.url.split(":")[2].split("/")[0]), run.env.state_view
        (served,) = observer._relays

        def wait(*, watched: bool) -> None:
            until = time.monotonic() + ENDING
            while served.watched is not watched:
                assert time.monotonic() < until
                time.sleep(0.01)

        state = replace(state, tick=1)
        assert not observer._sampler.look(state).closely
        with connect(port):
            wait(watched=True)
            assert observer._sampler.look(state).closely
        wait(watched=False)
        assert not observer._sampler.look(state).closely
        assert observer._sampler.look(replace(state, tick=sampler.CLOSE)).closely  # as in every recording
    finally:
        observer.end()


@pytest.mark.one_seed("the run that is served is lived by another process")
def test_hostile_viewers_change_nothing(tmp_path: Path) -> None:
    """300 connections that read nothing, in a run that may open few files: it lives as one that is not served."""
    code = f"""
import resource, socket, sys, time
from pathlib import Path
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers.rerun import RerunObserver, Viewers

resource.setrlimit(resource.RLIMIT_NOFILE, (128, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
run = Run(resolve("predator_prey", learners=["random"], ticks=60, record=False), Path({str(tmp_path / "served")!r}))
run.start()
observer = RerunObserver(every=1, viewers=Viewers(("127.0.0.1", 0)))

class Slow:
    def begin(self, env, minds):
        print(observer.url, flush=True)
        sys.stdin.readline()
    def watch(self, state, tick, minds):
        pass
    def end(self):
        pass

run.live([observer, Slow()])
"""
    plain = Run(resolve("predator_prey", learners=["random"], ticks=60, record=False), tmp_path / "plain")
    plain.start()
    plain.live()
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        port = int(process.stdout.readline().split(":")[2].partition("/")[0])
        links = []
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, 1_024)), hard))
        for _ in range(300):
            with contextlib.suppress(OSError):
                links.append(connect(port))
        began = time.monotonic()
        _, err = process.communicate("go\n", timeout=10 * ENDING)
        assert process.returncode == 0, err
        assert "Too many open files" not in err
        assert time.monotonic() - began < ENDING
        for link in links:
            link.close()
    one, other = (checkpoint.read(tmp_path / name / "checkpoint")["world"][0] for name in ("served", "plain"))
    for name, array in one.items():
        np.testing.assert_array_equal(array, other[name], err_msg=name)


@pytest.mark.parametrize("room", [200_000, 400_000])
def test_a_full_disk_is_an_error_and_the_run_can_be_resumed(room: int, tmp_path: Path) -> None:
    """It ends at once with its cause; with room again it goes on, and the recording has every tick once."""
    from ecology.observers.readback import column

    words = ["--learner", "random", "--ticks", "3000", "--record", "every=1", "--out", str(tmp_path / "run"), "--quiet"]
    code = f"""
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, resource.RLIM_INFINITY))
from ecology.lab.cli import main
from ecology.observers import rerun
rerun.SECONDS_FILE = 0.0
main(["run", "seasons", *{words!r}])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=10 * ENDING, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "File too large" in done.stderr
    assert f"resume from tick 0 with: ecology run --resume {tmp_path / 'run'}" in done.stderr
    assert "recording.rrd" in done.stderr or "metrics" in done.stderr
    again = Path(tmp_path / "run")
    resumed = subprocess.run(
        [sys.executable, "-m", "ecology", "run", "--resume", str(again), "--ticks", "400", "--quiet"],
        capture_output=True,
        text=True,
        timeout=10 * ENDING,
        check=False,
    )
    assert resumed.returncode == 0, resumed.stderr
    for entity, component in (("/world/agents/agent", "drive"), ("/focus/agent/needs", "Scalars:scalars")):
        assert list(column(again / "recording.rrd", entity, component)) == list(range(401)), entity
    assert not [path.name for path in again.iterdir() if path.suffix in (".parts", ".joined") or "resumed" in path.name]


def test_a_write_that_fails_leaves_whole_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was cut off is written again, once there is room."""
    import rerun as rr

    class Full:
        def __init__(self, file: object) -> None:
            self._file, self.room = file, 1_000_000

        def write(self, data: bytes) -> int:
            if not self.room:
                raise OSError(errno.ENOSPC, "No space left on device")
            part = bytes(data[: self.room])
            self.room -= len(part)
            return int(self._file.write(part))  # type: ignore[attr-defined]

        def __getattr__(self, name: str) -> object:
            return getattr(self._file, name)

    rec = rr.RecordingStream("ecology-test", recording_id="r")
    file = recording_file.RecordingFile(tmp_path / "recording.rrd", rec)
    full = Full(file._file)
    monkeypatch.setattr(file, "_file", full)
    for tick in range(20):
        rec.set_time("tick", sequence=tick)
        rec.log("a", rr.Scalars([float(tick)]))
        if tick == 10:
            full.room = 100
            with pytest.raises(OSError, match=r"No space left.*recording.rrd"):
                file.append()
            full.room = 1_000_000
        file.append()
    file.close()
    from rerun.chunk import RrdReader

    whole = viewer.repair_recording(tmp_path / "recording.rrd", tmp_path / "whole.rrd")
    rows = [row for chunk in RrdReader(str(whole)).stream().filter(content="/a")
            for row in chunk.to_record_batch().column("tick").to_pylist()]  # fmt: skip
    assert sorted(rows) == list(range(20))
