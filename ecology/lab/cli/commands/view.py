"""`ecology view`: open a recording."""

from __future__ import annotations

import contextlib
import functools
import json
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from ecology.errors import EcologyError
from ecology.lab.cli.options import Port, Trust, announces_compiling, check_port, say

ORDER = 11


@announces_compiling
def command(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run, or a recording.")],
    focus: Annotated[
        str | None, typer.Option(metavar="WHO", help="Agent (prey_17) or species to show closely.")
    ] = None,
    serve: Annotated[
        bool, typer.Option("--serve", help="Show the recording in a browser, where a click brings an agent into focus.")
    ] = False,
    port: Port = None,
    relive: Annotated[
        bool,
        typer.Option(
            "--relive",
            help="With --focus or --serve: compute the decisions of agents that were not in focus, from checkpoints.",
        ),
    ] = False,
    trust: Trust = False,
    screenshot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png", help="File to save a picture to, instead of opening a viewer; needs no screen."
        ),
    ] = None,
    tick: Annotated[int | None, typer.Option(min=0, help="Tick of the picture.", show_default="the last")] = None,
) -> None:
    """Open the recording of a run in the Rerun viewer, or save what it shows."""
    if tick is not None and screenshot is None:
        raise EcologyError("--tick requires --screenshot FILE.png.")
    check_port(port, serve=serve)
    if relive and focus is None and not serve:
        raise EcologyError("--relive requires an agent: give --focus WHO, or --serve and click one.")
    if trust and not relive:
        raise EcologyError("--trust requires --relive: without it, `view` runs no code of a run.")
    if serve and screenshot is not None:
        raise EcologyError("--serve and --screenshot are two ways to look; give one of them.")
    from ecology.lab.cli.live import wait, web_port
    from ecology.lab.runs.folder import CONFIG, RECORDING
    from ecology.lab.runs.minds import decisions
    from ecology.lab.runs.run import load_world
    from ecology.observers import viewer  # only here is a viewer looked for

    with contextlib.ExitStack() as stack:
        if focus is not None or serve or _needs_layout(run):
            from ecology.observers.hindsight import Hindsight  # slow to load

            if not (run / CONFIG).is_file():
                raise EcologyError(
                    f"--focus and --serve need the world of a run: there is no {CONFIG} in {str(run)!r}; give "
                    "the folder of the run."
                )
            world, name = load_world(run), run.absolute().name
            again = functools.partial(decisions, run, trust=trust, say=say(quiet=False)) if relive else None
            past = Hindsight(stack.enter_context(viewer.open_recording(run)), world, name, again)
            tick = past.lived_until if tick is None else tick
            run = past.write_view(focus, Path(stack.enter_context(tempfile.TemporaryDirectory())) / RECORDING)
        if serve:
            from ecology.observers.page import Page, Shown

            shown = Shown([run.name], past.hear, files={run.name: run}, named=past.layer_named)
            page = Page(shown, port=web_port(port), name=name)
            stack.callback(page.close)
            print(f"look in a browser: {page.url}\nstop with Ctrl-C", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                wait()
        elif screenshot is not None:
            from ecology.observers import screenshot as pictures  # slow to load

            pictures.screenshot(run, screenshot, tick=tick)
            print(f"written: {screenshot}")
        else:
            viewer.view(run)


def _needs_layout(run: Path) -> bool:
    """Return whether a run needs a new layout: no agent is alive at its end, or it was forked."""
    from ecology.lab.runs.folder import SUMMARY

    try:
        summary = json.loads((run / SUMMARY).read_text(encoding="utf-8"))
        return "fork" in summary or not any(of["end"] for of in summary["population"].values())
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return False
