"""Who is in focus: changed by clicks and words while a run lives, and after the fact; the run lives as it would."""
# ruff: noqa: D102

import contextlib
import dataclasses
import http.client
import json
import re
import socket
import threading
import time
import types
import warnings

import numpy as np
import pytest
from conftest import PATIENCE
from observed import TICKS, Wanderer, Witness, choice, column, live, many, one, rerun_observer, told, village

from ecology import Ecology, EcologyError
from ecology.observers import census, focus_requests, page, viewer
from ecology.observers.focus_requests import Click, FocusRequests

GARBAGE = {
    "nothing": b"",
    "no JSON": b"prey_3",
    "no object": b"[1, 2]",
    "deep": b"[" * 1_000,
    "no text": b"\xff\xfe\x00",
    "too little": b'{"entity": "/world/agents/prey", "row": 1}',
    "too much": b'{"entity": "/world/agents/prey", "row": 1, "tick": 1, "run": "rm"}',
    "no path": b'{"entity": 7, "row": 1, "tick": 1}',
    "no row": b'{"entity": "/world/agents/prey", "row": true, "tick": 1}',
    "a negative row": b'{"entity": "/world/agents/prey", "row": -1, "tick": 1}',
    "a huge row": b'{"entity": "/world/agents/prey", "row": 99999999999, "tick": 1}',
    "no tick": b'{"entity": "/world/agents/prey", "row": 1, "tick": "now"}',
    "a tick that is no number": b'{"entity": "/world/agents/prey", "row": 1, "tick": NaN}',
    "too long": b'{"entity": "' + b"x" * 2_000 + b'", "row": 1, "tick": 1}',
}
GARBAGE["a huge tick"] = b'{"entity": "/world/agents/prey", "row": 1, "tick": 1' + b"0" * 400 + b"}"
GARBAGE["far too long"] = b"x" * 50_000
GOOD = b'{"entity": "/world/agents/prey", "row": 3, "tick": 120.5}'


@pytest.fixture(autouse=True)
def strict():
    """Make bad input to the viewer's library an error instead of a warning."""
    import rerun as rr

    rr.set_strict_mode(True)


@pytest.fixture
def served(tmp_path, monkeypatch):
    """Return a maker of pages that are closed at the end; Rerun's files are stand-ins."""

    def files(folder):
        for name in page.VIEWER:
            (folder / name).write_bytes(name.encode())
        return [folder / name for name in page.VIEWER]

    monkeypatch.setattr(page, "_viewer_files", files)
    made = []

    def make(hear, **words):
        made.append(page.Page(page.Shown(["rerun+http://127.0.0.1:9876/proxy"], hear, **words), port=0))
        return made[-1]

    yield make
    for each in made:
        each.close()


def ask(served, method, path, body=None, **headers):
    """Return the answer of a page: status, headers, body."""
    link = http.client.HTTPConnection("127.0.0.1", served.port, timeout=10)
    link.request(method, path, body, headers)
    answer = link.getresponse()
    found = types.SimpleNamespace(status=answer.status, headers=answer.headers, body=answer.read())
    link.close()
    return found


def post(served, body, **headers):
    """Return the answer to a click."""
    return ask(served, "POST", "/focus", body, **{"X-Token": served.token, **headers})


# ---- the page --------------------------------------------------------------------------------


def test_a_page_shows_the_viewer(served, tmp_path):
    """It loads Rerun's files from itself alone, knows its token, serves what it was given and nothing else."""
    (tmp_path / "life.rrd").write_bytes(b"RRF2")
    it = served(lambda click: None, files={"life.rrd": tmp_path / "life.rrd"})
    assert it.url == f"http://127.0.0.1:{it.port}/"
    assert it._server.server_address[0] == "127.0.0.1"
    shown = ask(it, "GET", "/?renderer=webgl")
    assert shown.status == 200
    settings = json.loads(re.search(r"= (\{.*?\});", shown.body.decode())[1])
    assert settings == {
        "token": it.token,
        "sources": ["rerun+http://127.0.0.1:9876/proxy"],
        "agents": "/world/agents/",
        "name": "",
        "live": False,
        "usages": [],
    }
    policy = shown.headers["Content-Security-Policy"]
    assert "connect-src 'self' http://127.0.0.1:9876;" in policy
    assert "frame-ancestors 'none'" in policy
    for name in page.VIEWER:
        assert ask(it, "GET", f"/{name}").body == name.encode()
    assert ask(it, "GET", "/life.rrd").body == b"RRF2"
    for path in ("/focus", "/../page.py", "/life.rrd/", "//etc/passwd"):
        assert ask(it, "GET", path).status == 404
    assert served(lambda click: None).token != it.token


def is_shut(link):
    """Return whether a page has closed a connection; what it has answered is read."""
    link.setblocking(False)
    try:
        while link.recv(65_536):
            pass
        return True
    except BlockingIOError:
        return False
    except OSError:
        return True


def test_a_page_takes_few_connections(served, monkeypatch):
    """Of many that say nothing, the first are kept and the others closed: files and threads are also the run's."""
    monkeypatch.setattr(page, "CONNECTIONS", 8)
    it = served(lambda click: None)
    threads, until = threading.active_count(), time.monotonic() + PATIENCE
    with contextlib.ExitStack() as stack:
        links = [stack.enter_context(socket.create_connection(("127.0.0.1", it.port), 10)) for _ in range(40)]
        while sum(map(is_shut, links)) < 32:
            assert time.monotonic() < until
            time.sleep(0.01)
        assert threading.active_count() <= threads + 8
        assert sum(map(is_shut, links)) == 32
    while threading.active_count() > threads:
        assert time.monotonic() < until
        time.sleep(0.01)
    assert ask(it, "GET", "/").status == 200


@pytest.mark.parametrize("head", [b"", b"POST /focus HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999\r\n\r\n"])
def test_a_page_does_not_wait_for_a_slow_request(served, monkeypatch, head):
    """A client that sends a byte now and then, of the head or of the body, is shut out when its time is over."""
    monkeypatch.setattr(page, "PATIENCE", 1.0)
    it = served(lambda click: None)
    with socket.create_connection(("127.0.0.1", it.port), 10) as slow:
        slow.sendall(head)
        until = time.monotonic() + 10
        while not is_shut(slow):
            assert time.monotonic() < until
            with contextlib.suppress(OSError):
                slow.sendall(b"G")
            time.sleep(0.2)


def test_the_viewer_for_browsers_comes_with_rerun(tmp_path):
    """Rerun's own server gives the two files that the page needs, by the names that it uses."""
    script, program = page._viewer_files(tmp_path)
    text = script.read_text()
    for word in ("wasm_bindgen", "WebHandle", "send_rrd_to_channel", "open_channel", "has_panicked"):
        assert word in text
        assert word == "wasm_bindgen" or word in page.HTML.read_text()
    assert program.read_bytes()[:4] == b"\0asm"


def test_a_click_is_heard(served):
    """A click is handed on, and what is drawn for it comes back."""
    heard, layers = [], [None, b"RRF2 layer"]
    it = served(lambda click: heard.append(click) or layers[len(heard) - 1])
    answer = post(it, GOOD)
    assert (answer.status, answer.body) == (204, b"")
    answer = post(it, GOOD.replace(b"120.5", b"null"), Origin=it.url.rstrip("/"))
    assert (answer.status, answer.body) == (200, b"RRF2 layer")
    assert heard == [Click("/world/agents/prey", 3, 120.5), Click("/world/agents/prey", 3, None)]


@pytest.mark.parametrize("body", GARBAGE.values(), ids=GARBAGE.keys())
def test_garbage_is_no_click(served, body):
    """What is not a click gives 400 and is not heard; the next click is."""
    heard = []
    it = served(heard.append)
    assert post(it, body).status == 400
    assert heard == []
    assert post(it, GOOD).status == 204
    assert len(heard) == 1


def test_only_the_page_itself_can_click(served):
    """Without the token, from another page or under another host's name a click is refused, and so is the page."""
    heard = []
    it = served(heard.append)
    assert ask(it, "POST", "/focus", GOOD).status == 403
    for headers in (
        {"X-Token": "guess"},
        {"X-Token": "\xe9"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": f"http://127.0.0.1:{it.port + 1}"},
        {"Host": "evil.example"},
        {"Host": f"evil.example:{it.port}"},
        {"Host": "[::"},
    ):
        assert post(it, GOOD, **headers).status == 403, headers
    assert ask(it, "GET", "/", Host="evil.example").status == 403
    assert ask(it, "GET", "/", Host="localhost:8000").status == 200  # through a tunnel
    assert ask(it, "POST", "/", GOOD, **{"X-Token": it.token}).status == 404
    assert ask(it, "OPTIONS", "/focus").status == 501  # no other page is told that it may
    assert heard == []


# ---- words and clicks of a run that lives ------------------------------------------------------


def calm():
    """Return the village where nobody dies: who is named in a test is there."""
    prey, predator = village().species
    prey = dataclasses.replace(prey, hazard=None)
    predator = dataclasses.replace(predator, hazard=None, actions=predator.actions[:3])  # without the bite
    return dataclasses.replace(village(), species=(prey, predator))


class Hands:
    """An observer that clicks, posts garbage and asks at given ticks, while a run lives."""

    def __init__(self, deeds):
        self.deeds = deeds

    def begin(self, env, minds):
        pass

    def watch(self, state, tick, minds):
        self.deeds.get(state.tick, lambda: None)()

    def end(self):
        pass


@pytest.mark.parametrize("world", [one, many, village])
def test_changing_the_focus_changes_no_life(tmp_path, world, served):
    """A run whose focus is changed by clicks and words, under garbage too, lives as one that nobody watches."""
    alone = live(world()).state_view
    kept = FocusRequests(tmp_path)
    it = served(kept.click)
    name = world().species[-1].name
    clicked = json.dumps({"entity": f"/world/agents/{name}", "row": 0, "tick": None}).encode()
    deeds = {
        5: lambda: [post(it, body) for body in GARBAGE.values()],
        11: lambda: post(it, clicked),
        21: lambda: (tmp_path / focus_requests.FILE).write_text(json.dumps({"focus": "hungriest"})),
        31: lambda: (tmp_path / focus_requests.FILE).write_text("garbage"),
        41: lambda: (tmp_path / focus_requests.FILE).write_text(json.dumps({"focus": ["prey_1"]})),
    }
    watched = live(
        world(),
        Hands(deeds),
        rerun_observer(tmp_path / "recording.rrd", every=2, requests=kept, serve=("127.0.0.1", 0)),
    ).state_view
    for field, array in alone.arrays().items():
        np.testing.assert_array_equal(array, watched.arrays()[field], err_msg=field)


def test_a_click_brings_an_agent_into_focus(tmp_path):
    """From the next sample on its panels are those of the clicked one; clicks on anything else change nothing."""
    from rerun.chunk import RrdReader

    witness, path, kept, row = Witness(), tmp_path / "recording.rrd", FocusRequests(), 7
    others = (("/world/walls", 0), ("/world/agents/wolf", 1), ("/world/agents/prey", 99), ("/world/agents/prey/x", 1))
    deeds = {
        3: lambda: [kept.click(Click(*other)) for other in others],
        11: lambda: kept.click(Click("/world/agents/prey", row, 8.0)),
    }
    live(calm(), witness, Hands(deeds), rerun_observer(path, every=4, requests=kept, serve=("127.0.0.1", 0)))
    names = {t: v[0] for t, v in told(path, "/world/focus/prey/name", "Points2D:labels").items()}
    assert {names[tick] for tick in (0, 4, 8)} == {"prey_0"}
    values = told(path, "/focus/prey/deviation")
    assert np.isnan(values[12]).all()  # the series breaks between two lives
    for tick in range(16, TICKS + 1, 4):
        assert names[tick] == f"prey_{row}"
        assert values[tick] == pytest.approx(witness.states[tick].internal[row, 0] - 2.0, abs=1e-5)
    assert len(RrdReader(str(path)).blueprints()) == 1  # of several, one would be shown by chance
    at, texts = column(path, "/events/prey", "TextLog:text")
    words = {text[0]: tick for tick, text in zip(at.tolist(), texts, strict=True)}
    (turned,) = (word for word in words if word.endswith(f"  now in focus: prey_{row}"))
    assert turned == f"{words[turned]}  now in focus: prey_{row}"


def test_who_looks_on_is_shown_another_life_first(tmp_path):
    """A viewer is sent the layout for the one that was clicked, and one of a run that is gone on; the file has one."""
    from rerun.chunk import RrdReader

    path, kept, shown, words = tmp_path / "recording.rrd", FocusRequests(), [], {"every": 4, "serve": ("127.0.0.1", 0)}

    def look():
        """Count the layouts that a viewer is sent, PATIENCE seconds at most."""
        target = tmp_path / f"{len(shown)}.rrd"
        with viewer.viewer_process(observer.url, "--save", str(target), "--port", "auto"):
            until = time.monotonic() + PATIENCE
            found = []
            while len(found) < 2 - len(shown) and time.monotonic() < until:
                time.sleep(0.2)
                with contextlib.suppress(RuntimeError), warnings.catch_warnings(action="ignore"):
                    found = RrdReader(str(target)).blueprints()
        shown.append(len(found))

    observer = rerun_observer(path, requests=kept, **words)
    deeds = {11: lambda: kept.click(Click("/world/agents/predator", 1)), 21: look}
    env = live(calm(), observer, Hands(deeds))
    assert len(RrdReader(str(path)).blueprints()) == 1
    observer = rerun_observer(path, resume=True, **words)
    observer.begin(env, {g.name: Wanderer(g, np.random.SeedSequence(6)) for g in env.groups.values()})
    look()
    observer.end()
    assert shown == [2, 1]
    assert len(RrdReader(str(path)).blueprints()) == 1


def test_a_viewer_elsewhere_is_drawn_the_same(tmp_path, monkeypatch):
    """What it is sent is what the file holds, and another layout once another is in focus."""
    from rerun.chunk import RrdReader

    from ecology.observers import relay

    monkeypatch.setattr(relay, "PATIENCE", PATIENCE)  # a busy machine may be slow to send
    path, elsewhere, kept = tmp_path / "recording.rrd", tmp_path / "elsewhere.rrd", FocusRequests()
    port = viewer.free_port(viewer.LOOPBACK, 0)
    with viewer.viewer_process("--save", str(elsewhere), "--port", str(port)):
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until and not elsewhere.exists():
            time.sleep(0.1)
        observer = rerun_observer(path, every=4, requests=kept, connect=f"rerun+http://{viewer.LOOPBACK}:{port}/proxy")
        live(calm(), observer, Hands({11: lambda: kept.click(Click("/world/agents/predator", 1))}))
        there, here = {}, told(path, "/focus/predator/deviation")
        while max(there, default=0) < TICKS and time.monotonic() < until:
            with contextlib.suppress(EcologyError):  # nothing of it is on disk yet
                there = told(viewer.repair_recording(elsewhere, tmp_path / "whole.rrd"), "/focus/predator/deviation")
    assert there.keys() == here.keys() == set(range(0, TICKS + 1, 4))
    for tick, value in here.items():
        np.testing.assert_array_equal(there[tick], value)
    assert len(RrdReader(str(tmp_path / "whole.rrd")).blueprints()) == 2
    assert len(RrdReader(str(path)).blueprints()) == 1


def test_a_click_means_who_was_seen():
    """Where another has taken the slot since, or nobody lives in it, a click changes nothing."""
    env = Ecology(village())
    env.reset_arrays(3)
    focus = census.Focus.of(env, [])
    state = env.world.state
    state.tick, state.time, state.age[:] = 100, 100.0, 100.0
    state.age[4], state.alive[6] = 20.0, False
    state.serial[4] = 77
    assert focus.name_clicked(env, Click("/world/agents/prey", 4, 85.0)) == "prey_77"
    assert focus.name_clicked(env, Click("/world/agents/prey", 4, None)) == "prey_77"
    assert focus.name_clicked(env, Click("/world/agents/prey", 4, 75.0)) is None
    assert focus.name_clicked(env, Click("/world/agents/prey", 3, 75.0)) == "prey_3"
    assert focus.name_clicked(env, Click("/world/agents/prey", 6, 95.0)) is None
    assert focus.name_clicked(env, Click("/world/agents/predator", 0)) == "predator_12"
    for word in ("prey_6", "prey_4", "prey_900", "wolf_1", ""):
        with pytest.raises(EcologyError, match="focus"):
            focus.turn(env, word)
    assert (focus.wanted, focus.first) == ({}, None)


def test_the_latest_clicks_wait_for_a_sample():
    """Clicks of several threads are all kept, up to a number; of more, the last."""
    kept = FocusRequests()
    threads = [threading.Thread(target=kept.click, args=(Click("/world/agents/prey", i),)) for i in range(10)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(click.row for click in kept.clicks()) == list(range(10))
    for i in range(1_000):
        kept.click(Click("/world/agents/prey", i))
    assert [click.row for click in kept.clicks()] == list(range(1_000 - focus_requests.KEPT, 1_000))
    assert kept.clicks() == []


def test_a_run_answers_who_asks(tmp_path, monkeypatch):
    """`ask` returns what the run says or raises it, and leaves nothing; of a run that has ended it says so."""
    monkeypatch.setattr(focus_requests, "PAUSE", 0.01)
    kept, said = FocusRequests(tmp_path), []

    def serve():
        while len(said) < 2:
            if word := kept.word():
                said.append(word)
                kept.answer(word, f"{word} it is" if word == "prey_1" else "nobody", done=word == "prey_1")

    thread = threading.Thread(target=serve)
    thread.start()
    assert focus_requests.request_focus(tmp_path, "prey_1", lambda: True) == "prey_1 it is"
    with pytest.raises(EcologyError, match="nobody"):
        focus_requests.request_focus(tmp_path, "wolf", lambda: True)
    thread.join()
    assert kept.word() is None
    with pytest.raises(EcologyError, match="ecology view"):
        focus_requests.request_focus(tmp_path, "prey_1", lambda: False)
    with pytest.raises(EcologyError, match="did not answer"):
        focus_requests.request_focus(tmp_path, "prey_1", lambda: True, patience=0.05)
    with pytest.raises(EcologyError, match="cannot be written"):
        focus_requests.request_focus(tmp_path / "nowhere", "prey_1", lambda: True)
    assert list(tmp_path.iterdir()) == []


def test_a_word_brings_an_agent_into_focus(tmp_path, monkeypatch):
    """A run that lives takes the word of its folder at a sample, and answers; who is not alive is refused."""
    monkeypatch.setattr(focus_requests, "PAUSE", 0.01)
    path, said = tmp_path / "recording.rrd", []

    def leave(word):
        def asked():
            try:
                said.append(focus_requests.request_focus(tmp_path, word, lambda: True))
            except EcologyError as error:
                said.append(str(error))

        threads.append(threading.Thread(target=asked))
        threads[-1].start()
        while not (tmp_path / focus_requests.FILE).exists():
            pass

    threads: list[threading.Thread] = []
    deeds = {9: lambda: leave("predator_13"), 12: lambda: threads[-1].join(),
             17: lambda: leave("prey_999"), 20: lambda: threads[-1].join()}  # fmt: skip
    live(calm(), rerun_observer(path, every=10, requests=FocusRequests(tmp_path)), Hands(deeds))
    assert said[0] == "predator_13 is in focus from tick 10 on"
    assert "no prey_999 lives at tick 20" in said[1]
    names = {t: v[0] for t, v in told(path, "/world/focus/predator/name", "Points2D:labels").items()}
    assert (names[0], names[10]) == ("predator_12", "predator_13")
    assert [file.name for file in tmp_path.iterdir()] == ["recording.rrd"]


# ---- after the fact ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lived(tmp_path_factory):
    """Return a run of the village whose slots are used again: its recording, its states, its end."""
    path, witness, kept = tmp_path_factory.mktemp("lived") / "recording.rrd", Witness(), FocusRequests()

    class Weighing(Wanderer):
        decides = True

        def decision(self, slot):
            return choice(age=2, error=np.zeros(len(self.group.layout.names)))

    def click():  # on the youngest that was there four ticks ago
        before, now = witness.states[36], witness.states[40]
        lives = before.alive[:16] & now.alive[:16] & (before.serial[:16] == now.serial[:16])
        kept.click(Click("/world/agents/prey", int(np.where(lives, now.serial[:16], -1).argmax())))

    deeds = {40: click}
    env = live(village(), witness, Hands(deeds), rerun_observer(path, every=2, requests=kept), mind=Weighing, ticks=120)
    return path, witness, env


def hindsight(path):
    """Return what looks into the recording; rerun is loaded by the tests that use it."""
    from ecology.observers.hindsight import Hindsight

    return Hindsight(path, village(), "lived")


def test_any_life_is_drawn_after_the_fact(lived, tmp_path):
    """Needs, drive, reward, action and place of any agent are those of its life alone, also in a slot used again."""
    path, witness, env = lived
    past, rows = hindsight(path), env.groups["prey"].slots
    born_late = int(witness.states[120].serial[rows].max())
    for serial in (1, born_late):
        when = {t: np.flatnonzero(s.alive[rows] & (s.serial[rows] == serial))
                for t, s in enumerate(witness.states) if t % 2 == 0}  # fmt: skip
        when = {t: int(slot[0]) for t, slot in when.items() if slot.size}
        assert when
        layer, who = tmp_path / f"{serial}.rrd", f"prey_{serial}"
        layer.write_bytes(past.layer(who))
        needs, deviation = (told(layer, f"/chosen/{who}/{word}") for word in ("needs", "deviation"))
        drive, reward = (told(layer, f"/chosen/{who}/{word}") for word in ("drive", "reward"))
        places = told(layer, f"/world/chosen/{who}/name", "Points2D:positions")
        lives = {tick for tick, value in deviation.items() if np.isfinite(value).all()}
        assert lives == set(when)
        assert max(deviation) - max(lives) <= 120
        for tick, slot in when.items():
            state = witness.states[tick]
            assert needs[tick][:2] == pytest.approx([state.internal[slot, 0], 2.0], abs=1e-5)
            assert deviation[tick] == pytest.approx(state.internal[slot, 0] - 2.0, abs=1e-5)
            living = state.alive[rows]
            own = state.own_drive[slot]
            parts = [state.drive[slot], own, state.drive[slot] - own, state.drive[rows][living].mean()]
            assert drive[tick] == pytest.approx(parts, abs=1e-5)
            assert reward[tick][0] == pytest.approx(witness.ticks[tick].reward[slot] if tick else 0.0, abs=1e-5)
            assert places[tick][0, 0] == pytest.approx(state.position[slot, 0], abs=1e-5)
        acts = {t: v[0] for t, v in told(layer, f"/chosen/{who}/action", "StateChange:state").items()}
        shown = ""
        for tick in sorted(when):
            shown = acts.get(tick, shown)
            after = tick and witness.states[tick].action[when[tick]]
            assert shown == (env.groups["prey"].actions[after] if tick else "")
        if max(when) < 120:
            assert acts[max(when) + 2] == ""


def test_what_was_not_recorded_is_said(lived, tmp_path):
    """What an agent weighed is shown where it was in focus; elsewhere its panel says that it was not."""
    path, witness, _ = lived
    layer = tmp_path / "layer.rrd"
    names = {t: str(v[0]) for t, v in told(path, "/world/focus/prey/name", "Points2D:labels").items()}
    who = names[40]
    assert min(tick for tick, name in names.items() if name == who) == 40
    serial = int(who.removeprefix("prey_"))
    first = min(t for t, s in enumerate(witness.states) if t % 2 == 0 and (s.alive & (s.serial == serial))[:16].any())
    layer.write_bytes(hindsight(path).layer(who))
    texts = {t: v[0] for t, v in told(layer, f"/chosen/{who}/decision", "TextDocument:text").items()}
    assert "was not in focus here" in texts[first]
    assert "ticks 40 to" in texts[first]
    assert "chosen at 38, tick 2" in texts[40]
    assert sorted(texts)[:2] == [first, 40]


def test_a_recording_is_shown_with_another_focus(lived, tmp_path):
    """The file that is shown holds all that the recording does, the life, and one layout that shows it first."""
    from rerun.chunk import RrdReader

    path, _, _ = lived
    before = path.read_bytes()
    shown = hindsight(path).write_view("predator_13", tmp_path / "shown.rrd")
    assert path.read_bytes() == before
    reader = RrdReader(str(shown))
    assert len(reader.recordings()) == 1
    assert len(reader.blueprints()) == 1
    assert reader.recordings()[0].recording_id == RrdReader(str(path)).recordings()[0].recording_id
    there = {chunk.entity_path for chunk in reader.stream()}
    assert there >= {chunk.entity_path for chunk in RrdReader(str(path)).stream()}
    assert {"/chosen/predator_13/needs", "/world/chosen/predator_13"} <= there
    layout = reader.stream(store=reader.blueprints()[0])
    words = " ".join(str(column) for chunk in layout for column in chunk.to_record_batch().columns)
    assert "view field of predator_13" in words
    assert "/chosen/predator_13/needs" in words
    assert "/focus/prey/needs" in words


def test_a_focus_that_died_is_said_to_be_dead(lived, tmp_path):
    """The panels of an agent that died name the last recorded tick at which it lived; of one that lives, none."""
    from rerun.chunk import RrdReader

    path, witness, env = lived
    past, rows = hindsight(path), env.groups["prey"].slots

    def titles(who):
        shown = RrdReader(str(past.write_view(who, tmp_path / f"{who}.rrd")))
        layout = shown.stream(store=shown.blueprints()[0])
        return " ".join(str(column) for chunk in layout for column in chunk.to_record_batch().columns)

    end = witness.states[120]
    lives = end.serial[rows][end.alive[rows]]
    dead = next(n for n in witness.states[0].serial[rows] if n >= 0 and n not in lives)
    last = max(
        t for t, s in enumerate(witness.states) if t % 2 == 0 and (s.alive[rows] & (s.serial[rows] == dead)).any()
    )
    assert f"prey_{dead} (dead after tick {last})" in titles(f"prey_{dead}")
    assert "dead after" not in titles(f"prey_{lives[0]}")


def test_a_click_after_the_fact_means_who_was_there(lived):
    """The one that had the slot at the tick that was shown; nobody of what is no agent; nobody unknown."""
    path, witness, env = lived
    past, rows = hindsight(path), env.groups["prey"].slots
    first, last = witness.states[0].serial[rows], witness.states[120].serial[rows]
    row = int(np.flatnonzero(first != last)[0])
    assert past.who(Click("/world/agents/prey", row, 0.0)) == f"prey_{first[row]}"
    assert past.who(Click("/world/agents/prey", row, 121.0)) == f"prey_{last[row]}"
    assert past.who(Click("/world/agents/prey", row)) == f"prey_{last[row]}"
    assert past.who(Click("/world/agents/prey", row, -5.0)) == f"prey_{first[row]}"
    for entity, at in (("/world/walls", 0), ("/world/agents/prey", 99), ("/world/agents/wolf", 0)):
        assert past.hear(Click(entity, at, 10.0)).startswith("Nobody was there at tick 10")
    assert past.hear(Click("/world/agents/prey", row, 10.0))[:3] == b"RRF"
    for word in ("prey_999", "wolf", "prey_", "hungriest", "prey_x"):
        with pytest.raises(EcologyError, match="focus"):
            past.layer(word)


def test_a_drive_that_was_not_recorded_is_that_of_its_needs(tmp_path):
    """Of many, where the internal state alone is recorded, the drive follows from it, and there is no reward."""
    witness, path, layer = Witness(), tmp_path / "recording.rrd", tmp_path / "layer.rrd"
    live(calm(), witness, rerun_observer(path, every=5, detail="lean"))
    for who, slot in (("prey_2", 2), ("predator_12", 16)):
        layer.write_bytes(hindsight(path).layer(who))
        drive = told(layer, f"/chosen/{who}/drive")
        for tick in (0, 5, 10):
            assert drive[tick][0] == pytest.approx(witness.states[tick].own_drive[slot], abs=1e-5)
        assert not told(layer, f"/chosen/{who}/reward")


def test_one_agent_alone_is_always_in_focus(tmp_path):
    """Of a world with one agent nothing is drawn twice, and a click changes nothing."""
    path = tmp_path / "recording.rrd"
    live(one(), rerun_observer(path, every=5))
    from ecology.observers.hindsight import Hindsight

    past = Hindsight(path, one(), "alone")
    assert past.hear(Click("/world/agents/agent", 0)) is None
    shown = past.write_view("agent_0", tmp_path / "shown.rrd")
    assert told(shown, "/focus/agent/needs").keys() == told(path, "/focus/agent/needs").keys()
    assert not told(shown, "/chosen/agent_0/needs")
