"""A sweep: one scenario run with many settings, learners and seeds, and the table of their results.

Every run is a folder and a process of its own, started as `python -P -m ecology.lab.cli.worker FOLDER` with a
pipe for its standard input: where the pipe closes, because the sweep stops or has died, the run stops
after the present tick and can be gone on with.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from ecology.errors import EcologyError, nearest, readable, writable
from ecology.lab.runs import source as sources
from ecology.lab.runs.folder import CONFIG, SUMMARY, replace_text
from ecology.lab.runs.gate import Gate
from ecology.lab.runs.run_config import Plan, resolve
from ecology.lab.runs.stopping import StoppedError
from ecology.lab.values import as_key, read_value, split_values

TABLE, FIGURE, RUNS = "sweep.parquet", "sweep.png", "runs"  # what the folder of a sweep holds
LEARNED, LEARNED_OWN = "learned_drive", "learned_own_drive"  # keys of the summary of a run that was measured after it
WORKER = "ecology.lab.cli.worker"  # module of the process of a run
RETRIES = 3  # times that a run is begun or gone on with again after its process died
PATIENCE = 60.0  # seconds for which a run waits for the last process in its folder to end
CONFIDENCE = 0.95
BY_SPECIES, OWN_BY_SPECIES = "species_drive.", "species_own_drive."  # of the columns of the table
LONGEST = 100  # characters of a run's name
DPI = 130
USER_ERROR = 2  # exit code that another attempt would not change

Job = TypeVar("Job")
Done = TypeVar("Done")
Attempt = Callable[["Cell", threading.Event], tuple[int, str]]  # run, stop -> exit code, what it said


# ---- what is to be lived -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One run of a sweep: its settings, and those that distinguish it."""

    plan: Plan
    varied: Mapping[str, Any]  # "set.KEY", "learner": what was typed, the seed aside
    folder: Path
    evaluate: bool = False  # whether what was learned is measured after the run
    source: str | None = None  # which code of the user's own resumes it, see `source.choose`
    trust: bool = False  # whether copies may be run that this user has not run before, see `Gate`

    @property
    def name(self) -> str:
        """Return the name of the run's folder."""
        return self.folder.name


def seeds_of(text: str) -> list[int]:
    """Return the seeds of "0:32" (32 is not among them), "7" or "1,4,9:12"."""
    found: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,18})\s*(?::\s*(\d{1,18})\s*)?", part)
        if match is None or (match[2] and not 0 < int(match[2]) - int(match[1]) <= 1_000_000):
            raise EcologyError(f"--seeds takes whole numbers and ranges FIRST:END, as 0:32 or 1,4,9:12; got {text!r}.")
        found.extend(range(int(match[1]), int(match[2] or int(match[1]) + 1)))
    return list(dict.fromkeys(found))


def values_of(text: str) -> tuple[str, list[Any]]:
    """Return key and values of "key=1,2,[3, 4],word"; values that mean the same are there once."""
    key, sign, listed = text.partition("=")
    if not sign or not key.strip() or not listed.strip():
        raise EcologyError(f"--set takes KEY=VALUE or KEY=VALUE,VALUE,..., got {text!r}.")
    parts = split_values(listed)
    if not parts[-1]:  # a comma at the end
        parts.pop()
    if not all(parts):
        raise EcologyError(f"--set takes KEY=VALUE,VALUE,... with a value between any two commas, got {text!r}.")
    values: dict[Any, Any] = {}
    for value in map(read_value, parts):
        values.setdefault(as_key(value), value)
    return key.strip(), list(values.values())


def cells_of(
    scenario: str,
    out: Path,
    *,
    seeds: Sequence[int],
    settings: Mapping[str, Sequence[Any]],
    learners: Sequence[str] = (),
    evaluate: bool = False,
    source: str | None = None,
    trust: bool = False,
    **flags: Any,
) -> list[Cell]:
    """Return every run of a sweep, each plan resolved and checked; seeds vary fastest.

    `settings` are values by name as `resolve` takes them; `learners` are "a,b" or "SPECIES=a,b", every
    one of them a thing that varies.
    """
    axes: dict[str, list[tuple[str, Any]]] = {}  # what varies -> its values, each as a pair for `resolve`
    for key, values in settings.items():
        axes[f"set.{key}"] = [(key, value) for value in values]
    for word in learners:
        species, _, names = word.rpartition("=")
        axis = f"learner.{species}" if species else "learner"
        axes[axis] = [("learner", f"{species}={name}" if species else name) for name in dict.fromkeys(names.split(","))]
    cells: dict[str, Cell] = {}
    for choice in itertools.product(*axes.values()):
        picked = dict(zip(axes, choice, strict=True))
        chosen = [value for key, value in choice if key == "learner"]
        changes = {key: value for key, value in choice if key != "learner"}
        plan = resolve(scenario, changes=changes, learners=chosen, seed=seeds[0], **flags)
        varied = {axis: str(value).rpartition("=")[2] if key == "learner" else value
                  for axis, (key, value) in picked.items()}  # fmt: skip
        several = {axis: varied[axis] for axis in axes if len(axes[axis]) > 1}
        for seed in seeds:
            name = _name(several, seed)
            folder = out / RUNS / name
            cells[name] = Cell(
                plan=replace(plan, seed=seed),
                varied=varied,
                folder=folder,
                evaluate=evaluate,
                source=source,
                trust=trust,
            )
    return list(cells.values())


def _name(varied: Mapping[str, Any], seed: int) -> str:
    """Return the name of a run's folder: its settings, or a digest of them where a name cannot hold them."""
    whole = "_".join(f"{axis.removeprefix('set.')}={value}" for axis, value in varied.items())
    name = re.sub(r"[^\w.=+-]", "-", whole)
    if name != whole or len(name) > LONGEST:
        name = f"{name[:LONGEST]}-{hashlib.sha256(whole.encode()).hexdigest()[:8]}"
    return f"{name}_seed={seed}" if name else f"seed={seed}"


def finished_summary(cell: Cell) -> dict[str, Any] | None:
    """Return the summary of a run that has ended, and is measured if it is to be; else None."""
    summary = ended_summary(cell)
    return summary if summary is not None and (LEARNED in summary or not cell.evaluate) else None


def ended_summary(cell: Cell) -> dict[str, Any] | None:
    """Return the summary of a run that has ended, measured or not; else None."""
    return summary_at(cell.folder, cell.plan.ticks)


def summary_at(folder: Path, ticks: int) -> dict[str, Any] | None:
    """Return the summary of a run that has lived its `ticks`, None of one that has not."""
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        lived = summary["ticks"] == ticks or "extinct_at" in summary
        return summary if lived and "stopped_at" not in summary else None
    except (OSError, ValueError, TypeError, KeyError):
        return None


def check_cell(cell: Cell) -> None:
    """Raise EcologyError where the folder of a run holds a run with other settings."""
    try:
        with readable("the config", cell.folder / CONFIG):
            config = tomllib.loads((cell.folder / CONFIG).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return
    except EcologyError:
        raise
    except (OSError, ValueError) as error:
        raise EcologyError(f"the config {str(cell.folder / CONFIG)!r} cannot be read: {error}.") from error
    mine = tomllib.loads(cell.plan.to_toml())
    worlds = [words.pop("made_with", {}).get("world") for words in (mine, config)]
    differ = [key for key in sorted(mine.keys() | config.keys()) if mine.get(key) != config.get(key)]
    if not differ and worlds[0] != worlds[1]:
        differ = ["the scenario file, which has changed since"]
    if differ:
        raise EcologyError(
            f"the folder {str(cell.folder)!r} holds a run of another sweep: it differs in {' and '.join(differ)}. "
            "Give another --out."
        )
    copies = sources.choose(cell.folder, cell.source)
    if copies is not None:  # what is not copied was named by the user
        Gate(cell.source, cell.trust).admit(cell.plan.code, copies)


def check_folder(out: Path, cells: Sequence[Cell]) -> None:
    """Raise EcologyError where `out` holds a run, or the table of a sweep with runs that are not among `cells`."""
    if (out / CONFIG).exists():
        raise EcologyError(
            f"the folder {str(out)!r} holds a run, and a sweep needs one of its own; give another --out."
        )
    rows = _rows(out / TABLE)
    mine = {cell.name: cell for cell in cells}
    left_out = [row["run"] for row in rows if row["run"] not in mine or not _is_of(row, mine[row["run"]])]
    if left_out:
        more = f" and {len(left_out) - 3} more" if len(left_out) > 3 else ""
        raise EcologyError(
            f"the folder {str(out)!r} holds a sweep of {len(rows)} runs, {len(left_out)} of which this one leaves out: "
            f"{', '.join(left_out[:3])}{more}. Give another --out; to continue that sweep, give all its settings and "
            "seeds, or more."
        )


def _rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of the table at `path`, none where it is not there."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.exists():
        return []
    try:
        with readable("the table", path):
            rows = pq.read_table(path).to_pylist()
    except (OSError, pa.ArrowException) as error:
        raise EcologyError(
            f"the table {str(path)!r} is damaged ({str(error).splitlines()[0]}). Move it away: the sweep writes it "
            "again from its runs, which are kept."
        ) from error
    if any("run" not in row for row in rows):
        raise EcologyError(f"the table {str(path)!r} is of no sweep; move it away, or give another --out.")
    return rows


def _is_of(words: Mapping[str, Any], cell: Cell) -> bool:
    """Return whether a row of the table is of `cell`; where its folder is, `check` has compared that."""
    if (cell.folder / CONFIG).exists():
        return True
    mine = row(cell, {})
    plain = json.loads(json.dumps(mine, default=str))  # as a table holds it: lists for tuples
    return all(words.get(key, plain[key]) in (plain[key], str(mine[key])) for key in mine)


# ---- living it ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Outcome:
    """What became of a run: its summary, or why there is none."""

    cell: Cell
    summary: dict[str, Any] | None
    failed: str = ""
    code: int = 1  # of a run that failed


def live(
    cells: Iterable[Cell],
    attempt: Attempt,
    workers: Callable[[], int],
    tell: Callable[[Outcome, int], None],
) -> None:
    """Live all `cells` to their end, `workers()` at a time; `tell` hears of each and how many are under way.

    A run whose process dies is gone on with, `RETRIES` times; one that fails by its own error is not.
    A signal to stop lets the runs under way stop after their present tick: then StoppedError.
    """

    def do(cell: Cell, stop: threading.Event) -> Outcome:
        return _run_cell(cell, attempt, stop)

    schedule(cells, do, workers, tell)


def schedule(
    jobs: Iterable[Job],
    do: Callable[[Job, threading.Event], Done],
    workers: Callable[[], int],
    tell: Callable[[Done, int], None],
) -> None:
    """Do all `jobs`, `workers()` at a time, each in a thread; `tell` gets each result and how many are under way.

    `do` ends early where its event is set. A signal sets it; once all have ended, StoppedError is raised.
    """
    stop, heard = threading.Event(), []
    waiting = list(jobs)[::-1]

    def hear(signum: int, _: object) -> None:
        heard.append(signum)
        stop.set()

    with contextlib.ExitStack() as at_end:
        if threading.current_thread() is threading.main_thread():
            for signum in (signal.SIGINT, signal.SIGTERM):
                at_end.callback(signal.signal, signum, signal.signal(signum, hear))
        pool = at_end.enter_context(ThreadPoolExecutor(max(1, len(waiting))))  # threads start as they are needed
        at_end.callback(stop.set)  # whatever happens here, nobody is left running
        running: set[Any] = set()
        while running or (waiting and not stop.is_set()):
            room = workers() - len(running) if waiting else 0
            for _ in range(0 if stop.is_set() else min(room, len(waiting))):
                running.add(pool.submit(do, waiting.pop(), stop))
            done, running = wait(running, timeout=0.5, return_when=FIRST_COMPLETED)
            for future in done:
                tell(future.result(), len(running))
    if heard:
        raise StoppedError(heard[0])


def _run_cell(cell: Cell, attempt: Attempt, stop: threading.Event) -> Outcome:
    """Live one run to its end."""
    code, said = 0, ""
    for _ in range(1 + RETRIES):
        if stop.is_set():
            return Outcome(cell, None, "stopped")
        try:
            with writable(cell.folder):
                cell.folder.mkdir(parents=True, exist_ok=True)
                if not (cell.folder / CONFIG).exists():
                    sources.keep(cell.plan.code, cell.folder)
                    replace_text(cell.folder / CONFIG, cell.plan.to_toml())
        except EcologyError as error:
            return Outcome(cell, None, str(error), USER_ERROR)
        code, said = attempt(cell, stop)
        summary = finished_summary(cell)
        if summary is not None:
            return Outcome(cell, summary)
        if code == 0:
            said = f"its folder {str(cell.folder)!r} is not seen from here; give an --out that every machine sees"
        if code in (0, USER_ERROR):
            break
    else:
        said = f"its process died {1 + RETRIES} times, at last with exit code {code}. {said}".rstrip()
    return Outcome(cell, None, "stopped" if stop.is_set() else said, USER_ERROR if code == USER_ERROR else 1)


def by_process(cell: Cell, stop: threading.Event) -> tuple[int, str]:
    """Live a run in a process of one thread; return its exit code and its last line of error."""
    return in_own_process(cell.folder, cell.evaluate, cell.source, stop)


def in_own_process(folder: Path, evaluate: bool, source: str | None, stop: threading.Event) -> tuple[int, str]:
    """Live the run in `folder` in a process of one thread, and measure it if it is to be evaluated."""
    options = [*(["--evaluate"] if evaluate else []), *(["--source", source] if source else [])]
    return in_process([WORKER, *options, str(folder)], stop)


def in_process(words: Sequence[str], stop: threading.Event) -> tuple[int, str]:
    """Run `python -P -m WORDS` with one thread; return its exit code and its last line of error.

    With -P no module in the present folder takes the place of one that is installed.

    The pipe to its standard input closes once `stop` is set: see `stop_with_parent`.
    """
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", *words],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
            start_new_session=True,  # Ctrl-C reaches the sweep alone, which passes it on
        )
        assert process.stdin is not None
        try:
            while process.poll() is None and not stop.wait(0.05):
                pass
        finally:
            process.stdin.close()
            process.wait()
        errors.seek(0)
        said = errors.read().decode(errors="replace").strip()
    own = said.rfind("\necology: ") + 1  # the message, of however many lines, or else the last line
    return process.returncode, said[own:] if said[own:].startswith("ecology: ") else said.rpartition("\n")[2]


def stop_with_parent() -> None:
    """Send SIGTERM to this process as soon as its standard input closes."""

    def listen() -> None:
        while os.read(sys.stdin.fileno(), 1):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=listen, daemon=True).start()


# ---- what it came to ---------------------------------------------------------------------------


def row(cell: Cell, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row of the table: settings as `set.KEY`, learners, seed, and the summary's numbers."""
    plan = cell.plan
    head = {"run": cell.name, "scenario": plan.scenario, "seed": plan.seed, "ticks": plan.ticks}
    head |= {f"learner.{species}": choice.name for species, choice in plan.learners.items()}
    head |= {f"set.{key}": value for key, value in plan.settings.items()}
    head |= {key: value for key, value in cell.varied.items() if key.startswith("set.")}
    return head | dict(_flat({key: value for key, value in summary.items() if key not in ("learner", *head)}))


def _flat(words: Mapping[str, Any], where: str = "") -> Iterable[tuple[str, Any]]:
    for key, value in words.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{where}{key}.")
        else:
            yield f"{where}{key}", value


def rows_of(outcomes: Iterable[Outcome]) -> list[dict[str, Any]]:
    """Return the rows of the table; a cause of death that did not occur in a run, but in another, counts 0."""
    rows = [row(outcome.cell, outcome.summary or {}) for outcome in outcomes]
    for cause in dict.fromkeys(key for each in rows for key in each if ".died_of." in key):
        for each in rows:
            if cause.partition(".died_of.")[0] + ".mean" in each:
                each.setdefault(cause, 0)
    return rows


def columns_of(outcomes: Sequence[Outcome], show: Sequence[str] = ()) -> list[str]:
    """Return the columns of the table that are printed and drawn: those of `show`, or else what tells runs apart.

    That is the drive, of several species the mean population and drive of each. Where there is empathy, bodies' own
    drives come before what is felt.
    """
    if show:
        return list(show)
    rows = [row(outcome.cell, outcome.summary or {}) for outcome in outcomes]

    def drives(felt: str, own: str) -> list[str]:
        if all(each.get(own, each.get(felt)) == each.get(felt) for each in rows):  # nobody feels anything
            return [felt]
        return [own, felt]

    species = list(dict.fromkeys(key.partition(".")[2] for each in rows for key in each if key.startswith(BY_SPECIES)))
    found = drives(LEARNED, LEARNED_OWN) if any(outcome.cell.evaluate for outcome in outcomes) else []
    if len(species) > 1:
        for name in species:
            found += [f"population.{name}.mean", *drives(f"{BY_SPECIES}{name}", f"{OWN_BY_SPECIES}{name}")]
    return found or drives("mean_drive", "mean_own_drive")


def label(column: str) -> str:
    """Return what a column of the table is called where it is printed and drawn."""
    for start, end, ending in (
        (BY_SPECIES, "", " drive"),
        (OWN_BY_SPECIES, "", " own drive"),
        ("population.", ".mean", " population"),
        ("measures.", ".mean", ""),
    ):
        name = column.removeprefix(start).removesuffix(end)
        if column == start + name + end:
            return name + ending
    return column if "." in column else column.replace("_", " ")


def check_shown(columns: Iterable[str], cells: Sequence[Cell], summary_of: Callable[[Cell], Mapping[str, Any]]) -> None:
    """Raise EcologyError where one of `columns` is none of the numbers that the table will hold.

    `summary_of` returns the summary of a run before its first tick; settings may change which species there are.
    """
    missing, known = set(columns), list[str]()
    choices = {repr(cell.varied): cell for cell in reversed(cells)}  # the first of each
    seen = set()
    for cell in reversed(choices.values()):
        if not missing:
            return
        world = cell.plan.load()
        named = [
            (species.name, [need.name for need in species.needs], [action.name for action in species.actions])
            for species in world.species
        ]
        if (kind := repr((named, [*world.measures]))) in seen:
            continue
        seen.add(kind)
        summary = summary_of(cell)
        numbers = {**summary, **({LEARNED: None, LEARNED_OWN: None} if cell.evaluate else {})}
        head = row(cell, {})
        known += [key for key in row(cell, numbers) if key not in head]
        causes = tuple(f"population.{name}.died_of." for name in summary["population"])  # as many as will happen
        missing = {column for column in missing if column not in known and not column.startswith(causes)}
    for column in sorted(missing):
        raise EcologyError(
            f"--show takes a column of {TABLE} that holds numbers, got {column!r}. {nearest(column, set(known))}"
        )


def write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write `rows` as parquet, in the place of what is there; a column of several kinds holds words."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {}
    for key in dict.fromkeys(key for each in rows for key in each):
        values = [each.get(key) for each in rows]
        try:
            columns[key] = pa.array(values)
        except (pa.ArrowException, OverflowError):
            columns[key] = pa.array([None if value is None else str(value) for value in values])
    beside = path.with_name(path.name + ".new")
    pq.write_table(pa.table(columns), beside, compression="zstd")
    beside.replace(path)


def sum_up(out: Path, done: Sequence[Outcome], title: str, columns: Sequence[str] = ("mean_drive",)) -> list[Path]:
    """Write the table and the figure of the runs that are whole, and return their paths; of none, nothing."""
    if not done:
        return []
    ordered = sorted(done, key=lambda outcome: (repr(outcome.cell.varied), outcome.cell.plan.seed))
    write_table(out / TABLE, rows_of(ordered))
    panels = {label(column): found for column in columns if (found := points(ordered, column))}
    if not panels:  # nobody lived
        return [out / TABLE]
    draw_sweep(out / FIGURE, panels, title)
    return [out / TABLE, out / FIGURE]


@dataclass(frozen=True, kw_only=True)
class SweepPoint:
    """The mean of a column of the table under one choice of settings, over seeds."""

    varied: Mapping[str, Any]
    values: Sequence[float]  # of the runs that have one
    mean: float
    low: float  # of the t interval over seeds; NaN of one run
    high: float

    @property
    def runs(self) -> int:
        """Return the number of runs."""
        return len(self.values)


def points(outcomes: Iterable[Outcome], column: str = "mean_drive") -> list[SweepPoint]:
    """Return the means of a column by what varied, with their 95 % t intervals over seeds."""
    from scipy import stats  # slow to load

    outcomes = list(outcomes)
    groups: dict[str, tuple[Mapping[str, Any], list[float]]] = {}
    for outcome, record in zip(outcomes, rows_of(outcomes), strict=True):
        value = record.get(column)
        if value is not None:
            groups.setdefault(repr(outcome.cell.varied), (outcome.cell.varied, []))[1].append(float(value))
    found = []
    for varied, values in groups.values():
        n, mean, low, high = len(values), float(np.mean(values)), np.nan, np.nan
        if n > 1:
            half = stats.t.ppf((1 + CONFIDENCE) / 2, n - 1) * stats.sem(values)
            low, high = mean - half, mean + half
        found.append(SweepPoint(varied=varied, values=values, mean=mean, low=float(low), high=float(high)))
    return found


def draw_sweep(path: Path, panels: Mapping[str, Sequence[SweepPoint]], title: str) -> None:
    """Draw means over the first setting that varies, a line for every choice of the others, a panel for every name."""
    from ecology.observers.plotting import new_figure, save_figure  # slow to load

    everything = [point for found in panels.values() for point in found]
    axes = [axis for axis in everything[0].varied if len({repr(point.varied[axis]) for point in everything}) > 1]
    across = min(len(panels), 2)
    down = -(-len(panels) // across)
    figure = new_figure((7.5 if across == 1 else 12.0, 4.6 if down == 1 else 3.8 * down))
    for i, (what, found) in enumerate(panels.items()):
        ax = figure.add_subplot(down, across, i + 1)
        _panel(
            ax, found, axes, list(dict.fromkeys(str(point.varied[axes[0]]) for point in everything)) if axes else [""]
        )
        ax.set_ylabel(f"{what}, drive units (less is better)" if what.endswith("drive") else what)
    runs = sorted({point.runs for point in everything})
    over = "-".join(map(str, runs))
    bars = f"mean and {CONFIDENCE:.0%} t interval over {over} seeds (dots)" if runs[-1] > 1 else "one seed"
    figure.suptitle(f"{title}: {bars}", fontsize=11)
    save_figure(figure, path, DPI)


def _panel(ax: Any, found: Sequence[SweepPoint], axes: Sequence[str], words: Sequence[str]) -> None:
    """Draw the means of one column over the first of `axes`, whose values are `words` where they are no numbers."""
    from ecology.observers.plotting import draw_means, style

    first, others = (axes[0], axes[1:]) if axes else ("", [])
    values = [point.varied.get(first, "") for point in found]
    numeric = all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)
    lines: dict[str, list[tuple[float, SweepPoint]]] = {}
    for value, point in zip(values, found, strict=True):
        name = ", ".join(f"{axis.removeprefix('set.')} {point.varied[axis]}" for axis in others)
        lines.setdefault(name, []).append((float(value) if numeric else words.index(str(value)), point))
    every = np.unique([at for line in lines.values() for at, _ in line])
    step, wide = min(np.diff(every), default=1.0), float(np.ptp(every)) or 1.0
    for i, (name, line) in enumerate(lines.items()):
        line.sort(key=lambda pair: pair[0])
        aside = 0.02 * step * (i - (len(lines) - 1) / 2)  # intervals that lie on each other are told apart
        at = np.array([at for at, _ in line]) + aside
        mean = np.array([point.mean for _, point in line])
        bounds = np.array([(point.low, point.high) for _, point in line]).T
        draw_means(ax, at, mean, bounds, [point.values for _, point in line], style(i), wide=wide, label=name)
    if not numeric:
        ax.set_xticks(range(len(words)), words)
    ax.set_xlabel(first.removeprefix("set."))
    if others:
        ax.legend(fontsize=8, frameon=False)
