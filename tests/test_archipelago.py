"""Archipelagos: the same bits wherever islands live, migrants that take all along, pools with known answers."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import hearing
from safetensors.numpy import load_file

import ecology
from ecology import Archipelago, EcologyError, Island, Migration, Pool, Trait, agents, scenarios
from ecology.agents import loop
from ecology.archipelago import as_island
from ecology.lab.cli import main
from ecology.lab.islands import run as runs
from ecology.lab.islands.exchange import draw_brood, draw_moves
from ecology.lab.islands.hosts import Host, LostError, ProcessHost
from ecology.lab.islands.island import Count, Travellers, join
from ecology.lab.runs.gate import Gate
from ecology.lab.runs.stopping import StoppedError

SEED = np.random.SeedSequence(5)
FILE = '''
from ecology import Archipelago, Island, Migration


def build(rate: float = 0.02, islands: int = 3, where: str = "ring", growth: float = 0.0005):
    """Return pools side by side."""
    pool = Island(scenario="commons", settings={"n": 8, "growth": growth, "learner.memory": 40}, learners=("lean",))
    going = Migration(species="agent", rate=rate, where=where)
    return Archipelago(name="isles", islands=(pool,) * islands, every=20.0, migrations=(going,), ticks=60)
'''


@pytest.fixture
def isles(tmp_path: Path) -> str:
    """Return the path of an archipelago of three pools of learners."""
    path = tmp_path / "isles.py"
    path.write_text(FILE)
    return str(path)


class Here:
    """A host in this process, which can be lost."""

    made = 0

    def __init__(self, folder: Path, lost_at: int = -1) -> None:
        self.host, self.calls, self.lost_at = Host(str(folder)), 0, lost_at

    def send(self, method: str, calls: Any) -> None:
        """Keep what is called."""
        self.calls += 1
        self.sent = method, calls

    def answer(self) -> Any:
        """Do it, or be lost."""
        if self.calls == self.lost_at:
            raise LostError
        return self.host.call(*self.sent)

    def close(self) -> None:
        """Let go of the folders."""
        for island in self.host._islands.values():
            island._stack.close()


def digest(folder: Path) -> list[str]:
    """Return a digest of the last checkpoint of every island."""
    found = []
    for island in sorted((folder / "islands").iterdir()):
        total = hashlib.sha256()
        for path in sorted((island / "checkpoint").glob("*.safetensors")):
            for name, array in sorted(load_file(path).items()):
                total.update(name.encode() + np.ascontiguousarray(array).tobytes())
        found.append(total.hexdigest())
    return found


def live(
    name: str, out: Path, hosts: int = 1, lost_at: int = -1, ticks: int | None = None, **changes: object
) -> runs.ArchipelagoRun:
    """Live an archipelago in this process; the first host is lost at its `lost_at`th call."""
    made: list[Here] = []

    def make(folder: Path) -> Here:
        made.append(Here(folder, -1 if made else lost_at))
        return made[-1]

    it = runs.start(name, changes, out, record=False, snapshot_every=40, keep_every=20, ticks=ticks)
    it.live(make, hosts)
    return it


@pytest.fixture
def whole(isles: str, tmp_path: Path) -> tuple[Path, list[str]]:
    """Return the folder of a run on one host, and its digest."""
    live(isles, tmp_path / "whole")
    return tmp_path / "whole", digest(tmp_path / "whole")


def test_islands_are_the_same_wherever_they_live(isles: str, whole: tuple[Path, list[str]], tmp_path: Path) -> None:
    """On three hosts, with a host lost in the middle, resumed half-way, and forked without a change: the same bits."""
    folder, same = whole
    it = live(isles, tmp_path / "three", hosts=3, lost_at=6)
    assert it.fleet is not None
    assert it.fleet.lost == 1
    live(isles, tmp_path / "half", ticks=40)
    runs.resume(tmp_path / "half", 60, Gate()).live(Here, 2)
    runs.fork(folder, 20, {}, tmp_path / "fork", None, Gate()).live(Here, 1)
    for name in ("three", "half", "fork"):
        assert digest(tmp_path / name) == same, name
    ledgers = [(tmp_path / name / runs.LEDGER).read_text() for name in ("whole", "three", "half")]
    assert len(set(ledgers)) == 1
    assert sum(len(json.loads(line)["migrants"]) for line in ledgers[0].splitlines()) > 0
    live(isles, tmp_path / "other", rate=0.05)
    assert digest(tmp_path / "other") != same


@pytest.mark.one_seed("the islands are lived by other processes")
def test_processes_live_the_same_life(isles: str, whole: tuple[Path, list[str]], tmp_path: Path) -> None:
    """A process that is killed after the first exchange, and one in its place, come to the same bits."""
    hosts: list[ProcessHost] = []

    def make(folder: Path) -> ProcessHost:
        hosts.append(ProcessHost(folder))
        return hosts[-1]

    def say(words: str) -> None:
        if words.startswith("tick 20") and len(hosts) == 1:
            hosts[0].process.kill()

    it = runs.start(isles, {}, tmp_path / "processes", record=False)
    assert it.live(make, 1, say)["hosts_lost"] == 1
    assert digest(tmp_path / "processes") == whole[1]


def test_every_island_and_all_of_them_are_recorded(isles: str, tmp_path: Path) -> None:
    """A resumed archipelago has one recording of the whole: a tile per island, and numbers at every stop."""
    from ecology.observers.readback import column, span

    it = runs.start(isles, {"islands": 2}, tmp_path / "out", record_every=20, snapshot_every=20, ticks=20)
    it.live(Here, 1)
    runs.resume(tmp_path / "out", 40, Gate()).live(Here, 1)
    for path in ("islands/0/recording.rrd", "islands/1/metrics.parquet"):
        assert (tmp_path / "out" / path).stat().st_size > 0
    recording = tmp_path / "out/recording.rrd"
    assert span(recording) == (0, 40)
    living = column(recording, "/population/islands/agent", "Scalars:scalars")
    assert list(living) == [0, 20, 40]
    assert living[40].tolist() == [8.0, 8.0]
    places = np.array(column(recording, "/world/agents/agent", "Points2D:positions")[40]).reshape(-1, 2)
    assert len(places) == 16
    tiles = np.floor(places / 1.25)
    assert np.unique(tiles, axis=0).tolist() == [[0.0, 0.0], [1.0, 0.0]]
    assert (places - 1.25 * tiles <= 1.0).all()


def test_a_host_that_always_ends_is_an_error(isles: str, tmp_path: Path) -> None:
    """It is started again a few times, and then the message says what to do."""
    it = runs.start(isles, {}, tmp_path / "out", record=False)
    with pytest.raises(EcologyError, match="ended 4 times"):
        it.live(lambda folder: Here(folder, 1), 1)


def test_a_signal_stops_all_islands_together(isles: str, tmp_path: Path, whole: tuple[Path, list[str]]) -> None:
    """What is resumed after it, that of a closed terminal where there is one, ends as what was never stopped."""
    signum = getattr(signal, "SIGHUP", signal.SIGTERM)
    it = runs.start(isles, {}, tmp_path / "out", record=False)
    with hearing(signum), pytest.raises(StoppedError):
        it.live(ProcessHost, 1, lambda words: signal.raise_signal(signum))
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["stopped_by"] == signum.name
    assert runs.common_tick(tmp_path / "out") == 20
    runs.resume(tmp_path / "out", None, Gate()).live(Here, 1)
    assert digest(tmp_path / "out") == whole[1]


# ---- what goes along -----------------------------------------------------------------------------


def two_worlds(learner: str, ticks: int = 60) -> list[tuple[ecology.Ecology, agents.base.Learner]]:
    """Return two worlds of learners that have lived."""
    found = []
    for number in range(2):
        told = {"number": number, "islands": 2, "species": ["agent"]}
        env = ecology.parallel_env(as_island(scenarios.load("commons", n=6, capacity=50.0), told))
        group = env.groups["agent"]
        settings = {"memory": 30} if learner == "lean" else {}
        mind = agents.make(learner, group, np.random.SeedSequence(number), settings)
        loop.run(env, {"agent": mind}, env.reset_arrays(number), ticks)
        found.append((env, mind))
    return found


@pytest.mark.parametrize("learner", ["lean", "qvalue"])
def test_a_migrant_takes_along_its_body_and_all_that_it_has_learned(learner: str) -> None:
    """Needs, age, serial, weights, optimiser and memory are there as they were; the accounts of both worlds close."""
    (here, mine), (there, theirs) = two_worlds(learner)
    leaving, gone = np.array([1, 4]), np.array([0, 2])
    before = {name: here.state_view.arrays()[name][leaving] for name in ("serial", "age", "internal")}
    learned = mine.pack(leaving)
    there.take_out(gone)
    _, bodies = here.take_out(leaving)
    assert here.state_view.alive.sum() == 4
    assert (here.state_view.serial[leaving] == -1).all()
    _, slots = there.bring_in("agent", bodies, np.random.default_rng(0))
    theirs.unpack(slots, learned)
    assert slots.tolist() == gone.tolist()
    for name, value in before.items():
        np.testing.assert_array_equal(there.state_view.arrays()[name][slots], value)
    after = theirs.pack(slots)
    assert after.keys() == learned.keys()
    for name, rows in learned.items():
        np.testing.assert_array_equal(after[name], rows, err_msg=name)
    for env in (here, there):
        s = env.state_view
        stored = 1.0 + s.ingested + s.received - s.given - s.metabolised - s.lost  # 1 at the start
        np.testing.assert_allclose(s.internal, stored, atol=1e-12)
    assert set(there.agents) == {f"agent_{n}" for n in (2, 8, *[3, 7, 9, 11])}


def test_serials_are_given_once_over_all_islands() -> None:
    """Islands number by turns; newborns after an arrival are numbered after it, and nobody has a number twice."""
    (here, _), (there, _) = two_worlds("qvalue", ticks=1)
    assert here.state_view.serial.tolist() == [0, 2, 4, 6, 8, 10]
    assert there.state_view.serial.tolist() == [1, 3, 5, 7, 9, 11]
    here.take_out(np.array([0, 1]))
    _, bodies = there.take_out(np.array([5]))
    here.bring_in("agent", bodies, np.random.default_rng(0))
    _, slots = here.breed("agent", np.array([9]), None, np.random.default_rng(1))
    assert here.state_view.serial[slots].tolist() == [12]
    assert here.state_view.parent[slots].tolist() == [9]
    with pytest.raises(EcologyError, match="1 agents of 'agent' arrive, and 0 slots are free"):
        here.breed("agent", np.array([9]), None, np.random.default_rng(1))


def test_memories_of_different_length_are_joined() -> None:
    """A group that arrives from two islands is as wide as the fullest memory, and each keeps its own rows."""
    parts = [
        Travellers("a", {"serial": np.arange(n)}, {"memory.zeta": np.ones((n, k, 2)), "age": np.arange(n)})
        for n, k in ((1, 3), (2, 5))
    ]
    group = join(parts)
    assert group.minds["memory.zeta"].shape == (3, 5, 2)
    assert group.minds["memory.zeta"].sum(axis=(1, 2)).tolist() == [6.0, 10.0, 10.0]
    assert group.bodies["serial"].tolist() == [0, 0, 1]


# ---- who goes where ------------------------------------------------------------------------------


def counts_of(alive: list[int], free: list[int]) -> list[Count]:
    """Return a census of islands; the drive of their agents falls with the slot, and age rises."""
    return [
        Count(np.arange(n), np.arange(n), -np.arange(n, dtype=float), np.arange(n, dtype=float), room, n)
        for n, room in zip(alive, free, strict=True)
    ]


def test_agents_leave_at_the_rate_and_to_where_it_says() -> None:
    """The share that leaves is 1 - exp(-rate x time); a ring leads on, all others alike, a matrix by its shares."""
    counts = counts_of([4000] * 4, [10_000] * 4)
    leaves = 1 - np.exp(-0.1)
    ring = draw_moves(Migration(species="a", rate=0.01), counts, 10.0, SEED)
    assert len(ring.to) == pytest.approx(16_000 * leaves, rel=0.1)  # 2.6 standard deviations are 0.07
    np.testing.assert_array_equal(ring.to, (ring.origin + 1) % 4)
    everywhere = draw_moves(Migration(species="a", rate=0.01, where="all"), counts, 10.0, SEED)
    assert (everywhere.to != everywhere.origin).all()
    shares = np.bincount(everywhere.to[everywhere.origin == 1], minlength=4) / (everywhere.origin == 1).sum()
    np.testing.assert_allclose(shares, [1 / 3, 0, 1 / 3, 1 / 3], atol=0.09)
    matrix = ((0.0, 0.9, 0.0, 0.1), (0.0,) * 4, (1.0, 0.0, 0.0, 0.0), (0.0,) * 4)
    some = draw_moves(Migration(species="a", rate=0.01, where=matrix), counts, 10.0, SEED)
    assert set(some.origin.tolist()) == {0, 2}
    assert (some.to[some.origin == 2] == 0).all()
    assert np.mean(some.to[some.origin == 0] == 1) == pytest.approx(0.9, abs=0.06)


@pytest.mark.parametrize(("who", "first"), [("least drive", 99), ("most drive", 0), ("oldest", 99), ("youngest", 0)])
def test_those_leave_first_that_it_says(who: str, first: int) -> None:
    """The agents that leave are the extreme ones, without a gap."""
    moves = draw_moves(Migration(species="a", rate=0.02, who=who), counts_of([100, 100], [100, 100]), 10.0, SEED)
    mine = np.sort(moves.slot[moves.origin == 0])
    assert first in mine
    assert np.ptp(mine) == len(mine) - 1


def test_nobody_arrives_where_there_is_no_room() -> None:
    """Whatever is free: arrivals are at most the free slots and those that others leave; nobody is lost."""
    rng = np.random.default_rng(3)
    for trial in range(200):
        islands = int(rng.integers(2, 6))
        counts = counts_of(rng.integers(0, 9, islands).tolist(), rng.integers(0, 3, islands).tolist())
        where = ("ring", "all")[trial % 2]
        moves = draw_moves(Migration(species="a", rate=0.2, where=where), counts, 3.0, np.random.SeedSequence(trial))
        leave, come = (np.bincount(at, minlength=islands) for at in (moves.origin, moves.to))
        assert (come <= np.array([c.free for c in counts]) + leave).all()
        assert (leave <= [len(c.slots) for c in counts]).all()
        assert len(set(zip(moves.origin.tolist(), moves.slot.tolist(), strict=True))) == len(moves.slot)


# ---- the pool ------------------------------------------------------------------------------------


def test_a_pool_breeds_by_fitness_kinship_and_heredity() -> None:
    """Parents are drawn by fitness, pairs of a group are related by r, and the Price equation closes."""
    trait = Trait(name="care", of="none", bounds=(0.0, 1.0), mutation=0.01)
    counts = counts_of([4] * 500, [0] * 500)
    rng = np.random.default_rng(1)
    for i, count in enumerate(counts):
        count.serial = np.arange(4) + 4 * i
        count.fitness, count.trait = np.array([0.0, 1.0, 1.0, 2.0]), rng.random((4, 1))
    for r in (0.0, 0.25, 1.0):
        brood = draw_brood(Pool(species="a", generation=1.0, relatedness=r), (trait,), counts, SEED)
        parents = np.array(brood.parents)  # (500, 4)
        share = np.bincount(parents.ravel() % 4, minlength=4) / parents.size
        np.testing.assert_allclose(share, [0, 0.25, 0.25, 0.5], atol=0.09 if r == 1 else 0.05)
        pairs = [np.mean(parents[:, a] == parents[:, b]) for a in range(4) for b in range(a)]
        assert np.mean(pairs) == pytest.approx(r, abs=0.06)
        told = brood.report["traits"]["care"]
        assert told["selection"] + told["transmission"] == pytest.approx(told["change"], abs=1e-12)
        assert told["next"] - told["mean"] == pytest.approx(told["change"], abs=1e-12)
    empty = draw_brood(Pool(species="a", generation=1.0), (trait,), counts_of_nobody(3), SEED)
    assert [len(each) for each in empty.parents] == [0, 0, 0]


def counts_of_nobody(islands: int) -> list[Count]:
    """Return the census of islands on which nobody is left."""
    found = counts_of([0] * islands, [4] * islands)
    for count in found:
        count.fitness, count.trait, count.founders = np.zeros(0), np.zeros((0, 1)), 4
    return found


def test_groups_breed_from_one_pool(tmp_path: Path) -> None:
    """In `kin` every generation is as large as the first, of newborns alone, whose parents lived on any island."""
    live("kin", tmp_path / "kin", hosts=2, ticks=20, groups=6, relatedness=0.0)
    lines = [json.loads(line) for line in (tmp_path / "kin" / runs.LEDGER).read_text().splitlines()]
    assert [line["tick"] for line in lines] == [5, 10, 15, 20]
    assert all(line["born"] == 24 for line in lines)
    states = [load_file(tmp_path / f"kin/islands/{i}/checkpoint/world.safetensors") for i in range(6)]
    assert all((state["age"] == 0).all() and state["alive"].all() for state in states)
    parents = np.concatenate([state["parent"] for state in states])
    born_on = np.repeat(np.arange(6), 4)
    assert (parents % 6 != born_on).any()  # serials go round the islands
    serials = np.concatenate([state["serial"] for state in states])
    assert len(set(serials.tolist())) == 24


# ---- what is refused -----------------------------------------------------------------------------

ONE = (Island(scenario="commons"),)


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: Archipelago(name="a", islands=()), "at least one island"),
        (lambda: Migration(species="a", rate=-1.0), "rate is 0 or more, got -1.0"),
        (lambda: Migration(species="a", rate=1.0, where="rign"), "Did you mean 'ring'"),
        (lambda: Migration(species="a", rate=1.0, who="fittest"), "who is one of random"),
        (
            lambda: Archipelago(
                name="a",
                islands=ONE * 2,
                migrations=(Migration(species="a", rate=1.0, where=((0.0, 0.5), (1.0, 0.0))),),
            ),
            "row 0 of the matrix",
        ),
        (
            lambda: Archipelago(
                name="a", islands=ONE * 2, migrations=(Migration(species="a", rate=1.0, where=((0.0, 1.0),)),)
            ),
            "the matrix is 2 by 2",
        ),
        (lambda: Pool(species="a", generation=0.0), "generation is a positive time"),
        (lambda: Pool(species="a", generation=1.0, relatedness=2.0), "relatedness is from 0 to 1"),
        (
            lambda: Archipelago(
                name="a",
                islands=ONE,
                migrations=(Migration(species="a", rate=1.0),),
                pool=Pool(species="a", generation=5.0),
            ),
            "it does one of both",
        ),
    ],
)
def test_what_is_no_archipelago_is_refused(build: Callable[[], object], says: str) -> None:
    """Every mistake is one message with the rule and the value."""
    with pytest.raises(EcologyError, match=re.escape(says)):
        build()


def test_worlds_that_do_not_fit_are_refused(isles: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Unknown species, other learners, a world in the place of an archipelago, an island alone: exit code 2."""
    bad = tmp_path / "bad.py"
    for change, says in (
        (('species="agent"', 'species="agnet"'), "Did you mean 'agent'"),
        (("(pool,) * islands", '(pool, Island(scenario="commons"))'), "different learners"),
        (("(pool,) * islands", '(pool, Island(scenario="seasons"))'), "different learners or learner settings"),
        (('scenario="commons"', 'scenario="comons"'), "Did you mean 'commons'"),
    ):
        bad.write_text(FILE.replace(*change))
        with pytest.raises(EcologyError, match=says):
            runs.start(str(bad), {}, tmp_path / "none")
    live(isles, tmp_path / "out", ticks=20)
    config = (tmp_path / "out/islands/1/config.toml").read_text()
    (tmp_path / "tampered.toml").write_text(config.replace("number = 1", "number = 7"))
    for words, says in (
        (["run", isles], "run it with: ecology archipelago"),
        (["archipelago", "commons"], "one world is run with: ecology run commons"),
        (["archipelago"], "name an archipelago"),
        (["archipelago", isles, "--out", str(tmp_path / "out")], "already holds a run"),
        (["archipelago", "--resume", str(tmp_path / "out")], "reached its last tick"),
        (["archipelago", "--fork", str(tmp_path / "out"), "--at", "7"], "common snapshots at tick 0, 20, not at 7"),
        (["archipelago", "--fork", str(tmp_path / "out")], "go together"),
        (["archipelago", "--resume", str(tmp_path)], "holds no archipelago"),
        (["run", "--resume", str(tmp_path / "out/islands/1")], "an island of an archipelago"),
        (["run", "--config", str(tmp_path / "tampered.toml")], "[island] holds the number"),
    ):
        with pytest.raises(SystemExit) as left:
            main(words)
        assert left.value.code == 2
        assert says in capsys.readouterr().err.replace("\n", " ")


def test_an_island_is_a_world_with_serials_of_its_own() -> None:
    """Species that migrate can have newcomers; worlds that are no islands stay as they are."""
    world = scenarios.load("commons", n=3)
    assert as_island(world, {}) is world
    island = as_island(world, {"number": 2, "islands": 5, "species": ["agent"]})
    assert island.numbering == (2, 5)
    assert island.species[0].grows
    with pytest.raises(EcologyError, match=r"0 <= first < step, got \(5, 5\)"):
        dataclasses.replace(world, numbering=(5, 5))
