"""Write the generated parts of the pages: tables of scenarios, components, learner settings and commands.

A page marks such a part with two comments, `<!-- generated: NAME -->` and `<!-- end -->`. `make docs` renews what is
between them; `--check` writes nothing and fails where a page is stale.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import math
import re
import sys
import textwrap
import tokenize
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import typer.main

import ecology
from ecology import Action, Need, Outcome, Resource, Scenario, Species, World, agents, scenarios, spec
from ecology.agents import hjb
from ecology.lab.certificate.cases import all_cases
from ecology.lab.cli import app, parts
from ecology.senses import PARAMETRIC

HERE = Path(__file__).parent
PART = re.compile(r"(<!-- generated: ([\w -]+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
DIRECTIONS = {0.0: "east", 0.5: "north", 1.0: "west", -0.5: "south"}  # by the angle over pi
KINDS = {
    "deviation": "deviation from the set point",
    "felt": "felt of others",
    "position": "position",
    "angle": "angle, radians",
    "plain": "number",
}


PRESETS = ("hjb", "algorithm1", "lean", "crowd")  # learners that differ in the settings of hjb alone


class Field(NamedTuple):
    """A field of a dataclass: its default is empty where one must be given."""

    name: str
    kind: str
    default: str
    about: str


# ---- Markdown --------------------------------------------------------------------------------


def cell(value: object) -> str:
    """Return a value as the text of a table cell."""
    text = str(value).replace("|", "\\|").replace("\n", " ").replace("*", "\\*").strip()
    return re.sub(r"(?<![`\w-])(--[a-z][\w-]*)", r"`\1`", text)  # options are code


def code(value: object) -> str:
    """Return a value as code in a table cell; nothing for nothing."""
    return f"`{str(value).replace('|', chr(92) + '|')}`" if str(value) else ""


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, of cells that are ready."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def number(value: float) -> str:
    """Return a number as short as it can be read."""
    return {math.inf: "inf", -math.inf: "-inf"}.get(value, f"{value:.4g}" if abs(value) < 10_000 else f"{value:,.0f}")


def literal(value: object) -> str:
    """Return a value as Python writes it, a float with six digits at most."""
    return f"{value:.6g}" if isinstance(value, float) and len(repr(value)) > 8 else repr(value)


def amounts(values: Mapping[str, float] | None, sign: str = "") -> str:
    """Return "energy 0.1, water 0.2"."""
    return ", ".join(
        f"{name} {number(value) if sign == '' else f'{value:+.4g}'}" for name, value in (values or {}).items()
    )


def prose(text: str | None) -> str:
    """Return the text of a docstring as Markdown, indented paragraphs as code."""
    result = []
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(text or "")):
        if paragraph.startswith(" "):
            result.append(f"```text\n{textwrap.dedent(paragraph)}\n```")
        else:
            parts = re.split(r"(`[^`]+`)", re.sub(r"\n(?!- )", " ", paragraph))
            result.append("".join(part if i % 2 else re.sub(r"([*<])", r"\\\1", part) for i, part in enumerate(parts)))
    return "\n\n".join(result) + "\n"


# ---- dataclasses -----------------------------------------------------------------------------


def fields_of(cls: type) -> list[Field]:
    """Return the fields of a dataclass with the comment of each in its source."""
    source = textwrap.dedent(inspect.getsource(cls))
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT
    }
    (node,) = ast.parse(source).body
    found = []
    for line in getattr(node, "body", []):
        if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
            default = "" if line.value is None else ast.unparse(line.value)
            default = {"field(default_factory=dict)": "{}", "_field(default_factory=dict)": "{}"}.get(default, default)
            about = [comments[at] for at in range(line.lineno, (line.end_lineno or 0) + 1) if at in comments]
            found.append(Field(line.target.id, ast.unparse(line.annotation), default, " ".join(about)))
    return found


def field_table(cls: type) -> str:
    """Return the fields of a dataclass as a table."""
    rows = ((code(f.name), code(f.kind), code(f.default), cell(f.about)) for f in fields_of(cls))
    return table(("field", "type", "default", "meaning"), rows)


def components() -> str:
    """Return every building block of a scenario: the dataclasses with their fields, and the functions of actions."""
    makers = (
        spec.rest,
        spec.move,
        spec.turn,
        spec.sleep,
        spec.consume,
        spec.go_to,
        spec.bite,
        spec.give,
        spec.take,
        spec.drop,
        spec.act,
    )
    blocks = [
        value for value in vars(spec).values() if dataclasses.is_dataclass(value) and value.__module__ == spec.__name__
    ]
    blocks += [each for each in PARAMETRIC if each not in blocks]
    parts = []
    for cls in (Scenario, *blocks, World, Outcome):
        assert isinstance(cls, type)
        parts.append(f"## `{cls.__name__}`\n\n{prose(cls.__doc__)}\n{field_table(cls) if fields_of(cls) else ''}")
        if cls is Action:
            for maker in makers:
                words = re.sub(r": '([^']+)'", r": \1", str(inspect.signature(maker)).partition(" -> ")[0])
                call = f"{maker.__name__}{words.replace('**rest_of: object', '...')}"
                parts.append(f"### `{maker.__name__}`\n\n```python\n{call}\n```\n\n{prose(maker.__doc__)}")
    return "\n".join(parts)


def archipelago_table() -> str:
    """Return the parts of an archipelago, each with its fields."""
    parts = (ecology.Archipelago, ecology.Island, ecology.Migration, ecology.Pool)
    return "\n".join(f"### `{cls.__name__}`\n\n{prose(cls.__doc__)}\n{field_table(cls)}" for cls in parts)


def state() -> str:
    """Return the fields of the state as a table."""
    return field_table(ecology.State)


# ---- learners --------------------------------------------------------------------------------


def learners() -> str:
    """Return the learners, one line each."""
    return table(("learner", "does"), ((code(name), cell(line)) for name, (*_, line) in agents.LEARNERS.items()))


def learner_settings() -> str:
    """Return the settings of f and J with the values of each preset; empty where it is that of `hjb`."""
    presets = {name: agents.settings(name) for name in PRESETS}
    rows = []
    for field in fields_of(hjb.HJBSettings):
        values = [preset[field.name] for preset in presets.values()]
        others = [code(value) if value != values[0] else "" for value in values[1:]]
        rows.append((code(field.name), code(values[0]), *others, cell(field.about)))
    return table(("setting", *map(code, presets), "meaning"), rows)


def baseline_settings() -> str:
    """Return the settings of the other learners."""
    others = [name for name in agents.LEARNERS if name not in PRESETS]
    rows = ((code(name), ", ".join(f"`{key}={value!r}`" for key, value in agents.settings(name).items()) or "none")
            for name in others)  # fmt: skip
    return table(("learner", "settings with their defaults"), rows)


# ---- scenarios -------------------------------------------------------------------------------


def scenario_table() -> str:
    """Return all scenarios, one line each."""
    rows = []
    for name in scenarios.names():
        world = scenarios.load(name)
        kinds = ", ".join(f"{s.count} {s.name}" for s in world.species)
        about = (scenarios.module(name).__doc__ or "").partition("\n")[0]
        rows.append((f"[`{name}`]({name}.md)", cell(about), cell(kinds), f"{world.ticks:,}"))
    return table(("scenario", "about", "agents at the start", "ticks"), rows)


def scenario(name: str) -> str:
    """Return settings, resources and spaces of a scenario."""
    build = scenarios.module(name).build
    world = scenarios.load(name)
    env = ecology.parallel_env(world)
    (left, bottom), (right, top) = world.arena.extent
    walls = "" if world.arena.walls else ", a torus without walls"
    parts = [
        "### Settings\n",
        table(("setting", "default"), ((code(k), code(literal(v))) for k, v in scenarios.settings(name).items())),
        prose(build.__doc__).replace("Return ", "`build` returns ", 1),
        f"A run has {world.ticks:,} ticks of length {number(world.dt)} by default. The arena has "
        f"{len(world.arena.vertices)} vertices and spans {number(right - left)} by {number(top - bottom)}{walls}.\n",
    ]
    if world.resources:
        parts += ["### Resources\n", table(("resource", "patches", "where", "radius", "stock", "comes back"),
                                           map(resource_row, world.resources))]  # fmt: skip
    for species in world.species:
        group = env.groups[species.name]
        layout = group.layout
        room = "" if species.slots == species.count else f", at most {species.slots}"
        parts += [
            f"### Species `{species.name}`\n",
            f"{species.count} at the start{room}; learner `{species.learner}`"
            + (f" with {settings_of(species)}" if species.learner_settings else "")
            + f"; view field {view(species)}.\n",
            table(("need", "set point", "at birth", "by itself, per unit of time", "bounds", "in the drive"),
                  map(need_row, species.needs)),
            f"Action space: `Discrete({len(group.actions)})`.\n",
            table(("index", "action", "does", "control, per unit of time", "open"),
                  ((str(i), *action_row(action)) for i, action in enumerate(species.actions))),
            f"Observation space: `Box(({len(layout.names)},), float32)`, and the action mask.\n",
            table(("index", "component", "kind", "lowest", "highest"), component_rows(layout)),
        ]  # fmt: skip
    return "\n".join(parts)


def component_rows(layout: Any) -> Iterable[tuple[str, ...]]:
    """Yield the rows of the components of zeta."""
    columns = (layout.names, layout.kinds, layout.low, layout.high)
    for i, (name, kind, low, high) in enumerate(zip(*columns, strict=True)):
        yield str(i), code(name), KINDS[kind], number(low), number(high)


def settings_of(species: Species) -> str:
    """Return the learner settings of a species."""
    return ", ".join(f"`{key}={value!r}`" for key, value in species.learner_settings.items())


def view(species: Species) -> str:
    """Return the view field of a species in words."""
    angle = round(math.degrees(species.view_angle))
    return (
        f"{angle} degrees, {'any distance' if math.isinf(species.view_range) else f'{number(species.view_range)} far'}"
    )


def need_row(need: Need) -> tuple[str, ...]:
    """Return the row of a need."""
    moves = [f"{-need.decay:+.4g}"] if need.decay else []
    moves += [f"{-need.leak:+.4g} x"] if need.leak else []
    moves += [f"noise {number(need.noise)}"] if need.noise else []
    moves += [f"season of {number(need.season.period)}"] if need.season else []
    low, high = need.bounds
    ends = f"{number(low)} to {number(high)}" + (", lethal" if need.lethal else "")
    ends += f", floor {number(need.floor)}" if math.isfinite(need.floor) else ""
    start = number(need.x0)
    return (
        code(need.name),
        number(need.set_point),
        start,
        ", ".join(moves) or "0",
        ends,
        "yes" if need.regulated else "no",
    )


def action_row(action: Action) -> tuple[str, ...]:
    """Return the row of an action: name, what it does, its control, and when it is open."""
    way = "ahead"
    if action.direction is not None:
        way = DIRECTIONS.get(round(action.direction / math.pi, 3), f"at {math.degrees(action.direction):.0f} degrees")
    lasts = f", lasts {number(action.duration)}" if action.duration else ""
    does = {
        "rest": "nothing",
        "move": f"move {way} at {number(action.speed)}",
        "turn": f"turn by {action.turn:+.4g} radians per unit of time",
        "sleep": "sleep",
        "consume": f"consume {action.resource}",
        "go_to": f"walk to {action.resource} at {number(action.speed)}",
        "bite": f"bite the nearest {action.species} within {number(action.reach)}, chance {number(action.chance)}",
        "give": f"give to the nearest {action.species} within {number(action.reach)}, efficiency "
        f"{number(action.efficiency)}",
        "take": f"take {number(action.amount)} of {action.resource}, per unit of time",
        "drop": f"put {number(action.amount)} of {action.resource} into {action.into}, per unit of time",
        "act": "its control" if action.control else "defined by the rule",
    }[action.kind] + lasts  # fmt: skip
    if action.kind == "bite":
        does += "; " + ("kills" if action.damage is None else f"takes {amounts(action.damage)}")
        does += f"; brings {amounts(action.gain)}" if action.gain else ""
    if action.kind == "give":
        does += f": {amounts(action.gives)} per unit of time"
    if action.emits:
        does += f"; sends {amounts(action.emits)}"
    opens = {"consume": ["inside its circle"], "go_to": ["while it is seen"], "bite": ["one in reach and sight"],
             "give": ["one in reach and sight"], "take": ["inside its circle, with room for it"],
             "drop": ["carrying it, with a place for it"]}.get(action.kind, [])  # fmt: skip
    opens += [f"{name} at least {number(value)}" for name, value in action.opens_from.items()]
    opens += [f"{name} below {number(value)}" for name, value in action.closes_at.items()]
    return code(action.name), cell(does), cell(amounts(action.control, "+")) or "0", cell(", ".join(opens)) or "always"


def resource_row(resource: Resource) -> tuple[str, ...]:
    """Return the row of a resource."""
    where = "scattered" if resource.position is None else "({}, {})".format(*map(number, resource.position))
    where += "" if resource.motion is None else f", {type(resource.motion).__name__}"
    where += "" if resource.availability == 1 else f", there with probability {number(resource.availability)}"
    stock = "unlimited" if math.isinf(resource.stock) else f"{number(resource.stock)} of {number(resource.most)}"
    comes = [] if resource.growth is None else [f"{resource.growth.kind}, rate {number(resource.growth.rate)}"]
    comes += ["by seeds"] if resource.seeding is not None else []
    comes += [f"spoils by {number(resource.decay)}"] if resource.decay else []
    comes += [f"gone below {number(resource.gone_below)}"] if resource.gone_below is not None else []
    growth = ", ".join(comes) or "-"
    return code(resource.name), str(resource.count), where, number(resource.radius), stock, growth


# ---- commands --------------------------------------------------------------------------------


def usage(name: str, command: Any) -> str:
    """Return a command with its arguments and the options that it requires."""
    words = [f"ecology {name}"]
    for param in command.params:
        metavar = param.metavar or str(param.name).upper()
        if param.param_type_name != "argument":
            words += [f"{param.opts[0]} {metavar}"] if param.required else []
        else:
            several = f"{metavar} ..." if param.nargs == -1 and not param.required else metavar
            words.append(metavar if param.required else f"[{several}]")
    return " ".join(words)


def command_table() -> str:
    """Return every command with the first line of its help."""
    group: Any = typer.main.get_command(app)
    first = {name: (command.help or "").strip().partition("\n")[0] for name, command in group.commands.items()}
    rows = (
        (code(usage(name, command)), cell(first[name].removesuffix("."))) for name, command in group.commands.items()
    )
    return table(("command", "does"), rows)


def commands() -> str:
    """Return every command with its arguments and options."""
    group: Any = typer.main.get_command(app)
    parts = []
    for name, command in group.commands.items():
        rows = []
        for param in command.params:
            if param.param_type_name == "argument":
                word = param.metavar or str(param.name).upper()
            else:
                takes = "" if param.is_flag else f" {param.metavar or kind(command, param.name)}"
                word = ", ".join([*param.opts, *param.secondary_opts]) + takes
            rows.append((code(word), cell(default(param)), cell(param.help or "")))
        parts.append(f"## `{usage(name, command)}`\n\n{prose(command.help)}")
        if rows:
            parts.append(table(("option", "default", "meaning"), rows))
        if name == "reproduce":
            parts.append(table(("case", "about"), ((code(c.name), cell(c.about)) for c in all_cases().values())))
    return "\n".join(parts)


def kind(command: Any, name: str) -> str:
    """Return what an option takes, by the type of the parameter of the command's function."""
    hint = typing.get_type_hints(command.callback)[name]
    kinds = {int: "N", float: "X", Path: "PATH"}
    return next((word for type_, word in kinds.items() if type_ in (hint, *typing.get_args(hint))), "VALUE")


def default(param: Any) -> str:
    """Return the default of a parameter in words; nothing where there is none."""
    if isinstance(param.show_default, str):
        return param.show_default
    value = param.default
    return "" if value in (None, False, (), [], "") or callable(value) or param.required else str(value)


# ---- pages -----------------------------------------------------------------------------------


def starters() -> str:
    """Return the components of `ecology new --with` as a table."""
    rows = ((code(name), cell(part.about), ", ".join(map(code, part.imports))) for name, part in parts.PARTS.items())
    return table(("`--with`", "puts into the room", "imports"), rows)


PARTS: dict[str, Callable[[], str]] = {
    "archipelago": archipelago_table,
    "components": components,
    "starters": starters,
    "state": state,
    "learners": learners,
    "learner settings": learner_settings,
    "baseline settings": baseline_settings,
    "scenarios": scenario_table,
    "commands": commands,
    "command table": command_table,
    **{f"scenario {name}": (lambda name=name: scenario(name)) for name in scenarios.names()},
}


def renewed(text: str) -> str:
    """Return the text of a page with its generated parts renewed."""
    return PART.sub(lambda found: f"{found[1]}\n{PARTS[found[2]]()}\n{found[4]}", text)


def stale(pages: Iterable[Path]) -> dict[Path, str]:
    """Return the new text of every page that is stale."""
    texts = {page: page.read_text(encoding="utf-8") for page in pages}
    new = {page: renewed(text) for page, text in texts.items()}
    return {page: text for page, text in new.items() if text != texts[page]}


def main() -> None:
    """Renew the pages, or check them."""
    pages = stale([HERE.parent / "README.md", *sorted(HERE.rglob("*.md"))])
    if "--check" in sys.argv[1:]:
        if pages:
            sys.exit(f"stale: {', '.join(str(page.relative_to(HERE.parent)) for page in pages)}; run `make docs`")
        return
    for page, text in pages.items():
        page.write_text(text, encoding="utf-8")
        print(f"written: {page.relative_to(HERE.parent)}")


if __name__ == "__main__":
    main()
