"""`ecology view`, `focus` and `do`: looking at runs and changing them."""

from __future__ import annotations

import contextlib
import http.client
import json
import re
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from conftest import Command

from ecology import EcologyError
from ecology.lab.cli import live
from ecology.lab.runs.run import Run
from ecology.lab.runs.run_config import resolve
from ecology.observers import rerun


def test_view_saves_a_screenshot(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """--screenshot draws the tick that was asked for; --tick alone, and a file that exists, are errors."""
    from ecology.observers import screenshot

    run = ("run", "paper", "--ticks", "20", "--learner", "random", "--out", "mine", "--quiet")
    assert ecology(*run)[0] == 0
    code, _, err = ecology("view", "mine", "--tick", "5")
    assert code == 2
    assert "--screenshot" in err
    Path("there.png").write_text("mine")
    code, _, err = ecology("view", "mine", "--screenshot", "there.png")
    assert code == 2
    assert "'there.png'" in err
    assert Path("there.png").read_text() == "mine"
    drawn = []
    monkeypatch.setattr(screenshot, "screenshot", lambda *words, **more: drawn.append((words, more)))
    code, out, _ = ecology("view", "mine", "--screenshot", "new.png", "--tick", "5")
    assert (code, out) == (0, "written: new.png\n")
    assert drawn == [((Path("mine"), Path("new.png")), {"tick": 5})]


def test_runs_that_are_served_take_other_ports(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Where the usual ports are taken, also by a run that was prepared at the same time, free ones are used."""
    from ecology.observers import viewer

    for name in ("WEB_PORT", "SERVE_PORT"):
        monkeypatch.setattr(viewer, name, viewer.free_port(viewer.LOOPBACK, 0))
    monkeypatch.setattr(rerun, "SERVE_PORT", viewer.SERVE_PORT)
    runs, watched = [Run(resolve("paper", learner="random", ticks=3), tmp_path / word) for word in "ab"], []
    for run in runs:
        run.start()
        watched.append(live.make_observers(run, live.Watching(serve=True), resume=False))
    urls = []
    with contextlib.ExitStack() as at_end:
        for run, observers in zip(runs, watched, strict=True):
            for observer in observers:
                observer.begin(run.env, run.learners)
                at_end.callback(observer.end)
            shown, audience = observers[-2:]
            assert isinstance(shown, rerun.RerunObserver)
            assert isinstance(audience, live.Audience)
            at_end.callback(audience.close)
            urls += [shown.url, audience.url]
    assert len(set(urls)) == 4
    assert None not in urls
    assert f":{viewer.SERVE_PORT}/" in str(urls[0])
    assert f":{viewer.WEB_PORT}/" in str(urls[1])


def test_a_port_needs_something_to_serve(short: Command) -> None:
    """--port without --serve gives exit code 2."""
    code, _, err = short("paper", "--port", "9000")
    assert (code, err) == (2, "ecology: --port requires --serve.\n")


def test_a_port_for_browsers_that_is_taken_is_an_error(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A --port that is taken gives exit code 2, names the option, and leaves no folder."""
    from ecology.observers import viewer

    with socket.socket() as taken:
        taken.bind((viewer.LOOPBACK, 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        monkeypatch.setattr(viewer, "SERVE_PORT", 0)
        code, _, err = ecology(
            "run", "paper", "--ticks", "20", "--learner", "random", "--serve", "--port", port, "--out", "mine"
        )
    assert code == 2
    assert "cannot serve" in err
    assert "give another with --port" in err
    assert not Path("mine").exists()


def test_view_needs_a_recording(ecology: Command, short: Command) -> None:
    """`ecology view` of a run without a recording gives exit code 2 and says so."""
    assert short("paper", "--out", "mine")[0] == 0
    code, _, err = ecology("view", "mine")
    assert code == 2
    assert "recording" in err


@pytest.mark.parametrize(("size", "end"), [(0, 0), (3, 0), (100, 0), (20_000, 0), (100, 64)])
def test_a_recording_of_which_nothing_is_left_is_an_error(ecology: Command, size: int, end: int) -> None:
    """However one looks at a recording that lost its first tick, exit code 2 and one message name it."""
    from ecology.observers import viewer

    run = ("run", "paper", "--ticks", "20", "--learner", "random", "--out", "mine", "--quiet")
    assert ecology(*run)[0] == 0
    path = Path("mine/recording.rrd")
    data = path.read_bytes()
    path.write_bytes(data[:size] + data[len(data) - end :])
    before = path.read_bytes(), set(Path("mine").iterdir())
    looks = (("view", "mine", "--screenshot", "x.png"), ("view", "mine", "--serve"), ("film", "mine", "x.gif"))
    for words in looks:
        code, out, err = ecology(*words)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        assert "'mine/recording.rrd'" in err
    assert not Path("x.png").exists()
    assert not Path("x.gif").exists()
    with pytest.raises(EcologyError, match="recording"), viewer.open_recording(Path("mine")):
        pass
    assert (path.read_bytes(), set(Path("mine").iterdir())) == before


def test_view_shows_who_is_asked_for(ecology: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """--focus draws an agent's life, and --serve answers clicks with one; who was not there is an error."""
    from ecology.observers import page, readback, screenshot, viewer

    run = ("run", "predator_prey", "--ticks", "20", "--learner", "random", "--out", "mine", "--quiet")
    assert ecology(*run)[0] == 0
    drawn = []
    monkeypatch.setattr(screenshot, "screenshot", lambda run, *_, **__: drawn.append(readback.column(
        run, "/chosen/prey_3/drive", "Scalars:scalars").keys()))  # fmt: skip
    assert ecology("view", "mine", "--focus", "prey_3", "--screenshot", "new.png")[0] == 0
    assert drawn == [{0, 10, 20}]
    for words, told in (
        (("mine", "--focus", "prey_300"), "prey_300"),
        (("mine/recording.rrd", "--focus", "prey_3"), "the folder of the run"),
        (("mine", "--serve", "--screenshot", "new.png"), "one of them"),
    ):
        code, _, err = ecology("view", *words)
        assert code == 2
        assert told in err

    pages: list[page.Page] = []
    answers: list[tuple[int, bytes]] = []

    class Served(page.Page):
        def __init__(self, *words: Any, **more: Any) -> None:
            super().__init__(*words, **more)
            pages.append(self)

    def look() -> None:
        for method, path, entity in (
            ("POST", "/focus", "/world/agents/prey"),
            ("POST", "/focus", "/world/walls"),
            ("GET", "/recording.rrd", ""),
        ):
            link = http.client.HTTPConnection("127.0.0.1", pages[0].port)
            click = json.dumps({"entity": entity, "row": 5, "tick": 10})
            link.request(method, path, click if method == "POST" else None, {"X-Token": pages[0].token})
            answer = link.getresponse()
            answers.append((answer.status, answer.read()[:3]))
            link.close()
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "Page", Served)
    monkeypatch.setattr(viewer, "WEB_PORT", 0)
    monkeypatch.setattr(live, "wait", look)
    code, out, _ = ecology("view", "mine", "--serve")
    assert code == 0
    assert pages[0].url in out
    assert answers == [(200, b"RRF"), (200, b'{"s'), (200, b"RRF")]


def test_focus_turns_a_run_that_is_alive(ecology: Command) -> None:
    """`ecology focus` is answered by a run that lives; of one that does not, and of no run, it says so."""
    words = ["run", "predator_prey", "--ticks", "1000000", "--learner", "random", "--out", "mine", "--quiet"]
    run = subprocess.Popen([sys.executable, "-m", "ecology.lab.cli", *words])
    try:
        while not Path("mine/recording.rrd").exists():
            assert run.poll() is None
            time.sleep(0.1)
        code, out, _ = ecology("focus", "mine", "predator")
        assert code == 0
        assert out.startswith("predator is in focus from tick ")
        code, _, err = ecology("focus", "mine", "prey_999999")
        assert code == 2
        assert "no prey_999999 lives at tick" in err
    finally:
        run.terminate()
        run.wait()
    code, _, err = ecology("focus", "mine", "predator")
    assert code == 2
    assert "ecology view mine --focus predator" in err
    assert not Path("mine/focus.json").exists()
    code, _, err = ecology("focus", "nowhere", "predator")
    assert code == 2
    assert "holds no run" in err


def test_a_run_that_is_alive_can_be_changed(ecology: Command) -> None:
    """`ecology do` is answered by a run that lives, recorded or not; else it is refused."""
    words = ["run", "predator_prey", "--ticks", "1000000", "--learner", "random", "--out", "mine", "--no-record"]
    run = subprocess.Popen([sys.executable, "-m", "ecology.lab.cli", *words, "--quiet"])
    try:
        while not Path("mine/checkpoint").exists():
            assert run.poll() is None
            time.sleep(0.1)
        code, out, _ = ecology("do", "mine", "move grass.3 6.5 6.5")
        assert code == 0
        assert re.fullmatch(r"tick \d+: grass.3 was moved from .* to \(6.50, 6.50\)\n", out)
        code, _, err = ecology("do", "mine", "set", "prey", "enrgy", "0.2")
        assert code == 2
        assert "Did you mean 'energy'" in err
        code, _, err = ecology("do", "mine", "burn grass")
        assert (code, "no intervention 'burn'" in err) == (2, True)
    finally:
        run.terminate()
        run.wait()
    assert json.loads(Path("mine/interventions.jsonl").read_text())["do"] == "move grass.3 6.5 6.5"
    assert json.loads(Path("mine/summary.json").read_text())["interventions"] == 1
    assert not Path("mine/do.json").exists()
    code, _, err = ecology("do", "mine", "empty grass")
    assert code == 2
    assert "no run is alive in 'mine'" in err
    assert ecology("do", "nowhere", "empty grass")[0] == 2
    config = (
        "run",
        "--config",
        "mine/config.toml",
        "--replay",
        "mine/interventions.jsonl",
        "--out",
        "again",
        "--quiet",
    )
    tick = json.loads(Path("mine/interventions.jsonl").read_text())["tick"]
    assert ecology(*config, "--ticks", str(tick + 1))[0] == 0
    assert Path("again/interventions.jsonl").read_text() == Path("mine/interventions.jsonl").read_text()


def test_births_and_deaths_are_counted_on(ecology: Command) -> None:
    """What a resumed run, and a fork, say was born and has died so far goes on from where it was."""
    from ecology.observers import readback

    def flow(run: str) -> dict[int, list[float]]:
        found = readback.column(Path(run, "recording.rrd"), "/population/flow", "Scalars:scalars")
        return {tick: value.tolist() for tick, value in found.items()}

    run = ("run", "predator_prey", "--learner", "random", "--quiet")
    assert ecology(*run, "--ticks", "240", "--out", "whole")[0] == 0
    assert ecology(*run, "--ticks", "200", "--out", "mine")[0] == 0
    assert ecology("run", "--resume", "mine", "--ticks", "240", "--quiet")[0] == 0
    assert min(flow("whole")[200]) >= 0
    assert max(flow("whole")[200]) > 0
    assert flow("mine") == flow("whole")
    dead = readback.column(Path("whole", "recording.rrd"), "/world/agents/prey", "serial")[200][0]
    assert ecology("fork", "whole", "--at", "200", "--remove", f"prey_{dead}", "--out", "fork", "--quiet")[0] == 0
    assert flow("fork")[200] == flow("whole")[200]


def test_a_page_that_cannot_be_served_stops_no_run(
    ecology: Command, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Where Rerun's files for browsers are not to be had, --serve says so once and the run goes on."""
    from ecology.observers import page, viewer

    def fails(folder: Path) -> list[Path]:
        raise EcologyError("the viewer for browsers cannot be started (gone).")

    monkeypatch.setattr(viewer, "WEB_PORT", 0)
    monkeypatch.setattr(viewer, "SERVE_PORT", viewer.free_port(viewer.LOOPBACK, 0))
    monkeypatch.setattr(page, "_viewer_files", fails)
    code, out, _ = ecology("run", "paper", "--ticks", "20", "--learner", "random", "--serve", "--out", "mine")
    assert code == 0
    assert "rerun --connect" in out
    assert [record.getMessage() for record in caplog.records].count(
        "the viewer for browsers cannot be started (gone). The run continues."
    ) == 1
