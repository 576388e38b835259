"""A real browser touches a run: the page of `run --serve` from its first tick to a look back.

Needs Playwright and a Chromium, and some minutes: `make browser` runs it, and nothing else does. Every wait is for a
condition. The stages have names, which a failure tells with what the page says.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from same_end import same_end

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), ""
)
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PATIENCE = 900.0  # seconds for one condition; the viewer is drawn by the processor, about once a second
DECISIONS = 6  # after which the plan must be another, at most
YOUTH, END = 1_000, 1_100  # ticks
GARDEN = """
'''Two animals that feel for each other, water and a food between them.'''
from ecology import Arena, Empathy, Need, Resource, Scenario, Species, consume, go_to, move, rest, turn

def build(ticks=2000):
    needs = (Need(name="thirst", set_point=1.0, decay=0.01, bounds=(0.0, 2.0)),
             Need(name="hunger", set_point=1.0, decay=0.01, bounds=(0.0, 2.0)))
    actions = (rest(), move("walk", 0.1), turn("left", 0.4), turn("right", -0.4), consume("water", {"thirst": 0.1}),
               consume("food", {"hunger": 0.1}), go_to("water", 0.1), go_to("food", 0.1))
    animal = Species(name="animal", count=2, needs=needs, actions=actions, view_range=6.0, radius=0.1,
                     empathy=Empathy(weight=0.5))
    resources = (Resource(name="water", position=(1.0, 1.0), radius=0.4),
                 Resource(name="food", position=(3.0, 3.0), radius=0.4))
    return Scenario(name="garden", arena=Arena(vertices=((0, 0), (4, 0), (4, 4), (0, 4))), species=(animal,),
                    resources=resources, ticks=ticks)
"""

pytestmark = [
    pytest.mark.skipif("ECOLOGY_BROWSER" not in os.environ, reason="takes minutes; `make browser` runs it"),
    pytest.mark.skipif(importlib.util.find_spec("playwright") is None, reason="Playwright is not installed"),
    pytest.mark.skipif(not CHROMIUM, reason="there is no Chromium"),
]


def command(*words: str) -> list[str]:
    """Return the command line of `ecology` with `words`."""
    return [sys.executable, "-c", "from ecology.lab.cli import main; import sys; main(sys.argv[1:])", *words]


@contextlib.contextmanager
def stage(name: str, page: Any = None) -> Iterator[None]:
    """Say in which stage something failed, with what the page said, and keep a picture of it."""
    began = time.monotonic()
    try:
        yield
    except BaseException as error:
        said = ""
        if page is not None:
            with contextlib.suppress(Exception):
                said = f"; the bar says {page.inner_text('#bar')!r}"
                keep_picture(page, f"failed in {name}")
        error.add_note(f"stage: {name}, after {time.monotonic() - began:.0f} s{said}")
        raise
    print(f"{name}: {time.monotonic() - began:.0f} s", flush=True)


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return a browser's page on a run of the garden, in ./run, that is resumed and paused."""
    from playwright.sync_api import sync_playwright

    monkeypatch.chdir(tmp_path)
    Path("garden.py").write_text(GARDEN)
    with stage("live until there is something to plan with"):
        words = ("run", "garden.py", "--ticks", f"{YOUTH}", "--out", "run", "--record", "every=5", "--quiet")
        subprocess.run(command(*words), check=True)
    words = ("run", "--resume", "run", "--ticks", f"{END}", "--serve", "--paused")
    run = subprocess.Popen(command(*words), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert run.stdout is not None
    try:
        with stage("serve"):
            lines = iter(run.stdout)
            found = (re.search(r"watch in a browser: (\S+)", line) for line in lines)
            address = next((each[1] for each in found if each), "")
            assert address, f"the run stopped with {run.wait()}"
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS, timeout=1000 * PATIENCE)
            shown = browser.new_page(viewport={"width": 700, "height": 560})
            shown.set_default_timeout(1000 * PATIENCE)
            with stage("open the page", shown):
                shown.goto(f"{address}?renderer=webgl")
                shown.wait_for_selector("#said", state="detached")
                until(shown, lambda: shown.evaluate("tickShown()") is not None, "the viewer shows no tick")
            yield shown
            browser.close()
    finally:
        run.send_signal(signal.SIGTERM)  # SIGINT is ignored by what a shell started in the background
        try:
            run.wait(PATIENCE)
        finally:
            run.kill()
            run.stdout.close()


def until(page: Any, what: Callable[[], bool], why: str) -> None:
    """Wait until something holds."""
    end = time.monotonic() + PATIENCE
    while not what():
        assert time.monotonic() < end, why
        page.wait_for_timeout(200)  # while Playwright hears the browser


def clock(page: Any) -> str:
    """Return what the bar says of the time."""
    return " ".join(page.inner_text("#clock").split())


def step(page: Any, tick: int) -> None:
    """Step one tick, to `tick`."""
    page.keyboard.press("ArrowRight")
    until(page, lambda: clock(page).startswith(f"tick {tick:,} of {END:,}"), f"no step to {tick}")


def plan(page: Any) -> str:
    """Return the plan of the agent in focus, once there is one."""
    until(page, lambda: "plan:" in page.inner_text("#focused"), "no plan is shown")
    return str(page.inner_text("#focused").partition("plan:")[2])


def decide(page: Any) -> None:
    """Go to the next decision of the agent in focus."""
    before = clock(page)
    page.keyboard.press("ArrowDown")
    until(page, lambda: clock(page) != before and "paused" in clock(page), "no next decision")


def keep_picture(page: Any, name: str) -> None:
    """Keep a picture of the page where ECOLOGY_BROWSER names a folder."""
    if (folder := Path(os.environ["ECOLOGY_BROWSER"])).is_dir():
        page.screenshot(path=str(folder / f"{name}.png"))


def test_a_browser_touches_a_run(page: Any) -> None:
    """It steps, drags a food, sees another plan, cuts empathy, forks, lives to the end, looks back and reloads.

    The log of the run, replayed, gives the same life bit for bit, and so does that of its fork.
    """
    with stage("step", page):
        assert clock(page) == f"tick {YOUTH:,} of {END:,} · paused"
        for tick in range(1, 4):
            step(page, YOUTH + tick)
        before = plan(page)
        keep_picture(page, "1-stepped")

    with stage("drag the food to the other corner", page):
        page.keyboard.press("m")
        food = page.locator('#map [data-name="food"]')
        food.wait_for()
        box, field = food.bounding_box(), page.locator("#map polygon").bounding_box()
        page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
        page.mouse.down()
        page.mouse.move(field["x"] + 0.2 * field["width"], field["y"] + 0.3 * field["height"], steps=4)
        page.mouse.up()
        until(page, lambda: "food" in page.inner_text("#done"), "the food was not moved")
        page.keyboard.press("Escape")

    with stage("see another plan", page):
        for _ in range(DECISIONS):
            decide(page)
            if plan(page) != before:
                break
        assert plan(page) != before
        keep_picture(page, "2-dragged")

    with stage("cut empathy", page):
        page.keyboard.press("i")
        page.fill("#deed input", "empathy animal off")
        page.keyboard.press("Enter")
        until(page, lambda: "empathy" in page.inner_text("#deed-said"), "empathy was not cut")
        page.keyboard.press("Escape")

    with stage("fork", page):
        at = int(clock(page).split()[1].replace(",", ""))
        page.keyboard.press("k")
        page.fill("#split input", "empathy animal on")
        page.keyboard.press("Enter")
        forked = f"fork run-at-{at} since {at:,}: 2 animal"
        until(page, lambda: forked in page.inner_text("#forked"), "there is no fork")
        page.keyboard.press("Escape")
        step(page, at + 1)
        keep_picture(page, "3-forked")

    with stage("let both live to the end", page):
        page.keyboard.press(" ")
        until(page, lambda: "· over" in clock(page), "the run does not end")
        assert page.inner_text("#lag").startswith("The run is over. It lies in ")

    with stage("look back", page):
        page.click("#back")  # which is there when the recording is in order
        until(page, lambda: clock(page) == "recorded: looking back", "nothing looks back")
        page.wait_for_selector("#said", state="detached")
        until(page, lambda: page.evaluate("tickShown()") is not None, "the viewer shows no tick")
        keep_picture(page, "4-back")

    with stage("reload", page):
        page.reload()
        page.wait_for_selector("#said", state="detached")
        assert clock(page) == "recorded: looking back"
        assert page.title().startswith("run")
        keep_picture(page, "5-reloaded")

    page.close()  # a browser that draws slows what follows
    with stage("replay"):
        check_replays(at)


def check_replays(at: int) -> None:
    """Repeat the run and its fork by what they kept, and compare the ends bit for bit."""
    log = Path("run/interventions.jsonl").read_text()
    assert log.count("\n") == 2
    assert '"do": "move food ' in log
    assert '"do": "empathy animal off"' in log
    quiet = ("--quiet", "--no-record")
    for lived, again in (("run", "again"), (f"run-at-{at}", "other")):
        words = ("run", "--config", "run/config.toml", "--replay", f"{lived}/interventions.jsonl", "--out", again)
        subprocess.run(command(*words, "--trust", *quiet), check=True)
        same_end(lived, again)
