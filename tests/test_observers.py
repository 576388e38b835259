"""Those who watch: what they write is what was, and they change nothing."""
# ruff: noqa: D102

import contextlib
import dataclasses
import errno
import logging
import pathlib
import subprocess
import sys
import types

import numpy as np
import pyarrow.parquet as pq
import pytest
from worlds import ask, kind, square, start

import ecology
from ecology import Arena, Ecology, EcologyError, agents, scenarios
from ecology.agents.base import Learner
from ecology.agents.loop import advance
from ecology.decision import Decision
from ecology.ground import scatter, wrap
from ecology.observers import census, maps, picture, viewer
from ecology.observers.recorder import Recorder, parts_of, read

TICKS = 60


class Wanderer(Learner):
    """Takes any open action; knows the distance to each food as its deviation function."""

    def act(self, observations, masks):
        return np.array([self.rng.choice(np.flatnonzero(row)) if row.any() else 0 for row in masks])

    def report(self):
        numbers = np.arange(self.size, dtype=float)
        return {"loss_f": numbers + 1.0, "loss_J": numbers + 10.0, "epsilon": np.full(self.size, 0.25)}

    def deviation(self, slot, zeta):
        if self.group.layout.names[6:8] != ("x", "y"):
            return None
        return np.hypot(zeta[:, 6] - 0.5, zeta[:, 7] - 4.25) - zeta[:, :4].sum(axis=1)


class Blind(Wanderer):
    """Has no deviation function and reports nothing."""

    def report(self):
        return {}

    def deviation(self, slot, zeta):
        return None


class Witness:
    """Keeps a copy of every state, and tries to write on what it is shown."""

    def begin(self, env, minds):
        self.states = [env.state_view.copy()]
        self.ticks = [None]

    def watch(self, state, tick, minds):
        with pytest.raises(ValueError, match="read-only"):
            state.position[0] = 0.0
        self.states.append(state.copy())
        self.ticks.append(tick)

    def end(self):
        pass


def one():
    """Return the paper's world."""
    return scenarios.load("paper")


def many():
    """Return three prey and two predators; the predators have other needs, and can die of one."""
    scenario = one()
    prey = dataclasses.replace(scenario.species[0], name="prey", count=3, position=None, heading=None)
    food, *others = prey.needs[:4]
    hunger = dataclasses.replace(food, start=0.02, lethal=True)  # dies after 10 ticks without
    predator = dataclasses.replace(
        prey, name="predator", count=2, needs=(hunger, *others, *prey.needs[4:]), senses=("position",)
    )
    return dataclasses.replace(scenario, species=(prey, predator))


def village(ticks_of_life=60):
    """Return prey that bear, give and feel for each other, predators that bite, and patches of grass."""
    ways = (ecology.move("walk", 0.3), ecology.turn("left", 0.8))
    energy = ecology.Need(name="energy", set_point=2.0, decay=0.02, bounds=(0.0, 4.0))
    prey = ecology.Species(
        name="prey",
        needs=(energy,),
        actions=(
            ecology.rest(),
            *ways,
            ecology.consume("grass", {"energy": 0.2}),
            ecology.give("prey", {"energy": 0.1}, reach=1.0),
            ecology.sleep(duration=3.0),
        ),
        count=12,
        capacity=16,
        birth=ecology.Birth(rate=0.1, threshold={"energy": 1.0}, cost={"energy": 0.2}),
        hazard=ecology.Hazard(rate=1.0 / ticks_of_life),
        view_range=2.0,
        neighbours=(ecology.Neighbours(count=1),),
        empathy=ecology.Empathy(weight=0.1),
    )
    predator = ecology.Species(
        name="predator",
        needs=(energy,),
        actions=(ecology.rest(), *ways, ecology.bite("prey", reach=0.8, gain={"energy": 1.0})),
        count=3,
        arrival=0.2,
        capacity=5,
        hazard=ecology.Hazard(rate=0.02),
    )
    grass = ecology.Resource(name="grass", count=6, radius=0.6, stock=3.0, growth=ecology.Growth(rate=0.05))
    return ecology.Scenario(
        name="village",
        arena=ecology.Arena(vertices=((0, 0), (5, 0), (5, 5), (0, 5))),
        resources=(grass,),
        species=(prey, predator),
        measures={"crowding": lambda state: float(np.count_nonzero(state.alive)) / 25.0},
    )


def live(scenario, *observers, mind=Wanderer, ticks=TICKS, close=True):
    """Return the world after `ticks` ticks that `observers` watched."""
    env = Ecology(scenario)
    tick = env.reset_arrays(7)
    minds = {g.name: mind(g, np.random.SeedSequence(5)) for g in env.groups.values()}
    for observer in observers:
        observer.begin(env, minds)
    advance(env, minds, tick, ticks, observers)
    for observer in observers if close else ():
        observer.end()
    return env


@pytest.fixture(autouse=True)
def strict():
    """Make bad input to the viewer's library an error instead of a warning."""
    import rerun as rr

    rr.set_strict_mode(True)


def rerun_observer(*args, serve=None, connect=None, resume=False, wishes=None, **kwargs):
    """Return a RerunObserver; rerun is loaded by the tests that use it."""
    from ecology.observers.rerun import Recorded, RerunObserver, Viewers

    run = Recorded(resume=resume, wishes=wishes)
    return RerunObserver(*args, viewers=Viewers(serve, connect), run=run, **kwargs)


def column(path, entity, component):
    """Return ticks (n,) and the values at them of a component in a recording."""
    from rerun.chunk import RrdReader

    ticks, values = [], []
    chunks = RrdReader(str(path)).stream().filter(content=entity, components=component, is_static=False)
    for chunk in chunks:
        batch = chunk.to_record_batch()
        ticks += batch.column("tick").to_pylist()
        values += batch.column(component).to_pylist()
    order = np.argsort(ticks, kind="stable")
    return np.asarray(ticks)[order], [values[i] for i in order]


def test_the_world_loads_no_viewer():
    """`import ecology` loads neither the viewer's nor the plotting library."""
    code = "import ecology, sys; assert not {'rerun', 'matplotlib'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("world", [one, many, village])
def test_watching_changes_nothing(tmp_path, world):
    """A run that is watched by all lives as one that nobody watches, and cannot be written by them."""
    alone = live(world()).state_view
    watched = live(
        world(),
        Witness(),
        Recorder(tmp_path / "metrics.parquet", every=1),
        rerun_observer(tmp_path / "recording.rrd", every=1, maps_every=7, serve=("127.0.0.1", 0)),
    ).state_view
    for name, array in alone.arrays().items():
        np.testing.assert_array_equal(array, watched.arrays()[name], err_msg=name)


@pytest.mark.parametrize("world", [one, many, village])
def test_metrics_hold_every_sampled_tick_and_living_agent(tmp_path, world):
    """Rows are the state, by name; what a species does not have is null."""
    witness, path = Witness(), tmp_path / "metrics.parquet"
    env = live(world(), witness, Recorder(path, every=5))
    rows = pq.read_table(path).to_pylist()
    assert not parts_of(path).exists()
    expected = [(tick, slot) for tick in range(5, TICKS + 1, 5) for slot in np.flatnonzero(witness.states[tick].alive)]
    assert len(rows) == len(expected)
    for row, (tick, slot) in zip(rows, expected, strict=True):
        state = witness.states[tick]
        group = next(g for g in env.groups.values() if g.slots.start <= slot < g.slots.stop)
        species = env.scenario.species[group.index]
        assert (row["tick"], row["time"]) == (tick, state.time)
        assert (row["agent"], row["species"]) == (f"{group.name}_{state.serial[slot]}", group.name)
        assert row["action"] == group.actions[state.action[slot]]
        assert [row["x"], row["y"], row["heading"]] == pytest.approx(
            [*state.position[slot], state.heading[slot]], abs=1e-6
        )
        values = state.internal[slot, : len(species.needs)]
        assert [row[need.name] for need in species.needs] == pytest.approx(values, abs=1e-5)
        assert row["drive"] == pytest.approx(state.drive[slot], abs=1e-5)
        assert row["reward"] == pytest.approx(witness.ticks[tick].reward[slot], abs=1e-6)
        assert row["loss_f"] == 1.0 + slot - group.slots.start
        assert row["epsilon"] == 0.25


def test_a_variable_that_a_species_lacks_is_null(tmp_path):
    """Species with different needs share the table."""
    scenario = one()
    agent = scenario.species[0]
    plain = dataclasses.replace(
        agent,
        name="plain",
        position=None,
        needs=agent.needs[:1],
        actions=agent.actions[:1],
        collapse={},
    )
    path = tmp_path / "metrics.parquet"
    live(dataclasses.replace(scenario, species=(plain, agent)), Recorder(path, every=10), mind=Blind)
    rows = pq.read_table(path).to_pylist()
    assert {row["species"] for row in rows} == {"plain", "agent"}
    assert all((row["need_4"] is None) == (row["species"] == "plain") for row in rows)
    assert all(row["need_1"] is not None for row in rows)


def test_metrics_of_a_stopped_run_can_be_read_and_gone_on_with(tmp_path, monkeypatch):
    """Parts are complete files; a resumed recording keeps the rows up to its tick."""
    from ecology.observers import recorder

    monkeypatch.setattr(recorder, "ROWS", 10)
    monkeypatch.setattr(recorder, "SECONDS", np.inf)  # a machine may take long to compile
    path = tmp_path / "metrics.parquet"
    live(one(), Recorder(path, every=1), close=False)
    assert not path.exists()
    assert read(path)["tick"].to_pylist() == list(range(1, TICKS + 1))
    assert pq.read_table(parts_of(path)).num_rows == TICKS
    with pytest.raises(EcologyError, match="metrics at"):
        Recorder(path)

    env = Ecology(one())
    tick = env.reset_arrays(7)
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(5))}
    tick = advance(env, minds, tick, 20)
    again = Recorder(path, every=1, resume=True)
    again.begin(env, minds)
    advance(env, minds, tick, 15, [again])
    again.end()
    assert read(path)["tick"].to_pylist() == list(range(1, 36))
    assert pq.ParquetFile(path).num_row_groups == 4
    assert sorted(p.name for p in tmp_path.iterdir()) == ["metrics.parquet"]


def renamed(scenario, name):
    """Return `scenario` with its first need under another name."""
    agent = scenario.species[0]
    needs = (dataclasses.replace(agent.needs[0], name=name), *agent.needs[1:])
    actions = tuple(a for a in agent.actions if "need_1" not in {*a.control, *a.opens_from, *a.closes_at})
    return dataclasses.replace(scenario, species=(dataclasses.replace(agent, needs=needs, actions=actions),))


@pytest.mark.parametrize("name", ["epsilon", "drive"])
def test_columns_of_one_name_are_refused_at_once(tmp_path, name):
    """A need named like a column, or like a number that a mind reports, is refused before anything is written."""
    with pytest.raises(EcologyError, match=name):
        live(renamed(one(), name), Recorder(tmp_path / "metrics.parquet"))
    assert list(tmp_path.iterdir()) == []

    class Teller(Blind):
        def report(self):
            return {"reward": np.zeros(self.size)}

    with pytest.raises(EcologyError, match="reward"):
        live(one(), Recorder(tmp_path / "metrics.parquet"), mind=Teller)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", [b"", b"PAR1", b"PAR1" + bytes(50) + b"PAR1"])
def test_damaged_metrics_are_one_clear_error(tmp_path, text):
    """Reading them and going on with them names the file, and leaves it and nothing else."""
    path = tmp_path / "metrics.parquet"
    path.write_bytes(text)
    with pytest.raises(EcologyError, match=r"metrics\.parquet' is damaged"):
        read(path)
    with pytest.raises(EcologyError, match=r"metrics\.parquet' is damaged"):
        live(one(), Recorder(path, resume=True))
    assert {p: p.read_bytes() for p in tmp_path.iterdir()} == {path: text}


class Full:
    """Stands for a disk that is full from some call on, in the place of a writer of files."""

    def __init__(self, real, calls=0, number=errno.ENOSPC):
        self.real, self.calls, self.number = real, calls, number

    def __call__(self, *words, **more):
        self.calls -= 1
        if self.calls < 0:
            for path in (word for word in words if isinstance(word, pathlib.Path)):
                path.write_bytes(b"PAR1 half")
            raise OSError(self.number, "told by the library in its own words")
        return self.real(*words, **more)


@pytest.mark.parametrize(("number", "cause"), [(errno.ENOSPC, "No space left"), (errno.EROFS, "Read-only")])
def test_metrics_that_cannot_be_joined_are_not_called_damaged(tmp_path, monkeypatch, number, cause):
    """A full disk at the end of a run is named as such; every row is kept and joined once there is room."""
    path = tmp_path / "metrics.parquet"
    with monkeypatch.context() as full:
        full.setattr("ecology.observers.recorder._join", Full(None, number=number))
        with pytest.raises(EcologyError, match=cause) as told:
            live(one(), Recorder(path, every=1))
    assert "damaged" not in str(told.value)
    assert "No row is lost" in str(told.value)
    assert [p.name for p in tmp_path.iterdir()] == ["metrics.parquet.parts"]
    assert read(path)["tick"].to_pylist() == list(range(1, TICKS + 1))
    again = Recorder(path, every=1, resume=True)
    env = Ecology(one())
    env.reset_arrays(7)
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(5))}
    advance(env, minds, env.reset_arrays(7), TICKS)
    again.begin(env, minds)
    again.end()
    assert read(path)["tick"].to_pylist() == list(range(1, TICKS + 1))
    assert list(tmp_path.iterdir()) == [path]


def test_metrics_that_may_not_be_read_are_not_called_damaged(tmp_path, monkeypatch):
    """A file without permission is named with that cause, and no advice is to move it."""
    path = tmp_path / "metrics.parquet"
    live(one(), Recorder(path, every=1))
    monkeypatch.setattr(pq, "read_table", Full(None, number=errno.EACCES))
    with pytest.raises(EcologyError, match="Permission denied") as told:
        read(path)
    assert not {"damaged", "move"} & set(str(told.value).split())


def test_only_the_damaged_part_is_moved_away(tmp_path, monkeypatch):
    """Of several files the error names the one that is damaged; without it the others are read."""
    monkeypatch.setattr("ecology.observers.recorder.ROWS", 10)
    monkeypatch.setattr("ecology.observers.recorder.SECONDS", np.inf)
    path = tmp_path / "metrics.parquet"
    recorder = Recorder(path, every=1)
    monkeypatch.setattr(recorder, "end", lambda: None)  # as a run that was killed leaves it
    live(one(), recorder)
    bad = parts_of(path) / "part-000002.parquet"
    bad.write_bytes(b"PAR1 no more")
    with pytest.raises(EcologyError, match=rf"{bad.name}' is damaged .* Move this one file away") as told:
        read(path)
    assert "part-000001" not in str(told.value)
    bad.unlink()
    assert read(path)["tick"].to_pylist() == [*range(1, 11), *range(21, TICKS + 1)]


def test_a_half_written_part_is_not_among_the_parts(tmp_path, monkeypatch):
    """Other readers open the folder of parts whatever moment the run was killed at: a part is in it when complete."""
    monkeypatch.setattr("ecology.observers.recorder.ROWS", 10)
    monkeypatch.setattr("ecology.observers.recorder.SECONDS", np.inf)
    path = tmp_path / "metrics.parquet"
    recorder = Recorder(path, every=1)
    monkeypatch.setattr(recorder, "end", lambda: None)
    monkeypatch.setattr(pathlib.Path, "unlink", lambda *_, **__: None)  # a killed process tidies nothing
    monkeypatch.setattr(pq, "write_table", Full(pq.write_table, calls=3))
    with pytest.raises(OSError):
        live(one(), recorder)
    assert (tmp_path / "metrics.parquet.unfinished").read_bytes() == b"PAR1 half"
    assert pq.read_table(parts_of(path))["tick"].to_pylist() == list(range(1, 31))
    monkeypatch.undo()
    assert pq.read_table(parts_of(path)).num_rows == 30
    again = Recorder(path, every=1, resume=True)
    env = Ecology(one())
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(5))}
    advance(env, minds, env.reset_arrays(7), TICKS)
    again.begin(env, minds)
    again.end()
    assert list(tmp_path.iterdir()) == [path]


def test_rows_are_there_once_wherever_joining_was_killed(tmp_path):
    """Beside the joined file the parts are a remnant: they are read no more, and not gone on with."""
    path = tmp_path / "metrics.parquet"
    live(one(), Recorder(path, every=1))
    parts_of(path).mkdir()
    (parts_of(path) / "part-000001.parquet").write_bytes(path.read_bytes())
    assert read(path)["tick"].to_pylist() == list(range(1, TICKS + 1))
    env = Ecology(one())
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(5))}
    tick = advance(env, minds, env.reset_arrays(7), TICKS)
    again = Recorder(path, every=1, resume=True)
    again.begin(env, minds)
    assert not path.exists()
    assert read(path)["tick"].to_pylist() == list(range(1, TICKS + 1))
    advance(env, minds, tick, 5, [again])
    again.end()
    assert read(path)["tick"].to_pylist() == list(range(1, TICKS + 6))
    assert list(tmp_path.iterdir()) == [path]


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
    """Entities, timelines and the values of known ticks are those of the world."""
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
    ticks, times = column(path, "/world/agents/prey", "drive")[0], []
    for chunk in reader.stream().filter(content="/world/agents/prey", is_static=False):
        times += [t.total_seconds() for t in chunk.to_record_batch().column("sim_time").to_pylist()]
    np.testing.assert_allclose(sorted(times), ticks * env.dt)


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


def told(path, entity, component="Scalars:scalars"):
    """Return what a recording holds of a component by tick, each as an array."""
    return {int(tick): np.array(value) for tick, value in zip(*column(path, entity, component), strict=True)}


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
    """The log holds every birth, death, bite and gift, in words that name who it was."""
    witness, path = Witness(), tmp_path / "recording.rrd"
    env = live(village(), witness, rerun_observer(path, every=10), ticks=100)
    expected = []
    for before, state, tick in zip(witness.states, witness.states[1:], witness.ticks[1:], strict=False):
        name = [f"{'prey' if slot < 16 else 'predator'}_{state.serial[slot]}" for slot in range(env.size)]
        for slot in range(env.size):
            if tick.born[slot]:
                parent = tick.parent[slot]
                came = f"born, child of {name[parent]}" if parent >= 0 else "arrived"
                expected.append((state.tick, f"{name[slot]} {came}"))
            if tick.died[slot]:
                killer = name[tick.killer[slot]] if tick.killer[slot] >= 0 else "nobody"
                death = census.DEATHS[ecology.state.CAUSES[state.cause[slot]]].format(need="", killer=killer)
                expected.append((state.tick, f"{name[slot]} {death}"))
            if state.bit[slot] >= 0:
                expected.append((state.tick, f"{name[slot]} bit {name[state.bit[slot]]}"))
            if state.gave[slot] >= 0 and state.gave[slot] != before.gave[slot]:
                expected.append((state.tick, f"{name[slot]} gave to {name[state.gave[slot]]}"))
    seen = []
    for species in env.groups:
        ticks, texts = column(path, f"/events/{species}", "TextLog:text")
        told_at = [text[0].split("  ", 1) for text in texts]
        assert [at for at, _ in told_at] == [f"{tick:,}" for tick in ticks]  # words tell their tick
        seen += [(int(tick), text) for tick, (_, text) in zip(ticks, told_at, strict=True)]
    meals = (" ate ", " slept", "focus:")
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


def test_a_death_is_told_with_its_need_and_its_killer():
    """The event log says which need was fatal, and who bit; the place of the killer is known."""
    food = ecology.Need(name="food", set_point=2.0, decay=1.0, bounds=(0.0, 4.0), lethal=True)
    calm = ecology.Need(name="calm", set_point=1.0)
    prey = {"needs": (calm, food)}
    scenario = square(
        kind("wolf", ecology.bite("wounded", reach=1.0, damage={"food": 1.0}), position=(2.0, 2.0)),
        kind("fox", ecology.bite("killed", reach=1.0), position=(6.0, 6.0)),
        kind("wounded", position=(2.0, 2.5), **prey),
        kind("killed", position=(6.0, 6.5), **prey),
        kind("starved", position=(4.0, 4.0), **prey),
    )
    env = start(scenario, internal=[[2.0, 0.0], [2.0, 0.0], [1.0, 1.5], [1.0, 2.0], [1.0, 0.5]])
    seen = census.Census(env)
    tick = env.step_arrays(ask(env, wolf="bite_wounded", fox="bite_killed"))
    (deaths,) = (event for event in seen.watch(env.state_view, tick) if event.kind == "died")
    assert [census.words(scenario, tuple(env.groups.values()), deaths, i) for i in range(3)] == [
        "wounded_2 died of food, bitten to death by wolf_0",
        "killed_3 died, eaten by fox_1",
        "starved_4 died of food, beyond its bounds",
    ]
    assert deaths.other_place.tolist() == [[2.0, 2.0], [6.0, 6.0], [4.0, 4.0]]


def test_populations_are_counted(tmp_path):
    """Numbers, births and deaths, drives, stocks, measures, ages and couplings are those of the world."""
    witness, path = Witness(), tmp_path / "recording.rrd"
    env = live(village(), witness, rerun_observer(path, every=5), ticks=100)
    blocks = [group.slots for group in env.groups.values()]
    counts, flow, drive = (told(path, f"/population/{word}") for word in ("count", "flow", "drive"))
    stocks, measures = (told(path, f"/population/{word}") for word in ("stocks", "measures"))
    for tick in (0, 5, 50, 100):
        state = witness.states[tick]
        alive = [np.flatnonzero(state.alive[rows]) + rows.start for rows in blocks]
        assert counts[tick].tolist() == [len(slots) for slots in alive]
        spread = [
            (m, m - s, m + s) for m, s in ((state.drive[a].mean(), state.drive[a].std()) for a in alive if len(a))
        ]
        assert drive[tick][np.isfinite(drive[tick])] == pytest.approx(np.ravel(spread), abs=1e-5)
        assert stocks[tick] == pytest.approx(state.stock.sum())
        assert measures[tick] == pytest.approx(state.alive.sum() / 25.0)
        past = witness.ticks[1 : tick + 1]
        born, died = ([sum(getattr(t, w)[rows].sum() for t in past) for rows in blocks] for w in ("born", "died"))
        assert flow[tick].tolist() == [*born, *died]
    ages = told(path, "/population/ages/prey", "BarChart:values")
    assert ages.keys() == {0, 100}
    entities = {chunk.entity_path for chunk in _chunks(path)}
    assert "/population/coupling/prey" in entities
    assert "/population/coupling/predator" not in entities
    weight, others = env.coupling("prey")
    state = env.state_view
    assert np.array_equal(weight > 0, state.alive[:16, None] & state.alive[others])


def _chunks(path):
    from rerun.chunk import RrdReader

    return RrdReader(str(path)).stream()


def test_a_focus_is_who_was_asked_for():
    """An agent, once it lives; a species first; the hungriest; and nobody who cannot be."""
    env = Ecology(village())
    env.reset_arrays(3)
    state = env.state_view
    focus = census.Focus.of(env, ["prey_4", "predator"])
    focus.look(state)
    assert (focus.slots["prey"], focus.name("prey"), focus.first) == (4, "prey_4", "prey")
    assert focus.name("predator") == "predator_12"
    drive = np.linspace(0.0, 1.0, env.size) % 0.6
    state = dataclasses.replace(state, own_drive=drive)
    focus = census.Focus.of(env, ["hungriest"])
    focus.look(state)
    assert focus.slots["prey"] == int(np.argmax(np.where(state.alive[:16], drive[:16], -1)))
    state.alive = np.zeros(env.size, bool)
    assert set(focus.look(state)) == {"prey", "predator"}
    assert focus.slots == {"prey": -1, "predator": -1}
    for wrong in ("prey_x", "wolf_1", "wolf", "hungry"):
        with pytest.raises(EcologyError, match=wrong):
            census.Focus.of(env, [wrong])


@pytest.mark.parametrize("name", ["hjb", "algorithm1"])
def test_a_decision_is_the_one_that_is_taken(name):
    """The movement of least score among those open is the one that the learner takes; the sum is a sum."""
    env = Ecology(scenarios.load("paper"))
    tick = env.reset_arrays(1)
    minds = {"agent": agents.make(name, env.groups["agent"], np.random.SeedSequence(2), {})}
    mind = minds["agent"]
    tick = advance(env, minds, tick, 600)
    mind.evaluating(0.0)
    mind.follow([0])
    told = None
    for _ in range(60):
        zeta, before = tick.observations["agent"], mind.decisions[0]
        action = mind.act(zeta, tick.masks["agent"])
        if mind.decisions[0] > before:
            told = mind.decision(0)
            assert mind.execution.movement[0] == np.where(told.open, told.score, np.inf).argmin() == told.taken
            assert told.total == pytest.approx(told.next_drive + told.slope)
            assert told.value == pytest.approx(float(mind.deviation(0, zeta)[0]))
        tick = env.step_arrays(action)
    assert told is not None
    error = told.error
    assert error.shape == (len(env.groups["agent"].layout.names),)
    known = error[np.isfinite(error)]
    assert (known >= 0).all()
    assert known.size or name == "algorithm1"  # which keeps too little to know


def choice(**words):
    """Return a decision between a rest, a walk that is closed, and a meal."""
    numbers = np.arange(3.0)
    usual = {
        "options": ("rest", "walk", "eat"), "open": np.array([True, False, True]), "next_drive": numbers,
        "slope": numbers + 1, "score": numbers + 3, "taken": 0, "explored": False, "learned": True, "value": 2.5,
        "gamma": 0.9, "error": np.full(14, 0.5),
    }  # fmt: skip
    return Decision(**{**usual, **words})


def test_a_decision_says_what_is_not_known():
    """A decision without learning, or looked at too late, is marked so; one without an end of its own has no length."""
    from ecology.observers.panels.decision import decision_text

    def head(**words):
        return decision_text(census.Choice(4_011, 4011.0, "agent_0", choice(**words))).splitlines()[0]

    assert head(age=30) == "**agent_0**: **rest**, chosen at 3,981, tick 30; -ln(γ) J = 2.500"
    assert head(age=1, length=40, learned=False).endswith(
        "chosen at 4,010, tick 1 of 40; **nothing learned yet**; -ln(γ) J = 2.500"
    )
    assert "not in focus when it chose" in head(age=2, recalled=True, explored=None)
    assert "explored" not in head(age=2, recalled=True, explored=None)


@pytest.mark.parametrize("name", ["hjb", "algorithm1", "lean"])
def test_a_decision_is_held_until_the_next_one(name):
    """The one that is shown is what the agent does, from its first tick to its last, with the scores it had then."""
    env = Ecology(scenarios.load("paper"))
    mind = agents.make(name, env.groups["agent"], np.random.SeedSequence(2), {})
    tick, names = env.reset_arrays(1), env.groups["agent"].actions
    assert mind.decision(0) is None
    mind.follow([0])
    compared, score_all = [], mind._scores
    mind._scores = lambda *words: compared.append(score_all(*words)) or compared[-1]
    explored, kept, taken = 0, None, 0
    for t in range(600):
        before = mind.decisions[0]
        compared.clear()
        tick = advance(env, {"agent": mind}, tick, 1)
        shown = mind.decision(0)
        if shown.age == 1:
            assert mind.decisions[0] > before
            if compared:  # else it explored
                np.testing.assert_array_equal(shown.score[shown.open], compared[0][0][shown.open])
            kept, made = shown, t
            explored += shown.explored
            taken += shown.taken == np.where(shown.open, shown.score, np.inf).argmin()
            assert shown.explored or shown.taken == np.where(shown.open, shown.score, np.inf).argmin()
        assert shown.age == t - made + 1
        assert shown.score is kept.score
        assert shown.taken == mind.execution.movement[0]
        assert names[tick.action[0]] in shown.options[shown.taken]
        assert shown.length is None or shown.age <= shown.length
    assert 0 < explored < mind.decisions[0]
    assert shown.learned
    other = agents.make(name, env.groups["agent"], np.random.SeedSequence(2), {})
    other.restore(*mind.state())
    recalled = other.decision(0)
    assert recalled.recalled
    assert recalled.explored is None
    assert recalled.taken == mind.execution.movement[0]


def test_following_changes_no_life():
    """Agents whose decisions are kept live as the others do, bit for bit, births and deaths included."""
    ends = []
    for followed in ([], [0, 3], range(16)):
        env = Ecology(village())
        tick = env.reset_arrays(3)
        minds = {n: agents.make("lean", g, np.random.SeedSequence(4), {"memory": 50, "warm_up": 4, "update_every": 1.0})
                 for n, g in env.groups.items()}  # fmt: skip
        minds["prey"].follow(followed)
        advance(env, minds, tick, 120)
        assert minds["prey"].decision(3 if followed else 0) is None or minds["prey"].decision(3).options
        ends.append((env.snapshot()[0], minds["prey"].state()[0]))
    for world, mind in ends[1:]:
        for before, after in ((ends[0][0], world), (ends[0][1], mind)):
            for key, array in before.items():
                np.testing.assert_array_equal(array, after[key], err_msg=key)


def test_shares_of_the_drive_add_up():
    """The shares of the needs add up to the own drive; one that is not regulated has none."""
    from ecology.observers.panels.shares import drive_shares

    species, x = one().species[0], np.array([[0.1, -0.3, 0.2, 0.0, 0.1, 0.4], np.full(6, np.nan)])
    target = np.array([need.set_point for need in species.needs])
    shares = drive_shares(species, x)
    assert np.isnan(shares[1]).all()
    assert shares[0].sum() == pytest.approx((species.drive_epsilon + 0.31) ** 0.5)
    assert shares[0] / shares[0].sum() == pytest.approx(np.array([0.01, 0.09, 0.04, 0.0, 0.01, 0.16]) / 0.31)
    assert (drive_shares(species, np.zeros((1, len(target)))) == 0).all()


def test_a_decision_is_recorded(tmp_path):
    """What the focus weighed is in the recording by movement, what is closed marked so, and J beside what was met."""

    class Weighing(Wanderer):
        decides, ticks = True, 0

        def deviation(self, slot, zeta):
            return np.full(len(zeta), 2.5)

        def learn(self, transition):
            self.ticks += 1

        def decision(self, slot):
            return choice(age=(self.ticks - 2) % 7 + 1, length=7, taken=2, explored=self.ticks < 9)

    witness, path = Witness(), tmp_path / "recording.rrd"
    live(one(), witness, rerun_observer(path, every=4), mind=Weighing)
    assert told(path, "/focus/agent/decision", "total")[8].tolist() == [1.0, 3.0, 5.0]
    assert told(path, "/focus/agent/decision", "taken")[8].tolist() == [2]
    texts = {tick: text[0] for tick, text in told(path, "/focus/agent/decision", "TextDocument:text").items()}
    assert sorted(texts)[:6] == [2, 4, 8, 9, 12, 16]  # every sample, and every tick at which it decided
    head, *table = texts[4].splitlines()
    assert head == "**agent_0**: **eat**, chosen at 1, tick 3 of 7; **explored**; -ln(γ) J = 2.500"
    assert [line.split(" | ")[0] for line in table[-3:]] == ["| rest", "| **▶ eat**", "| ~~walk~~ closed"]
    assert texts[12].startswith("**agent_0**: **eat**, chosen at 8, tick 4 of 7; -ln(γ) J = 2.500\n")
    assert told(path, "/learning/agent/J")[8] == 2.5
    met = told(path, "/learning/agent/met")
    weight = 0.9 ** np.arange(1, 30)  # up to 5 %
    after = [s.drive[0] for s in witness.states[9:38]]
    assert met[8] == pytest.approx(weight @ after / weight.sum())
    assert max(met) <= TICKS - 29


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


def test_a_film_is_made_of_what_was_recorded(tmp_path, monkeypatch):
    """Frames are the recorded ticks; a film is a new gif of them, or an mp4 where ffmpeg is installed."""
    from PIL import Image

    from ecology.observers import film, readback

    witness, path = Witness(), tmp_path / "recording.rrd"
    env = live(village(), witness, rerun_observer(path, every=5), ticks=60)
    frames = readback.frames(tmp_path, env.scenario, 20, 60)
    assert [f.tick for f in frames] == list(range(20, 61, 5))
    state = witness.states[40]
    shown = frames[4]
    assert shown.time == state.time
    np.testing.assert_allclose(shown.position[state.alive], state.position[state.alive], atol=1e-6)
    assert np.isnan(shown.position[~state.alive]).all()
    np.testing.assert_allclose(shown.patches, state.resource_position, atol=1e-6)
    np.testing.assert_allclose(shown.full, state.stock / 3.0, atol=0.05)
    assert sum(len(f.marks["born"]) for f in frames) > 0
    target = tmp_path / "film.gif"
    film.film(env.scenario, frames, target, fps=10)
    with Image.open(target) as made:
        assert made.n_frames == len(frames)
        assert made.size == (800, 600)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for name, word in (
        ("film.gif", "exists"),
        ("film.avi", "gif"),
        ("film.mp4", "ffmpeg"),
        ("no/film.gif", "no folder"),
    ):
        with pytest.raises(EcologyError, match=word):
            film.film(env.scenario, frames, tmp_path / name)
    with pytest.raises(EcologyError, match="no recorded tick"):
        film.film(env.scenario, readback.frames(tmp_path, env.scenario, 61), tmp_path / "other.gif")
    assert not (tmp_path / "other.gif").exists()

    def full(self, target, **_):
        pathlib.Path(target).write_text("half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", full)
    with pytest.raises(EcologyError, match=r"other\.gif' cannot be written: .*No space left"):
        film.film(env.scenario, frames, tmp_path / "other.gif")
    assert not (tmp_path / "other.gif").exists()
    monkeypatch.setattr(ecology.errors.tempfile, "TemporaryFile", refused)
    with pytest.raises(EcologyError, match=r"cannot be written.*Read-only"):
        film.film(env.scenario, frames, tmp_path / "other.gif", tell=pytest.fail)


def refused(**_):
    """Refuse to make a file."""
    raise OSError(errno.EROFS, "Read-only file system")


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
    advance(env, minds, env.put(), 20, [again])
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
    assert not viewer.whole(path)
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
    viewer.resumed(path).write_bytes(b"")
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(6))}
    again = rerun_observer(path, every=10, resume=True)
    again.begin(env, minds)
    advance(env, minds, env.put(), 20, [again])
    again.end()
    assert {0, TICKS, TICKS + 10, TICKS + 20} <= set(column(path, "/world/agents/agent", "drive")[0].tolist())
    assert list(tmp_path.iterdir()) == [path]


def test_a_killed_recording_opens(tmp_path):
    """What was sent before a run was killed can be read, and is mended for the viewer."""
    path = tmp_path / "recording.rrd"
    code = (
        "import sys; sys.path.insert(0, 'tests')\n"
        "import os, time, test_observers as t\n"
        "from ecology.observers import rerun\n"
        "rerun.SECONDS_FILE = 0.0\n"
        f"observer = t.rerun_observer({str(path)!r}, every=1)\n"
        "t.live(t.one(), observer, close=False)\n"
        "time.sleep(1.0)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == -9
    assert not viewer.whole(path)
    path.write_bytes(path.read_bytes()[:-100])  # in the middle of a write
    mended = viewer.mended(path, tmp_path / "mended.rrd")
    ticks, _ = column(mended, "/world/agents/agent", "drive")
    assert len(ticks) > TICKS // 2

    env = live(one(), ticks=TICKS // 3)  # the checkpoint that it goes on from
    minds = {"agent": Wanderer(env.groups["agent"], np.random.SeedSequence(6))}
    again = rerun_observer(path, every=1, resume=True)
    again.begin(env, minds)
    before = list(range(TICKS // 3 + 1))
    assert column(path, "/world/agents/agent", "drive")[0].tolist() == before
    advance(env, minds, env.put(), 5, [again])
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
                with viewer.complete(path) as source:
                    look(source)
            except EcologyError:
                refused += 1
    assert refused


def test_a_viewer_that_is_not_there_stops_nothing(tmp_path, caplog, monkeypatch):
    """A run that streams to nobody goes on at once, and says so once."""
    from ecology.observers import relay

    monkeypatch.setattr(relay, "PATIENCE", 0.5)
    url = f"rerun+http://127.0.0.1:{viewer.free_port('127.0.0.1', 0)}/proxy"
    with caplog.at_level(logging.WARNING, "ecology"):
        live(one(), rerun_observer(every=1, connect=url))
    assert len([r for r in caplog.records if url in r.getMessage()]) == 1


@pytest.mark.parametrize("name", scenarios.names())
def test_every_scenario_can_be_watched(tmp_path, name):
    """Nothing in a scenario that ships is refused by those who record it."""
    path = tmp_path / "metrics.parquet"
    blind = rerun_observer(tmp_path / "recording.rrd", every=2)
    live(scenarios.load(name), Recorder(path, every=2), blind, mind=Blind, ticks=10)
    assert set(read(path)["tick"].to_pylist()) == {2, 4, 6, 8, 10}


def test_bad_input_is_refused(tmp_path):
    """What cannot be watched is said before the run starts."""
    import socket

    for wrong in ({"every": 0}, {"maps_every": -1}, {"connect": "127.0.0.1:9876"}):
        with pytest.raises(EcologyError):
            rerun_observer(**wrong)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(EcologyError, match="cannot serve at"):
            rerun_observer(serve=taken.getsockname())
    with pytest.raises(EcologyError, match="no agent 'agent_9'"):
        live(one(), rerun_observer(tmp_path / "r.rrd", focus=["agent_9"]))


def test_view_says_what_is_wrong(tmp_path, monkeypatch):
    """A missing, foreign or unreadable recording, and a machine without a screen, are told in one error."""
    with pytest.raises(EcologyError, match="no recording at"):
        viewer.view(tmp_path)
    path = tmp_path / "recording.rrd"
    path.write_text("something else")
    with pytest.raises(EcologyError, match="not a Rerun recording"):
        viewer.view(tmp_path)
    path.write_bytes(b"RRF2" + bytes(60))
    assert not viewer.joined([path], path)
    monkeypatch.setenv("DISPLAY", ":0")
    with pytest.raises(EcologyError, match="damaged"):
        viewer.view(tmp_path)
    if sys.platform.startswith("linux"):
        monkeypatch.delenv("DISPLAY")
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        with pytest.raises(EcologyError, match="no screen"):
            viewer.view(tmp_path)


class Drawing:
    """A viewer's client that draws, and reports what it is told to."""

    def __init__(self, reports):
        self.reports, self.at = reports, []

    def connect(self, url):
        return self

    def open(self, path):
        assert viewer.whole(pathlib.Path(path))

    def set_time(self, timeline, *, sequence, play_state):
        self.at.append(sequence)

    def get_state(self):
        return types.SimpleNamespace(views=[types.SimpleNamespace(reports=self.reports)])

    def save_screenshot(self, path):
        from PIL import Image

        Image.new("RGB", (3200, 1800)).save(path)


def test_a_screenshot_is_a_new_file(tmp_path, monkeypatch):
    """It is drawn without the viewer's bar; a file that is there, or a panel that is not drawn, is an error."""
    from PIL import Image

    screenshot = pytest.importorskip("ecology.observers.screenshot")
    live(one(), rerun_observer(tmp_path / "recording.rrd", every=10))
    picture_, client = tmp_path / "shown.png", Drawing([])
    monkeypatch.setattr(screenshot, "ViewerClient", client)
    monkeypatch.setattr(screenshot, "SETTLING", 0.0)
    process = types.SimpleNamespace(poll=lambda: None)
    monkeypatch.setattr(screenshot, "viewer_process", lambda *_: contextlib.nullcontext(process))
    screenshot.screenshot(tmp_path, picture_, tick=20)
    assert client.at == [20]
    with Image.open(picture_) as shown:
        assert shown.size == (3200, 1800 - 2 * screenshot.BAR)
    for name, word in (("shown.png", "exists"), ("shown.jpg", r"\.png"), ("nowhere/shown.png", "no folder")):
        with pytest.raises(EcologyError, match=word):
            screenshot.screenshot(tmp_path, tmp_path / name)
    for tick in (TICKS + 1, 99_999):
        with pytest.raises(EcologyError, match=f"0 to {TICKS}; got {tick}"):
            screenshot.screenshot(tmp_path, tmp_path / "other.png", tick=tick)
    screenshot.screenshot(tmp_path, tmp_path / "last.png", tick=TICKS)
    assert client.at == [20, TICKS]
    with monkeypatch.context() as patch:
        patch.setattr(ecology.errors.tempfile, "TemporaryFile", refused)
        with pytest.raises(EcologyError, match=r"cannot be written.*Read-only"):
            screenshot.screenshot(tmp_path, tmp_path / "other.png")

    def full(self, target, **_):
        if pathlib.Path(target).name == "other.png" and pathlib.Path(target).parent == tmp_path:
            pathlib.Path(target).write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")
        saved(self, target)

    saved = Image.Image.save
    with monkeypatch.context() as patch:
        patch.setattr(Image.Image, "save", full)
        with pytest.raises(EcologyError, match=r"other\.png' cannot be written: .*No space left"):
            screenshot.screenshot(tmp_path, tmp_path / "other.png")
    assert not (tmp_path / "other.png").exists()
    client.reports.append("no shader")
    with pytest.raises(EcologyError, match="no shader"):
        screenshot.screenshot(tmp_path, tmp_path / "other.png")
    process.poll = lambda: 1
    with pytest.raises(EcologyError, match="no viewer could be started"):
        screenshot.screenshot(tmp_path, tmp_path / "other.png")
    assert not (tmp_path / "other.png").exists()


def test_a_legend_shows_marks_as_they_are_drawn():
    """Births are rings and deaths crosses without a line; bites and gifts are lines."""
    handles = {handle.get_label(): handle for handle in picture.Picture(village())._handles()}
    signs = {word: (handle.get_marker(), handle.get_linestyle()) for word, handle in handles.items() if ":" in word}
    assert signs == {
        "ring: born": ("o", "None"),
        "cross: died": ("x", "None"),
        "red line: bite": ("None", "-"),
        "green line: gift": ("None", "-"),
    }


@pytest.mark.parametrize("world", [one, many, village])
def test_a_picture_shows_the_world(world):
    """`draw` returns pixels, and others once an agent has moved."""
    env = Ecology(world(), render_mode="rgb_array")
    env.reset_arrays(seed=0)
    before = env.render()
    assert before.shape == (600, 800, 3)
    assert before.dtype == np.uint8
    env.put(position=scatter(env.scenario.arena, 0.2, env.size, np.random.default_rng(1)))
    after = picture.draw(env.scenario, env.state_view)
    assert (before != after).any()
    assert np.array_equal(after, env.render())
