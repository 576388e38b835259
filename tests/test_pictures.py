"""Pictures of runs: films, screenshots and what says that there is none."""
# ruff: noqa: D102

# ruff: noqa: D102

import contextlib
import dataclasses
import errno
import pathlib
import sys
import types

import numpy as np
import pytest
from observed import (
    TICKS,
    Witness,
    live,
    many,
    one,
    refused,
    rerun_observer,
    strict,  # noqa: F401  (a fixture)
    village,
)

import ecology
from ecology import Ecology, EcologyError
from ecology.ground import scatter
from ecology.observers import picture, viewer
from ecology.observers.frame import frame


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


def test_view_says_what_is_wrong(tmp_path, monkeypatch):
    """A missing, foreign or unreadable recording, and a machine without a screen, are told in one error."""
    with pytest.raises(EcologyError, match="no recording at"):
        viewer.view(tmp_path)
    path = tmp_path / "recording.rrd"
    path.write_text("something else")
    with pytest.raises(EcologyError, match="not a Rerun recording"):
        viewer.view(tmp_path)
    path.write_bytes(b"RRF2" + bytes(60))
    assert not viewer.join_recordings([path], path)
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
        assert viewer.is_complete(pathlib.Path(path))

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
    env.set_state(position=scatter(env.scenario.arena, 0.2, env.size, np.random.default_rng(1)))
    after = picture.draw_picture(env.scenario, env.state_view)
    assert (before != after).any()
    assert np.array_equal(after, env.render())


def test_a_resource_that_covers_the_room_colours_the_floor():
    """Within the walls alone, as far as it is full; the walls stay black, and its name is in the legend."""
    scenario = ecology.scenarios.load("colony")
    env = Ecology(scenario, render_mode="rgb_array")
    env.reset_arrays(seed=0)
    shown = frame(scenario, env.state_view)
    drawn = picture.Picture(scenario)
    full, empty = (drawn.draw(dataclasses.replace(shown, full=np.full(1, share))) for share in (1.0, 0.0))
    changed = (full != empty).any(axis=-1)
    assert (empty[changed] == 255).all(axis=-1).mean() > 0.95  # of a white floor
    assert changed.mean() > 0.3
    rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
    across = full[(rows[0] + rows[-1]) // 2]
    assert (across[columns[0] - 3 : columns[0]] == 0).all(axis=-1).any()  # the wall beside it
    words = [text.get_text() for legend in drawn._figure.legends for text in legend.get_texts()]
    assert "food: everywhere" in words
