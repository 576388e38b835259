"""Two runs that end alike."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from ecology.agents import checkpoint
from ecology.observers.readback import chunks


def same_end(one: str, other: str) -> None:
    """Compare the last states of two runs bit for bit, except for their clocks."""
    a, b = (checkpoint.read(Path(each, "checkpoint")) for each in (one, other))
    assert a.keys() == b.keys()
    for name, (arrays, values) in a.items():
        assert {**values, "seconds": 0} == {**b[name][1], "seconds": 0}, name
        assert arrays.keys() == b[name][0].keys()
        for key, array in arrays.items():
            np.testing.assert_array_equal(array, b[name][0][key], err_msg=f"{name} {key}")


def recorded(recording: Path) -> dict[str, Counter[int]]:
    """Return how often every component of every entity ("/entity component") of a recording is given at each tick.

    A chunk holds some components of an entity; putting a recording in order may split and join chunks.
    """
    found: dict[str, Counter[int]] = defaultdict(Counter)
    for chunk in chunks(recording, is_static=False):
        if "tick" not in chunk.timeline_names:
            continue
        batch = chunk.to_record_batch()
        timelines = {"rerun.controls.RowId", *chunk.timeline_names}
        for name in set(batch.schema.names) - timelines:
            given = batch.filter(batch.column(name).is_valid())
            found[f"{chunk.entity_path} {name}"].update(given.column("tick").to_pylist())
    return found
