"""A checkpoint: the arrays and plain values of named parts in one folder, without pickle.

`<part>.safetensors` holds the arrays of a part, `checkpoint.json` the plain values, the versions
and a digest of every file and of the values. The folder appears under its name only when it is whole.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load, save

import ecology
from ecology import EcologyError

FORMAT = 2  # of the folder; a checkpoint of another format is refused
INDEX = "checkpoint.json"

Part = tuple[Mapping[str, np.ndarray], Mapping[str, Any]]  # arrays, plain values that JSON holds


def write(folder: Path, parts: Mapping[str, Part]) -> None:
    """Write `parts` to `folder`, in the place of a checkpoint that is there.

    It is written beside first and renamed when whole; whatever happens on the way, a whole
    checkpoint is left under `folder` or, between the two renames, under `folder`.old.
    """
    new, old = folder.with_name(folder.name + ".new"), folder.with_name(folder.name + ".old")
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir(parents=True)
    index: dict[str, Any] = {"format": FORMAT, "ecology": ecology.__version__, "digests": {}, "values": {}}
    for name, (arrays, values) in parts.items():
        data = save({key: np.array(array, order="C") for key, array in arrays.items()})
        (new / f"{name}.safetensors").write_bytes(data)
        index["digests"][name] = hashlib.sha256(data).hexdigest()
        index["values"][name] = json.loads(json.dumps(values, default=_plain))
    index["digest"] = _digest(index["values"])
    (new / INDEX).write_text(json.dumps(index, indent=1) + "\n")
    if folder.exists():
        shutil.rmtree(old, ignore_errors=True)
        folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def there(folder: Path) -> bool:
    """Return whether `folder` holds a checkpoint, be it one left between two renames."""
    return folder.exists() or folder.with_name(folder.name + ".old").exists()


def read(folder: Path) -> dict[str, Part]:
    """Return the parts that `write` put in `folder`; EcologyError where it is damaged or foreign."""
    old = folder.with_name(folder.name + ".old")
    if not folder.exists() and old.exists():
        folder = old
    if not folder.is_dir():
        raise EcologyError(f"there is no checkpoint in {str(folder.parent)!r}; give the folder of a run that has one.")
    try:
        index = json.loads((folder / INDEX).read_text())
        made_by = index["format"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise EcologyError(
            f"the checkpoint {str(folder)!r} is damaged or foreign: {INDEX} cannot be read ({error}). "
            "Start the run anew."
        ) from error
    if made_by != FORMAT:
        raise EcologyError(
            f"the checkpoint {str(folder)!r} has the format {made_by!r} (ecology {index.get('ecology')}); "
            f"this is ecology {ecology.__version__}, which reads format {FORMAT}. Read it with the version "
            "that wrote it."
        )
    try:
        if _digest(index["values"]) != index["digest"]:
            raise ValueError(f"the values in {INDEX} are not what was written")
        return {name: (_arrays(folder, name, index), values) for name, values in index["values"].items()}
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise EcologyError(
            f"the checkpoint {str(folder)!r} is damaged: {error}. Start the run anew, or restore the folder."
        ) from error


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
