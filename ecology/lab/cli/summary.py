"""The summary that `ecology run` and `ecology fork` print at the end of a run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ecology.lab.cli.options import format_number
from ecology.lab.runs.folder import RECORDING


def print_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Print the summary of a run, and the commands that come next."""
    drive, last = summary["mean_drive"], summary["mean_drive_last_tenth"]
    own, last_own = summary["mean_own_drive"], summary["mean_own_drive_last_tenth"]
    felt = f" (own drive {format_number(own)}, {format_number(last_own)})" if (own, last_own) != (drive, last) else ""
    print(
        f"{summary['ticks']:,} ticks in {summary['wall_seconds']:,.1f} s; mean drive {format_number(drive)}, "
        f"in the last tenth {format_number(last)}{felt}. The run is in {folder}"
    )
    several = len(summary["population"]) > 1
    for name, of in summary["population"].items() if several or summary["births"] or summary["deaths"] else ():
        gone = "" if of["died_out"] is None else f" (died out at tick {of['died_out']:,})"
        drive, own = summary["species_drive"][name], summary["species_own_drive"][name]
        felt = f" (own drive {format_number(own)})" if own != drive else ""
        print(
            f"{name}: {of['end']} alive{gone}, {of['mean']:.1f} on average, from {of['least']} to {of['most']}; "
            f"mean drive {format_number(drive)}{felt}"
        )
    for name, of in summary["measures"].items():
        known = [format_number(of[key]) for key in ("mean", "least", "most", "end")]
        print(f"{name}: {known[0]} on average, from {known[1]} to {known[2]}, {known[3]} at the end")
    watch = f"ecology view {folder}   or   " if (folder / RECORDING).exists() else ""
    print(f"next: {watch}ecology evaluate {folder}")
