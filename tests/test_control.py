"""The controls of a run that is served: pause, step, pace, waiting for pages; and what a page may ask for."""
# ruff: noqa: D102

import http.client
import json
import threading
import time
import types

import numpy as np
import pytest
from conftest import PATIENCE
from test_focus import ask, served  # noqa: F401  (a fixture)
from test_interventions import end_of, plan, same, world  # noqa: F401  (a fixture)

from ecology import EcologyError
from ecology.lab.runs.run import Run
from ecology.observers import control as controls
from ecology.observers.control import Control
from ecology.observers.page import Shown


@pytest.fixture
def clock(monkeypatch):
    """Return a clock that stands still until it is set."""
    now = types.SimpleNamespace(now=100.0)
    monkeypatch.setattr(controls.time, "monotonic", lambda: now.now)
    return now


def test_a_paused_run_waits(clock):
    """It is granted as many ticks as steps are ordered, goes to a decision or goes on; while it waits it is held."""
    control = Control(paused=True)
    assert 0 < control.hold(0) <= 0.05
    assert control.held
    control.order("step")
    assert not control.held
    control.order("step")
    assert not control.held
    assert [control.hold(t) > 0 for t in range(3)] == [False, False, True]
    control.order("decision")
    assert [control.hold(t) for t in range(2, 6)] == [0, 0, 0, 0]
    assert control.status()["to_decision"]
    control.decided()
    assert control.hold(6) > 0
    assert control.status()["paused"]
    control.order("go")
    assert control.hold(6) == 0
    control.order("pause")
    assert control.hold(7) > 0


def test_a_pace_is_kept(clock):
    """A tick begins when its time has come; what took too long is not made up for by a burst."""
    control = Control(pace=10)
    begun = []
    for _ in range(200):
        if not control.hold(0):
            begun.append(clock.now)
        clock.now += 0.01
    assert np.diff(begun) == pytest.approx(np.full(len(begun) - 1, 0.1), abs=0.011)
    assert len(begun) == pytest.approx(20, abs=1)
    clock.now += 30.0
    assert [control.hold(0) > 0 for _ in range(4)] == [False, False, True, True]
    control.order("pace", None)
    assert control.hold(0) == 0
    for pace in (0, -1, float("nan"), "fast", True):
        with pytest.raises(EcologyError, match="a pace is a number of ticks per second above 0"):
            control.order("pace", pace)
    with pytest.raises(EcologyError, match="no order 'stop'"):
        control.order("stop")
    assert control.status()["pace"] is None


def test_a_run_waits_for_its_watchers(clock):
    """It waits while a page that looks on is behind, not for one that looks elsewhere, is gone, stuck or up to date."""
    control = Control()
    control.sent(500)
    assert control.hold(500) == 0  # nobody looks
    control.seen("a", 490.0)
    assert control.hold(500) == 0  # near enough
    control.seen("a", 100.0)
    assert control.hold(500) > 0
    assert control.status()["waits"]
    control.seen("a", None)
    assert control.hold(500) == 0  # it looks back
    control.seen("a", 100.0)
    assert control.hold(500) > 0
    clock.now += controls.GONE
    assert control.hold(500) == 0  # it was closed
    for _ in range(20):  # it reports, but its picture does not move
        control.seen("a", 100.0)
        clock.now += controls.STUCK / 10
    assert control.hold(500) == 0
    control.seen("a", 150.0)
    assert control.hold(500) > 0
    assert Control(patient=False).hold(0) == 0
    impatient = Control(patient=False)
    impatient.sent(500)
    impatient.seen("a", 0.0)
    assert impatient.hold(500) == 0


def test_few_pages_are_listened_to(clock):
    """However many names report, few are kept, and those that are gone make room."""
    control = Control()
    for number in range(10_000):
        control.seen(f"x{number}", 0.0)
    assert control.status()["watchers"] == controls.WATCHERS
    clock.now += controls.GONE + 1
    control.seen("new", 0.0)
    assert control.status()["watchers"] == len(control._watchers) == 1


def test_a_picture_that_goes_to_and_fro_is_not_waited_for(clock):
    """Only a page whose picture advances beyond all that it has shown holds the run."""
    control = Control()
    waited = 0
    for i in range(400):
        control.sent(1_000)
        control.seen("x", float(i % 2))
        waited += control.hold(1_000) > 0
        clock.now += 0.1
    assert 0 < waited <= (controls.STUCK + 1) / 0.1


def test_a_fast_run_may_be_further_ahead(clock):
    """A page may be a second behind, at the speed of the run."""
    control = Control()
    for tick in range(0, 2_001, 100):
        control.advanced(tick)
        clock.now += 0.1
    assert control.status()["speed"] == pytest.approx(1_000, rel=0.1)
    control.sent(2_000)
    control.seen("a", 1_200.0)
    assert control.hold(2_000) == 0
    control.seen("a", 600.0)
    assert control.hold(2_000) > 0


# ---- a run -----------------------------------------------------------------------------------


def test_a_controlled_run_has_the_same_life(world, tmp_path):  # noqa: F811
    """Paused, stepped, paced and watched, with its extra pictures, it is bit for bit what it is alone."""
    from ecology.observers.rerun import Recorded, RerunObserver, Viewers

    alone = Run(plan(world), tmp_path / "alone")
    alone.start()
    alone.live()
    run = Run(plan(world), tmp_path / "run")
    run.control = control = Control(paused=True)
    observer = RerunObserver(
        tmp_path / "life.rrd", every=10, viewers=Viewers(("127.0.0.1", 0)), run=Recorded(control=control)
    )
    run.start()

    def play():
        for order in ("step", "step", "decision", "step"):
            while not control.held:
                time.sleep(0.001)
            ticks.append(control.status()["tick"])
            control.order(order)
        control.order("pace", 400.0)
        control.order("go")

    ticks: list[int] = []
    thread = threading.Thread(target=play)
    thread.start()
    run.live([observer])
    thread.join(PATIENCE)
    assert ticks[:3] == [0, 1, 2]
    assert ticks[3] > 2
    same(end_of(alone), end_of(run))
    from observed import column

    drawn = set(column(tmp_path / "life.rrd", "/world/agents/prey", "serial")[0].tolist())
    assert {0, 1, 2, 10, 20, 30, 40} <= drawn


def test_a_signal_stops_a_run_that_waits(world, tmp_path, monkeypatch):  # noqa: F811
    """A paused run is stopped at once, and the tick at which it waited is kept."""
    import signal

    from ecology.lab.runs.stopping import StoppedError

    run = Run(plan(world), tmp_path / "run")
    run.control = Control(paused=True)
    run.control.order("step")
    run.start()
    timer = threading.Timer(1.0, lambda: signal.raise_signal(signal.SIGINT))
    timer.start()
    with pytest.raises(StoppedError):
        run.live()
    assert run.now == 1
    assert json.loads((tmp_path / "run/summary.json").read_text())["stopped_at"] == 1


# ---- the page --------------------------------------------------------------------------------


class Desk:
    """Writes down what it is asked for, and refuses what is "bad"."""

    def __init__(self):
        self.asked = []

    def _take(self, *words):
        self.asked.append(words)
        if "bad" in words:
            raise EcologyError("it cannot be done.")

    def status(self, page, shown):
        self._take("status", page, shown)
        return {"tick": 5}

    def order(self, order, pace):
        self._take("order", order, pace)
        return {"paused": True}

    def do(self, text):
        self._take("do", text)
        return "done"

    def focus(self, who):
        self._take("focus", who)
        return "in focus"

    def world(self):
        self._take("world")
        return {"walls": []}


ASKED = {
    "/status": ({"page": "x", "shown": 4.5}, ("status", "x", 4.5), {"tick": 5}),
    "/order": ({"order": "pace", "pace": None}, ("order", "pace", None), {"paused": True}),
    "/do": ({"do": "empty grass"}, ("do", "empty grass"), {"said": "done"}),
    "/name": ({"who": "prey_3"}, ("focus", "prey_3"), {"said": "in focus"}),
    "/world": ({}, ("world",), {"walls": []}),
}
WRONG = {
    "/status": [{}, {"page": "x"}, {"page": 5, "shown": 1}, {"page": "x", "shown": "1"}, {"page": "x", "shown": True}],
    "/order": [{"order": "go"}, {"order": 5, "pace": None}, {"order": "pace", "pace": "5"}],
    "/do": [{}, {"do": 5}, {"do": "x", "at": 5}, {"do": "x" * 2_000}],
    "/name": [{}, {"who": None}],
    "/world": [{"x": 1}, []],
}


@pytest.mark.parametrize("path", ASKED)
def test_a_page_asks_for_a_run(served, path):  # noqa: F811
    """What is posted with the token reaches the desk and is answered; without it, from elsewhere or as garbage, not."""
    desk = Desk()
    it = served(lambda click: None, desk=desk)
    told, asked, answered = ASKED[path]
    body, token = json.dumps(told).encode(), {"X-Token": it.token}
    answer = ask(it, "POST", path, body, **token)
    assert (answer.status, json.loads(answer.body)) == (200, answered)
    assert answer.headers["Content-Type"] == "application/json"
    assert desk.asked == [asked]
    for headers in (
        {},
        {"X-Token": "guess"},
        {**token, "Origin": "http://evil.example"},
        {**token, "Host": "evil.example"},
    ):
        assert ask(it, "POST", path, body, **headers).status == 403
    for wrong in (b"", b"garbage", b"[" * 500, *(json.dumps(each).encode() for each in WRONG[path])):
        assert ask(it, "POST", path, wrong, **token).status == 400, wrong
    assert ask(it, "GET", path).status == 404
    assert desk.asked == [asked]


def test_what_a_run_refuses_is_said(served):  # noqa: F811
    """An error of the run is the answer 409 with its reason."""
    it = served(lambda click: None, desk=Desk())
    answer = ask(it, "POST", "/do", b'{"do": "bad"}', **{"X-Token": it.token})
    assert (answer.status, json.loads(answer.body)) == (409, {"error": "it cannot be done."})


def test_a_recording_takes_no_orders(served, tmp_path):  # noqa: F811
    """A page of a recording brings agents into focus by name, and has nothing to be paused or moved."""
    it = served(lambda click: None, named=lambda who: b"RRF2" + who.encode())
    token = {"X-Token": it.token}
    assert b'"live": false' in ask(it, "GET", "/").body
    assert ask(it, "POST", "/name", b'{"who": "prey_3"}', **token).body == b"RRF2prey_3"
    for path in set(ASKED) - {"/name"}:
        assert ask(it, "POST", path, json.dumps(ASKED[path][0]).encode(), **token).status == 404


def test_a_page_looks_back_when_its_run_is_over(served, tmp_path):  # noqa: F811
    """Who loads it again is served the recording; a page that is still open hears that the run is over."""
    desk, clicks = Desk(), []
    it = served(clicks.append, desk=desk)
    assert b'"live": true' in ask(it, "GET", "/").body
    (tmp_path / "recording.rrd").write_bytes(b"RRF2")
    recording = tmp_path / "recording.rrd"
    files = {recording.name: recording}
    it.look_back(Shown([recording.name], lambda click: b"RRF2 layer", files, named=lambda who: b"RRF2 name"), desk)
    page = ask(it, "GET", "/").body
    assert b'"live": false' in page
    assert b'"sources": ["recording.rrd"]' in page
    assert ask(it, "GET", "/recording.rrd").body == b"RRF2"
    token = {"X-Token": it.token}
    click = b'{"entity": "/world/agents/prey", "row": 3, "tick": null}'
    assert ask(it, "POST", "/focus", click, **token).body == b"RRF2 layer"
    assert ask(it, "POST", "/name", b'{"who": "prey_3"}', **token).body == b"RRF2 name"
    assert ask(it, "POST", "/status", b'{"page": "x", "shown": 1}', **token).status == 200
    assert clicks == []


def test_a_served_run_from_its_page(tmp_path, monkeypatch, capsys):
    """The whole of it: paused, a thing moved by hand, an agent into focus, to the end, and looked back at."""
    from ecology.lab.cli import live, main
    from ecology.observers import page, viewer

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(viewer, "WEB_PORT", 0)
    monkeypatch.setattr(viewer, "SERVE_PORT", 0)
    monkeypatch.setattr(page, "_viewer_files", lambda folder: [])
    pages, found = [], {}

    class Served(page.Page):
        def __init__(self, *words, **more):
            super().__init__(*words, **more)
            pages.append(self)

    monkeypatch.setattr(page, "Page", Served)

    def post(path, **told):
        answer = ask(pages[0], "POST", path, json.dumps(told).encode(), **{"X-Token": pages[0].token})
        return json.loads(answer.body) if answer.status in (200, 409) and answer.body[:1] == b"{" else answer

    def visit():
        until = time.monotonic() + PATIENCE
        while not pages and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(0.2)
        try:
            found["first"] = post("/status", page="x", shown=0)
            found["world"] = post("/world")
            found["moved"] = post("/do", do="move grass.0 2 2")
            found["refused"] = post("/do", do="move grass.0 200 2")
            found["focus"] = post("/name", who="predator")
            found["nobody"] = post("/name", who="wolf_3")
            post("/order", order="step", pace=None)
            while post("/status", page="x", shown=None)["tick"] < 1:
                time.sleep(0.01)
            found["then"] = post("/status", page="x", shown=None)
        finally:
            post("/order", order="go", pace=None)

    def look():
        found["over"] = post("/status", page="x", shown=30)
        found["late"] = post("/do", do="empty grass")
        found["again"] = ask(pages[0], "GET", "/recording.rrd").body[:3]
        found["layer"] = post("/name", who="prey_3").body[:3]
        raise KeyboardInterrupt

    monkeypatch.setattr(live, "wait", look)
    thread = threading.Thread(target=visit)
    thread.start()
    with pytest.raises(SystemExit, match="0"):
        main(["run", "predator_prey", "--learner", "random", "--ticks", "30", "--serve", "--paused", "--out", "mine",
              "--quiet"])  # fmt: skip
    thread.join(PATIENCE)
    assert (found["first"]["tick"], found["first"]["paused"], found["first"]["over"]) == (0, True, False)
    assert found["first"]["alive"] == {"prey": 110, "predator": 30}
    assert found["first"]["focus"].startswith("prey_")
    assert {"grass.0", "grass.15"} <= {each["name"] for each in found["world"]["resources"]}
    assert "prey_3" in {each["name"] for each in found["world"]["agents"]}
    assert found["moved"]["said"].startswith("grass.0 was moved from")
    assert "outside the arena" in found["refused"]["error"]
    assert found["focus"]["said"].startswith("predator is in focus from tick 0 on")
    assert "wolf_3" in found["nobody"]["error"]
    assert found["then"]["focus"].startswith("predator_")
    assert (found["over"]["tick"], found["over"]["over"]) == (30, True)
    assert found["over"]["folder"] == "mine"
    assert (found["first"]["back"], found["over"]["back"]) == ("making", "ready")
    assert found["late"]["error"] == "the run is over."
    assert found["again"] == found["layer"] == b"RRF"
    assert (tmp_path / "mine/interventions.jsonl").read_text() == '{"tick": 0, "do": "move grass.0 2 2"}\n'
    assert pages[0].url in capsys.readouterr().out
    with pytest.raises(OSError, match="refused"):
        http.client.HTTPConnection("127.0.0.1", pages[0].port).request("GET", "/")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--paused"], "--paused requires --serve."),
        (["--pace", "5"], "--pace requires --serve."),
        (["--no-wait"], "--no-wait requires --serve."),
        (["--serve", "--pace", "0"], "a pace is a number of ticks per second above 0, got 0.0."),
        (["--replay", "nowhere.jsonl"], "nowhere.jsonl"),
    ],
)
def test_options_that_do_not_fit_are_refused(tmp_path, monkeypatch, capsys, words, said):
    """They give exit code 2 and a message, and nothing is written."""
    from ecology.lab.cli import main

    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main(["run", "paper", "--learner", "random", "--ticks", "5", "--out", "mine", *words])
    assert stopped.value.code == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "mine/config.toml").exists()
