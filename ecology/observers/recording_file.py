"""The file of a recording, written by this process: a full disk is an error here, and hangs nothing.

Rerun's own file sink writes in a thread that ends where the disk is full; whoever flushes or closes the stream then
waits for it for ever. Here the stream only makes bytes, and this module puts them into the file.
"""

from __future__ import annotations

import contextlib
import os
import struct
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pyarrow.compute as pc
import rerun as rr
import rerun.blueprint as rrb
import rerun_bindings
from rerun.chunk import Chunk, RrdReader

from ecology.errors import EcologyError
from ecology.observers.viewer import unfinished_path

PATIENCE = 60.0  # seconds granted to the stream to make its bytes
HEADER, FRAME, END = 12, struct.Struct("<QQ"), 0  # of Rerun's format: bytes, kind and length of a message, the last


def open_stream(application: str, identity: str | None = None, *, named: bool = True) -> rr.RecordingStream:
    """Return a stream, with Rerun's properties of a recording if it is `named`; free those that nothing refers to.

    Rerun keeps two threads and some memory for each until they are freed, as `rr.init` does too.
    """
    rerun_bindings.flush_and_cleanup_orphaned_recordings()
    return rr.RecordingStream(application, recording_id=identity, send_properties=named)


class RecordingFile:
    """Puts what is logged to a stream into a file, message by message; a write that fails leaves whole messages."""

    def __init__(self, path: Path, rec: rr.RecordingStream) -> None:
        """Write what `rec` is sent from now on to the new file `path`, in the place of what is there."""
        self._path, self._stream = path, rr.binary_stream(rec)
        path.unlink(missing_ok=True)  # not through a link
        self._file = path.open("xb", buffering=0)
        self._size, self._waiting, self._begun = 0, b"", False

    def lay_out(self, layout: rrb.Blueprint, application: str) -> None:
        """Let the file begin with a layout; a stream that is sent one keeps its memory for good."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "layout.rbl"
            layout.save(application, path)
            self._waiting += _messages(path.read_bytes(), head=not self._begun)
        self._begun = True

    def append(self) -> None:
        """Write what was logged; OSError, which names the file, where there is no room, nothing being lost."""
        try:
            data = self._stream.read(flush=True, flush_timeout_sec=PATIENCE)
        except RuntimeError as error:
            raise EcologyError(f"the recording {str(self._path)!r} cannot be written: {error}.") from error
        if data:
            self._waiting += _messages(data, head=not self._begun)
            self._begun = True
        try:
            rest = memoryview(self._waiting)
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            with contextlib.suppress(OSError):
                self._file.truncate(self._size)
                self._file.seek(self._size)
            raise OSError(error.errno, error.strerror, str(self._path)) from error
        self._size += len(self._waiting)
        self._waiting = b""

    def close(self) -> None:
        """Write no more."""
        self._file.close()


def _messages(data: bytes, *, head: bool) -> bytes:
    """Return the messages of a whole recording without its index, and with its `head` or not."""
    at = HEADER
    while at + FRAME.size <= len(data):
        kind, length = FRAME.unpack_from(data, at)
        if kind == END:
            break
        at += FRAME.size + length
    return data[0 if head else HEADER : at]


def cut(path: Path, tick: int, application: str, identity: str) -> bool:
    """Leave out of a recording what is later than `tick`, and with it its layout; return whether there was anything."""
    later = any(_last(chunk) > tick for chunk in RrdReader(str(path)).stream())
    if later:
        beside = unfinished_path(path)
        beside.unlink(missing_ok=True)
        stream = RrdReader(str(path)).stream().flat_map(lambda chunk: list(_until(chunk, tick)))
        stream.write_rrd(str(beside), application_id=application, recording_id=identity)
        os.replace(beside, path)
    return later


def _last(chunk: Chunk) -> int:
    """Return the last tick of a chunk, -1 without any."""
    if chunk.is_static or "tick" not in chunk.timeline_names or not chunk.num_rows:
        return -1
    return int(pc.max(chunk.to_record_batch().column("tick")).as_py())


def _until(chunk: Chunk, tick: int) -> Iterator[Chunk]:
    """Give of a chunk what is not later than `tick`, if anything is."""
    if _last(chunk) <= tick:
        yield chunk
        return
    batch = chunk.to_record_batch()
    kept = batch.filter(pc.less_equal(batch.column("tick"), tick))
    if kept.num_rows:
        yield from Chunk.from_record_batch(kept)
