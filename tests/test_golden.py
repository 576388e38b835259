"""Golden trajectories: what a world does is changed on purpose or not at all.

`make golden` (`pytest tests/test_golden.py --golden`) writes those that are missing or have changed.
"""

import json
from pathlib import Path

import numpy as np
import pytest

import ecology
from ecology import scenarios

FOLDER = Path(__file__).parent / "golden"
TICKS = (1, 10, 50, 120)  # at which the state is held
HELD = 1e-6  # by which a number may differ, absolute and relative
DIGITS = 9  # that are written, after the point
ROWS = 20  # of slots and patches that are written, spread over all; the sum is of all
STEPS = 5  # ticks for which a script stays with an action, if it stays open


def script(tick, env, t):
    """Return the actions (N,) of the script: every slot goes through its open actions in turn, from its own."""
    wanted = np.zeros(env.size, np.int64)
    for group in env.groups.values():
        mask = tick.masks[group.name]
        turn = (t // STEPS + np.arange(group.size)) % np.maximum(mask.sum(axis=1), 1)
        wanted[group.slots] = np.argmax(np.cumsum(mask, axis=1) > turn[:, None], axis=1)
    return wanted


def spread(values):
    """Return at most ROWS of the rows, and the sum of all."""
    few = values[:: max(1, -(-len(values) // ROWS))]
    return {"rows": np.round(few, DIGITS).tolist(), "sum": np.round(values.sum(axis=0), DIGITS).tolist()}


def trajectory(scenario):
    """Return the state of the world at the fixed ticks of the script, as JSON holds it."""
    env = ecology.parallel_env(scenario)
    tick = env.reset_arrays(seed=0)
    found = {}
    for t in range(TICKS[-1]):
        tick = env.step_arrays(script(tick, env, t))
        if t + 1 not in TICKS:
            continue
        now, alive = env.state_view, tick.alive
        facing = np.stack([np.cos(now.heading), np.sin(now.heading)], axis=1)
        found[str(t + 1)] = {
            "serial": now.serial[alive].tolist(),
            "action": now.action[alive].tolist(),
            "position": spread(now.position[alive]),
            "facing": spread(facing[alive]),
            "internal": spread(now.internal[alive]),
            "drive": spread(now.drive[alive]),
            "stock": spread(now.stock[np.isfinite(now.stock)]),
            "resource_position": spread(now.resource_position),
        }
    return found


def differences(golden, found, where=""):
    """Return where the two differ, the first few in words."""
    if isinstance(golden, dict) or isinstance(found, dict):
        if not (isinstance(golden, dict) and isinstance(found, dict) and golden.keys() == found.keys()):
            return [f"{where}: something is missing"]
        return [line for key in golden for line in differences(golden[key], found[key], f"{where} {key}")]
    one, other = np.array(golden, float), np.array(found, float)
    if one.shape != other.shape:
        return [f"{where}: another shape"]
    if np.allclose(one, other, rtol=HELD, atol=HELD):
        return []
    return [f"{where}: by at most {np.abs(one - other).max():.3g}"]


@pytest.mark.parametrize("name", scenarios.names())
def test_a_world_does_what_it_did(name, request):
    """The scripted life of every scenario is the one in its golden file, to 1e-6."""
    if request.config.getoption("--luck"):
        pytest.skip("golden trajectories are of one seed")
    path, found = FOLDER / f"{name}.json", trajectory(scenarios.load(name))
    golden = json.loads(path.read_text()) if path.exists() else {}
    differ = differences(golden, found)
    if differ and request.config.getoption("--golden"):
        path.write_text(json.dumps(found, separators=(",", ":")).replace('},"', '},\n"') + "\n")
        return
    assert golden, f"the scenario {name!r} has no golden trajectory; write {path.name} with: make golden"
    assert not differ, (
        f"the world of {name!r} does something else than it did, at tick and field {'; '.join(differ[:5])}. "
        "If that is meant, renew its golden trajectory with: make golden"
    )


def test_no_golden_file_is_left_over():
    """Every golden file is of a scenario that ships."""
    assert {path.stem for path in FOLDER.glob("*.json")} <= set(scenarios.names())


def test_a_difference_is_found():
    """A change beyond 1e-6 in one number, another shape and a missing tick are told; rounding is not."""
    found = trajectory(scenarios.load("seasons"))
    assert differences(found, json.loads(json.dumps(found))) == []
    changed = json.loads(json.dumps(found))
    changed["50"]["internal"]["rows"][0][1] += 1e-5
    assert differences(found, changed) == [" 50 internal rows: by at most 1e-05"]
    changed["50"]["internal"]["rows"][0][1] -= 1e-5 - 1e-9
    assert differences(found, changed) == []
    changed["10"]["serial"].append(1)
    assert differences(found, changed) == [" 10 serial: another shape"]
    del changed["10"]
    assert differences(found, changed) == [": something is missing"]
