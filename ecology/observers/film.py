"""A film of a stretch of a run, made of what was recorded: a gif, or an mp4 where ffmpeg is installed."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from ecology.errors import EcologyError, check_writable
from ecology.observers.frame import Frame
from ecology.observers.picture import Picture, Shot
from ecology.scenario import Scenario
from ecology.spec import require

FRAMES = 200  # of a film whose beginning is not told, at most
LARGEST = 5_000  # frames of a film


def film(
    scenario: Scenario,
    frames: list[Frame],
    target: Path,
    *,
    fps: float = 20.0,
    shot: Shot | None = None,
    tell: Callable[[int], None] = lambda _: None,
) -> None:
    """Write `frames` as a new file, .gif or .mp4, at `fps` frames per second, taken as `shot` says.

    `tell` hears of each one.

    Raises EcologyError, and leaves no file, where it exists or cannot be written.
    """
    check_film(target, fps)
    require(bool(frames), "there is no recorded tick in that stretch; give another --from and --to.")
    require(
        len(frames) <= LARGEST,
        f"a film has at most {LARGEST} frames, got {len(frames)}; give a later --from or an earlier --to.",
    )

    def pictures() -> Iterable[np.ndarray]:
        picture = Picture(scenario, shot)
        for i, shown in enumerate(frames):
            tell(i)
            yield picture.draw(shown)

    try:
        (_gif if target.suffix == ".gif" else _mp4)(target, pictures(), fps)
    except OSError as error:
        with contextlib.suppress(OSError):  # where nothing can be written, nothing can be taken away
            target.unlink()
        raise EcologyError(f"the film {str(target)!r} cannot be written: {error}.") from error


def check_film(target: Path, fps: float) -> None:
    """Raise EcologyError unless a film can be written to `target`."""
    require(target.suffix in (".gif", ".mp4"), f"a film is a .gif or an .mp4 file, got {str(target)!r}.")
    require(not os.path.lexists(target), f"the file {str(target)!r} exists; choose another name.")
    require(target.parent.is_dir(), f"there is no folder {str(target.parent)!r} for the film; make it first.")
    check_writable(target.parent)
    require(0 < fps <= 100, f"a film has from 0 to 100 frames per second, got {fps!r}.")
    if target.suffix == ".mp4":
        _encoder()


def _gif(target: Path, pictures: Iterable[np.ndarray], fps: float) -> None:
    from PIL import Image

    first, *rest = (Image.fromarray(p).quantize(dither=Image.Dither.NONE) for p in pictures)
    first.save(target, save_all=True, append_images=rest, duration=round(1000 / fps), loop=0)


def _mp4(target: Path, pictures: Iterable[np.ndarray], fps: float) -> None:
    writer = None
    for p in pictures:
        if writer is None:
            height, width = p.shape[:2]
            writer = _encoder().write_frames(str(target), (width, height), fps=fps, macro_block_size=2)
            writer.send(None)
        writer.send(np.ascontiguousarray(p))
    if writer is not None:
        writer.close()


def _encoder() -> Any:
    """Return the library that writes mp4 files."""
    try:
        import imageio_ffmpeg
    except ImportError as error:
        raise EcologyError(
            "an mp4 needs ffmpeg; run pip install -e '.[film]' in the project's folder, or write a .gif."
        ) from error
    return imageio_ffmpeg
