"""`ecology film`: make a film from a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ecology.errors import EcologyError
from ecology.lab.cli.options import Quiet, announces_compiling, takes_options

ORDER = 12


@dataclass(frozen=True)
class FilmOptions:
    """What `ecology film` is given."""

    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run that has a recording.")]
    target: Annotated[
        Path | None, typer.Argument(metavar="OUT.gif|OUT.mp4", help="File to write.", show_default="RUN/film.gif")
    ] = None
    from_: Annotated[
        int | None,
        typer.Option("--from", min=0, metavar="TICK", help="First tick.", show_default="200 frames before the end"),
    ] = None
    to: Annotated[int | None, typer.Option(min=0, metavar="TICK", help="Last tick.", show_default="the last")] = None
    fps: Annotated[float, typer.Option(help="Frames per second; each frame is one recorded tick.")] = 20.0
    size: Annotated[str, typer.Option(metavar="WxH", help="Size in pixels.")] = "800x600"
    follow: Annotated[
        str | None,
        typer.Option(metavar="WHO", help="Agent (prey_17) to mark with a ring.", show_default="with --mind the first"),
    ] = None
    zoom: Annotated[
        float | None,
        typer.Option(min=1.0, help="With --follow: let the camera follow the agent, this many times closer."),
    ] = None
    trail: Annotated[int, typer.Option(min=0, help="Length of the trails in frames.")] = 0
    mind: Annotated[bool, typer.Option("--mind", help="Show needs and decision of an agent beside the arena.")] = False
    quiet: Quiet = False


@takes_options
@announces_compiling
def command(options: FilmOptions) -> None:
    """Make a film of a run from its recording: a gif, or an mp4 with the extra `film`."""
    from ecology.lab.runs.run import load_world
    from ecology.observers import film as films
    from ecology.observers import readback  # slow to load
    from ecology.observers.picture import Shot

    run, follow, quiet = options.run, options.follow, options.quiet
    target = run / "film.gif" if options.target is None else options.target
    scenario = load_world(run)
    films.check_film(target, options.fps)
    if options.zoom is not None and follow is None:
        raise EcologyError("--zoom requires --follow WHO: the camera follows an agent.")
    shot = Shot(size=_read_size(options.size), zoom=options.zoom, trail=options.trail, beside=options.mind)
    frames = readback.frames(run, scenario, options.from_, options.to)
    if frames and (options.mind or follow is not None):
        frames = readback.follow(run, scenario, frames, follow)
    console = Console(stderr=True, quiet=quiet)
    with console.status("drawing") as status:

        def tell(i: int) -> None:
            status.update(f"drawing tick {frames[i].tick}")

        films.film(scenario, frames, target, fps=options.fps, shot=shot, tell=tell)
    if not quiet:
        print(f"written: {target}, ticks {frames[0].tick} to {frames[-1].tick}, {len(frames)} frames")


def _read_size(text: str) -> tuple[int, int]:
    """Return width and height of "800x600"; both even, as an mp4 needs them."""
    parts = text.split("x")
    good = len(parts) == 2 and all(part.isascii() and part.isdecimal() for part in parts)
    wide, tall = (int(part) for part in parts) if good else (0, 0)
    if not (200 <= wide <= 4000 and 200 <= tall <= 4000) or wide % 2 or tall % 2:
        raise EcologyError(f"--size is WIDTHxHEIGHT in pixels, even numbers from 200 to 4000, got {text!r}.")
    return wide, tall
