"""What does not change in a recording: the arena, the legend, names and colours of what is drawn over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr

from ecology.ground.outline import drawn_lines
from ecology.observers import colours, maps, places
from ecology.observers.scene import (
    BACKGROUND,
    DRIVE_SCALE,
    FAINT,
    FLOOR,
    INK,
    MARKED,
    STEPS,
    WALL,
    Scene,
    losses,
)
from ecology.spec import Species


def open_scene(rec: rr.RecordingStream, scene: Scene) -> None:
    """Draw what does not change."""
    rec.set_log_time_enabled(False)
    rec.send_recording_name(scene.run)
    rec.log("world", rr.Transform3D(mat3x3=[[1, 0, 0], [0, -1, 0], [0, 0, 1]]), static=True)
    shown = colours.scale(DRIVE_SCALE)[np.linspace(0, colours.SHADES - 1, STEPS).round().astype(int)]
    top = colours.highest_drive(scene.scenario)
    rec.log(
        "world",
        rr.AnnotationContext(
            [
                (i, f"drive {'≥ ' * (i == STEPS - 1)}{top * i / (STEPS - 1):.2f}", c.tolist())
                for i, c in enumerate(shown)
            ]
        ),
        static=True,
    )
    _draw_arena(rec, scene)
    _draw_legend(rec, scene)
    for name, group in scene.groups.items():
        _open_species(rec, scene, name, scene.scenario.species[group.index])
    for kind, shade in MARKED.items():
        rec.log(
            f"world/marks/{kind}",
            rr.LineStrips2D.from_fields(colors=[shade], radii=rr.Radius.ui_points(0.8), draw_order=25),
            static=True,
        )
    _open_population(rec, scene)


def _draw_arena(rec: rr.RecordingStream, scene: Scene) -> None:
    arena = scene.scenario.arena
    corners, shade = np.array(arena.vertices, float), FAINT if arena.torus else WALL
    rec.log("world/walls", rr.LineStrips2D(drawn_lines(arena), colors=[shade], draw_order=5), static=True)
    fine = maps.cover(arena, 400)
    floor = np.where(fine.inside[..., None], FLOOR, BACKGROUND).astype(np.uint8)
    _lay(rec, "world/floor", fine.corner, (fine.cell, fine.cell))
    rec.log("world/floor", rr.Image(floor, draw_order=-30), static=True)
    rough = places.grid_of(arena)
    for each in scene.scenario.fields:
        _lay(rec, f"world/fields/{each.name}", rough.corner, (rough.cell, rough.cell))
    # axes: a number at round places below and left of the arena
    low, high = corners.min(axis=0), corners.max(axis=0)
    step = _round_step(scene.size / 8)
    spots, words = [], []
    for axis in range(2):
        for value in np.arange(np.ceil(low[axis] / step) * step, high[axis] + 1e-9, step):
            place = low - 0.035 * scene.size
            place[axis] = value
            spots.append(place)
            words.append(f"{'xy'[axis]} {value:g}" if value == low[axis] else f"{value:g}")
    _write(rec, "world/axes", spots, words)


def _draw_legend(rec: rr.RecordingStream, scene: Scene) -> None:
    """Write the colour scale of the drive above the arena, and above it what else has a colour."""
    low, high = np.array(scene.scenario.arena.extent)
    size = scene.size
    top, wide, tall = high[1] + 0.06 * size, 0.3 * size, 0.02 * size
    bar = np.tile(colours.scale(DRIVE_SCALE), (2, 1, 1))  # (2, SHADES, 3)
    _lay(rec, "world/legend/drive", (float(low[0]), float(top)), (wide / bar.shape[1], tall / 2))
    rec.log("world/legend/drive", rr.Image(bar), static=True)
    what = "heading: drive 0" if scene.mixed else "body: drive 0"
    places = [(low[0] + 0.02 * size, top), (low[0] + wide, top)]
    _write(rec, "world/legend/numbers", places, [what, f"{colours.highest_drive(scene.scenario):.1f}"])
    for i, row in enumerate(scene.legend_rows()):
        y = high[1] + (0.12 + 0.055 * i) * size
        xs = np.array([low[0] + at + 0.012 * size for at, _, _ in row])
        shades = [shade for _, _, shade in row]
        dots = np.stack([xs, np.full(len(row), y)], axis=1)
        rec.log(f"world/legend/{i}", rr.Points2D(dots, radii=0.009 * size, colors=shades), static=True)
        middle = [(x + (0.02 + 0.006 * len(word)) * size, y + 0.022 * size)
                  for x, (_, word, _) in zip(xs, row, strict=True)]  # fmt: skip
        _write(rec, f"world/legend/{i}/words", middle, [word for _, word, _ in row])


def _open_species(rec: rr.RecordingStream, scene: Scene, name: str, species: Species) -> None:
    colour, radius = scene.colour(name), scene.radius(species)
    body = f"world/agents/{name}"
    # the other one is coloured by class: the drive
    of_body, of_arrow = ([colour], None) if scene.mixed else (None, [colour])
    points = rr.Points2D.from_fields(radii=radius, colors=of_body, show_labels=False, draw_order=20)
    rec.log(body, points, static=True)
    arrows = rr.Arrows2D.from_fields(radii=0.2 * radius, colors=of_arrow, show_labels=False)
    rec.log(body, arrows, static=True)
    trail = colours.shaded(colour, 0.6)
    rec.log(f"world/trail/{name}", rr.Points2D.from_fields(radii=0.25 * radius, colors=[trail], draw_order=10),
            static=True)  # fmt: skip
    open_life(rec, scene, name, species)
    for part, told in zip(("losses", "numbers"), losses(scene.told[name]), strict=True):
        if told:
            _series(rec, f"learning/{name}/{part}", told, colours.PALETTE)
    if scene.decides[name]:
        layout = scene.groups[name].layout
        _series(rec, f"learning/{name}/error", layout.names, [colours.need_colour(i) for i in range(len(layout.names))])
        _series(rec, f"learning/{name}/J", ["-ln(gamma) J"], [colours.PALETTE[0]])
        _series(rec, f"learning/{name}/met", ["drive met afterwards, discounted"], [colours.PALETTE[1]])
    for i in maps.mapped_needs(species) if scene.mapped.get(name) else ():
        _lay(
            rec,
            f"world/maps/{name}/{species.needs[i].name}/image",
            scene.grid.corner,
            (scene.grid.cell,) * 2,
        )


def open_life(rec: rr.RecordingStream, scene: Scene, name: str, species: Species) -> None:
    """Name and colour what is drawn of the life of a species' focus."""
    thin = rr.Radius.ui_points(0.4)
    rec.log(f"world/{scene.at(name)}", rr.LineStrips2D.from_fields(colors=[FAINT], radii=thin, draw_order=15),
            static=True)  # fmt: skip
    label = rr.Points2D.from_fields(radii=1e-4, colors=[INK], show_labels=True, draw_order=30)
    rec.log(f"world/{scene.at(name)}/name", label, static=True)
    base, shades = scene.at(name), [colours.need_colour(i) for i in range(len(species.needs))]
    _series(rec, f"{base}/deviation", [need.name for need in species.needs], shades)
    words, lines = [], []
    for need, shade in zip(species.needs, shades, strict=True):
        words += [need.name, "set point", "lower bound", "upper bound"]
        lines += [shade, INK, FAINT, FAINT]
    _series(rec, f"{base}/needs", words, lines, [2.0, 1.0, 1.0, 1.0] * len(species.needs))
    many = scene.groups[name].size > 1
    who = scene.chosen.get(name, "in focus" if many else scene.names[name])
    feels = species.empathy is not None
    words = [who, *(["its own", "felt of others"] * feels), *(["mean of the species"] * many)]
    felt = [colours.PALETTE[1], colours.PALETTE[5]] * feels
    _series(rec, f"{base}/drive", words, [(240, 240, 240), *felt, colours.PALETTE[0]])
    _series(rec, f"{base}/shares", [need.name for need in species.needs], shades)
    _series(rec, f"{base}/reward", ["reward"], [colours.PALETTE[1]])
    rec.log(
        f"{base}/action",
        rr.StateConfiguration(
            values=[a.name for a in species.actions],
            labels=[a.name for a in species.actions],
            colors=colours.packed(np.array(colours.action_colours(scene.scenario, species), np.uint8)),
        ),
        static=True,
    )


def _open_population(rec: rr.RecordingStream, scene: Scene) -> None:
    """Name and colour the series of the populations."""
    if not scene.crowd:
        return
    names, shades = list(scene.groups), [scene.colour(name) for name in scene.groups]
    dim = [colours.shaded(shade, 0.55) for shade in shades]
    _series(rec, "population/count", names, shades, [2.0] * len(names))
    _series(rec, "population/flow", [f"{n} born" for n in names] + [f"{n} died" for n in names], shades + dim)
    words = [word for n in names for word in (n, f"{n} - sd", f"{n} + sd")]
    thrice = [each for shade, faint in zip(shades, dim, strict=True) for each in (shade, faint, faint)]
    _series(rec, "population/drive", words, thrice, [2.0, 0.8, 0.8] * len(names))
    if scene.stocked:
        food = dict(
            zip((r.name for r in scene.scenario.resources), colours.resource_colours(scene.scenario), strict=True)
        )
        _series(rec, "population/stocks", scene.stocked, [food[n] for n in scene.stocked])
    if scene.measures:
        _series(rec, "population/measures", scene.measures, colours.PALETTE)


def _round_step(least: float) -> float:
    """Return 1, 2 or 5 times a power of ten, at least `least`."""
    power = 10.0 ** np.floor(np.log10(least))
    return float(power * next(m for m in (1, 2, 5, 10) if m * power >= least * (1 - 1e-9)))


def _lay(rec: rr.RecordingStream, entity: str, corner: tuple[float, float], cell: tuple[float, float]) -> None:
    """Lay the images of `entity` on the plane: lower left corner, size of a pixel."""
    rec.log(entity, rr.Transform3D(translation=[*corner, 0], scale=[*cell, 1]), static=True)


def text(places: Any, words: Sequence[str], shades: Sequence[colours.Colour]) -> tuple[rr.Points2D]:
    """Return words just below `places` (n, 2)."""
    return (rr.Points2D(places, radii=1e-4, labels=list(words), colors=shades, show_labels=True, draw_order=30),)


def _write(rec: rr.RecordingStream, entity: str, places: Any, words: Sequence[str]) -> None:
    rec.log(entity, *text(places, words, [INK] * len(words)), static=True)


def _series(
    rec: rr.RecordingStream,
    entity: str,
    words: Sequence[str],
    shades: Sequence[colours.Colour],
    widths: Sequence[float] | None = None,
) -> None:
    several = [shades[i % len(shades)] for i in range(len(words))]
    lines = rr.SeriesLines(names=list(words), colors=several, widths=widths or [1.5] * len(words))
    rec.log(entity, lines, static=True)
