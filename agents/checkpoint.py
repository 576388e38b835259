"""A checkpoint: the arrays and plain values of named parts in one folder, without pickle.

`<part>.safetensors` holds the arrays of a part, `checkpoint.json` the plain values, the versions
and a digest of every file and of the values. The folder appears under its name only when it is whole,
and the one before it is kept beside it.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

import ecology
from ecology import EcologyError
from ecology.errors import describe_refusal, readable

FORMAT = 5  # of the folder; a checkpoint of another format is refused
INDEX = "checkpoint.json"

Part = tuple[Mapping[str, np.ndarray], Mapping[str, Any]]  # arrays, plain values that JSON holds


def write(folder: Path, parts: Mapping[str, Part]) -> None:
    """Write `parts` to `folder`; the checkpoint that is there becomes `folder`.previous.

    It is written beside first and renamed when whole: whenever the process is killed, a whole
    checkpoint is left under `folder` or, between two renames, under `folder`.previous.
    Raises EcologyError where it cannot be written; what was there is then untouched.
    """
    new, previous = _beside(folder, ".new"), previous_of(folder)
    index: dict[str, Any] = {"format": FORMAT, "ecology": ecology.__version__, "digests": {}, "values": {}}
    try:
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir(parents=True)
        for name, (arrays, values) in parts.items():
            data = save({key: np.array(array, order="C") for key, array in arrays.items()})
            (new / f"{name}.safetensors").write_bytes(data)
            index["digests"][name] = hashlib.sha256(data).hexdigest()
            index["values"][name] = json.loads(json.dumps(values, default=_plain))
        index["digest"] = _digest(index["values"])
        (new / INDEX).write_text(json.dumps(index, indent=1) + "\n")
        if folder.exists():
            shutil.rmtree(previous, ignore_errors=True)
            folder.rename(previous)
        new.rename(folder)
    except OSError as error:
        raise EcologyError(
            f"the checkpoint {str(folder)!r} cannot be written ({describe_refusal(error)}). What was kept before is "
            "still there; make room, or give another folder."
        ) from error


def previous_of(folder: Path) -> Path:
    """Return where the checkpoint before the one in `folder` is kept."""
    return _beside(folder, ".previous")


def exists(folder: Path) -> bool:
    """Return whether `folder` holds a checkpoint, be it one left between two renames."""
    return folder.exists() or previous_of(folder).exists()


def put_aside(folder: Path) -> None:
    """Make the previous checkpoint the only one; the newer is kept, unused, as `folder`.aside."""
    if folder.exists():
        shutil.rmtree(_beside(folder, ".aside"), ignore_errors=True)
        folder.rename(_beside(folder, ".aside"))


def read(folder: Path, *, previous: bool = False) -> dict[str, Part]:
    """Return the parts that `write` put in `folder`, or the ones before them.

    Raises EcologyError where they are damaged, foreign or of another version.
    """
    before = previous_of(folder)
    if previous or (not folder.exists() and before.exists()):
        folder = before
    if not folder.is_dir():
        which = "previous checkpoint" if previous else "checkpoint"
        raise EcologyError(f"there is no {which} in {str(folder.parent)!r}; give the folder of a run that has one.")
    try:
        with readable("the checkpoint", folder):
            index = json.loads((folder / INDEX).read_text())
            made_by = index["format"], index["ecology"]
            if made_by == (FORMAT, ecology.__version__):
                if _digest(index["values"]) != index["digest"]:
                    raise ValueError(f"the values in {INDEX} are not what was written")
                return {name: (_arrays(folder, name, index), values) for name, values in index["values"].items()}
    except EcologyError:
        raise
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError, SafetensorError) as error:
        cause = f"{type(error).__name__}: {error}"
        raise EcologyError(
            f"the checkpoint {str(folder)!r} is damaged or foreign ({cause}). {advice(folder)}"
        ) from error
    raise EcologyError(
        f"the checkpoint {str(folder)!r} was written by ecology {made_by[1]} in format {made_by[0]!r}; this is ecology "
        f"{ecology.__version__}, which reads its own in format {FORMAT}. Read it with the version that wrote it, or "
        "start a new run."
    )


def check_array(
    name: str,
    given: np.ndarray,
    like: Any,
    *,
    finite: bool = True,
    low: float | None = None,
    below: float | None = None,
) -> None:
    """Raise EcologyError unless `given` has the shape and type of `like`, and values within what is said of them."""
    shape, dtype = tuple(like.shape), np.dtype(str(like.dtype).removeprefix("torch."))
    if given.shape != shape or given.dtype != dtype:
        raise EcologyError(
            f"the checkpoint does not fit: {name} has the shape {given.shape} and the type {given.dtype}, not {shape} "
            f"and {dtype}; load it with the settings that it was written with."
        )
    good = np.isfinite(given) if finite else np.ones(shape, bool)
    good &= (given >= low) if low is not None else True
    good &= (given < below) if below is not None else True
    if not good.all():
        raise EcologyError(f"the checkpoint's {name} holds {given[~good].ravel()[0].item()!r}, which no run comes to.")


def advice(folder: Path) -> str:
    """Return what to do where the checkpoint in `folder` cannot be used."""
    if previous_of(folder).is_dir():
        return f"Go on from the one before it with `ecology run --resume {folder.parent} --previous`."
    return "Start a new run with another --out; what this one has recorded can still be read."


def _beside(folder: Path, ending: str) -> Path:
    return folder.with_name(folder.name + ending)


def _arrays(folder: Path, name: str, index: Mapping[str, Any]) -> dict[str, np.ndarray]:
    data = (folder / f"{name}.safetensors").read_bytes()
    if hashlib.sha256(data).hexdigest() != index["digests"][name]:
        raise ValueError(f"{name}.safetensors is not what was written")
    return {key: array.copy() for key, array in load(data).items()}  # copies: those of load are locked


def _digest(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return what JSON holds in the place of a NumPy value."""
    if isinstance(value, (np.generic, np.ndarray)):
        return value.tolist()
    raise TypeError(f"a checkpoint holds plain values and arrays, got {type(value).__name__}")
