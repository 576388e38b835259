"""The folder of a run: what it holds, how files are written to it, and its lock."""

from __future__ import annotations

import contextlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock, Timeout

from ecology.errors import EcologyError, readable

CONFIG = "config.toml"
SUMMARY, CHECKPOINT, METRICS, RECORDING = "summary.json", "checkpoint", "metrics.parquet", "recording.rrd"
EVALUATION, FIGURES = "evaluation.json", "figures"
LOCK = ".lock"  # file that the process that writes to the folder has locked
KEPT = "checkpoints"  # folder of those that are kept for good, each under its tick
INTERVENTIONS = "interventions.jsonl"  # what was done to it from outside
# what a run folder holds
WRITES = (CONFIG, SUMMARY, CHECKPOINT, KEPT, METRICS, RECORDING, EVALUATION, FIGURES, INTERVENTIONS)


def check_run(folder: Path) -> None:
    """Raise EcologyError where `folder` holds no run, or something that is no file."""
    if not (folder / CONFIG).is_file():
        raise EcologyError(f"the folder {str(folder)!r} holds no run: there is no {CONFIG} in it.")
    check_files(folder)


def check_files(folder: Path) -> None:
    """Raise EcologyError where `folder` holds what is neither a file nor a folder: whoever reads a pipe waits."""
    for path in _contents(folder):
        if path.exists() and not path.is_file() and not path.is_dir():
            raise EcologyError(
                f"{str(path)!r} is neither a file nor a folder, and no run writes such things; remove it."
            )


def check_links(folder: Path) -> None:
    """Raise EcologyError where `folder` holds a link: what is written to a run stays in its folder."""
    for path in _contents(folder):
        if path.is_symlink():
            raise EcologyError(
                f"{str(path)!r} is a link to {os.readlink(path)!r}, and nothing is written through links in a run "
                "folder; remove it, or put what it leads to in its place."
            )


def write_json(path: Path, value: Any) -> None:
    """Write `value` as JSON in the place of the file at `path`; what is not finite becomes null."""
    replace_text(path, json.dumps(_finite(value), indent=2, allow_nan=False) + "\n")


def check_evaluation(folder: Path, words: Mapping[str, Any]) -> None:
    """Raise EcologyError where `folder` holds an evaluation that was made with other `words`, keys of its report."""
    path, mine = folder / EVALUATION, json.loads(json.dumps(_finite(words)))
    then = f"give --again to replace it, or move {EVALUATION} and {FIGURES}/ away to keep it."
    try:
        with readable("the evaluation", path):
            text = path.read_text(encoding="utf-8")
        record = json.loads(text)
        differ = [
            f"{key} {record.get(key)!r} instead of {value!r}" for key, value in mine.items() if record.get(key) != value
        ]
    except FileNotFoundError:
        return
    except EcologyError:
        raise
    except (ValueError, AttributeError) as error:
        raise EcologyError(f"the evaluation {str(path)!r} is damaged ({error}); {then}") from error
    if differ:
        raise EcologyError(
            f"the folder {str(folder)!r} holds an evaluation that was made with {', '.join(differ)}; {then}"
        )


def replace_text(path: Path, text: str) -> None:
    """Write `text` in the place of the file at `path`, which is there whole at any time."""
    beside = path.with_name(path.name + ".new")
    beside.unlink(missing_ok=True)  # it may be a link
    with beside.open("x", encoding="utf-8") as file:
        file.write(text)
    beside.replace(path)


@contextlib.contextmanager
def lock(folder: Path, patience: float = 0.0) -> Iterator[None]:
    """Keep other processes out of `folder`; raise EcologyError if one still has it locked after `patience` seconds.

    The lock ends with the process, however that ends. A folder that does not exist or cannot be written is left
    unlocked: the code that uses it next reports that.
    """
    with contextlib.ExitStack() as stack:
        if folder.is_dir():  # FileLock would create it
            try:
                stack.enter_context(FileLock(folder / LOCK).acquire(timeout=patience, poll_interval=0.1))
            except Timeout as error:
                raise EcologyError(
                    f"another process is writing to the folder {str(folder)!r}; wait until it ends, or stop it."
                ) from error
            except OSError:  # read-only, or on a file system without locks
                pass
        yield


def is_locked(folder: Path) -> bool:
    """Return whether another process may have `folder` locked; False only if none has."""
    try:
        with FileLock(folder / LOCK).acquire(timeout=0.0):
            return False
    except OSError:  # Timeout is one
        return True


def _contents(folder: Path) -> Iterator[Path]:
    """Yield all that `folder` and the folders in it hold."""
    for place, folders, files in os.walk(folder):
        yield from (Path(place, name) for name in (*folders, *files))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(each) for key, each in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_finite(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
