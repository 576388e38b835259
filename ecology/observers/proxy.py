"""Lets viewers on this machine through to Rerun's server: a few at a time, none that reads too slowly.

Rerun's server takes as many connections as there are, keeps what a client does not read, and answers pages of every
site on this machine. A connection is closed here if it is one too many, if its client reads nothing for a while, or
if its first request names another host (DNS rebinding) or comes from a page that is not served by this machine.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import threading
from collections.abc import Callable
from urllib.parse import urlsplit

CONNECTIONS = 32  # at a time, at most
SLOW = 30.0  # seconds for which a client may read nothing while something waits for it
FIRST = 10.0  # seconds in which a client has to say what it wants
BLOCK = 65_536  # bytes that are passed on in one go, and that wait for a client here, at most
HOSTS = ("127.0.0.1", "localhost", "::1")
PREFACE = b"PRI * HTTP/2"  # of a viewer that is no page


def open_proxy(host: str, port: int, inner: int, tell: Callable[[int], None] = lambda _: None) -> None:
    """Serve at (host, port), in a thread, what is served at the port `inner` here; OSError where it is taken.

    tell: is given the number of connections, in that thread, whenever it changes.
    """
    loop, ready = asyncio.new_event_loop(), threading.Event()
    failed: list[OSError] = []

    async def serve() -> None:
        inside: set[object] = set()

        async def pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            key = object()
            if len(inside) >= CONNECTIONS:
                writer.transport.abort()
                return
            inside.add(key)
            tell(len(inside))
            try:
                await _pass_on(reader, writer, inner)
            finally:
                inside.discard(key)
                tell(len(inside))

        try:
            await asyncio.start_server(pass_on, host, port, limit=BLOCK, backlog=CONNECTIONS)
        except OSError as error:
            failed.append(error)
        ready.set()

    def run() -> None:
        loop.run_until_complete(serve())
        if not failed:
            loop.run_forever()
        loop.close()

    threading.Thread(target=run, daemon=True).start()
    ready.wait()
    if failed:
        raise failed[0]


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, inner: int) -> None:
    """Pass on one connection, both ways, until one side closes it or the client is too slow."""
    writers = [writer]
    try:
        head = await asyncio.wait_for(_head(reader), FIRST)
        if not is_welcome(head):
            writer.write(b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
            await asyncio.wait_for(writer.drain(), FIRST)
            return
        there, back = await asyncio.open_connection("127.0.0.1", inner, limit=BLOCK)
        writers.append(back)
        for each in writers:
            each.transport.set_write_buffer_limits(high=BLOCK)
        back.write(head)
        ways = [asyncio.create_task(_copy(reader, back)), asyncio.create_task(_copy(there, writer))]
        _, pending = await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in pending:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
    except (OSError, TimeoutError, asyncio.IncompleteReadError):
        return
    finally:
        for each in writers:
            each.transport.abort() if each.transport.get_write_buffer_size() else each.close()


async def _head(reader: asyncio.StreamReader) -> bytes:
    """Return the first bytes of a connection: of a page, the head of its first request."""
    head = b""
    while not head.startswith(PREFACE) and b"\r\n\r\n" not in head and len(head) < BLOCK:
        block = await reader.read(BLOCK)
        if not block:
            break
        head += block
    return head


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Forward the input; TimeoutError if it is not read."""
    with contextlib.suppress(OSError):
        while block := await reader.read(BLOCK):
            writer.write(block)
            await asyncio.wait_for(writer.drain(), SLOW)


def is_welcome(head: bytes) -> bool:
    """Return whether the first bytes of a connection are of a viewer, or of a page that this machine serves."""
    if head.startswith(PREFACE):
        return True
    fields = dict(re.findall(rb"(?m)^(host|origin):[ \t]*([^\r\n]*)", head.lower().partition(b"\r\n\r\n")[0]))
    places = [b"//" + fields.get(b"host", b"")] + ([fields[b"origin"]] if b"origin" in fields else [])
    try:
        return all(urlsplit(place.decode("latin-1")).hostname in HOSTS for place in places)
    except ValueError:
        return False
