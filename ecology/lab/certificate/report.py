"""The certificate as a table, on the screen and in files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ecology.lab.certificate import reference
from ecology.lab.certificate.case import Case, Row
from ecology.lab.runs.folder import replace_text

TABLE, PARQUET = "certificate.md", "certificate.parquet"
SIZE, DPI = (7.2, 4.2), 130  # of a figure: inches, and dots per inch
HEAD = ("case", "what", "theirs", "closed form", "ours (95 % interval)", "SD", "n", "verdict")


def cells(case: str, row: Row) -> tuple[str, ...]:
    """Return a row of the certificate as words, in the order of HEAD."""
    theirs = "-"
    if row.theirs is not None:
        mean, spread, count = row.theirs
        theirs = _format(mean) + (f" (SD {_format(spread)}, n {count})" if spread is not None else "")
    interval = row.interval()
    between = "" if interval is None else f" ({_format(interval[0])} to {_format(interval[1])})"
    return (
        case,
        row.what,
        theirs,
        "-" if row.closed is None else _format(row.closed),
        _format(row.mean()) + between,
        "-" if row.spread() is None else _format(row.spread() or 0.0),
        str(len(row.ours)),
        row.says(),
    )


def _format(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"


def markdown(head: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """Return a table of Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(map(str, line))} |\n" for line in lines)


def certificate(table: Mapping[str, Sequence[Row]]) -> str:
    """Return the certificate as a table of Markdown."""
    return markdown(HEAD, [cells(name, row) for name, found in table.items() for row in found])


def draw_case(folder: Path, case: Case, values: Mapping[str, Any]) -> list[Path]:
    """Draw the figure of a case from its finished parts into the folder; return its files, none without a figure."""
    if case.figure is None or not values:
        return []
    from ecology.observers.plotting import new_figure, save_figure  # slow to load

    figure = new_figure(SIZE)
    case.figure(values, figure)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{case.name}.png"
    return save_figure(figure, path, DPI)


def write(folder: Path, table: Mapping[str, Sequence[Row]], tables: Mapping[str, str]) -> list[Path]:
    """Write the certificate into the folder, as Markdown and as parquet (a row per row), and `tables` by name.

    Below the table stands whether this machine gives the reference life. Returns the paths.
    """
    import pyarrow as pa  # slow to load
    from pyarrow import parquet

    flat = []
    for name, found in table.items():
        for row in found:
            mean, spread, count = row.theirs or (None, None, None)
            low, high = row.interval() or (None, None)
            own = {"mean": row.mean(), "sd": row.spread(), "low": low, "high": high, "n": len(row.ours)}
            theirs = {"theirs_mean": mean, "theirs_sd": spread, "theirs_n": count, "closed_form": row.closed}
            flat.append({"case": name, "what": row.what, **theirs, **own, "verdict": row.says()})
    folder.mkdir(parents=True, exist_ok=True)
    replace_text(folder / TABLE, f"{certificate(table)}\n{reference.line()}\n")
    parquet.write_table(pa.Table.from_pylist(flat), folder / PARQUET)
    for name, text in tables.items():
        replace_text(folder / f"{name}.md", text)
    return [folder / name for name in (TABLE, PARQUET, *(f"{name}.md" for name in tables))]
