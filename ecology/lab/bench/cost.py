"""What was learned against what it cost: `python -m ecology.lab.bench.cost FOLDER ... --out cost.png`.

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

from ecology import Ecology, scenarios
from ecology.agents import evaluation, lives
from ecology.lab.runs.defaults import EVALUATED, EVALUATION_SEED, SKIPPED
from ecology.lab.runs.sweep import DPI, LEARNED, TABLE


@dataclass(frozen=True, kw_only=True)
class CostPoint:
    """One choice of settings: drives by seed, and what its learners cost."""

    sweep: str
    label: str
    drives: Mapping[int, float]
    learner: float  # acting and learning, milliseconds per agent and tick
    tick: float  # the world and those who watch too


def points(folders: Sequence[Path]) -> list[CostPoint]:
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
            CostPoint(
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
    """Return the learner and those of its settings that a sweep sets."""
    settings = [
        (key.rpartition(".")[2], value) for key, value in row.items() if re.match(r"set\.(\w+\.)?learner\.", key)
    ]
    names = [value for key, value in row.items() if key.startswith("learner.")]
    return ", ".join([*dict.fromkeys(names), *(f"{key} {value}" for key, value in settings)])


def cost(row: Mapping[str, Any], of: str) -> float:
    """Return milliseconds of CPU time per agent and tick."""
    agents = sum(value for key, value in row.items() if re.fullmatch(r"population\..*\.mean", key))
    return 1e3 * row[of] / (row["ticks"] * agents)


def world(row: Mapping[str, Any]) -> float:
    """Return the same for all but the learners."""
    return cost(row, "cpu_seconds") - cost(row, "learner_cpu_seconds")


def camping(scenario: str) -> float:
    """Return the mean drive of an agent that stays at the best resource."""
    world = scenarios.load(scenario)
    group = next(iter(Ecology(world).groups.values()))
    seed = EVALUATION_SEED
    baseline = evaluation.baseline("camping", world, group, seed, EVALUATED)
    return float(lives.mean_drive(world, baseline, EVALUATED, seed, SKIPPED).mean())


def draw_costs(path: Path, found: Sequence[CostPoint], line: float) -> None:
    """Draw every choice with the range of its seeds, numbered as in the table, and the drive of camping as a `line`."""
    from ecology.observers.plotting import ScalarFormatter, new_figure, save_figure, style  # slow to load

    figure = new_figure((11, 5.6))
    ax = figure.add_subplot(xscale="log", yscale="log")
    ax.axhline(line, color="0.5", linewidth=1, linestyle="--")
    ax.annotate(f"camping {line:.2f}", (1, line), xycoords=("axes fraction", "data"), xytext=(-4, 3),
                textcoords="offset points", ha="right", fontsize=8, color="0.4")  # fmt: skip
    looks = {sweep: style(i) for i, sweep in enumerate(dict.fromkeys(point.sweep for point in found))}
    for number, point in enumerate(found, 1):
        drives, mean = list(point.drives.values()), float(np.mean(list(point.drives.values())))
        look = looks[point.sweep]
        ax.plot([1.02 * point.learner] * len(drives), drives, ".", color=look.colour, alpha=0.45, markersize=5)
        ax.errorbar(
            point.learner, mean, [[mean - min(drives)], [max(drives) - mean]], fmt=look.marker, capsize=3,
            markersize=5, linewidth=1, color=look.colour, label=f"{number}  {point.label}",
        )  # fmt: skip
        ax.annotate(str(number), (point.learner, max(drives)), xytext=(0, 4), textcoords="offset points", ha="center",
                    fontsize=9)  # fmt: skip
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(ScalarFormatter())
    ax.tick_params(which="both", labelsize=8)
    ax.set_xlabel("CPU time of the learner, milliseconds per agent and tick")
    ax.set_ylabel("learned drive (less is better); bars: range over seeds, small dots: seeds")
    figure.legend(loc="outside right upper", fontsize=9, frameon=False)
    save_figure(figure, path, DPI)


def table(found: Sequence[CostPoint]) -> str:
    """Return the choices as a table in markdown."""
    seeds = sorted({seed for point in found for seed in point.drives})
    lines = [["", "setting", "learner, ms", "tick, ms", *(f"seed {seed}" for seed in seeds), "worst"], ["---"] * 5]
    lines[1] += ["---"] * len(seeds)
    for number, point in enumerate(found, 1):
        drives = [f"{point.drives[seed]:.2f}" if seed in point.drives else "-" for seed in seeds]
        worst = f"{max(point.drives.values()):.2f}"
        lines.append([str(number), f"`{point.label}`", f"{point.learner:.3f}", f"{point.tick:.3f}", *drives, worst])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    words = parser.parse_args()
    found = points(words.folders)
    import pyarrow.parquet as pq

    draw_costs(words.out, found, camping(pq.read_table(words.folders[0] / TABLE)["scenario"][0].as_py()))
    print(table(found))


if __name__ == "__main__":
    main()
