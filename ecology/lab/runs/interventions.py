"""What is done to a run between its ticks: its log, and what waits to be done.

`interventions.jsonl` in the run's folder has a line for each, `{"tick": 120, "do": "move food 0.5 1.5"}`: done when 120
ticks had passed, before the next one. It is the schedule of the run as well: a checkpoint says how many of its lines
were done by then, and whoever continues from there does the others at their ticks. A run that begins with the log of
another one, in the same world from the same seed, has the same life.
"""

from __future__ import annotations

import json
import queue
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path

from ecology.errors import EcologyError, readable
from ecology.lab.runs.folder import INTERVENTIONS, replace_text
from ecology.verbs import split


@dataclass(frozen=True)
class Entry:
    """An intervention, and the number of ticks after which it is done."""

    tick: int
    do: str


class Schedule:
    """The interventions of a run in order: those that were done, and then those that wait for their tick."""

    def __init__(self, folder: Path) -> None:
        """Begin without any; `read` takes those of the folder."""
        self._file = folder / INTERVENTIONS
        self.entries: list[Entry] = []
        self.done = 0  # the first so many were done
        self.requests: queue.SimpleQueue[tuple[str, Future[str]]] = queue.SimpleQueue()  # from other threads

    def read(self, file: Path | None = None) -> None:
        """Take the interventions of the folder, if there are any, or of `file`, a log of another run."""
        if file is not None or self._file.exists():
            self.entries = read_log(file or self._file)

    def due(self, tick: int) -> Entry | None:
        """Return the next one that waits if it is to be done at `tick`, or should have been."""
        if self.done < len(self.entries) and self.entries[self.done].tick <= tick:
            return self.entries[self.done]
        return None

    def since(self, tick: int, every: int) -> list[tuple[int, str]]:
        """Return tick and line of those that were done by `tick` after the last sample, with one `every` so many."""
        return [(each.tick, each.do) for each in self.entries[: self.done] if each.tick >= tick // every * every]

    def add(self, tick: int, text: str) -> None:
        """Let an intervention be done at `tick`, after those that are to be done by then."""
        at = self.done
        while at < len(self.entries) and self.entries[at].tick <= tick:
            at += 1
        self.entries.insert(at, Entry(tick, text))

    def drop(self) -> None:
        """Take back the next one that waits."""
        del self.entries[self.done]

    def write(self) -> None:
        """Write the log, if there is anything to write and the folder is there."""
        if (self.entries or self._file.exists()) and self._file.parent.is_dir():
            lines = [json.dumps({"tick": each.tick, "do": each.do}, ensure_ascii=False) for each in self.entries]
            replace_text(self._file, "".join(f"{line}\n" for line in lines))

    def refuse(self, why: str) -> None:
        """Refuse everything that other threads wait for."""
        while not self.requests.empty():
            self.requests.get()[1].set_exception(EcologyError(why))


def as_schedule(folder: Path, dt: float) -> str:
    """Return the log of the run in `folder`, whose ticks last `dt`, as Python: a scenario's schedule.

    Raises EcologyError where nothing was done to the run.
    """
    log = folder / INTERVENTIONS
    if not log.exists():
        raise EcologyError(f"the run {str(folder)!r} has no interventions: there is no {INTERVENTIONS} in it.")
    lines = [f"    Event(do={json.dumps(each.do, ensure_ascii=False)}, at={each.tick * dt!r}, felt=False),\n"
             for each in read_log(log)]  # fmt: skip
    head = f'"""What was done to the run {folder.absolute().name}."""\n\nfrom ecology import Event\n\n'
    return f"{head}SCHEDULE = (\n{''.join(lines)})\n"


def read_log(path: Path) -> list[Entry]:
    """Return the interventions of a log; EcologyError, which names the line, where it is not one."""
    with readable("the interventions", path):
        lines = path.read_text(encoding="utf-8").splitlines()
    return list(_entries(path, lines))


def _entries(path: Path, lines: Iterable[str]) -> Iterable[Entry]:
    last = 0
    for number, line in enumerate(lines, 1):
        where = f"the interventions {str(path)!r}, line {number}"
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise EcologyError(f'{where}: a line is {{"tick": 120, "do": "..."}}, got {line[:80]!r}.') from error
        if not isinstance(entry, dict) or set(entry) != {"tick", "do"}:
            raise EcologyError(f'{where}: a line is {{"tick": 120, "do": "..."}}, got {line[:80]!r}.')
        tick, text = entry["tick"], entry["do"]
        if type(tick) is not int or tick < last:
            raise EcologyError(f"{where}: its tick is a whole number, at least that of the line before; got {tick!r}.")
        try:
            split(text)
        except EcologyError as error:
            raise EcologyError(f"{where}: {error}") from error
        last = tick
        yield Entry(tick, text)
