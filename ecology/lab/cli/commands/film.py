"""`ecology film`: a film of a recording."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from ecology.lab.cli.options import Quiet, announces_compiling

ORDER = 12


@announces_compiling
def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run that has a recording.")],
    target: Annotated[
        Path | None, typer.Argument(metavar="[OUT.gif|OUT.mp4]", help="File to write.", show_default="RUN/film.gif")
    ] = None,
    from_: Annotated[
        int | None,
        typer.Option("--from", min=0, metavar="TICK", help="First tick.", show_default="200 frames before the end"),
    ] = None,
    to: Annotated[int | None, typer.Option(min=0, metavar="TICK", help="Last tick.", show_default="the last")] = None,
    fps: Annotated[float, typer.Option(help="Frames per second, one recorded tick each.")] = 20.0,
    quiet: Quiet = False,
) -> None:
    """Make a film of a run from its recording: a gif, or an mp4 with the extra `film`."""
    from ecology.lab.runs.run import load_world
    from ecology.observers import film as films
    from ecology.observers import readback  # slow to load

    target = run / "film.gif" if target is None else target
    scenario = load_world(run)
    films.check(target, fps)
    frames = readback.frames(run, scenario, from_, to)
    console = Console(stderr=True, quiet=quiet)
    with console.status("drawing") as status:

        def tell(i: int) -> None:
            status.update(f"drawing tick {frames[i].tick}")

        films.film(scenario, frames, target, fps=fps, tell=tell)
    if not quiet:
        print(f"written: {target}, ticks {frames[0].tick} to {frames[-1].tick}, {len(frames)} frames")
