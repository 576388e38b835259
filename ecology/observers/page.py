"""Rerun's web viewer in a page of our own, served to browsers on this machine; it tells what is clicked.

    GET  /                      the page; it holds the token that a click needs
    GET  /re_viewer.js, .wasm   Rerun's own, taken from the server that comes with it
    GET  /NAME                  a recording that is shown
    POST /focus                 {"entity": "/world/agents/prey", "row": 17, "tick": 1200}: a click
    POST /name                  {"who": "prey_17"}: the same by name
    POST /status                {"page": "x7", "shown": 1190}: what a page shows, null where it looks elsewhere
    POST /order                 {"order": "pace", "pace": 50}: of the run's pace, see control.py
    POST /do                    {"do": "move food 0.5 1.5"}: an intervention, see ecology/interventions.py
    POST /fork                  {"do": "empathy nurse off"}: fork from here, with an intervention in the fork or ""
    POST /fork/do               {"do": "..."}: an intervention in the fork
    POST /world                 {}: where everything is

Who asks under another host's name (DNS rebinding), posts from another page or without the token gets
403, what cannot be read 400; neither reaches the run. What the run refuses gets 409 with its reason. The last six are
of a run that is alive, and 404 elsewhere. A browser may load nothing from elsewhere.

The page is served in the process of the run, whose files and threads must not run out: connections are few at a time,
and each must make its request within PATIENCE seconds and go on reading the answer.
"""

from __future__ import annotations

import hmac
import io
import json
import logging
import secrets
import shutil
import socket
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

from ecology.errors import EcologyError
from ecology.observers.focus_requests import AGENTS, Click
from ecology.observers.viewer import LOOPBACK, WEB_PORT, free_port, viewer_process
from ecology.verbs import USAGES

HTML = Path(__file__).with_name("page.html")
VIEWER = ("re_viewer.js", "re_viewer_bg.wasm")
JSON = "application/json"
TYPES = {".js": "text/javascript", ".wasm": "application/wasm", ".html": "text/html; charset=utf-8"}
LONGEST, DRAINED = 1_024, 65_536  # bytes of a click, and of anything that is read
PATIENCE = 30.0  # seconds granted to a browser that is slow, and to the start of Rerun's server
CONNECTIONS = 64  # at a time, at most; a browser opens six
HOSTS = (LOOPBACK, "localhost")


@dataclass(frozen=True)
class Shown:
    """What a page shows, and what handles its clicks."""

    sources: Sequence[str]  # what the viewer opens: addresses of runs that serve, or names of `files`
    # called with every click, in any thread; a recording that it returns is added to the viewer, a text is displayed
    hear: Callable[[Click], bytes | str | None]
    files: Mapping[str, Path] = field(default_factory=dict)  # recordings
    desk: Desk | None = None  # takes orders for a run that is alive; a recording has none
    named: Callable[[str], bytes | str | None] | None = None  # called with names of agents, where there is no desk


class Page:
    """Serves the viewer and hears clicks, in threads of its own, until it is closed."""

    def __init__(self, shown: Shown, *, port: int = WEB_PORT, name: str = "") -> None:
        """Serve from now on.

        port: a free one for 0. Raises EcologyError where the port is taken. name: of the run.
        """
        self.port = free_port(LOOPBACK, port)
        self.token = secrets.token_urlsafe(32)
        self._folder = tempfile.TemporaryDirectory()
        try:
            viewer = _viewer_files(Path(self._folder.name))
        except BaseException:
            self._folder.cleanup()
            raise
        runs = " ".join(f"http://{urlsplit(source).netloc}" for source in shown.sources if "://" in source)
        policy = (
            "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; style-src 'unsafe-inline'; "
            f"img-src 'self' data: blob:; connect-src 'self' {runs}; worker-src blob:; frame-ancestors 'none'"
        )
        self._viewer = {f"/{path.name}": path for path in viewer}
        words = {"token": self.token, "agents": f"{AGENTS}/", "name": name}
        self._served = type("Served", (_Handler,), {"words": words, "token": self.token, "policy": policy})
        self._show(shown)
        self._server = _Server((LOOPBACK, self.port), self._served)
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Return the address to open."""
        return f"http://{LOOPBACK}:{self.port}/"

    def _show(self, shown: Shown) -> None:
        served: Any = self._served
        desk = shown.desk
        live = {"live": desk is not None, "usages": USAGES if desk is not None else ()}
        words = json.dumps({**served.words, "sources": list(shown.sources), **live})
        page = HTML.read_text(encoding="utf-8").replace("SETTINGS", words.replace("<", "\\u003c"), 1).encode()
        named = shown.named or (desk.focus if desk is not None else None)
        served.page, served.desk = page, desk
        served.files = {**self._viewer, **{f"/{name}": file for name, file in shown.files.items()}}
        served.hear, served.named = staticmethod(shown.hear), staticmethod(named or _nobody)

    def look_back(self, shown: Shown, desk: Desk) -> None:
        """Show a recording to pages that are loaded from now on; `desk` still informs pages that are open."""
        self._show(shown)
        served: Any = self._served
        served.desk = desk

    def close(self) -> None:
        """Serve no more."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._folder.cleanup()


class Desk(Protocol):
    """Takes orders for a run that is alive; called from the threads of a page."""

    def status(self, page: str, shown: float | None) -> dict[str, Any]:
        """Return how the run goes, to a `page` that shows the tick `shown`."""
        ...

    def order(self, order: str, pace: float | None) -> dict[str, Any]:
        """Pause, step or pace the run, and return how it goes."""
        ...

    def do(self, text: str) -> str:
        """Intervene, and return what was done."""
        ...

    def fork(self, text: str) -> str:
        """Fork the run, with an intervention in the fork, and return what was done."""
        ...

    def do_in_fork(self, text: str) -> str:
        """Intervene in the fork, and return what was done."""
        ...

    def focus(self, who: str) -> str:
        """Bring an agent into focus, and return what the run says."""
        ...

    def world(self) -> dict[str, Any]:
        """Return where everything is."""
        ...


def _nobody(who: str) -> None:
    """Bring no agent into focus."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._places = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection in a thread of its own, or close it where there are too many."""
        if not self._places.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:  # no thread could be started
            self._places.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection, and make its place free."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._places.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Keep from the terminal, which is the run's, that a browser went away."""
        logging.getLogger("ecology").debug("a request of %s failed", client_address, exc_info=True)


class _Request(io.RawIOBase):
    """What a client sends; TimeoutError where it takes longer than PATIENCE seconds in all."""

    def __init__(self, link: socket.socket) -> None:
        self._link, self._until = link, time.monotonic() + PATIENCE

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left = self._until - time.monotonic()
        if left <= 0:
            raise TimeoutError("the request was not made in time")
        self._link.settimeout(left)
        try:
            return self._link.recv_into(buffer)
        finally:
            self._link.settimeout(PATIENCE)  # for every block of the answer


class _Handler(BaseHTTPRequestHandler):
    page: bytes
    files: Mapping[str, Path]
    token: str
    policy: str
    words: Mapping[str, Any]
    hear: Callable[[Click], bytes | str | None]
    named: Callable[[str], bytes | str | None]
    desk: Desk | None
    timeout = PATIENCE
    server_version, sys_version = "ecology", ""

    def setup(self) -> None:
        super().setup()
        self.rfile = io.BufferedReader(_Request(self.connection))

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
        elif (path := urlsplit(self.path).path) not in ROUTES or (path in LIVE and self.desk is None):
            self._send(HTTPStatus.NOT_FOUND)
        elif (request := read_body(body, path)) is None:
            self._send(HTTPStatus.BAD_REQUEST)
        else:
            try:
                found = self._answer(path, request)
            except EcologyError as error:
                self._send(HTTPStatus.CONFLICT, json.dumps({"error": str(error)}).encode(), JSON)
                return
            if not found:
                self._send(HTTPStatus.NO_CONTENT)
            elif isinstance(found, bytes):
                self._send(HTTPStatus.OK, found)
            else:
                found = {"said": found} if isinstance(found, str) else found
                self._send(HTTPStatus.OK, json.dumps(found).encode(), JSON)

    def _answer(self, path: str, request: dict[str, Any]) -> bytes | str | dict[str, Any] | None:
        """Return what is to be said to a post that could be read; EcologyError where it is refused."""
        if path == "/focus":
            return self.hear(Click(request["entity"], request["row"], request["tick"]))
        if path == "/name":
            return self.named(request["who"])
        assert self.desk is not None
        if path == "/status":
            return self.desk.status(request["page"], request["shown"])
        if path == "/order":
            return self.desk.order(request["order"], request["pace"])
        if path == "/world":
            return self.desk.world()
        if path == "/fork":
            return self.desk.fork(request["do"])
        return self.desk.do(request["do"]) if path == "/do" else self.desk.do_in_fork(request["do"])

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


def read_body(body: bytes, path: str) -> dict[str, Any] | None:
    """Return what a post to `path` says, by key; None where it says anything else."""
    try:
        request = json.loads(body) if len(body) <= LONGEST else None
    except (ValueError, RecursionError):
        return None
    kinds = ROUTES[path]
    if not isinstance(request, dict) or set(request) != set(kinds):
        return None
    return request if all(fits(request[key]) for key, fits in kinds.items()) else None


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_row(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**31


def _is_number(value: Any) -> bool:
    """Return whether it is a number, or none is known."""
    return value is None or (type(value) in (int, float) and abs(value) < 2**53)


# what may be posted: by path, the keys with what their values must be
ROUTES: Mapping[str, Mapping[str, Callable[[Any], bool]]] = {
    "/focus": {"entity": _is_text, "row": _is_row, "tick": _is_number},
    "/name": {"who": _is_text},
    "/status": {"page": _is_text, "shown": _is_number},
    "/order": {"order": _is_text, "pace": _is_number},
    "/do": {"do": _is_text},
    "/fork": {"do": _is_text},
    "/fork/do": {"do": _is_text},
    "/world": {},
}
LIVE = ("/status", "/order", "/do", "/fork", "/fork/do", "/world")  # of a run that is alive


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
