"""The process of one run of a sweep: `python -P -m ecology.lab.cli.worker [--evaluate] [--source CHOICE] FOLDER`."""

from __future__ import annotations

import contextlib
import json
import sys
from pathlib import Path

from ecology.agents import lives
from ecology.errors import EcologyError
from ecology.lab.cli import main
from ecology.lab.runs.defaults import EVALUATED, EVALUATION_SEED, SKIPPED
from ecology.lab.runs.folder import CONFIG, SUMMARY, check_links, lock, write_json
from ecology.lab.runs.run import open_run
from ecology.lab.runs.run_config import read_config
from ecology.lab.runs.sweep import LEARNED, LEARNED_OWN, PATIENCE, USER_ERROR, stop_with_parent, summary_at


def work(folder: Path, *, evaluate: bool, source: str | None = None) -> None:
    """Live what is left of a run, and measure it if it is to be evaluated; stop when standard input closes.

    Whose code it runs, the sweep has checked.
    """
    stop_with_parent()
    with contextlib.suppress(EcologyError), lock(folder, patience=PATIENCE):
        pass  # the last process in the folder has ended
    if not evaluate or summary_at(folder, read_config(folder / CONFIG)["ticks"]) is None:
        try:
            main(["run", "--resume", str(folder), "--quiet", "--trust", *(["--source", source] if source else [])])
        except SystemExit as left:
            if left.code or not evaluate:
                raise
    try:
        measure(folder, source)
    except EcologyError as error:
        print(f"ecology: {error}", file=sys.stderr)
        sys.exit(USER_ERROR)


def measure(folder: Path, source: str | None = None) -> None:
    """Add to the summary of a run what the learner of its first species has learned."""
    check_links(folder)
    run = open_run(folder, device="cpu", choice=source, trust=True)
    run.restore()
    learner = next(iter(run.learners.values()))
    life = lives.fresh_life(run.scenario, learner, EVALUATED, run.plan.seed + EVALUATION_SEED)
    summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    for key, own in ((LEARNED, False), (LEARNED_OWN, True)):
        drives = lives.drive_series(life, SKIPPED, own=own)
        summary[key] = float(drives.mean()) if len(drives) else None
    write_json(folder / SUMMARY, summary)


if __name__ == "__main__":
    chosen = sys.argv[sys.argv.index("--source") + 1] if "--source" in sys.argv else None
    work(Path(sys.argv[-1]), evaluate="--evaluate" in sys.argv, source=chosen)
