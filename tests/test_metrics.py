"""Metrics: what a recorder writes is what was, and can be continued and repaired."""
# ruff: noqa: D102

# ruff: noqa: D102

import dataclasses
import errno
import pathlib

import numpy as np
import pyarrow.parquet as pq
import pytest
from observed import (
    TICKS,
    Blind,
    Wanderer,
    Witness,
    live,
    many,
    one,
    strict,  # noqa: F401  (a fixture)
    village,
)

from ecology import Ecology, EcologyError
from ecology.agents.loop import advance
from ecology.observers.recorder import Recorder, parts_of, read


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
