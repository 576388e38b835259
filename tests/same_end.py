"""Two runs that end alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ecology.agents import checkpoint


def same_end(one: str, other: str) -> None:
    """Compare the last states of two runs bit for bit, except for their clocks."""
    a, b = (checkpoint.read(Path(each, "checkpoint")) for each in (one, other))
    assert a.keys() == b.keys()
    for name, (arrays, values) in a.items():
        assert {**values, "seconds": 0} == {**b[name][1], "seconds": 0}, name
        assert arrays.keys() == b[name][0].keys()
        for key, array in arrays.items():
            np.testing.assert_array_equal(array, b[name][0][key], err_msg=f"{name} {key}")
