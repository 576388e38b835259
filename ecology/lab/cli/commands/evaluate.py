"""`ecology evaluate`: measure how well a run has learned."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from ecology.errors import EcologyError, check_writable, nearest, writable
from ecology.lab.cli.options import (
    Quiet,
    Source,
    Trust,
    announces_compiling,
    format_number,
    read_pairs,
    read_setting,
    say,
    takes_options,
)
from ecology.lab.runs.defaults import EVALUATED, EVALUATION_SEED, SKIPPED

if TYPE_CHECKING:
    from ecology import Scenario
    from ecology.lab.runs.run import Run

ORDER = 9


@dataclass(frozen=True)
class EvaluateOptions:
    """What `ecology evaluate` is given."""

    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]
    species: Annotated[
        str | None, typer.Option(help="Species whose learner is evaluated.", show_default="the first")
    ] = None
    ticks: Annotated[int, typer.Option(min=10, help="Length of each life that is measured.")] = EVALUATED
    places: Annotated[int, typer.Option(min=1, help="Places per need at which choices are probed.")] = 60
    seed: Annotated[
        int | None, typer.Option(min=0, help="Random seed of the evaluation.", show_default="the run's + 1000")
    ] = None
    in_: Annotated[
        str | None, typer.Option("--in", metavar="SCENARIO", help="Scenario to evaluate in.", show_default="the run's")
    ] = None
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Setting of the world to evaluate in.")
    ] = None
    device: Annotated[
        str, typer.Option(metavar="cpu|plain|cuda|cuda:N|mps", help="Device that the learner computes on.")
    ] = "cpu"  # one agent at a time: elsewhere it takes longer
    again: Annotated[bool, typer.Option("--again", help="Replace an existing evaluation made with other options.")] = (
        False
    )
    source: Source = None
    trust: Trust = False
    quiet: Quiet = False


@takes_options
@announces_compiling
def command(options: EvaluateOptions) -> None:
    """Evaluate a run's learner against baselines; write evaluation.json and figures."""
    from ecology.agents import evaluation, figures
    from ecology.lab.runs.folder import EVALUATION, FIGURES, METRICS, check_evaluation, check_links, write_json
    from ecology.lab.runs.run import open_run
    from ecology.observers import recorder

    run, species, quiet = options.run, options.species, options.quiet
    loaded = open_run(run, device=options.device, choice=options.source, trust=options.trust, say=say(quiet))
    if species is not None and species not in loaded.learners:
        raise EcologyError(f"the run has no species {species!r}. {nearest(species, loaded.learners)}")
    learner = loaded.learners[species or next(iter(loaded.learners))]
    world, where = _world_to_measure_in(loaded, learner.group.name, options.in_, options.set_ or ())
    seed = loaded.plan.seed + EVALUATION_SEED if options.seed is None else options.seed
    measured: dict[str, Any] = {
        "device": options.device,
        "seed": seed,
        "ticks": options.ticks,
        "places": options.places,
    }
    if not options.again:
        words: dict[str, Any] = {"scenario": world.name, "settings": dict(world.settings)}
        check_evaluation(where, {**words, "species": learner.group.name, **measured})
    check_links(run)
    loaded.restore()
    metrics = run / METRICS
    for folder in (where, where / FIGURES):  # what cannot be kept, or is damaged, is told before the long part
        check_writable(folder)
    if recorder.sources(metrics):
        recorder.read(metrics)

    console = Console(stderr=True, quiet=quiet)
    with console.status("evaluating") as status:

        def tell(words: str) -> None:
            if console.is_terminal:
                status.update(words)
            else:
                console.print(words, highlight=False)

        trained = evaluation.Trained(
            name=loaded.plan.learners[learner.group.name].name,
            home=None if world is loaded.scenario else loaded.scenario,
            lived=evaluation.Lived(*loaded.totals.drives(learner.group.name)),
        )
        extent = evaluation.Extent(**measured, skip=min(SKIPPED, options.ticks // 10))
        findings = evaluation.evaluate(world, learner, extent, trained, tell=tell)
        tell("figures")
        with writable(where):
            drawn = figures.draw_evaluation(where / FIGURES, world, findings, learner.group.layout.names, metrics)
            write_json(where / EVALUATION, findings.report)  # last: with it the evaluation is whole
    if not quiet:
        _say_findings(findings.report)
        print(f"written: {where / EVALUATION} and {len(drawn)} figures in {where / FIGURES}")


def _world_to_measure_in(run: Run, species: str, scenario: str | None, changes: Sequence[str]) -> tuple[Scenario, Path]:
    """Return the world to measure the learner of a species in, and the folder for what is found.

    That is the run's own for its first species in its own world, and else one within it, named for what is another.
    """
    from ecology import scenarios
    from ecology.lab.runs.source import locate

    words = [] if species == next(iter(run.learners)) else ["of", species]
    world = run.scenario
    if scenario is not None or changes:
        own = {} if scenario is not None else run.plan.settings
        scenario = scenario or run.plan.scenario
        world = scenarios.load(
            locate(scenario, run.plan.copies), **{**own, **read_pairs("--set", changes, read_setting)}
        )
        words += ["in", Path(scenario).stem, *changes]
    return world, run.folder / re.sub(r"[^\w=.-]+", "_", "-".join(words))


def _say_findings(report: Mapping[str, Any]) -> None:
    """Print an evaluation as tables."""
    console = Console()
    owns = report.get("mean_own_drive", {})
    feels = any(own["mean"] != report["mean_drive"][name]["mean"] for name, own in owns.items())
    drives = Table(
        "",
        "mean drive",
        "95 % interval",
        *(["mean own drive", "95 % interval"] if feels else []),
        title=f"{report['scenario']}, {report['ticks']:,} ticks, on {report['device']}",
    )
    known = {name: drive for name, drive in report["mean_drive"].items() if drive["mean"] is not None}
    for name, drive in sorted(known.items(), key=lambda item: item[1]["mean"]):
        words = []
        for each in (drive, owns[name]) if feels else (drive,):
            interval = f"{each['low']:.3f} to {each['high']:.3f}" if each["blocks"] > 1 else "-"
            words += [format_number(each["mean"]), interval]
        drives.add_row(name, *words, style="bold" if name == "learned" else None)
    console.print(drives)
    gap = report["closed_gap"]
    if gap is not None:
        console.print("worse than camping" if gap < 0 else f"{gap:.0%} of the way from camping to the planner")
    _say_lives(console, report)
    maps, probe = report["deviation_maps"] or {}, report["probe"]
    if maps or probe:
        needs = Table("need", "minimum of J to resource", "rank correlation", "eaten first")
        for name in {**maps, **probe}:
            mapped, right = maps.get(name, {}), probe.get(name, {}).get("share_right")
            needs.add_row(
                name,
                format_number(mapped.get("distance_of_minimum")),
                format_number(mapped.get("spearman_with_walking_distance")),
                "-" if right is None else f"{right:.0%}",
            )
        console.print(needs)
    for name, check in (report["deviation_check"] or {}).items():
        if isinstance(check, Mapping):
            console.print(
                f"J against measured drive, {name.replace('_', ' ')}: correlation "
                f"{format_number(check['correlation'])}, bias {format_number(check['bias'])}",
                highlight=False,
            )


def _say_lives(console: Console, report: Mapping[str, Any]) -> None:
    """Print how the run went, the worst block of the evaluated life, and where the agents were stuck."""
    lived, below = report["as_lived"], report["regulated"]["below"]
    if lived is not None:
        text = f"as lived: mean drive {format_number(lived['mean_drive_last_tenth'])} in the last tenth"
        if below is not None:
            since = lived["regulated_from"]
            then = (
                f"never stays below {below:.2f}" if since is None else f"stays below {below:.2f} from tick {since:,} on"
            )
            text += f"; its running mean over {lived['window']:,} ticks {then}"
        console.print(text, highlight=False)
    for name, words in (("learned", "frozen life"), ("learned_epsilon_0", "frozen life, epsilon 0")):
        worst, sinks = report["worst_block"][name], report["stuck"][name] or []
        if worst is not None:
            console.print(
                f"{words}: worst 1,000 ticks from tick {worst['from']:,}, mean drive {worst['mean']:.2f}; "
                + (f"stuck {len(sinks)} times" if sinks else "never stuck"),
                highlight=False,
            )
        for sink in sinks[:3]:
            x, y = sink["place"]
            console.print(
                f"  ticks {sink['from']:,} to {sink['to']:,} at ({x:.2f}, {y:.2f}): {sink['action']} in "
                f"{sink['share_of_action']:.0%}, mean drive {sink['mean_drive']:.2f}",
                highlight=False,
            )
