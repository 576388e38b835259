"""Rerun's web viewer in a page of our own, served to browsers on this machine; it tells what is clicked.

    GET  /                      the page; it holds the token that a click needs
    GET  /re_viewer.js, .wasm   Rerun's own, taken from the server that comes with it
    GET  /NAME                  a recording that is shown
    POST /focus                 {"entity": "/world/agents/prey", "row": 17, "tick": 1200}

Who asks under another host's name (DNS rebinding), clicks from another page or without the token gets
403, what is no click 400; neither reaches the run. A browser may load nothing from elsewhere.
"""

from __future__ import annotations

import hmac
import json
import logging
import secrets
import shutil
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ecology.errors import EcologyError
from ecology.observers.viewer import LOOPBACK, WEB_PORT, free_port, viewer_process
from ecology.observers.wishes import AGENTS, Click

HTML = Path(__file__).with_name("page.html")
VIEWER = ("re_viewer.js", "re_viewer_bg.wasm")
TYPES = {".js": "text/javascript", ".wasm": "application/wasm", ".html": "text/html; charset=utf-8"}
LONGEST, DRAINED = 1_024, 65_536  # bytes of a click, and of anything that is read
PATIENCE = 30.0  # seconds granted to a browser that is slow, and to the start of Rerun's server
HOSTS = (LOOPBACK, "localhost")


class Page:
    """Serves the viewer and hears clicks, in threads of its own, until it is closed."""

    def __init__(
        self,
        sources: Sequence[str],
        hear: Callable[[Click], bytes | None],
        *,
        files: Mapping[str, Path] | None = None,
        dt: float = 1.0,
        port: int = WEB_PORT,
    ) -> None:
        """Serve from now on.

        sources: what the viewer opens: addresses of runs that serve, or names of `files`, recordings.
        hear: is given every click, in any thread; what it returns (a recording) is added to what is shown.
        dt: units of time per tick. port: a free one for 0. Raises EcologyError where the port is taken.
        """
        self.port = free_port(LOOPBACK, port)
        self.token = secrets.token_urlsafe(32)
        self._folder = tempfile.TemporaryDirectory()
        try:
            viewer = _viewer_files(Path(self._folder.name))
        except BaseException:
            self._folder.cleanup()
            raise
        told = json.dumps({"token": self.token, "sources": list(sources), "agents": f"{AGENTS}/", "dt": dt})
        page = HTML.read_text(encoding="utf-8").replace("SETTINGS", told.replace("<", "\\u003c"), 1).encode()
        runs = " ".join(f"http://{urlsplit(source).netloc}" for source in sources if "://" in source)
        policy = (
            "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'unsafe-inline'; "
            f"img-src 'self' data: blob:; connect-src 'self' {runs}; worker-src blob:; frame-ancestors 'none'"
        )
        answers = {f"/{path.name}": path for path in viewer} | {f"/{n}": path for n, path in (files or {}).items()}
        handler = type("Served", (_Handler,), {"page": page, "files": answers, "token": self.token,
                                               "policy": policy, "hear": staticmethod(hear)})  # fmt: skip
        self._server = _Server((LOOPBACK, self.port), handler)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Return the address to open."""
        return f"http://{LOOPBACK}:{self.port}/"

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._folder.cleanup()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Keep from the terminal, which is the run's, that a browser went away."""
        logging.getLogger("ecology").debug("a request of %s failed", client_address, exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    page: bytes
    files: Mapping[str, Path]
    token: str
    policy: str
    hear: Callable[[Click], bytes | None]
    timeout = PATIENCE
    server_version, sys_version = "ecology", ""

    def do_GET(self) -> None:
        path = urlsplit(self.path).path
        if not self._ours():
            self._send(HTTPStatus.FORBIDDEN)
        elif path == "/":
            self._send(HTTPStatus.OK, self.page, TYPES[".html"])
        elif path in self.files:
            with self.files[path].open("rb") as file:
                self._head(HTTPStatus.OK, self.files[path].stat().st_size, TYPES.get(self.files[path].suffix))
                shutil.copyfileobj(file, self.wfile)
        else:
            self._send(HTTPStatus.NOT_FOUND)

    def do_POST(self) -> None:
        body = self._body()  # read whatever it is: a connection closed before would hide the answer
        origin = self.headers.get("Origin")
        token = self.headers.get("X-Token", "")
        ours = self._ours() and origin in (None, f"http://{self.headers.get('Host')}")
        if not ours or not hmac.compare_digest(token.encode(), self.token.encode()):
            self._send(HTTPStatus.FORBIDDEN)
        elif urlsplit(self.path).path != "/focus":
            self._send(HTTPStatus.NOT_FOUND)
        elif (click := parsed(body)) is None:
            self._send(HTTPStatus.BAD_REQUEST)
        elif layer := self.hear(click):
            self._send(HTTPStatus.OK, layer)
        else:
            self._send(HTTPStatus.NO_CONTENT)

    def _ours(self) -> bool:
        """Return whether this machine was asked for by its own name, through a tunnel or not."""
        try:
            return urlsplit(f"//{self.headers.get('Host', '')}").hostname in HOSTS
        except ValueError:
            return False

    def _body(self) -> bytes:
        """Return what was sent, cut off where it is longer than a click can be."""
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdecimal()) or len(length) > len(str(DRAINED)):
            return b""
        try:
            return self.rfile.read(min(int(length), DRAINED))[: LONGEST + 1]
        except OSError:
            return b""

    def _send(self, status: HTTPStatus, body: bytes = b"", kind: str | None = None) -> None:
        self._head(status, len(body), kind)
        self.wfile.write(body)

    def _head(self, status: HTTPStatus, length: int, kind: str | None) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind or "application/octet-stream")
        self.send_header("Content-Length", str(length))
        self.send_header("Content-Security-Policy", self.policy)
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Say nothing: the terminal is the run's."""


def parsed(body: bytes) -> Click | None:
    """Return the click that a body says, None where it says anything else."""
    try:
        told = json.loads(body) if len(body) <= LONGEST else None
    except (ValueError, RecursionError):
        return None
    if not isinstance(told, dict) or set(told) != {"entity", "row", "tick"}:
        return None
    entity, row, tick = told["entity"], told["row"], told["tick"]
    known = tick is None or (type(tick) in (int, float) and abs(tick) < 2**53)
    if not isinstance(entity, str) or type(row) is not int or not 0 <= row < 2**31 or not known:
        return None
    return Click(entity, row, tick)


def _viewer_files(folder: Path) -> list[Path]:
    """Return copies, in `folder`, of what Rerun's own server sends a browser; EcologyError where it does not."""
    found = [folder / name for name in VIEWER]
    port, reason = free_port(LOOPBACK, 0), ""
    # with a URL, no second server for data is opened
    with viewer_process(
        "--serve-web", "--web-viewer-port", str(port), f"rerun+http://{LOOPBACK}:{port}/proxy"
    ) as process:
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until and process.poll() is None:
            try:
                for path in found:
                    address = f"http://{LOOPBACK}:{port}/{path.name}"
                    with _direct.open(address, timeout=PATIENCE) as answer, path.open("wb") as file:
                        shutil.copyfileobj(answer, file)
                return found
            except OSError as error:
                reason = str(error)
                time.sleep(0.05)
    raise EcologyError(f"the viewer for browsers cannot be started ({reason or 'it stopped at once'}).")


_direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))  # loopback is reached by no proxy
