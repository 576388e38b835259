"""Recordings: they read back as what was, are continued, and open after a kill."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from observed import (
    TICKS,
    Blind,
    Wanderer,
    Witness,
    column,
    live,
    many,
    one,
    rerun_observer,
    strict,  # noqa: F401  (a fixture)
    told,
    village,
)
from worlds import kind

import ecology
from ecology import Arena, Ecology, EcologyError, agents
from ecology.agents.loop import advance
from ecology.ground import wrap
from ecology.observers import census, maps, viewer


def test_a_recording_shows_holes_and_inner_walls(tmp_path):
    """The outer walls, each hole and each inner wall are a line, and the floor has a hole in it."""
    from rerun.chunk import RrdReader

    hole, wall = ((3.0, 3.0), (5.0, 3.0), (5.0, 5.0)), ((1.0, 1.0), (1.0, 4.0), (2.0, 4.0))
    arena = Arena(vertices=((0, 0), (8, 0), (8, 8), (0, 8)), holes=[hole], walls=[wall])
    path = tmp_path / "recording.rrd"
    live(dataclasses.replace(one(), arena=arena, resources=(), species=(kind(),)), rerun_observer(path), ticks=2)
    (chunk,) = RrdReader(str(path)).stream().filter(content="/world/walls", is_static=True)
    (lines,) = chunk.to_record_batch().column("LineStrips2D:strips").to_pylist()
    assert lines[1:] == [[*map(list, hole), list(hole[0])], [*map(list, wall)]]
    fine = maps.cover(arena, 400)
    assert 64 * fine.inside.mean() == pytest.approx(62.0, abs=0.1)


def test_a_recording_reads_back(tmp_path):
    """Entities, the one timeline and the values of known ticks are those of the world."""
    from rerun.chunk import RrdReader

    witness, path = Witness(), tmp_path / "recording.rrd"
    env = live(many(), witness, rerun_observer(path, every=2, maps_every=20))
    reader = RrdReader(str(path))
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    assert not (tmp_path / "recording.unfinished.rrd").exists()
    entities = {chunk.entity_path for chunk in reader.stream()}
    assert entities >= {
        f"/{part}"
        for part in (
            "world/walls",
            "world/resources",
            "world/agents/prey",
            "world/agents/predator",
            "world/trail/prey",
            "focus/prey/deviation",
            "focus/predator/action",
            "learning/prey/losses",
            "world/maps/prey/need_4/image",
        )
    }
    for name, group in env.groups.items():
        species = env.scenario.species[group.index]
        ticks, positions = column(path, f"/world/agents/{name}", "Points2D:positions")
        assert ticks.tolist() == list(range(0, TICKS + 1, 2))
        _, drives = column(path, f"/world/agents/{name}", "drive")
        _, foods = column(path, f"/world/agents/{name}", "need_2")
        for tick in (0, 10, 30, TICKS):
            state = witness.states[tick]
            alive = state.alive[group.slots]
            seen = np.array(positions[tick // 2])
            np.testing.assert_allclose(seen[alive], state.position[group.slots][alive], atol=1e-6)
            assert np.isnan(seen[~alive]).all()
            np.testing.assert_allclose(np.array(drives[tick // 2])[alive], state.drive[group.slots][alive], atol=1e-5)
            np.testing.assert_allclose(
                np.array(foods[tick // 2])[alive], state.internal[group.slots, 1][alive], atol=1e-5
            )
        assert not witness.states[TICKS].alive[env.groups["predator"].slots].any()
        # the focus agent over time
        first = group.slots.start
        ticks, deviations = column(path, f"/focus/{name}/deviation", "Scalars:scalars")
        target = np.array([need.set_point for need in species.needs])
        np.testing.assert_allclose(deviations[4], witness.states[8].internal[first, : len(target)] - target, atol=1e-5)
        ticks, actions = column(path, f"/focus/{name}/action", "StateChange:state")
        done = {t: a[0] for t, a in zip(ticks.tolist(), actions, strict=True)}
        shown = ""
        for tick in range(0, TICKS + 1, 2):
            shown = done.get(tick, shown)
            state = witness.states[tick]
            lives = tick > 0 and state.alive[first]
            assert shown == (group.actions[state.action[first]] if lives else "")
        # trails hold every tick between samples, and losses are log10 of the mean over the living
        ticks, trails = column(path, f"/world/trail/{name}", "Points2D:positions")
        np.testing.assert_allclose(
            np.array(trails[3]),
            np.concatenate([witness.states[t].position[group.slots] for t in (5, 6)]),
            atol=1e-6,
        )
        ticks, losses = column(path, f"/learning/{name}/losses", "Scalars:scalars")
        mean = np.arange(group.size).mean()
        np.testing.assert_allclose(losses[2], np.log10([1.0 + mean, 10.0 + mean]))
    assert {name for chunk in reader.stream() if not chunk.is_static for name in chunk.timeline_names} == {"tick"}


def test_deviation_maps_are_the_minds_own(tmp_path):
    """A map holds J at need i = -x_i*, all else 0, at every cell of the arena, and nothing outside."""
    path = tmp_path / "recording.rrd"
    env = live(one(), rerun_observer(path, every=10, maps_every=30))
    grid = maps.cover(env.scenario.arena)
    ticks, values = column(path, "/world/maps/agent/need_3/image", "deviation")
    assert ticks.tolist() == [0, 30, 60]
    seen = np.array(values[-1]).reshape(grid.inside.shape)
    x, y = np.meshgrid(grid.x, grid.y)
    expected = np.where(grid.inside, np.hypot(x - 0.5, y - 4.25) + 3.0, np.nan)
    np.testing.assert_allclose(seen, expected, rtol=1e-5)
    assert grid.inside.shape == (60, 80)
    assert not grid.inside[0, 0]  # below the arena's floor
    assert grid.inside[15, 0]  # (0.05, 1.55)


def test_a_slot_that_is_used_again_is_another_agent(tmp_path):
    """Bodies are told by serial; the focus passes on where a life ends, and its series break there."""
    witness, path = Witness(), tmp_path / "recording.rrd"
    env = live(village(), witness, rerun_observer(path, every=1), ticks=150)
    rows = env.groups["prey"].slots
    assert (witness.states[150].serial[rows] > 15).any()  # slots were used again
    serials = told(path, "/world/agents/prey", "serial")
    for tick in (0, 1, 75, 150):
        assert np.array_equal(serials[tick], witness.states[tick].serial[rows])
    names = {t: v[0] for t, v in told(path, "/world/focus/prey/name", "Points2D:labels").items()}
    values = told(path, "/focus/prey/deviation")
    assert names[0] == "prey_0"
    changes = 0
    for tick in range(1, 151):
        state, serial = witness.states[tick], int(names[tick].rpartition("_")[2])
        slot = rows.start + int(np.flatnonzero(state.serial[rows] == serial)[0])
        assert state.alive[slot]
        if names[tick] != names[tick - 1]:
            changes += 1
            old = int(names[tick - 1].rpartition("_")[2])
            assert not state.alive[rows][state.serial[rows] == old].any()
            assert state.age[slot] == state.age[rows][state.alive[rows]].max()  # the oldest is next
            assert np.isnan(values[tick]).all()
        else:
            assert values[tick] == pytest.approx(state.internal[slot, 0] - 2.0, abs=1e-5)
    assert changes


def test_events_are_told_by_name(tmp_path):
    """The log names who was born, died, bit and gave; of more than a sample has lines for, it says how many."""
    from ecology.observers.panels.events import LINES

    witness, path, every = Witness(), tmp_path / "recording.rrd", 10
    env = live(village(), witness, rerun_observer(path, every=every), ticks=100)
    species, happened = tuple(env.groups), {}  # species, tick of the sample, deed -> ticks and words

    def happens(slot, deed, words):
        sample = -(-state.tick // every) * every
        happened.setdefault((species[slot >= 16], sample, deed), []).append((state.tick, f"{name[slot]} {words}"))

    for before, state, tick in zip(witness.states, witness.states[1:], witness.ticks[1:], strict=False):
        name = [f"{species[slot >= 16]}_{state.serial[slot]}" for slot in range(env.size)]
        for slot in range(env.size):
            if tick.born[slot]:
                parent = tick.parent[slot]
                happens(slot, "born", f"born, child of {name[parent]}" if parent >= 0 else "arrived")
            if tick.died[slot]:
                killer = name[tick.killer[slot]] if tick.killer[slot] >= 0 else "nobody"
                death = census.DEATHS[ecology.state.CAUSES[state.cause[slot]]].format(need="", killer=killer)
                happens(slot, "died", death)
            if state.bit[slot] >= 0:
                happens(slot, "bit", f"bit {name[state.bit[slot]]}")
            if state.gave[slot] >= 0 and state.gave[slot] != before.gave[slot]:
                happens(slot, "gave", f"gave to {name[state.gave[slot]]}")
    expected, most = [], LINES[True]
    for (whose, sample, deed), lines in happened.items():
        expected += lines[:most]
        if len(lines) > most:
            expected.append((sample, f"and {len(lines) - most} more {whose} {deed}"))
    seen = []
    for group in env.groups:
        ticks, texts = column(path, f"/events/{group}", "TextLog:text")
        told_at = [text[0].split("  ", 1) for text in texts]
        assert [at for at, _ in told_at] == [f"{tick:,}" for tick in ticks]  # words tell their tick
        seen += [(int(tick), text) for tick, (_, text) in zip(ticks, told_at, strict=True)]
    meals = (" ate", " slept", "focus:")
    assert sorted(expected) == sorted(e for e in seen if not any(word in e[1] for word in meals))
    words = " ".join(text for _, text in seen)
    for word in (
        "born, child",
        "arrived",
        "died, eaten by predator_",
        "by chance",
        "bit",
        "gave",
        "ate grass",
        "slept",
    ):
        assert word in words


def test_a_thousand_agents_take_48_bytes_each(tmp_path):
    """A recording grows by at most 48 bytes per agent and sampled tick: place, heading, action, eight variables."""
    needs = tuple(ecology.Need(name=f"need_{i}", set_point=1.0, noise=0.05, bounds=(0.0, 2.0 + i)) for i in range(8))
    crowd = ecology.Species(
        name="crowd",
        needs=needs,
        actions=(ecology.rest(), ecology.move("walk", 0.2), ecology.turn("left", 0.7)),
        count=1000,
    )
    world = ecology.Scenario(
        name="crowd", arena=ecology.Arena(vertices=((0, 0), (60, 0), (60, 60), (0, 60))), species=(crowd,)
    )
    sizes = {}
    for ticks in (20, 60):
        path = tmp_path / f"{ticks}.rrd"
        env = Ecology(world)
        minds = {"crowd": agents.make("random", env.groups["crowd"], np.random.SeedSequence(1), {})}
        observer = rerun_observer(path, every=1)
        tick = env.reset_arrays(1)
        observer.begin(env, minds)
        advance(env, minds, tick, ticks, [observer])
        observer.end()
        sizes[ticks] = path.stat().st_size
    assert (sizes[60] - sizes[20]) / 40 / 1000 <= 48
    for i in range(8):
        assert told(path, "/world/agents/crowd", f"need_{i}")[60] == pytest.approx(
            env.state_view.internal[:, i], abs=1e-6
        )
    way = told(path, "/world/agents/crowd", "Arrows2D:vectors")[60]
    turned = np.arctan2(way[:, 1], way[:, 0]) - env.state_view.heading
    assert np.abs(wrap(turned)).max() <= np.pi / 512 + 1e-6
    assert told(path, "/world/agents/crowd", "action")[60].tolist() == env.state_view.action.tolist()


def test_a_mind_without_j_or_numbers_is_recorded(tmp_path):
    """Nothing is drawn of what a learner does not have."""
    from rerun.chunk import RrdReader

    path = tmp_path / "recording.rrd"
    live(one(), rerun_observer(path, every=10), mind=Blind)
    entities = {chunk.entity_path for chunk in RrdReader(str(path)).stream()}
    assert "/world/agents/agent" in entities
    assert not any("maps" in entity or "learning" in entity for entity in entities)


def test_a_resumed_recording_is_one(tmp_path):
    """Both stretches end up in one file, under one identity."""
    from rerun.chunk import RrdReader

    path = tmp_path / "recording.rrd"
    env = live(one(), rerun_observer(path, every=10))
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(6))}
    with pytest.raises(EcologyError, match="recording at"):
        rerun_observer(path)
    again = rerun_observer(path, every=10, resume=True)
    again.begin(env, minds)
    advance(env, minds, env.set_state(), 20, [again])
    again.end()
    assert len(RrdReader(str(path)).recordings()) == len(RrdReader(str(path)).blueprints()) == 1
    ticks, _ = column(path, "/world/agents/agent", "drive")
    assert sorted(set(ticks.tolist())) == list(range(0, TICKS + 21, 10))
    assert [p.name for p in tmp_path.iterdir()] == ["recording.rrd"]


def test_a_recording_too_large_to_be_put_in_order_can_be_read(tmp_path, monkeypatch):
    """It is left as it was written, without an index, and is put in order by who reads it or goes on with it."""
    from ecology.observers import readback, rerun

    monkeypatch.setattr(rerun, "TIDY", 0)
    path = tmp_path / "recording.rrd"
    env = live(one(), rerun_observer(path, every=10))
    assert not viewer.is_complete(path)
    ticks = list(range(0, TICKS + 1, 10))
    assert [f.tick for f in readback.frames(path, env.scenario, 0)] == ticks
    again = rerun_observer(path, every=10, resume=True)
    again.begin(env, {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(6))})
    again.end()
    assert sorted(set(column(path, "/world/agents/agent", "drive")[0].tolist())) == ticks


def test_a_recording_that_was_killed_at_once_begins_anew(tmp_path):
    """Of a run that is gone on with from its first tick nothing was recorded, readable or not."""
    path = tmp_path / "recording.rrd"
    path.write_bytes(b"RRF")
    live(one(), rerun_observer(path, every=10, resume=True))
    assert column(path, "/world/agents/agent", "drive")[0].tolist() == list(range(0, TICKS + 1, 10))
    assert list(tmp_path.iterdir()) == [path]


def test_a_last_stretch_that_cannot_be_read_is_left_out(tmp_path):
    """A run that was killed as soon as it had been resumed can be resumed again."""
    path = tmp_path / "recording.rrd"
    env = live(one(), rerun_observer(path, every=10))
    path.write_bytes(path.read_bytes()[:-100])
    viewer.resumed_path(path).write_bytes(b"")
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(6))}
    again = rerun_observer(path, every=10, resume=True)
    again.begin(env, minds)
    advance(env, minds, env.set_state(), 20, [again])
    again.end()
    assert {0, TICKS, TICKS + 10, TICKS + 20} <= set(column(path, "/world/agents/agent", "drive")[0].tolist())
    assert list(tmp_path.iterdir()) == [path]


def test_a_killed_recording_opens(tmp_path):
    """What was sent before a run was killed can be read, and is mended for the viewer."""
    path = tmp_path / "recording.rrd"
    code = (
        "import sys; sys.path.insert(0, 'tests')\n"
        "import os, time, observed as t\n"
        "from ecology.observers import rerun\n"
        "rerun.SECONDS_FILE = 0.0\n"
        f"observer = t.rerun_observer({str(path)!r}, every=1)\n"
        "t.live(t.one(), observer, close=False)\n"
        "time.sleep(1.0)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == -9
    assert not viewer.is_complete(path)
    path.write_bytes(path.read_bytes()[:-100])  # in the middle of a write
    mended = viewer.repair_recording(path, tmp_path / "mended.rrd")
    ticks, _ = column(mended, "/world/agents/agent", "drive")
    assert len(ticks) > TICKS // 2

    env = live(one(), ticks=TICKS // 3)  # the checkpoint that it goes on from
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(6))}
    again = rerun_observer(path, every=1, resume=True)
    again.begin(env, minds)
    before = list(range(TICKS // 3 + 1))
    assert column(path, "/world/agents/agent", "drive")[0].tolist() == before
    advance(env, minds, env.set_state(), 5, [again])
    again.end()
    after = [*before, *range(TICKS // 3 + 1, TICKS // 3 + 6)]
    for entity, component in (("/world/agents/agent", "drive"), ("/focus/agent/needs", "Scalars:scalars")):
        assert sorted(column(path, entity, component)[0].tolist()) == after, entity
    from rerun.chunk import RrdReader

    assert len(RrdReader(str(path)).recordings()) == len(RrdReader(str(path)).blueprints()) == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mended.rrd", "recording.rrd"]


def test_a_recording_that_is_damaged_inside_is_one_clear_error(tmp_path):
    """Where a byte was lost or changed, every reader gives what there is, or one EcologyError."""
    from ecology.observers import readback
    from ecology.observers.hindsight import Hindsight

    path, rng, refused = tmp_path / "recording.rrd", np.random.default_rng(0), 0
    live(one(), rerun_observer(path, every=5))
    data = path.read_bytes()
    for i in range(24):
        at, bad = int(rng.integers(3, len(data) - 200)), bytearray(data)
        bad[at : len(data) if i % 3 == 0 else at + 100] = rng.bytes(100) if i % 3 == 1 else b""
        path.write_bytes(bad)
        for look in (
            lambda source: readback.frames(source, one(), 0),
            readback.span,
            lambda s: Hindsight(s, one(), "x"),
        ):
            try:
                with viewer.open_recording(path) as source:
                    look(source)
            except EcologyError:
                refused += 1
    assert refused
