"""The Rerun viewer as a process: opened on a recording, or attached to a run.

Every process is bound to the loopback address: whoever reaches a viewer's port can read and write.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import urllib.parse
from collections.abc import Iterator, Sequence
from pathlib import Path

from ecology.errors import EcologyError, readable
from ecology.spec import require

LOOPBACK = "127.0.0.1"
RECORDING = "recording.rrd"  # in a run's folder
SERVE_PORT, WEB_PORT = 9876, 9090  # the defaults of Rerun
TIDYING, PACE = 300.0, 4e6  # granted to putting a recording in order: seconds, and bytes per second besides


def view(run: Path | str) -> None:
    """Open the recording of a run (its folder or the file) in the viewer, until it is closed.

    A recording that was cut short is opened as far as it goes. Raises EcologyError where there is
    no recording, it is not one, or no viewer can be opened.
    """
    needs_display(f"copy {str(recording_of(Path(run)))!r} to a machine with a screen and open it there, or use --serve")
    with open_recording(run) as source:
        with viewer_process(str(source), "--port", "auto", errors=subprocess.PIPE) as process:
            try:
                said = (process.communicate()[1] or b"").decode(errors="replace").strip()
            except KeyboardInterrupt:
                return
        _check_exit(process.returncode, said)


@contextlib.contextmanager
def open_recording(run: Path | str) -> Iterator[Path]:
    """Give the recording of a run (its folder or the file) as one whole file, a copy where it was cut short."""
    path = recording_of(Path(run))
    with tempfile.TemporaryDirectory() as folder:
        one = is_complete(path) and not resumed_path(path).exists()
        require(
            not one or _holds_recording(path), _describe_damage(path)
        )  # of a file that holds nothing a viewer shows its own page
        yield path if one else repair_recording(path, Path(folder) / RECORDING)


def attach(url: str) -> subprocess.Popen[bytes]:
    """Open the viewer on a run that serves at `url` (`RerunObserver.url`); it outlives the run."""
    needs_display("use --serve and look from a browser")
    return _start(url, "--port", "auto", "--expect-data-soon", own_session=True)


def recording_of(run: Path) -> Path:
    """Return the recording of a run, given its folder or the file; EcologyError where there is none."""
    path = run / RECORDING if run.is_dir() else run
    require(path.is_file(), f"there is no recording at {str(path)!r}; give the folder of a run that recorded.")
    with readable("the recording", path), path.open("rb") as file:
        require(
            file.read(3) == b"RRF",
            f"{str(path)!r} is not a Rerun recording, or its start is damaged; record the run again.",
        )
    return path


def is_complete(path: Path) -> bool:
    """Return whether the recording was closed: whether it ends with its footer."""
    with path.open("rb") as file:
        file.seek(-min(64, path.stat().st_size), os.SEEK_END)
        return b"RRF2FOOT" in file.read()


def resumed_path(path: Path) -> Path:
    """Return where a resumed run records until it ends and the stretches are joined."""
    return path.with_suffix(".resumed.rrd")


def unfinished_path(path: Path) -> Path:
    """Return where a recording is put in order, beside the one that it takes the place of."""
    return path.with_suffix(".unfinished.rrd")


def recording_parts(path: Path) -> list[Path]:
    """Return the files that hold the recording at `path`: more than one while a run is resumed."""
    return [part for part in (path, resumed_path(path)) if part.exists()]


def join_recordings(parts: Sequence[Path], target: Path) -> bool:
    """Join recordings into `target`, in few large chunks; say whether it worked, nothing lost if not."""
    good = _tidy(parts, target)
    for part in parts if good else ():
        if part != target:
            part.unlink()
    return good


def repair_recording(path: Path, target: Path) -> Path:
    """Return a copy, at `target`, of a recording that was cut short, as far as it goes."""
    _check_room(recording_parts(path), target)
    require(_tidy(recording_parts(path), target), _describe_damage(path))
    return target


def merge_recordings(parts: Sequence[Path], target: Path) -> Path:
    """Write recordings of one identity as one to the new file `target`."""
    _check_room(parts, target)
    require(_tidy(parts, target, "merge"), f"the recording {str(parts[0])!r} cannot be read; record the run again.")
    return target


def free_port(host: str, port: int) -> int:
    """Return `port`, or one that is free for 0; EcologyError where it is taken."""
    require(isinstance(port, int) and 0 <= port < 65536, f"a port is a whole number below 65536, got {port!r}.")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise EcologyError(
                f"cannot serve at {host}:{port} ({error.strerror}); free the port, or give another with --port."
            ) from error
        return probe.getsockname()[1]


def preferred_port(host: str, port: int) -> int:
    """Return `port` where it is free, else any port that is: another run may serve at this one."""
    try:
        return free_port(host, port)
    except EcologyError:
        return free_port(host, 0)


def check_url(url: str) -> str:
    """Return `url` if it can be a viewer's address."""
    parts = urllib.parse.urlsplit(url)
    require(
        parts.scheme in ("rerun", "rerun+http", "rerun+https") and bool(parts.hostname) and parts.path == "/proxy",
        f"a viewer's address is rerun+http://HOST:PORT/proxy, got {url!r}.",
    )
    return url


@contextlib.contextmanager
def viewer_process(*arguments: str, errors: int = subprocess.DEVNULL) -> Iterator[subprocess.Popen[bytes]]:
    """Run the viewer within a `with`; it is closed at its end."""
    process = _start(*arguments, errors=errors)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _start(*arguments: str, errors: int = subprocess.DEVNULL, own_session: bool = False) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [*_viewer(), "--bind", LOOPBACK, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=errors,
        env=_quiet_environment(),
        start_new_session=own_session,
    )


def _viewer() -> list[str]:
    """Return the packaged viewer; the program itself, not the script around it, so that it can be ended."""
    found = importlib.util.find_spec("rerun_cli")
    for name in ("rerun", "rerun.exe"):
        if found and found.origin and (program := Path(found.origin).with_name(name)).is_file():
            return [str(program)]
    raise EcologyError("the Rerun viewer is not installed; install rerun-sdk, which brings it.")


def _quiet_environment() -> dict[str, str]:
    return {**os.environ, "RUST_LOG": "error"}


def needs_display(instead: str) -> None:
    """Raise EcologyError where there is no screen, saying what to do `instead`."""
    screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    require(
        not sys.platform.startswith("linux") or screen,
        f"there is no screen to open the viewer on (neither DISPLAY nor WAYLAND_DISPLAY is set); {instead}.",
    )


def _check_exit(code: int, said: str) -> None:
    require(
        code <= 0,
        f"the viewer stopped with the code {code}: {said.splitlines()[-1] if said else 'it said nothing'}",
    )


def _holds_recording(path: Path) -> bool:
    """Return whether a file, closed, holds a recording."""
    from ecology.observers.readback import holds_recording  # slow to load

    return holds_recording(path)


def _describe_damage(path: Path) -> str:
    return f"the recording {str(path)!r} is damaged and nothing of it can be read; record the run again."


def _check_room(parts: Sequence[Path], target: Path) -> None:
    """Raise EcologyError where a copy of recordings has no room at `target`: their reader would call them damaged."""
    size, free = sum(part.stat().st_size for part in parts), shutil.disk_usage(target.parent).free
    require(
        size <= free,
        f"a copy of the recording {str(parts[0])!r} needs {size / 1e6:,.0f} MB in {str(target.parent)!r}, where "
        f"{free / 1e6:,.0f} MB are free; make room, or set TMPDIR to a folder with room.",
    )


def _tidy(parts: Sequence[Path], target: Path, how: str = "optimize") -> bool:
    """Write what can be read of `parts` to `target`, optimised in few large chunks; say whether that was anything."""
    beside = unfinished_path(target)
    command = [*_viewer(), "rrd", how, *map(str, parts), "-o", str(beside)]
    try:
        beside.unlink(missing_ok=True)  # not through a link
        patience = TIDYING + sum(part.stat().st_size for part in parts) / PACE
        done = subprocess.run(command, check=False, capture_output=True, timeout=patience, env=_quiet_environment())
        good = done.returncode == 0 and beside.stat().st_size > 0 and is_complete(beside) and _holds_recording(beside)
    except (OSError, subprocess.TimeoutExpired):
        good = False
    if good:
        os.replace(beside, target)
    beside.unlink(missing_ok=True)
    return good
