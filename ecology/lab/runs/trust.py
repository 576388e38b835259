"""The list of the code that this user has run: files by digest and path, in the format of `sha256sum`."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import platformdirs

LIST = "trusted"  # file in the user's folder for the state of this program


class File(NamedTuple):
    """A file of code, and the digest of what it holds."""

    path: str
    sha256: str


def read_list() -> set[File]:
    """Return the files that this user has run; none where the list is not there or cannot be read."""
    try:
        lines = _list().read_text(encoding="utf-8", errors="replace").split("\n")
    except OSError:
        return set()
    parts = [line.partition("  ") for line in lines]
    return {File(file, digest) for digest, _, file in parts if file}


def note(files: Iterable[File]) -> None:
    """Add files to the list; nothing is added where it cannot be written."""
    known = read_list()
    new = dict.fromkeys(each for each in files if each not in known and "\n" not in each.path)
    if not new:
        return
    path = _list()
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        text = "".join(f"{each.sha256}  {each.path}\n" for each in new)
        descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600)
        try:
            os.write(descriptor, text.encode())  # at once: other processes add lines, too
        finally:
            os.close(descriptor)


def _list() -> Path:
    return platformdirs.user_state_path("ecology", appauthor=False) / LIST
