"""Viewers, fed by a process of its own so that the run never waits for them: one elsewhere, or those that attach.

Who attaches is let in by a proxy (proxy.py) in that process. Whatever they do there, many or hostile, the run is not
touched: it neither opens nor waits for a connection.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import queue
import subprocess
import sys
import threading

import rerun as rr

from ecology.observers import proxy
from ecology.observers.drawing import Drawing, open_scene
from ecology.observers.layout import blueprint
from ecology.observers.scene import Scene
from ecology.observers.viewer import LOOPBACK, free_port

BACKLOG = 64 * 2**20  # bytes that may wait for a viewer elsewhere; older ones are dropped
PATIENCE = 5.0  # seconds granted to a viewer elsewhere when the run ends
STARTING = 60.0  # seconds granted to the process to begin
MEMORY = "256MB"  # of history kept for viewers that attach late
CONNECT, SERVE = "connect", "serve"  # to a viewer, or viewers that attach
READY = b"+"  # sent when viewers can attach, or before connecting to the one elsewhere
WATCHED, ALONE = b"1", b"0"  # sent when the first viewer attaches, and when the last one leaves

log = logging.getLogger("ecology")


class Relay:
    """Feeds viewers from a process of its own, so that the run never waits for them.

    What waits is bounded by `BACKLOG` bytes; the oldest is dropped. A viewer that cannot be
    reached, is slow or goes away is reported once, in the log, and the run continues.
    """

    def __init__(self, how: str, address: str, scene: Scene) -> None:
        """Start the process that streams `scene` to a viewer (CONNECT, its URL) or lets them attach (SERVE, HOST:PORT).

        Returns once viewers can attach.
        """
        self._url, self._told = address, False
        self.watched = how == CONNECT  # whether a viewer is attached
        self._waiting: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._bytes, self._lock = 0, threading.Lock()
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "ecology.observers.relay", how, address],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "RUST_LOG": "off"},
            start_new_session=True,
        )
        self._thread = threading.Thread(target=self._feed, args=(pickle.dumps(scene),), daemon=True)
        self._thread.start()
        self._serves, self._answered = False, threading.Event()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        if how == SERVE and not self._is_ready():
            self._tell("cannot be served")

    def _listen(self) -> None:
        """Read from the process whether it is ready, and whether a viewer is attached."""
        pipe = self._process.stdout
        assert pipe is not None
        while said := pipe.read(1):
            if said == READY:
                self._serves = True
                self._answered.set()
            else:
                self.watched = said == WATCHED
        self._answered.set()  # the process has ended

    def _is_ready(self) -> bool:
        """Wait until the process says that it is ready; say whether it is."""
        return self._answered.wait(STARTING) and self._serves

    def put(self, message: bytes) -> None:
        """Let `message` wait for its turn, in the place of the oldest where there is no room."""
        with self._lock:
            self._waiting.put(message)
            self._bytes += len(message)
            dropped = False
            while self._bytes > BACKLOG:
                self._bytes -= len(self._waiting.get_nowait() or b"")
                dropped = True
        if dropped:
            self._tell("is slower than the run; it is shown the newest")

    def close(self) -> None:
        """Give the viewer `PATIENCE` seconds to take what waits, once the process has begun, then leave."""
        self._waiting.put(None)
        self._is_ready()  # a short run on a busy machine ends before the process has started
        self._thread.join(PATIENCE)
        try:
            self._process.wait(0.1 if self._thread.is_alive() else PATIENCE)
        except subprocess.TimeoutExpired:
            self._tell("did not take the end of the run")
            self._process.kill()
            self._process.wait()
        self._thread.join(PATIENCE)
        self._listener.join(PATIENCE)
        assert self._process.stdout is not None
        self._process.stdout.close()

    def _feed(self, first: bytes) -> None:
        pipe = self._process.stdin
        assert pipe is not None
        message: bytes | None = first
        try:
            while message is not None:
                pipe.write(len(message).to_bytes(8, "big") + message)
                pipe.flush()
                message = self._waiting.get()
                with self._lock:
                    self._bytes -= len(message or b"")
        except OSError:
            self._tell("cannot be reached, or went away; it is shown no more")
        with contextlib.suppress(OSError):
            pipe.close()

    def _tell(self, what: str) -> None:
        if not self._told:
            self._told = True
            log.warning("the viewer at %s %s. The run continues.", self._url, what)


def _relay(how: str, address: str) -> int:
    """Draw what comes in over stdin (from `Relay`, of the same program) for viewers."""
    source = sys.stdin.buffer
    drawing: Drawing | None = None
    while head := source.read(8):
        message = pickle.loads(source.read(int.from_bytes(head, "big")))
        if drawing is None:
            scene: Scene = message
            rec = rr.RecordingStream(scene.application)
            if how == CONNECT:
                _say(READY)
                rec.connect_grpc(address, default_blueprint=blueprint(scene))
            else:
                port = free_port(LOOPBACK, 0)
                server = rr.GrpcServerSink(LOOPBACK, port, server_memory_limit=MEMORY)
                rec.set_sinks(server, default_blueprint=blueprint(scene))
            open_scene(rec, scene)
            drawing = Drawing(rec, scene)
            if how == SERVE:
                host, _, outer = address.rpartition(":")
                proxy.open_proxy(host, int(outer), port, lambda number: _say(WATCHED if number else ALONE))
                _say(READY)
        else:
            what, arguments = message
            getattr(drawing, what)(*arguments)
        try:
            rec.flush(timeout_sec=4 * PATIENCE)
        except RuntimeError:
            return 1
    rec.disconnect()
    return 0


def _say(what: bytes) -> None:
    """Tell the run something, in one write; it may be gone."""
    with contextlib.suppress(OSError):
        os.write(sys.stdout.fileno(), what)


if __name__ == "__main__":
    # the process leaves at once: what a viewer that hangs has not taken must not keep it
    os._exit(_relay(*sys.argv[1:3]))
