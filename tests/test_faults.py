"""An exception in a user's own code: one message that names the place, and a run that is kept and gone on with."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from same_end import same_end

from ecology import agents, faults, physiology
from ecology.agents import checkpoint
from ecology.agents.base import Learner
from ecology.lab.cli import main

WORLD = """
import math
from ecology import Arena, Need, Resource, Scenario, Species, consume, move, rest

def share(world, parts):
    return 1 / parts

def rule(world, rng):
    outcome = world.no_effect()
    outcome.received[:] = 0.001 * rng.random()
    if world.state.tick == FAILS:
        share(world, 0)  # MARK
    return outcome

def crowd(state):
    return [1.0, 2.0][state.tick == FAILS and "two"] if state.tick == FAILS else 1.0

def build(decay=0.01, ticks=60):
    BUILD
    need = Need(name="food", set_point=2.0, decay=decay, noise=0.01, bounds=(0.0, 4.0))
    agent = Species(name="agent", needs=(need,), count=3, learner="random", position=(1.0, 1.0),
                    actions=(rest(), move("walk", 0.1), consume("berries", {"food": 0.1})))
    return Scenario(name="world", arena=Arena(vertices=((0, 0), (2, 0), (2, 2), (0, 2))), species=(agent,), rule=RULE,
                    measures=MEASURES, resources=(Resource(name="berries", position=(1.0, 1.0)),), ticks=ticks)
"""
WHOLE = {"FAILS": "-1", "BUILD": "pass", "RULE": "rule", "MEASURES": "{}"}
Command = Callable[..., tuple[int, str, str]]


def write(**words: str) -> None:
    """Write world.py, which is whole but for `words`."""
    text = WORLD
    for key, word in {**WHOLE, **words}.items():
        text = text.replace(key, word)
    Path("world.py").write_text(text)


def line_of(words: str) -> int:
    """Return the number of the line of world.py that holds `words`."""
    return 1 + [words in line for line in Path("world.py").read_text().splitlines()].index(True)


@pytest.fixture
def ecology(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Return the command line in a folder that holds world.py: words -> exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(agents, "LEARNERS", {**agents.LEARNERS, "mine": (__name__, "Mine", None, "")})
    write()

    def type_(*words: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as left:
            main(words)
        return int(left.value.code or 0), *capsys.readouterr()

    return type_


class Mine(Learner):
    """A learner of a user's own, which fails where it is told to."""

    fails = ""

    def __init__(self, group, seed):
        super().__init__(group, seed)
        self.ticks = 0
        self.fail("init")

    def fail(self, where):
        """Fail where that is meant, once 25 ticks are lived."""
        if self.fails == where and self.ticks in (0, 25):
            raise LookupError(f"no {where}")

    def act(self, observations, masks):
        """Rest."""
        if self.fails == "few":
            return np.zeros(2)
        if self.ticks:
            self.fail("act")
        return np.zeros(self.size, np.int64)

    def learn(self, transition):
        """Count."""
        self.ticks += 1
        self.fail("learn")

    def report(self):
        """Report nothing."""
        if self.ticks:
            self.fail("report")
        return {}

    def state(self):
        """Return nothing."""
        if self.ticks:
            self.fail("state")
        return {}, {"ticks": self.ticks, **super().state()[1]}

    def restore(self, arrays, values):
        """Become what it was."""
        self.fail("restore")
        super().restore(arrays, values)
        self.ticks = values["ticks"]


def test_a_rule_that_fails_is_named_and_the_run_goes_on_once_it_is_mended(ecology: Command) -> None:
    """File, line, function and exception; the folder is readable; resumed, the life is that of the mended rule."""
    write(FAILS="25")
    code, _, err = ecology("run", "world.py", "--out", "out", "--quiet", "--record", "every=1")
    path, line = Path("world.py").absolute(), line_of("return 1 / parts")
    assert code == 2
    message = err.splitlines()[-1]
    assert message == (
        f"ecology: after 25 ticks: {path}, line {line}, in share: ZeroDivisionError: division by zero. The run up to "
        "there is kept in out; once this is fixed, resume from tick 0 with: ecology run --resume out "
        "--source current"
    )
    assert f'File "{path}", line {line_of("# MARK")}, in rule\n    share(world, 0)  # MARK\n' in err
    assert "env.py" not in err  # the frames from the rule on, and none of the project's above it
    assert "Traceback" not in err
    summary = json.loads(Path("out/summary.json").read_text())
    assert (summary["stopped_at"], summary["stopped_by"]) == (
        25,
        f"{path}, line {line}, in share: ZeroDivisionError: division by zero",
    )
    assert pq.read_table("out/metrics.parquet").num_rows == 25 * 3
    write()
    assert ecology("run", "--resume", "out", "--source", "current", "--quiet") == (0, "", "")
    assert ecology("run", "world.py", "--out", "whole", "--quiet", "--record", "every=1") == (0, "", "")
    same_end("out", "whole")
    assert pq.read_table("out/metrics.parquet").equals(pq.read_table("whole/metrics.parquet"))


def test_it_goes_on_from_the_last_checkpoint(ecology: Command) -> None:
    """Where checkpoints were written on the way, the last of them is named and gone on from."""
    write(FAILS="25")
    Path("config.toml").write_text('scenario = "world.py"\ncheckpoint_every = 10')
    code, _, err = ecology("run", "--config", "config.toml", "--trust", "--out", "out", "--no-record", "--quiet")
    assert code == 2
    assert "resume from tick 20 with" in err
    assert checkpoint.read(Path("out/checkpoint"))["tally"][1]["tick"] == 20
    code, _, err = ecology("run", "--resume", "out", "--quiet")  # not mended
    assert (code, "after 25 ticks" in err, "from tick 20" in err) == (2, True, True)
    write()
    assert ecology("run", "--resume", "out", "--source", "current", "--quiet")[0] == 0


@pytest.mark.parametrize("record", ["--record", "--no-record"])
def test_an_exception_of_files_is_the_rules_own(ecology: Command, record: str) -> None:
    """A rule that cannot open a file of its own is not taken for a run folder that cannot be written."""
    write(RULE='lambda world, rng: open("nowhere.csv")')
    code, _, err = ecology("run", "world.py", "--out", "out", "--quiet", record)
    assert code == 2
    assert "in <lambda>: FileNotFoundError" in err
    assert "cannot be written" not in err


FAULTS = {
    "a measure": ({"FAILS": "20", "RULE": "None", "MEASURES": '{"n": crowd}'}, "after 20 ticks: ", "in crowd: TypeErr"),
    "a measure of the start": ({"MEASURES": '{"n": lambda s: 1 / 0}'}, "after 0 ticks: ", "in <lambda>: Zero"),
    "a measure that is no number": ({"MEASURES": '{"one": lambda s: None}'}, "the measure 'one' must", "got None"),
    "build": ({"BUILD": "decay = {}[1]"}, "'world.py' cannot be built with {}: ", "in build: KeyError: 1."),
    "the file": ({"import math": "import math; math.nothing()"}, "does not run: ", "in <module>: AttributeError"),
    "the rule's words": ({"share(world, 0)": 'world.does("agent", "wlk")', "FAILS": "25"}, "after 25 ticks", "'walk'"),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_own_code_is_named_wherever_it_is_called(ecology: Command, case: str) -> None:
    """Whatever of a scenario file fails, the file is named, what was raised is said, and the exit code is 2."""
    words, begins, says = FAULTS[case]
    write(**words)
    code, out, err = ecology("run", "world.py", "--out", "out", "--quiet")
    assert code == 2
    message = err[err.index("ecology: ") :]
    assert begins in message
    assert says in message
    assert "world.py" in message or "measure" in case
    assert out == ""
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("where", "when"),
    [("init", ""), ("act", "after 25 ticks: "), ("learn", "after 25 ticks: "), ("report", "after 30 ticks: ")],
)
def test_a_learner_of_ones_own_is_named(
    ecology: Command, monkeypatch: pytest.MonkeyPatch, where: str, when: str
) -> None:
    """What a learner raises is told by its file and line, and how far the run came."""
    monkeypatch.setattr(Mine, "fails", where)
    if where == "report":
        monkeypatch.setattr(Mine, "fail", lambda self, here: 1 / 0 if here == where and self.ticks == 30 else None)
    code, _, err = ecology("run", "world.py", "--learner", "mine", "--out", "out", "--quiet")
    assert code == 2
    assert f"ecology: {when}{__file__}, line " in err
    assert ("ZeroDivisionError" if where == "report" else f"in fail: LookupError: no {where}") in err
    assert Path("out").exists() == (where != "init")
    monkeypatch.undo()


def test_a_learner_that_cannot_be_kept_or_restored_is_named(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """What `state` raises is told when the checkpoint is due; what `restore` raises is told with its place."""
    assert ecology("run", "world.py", "--learner", "mine", "--ticks", "25", "--out", "out", "--quiet")[0] == 0
    monkeypatch.setattr(Mine, "fails", "restore")
    code, _, err = ecology("run", "--resume", "out", "--ticks", "40")
    assert code == 2
    assert f"({__file__}, line " in err
    assert "LookupError: no restore" in err
    monkeypatch.setattr(Mine, "fails", "state")
    code, _, err = ecology("run", "world.py", "--learner", "mine", "--ticks", "25", "--out", "other", "--quiet")
    assert code == 2
    assert "after 25 ticks" in err
    assert "from tick 0" in err
    assert checkpoint.read(Path("other/checkpoint"))["tally"][1]["tick"] == 0


def test_too_few_actions_are_told(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A learner that does not return an action for every slot is told so."""
    monkeypatch.setattr(Mine, "fails", "few")
    code, _, err = ecology("run", "world.py", "--learner", "mine", "--out", "out", "--quiet")
    assert code == 2
    assert "the learner of 'agent', Mine, must return 3 actions" in err


def test_check_stops_where_the_rule_fails(ecology: Command) -> None:
    """A rule or a measure that fails is told once, by its place, not as a breach of every point of the contract."""
    write(FAILS="5")
    code, out, err = ecology("check", "world.py", "--ticks", "30")
    assert (code, out) == (2, "")
    assert f"line {line_of('return 1 / parts')}, in share: ZeroDivisionError" in err
    write(FAILS="5", RULE="None", MEASURES='{"crowd": crowd}')
    code, _, err = ecology("check", "world.py", "--ticks", "30")
    assert code == 2
    assert "in crowd: TypeError" in err


def test_a_fork_tells_of_past_and_future(ecology: Command) -> None:
    """Where the fork fails, its folder is kept; where the past that is lived again fails, nothing is begun."""
    assert ecology("run", "world.py", "--out", "run", "--no-record", "--quiet")[0] == 0
    write(FAILS="25")
    words = ("--out", "new", "--source", "current", "--quiet")
    code, _, err = ecology("fork", "run", "--at", "30", *words)
    assert code == 2
    assert "ecology: after 25 ticks: " in err
    assert "in share: ZeroDivisionError" in err
    assert not Path("new").exists()
    code, _, err = ecology("fork", "run", "--at", "20", *words)
    assert code == 2
    assert "resume from tick 20 with: ecology run --resume new --source current" in err
    write()
    assert ecology("run", "--resume", "new", "--source", "current", "--quiet")[0] == 0
    same_end("run", "new")


def test_a_sweep_tells_of_every_run(ecology: Command) -> None:
    """Runs whose rule fails are told by place with exit code 2, kept, and resumed by the same command once mended."""
    write(FAILS="25")
    words = ("sweep", "world.py", "--seeds", "0:1", "--workers", "1", "--out", "out", "--quiet")
    code, out, err = ecology(*words)
    assert (code, out) == (2, "")
    assert f"line {line_of('return 1 / parts')}, in share: ZeroDivisionError: division by zero" in err
    assert err.count("ecology: the run ") == 1
    assert "Traceback" not in err
    write()
    assert ecology(*words, "--source", "current")[0] == 0
    assert pq.read_table("out/sweep.parquet")["ticks"].to_pylist() == [60]


def test_what_the_project_or_a_library_raises_is_no_users_fault(
    ecology: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault without a user's frame in it stays a traceback; with one, it is told by that frame."""
    with pytest.raises(ValueError) as caught:
        json.loads("{")
    error = caught.value
    assert f"{__file__}, line " in str(faults.user_fault(error))
    assert error.__traceback__ is not None
    assert faults.user_fault(error.with_traceback(error.__traceback__.tb_next)) is None
    monkeypatch.setattr(physiology, "advance", None)
    with pytest.raises(TypeError):
        main(["run", "world.py", "--no-record", "--quiet"])
