"""An archipelago in the Rerun viewer: a tile per island, the migrations, and every island's numbers over time."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from ecology.ground.outline import drawn_lines
from ecology.observers import colours
from ecology.observers.recording_file import RecordingFile, open_stream
from ecology.observers.viewer import join_recordings
from ecology.scenario import Scenario
from ecology.state import Floats

PITCH = 1.25  # from tile to tile, whose longer side is 1
DOT = 0.012  # radius of an agent, in tiles
LABELLED = 400  # islands that have their number beside them, at most
FEW = 12  # islands with a name in the plots, at most
INK, FAINT, WENT = (150, 156, 168), (90, 95, 105), (255, 200, 80)


class Overview:
    """The recording of an archipelago: `recording.rrd` in its folder, a sample per stop of the islands."""

    def __init__(
        self, path: Path, name: str, worlds: Sequence[Scenario], passing: Sequence[str], *, after: int | None = None
    ) -> None:
        """Record the islands `worlds` to `path`; with `after`, continue the recording after that tick.

        `passing` lists the kinds of exchange: "passed" for migrants, "pool" for a common pool.
        """
        self._passing = passing
        self._path, self._worlds, self._target = path, worlds, path
        self._species = list(dict.fromkeys(s.name for world in worlds for s in world.species))
        self._across = math.ceil(math.sqrt(len(worlds)))
        self._highest = max(colours.highest_drive(world) for world in {id(w): w for w in worlds}.values())
        application, identity, layout = "ecology-archipelago-" + re.sub(r"[^A-Za-z0-9_-]", "_", name), None, True
        if after is not None and path.exists():
            from ecology.observers.readback import prepare_to_resume

            self._target, identity, layout = prepare_to_resume(path, after, application)
        self._rec = open_stream(application, identity)
        self._file = RecordingFile(self._target, self._rec)
        if layout:
            self._file.lay_out(self._blueprint(name), application)
        self._open()

    def _open(self) -> None:
        lines = [self._place(i, line) for i, world in enumerate(self._worlds) for line in drawn_lines(world.arena)]
        self._rec.log("world/arenas", rr.LineStrips2D(lines, colors=[INK], radii=rr.Radius.ui_points(0.7)), static=True)
        if len(self._worlds) <= LABELLED:
            places = [self._corner(i) - (0.0, 0.07) for i in range(len(self._worlds))]
            words = [str(i) for i in range(len(self._worlds))]
            dots = rr.Points2D(places, labels=words, colors=[INK], radii=[0.0], show_labels=True)
            self._rec.log("world/numbers", dots, static=True)
        few = len(self._worlds) <= FEW
        for i, name in enumerate(self._species):
            alone = len(self._species) == 1
            shades = [colours.PALETTE[j % len(colours.PALETTE)] if few else FAINT for j in range(len(self._worlds))]
            words = [f"{name}, island {j}" if few else "" for j in range(len(self._worlds))]
            for what in ("population", "drive"):
                lines_ = rr.SeriesLines(colors=shades, names=words, widths=[1.5 if few else 0.7])
                self._rec.log(f"{what}/islands/{name}", lines_, static=True)
                mean = rr.SeriesLines(
                    colors=[colours.species_colour(i, alone=alone)], names=[f"{name}, mean"], widths=[2.5]
                )
                self._rec.log(f"{what}/mean/{name}", mean, static=True)

    def _blueprint(self, name: str) -> rrb.Blueprint:
        tall = -(-len(self._worlds) // self._across)
        bounds = rrb.VisualBounds2D(x_range=[-0.2, self._across * PITCH], y_range=[-0.2, tall * PITCH])
        tiles = rrb.Spatial2DView(
            origin="/world", name=f"{name}: islands, drive of the living (dark to bright), and who went where",
            visual_bounds=bounds, background=(13, 16, 23),
        )  # fmt: skip
        plots = [
            rrb.TimeSeriesView(origin=f"/{what}", name=title)
            for what, title in (
                ("population", "living, per island and their mean"),
                ("drive", "mean drive, per island and their mean"),
                ("passed", "agents that migrated, and that found no room"),
                ("pool", "traits of the pool, mean and standard deviation"),
            )
            if what in ("population", "drive", *self._passing)
        ]
        return rrb.Blueprint(
            rrb.Horizontal(tiles, rrb.Vertical(*plots), column_shares=[1.2, 1]),
            rrb.TimePanel(timeline="tick", state="collapsed"),
            auto_views=False,
            collapse_panels=True,
        )

    def _corner(self, island: int) -> Floats:
        return np.array([island % self._across, island // self._across]) * PITCH

    def _place(self, island: int, points: Floats) -> Floats:
        """Return where points (k, 2) of an island's arena are in the picture; y upwards there, downwards here."""
        (left, bottom), (right, top) = self._worlds[island].arena.extent
        side = max(right - left, top - bottom)
        return self._corner(island) + np.column_stack([points[:, 0] - left, top - points[:, 1]]) / side

    def watch(
        self,
        tick: int,
        places: Sequence[Mapping[str, Floats]],
        living: Sequence[Mapping[str, int]],
        drive: Sequence[Mapping[str, float]],
    ) -> None:
        """Show the islands at a stop: `places` (k, 3) are x, y and drive of the living, per island and species."""
        self._rec.set_time("tick", sequence=tick)
        for i, name in enumerate(self._species):
            crowds = [(j, place[name]) for j, place in enumerate(places) if len(place.get(name, ()))]
            at = [self._place(j, place[:, :2]) for j, place in crowds]
            shade = [colours.shade("inferno", place[:, 2], 0.0, self._highest) for _, place in crowds]
            edge = [] if len(self._species) == 1 else [colours.species_colour(i)]
            self._rec.log(
                f"world/agents/{name}",
                rr.Points2D(
                    np.concatenate(at) if at else np.zeros((0, 2)),
                    colors=np.concatenate(shade) if shade else [],
                    radii=[DOT if not edge else DOT * (1 + 0.4 * i)],
                ),
            )
            counts = [float(island.get(name, 0)) for island in living]
            drives = np.array([island.get(name, math.nan) for island in drive])
            known = drives[np.isfinite(drives)]
            self._rec.log(f"population/islands/{name}", rr.Scalars(counts))
            self._rec.log(f"population/mean/{name}", rr.Scalars(float(np.mean(counts))))
            self._rec.log(f"drive/islands/{name}", rr.Scalars(drives))
            if known.size:
                self._rec.log(f"drive/mean/{name}", rr.Scalars(float(known.mean())))
        self._rec.log("world/went", rr.Clear(recursive=False))

    def show_migrants(self, tick: int, origin: np.ndarray, to: np.ndarray, refused: int) -> None:
        """Show the migrants, with islands `origin` (m,) and `to` (m,), and the number that found no room."""
        self._rec.set_time("tick", sequence=tick)
        ways, count = np.unique(np.column_stack([origin, to]), axis=0, return_counts=True)
        middle = [self._corner(i) + 0.5 for i in range(len(self._worlds))]
        if len(ways):
            arrows = rr.Arrows2D(
                origins=[middle[a] for a, _ in ways],
                vectors=[0.9 * (middle[b] - middle[a]) for a, b in ways],
                colors=[WENT],
                radii=0.002 * np.sqrt(count),
            )
            self._rec.log("world/went", arrows)
        self._rec.log("passed/migrated", rr.Scalars(float(len(origin))))
        self._rec.log("passed/refused", rr.Scalars(float(refused)))

    def show_generation(self, tick: int, traits: Mapping[str, Mapping[str, float]]) -> None:
        """Show the mean and the spread of every trait of a generation that has ended."""
        self._rec.set_time("tick", sequence=tick)
        for name, statistics in traits.items():
            self._rec.log(f"pool/{name}/mean", rr.Scalars(statistics["mean"]))
            self._rec.log(f"pool/{name}/sd", rr.Scalars(statistics["sd"]))

    def flush(self) -> None:
        """Write what was logged into the file."""
        self._file.append()

    def close(self) -> None:
        """Write what is left, and put the file in order."""
        try:
            self._file.append()
        finally:
            self._file.close()
        parts = [self._path] if self._target == self._path else [self._path, self._target]
        join_recordings(parts, self._path)
