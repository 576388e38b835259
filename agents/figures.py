"""The figures of an evaluation, as PNG files; colour-blind readers can distinguish the colours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ecology import EcologyError, Scenario, Species
from ecology.agents.evaluation import DeviationCheck, Findings, Life, Maps
from ecology.ground.outline import drawn_lines
from ecology.observers import recorder
from ecology.observers.colours import darken, need_colour, resource_colours
from ecology.observers.plotting import (
    LINES,
    MARKERS,
    Axes,
    Circle,
    Figure,
    LineCollection,
    Polygon,
    new_figure,
    save_figure,
)
from ecology.state import Floats, Ints

DPI = 130
POINTS = 4000  # of a curve, at most; of more ticks it shows the range of neighbouring ones
INK, FAINT, LEARNED = "#222222", "#999999", "#0072B2"  # blue of Okabe and Ito (2008)
MEAL, DIED, BORN = "#D55E00", "#CC79A7", "#009E73"  # their vermilion, purple and green
SMOOTH = 200  # points of a loss curve, at most
MARKED = 12  # markers along a curve


def rgb(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return a colour of 0 to 255 as matplotlib wants it."""
    r, g, b = colour
    return r / 255, g / 255, b / 255


def arena(ax: Axes, scenario: Scenario, highlight: int = -1, labels: bool = True) -> None:
    """Draw walls and resources; `highlight` is the resource that the picture is about, -1: all alike."""
    vertices = np.array(scenario.arena.vertices, float)
    ax.add_patch(Polygon(vertices, closed=True, fill=False, edgecolor=INK, linewidth=2.0, zorder=3))
    for line in drawn_lines(scenario.arena)[1:]:
        ax.plot(*line.T, color=INK, linewidth=2.0, zorder=3)
    colours = resource_colours(scenario)
    for i, resource in enumerate(scenario.resources):
        if resource.position is None:  # scattered differently in every world
            continue
        meant = highlight in (-1, i)
        ax.add_patch(
            Circle(
                resource.position,
                resource.radius,
                facecolor=(*rgb(colours[i]), 0.85) if meant else (1, 1, 1, 0.25),
                edgecolor="white" if highlight >= 0 else INK,
                linewidth=1.8 if meant else 0.8,
                zorder=4,
            )
        )
        if labels:
            x, y = resource.position
            ax.text(x, y, str(i + 1), ha="center", va="center", fontsize=8, zorder=5, color=INK)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    margin = 0.03 * float((high - low).max())
    ax.set_xlim(low[0] - margin, high[0] + margin)
    ax.set_ylim(low[1] - margin, high[1] + margin)
    ax.set_aspect("equal")
    ax.set_xlabel("x, length")
    ax.set_ylabel("y, length")


def deviation_maps(maps: Maps, scenario: Scenario, species: Species, report: Mapping[str, Any]) -> Figure:
    """Draw the paper's panels: J over the arena, one need at its worst in each."""
    count = len(maps.needs)
    columns = min(count, 2)
    rows = -(-count // columns)
    figure = new_figure((5.6 * columns, 4.3 * rows))
    half = maps.grid.cell / 2
    extent = (
        maps.grid.x[0] - half, maps.grid.x[-1] + half, maps.grid.y[0] - half, maps.grid.y[-1] + half,
    )  # fmt: skip
    for i, need in enumerate(maps.needs):
        ax = figure.add_subplot(rows, columns, i + 1)
        image = ax.imshow(maps.value[i], origin="lower", extent=extent, cmap="viridis", interpolation="nearest")
        arena(ax, scenario, highlight=maps.resources[i])
        ax.plot(*maps.minimum(i), marker="x", color="#D55E00", markersize=10, markeredgewidth=2.8, zorder=6)
        words = species.needs[need]
        title = f"({'abcdefgh'[i % 8]}) {words.name} at $-x^*$ = {-words.set_point:g}, all else 0"
        rank = report.get(words.name, {}).get("spearman_with_walking_distance")
        if rank is not None:
            title += f"\nrank correlation with walking distance {rank:.2f}"
        ax.set_title(title, fontsize=10)
        figure.colorbar(image, ax=ax, label=r"$-\ln(\gamma)\,J$, drive units", shrink=0.9)
    figure.suptitle("Deviation function over the arena; the cross marks its minimum", fontsize=11)
    return figure


def changes_of_tenant(life: Life, slot: int) -> tuple[Ints, Ints]:
    """Return the ticks at which the agent in `slot` died, and those at which another was born in it."""
    alive, born = life.alive[:, slot], life.born[:, slot].copy()
    born[0] = False  # the first tenant's birth
    died = np.flatnonzero(alive[:-1] & (~alive[1:] | born[1:])) + 1
    return died, np.flatnonzero(born)


def _curve(ax: Axes, time: Floats, value: Floats, **style: Any) -> None:
    """Draw `value` (T,) over `time` (T,), NaN left out; of long series least and greatest of neighbouring ticks."""
    size = -(-len(value) // (POINTS // 2))
    if size > 1:
        edges = np.arange(0, len(value), size)
        low, high = np.fmin.reduceat(value, edges), np.fmax.reduceat(value, edges)
        value = np.column_stack([low, high]).ravel()
        time = np.repeat(time[edges], 2)
    ax.plot(time, value, **style)


def _mark_tenants(ax: Axes, life: Life, slot: int, dt: float, labels: bool) -> None:
    """Mark deaths and births of new tenants of a slot by vertical lines."""
    for ticks, colour, style, label in zip(
        changes_of_tenant(life, slot), (DIED, BORN), ("-", (0, (2, 2))), ("death", "new tenant"), strict=True
    ):
        for i, tick in enumerate(ticks.tolist()):
            name = label if labels and not i else None
            ax.axvline(tick * dt, color=colour, linestyle=style, linewidth=1.0, zorder=1, label=name)


def internal_states(life: Life, scenario: Scenario, species: Species, slot: int = 0) -> Figure:
    """Draw the deviations of the needs, the fatigues and the drive over a whole life, and the tenants of its slot."""
    time: Floats = np.arange(len(life.actions) + 1, dtype=float) * float(scenario.dt)

    def masked(value: Floats) -> Floats:
        return np.where(life.alive[:, slot], value, np.nan)

    groups = [
        (title, rows)
        for title, rows in (
            (r"deviation $x - x^*$", [i for i, n in enumerate(species.needs) if n.set_point > 0]),
            ("fatigue $x$", [i for i, n in enumerate(species.needs) if n.set_point <= 0]),
        )
        if rows
    ]
    figure = new_figure((12, 2.6 * (len(groups) + 1)))
    axes = figure.subplots(len(groups) + 1, 1, sharex=True, squeeze=False)[:, 0]
    for ax, (title, rows) in zip(axes, groups, strict=False):
        for k, i in enumerate(rows):
            _curve(
                ax,
                time,
                masked(life.zeta[:, slot, i]),
                color=rgb(darken(need_colour(i), 0.85)),
                linestyle=LINES[k % len(LINES)],
                marker=MARKERS[k % len(MARKERS)],
                markersize=4,
                markevery=(0.01 * k, 1.0 / MARKED),
                linewidth=1.2,
                label=species.needs[i].name.replace("_", " "),
            )
        ax.axhline(0.0, color=FAINT, linewidth=0.8, zorder=0)
        ax.set_ylabel(title)
        ax.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    _curve(axes[-1], time, masked(life.drive[:, slot]), color=INK, linewidth=1.0, label="drive")
    for ax in axes:
        _mark_tenants(ax, life, slot, scenario.dt, labels=ax is axes[-1])
    axes[-1].set_ylim(bottom=0)
    axes[-1].set_ylabel("drive $d$")
    axes[-1].set_xlabel("time")
    axes[-1].set_xlim(0, time[-1])
    axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    axes[0].set_title(f"Internal states from birth, without learning, {len(life.actions):,} ticks", fontsize=11)
    return figure


def trajectory(life: Life, scenario: Scenario, species: Species, slot: int = 0) -> Figure:
    """Draw the path through the arena over a whole life, coloured by time, with meals, deaths and new tenants."""
    path, alive = life.position[:, slot], life.alive[:, slot]
    time = np.arange(len(path)) * scenario.dt
    died, born = changes_of_tenant(life, slot)
    figure = new_figure((8.5, 6))
    ax = figure.add_subplot()
    arena(ax, scenario)
    kept = alive[:-1] & alive[1:] & ~life.born[1:, slot]  # no line from a death to the next tenant's birth
    pieces = np.stack([path[:-1], path[1:]], axis=1)[kept]
    lines = LineCollection(list(pieces), cmap="viridis", array=time[:-1][kept], linewidths=1.0, alpha=0.7, zorder=2)
    ax.add_collection(lines)
    feeds = np.array([action.kind in ("consume", "bite") for action in species.actions])
    eats = feeds[life.actions[:, slot]] & alive[:-1]
    x, y = path.T
    ax.scatter(x[:-1][eats], y[:-1][eats], s=14, color=MEAL, zorder=6, label="meals", linewidths=0)
    ax.scatter(x[0], y[0], marker="s", s=50, facecolor="white", edgecolor=INK, zorder=7, label="birth")
    if len(died):
        ax.scatter(x[died - 1], y[died - 1], marker="x", s=50, color=DIED, zorder=8, label="death")
    if len(born):
        ax.scatter(x[born], y[born], marker="^", s=50, facecolor="white", edgecolor=BORN, zorder=8, label="new tenant")
    figure.colorbar(lines, ax=ax, label="time", shrink=0.9)
    ax.legend(loc="lower right", fontsize=9)
    ax.set_title(f"Path from birth, without learning, {len(life.actions):,} ticks", fontsize=11)
    return figure


def losses(tick: Floats, columns: Mapping[str, Floats]) -> Figure:
    """Draw losses (T,) by name over the ticks (T,), smoothed by a running median."""
    figure = new_figure((9, 3.0 * len(columns)))
    axes = figure.subplots(len(columns), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (name, value) in zip(axes, columns.items(), strict=True):
        good = np.isfinite(value) & (value > 0)
        at, value = tick[good], value[good]
        ax.plot(at, value, color=FAINT, linewidth=0.5, alpha=0.7, label="sampled ticks")
        if len(at):
            parts = np.array_split(np.arange(len(at)), min(SMOOTH, len(at)))
            ax.plot(
                [at[p].mean() for p in parts],
                [np.median(value[p]) for p in parts],
                color=LEARNED,
                linewidth=1.8,
                label="median of neighbouring ticks",
            )
            ax.set_yscale("log")
        ax.set_ylabel({"loss_f": "$L_f$", "loss_J": "$L_J$"}.get(name, name))
        ax.legend(loc="upper right", fontsize=8)
    axes[-1].set_xlabel("tick")
    axes[0].set_title("Losses over the agent's life", fontsize=11)
    return figure


def baselines(drives: Mapping[str, Mapping[str, Any]], gap: float | None) -> Figure:
    """Draw the mean drive of the learner and of those it is measured against, with intervals."""
    rows = sorted((d["mean"], name) for name, d in drives.items() if d["mean"] is not None)
    figure = new_figure((8, 0.55 * len(rows) + 1.6))
    ax = figure.add_subplot()
    end = [mean if drives[name]["high"] is None else drives[name]["high"] for mean, name in rows]
    for i, (mean, name) in enumerate(rows):
        d = drives[name]
        ax.barh(i, mean, color=LEARNED if name == "learned" else "#BBBBBB", height=0.65)
        if d["low"] is not None:
            ax.errorbar(mean, i, xerr=[[mean - d["low"]], [d["high"] - mean]], color=INK, capsize=4, linewidth=1.3)
        ax.text(end[i], i, f"  {mean:.2f}", va="center", fontsize=9)
    ax.set_yticks(range(len(rows)), [name for _, name in rows])
    ax.invert_yaxis()
    ax.set_xlim(0, 1.12 * max(end, default=1.0))
    ax.set_xlabel("mean drive, drive units (less is better); bars: 95 % bootstrap interval over blocks of 500 ticks")
    title = "Mean drive on the same world"
    ax.set_title(title if gap is None else f"{title}; {gap:.0%} of the way from camping to planner", fontsize=11)
    return figure


def deviation_check(checks: Mapping[str, DeviationCheck]) -> Figure:
    """Draw J against the discounted drive measured along the same policy."""
    figure = new_figure((6.4, 6))
    ax = figure.add_subplot()
    words = {"life": "along a life", "random_starts": "after random starts"}
    marks = {"life": ("o", LEARNED), "random_starts": ("^", "#D55E00")}
    ends = [np.concatenate([c.learned, c.measured]) for c in checks.values()]
    low = min((1.05 * float(e.min()) for e in ends if len(e) and e.min() < 0), default=0.0)
    high = 1.05 * max((float(e.max()) for e in ends if len(e)), default=1.0)
    ax.plot([low, high], [low, high], color=FAINT, linewidth=1.2, zorder=1)
    for name, check in checks.items():
        report = check.report()
        mark, colour = marks.get(name, ("s", INK))
        label = words.get(name, name)
        if report["correlation"] is not None:
            label += f": correlation {report['correlation']:.2f}, bias {report['bias']:+.2f}"
        ax.scatter(check.measured, check.learned, s=18, marker=mark, facecolor="none", edgecolor=colour, label=label)
    ax.set_xlim(low, high)
    ax.set_ylim(low, high)
    ax.set_aspect("equal")
    ax.set_xlabel("discounted drive measured along the policy, drive units")
    ax.set_ylabel(r"learned $-\ln(\gamma)\,J$, drive units")
    ax.legend(loc="upper left", fontsize=8)
    ax.set_title("Deviation function against what it stands for", fontsize=11)
    return figure


def draw_evaluation(
    folder: Path, scenario: Scenario, findings: Findings, layout: Sequence[str], metrics: Path | None = None
) -> list[Path]:
    """Write the figures of `findings` to `folder` as PNG and return their paths.

    `layout` names the components of zeta, `metrics` is the run's metrics.parquet for the losses. A
    figure for which there is nothing to show (a learner without a J) is left out.
    """
    report, life = findings.report, findings.life
    species = next(s for s in scenario.species if s.name == report["species"])
    slot = report["slot"]
    figures: dict[str, Figure] = {}
    if findings.maps is not None:
        figures["deviation_maps"] = deviation_maps(findings.maps, scenario, species, report["deviation_maps"])
    figures["internal_states"] = internal_states(life, scenario, species, slot)
    if "x" in layout:
        figures["trajectory"] = trajectory(life, scenario, species, slot)
    if metrics is not None:
        tick, columns = read_losses(metrics, species.name)
        if columns:
            figures["losses"] = losses(tick, columns)
    figures["baselines"] = baselines(report["mean_drive"], report["closed_gap"])
    if findings.checks:
        figures["deviation_check"] = deviation_check(findings.checks)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures.items():
        paths.append(folder / f"{name}.png")
        save_figure(figure, paths[-1], DPI)
    return paths


def read_losses(metrics: Path, species: str) -> tuple[Floats, dict[str, Floats]]:
    """Return the sampled ticks (T,) and the losses (T,) by name, averaged over the species, if any."""
    try:
        table = recorder.read(metrics)
    except EcologyError:
        return np.zeros(0), {}
    names = [name for name in ("loss_f", "loss_J") if name in table.column_names]
    table = table.filter(np.array(table["species"].to_pylist()) == species)
    ticks, row = np.unique(table["tick"].to_numpy(), return_inverse=True)
    found = {}
    for name in names:
        value = np.asarray(table[name].to_numpy(), float)
        good = np.isfinite(value)
        count = np.bincount(row[good], minlength=len(ticks))
        total = np.bincount(row[good], value[good], minlength=len(ticks))
        if count.any():
            found[name] = np.divide(total, count, out=np.full(len(ticks), np.nan), where=count > 0)
    return ticks.astype(float), found
