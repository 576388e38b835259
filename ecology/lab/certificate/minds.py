"""How well and how soon an agent regulates in `paper`: the measures of one seed, and what must hold over many.

A seed is one run, trained for some ticks, and lives on from its last checkpoint. Every measure begins from that
checkpoint, so that each can be taken alone and a stopped measurement resumes.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import json
import math
import os
import platform
import re
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import ecology
from ecology import EcologyError, Scenario, State, Tick, agents
from ecology.agents import evaluation, lives
from ecology.agents.base import Learner
from ecology.errors import writable
from ecology.lab.certificate import reference
from ecology.lab.certificate.report import markdown
from ecology.lab.runs import sweep
from ecology.lab.runs.folder import CONFIG, lock, replace_text, write_json
from ecology.lab.runs.fork import Change, fork
from ecology.lab.runs.run import Run, open_run
from ecology.lab.runs.run_config import resolve, words_of, world_digest
from ecology.lab.runs.stopping import StoppedError
from ecology.observers.base import Mind, Observer

WORLD, TRAINED = "paper", 60_000  # ticks of training
LIFE, SKIP = 20_000, 1_000  # ticks of a frozen life, and of its beginning that are not measured
EVALUATION_SEED = 1_000  # added to the run's seed, as `ecology evaluate` does
BOUND = 2.0  # drive below which the running mean counts as regulated
STUCK = 2.0  # drive above which an agent that stays in one place without a meal is stuck
MOVED, PLACE = "food_3", (0.5, 1.5)  # from (7, 5.5) in the east to the south-west corner, where no other food lies
BACK, ADAPTS = 1.25, 15_000  # times the drive before the move that counts as recovered; ticks that are waited for it
PROBES = evaluation.PROBES  # places per need
LEARNING, ACTING = 6.4e-3, 1e-3  # seconds per tick; Intel Xeon at 2.5 GHz, 2026-11-28, and acting is a guess
DONE = "measures.json"
APART = ("agents", "lab", "observers", "scenarios")  # folders of `ecology` that do not belong to the world

Tell = Callable[[str], None]


class Drives(Observer):
    """Keep the mean drive of one species in every tick, an observer."""

    def __init__(self, slots: slice) -> None:
        self._slots = slots
        self.rows: list[float] = []

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Add one tick."""
        self.rows.append(float(tick.drive[self._slots].mean()))


def measure_seed(
    seed: int,
    ticks: int = TRAINED,
    settings: Mapping[str, Any] | None = None,
    *,
    life: int = LIFE,
    folder: Path | None = None,
    tell: Tell = lambda _: None,
) -> dict[str, Any]:
    """Train one seed of `paper` for `ticks` ticks and return its measures, plain values that JSON holds.

    `settings` are written as for `ecology run --set`: {"learner.width": 32}. `folder` keeps the run and every measure
    that is done; a call with the same folder resumes. Without one, nothing is kept. `life` is the length of a frozen
    life. `tell` is called with a line before each part.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as scratch:
            return measure_seed(seed, ticks, settings, life=life, folder=Path(scratch) / "run", tell=tell)
    train(folder, seed, ticks, settings or {}, tell)
    return measure_run(folder, life=life, tell=tell)


def train(folder: Path, seed: int, ticks: int, settings: Mapping[str, Any], tell: Tell = lambda _: None) -> None:
    """Run a seed of `paper` in `folder` to its last tick, from its last checkpoint if there is one."""
    plan = resolve(WORLD, changes=settings, ticks=ticks, seed=seed, record=False)
    cell = sweep.Cell(plan=plan, varied={}, folder=folder)
    sweep.check_cell(cell)
    if sweep.ended_summary(cell) is not None:
        return
    if (folder / CONFIG).is_file():
        run = open_run(folder)
        run.resume()
    else:
        run = Run(plan, folder)
        run.start()
    tell("training")
    run.live()


def measure_run(folder: Path, *, life: int = LIFE, tell: Tell = lambda _: None) -> dict[str, Any]:
    """Return the measures of the run of `paper` in `folder`, whole, and keep each there as soon as it is taken."""
    measures = _read_measures(folder, life)
    for name, measure in MEASURES.items():
        if name not in measures:
            tell(name)
            start, run = time.monotonic(), open_run(folder)
            run.restore()
            measures |= {"seed": run.plan.seed, "ticks": run.plan.ticks, "life": life}
            measures[name] = measure(run, life)
            measures["seconds"] = round(measures.get("seconds", 0.0) + time.monotonic() - start, 1)
            write_json(folder / DONE, measures)
    return measures


def _read_measures(folder: Path, life: int) -> dict[str, Any]:
    """Return the measures in `folder` that were taken over frozen lives of `life` ticks."""
    try:
        record = json.loads((folder / DONE).read_text(encoding="utf-8"))
        return record if record["life"] == life else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def is_done(folder: Path, life: int) -> bool:
    """Return whether `folder` holds every measure."""
    return set(MEASURES) <= set(_read_measures(folder, life))


def _mind(run: Run) -> tuple[Scenario, Learner]:
    return run.scenario, next(iter(run.learners.values()))


def measure_training(run: Run) -> dict[str, Any]:
    """Return the results of the training: the drive of its last tenth, and the tick from which it was regulated."""
    _, learner = _mind(run)
    drive, span = run.totals.drives(learner.group.name)
    return {
        "last_tenth": float(drive[-max(1, len(drive) // 10) :].mean()),
        "regulated_from": lives.find_regulation(drive, BOUND, span=span),
        "wall_seconds": float(run.totals.seconds[0]),
        "cpu_seconds": float(run.totals.seconds[1]),
    }


def _life(run: Run, ticks: int, epsilon: float) -> tuple[lives.Life, dict[str, Any]]:
    """Return a frozen life and its measures."""
    scenario, learner = _mind(run)
    life = lives.fresh_life(scenario, learner, ticks, run.plan.seed + EVALUATION_SEED, epsilon)
    series = lives.drive_series(life, min(SKIP, ticks // 10))
    worst = lives.worst_block(series)
    return life, {
        "mean_drive": float(series.mean()),
        "worst_block": worst and worst["mean"],
        "stuck": lives.stuck(life, learner.group, STUCK),
    }


def measure_frozen(run: Run, life: int) -> dict[str, Any]:
    """Return the measures of a frozen life with exploration, and what f, J and the choices are worth in it."""
    scenario, learner = _mind(run)
    seed = run.plan.seed + EVALUATION_SEED
    own, choices = _life(run, life, lives.EPSILON)
    maps = evaluation.maps_of(scenario, learner)
    if maps is not None:
        mapped = evaluation.maps_report(maps, scenario, learner.group).values()
        ranks = [each["spearman_with_walking_distance"] for each in mapped]
        choices["spearman"] = float(np.mean([0.0 if rank is None else rank for rank in ranks]))
        choices["minima_within_1"] = sum(each["minimum_within_1"] for each in mapped)
    probed = evaluation.probe(scenario, learner, seed, PROBES)
    choices["probe"] = float(np.mean([each["share_right"] for each in probed.values()]))
    gamma, watched = getattr(getattr(learner, "settings", None), "gamma", None), [own]
    if gamma is not None:
        rng, far = np.random.default_rng(seed), evaluation.horizon(gamma, learner.group.dt)
        starts = evaluation.random_starts(scenario, learner, seed, evaluation.STARTS, far + far // 4)
        watched += starts
        for name, from_ in (("life", [(own, 0, min(SKIP, life // 10))]), ("starts", [(each, 0, 0) for each in starts])):
            check = evaluation.compare_deviation(learner, from_, gamma, evaluation.STATES, rng).report()
            choices[f"bias_{name}"], choices[f"correlation_{name}"] = check["bias"], check["correlation"]
    checked = evaluation.transition_check(scenario, learner, watched, seed)
    shares = {
        name: row["share_explained"] for name, row in (checked or {}).items() if row["share_explained"] is not None
    }
    if shares:
        least = min(shares, key=lambda name: shares[name])
        choices |= {"least_explained": shares[least], "least_explained_movement": least}
    return choices


def greedy(run: Run, life: int) -> dict[str, Any]:
    """Return the measures of a frozen life without exploration."""
    return _life(run, life, 0.0)[1]


def measure_recovery(run: Run) -> dict[str, Any]:
    """Return how soon the learner recovers, learning on, after a food was moved to the other end of the arena.

    It has recovered at the first tick, `lives.WINDOW` or more after the move, at which the running mean is back
    within `BACK` of what it was in the same span before the move.
    """
    _, learner = _mind(run)
    name, at = learner.group.name, run.now
    drive, span = run.totals.drives(name)
    before = float(drive[-max(1, lives.WINDOW // span) :].mean())
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "moved"
        forked = fork(run, at, out, Change(move={MOVED: PLACE}), ticks=at + ADAPTS, record=False)
        after, tick = Drives(learner.group.slots), at
        while tick < at + ADAPTS:
            tick = min(tick + lives.WINDOW // 2, at + ADAPTS)
            forked.live_on(tick, [after])
            if len(after.rows) >= lives.WINDOW:
                back = np.flatnonzero(lives.running_mean(np.array(after.rows)) <= BACK * before)
                if back.size:
                    return {"before": before, "recovered_after": lives.WINDOW + int(back[0])}
    return {"before": before, "recovered_after": None}


MEASURES: Mapping[str, Callable[[Run, int], dict[str, Any]]] = {
    "lived": lambda run, _: measure_training(run),
    "frozen": measure_frozen,
    "greedy": greedy,
    "moved": lambda run, _: measure_recovery(run),
}


# ---- what must hold --------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Target:
    """A measure, what it was at first and what it must be, as median and as worst over seeds."""

    what: str
    part: str
    key: str
    was: tuple[str, str]  # median and worst, in words
    must: tuple[float | None, float | None]
    sign: int = 1  # 1: less is better, -1: more is better, 0: nearest to zero is best
    digits: int = 2

    def cost(self, value: float | None) -> float:
        """Return a number that is less for a better value; one that was never reached costs most."""
        if value is None:
            return math.inf
        return abs(value) if self.sign == 0 else self.sign * value

    def over(self, seeds: Sequence[Mapping[str, Any]]) -> tuple[float | None, float | None]:
        """Return median and worst over the measures of seeds, None where that was never reached."""
        values = sorted((each[self.part].get(self.key) for each in seeds), key=self.cost)
        if self.sign:
            middle = float(np.median([self.sign * self.cost(value) for value in values]))
        else:  # of the bias itself, whose sign says how it errs
            middle = float(np.median([math.inf if value is None else value for value in values]))
        return (middle if math.isfinite(middle) else None), values[-1]

    def holds(self, found: tuple[float | None, float | None]) -> bool:
        """Return whether median and worst are as they must be."""
        return all(
            must is None or self.cost(value) <= self.cost(must) for value, must in zip(found, self.must, strict=True)
        )

    def format(self, values: Sequence[float | None], empty: str) -> str:
        """Return median and worst in words."""
        return " / ".join(empty if value is None else f"{value:,.{self.digits}f}" for value in values)


TARGETS = (
    Target(what="mean drive, epsilon 0.05", part="frozen", key="mean_drive", was=("0.98", "2.65"), must=(0.70, 0.95)),
    Target(what="mean drive, epsilon 0", part="greedy", key="mean_drive", was=("0.64", "1.75"), must=(0.50, 0.65)),
    Target(
        what="worst block of 1,000 ticks, epsilon 0.05", part="frozen", key="worst_block", was=("-", "5.4"),
        must=(None, 2.0),
    ),
    Target(what="as lived, last tenth", part="lived", key="last_tenth", was=("1.25", "1.8"), must=(0.85, 1.2)),
    Target(
        what="first tick from which the running mean (2,000 ticks) stays below 2.0", part="lived", key="regulated_from",
        was=("27,000", "never"), must=(6_000, 10_000), digits=0,
    ),
    Target(
        what="ticks until the running mean is back within 1.25 x, food_3 moved", part="moved", key="recovered_after",
        was=("9,000", "-"), must=(3_000, 5_000), digits=0,
    ),
    Target(
        what="bias of J along a life", part="frozen", key="bias_life", was=("-0.14", "-"), must=(0.05, None), sign=0
    ),
    Target(
        what="bias of J after random starts", part="frozen", key="bias_starts", was=("-0.31", "-"), must=(0.10, None),
        sign=0,
    ),
    Target(
        what="least share of change explained by f", part="frozen", key="least_explained", was=("0.70", "-0.44"),
        must=(0.80, 0.80), sign=-1,
    ),
    Target(
        what="maps: Spearman, mean over needs", part="frozen", key="spearman", was=("0.96", "0.94"), must=(0.96, 0.94),
        sign=-1,
    ),
    Target(
        what="maps: needs with the minimum within 1, of 4", part="frozen", key="minima_within_1", was=("4", "4"),
        must=(4, 4), sign=-1, digits=0,
    ),
    Target(
        what="probe: share right, mean over needs", part="frozen", key="probe", was=("0.92", "0.88"), must=(0.91, 0.88),
        sign=-1,
    ),
)  # fmt: skip
HEAD = ("measure", "at first (median / worst)", "must be", "here (median / worst)", "worst seed", "reached")


def rows(seeds: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return the table of the measures of `seeds`, in the order of HEAD."""
    found: list[tuple[str, ...]] = []
    for target in TARGETS:
        values = target.over(seeds)
        worst = max(seeds, key=lambda each, of=target: of.cost(each[of.part].get(of.key)))  # type: ignore[misc]
        found.append(
            (
                target.what,
                " / ".join(target.was),
                target.format(target.must, "-"),
                target.format(values, "never"),
                str(worst["seed"]),
                "yes" if target.holds(values) else "no",
            )
        )
    return found


# ---- many seeds ------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Job:
    """One seed that is measured in a process of its own."""

    seed: int
    ticks: int
    life: int
    settings: Mapping[str, Any]
    folder: Path


def processor() -> dict[str, str]:
    """Return what the arithmetic of a run depends on: the processor, and the one that numba compiles for instead."""
    name = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        name = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), name)
    return {"processor": name, "numba_cpu_name": os.environ.get("NUMBA_CPU_NAME", "")}


def code_files() -> list[Path]:
    """Return the files of the world and of the learners, those of their subpackages included."""
    found = []
    for package in (agents, ecology):
        home = Path(package.__path__[0])
        inner = (path for path in sorted(home.rglob("*.py")) if path.relative_to(home).parts[0] not in APART)
        found += [path for path in inner if path.name != "figures.py"]
    return found


def code_digest() -> str:
    """Return a digest of the code that decides how a run goes; comments, docstrings and layout do not count."""
    digest = hashlib.sha256()
    for path in code_files():
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node):
                node.body = node.body[1:]
        digest.update(ast.dump(tree).encode())
    return digest.hexdigest()


def jobs(out: Path, seeds: Sequence[int], ticks: int, life: int, settings: Mapping[str, Any]) -> list[Job]:
    """Return what is to be measured, each seed in its folder; EcologyError where the settings do not fit.

    What is measured by other code, with other settings or on another processor lies in another folder.
    """
    if life < 2 * SKIP or ticks < lives.WINDOW:
        raise EcologyError(
            f"--life must be at least {2 * SKIP} ticks and --ticks at least {lives.WINDOW}; got {life} and "
            f"{ticks}. Pass more."
        )
    plan = resolve(WORLD, changes=settings, ticks=ticks)
    identity = [processor(), code_digest(), world_digest(plan.load()), words_of(plan.learners), ticks, life]
    name = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:12]
    folder = out / "minds" / name
    return [Job(seed=seed, ticks=ticks, life=life, settings=settings, folder=folder / f"seed-{seed}") for seed in seeds]


def work(job: Job, stop: threading.Event) -> tuple[Job, str]:
    """Measure a seed in a process of its own; return what went wrong in words, if anything."""
    words = json.dumps([job.seed, job.ticks, job.settings, job.life])
    code, said = sweep.in_process(["ecology.lab.certificate.minds", words, str(job.folder)], stop)
    return job, "" if is_done(job.folder, job.life) else said or f"it ended with exit code {code}"


def seconds(job: Job) -> float:
    """Return about how long a seed takes on one core, seconds."""
    return 40.0 + LEARNING * (job.ticks + ADAPTS) + ACTING * 2 * job.life


def read_measures(job: Job) -> dict[str, Any]:
    """Return the measures of a seed that is done."""
    return _read_measures(job.folder, job.life)


def line(job: Job) -> str:
    """Return the measures of a seed that is done in one line."""
    found = read_measures(job)
    return (
        f"mean drive {found['frozen']['mean_drive']:.2f}, worst block {found['frozen']['worst_block']:.2f}, "
        f"with epsilon 0 {found['greedy']['mean_drive']:.2f}"
    )


def write(out: Path, done: Sequence[Job]) -> tuple[str, list[Path]]:
    """Write the table of the seeds that are `done` as Markdown and JSON; return its text and the paths."""
    seeds = [read_measures(job) for job in done]
    first, chip, table = done[0], processor(), rows(seeds)
    day = datetime.now(UTC).date().isoformat()
    what = chip["processor"] + (f", compiled for {chip['numba_cpu_name']}" if chip["numba_cpu_name"] else "")
    numbers = _ranges([job.seed for job in done])
    head = (
        f"`{WORLD}`, {len(done)} seeds ({numbers}), {first.ticks:,} ticks of training, frozen lives of {first.life:,} "
        f"ticks. {day}, ecology {ecology.__version__}, {what}."
    )
    if first.settings:
        head += " Settings: " + ", ".join(f"{key}={value}" for key, value in first.settings.items()) + "."
    head += f" {reference.line()}"
    text = f"{head}\n\n{markdown(HEAD, table)}"
    name = f"minds-{re.sub(r'[^A-Za-z0-9.-]+', '_', chip['numba_cpu_name'] or 'native')}"
    report = {
        "date": day, "ecology": ecology.__version__, **chip, "ticks": first.ticks, "life": first.life,
        "settings": dict(first.settings), "reference_life": reference.here(),
        "table": [dict(zip(HEAD, row, strict=True)) for row in table], "seeds": seeds,
    }  # fmt: skip
    with writable(out):
        replace_text(out / f"{name}.md", text)
        write_json(out / f"{name}.json", report)
    return text, [out / f"{name}.md", out / f"{name}.json"]


def _ranges(seeds: Sequence[int]) -> str:
    """Return seeds in words: 0 to 31, 40."""
    found: list[list[int]] = []
    for seed in sorted(seeds):
        if found and seed == found[-1][1] + 1:
            found[-1][1] = seed
        else:
            found.append([seed, seed])
    return ", ".join(f"{a} to {b}" if a < b else f"{a}" for a, b in found)


def _process() -> None:
    """Measure one seed as `work` says; stop when standard input closes."""
    sweep.stop_with_parent()
    (seed, ticks, settings, life), folder = json.loads(sys.argv[1]), Path(sys.argv[2])
    try:
        with writable(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with lock(folder, patience=sweep.PATIENCE):
            measure_seed(seed, ticks, settings, life=life, folder=folder)
    except StoppedError as stopped:
        sys.exit(128 + stopped.signum)
    except EcologyError as error:
        print(f"ecology: {error}", file=sys.stderr)
        sys.exit(sweep.USER_ERROR)


if __name__ == "__main__":
    _process()
