"""What a run does, drawn over time: samples and deviation maps turned into Rerun's columns.

A recording holds one entity per species for its bodies, however many they are, and one agent in
focus per species whose needs, drive, decision and deviation maps are drawn over time:

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
    events/SPECIES          TextLog: who was born, died, bit, gave, ate, slept
    events/interventions    TextLog: what was done from outside

Timelines: "tick", and "sim_time" (one unit of the model's time shown as one second). A slot is taken
by one agent after another: `serial` says which, and a series breaks where another life begins.

Rerun's plane has y downwards. Positions are written as they are; the transform of `world`, which
mirrors y, turns the picture, so that y points up on the screen and numbers read there are true.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from ecology import physiology
from ecology.ground.outline import polygon_of
from ecology.observers import census, colours, maps, places, shapes
from ecology.observers.backdrop import text
from ecology.observers.census import Choice, Life
from ecology.observers.layout import blueprint
from ecology.observers.scene import BACKGROUND, DEAD, FAINT, INK, MAP_SCALE, MARKED, STEPS, Scene, losses
from ecology.spec import Species

LINES = {True: 20, False: 5}  # of the event log, per kind and sample, of few and of many; the rest is counted
MARKS = 200  # per kind and sample, at most
DEED = 0xFFD23FFF  # colour of an intervention in the event log
NUMBERS = ("next_drive", "slope", "total", "score", "open")  # of a decision, in the recording
COMPASS = 512  # directions in which a heading is drawn, and recorded for the viewer


class Drawing:
    """Draws a scene in a recording, sample by sample."""

    def __init__(self, rec: rr.RecordingStream, scene: Scene) -> None:
        """Begin to draw `scene` in `rec`, where what does not change is drawn already (see backdrop.py)."""
        self._rec, self._scene = rec, scene
        self._acted: dict[str, int] = {}
        self._resources: np.ndarray | None = None
        self._fields: dict[str, np.ndarray] = {}  # as they were last drawn
        self._doors = b""

    def draw(self, samples: Sequence[Mapping[str, Any]]) -> None:
        """Send samples, in columns."""
        column = {
            key: np.stack([s[key] for s in samples])
            for key in ("tick", "time", "place", "heading", "internal", "drive", "reward", "serial", "action")
        }
        if "set_point" in samples[0]:
            column["set_point"] = np.stack([s["set_point"] for s in samples])
        times = _times(column["tick"], column["time"])
        self._draw_resources(times, samples)
        self._draw_places(samples)
        turn = 2 * np.pi / COMPASS
        angle = (column["heading"] / turn).round() * turn
        way = np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32)  # (n, N, 2)
        top = colours.highest_drive(self._scene.scenario)
        level = (np.clip(np.nan_to_num(column["drive"]) / top, 0, 1) * (STEPS - 1)).round().astype(np.uint16)
        for i, (name, group) in enumerate(self._scene.groups.items()):
            species, rows = self._scene.scenario.species[group.index], group.slots
            each = [group.size] * len(samples)
            numbers = {need.name: column["internal"][:, rows, k] for k, need in enumerate(species.needs)}
            for k, word in enumerate(census.moving(species)):
                if word:
                    numbers[word] = column["set_point"][:, rows, k]
            extra = ("drive", "reward") if self._scene.full else ()
            numbers |= {key: column[key][:, rows] for key in (*extra, "serial", "action")}
            drive = {"class_ids": level[:, rows].reshape(-1)}
            arrow = (2.5 * self._scene.radius(species) * way[:, rows]).reshape(-1, 2)
            at = column["place"][:, rows].reshape(-1, 2)
            self._rec.send_columns(
                f"world/agents/{name}",
                times,
                [
                    *rr.Points2D.columns(positions=at, **({} if self._scene.mixed else drive)).partition(each),
                    *rr.Arrows2D.columns(vectors=arrow, **(drive if self._scene.mixed else {})).partition(each),
                    *rr.AnyValues.columns(
                        **{key: pa.array(value.reshape(-1)) for key, value in numbers.items()}
                    ).partition(each),
                ],
            )
            who = rows if self._scene.few else slice(i, i + 1)
            steps = [s["steps"][:, who].reshape(-1, 2) for s in samples]
            self._rec.send_columns(
                f"world/trail/{name}",
                times,
                rr.Points2D.columns(positions=np.concatenate(steps)).partition([len(s) for s in steps]),
            )
            self._draw_focus(name, species, samples, column)
            told = np.stack([s["told"][name] for s in samples])  # (n, K)
            for part, words in zip(("losses", "numbers"), losses(self._scene.told[name]), strict=True):
                if words:
                    value = told[:, [self._scene.told[name].index(word) for word in words]]
                    if part == "losses":
                        value = np.log10(np.where(value > 0, value, np.nan))
                    _scalars(self._rec, f"learning/{name}/{part}", times, value)
        self._draw_marks(times, samples)
        self._tell(samples)
        if self._scene.crowd:
            self._draw_population(samples, times, column)

    def _draw_focus(
        self,
        name: str,
        species: Species,
        samples: Sequence[Mapping[str, Any]],
        column: Mapping[str, np.ndarray],
    ) -> None:
        shown = [s["focus"][name] for s in samples]
        n, rows = np.arange(len(samples)), self._scene.groups[name].slots
        slot = np.array([f["slot"] for f in shown])
        gap = np.where((slot < 0) | [f["anew"] for f in shown], np.nan, 0.0)  # a series breaks between two lives
        many = self._scene.groups[name].size > 1
        life = Life(
            tick=column["tick"],
            time=column["time"],
            internal=column["internal"][n, slot][:, : len(species.needs)] + gap[:, None],
            set_point=column["set_point"][n, slot][:, : len(species.needs)]
            if "set_point" in column
            else np.array([need.set_point for need in species.needs]),
            drive=column["drive"][n, slot] + gap,
            own=np.array([f.get("own", np.nan) for f in shown]) + gap if species.empathy is not None else None,
            mean=np.array([census.mean(row) for row in column["drive"][:, rows]]) if many else None,
            reward=column["reward"][n, slot] + gap,
            action=np.where(slot < 0, DEAD, column["action"][n, slot]),
            place=np.where((slot < 0)[:, None], np.nan, column["place"][n, slot]),
            names=[f["name"] for f in shown],
            field=[f.get("field", np.empty((0, 2))) for f in shown],
            sight=[f.get("sight", np.empty((0, 2))) for f in shown],
        )
        self.draw_life(name, species, life)
        self._draw_decisions(name, shown, column)

    def draw_life(self, name: str, species: Species, life: Life) -> None:
        """Send what is drawn of the life of a species' focus."""
        base, needs, times = self._scene.at(name), species.needs, _times(life.tick, life.time)
        x, n = life.internal, len(life.tick)
        target = np.broadcast_to(life.set_point, x.shape)
        bounds = np.array([(need.low, need.bounds[1]) for need in needs])
        bounds[~np.isfinite(bounds)] = np.nan
        beside = np.concatenate([target[..., None], np.broadcast_to(bounds, (n, *bounds.shape))], axis=-1)
        _scalars(self._rec, f"{base}/deviation", times, x - target)
        _scalars(self._rec, f"{base}/needs", times, np.concatenate([x[..., None], beside], axis=-1).reshape(n, -1))
        parts = [life.drive, *([] if life.own is None else [life.own, life.drive - life.own])]
        parts += [] if life.mean is None else [life.mean]
        _scalars(self._rec, f"{base}/drive", times, np.stack(parts, axis=1))
        _scalars(self._rec, f"{base}/shares", times, drive_shares(species, x - target))
        if life.reward is not None:
            _scalars(self._rec, f"{base}/reward", times, life.reward[:, None])
        self._draw_action(name, species, life.tick, life.time, life.action)
        # the view field and the lines of sight, in the plane
        strips: list[np.ndarray] = []
        lengths = []
        for at, outline, sight in zip(life.place, life.field, life.sight, strict=True):
            seen = [np.stack([at, there]) for there in sight] + ([outline] if len(outline) else [])
            strips += seen
            lengths.append(len(seen))
        self._rec.send_columns(f"world/{base}", times, rr.LineStrips2D.columns(strips=strips).partition(lengths))
        if self._scene.crowd:
            place = life.place - [0.0, 1.2 * self._scene.radius(species)]
            labels = rr.Points2D.columns(positions=place, labels=life.names)
            self._rec.send_columns(f"world/{base}/name", times, labels)

    def _draw_action(
        self,
        name: str,
        species: Species,
        tick: np.ndarray,
        now: np.ndarray,
        action: np.ndarray,
    ) -> None:
        before = np.concatenate([[self._acted.get(name, -2)], action[:-1]])
        self._acted[name] = int(action[-1])
        changed = np.flatnonzero(action != before)
        if changed.size:
            words = [species.actions[a].name if a != DEAD else "" for a in action[changed]]
            self._rec.send_columns(
                f"{self._scene.at(name)}/action",
                _times(tick[changed], now[changed]),
                rr.StateChange.columns(state=words),
            )

    def _draw_decisions(self, name: str, shown: Sequence[Mapping[str, Any]], column: Mapping[str, np.ndarray]) -> None:
        """Write what the agent in focus weighs, and how its f and its J fare."""
        gone = [i for i, f in enumerate(shown) if f["slot"] < 0 and f["anew"]] if self._scene.decides[name] else []
        if gone:
            self._rec.send_columns(
                f"focus/{name}/decision",
                _times(column["tick"][gone], column["time"][gone]),
                rr.TextDocument.columns(
                    text=["nobody is in focus"] * len(gone), media_type=["text/markdown"] * len(gone)
                ),
            )
        choices = [choice for f in shown for choice in f.get("choices", ())]
        if choices:
            told = [choice.decision for choice in choices]
            numbers = {
                key: np.concatenate([np.asarray(getattr(d, key), bool if key == "open" else float) for d in told])
                for key in NUMBERS
            }
            each = [len(d.options) for d in told]
            text = [decision_text(choice) for choice in choices]
            self._rec.send_columns(
                f"focus/{name}/decision",
                _times(np.array([c.tick for c in choices]), np.array([c.time for c in choices])),
                [
                    *rr.TextDocument.columns(text=text, media_type=["text/markdown"] * len(text)),
                    *rr.AnyValues.columns(**{key: pa.array(value) for key, value in numbers.items()}).partition(each),
                    *rr.AnyValues.columns(taken=pa.array([d.taken for d in told])),
                ],
            )
        at = np.array([i for i, f in enumerate(shown) if "J" in f], int)
        if not at.size:
            return
        times = _times(column["tick"][at], column["time"][at])
        _scalars(self._rec, f"learning/{name}/error", times, np.stack([shown[i]["error"] for i in at]))
        _scalars(self._rec, f"learning/{name}/J", times, np.array([[shown[i]["J"]] for i in at]))
        met = [each for i in at for each in shown[i]["met"]]
        if met:
            ticks, nows, value = (np.array(part) for part in zip(*met, strict=True))
            _scalars(self._rec, f"learning/{name}/met", _times(ticks, nows), value[:, None])

    def _draw_resources(self, times: list[rr.TimeColumn], samples: Sequence[Mapping[str, Any]]) -> None:
        """Draw the resources again where they have moved, and how full the finite ones are."""
        resources = [r for r in self._scene.scenario.resources for _ in range(r.count)]
        if not resources:
            return
        shades = colours.resource_colours(self._scene.scenario)
        kind = np.repeat(
            np.arange(len(self._scene.scenario.resources)), [r.count for r in self._scene.scenario.resources]
        )
        each = [shades[k] for k in kind]
        radii = np.array([r.radius for r in resources], np.float32)
        place = np.stack([s["resources"] for s in samples])  # (n, R, 2)
        before = np.concatenate([place[:1] if self._resources is None else self._resources[None], place[:-1]])
        moved = np.flatnonzero(~((place == before) | (np.isnan(place) & np.isnan(before))).all(axis=(1, 2)))
        if self._resources is None:
            moved = np.union1d([0], moved)
            thin = rr.Radius.ui_points(1.0 if len(resources) > len(shades) else 1.5)
            line = rr.Ellipses2D.from_fields(colors=each, line_radii=thin, draw_order=8)
            self._rec.log("world/resources", line, static=True)
            # a dark rim, so that a circle stands out from a map of its own colour
            rim = rr.Ellipses2D.from_fields(colors=[BACKGROUND], line_radii=rr.Radius.ui_points(3.0), draw_order=7)
            self._rec.log("world/resources/rim", rim, static=True)
            full = rr.Points2D.from_fields(colors=[colours.shaded(s, 0.5) for s in each], draw_order=6)
            self._rec.log("world/resources/stock", full, static=True)
            single = [k for k, r in enumerate(self._scene.scenario.resources) if r.count == 1]
            words = rr.Points2D.from_fields(
                radii=1e-4,
                labels=[self._scene.scenario.resources[k].name for k in single],
                colors=[shades[k] for k in single],
                show_labels=True,
                draw_order=30,
            )
            self._rec.log("world/resources/names", words, static=True)
        self._resources = place[-1]
        some = [times[0], times[1]] if len(moved) == len(samples) else _times(
            np.array([samples[int(i)]["tick"] for i in moved]), np.array([samples[int(i)]["time"] for i in moved])
        )  # fmt: skip
        finite = not all(r.constant for r in resources)
        if moved.size:
            parts, at = [len(resources)] * len(moved), place[moved].reshape(-1, 2)
            half = np.tile(np.stack([radii, radii], axis=1), (len(moved), 1))
            circles = [*rr.Ellipses2D.columns(centers=at, half_sizes=half).partition(parts)]
            self._rec.send_columns("world/resources", some, circles)
            self._rec.send_columns("world/resources/rim", some, circles)
            if finite:
                self._rec.send_columns(
                    "world/resources/stock", some, rr.Points2D.columns(positions=at).partition(parts)
                )
            first = [
                int(np.flatnonzero(kind == k)[0]) for k, r in enumerate(self._scene.scenario.resources) if r.count == 1
            ]
            beside = [self._beside(p[k], radii[k], len(resources[k].name)) for p in place[moved] for k in first]
            if first:
                words_ = rr.Points2D.columns(positions=beside).partition([len(first)] * len(moved))
                self._rec.send_columns("world/resources/names", some, words_)
        if finite:
            full_ = (STEPS * np.sqrt(np.stack([s["stock"] for s in samples]))).round() / STEPS * radii
            self._rec.send_columns(
                "world/resources/stock",
                times,
                rr.Points2D.columns(radii=full_.astype(np.float32).reshape(-1)).partition(
                    [len(resources)] * len(samples)
                ),
            )

    def _draw_places(self, samples: Sequence[Mapping[str, Any]]) -> None:
        """Draw the fields and the closed doors again where they have changed."""
        for s in samples:
            changed = [
                name
                for name, level in s.get("fields", {}).items()
                if name not in self._fields or not np.array_equal(level, self._fields[name])
            ]
            doors = b"".join(line.tobytes() for line in s.get("doors", ()))
            if not changed and doors == self._doors:
                continue
            self._rec.set_time("tick", sequence=s["tick"])
            self._rec.set_time("sim_time", duration=s["time"])
            for name in changed:
                index = list(s["fields"]).index(name)
                self._rec.log(
                    f"world/fields/{name}", rr.Image(places.image(s["fields"][name], index), draw_order=-20 + index)
                )
                self._fields[name] = s["fields"][name]
            if doors != self._doors:
                self._rec.log("world/doors", rr.LineStrips2D(s["doors"], colors=[INK], draw_order=5))
                self._doors = doors

    def _beside(self, centre: np.ndarray, radius: float, letters: int) -> tuple[float, float]:
        """Return where a word may hang below or above a circle without lying on a wall."""
        import shapely  # slow to load

        walls = polygon_of(self._scene.scenario.arena).boundary
        size = max(walls.bounds[2] - walls.bounds[0], walls.bounds[3] - walls.bounds[1])
        half, tall = 0.009 * size * letters, 0.04 * size  # of the word, as the first screen shows it
        x, y = map(float, centre)
        for gap in np.arange(0.0, 0.3, 0.01) * size:
            for top in (y - radius - gap, y + radius + gap + tall):
                if not walls.intersects(shapely.box(x - half, top - tall, x + half, top)):
                    return x, top
        return x, y - radius

    def _draw_marks(self, times: list[rr.TimeColumn], samples: Sequence[Mapping[str, Any]]) -> None:
        """Mark births, deaths, bites and gifts where they happened since the last sample."""
        wide = max(self._scene.radius(species) for species in self._scene.scenario.species)
        far = max(action.reach for species in self._scene.scenario.species for action in species.actions)
        for kind in MARKED:
            found = [[e for e in s["happened"] if e.kind == kind] for s in samples]
            if not any(found):
                continue
            strips, lengths = [], []
            for events in found:
                mine = [strip for e in events for strip in shapes.mark(kind, e.place, e.other_place, wide)][: 2 * MARKS]
                if kind in ("bit", "gave"):  # who was put elsewhere after it is not joined by a line
                    mine = [strip for strip in mine if np.hypot(*(strip[1] - strip[0])) <= 2 * far]
                strips += mine
                lengths.append(len(mine))
            self._rec.send_columns(
                f"world/marks/{kind}", times, rr.LineStrips2D.columns(strips=strips).partition(lengths)
            )

    def _tell(self, samples: Sequence[Mapping[str, Any]]) -> None:
        """Write the event log: every event of a few agents, of many the most telling, and how many more."""
        deeds = [deed for s in samples for deed in s["deeds"]]
        if deeds:
            ticks, nows, texts = zip(*deeds, strict=True)
            self._rec.send_columns(
                "events/interventions",
                _times(np.array(ticks), np.array(nows)),
                rr.TextLog.columns(text=texts, level=["intervention"] * len(deeds), color=[DEED] * len(deeds)),
            )
        groups = list(self._scene.groups.values())
        for group in groups:
            rows: list[tuple[int, float, str, str]] = []
            most = LINES[self._scene.few]
            for s in samples:
                left: dict[str, int] = {}
                focus = s["focus"][group.name]
                if focus["anew"]:
                    rows.append((s["tick"], s["time"], "focus", f"now in focus: {focus['name']}"))
                for event in s["happened"]:
                    mine = (event.slot >= group.slots.start) & (event.slot < group.slots.stop)
                    for i in np.flatnonzero(mine):
                        left[event.kind] = left.get(event.kind, 0) + 1
                        if left[event.kind] <= most:
                            words = census.words(self._scene.scenario, groups, event, int(i))
                            rows.append((event.tick, event.time, event.kind, words))
                rows += [
                    (s["tick"], s["time"], kind, f"and {many - most} more {group.name} {kind}")
                    for kind, many in left.items()
                    if many > most
                ]
            if rows:
                ticks, nows, kinds, texts = zip(*rows, strict=True)
                shades = colours.packed(np.array([MARKED.get(kind, FAINT) for kind in kinds], np.uint8))
                self._rec.send_columns(
                    f"events/{group.name}",
                    _times(np.array(ticks), np.array(nows)),
                    rr.TextLog.columns(text=texts, level=kinds, color=shades),
                )

    def _draw_population(
        self,
        samples: Sequence[Mapping[str, Any]],
        times: list[rr.TimeColumn],
        column: Mapping[str, np.ndarray],
    ) -> None:
        """Draw numbers, births and deaths, drives, ages, stocks, measures and couplings."""
        count, drives = [], []
        for group in self._scene.groups.values():
            drive = column["drive"][:, group.slots]
            lives = np.isfinite(drive)
            many = lives.sum(axis=1)
            total = np.where(lives, drive, 0.0).sum(axis=1)
            mean = np.divide(total, many, out=np.full(len(many), np.nan), where=many > 0)
            off = np.where(lives, drive - mean[:, None], 0.0)
            spread = np.sqrt(np.divide((off**2).sum(axis=1), many, out=np.full(len(many), np.nan), where=many > 0))
            count.append(many.astype(float))
            drives += [mean, mean - spread, mean + spread]
        _scalars(self._rec, "population/count", times, np.stack(count, axis=1))
        _scalars(self._rec, "population/drive", times, np.stack(drives, axis=1))
        index = [group.index for group in self._scene.groups.values()]
        flow = np.stack([np.concatenate([s["born"][index], s["died"][index]]) for s in samples]).astype(float)
        _scalars(self._rec, "population/flow", times, flow)
        for word, there in (("stocks", self._scene.stocked), ("measures", self._scene.measures)):
            if there:
                _scalars(self._rec, f"population/{word}", times, np.stack([s[word] for s in samples]))
        for s in samples:
            if "ages" not in s:
                continue
            self._rec.set_time("tick", sequence=s["tick"])
            self._rec.set_time("sim_time", duration=float(s["time"]))
            for name, (middle, number) in s["ages"].items():
                shade, wide = self._scene.colour(name), np.full(len(middle), 0.9 * 2 * middle[0])
                self._rec.log(
                    f"population/ages/{name}", rr.BarChart(number, abscissa=middle - wide / 2, widths=wide, color=shade)
                )
            for name, (middle, number) in s["traits"].items():
                shade, wide = self._scene.colour(name.partition("/")[0]), np.full(len(middle), 0.9 * np.ptp(middle[:2]))
                bars = rr.BarChart(number, abscissa=middle - wide / 2, widths=wide, color=shade)
                self._rec.log(f"population/traits/{name}", bars)
            for name, weight in s["coupling"].items():
                if weight is not None:
                    self._rec.log(f"population/coupling/{name}", rr.Tensor(weight, dim_names=("feels", "felt")))

    def draw_maps(self, tick: int, now: float, name: str, found: np.ndarray | None) -> None:
        """Send the deviation maps (k, rows, columns) of a species' focus agent."""
        if found is None or not np.isfinite(found).any():
            return
        self._rec.set_time("tick", sequence=tick)
        self._rec.set_time("sim_time", duration=now)
        species = self._scene.scenario.species[self._scene.groups[name].index]
        x, y = self._scene.grid.corner
        for i, value in zip(maps.mapped_needs(species), found, strict=True):
            entity = f"world/maps/{name}/{species.needs[i].name}"
            low, high = float(np.nanmin(value)), float(np.nanmax(value))
            image = colours.shade(MAP_SCALE, value, low, high)
            image[~np.isfinite(value)] = BACKGROUND
            self._rec.log(
                f"{entity}/image",
                rr.Image(image, draw_order=-10),
                rr.AnyValues(
                    deviation=pa.array(value.astype(np.float32).reshape(-1)),
                    shape=np.array(value.shape, np.int32),
                ),
            )
            wide, tall = value.shape[1] * self._scene.grid.cell, value.shape[0] * self._scene.grid.cell
            ends = [(x + share * wide, y - 0.03 * tall) for share in (0.2, 0.8)]
            words = [f"dark {low:.2f}", f"bright {high:.2f}"]
            self._rec.log(f"{entity}/range", *text(ends, words, [INK] * 2))

    def lay_out(self, first: str | None) -> None:
        """Show the life of the species `first` first from now on."""
        self._scene.first = first
        self._rec.send_blueprint(blueprint(self._scene))


def decision_text(choice: Choice) -> str:
    """Return a decision in Markdown: what was taken and when, and a table with the least score first."""
    d = choice.decision
    taken, since = d.options[d.taken], choice.tick - d.age
    how_far = f"tick {d.age}" + ("" if d.length is None else f" of {max(d.length, d.age)}")
    marks = ["**explored**"] * bool(d.explored) + ["**nothing learned yet**"] * (not d.learned)
    if d.recalled:
        marks.append("not in focus when it chose: scores by what it knows now")
    order = np.argsort(np.where(d.open, d.score, np.inf), kind="stable")
    rows = [
        f"**{choice.name}**: **{taken}**, chosen at {since:,}, {how_far}"
        + "".join(f"; {mark}" for mark in marks)
        + f"; -ln(γ) J = {d.value:.3f}",
        "",
        "| option | next drive | dJ/dζ·f | sum | score |",
        "|---|---|---|---|---|",
    ]
    for i in order:
        numbers = [f"{value[i]:.3f}" for value in (d.next_drive, d.slope, d.total, d.score)] if d.open[i] else ["-"] * 4
        cells = [d.options[i] if d.open[i] else f"~~{d.options[i]}~~ closed", *numbers]
        if i == d.taken:
            cells = [f"**{cell}**" for cell in (f"▶ {cells[0]}", *cells[1:])]
        rows.append(f"| {' | '.join(cells)} |")
    return "\n".join(rows)


def drive_shares(species: Species, delta: np.ndarray) -> np.ndarray:
    """Return the share of each need in the own drive at x - x* (n, V), (n, V) in drive units; their sum is the drive.

    The share of a need is d |c_i delta_i|^n / sum_j |c_j delta_j|^n: which need the drive is about. Without any
    deviation it is 0.
    """
    regulated = np.array([need.regulated for need in species.needs])
    delta = np.where(regulated, delta, 0.0)
    below, above = physiology.drive_factors(species)
    square = np.abs(delta * np.where(delta > 0, above, below)) ** species.drive_power
    total = square.sum(axis=1, keepdims=True)
    drive = physiology.drive_of(species, delta)[:, None]
    return np.divide(
        drive * square, total, out=np.where(np.isfinite(total), np.zeros_like(square), np.nan), where=total > 0
    )


def _times(ticks: np.ndarray, times: np.ndarray) -> list[rr.TimeColumn]:
    return [rr.TimeColumn("tick", sequence=ticks), rr.TimeColumn("sim_time", duration=times)]


def _scalars(rec: rr.RecordingStream, entity: str, times: list[rr.TimeColumn], value: np.ndarray) -> None:
    """Send `value` (n, K) as K series."""
    rows, each = value.shape
    rec.send_columns(entity, times, rr.Scalars.columns(scalars=value.reshape(-1)).partition([each] * rows))
