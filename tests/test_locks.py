"""One process at a time writes to the folder of a run."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ecology import EcologyError
from ecology.lab.cli import main
from ecology.lab.runs.folder import is_locked, lock

HOLD = """
import sys, time
from pathlib import Path
from ecology.lab.runs.folder import lock
with lock(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(600)
"""
TRY = """
import sys
from pathlib import Path
from ecology.lab.runs.folder import is_locked, lock
with lock(Path(sys.argv[1])):
    print(is_locked(Path(sys.argv[1])), *Path(sys.argv[1]).iterdir())
"""
DROP, WRITE_ANYWHERE = 24, 1  # PR_CAPBSET_DROP and CAP_DAC_OVERRIDE of Linux


def hold(folder: Path) -> subprocess.Popen[str]:
    """Return another process that has `folder` locked."""
    process = subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "locked\n"
    return process


def test_a_lock_ends_with_its_process(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A folder that another process has locked is refused with exit code 2, and free once that process is killed."""
    (tmp_path / "config.toml").write_text("")
    assert not is_locked(tmp_path)
    process = hold(tmp_path)
    try:
        assert is_locked(tmp_path)
        with pytest.raises(SystemExit, match="2"):
            main(["run", "--resume", str(tmp_path)])
        said = capsys.readouterr().err
        assert said == (
            f"ecology: another process is writing to the folder {str(tmp_path)!r}; wait until it ends, or stop it.\n"
        )
    finally:
        process.send_signal(signal.SIGKILL if hasattr(signal, "SIGKILL") else signal.SIGTERM)
        process.communicate()
    assert not is_locked(tmp_path)
    with lock(tmp_path):
        assert is_locked(tmp_path)
    assert not is_locked(tmp_path)


def test_patience_waits_for_the_lock(tmp_path: Path) -> None:
    """With patience a lock waits that long and no longer, and takes over once it can."""
    with lock(tmp_path):
        began = time.monotonic()
        with pytest.raises(EcologyError, match="another process"), lock(tmp_path, patience=0.3):
            pass
        assert time.monotonic() - began >= 0.3
    process = hold(tmp_path)
    process.kill()
    with lock(tmp_path, patience=60.0):
        assert is_locked(tmp_path)
    process.communicate()


def test_a_missing_folder_is_not_created(tmp_path: Path) -> None:
    """Locking a folder that does not exist leaves the error to the code that opens it."""
    with lock(tmp_path / "missing"):
        pass
    assert list(tmp_path.iterdir()) == []


def obey_permissions() -> None:
    """Make permissions bind the superuser too, in a process that is about to start."""
    if os.geteuid() == 0:
        ctypes.CDLL(None).prctl(DROP, WRITE_ANYWHERE, 0, 0, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="folders have other permissions")
def test_a_read_only_folder_is_not_locked(tmp_path: Path) -> None:
    """A folder that nobody here can write to is used without a lock: a fork only reads it."""
    tmp_path.chmod(0o555)
    try:
        done = subprocess.run(
            [sys.executable, "-c", TRY, str(tmp_path)], capture_output=True, text=True, check=False,
            preexec_fn=obey_permissions,
        )  # fmt: skip
    finally:
        tmp_path.chmod(0o755)
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr
