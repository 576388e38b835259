"""Those who watch: what they write is what was, and they change nothing."""

import dataclasses
import logging
import subprocess
import sys

import numpy as np
import pytest
from observed import (
    TICKS,
    Blind,
    Wanderer,
    Witness,
    choice,
    live,
    many,
    one,
    rerun_observer,
    strict,  # noqa: F401  (a fixture)
    told,
    village,
)
from worlds import ask, kind, square, start

import ecology
from ecology import Ecology, EcologyError, agents, scenarios
from ecology.agents.loop import advance
from ecology.observers import census, viewer
from ecology.observers.recorder import Recorder, read


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
    for tick in sorted(counts):  # the age structure is of this tick or of one shortly before
        assert max(kept for kept in ages if kept <= tick) >= 0.8 * tick - 5
    assert len(ages) < 0.7 * len(counts)
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


def test_a_decision_says_what_is_not_known():
    """A decision without learning, or looked at too late, is marked so; one without an end of its own has no length."""
    from ecology.observers.panels.decision import decision_text

    def head(**words):
        return decision_text(census.Choice(4_011, "agent_0", choice(**words))).splitlines()[0]

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
    with np.errstate(all="raise"):  # a body that is dead is no reason to warn
        assert np.isnan(drive_shares(dataclasses.replace(species, drive_exponent=2.0), x)[1]).all()


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
