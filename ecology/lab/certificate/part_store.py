"""The finished parts of the certificate, kept so that they are not repeated."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import ecology
from ecology.errors import EcologyError
from ecology.lab.certificate.case import Case, Part, Row
from ecology.lab.runs.folder import replace_text

PARTS = "parts"  # folder of the parts that are done


class PartStore:
    """The finished parts, one JSON file each in the folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / PARTS

    def read(self, case: Case, part: Part) -> Any | None:
        """Return the value of a part; None if it is not done or was made with other parameters."""
        try:
            record = json.loads(self._path(case, part).read_text(encoding="utf-8"))
            return record["value"] if record["words"] == self._parameters(part) else None
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def do(self, case: Case, part: Part) -> Any:
        """Compute a part and keep its value."""
        start = time.monotonic()
        value = part.compute()
        record = {"words": self._parameters(part), "seconds": round(time.monotonic() - start, 1), "value": value}
        path = self._path(case, part)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_text(path, json.dumps(record, indent=1) + "\n")
        except OSError as error:
            raise EcologyError(f"the folder {str(self.folder)!r} cannot be written: {error.strerror}.") from error
        return value

    def _path(self, case: Case, part: Part) -> Path:
        return self.folder / case.name / f"{part.key}.json"

    def _parameters(self, part: Part) -> Any:
        return json.loads(json.dumps({"version": ecology.__version__, **part.parameters}))


def unfinished_parts(case: Case, ledger: PartStore) -> list[Part]:
    """Return the parts of a case that are not done."""
    return [part for part in case.parts() if ledger.read(case, part) is None]


def rows(case: Case, ledger: PartStore) -> list[Row]:
    """Return the rows of a case, as far as its parts are done."""
    return case.rows(values(case, ledger))


def values(case: Case, ledger: PartStore) -> dict[str, Any]:
    """Return the values of the finished parts of a case, by their keys."""
    found = {part.key: ledger.read(case, part) for part in case.parts()}
    return {key: value for key, value in found.items() if value is not None}
