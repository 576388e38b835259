"""What a run does, drawn over time: samples turned into Rerun's columns, by panel.

A recording holds one entity per species for its bodies, however many they are, and one agent in
focus per species whose needs, drive, decision and deviation maps are drawn over time. The panels, a file each in
panels/, say what is sampled and drawn:

    world/walls, world/axes, world/legend       static, in the units of the plane
    world/fields/NAME, world/doors              fields as images that shine through, and the doors that are closed
    world/resources, .../stock, .../names       circles, how full they are, and what they are called
    world/agents/SPECIES    Points2D and Arrows2D: bodies and headings, a row per slot; internal
                            variables, serial and action as numbers; in full, drive and reward too
    world/trail/SPECIES     Points2D: where bodies were at every tick since the last sample
    world/focus/SPECIES     LineStrips2D: view field and lines of sight of the agent in focus; its name
    world/marks/KIND        LineStrips2D: births, deaths, bites and gifts since the last sample
    world/maps/SPECIES/NEED/image   Image and the numbers of the deviation map behind it
    focus/SPECIES/{needs,deviation,shares,drive,reward,action,decision}    of the agent in focus; with empathy its
                            drive, its own drive, what is felt of others; `shares` of its own drive by need
    learning/SPECIES/{losses,numbers,error,J,met}   of Mind.report(), mean over the living, losses as
                            log10; of the focus: f's error, J, and the discounted drive met afterwards
    population/{count,flow,drive,stocks,measures}, population/ages/SPECIES, population/coupling/SPECIES
    events/SPECIES          TextLog: births, deaths, bites, gifts, meals, sleep
    minds/AGENT/decision    of every agent where there are few: its decisions, as they were made
    fork/...                arena and decisions of the other future, where the run was forked while it was watched
    futures/{living,drive,apart,text}   both futures in one picture, and what differs
    events/interventions    TextLog: what was done from outside

The timeline is "tick". A slot is taken by one agent after another: `serial` says which, and a series
breaks where another life begins.

Rerun's plane has y downwards. Positions are written as they are; the transform of `world`, which
mirrors y, turns the picture, so that y points up on the screen and numbers read there are true.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import rerun as rr

from ecology.observers.layout import FORK, FORKED, blueprint, panels
from ecology.observers.panels.base import Batch, Panel
from ecology.observers.panels.futures import Futures
from ecology.observers.panels.legend import Legend
from ecology.observers.scene import Scene


def open_scene(rec: rr.RecordingStream, scene: Scene) -> None:
    """Draw what does not change."""
    rec.set_log_time_enabled(False)
    rec.send_recording_name(scene.run)
    for panel in panels(scene):
        panel.open(rec)


class Drawing:
    """Draws a scene in a recording, sample by sample."""

    def __init__(self, rec: rr.RecordingStream, scene: Scene) -> None:
        """Begin to draw `scene` in `rec`, where `open_scene` has drawn what does not change."""
        self._rec, self._scene = rec, scene
        self._panels = panels(scene)
        self._fork: tuple[Scene, list[Panel]] | None = None
        self._futures: Futures | None = None

    def draw(self, samples: Sequence[Mapping[str, Any]]) -> None:
        """Send samples, in columns."""
        batch = Batch(self._scene, samples)
        for panel in self._panels:
            panel.draw(self._rec, batch)
        both = [s for s in samples if "fork" in s]
        if both and self._fork is not None and self._futures is not None:
            scene, there = self._fork
            other = Batch(scene, [s["fork"] for s in both])
            for panel in there:
                panel.draw(cast(rr.RecordingStream, Below(self._rec, FORKED)), other)
            self._futures.draw(self._rec, Batch(self._scene, both))

    def draw_final(self, sample: Mapping[str, Any]) -> None:
        """Send what panels draw at the end of the run beside its last sample."""
        batch = Batch(self._scene, [sample])
        for panel in self._panels:
            if panel.key in sample["panels"]:
                panel.draw(self._rec, batch)

    def open_fork(self, scene: Scene) -> None:
        """Begin to draw the other future of the run, whose scene is `scene`, below the entity "fork"."""
        self._scene.fork = scene.run
        self._fork, self._futures = (scene, panels(scene, FORK)), Futures(self._scene)
        for panel in self._fork[1]:
            panel.open(cast(rr.RecordingStream, Below(self._rec, FORKED)))
        self._futures.open(self._rec)
        for panel in self._panels:
            if isinstance(panel, Legend):  # the arena is smaller from now on
                panel.open(self._rec)

    def lay_out(self, first: str | None) -> None:
        """Show the life of the species `first` first from now on."""
        self._scene.first = first
        self._rec.send_blueprint(blueprint(self._scene))


class Below:
    """A recording in which all that is drawn lies below one entity."""

    def __init__(self, rec: rr.RecordingStream, entity: str) -> None:
        self._rec, self._entity = rec, entity
        self.set_time = rec.set_time

    def log(self, entity: str, *what: Any, **how: Any) -> None:
        """Log something."""
        self._rec.log(f"{self._entity}/{entity}", *what, **how)

    def send_columns(self, entity: str, *what: Any) -> None:
        """Log columns."""
        self._rec.send_columns(f"{self._entity}/{entity}", *what)
