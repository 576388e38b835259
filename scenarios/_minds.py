"""How well and how soon an agent regulates in `paper`: the measures of one seed, and what must hold over many.

A seed is one run, trained for some ticks, and lives on from its last checkpoint. Every measure begins from that
checkpoint, so that each can be taken alone and a stopped measurement resumes.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agents import evaluation
from agents.base import Learner
from ecology import Scenario, State, Tick
from ecology.observers.base import Mind
from scenarios import _fork
from scenarios._plan import CONFIG, resolve
from scenarios._run import Run, opened, write_json

WORLD, TRAINED = "paper", 60_000  # ticks of training
LIFE, SKIP = 20_000, 1_000  # ticks of a frozen life, and of its beginning that are not measured
EVALUATION_SEED = 1_000  # added to the run's seed, as `ecology evaluate` does
BOUND = 2.0  # drive below which the running mean counts as regulated
STUCK = 2.0  # drive above which an agent that stays in one place without a meal is stuck
MOVED, PLACE = "food_3", (0.5, 1.5)  # from (7, 5.5) in the east to the south-west corner, where no other food lies
BACK, ADAPTS = 1.25, 15_000  # times the drive before the move that counts as recovered; ticks that are waited for it
DONE = "measures.json"

Tell = Callable[[str], None]


class Drives:
    """Keep the mean drive of one species in every tick, an observer."""

    def __init__(self, slots: slice) -> None:
        self._slots = slots
        self.rows: list[float] = []

    def begin(self, env: Any, minds: Mapping[str, Mind]) -> None:
        """Need nothing."""

    def watch(self, state: State, tick: Tick, minds: Mapping[str, Mind]) -> None:
        """Add one tick."""
        self.rows.append(float(tick.drive[self._slots].mean()))

    def end(self) -> None:
        """Close nothing."""


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
    if (folder / CONFIG).is_file():
        run = opened(folder, ticks)
        run.restore()
        if run.now >= ticks:
            return
        run = opened(folder, ticks)
        run.resume()
    else:
        run = Run(resolve(WORLD, changes=settings, ticks=ticks, seed=seed, record=False), folder)
        run.start()
    tell("training")
    run.live()


def measure_run(folder: Path, *, life: int = LIFE, tell: Tell = lambda _: None) -> dict[str, Any]:
    """Return the measures of the run of `paper` in `folder`, whole, and keep each there as soon as it is taken."""
    path = folder / DONE
    told: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    if told.get("life") != life:
        told = {"life": life}
    for name, measure in (("lived", lived), ("frozen", frozen), ("greedy", greedy), ("moved", moved)):
        if name not in told:
            tell(name)
            run = opened(folder)
            run.restore()
            told[name] = measure(run, life)
            write_json(path, told)
    run = opened(folder)
    return {"seed": run.plan.seed, "ticks": run.plan.ticks, **told}


def _mind(run: Run) -> tuple[Scenario, Learner]:
    return run.scenario, next(iter(run.learners.values()))


def lived(run: Run, life: int) -> dict[str, Any]:
    """Return what the training came to: the drive of its last tenth, and from which tick on it was regulated."""
    _, learner = _mind(run)
    drive, span = run.tally.drives(learner.group.name)
    window = max(1, evaluation.WINDOW // span)
    first = evaluation.regulated_from(drive, BOUND, window) if len(drive) >= window else None
    return {
        "last_tenth": float(drive[-max(1, len(drive) // 10) :].mean()),
        "regulated_from": None if first is None else first * span,
        "seconds": float(run.tally.seconds[1]),
    }


def _life(run: Run, ticks: int, epsilon: float) -> tuple[evaluation.Life, dict[str, Any]]:
    """Return a frozen life and its measures."""
    scenario, learner = _mind(run)
    life = evaluation.fresh_life(scenario, learner, ticks, run.plan.seed + EVALUATION_SEED, epsilon)
    series = evaluation.drive_series(life, min(SKIP, ticks // 10))
    worst = evaluation.worst_block(series) or {"mean": None, "from": None}
    return life, {
        "mean_drive": float(series.mean()),
        "worst_block": worst["mean"],
        "stuck": evaluation.stuck(life, learner.group, STUCK),
    }


def frozen(run: Run, life: int) -> dict[str, Any]:
    """Return the measures of a frozen life with exploration, and what f, J and the choices are worth in it."""
    scenario, learner = _mind(run)
    seed = run.plan.seed + EVALUATION_SEED
    own, told = _life(run, life, evaluation.EPSILON)
    maps = evaluation.maps_of(scenario, learner)
    if maps is not None:
        mapped = evaluation.maps_report(maps, scenario, learner.group).values()
        ranks = [each["spearman_with_walking_distance"] for each in mapped]
        told["spearman"] = float(np.mean([0.0 if rank is None else rank for rank in ranks]))
        told["minima_within_1"] = sum(each["minimum_within_1"] for each in mapped)
    probed = evaluation.probe(scenario, learner, seed)
    told["probe"] = float(np.mean([each["share_right"] for each in probed.values()]))
    gamma, lives = getattr(getattr(learner, "settings", None), "gamma", None), [own]
    if gamma is not None:
        rng, far = np.random.default_rng(seed), evaluation.horizon(gamma, learner.group.dt)
        starts = evaluation.random_starts(scenario, learner, seed, evaluation.STARTS, far + far // 4)
        lives += starts
        for name, from_ in (("life", [(own, 0, SKIP)]), ("starts", [(each, 0, 0) for each in starts])):
            check = evaluation.compare_deviation(learner, from_, gamma, evaluation.STATES, rng).report()
            told[f"bias_{name}"], told[f"correlation_{name}"] = check["bias"], check["correlation"]
    checked = evaluation.transition_check(scenario, learner, lives, seed)
    shares = {
        name: row["share_explained"] for name, row in (checked or {}).items() if row["share_explained"] is not None
    }
    if shares:
        least = min(shares, key=lambda name: shares[name])
        told |= {"least_explained": shares[least], "least_explained_movement": least}
    return told


def greedy(run: Run, life: int) -> dict[str, Any]:
    """Return the measures of a frozen life without exploration."""
    return _life(run, life, 0.0)[1]


def moved(run: Run, life: int) -> dict[str, Any]:
    """Return how soon the learner recovers, learning on, after a food was moved to the other end of the arena.

    It has recovered at the first tick, `evaluation.WINDOW` or more after the move, at which the running mean is back
    within `BACK` of what it was in the same span before the move.
    """
    _, learner = _mind(run)
    name, at = learner.group.name, run.now
    drive, span = run.tally.drives(name)
    before = float(drive[-max(1, evaluation.WINDOW // span) :].mean())
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "moved"
        forked = _fork.fork(run, at, out, changes={}, move={MOVED: PLACE}, ticks=at + ADAPTS, record=False)
        after, tick = Drives(learner.group.slots), at
        while tick < at + ADAPTS:
            tick = min(tick + evaluation.WINDOW // 2, at + ADAPTS)
            forked.live_on(tick, [after])
            if len(after.rows) >= evaluation.WINDOW:
                back = np.flatnonzero(evaluation.running_mean(np.array(after.rows)) <= BACK * before)
                if back.size:
                    return {"before": before, "recovered_after": evaluation.WINDOW + int(back[0])}
    return {"before": before, "recovered_after": None}
