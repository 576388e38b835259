"""A picture of a recording as a viewer shows it, without a screen."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from ecology.errors import EcologyError, check_writable
from ecology.observers.readback import span
from ecology.observers.viewer import LOOPBACK, free_port, open_recording, viewer_process
from ecology.spec import require

ATTEMPTS = 60  # to reach a viewer that was started, half a second apart
SETTLING = 12.0  # seconds in which a viewer's notices of the start fade and chunks load
BAR = 35  # height of the viewer's own bar, logical points


def screenshot(
    run: Path | str, picture: Path | str, *, tick: int | None = None, size: tuple[int, int] = (1600, 900)
) -> None:
    """Save what a viewer shows of a run (its folder or recording) as a new PNG file, without a screen.

    `tick`: where the cursor stands, the end when None. `size` in logical points; the picture has
    twice as many pixels each way. Needs a Vulkan driver, a software one (Mesa's lavapipe) will do.
    Raises EcologyError, and writes nothing, where the file exists or cannot be written, the recording
    does not reach `tick`, or the viewer cannot draw.
    """
    target = Path(picture)
    require(target.suffix == ".png", f"a screenshot is a .png file, got {str(target)!r}.")
    require(not os.path.lexists(target), f"the file {str(target)!r} exists; choose another name.")
    require(target.parent.is_dir(), f"there is no folder {str(target.parent)!r} for the screenshot; make it first.")
    check_writable(target.parent)
    with open_recording(run) as source, tempfile.TemporaryDirectory() as folder:
        if tick is not None:
            first, last = span(source)
            require(
                first <= tick <= last,
                f"a screenshot is of a tick that was recorded, {first} to {last}; got {tick}, give one of those.",
            )
        shown = Path(folder) / target.name
        _shoot(source.resolve(), shown, tick, size)
        with Image.open(shown) as drawn:  # without the window's own bar
            cropped = drawn.crop((0, BAR * drawn.width // size[0], drawn.width, drawn.height))
        try:
            cropped.save(target)
        except OSError as error:
            with contextlib.suppress(OSError):
                target.unlink()
            raise EcologyError(f"the screenshot {str(target)!r} cannot be written: {error}.") from error


def _shoot(source: Path, shown: Path, tick: int | None, size: tuple[int, int]) -> None:
    """Save the window of a viewer on the recording `source` to the file `shown`."""
    port, reason = free_port(LOOPBACK, 0), "it stopped at once"
    with viewer_process(
        "--headless", "--hide-welcome-screen", "--port", str(port), "--window-size", f"{size[0]}x{size[1]}"
    ) as process:
        viewer = None
        for _ in range(ATTEMPTS):
            if process.poll() is not None:
                break
            try:
                viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
                viewer.open(str(source))
                break
            except Exception as error:
                viewer, reason = None, str(error)
                time.sleep(0.5)
        require(
            viewer is not None,
            f"no viewer could be started to draw {str(source)!r}: {reason}. It needs a Vulkan driver; where there "
            "is no GPU, install Mesa's lavapipe.",
        )
        assert viewer is not None
        try:
            time.sleep(SETTLING)
            if tick is not None:
                viewer.set_time("tick", sequence=tick, play_state="paused")
                time.sleep(SETTLING / 3)
            reports = [r for view in viewer.get_state().views for r in view.reports]
            viewer.save_screenshot(str(shown))
        except Exception as error:
            raise EcologyError(f"the viewer cannot draw {str(source)!r}: {error}.") from error
    require(not reports, f"the viewer cannot draw all of {str(source)!r}: {reports}.")
