"""What was learned against what it cost: `python -m scenarios._cost FOLDER ... --out cost.png`.

The folders are those of sweeps with --evaluate, of one scenario in which all agents are of one species.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import scenarios
from agents import evaluation
from ecology import Ecology
from ecology.observers.colours import PALETTE
from scenarios import cli
from scenarios._sweep import DPI, LEARNED, TABLE

OFFSETS = [
    (9, 5),
    (9, -12),
    (-9, 5),
    (-9, -12),
    (0, 12),
    (0, -20),
    (9, 16),
    (-9, 16),
    (9, -24),
    (-9, -24),
]  # of a label


@dataclass(frozen=True, kw_only=True)
class Point:
    """One choice of settings: drives by seed, and what its learners cost."""

    sweep: str
    label: str
    drives: Mapping[int, float]
    learner: float  # acting and learning, milliseconds per agent and tick
    tick: float  # the world and those who watch too


def points(folders: Sequence[Path]) -> list[Point]:
    """Return the choices that were swept, those that cost most first.

    What the world takes is the same work in every run, and tells how busy the machine was: a learner's cost is
    its share of that, in the median over seeds, times the least that the world took in any run.
    """
    import pyarrow.parquet as pq

    found: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for folder in folders:
        for row in pq.read_table(folder / TABLE).to_pylist():
            found.setdefault((folder.name, label(row)), []).append(row)
    least = min(world(row) for rows in found.values() for row in rows)
    learner = {
        key: least * float(np.median([cost(row, "learner_cpu_seconds") / world(row) for row in rows]))
        for key, rows in found.items()
    }
    return sorted(
        (
            Point(
                sweep=sweep,
                label=name,
                drives={row["seed"]: row[LEARNED] for row in rows},
                learner=learner[sweep, name],
                tick=learner[sweep, name] + least,
            )
            for (sweep, name), rows in found.items()
        ),
        key=lambda point: -point.learner,
    )


def label(row: Mapping[str, Any]) -> str:
    """Return the learner and those of its settings that a sweep was told."""
    told = [(key.rpartition(".")[2], value) for key, value in row.items() if re.match(r"set\.(\w+\.)?learner\.", key)]
    names = [value for key, value in row.items() if key.startswith("learner.")]
    return ", ".join([*dict.fromkeys(names), *(f"{key} {value}" for key, value in told)])


def cost(row: Mapping[str, Any], of: str) -> float:
    """Return milliseconds of CPU time per agent and tick."""
    agents = sum(value for key, value in row.items() if re.fullmatch(r"population\..*\.mean", key))
    return 1e3 * row[of] / (row["ticks"] * agents)


def world(row: Mapping[str, Any]) -> float:
    """Return the same for all but the learners."""
    return cost(row, "cpu_seconds") - cost(row, "learner_cpu_seconds")


def camping(scenario: str) -> float:
    """Return the mean drive of who stays at the best resource."""
    world = scenarios.load(scenario)
    group = next(iter(Ecology(world).groups.values()))
    seed = cli.EVALUATION_SEED
    there = evaluation.baseline("camping", world, group, seed, cli.EVALUATED)
    return float(evaluation.mean_drive(world, there, cli.EVALUATED, seed, cli.SKIPPED).mean())


def draw(path: Path, found: Sequence[Point], line: float) -> None:
    """Draw every choice with the range of its seeds, and the drive of camping as a `line`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import ScalarFormatter

    figure = Figure(figsize=(10, 6.2), layout="constrained")
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_subplot(xscale="log", yscale="log")
    ax.axhline(line, color="0.5", linewidth=1, linestyle="--")
    ax.annotate(f"camping {line:.2f}", (1, line), xycoords=("axes fraction", "data"), xytext=(-4, 3),
                textcoords="offset points", ha="right", fontsize=8, color="0.4")  # fmt: skip
    marks: list[tuple[str, tuple[float, float], Any]] = []
    for i, sweep in enumerate(dict.fromkeys(point.sweep for point in found)):
        mine = [point for point in found if point.sweep == sweep]
        x, drives = [point.learner for point in mine], [list(point.drives.values()) for point in mine]
        mean = np.array([np.mean(each) for each in drives])
        span = [mean - [min(each) for each in drives], [max(each) for each in drives] - mean]
        colour = np.array(PALETTE[(i - 2) % len(PALETTE)]) / 255
        ax.errorbar(x, mean, span, fmt="o", capsize=3, linewidth=1, markersize=5, color=colour)
        marks += [(point.label, (a, b), colour) for point, a, b in zip(mine, x, mean, strict=True)]
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(ScalarFormatter())
    ax.tick_params(which="both", labelsize=8)
    ax.set_xlabel("CPU time of the learner, milliseconds per agent and tick")
    ax.set_ylabel("mean drive of what was learned: mean and range over seeds (less is better)")
    canvas.draw()
    taken: list[Any] = []
    for text, at, colour in marks:  # the first place inside at which a label lies on no other
        for dx, dy in OFFSETS:
            side = "center" if dx == 0 else "left" if dx > 0 else "right"
            word = ax.annotate(text, at, xytext=(dx, dy), textcoords="offset points", ha=side, fontsize=8, color=colour)
            box = word.get_window_extent()
            inside = ax.bbox.containsx(box.x0) and ax.bbox.containsx(box.x1)
            if (dx, dy) == OFFSETS[-1] or (inside and not any(box.overlaps(other) for other in taken)):
                taken.append(box)
                break
            word.remove()
    figure.savefig(path, dpi=DPI)


def table(found: Sequence[Point]) -> str:
    """Return the choices as a table in markdown."""
    seeds = sorted({seed for point in found for seed in point.drives})
    lines = [["setting", "learner, ms", "tick, ms", *(f"seed {seed}" for seed in seeds), "worst"], ["---"] * 4]
    lines[1] += ["---"] * len(seeds)
    for point in found:
        drives = [f"{point.drives[seed]:.2f}" if seed in point.drives else "-" for seed in seeds]
        worst = f"{max(point.drives.values()):.2f}"
        lines.append([f"`{point.label}`", f"{point.learner:.3f}", f"{point.tick:.3f}", *drives, worst])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    words = parser.parse_args()
    found = points(words.folders)
    import pyarrow.parquet as pq

    draw(words.out, found, camping(pq.read_table(words.folders[0] / TABLE)["scenario"][0].as_py()))
    print(table(found))


if __name__ == "__main__":
    main()
