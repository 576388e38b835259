"""The components that `ecology new --with` puts into a new scenario: lines for marked places of the template."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from ecology.errors import EcologyError, nearest

MARK = re.compile(r"^ *# \+ (\w+)\n", re.MULTILINE)
OPENING = "from ecology import "


class Part(NamedTuple):
    """What a component adds to a new scenario."""

    about: str
    imports: tuple[str, ...]
    lines: dict[str, str]  # place in the template -> lines


PARTS: dict[str, Part] = {
    "holes": Part("a pillar that stops bodies and hides what is behind it", (),
                  {"arena": "holes=[((2.5, 2.5), (3.5, 2.5), (3.5, 3.5), (2.5, 3.5))],"}),
    "doors": Part("an inner wall with a door that is open half of the time", ("Door",),
                  {"arena": 'doors=(Door(name="door", start=(3, 4), end=(3, 6), period=200.0),),'}),
    "growth": Part("a finite stock that regrows, in several patches", ("Growth",),
                   {"resources": 'Resource(name="berries", count=6, stock=1.0, growth=Growth(rate=0.01)),',
                    "actions": 'consume("berries", {"hunger": intake / 2}),'}),
    "seeding": Part("patches that are eaten up and appear elsewhere", ("Seeding",),
                    {"resources": 'Resource(name="mushroom", count=5, stock=0.5, gone_below=0.01, present=2, '
                                  "seeding=Seeding(rate=0.01)),",
                     "actions": 'consume("mushroom", {"hunger": intake}),'}),
    "motion": Part("food that drifts about", ("Drift",),
                   {"resources": 'Resource(name="shoal", motion=Drift(spread=0.05)),',
                    "actions": 'consume("shoal", {"hunger": intake}),'}),
    "risk": Part("a meal that fails half of the time and is twice as large", (),
                 {"actions": 'consume("grass", {"hunger": 2 * intake}, name="gamble", chance=0.5),'}),
    "bites": Part("two meals of one thing, a small and a large one", (),
                  {"actions": 'consume("grass", {"hunger": intake / 4}, name="nibble"),'}),
    "patch-yield": Part("a patch that yields the less, the less of it is left", ("Growth",),
                        {"resources": 'Resource(name="bush", position=(1.0, 5.0), stock=5.0, '
                                      "growth=Growth(rate=0.01)),",
                         "actions": 'consume("bush", {"hunger": 2 * intake}, by_stock=True),'}),
    "compartments": Part("a stomach that empties into another need", (),
                         {"needs": 'Need(name="sugar", set_point=1.0, start=0.5, decay=0.002, bounds=(0.0, 4.0)),\n'
                                   'Need(name="stomach", set_point=0.0, leak=0.05, regulated=False, '
                                   'feeds={"sugar": 1.0}),',
                          "actions": 'consume("grass", {"stomach": intake}, name="swallow"),'}),
    "drain": Part("an action that lowers a need in proportion to it", ("act",),
                  {"actions": 'act("doze", drain={"sleepiness": 0.05}),'}),
    "adaptation": Part("a set point that rises with intake and recovers", ("Adaptation",),
                       {"needs": 'Need(name="sweet", set_point=1.0, decay=0.002, bounds=(0.0, 6.0), '
                                 "set_range=(1.0, 3.0),\n     adaptation=Adaptation(gain=0.1, recovery=0.0005)),",
                        "actions": 'consume("grass", {"sweet": intake}, name="lick"),'}),
    "noise": Part("a need that is disturbed, and a day that changes its decay", ("Season",),
                  {"needs": 'Need(name="comfort", set_point=2.0, decay=0.002, noise=0.01, bounds=(0.0, 4.0),\n'
                            "     season=Season(amplitude=0.5, period=1000.0)),",
                   "actions": 'consume("water", {"comfort": intake}, name="bathe"),'}),
    "fields": Part("a warm spot that is sensed and acts on a need", ("Exposure", "Field", "Gauge"),
                   {"top": '\n\ndef warm(x, y, time):  # noqa: ANN001, ANN201, ARG001\n'
                           '    """Return how warm it is at places (n,)."""\n'
                           "    return 1.0 / (1.0 + (x - 3.0) ** 2 + (y - 3.0) ** 2)",
                    "needs": 'Need(name="heat", set_point=1.0, leak=0.01, bounds=(0.0, 4.0)),',
                    "senses": 'Gauge(field="warmth", gradient=True),',
                    "species": 'exposures=(Exposure(field="warmth", control={"heat": 0.02}),),',
                    "scenario": 'fields=(Field(name="warmth", values=warm),),'}),
    "rays": Part("the sense of walls", ("Rays",), {"senses": "Rays(range=2.0, count=6),"}),
    "faults": Part("a sense that is noisy and fails", ("Fault",),
                   {"species": 'faults=(Fault(of="x", noise=0.1, failure=0.001, repair=0.01),),'}),
    "cues": Part("a light that announces something, its fading trace, and an action that waits for it",
                 ("Cue", "Event", "Session", "Trace", "act"),
                 {"senses": 'Trace(of="light", rate=0.05),',
                  "actions": 'act("press", cue="light", control={"thirst": 0.05}),',
                  "species": 'cues=("light",),',
                  "scenario": 'cues=(Cue(name="light"),),\nsessions=(\n    Session(name="trials", trials=20, '
                              'length=100.0, '
                              'gap=50.0, random=True,\n            events=(Event(do="show light on"), '
                              'Event(do="show light off", at=5.0))),\n),'}),
    "schedule": Part("events at set times", ("Event",),
                     {"scenario": 'schedule=(Event(do="move water 1 4", at=5_000.0), '
                                  'Event(do="set agent hunger 1", every=1_000.0)),'}),
    "stages": Part("stages of life", ("Stage",),
                   {"species": 'stages=(Stage(name="young", speed=0.5, cannot=("sleep",)), '
                               'Stage(name="adult", age=500.0)),'}),
    "births": Part("births up to a limit, and deaths by age", ("Birth", "Hazard"),
                   {"species": 'capacity=12,\nbirth=Birth(rate=0.002, threshold={"hunger": 1.5}, cost={"hunger": 0.5}, '
                               "limit=10.0),\nhazard=Hazard(rate=0.0001, ageing=0.0005),"}),
    "traits": Part("a speed that children inherit with mutation", ("Birth", "Trait"),
                   {"species": 'capacity=12,\nbirth=Birth(rate=0.002, threshold={"hunger": 1.5}, cost={"hunger": 0.5}, '
                               "limit=10.0),\n"
                               'traits=(Trait(name="pace", of="speed", bounds=(0.5, 1.5), mutation=0.05),),'}),
    "remains": Part("a carcass where a body dies", ("Hazard", "Remains"),
                    {"resources": 'Resource(name="carcass", count=4, stock=0.0, capacity=4.0, decay=0.002, '
                                  "gone_below=0.02),",
                     "species": 'hazard=Hazard(rate=0.0001),\nremains=Remains(resource="carcass", body=1.0),'}),
    "carrying": Part("food that is carried and stored", ("drop", "take"),
                     {"resources": 'Resource(name="nuts", position=(1.0, 3.0), stock=20.0),\n'
                                   'Resource(name="store", position=(5.0, 1.0), stock=0.0, capacity=20.0),',
                      "actions": 'take("nuts", 0.2),\ndrop("nuts", 0.2, into="store"),',
                      "species": 'carries={"nuts": 1.0},'}),
    "neighbours": Part("others that are seen, with what they do", ("Neighbours",),
                       {"species": "capacity=4,\nneighbours=(Neighbours(count=2, action=True, kin=True),),"}),
    "empathy": Part("what others feel enters one's own drive", ("Empathy",),
                    {"species": "capacity=4,\nempathy=Empathy(weight=0.5),"}),
    "signals": Part("a call that others hear", ("Hearing", "act"),
                    {"senses": 'Hearing(channel="call", range=4.0),',
                     "actions": 'act("call", emits={"call": 1.0}),', "species": "capacity=4,"}),
    "crowding": Part("others that are too near", ("Crowding",),
                     {"species": 'capacity=4,\ncrowding=Crowding(within=0.5, control={"thirst": -0.01}),'}),
    "rule": Part("a rule of one's own, with a memory", ("Outcome", "World"),
                 {"top": '\n\ndef rain(world: World, rng) -> Outcome:  # noqa: ANN001\n'
                         '    """Let it rain now and then, which wets everybody."""\n'
                         "    outcome = world.no_effect()\n"
                         '    wet = rng.random() < 0.01 or (world.memory["wet"] > 0 and rng.random() < 0.9)\n'
                         '    outcome.memory["wet"] = float(wet)\n'
                         "    outcome.received[world.state.alive, 0] = 0.02 * wet\n"
                         "    return outcome",
                  "scenario": 'rule=rain,\nmemory={"wet": 0.0},'}),
}  # fmt: skip


def choose_parts(names: Sequence[str]) -> list[Part]:
    """Return the parts by name; EcologyError for an unknown one."""
    for name in names:
        if name not in PARTS:
            raise EcologyError(
                f"--with names the component {name!r}, which is none. {nearest(name, PARTS)} "
                "`ecology new --help` lists them all."
            )
    return [PARTS[name] for name in dict.fromkeys(names)]


def fill(template: str, parts: Sequence[Part]) -> str:
    """Return the template with the lines of `parts` at its marked places, and what they import."""
    places: dict[str, dict[Any, str]] = {}
    for part in parts:
        for place, lines in part.lines.items():
            texts = places.setdefault(place, {})
            for line in lines.split("\n"):  # what two components say alike of the species is said once
                texts.setdefault(line.partition("=")[0] if place == "species" else len(texts), line)

    def put(mark: re.Match[str]) -> str:
        indent = mark.group(0)[: mark.group(0).index("#")]
        return "".join(f"{indent}{line}\n" if line else "\n" for line in places.get(mark.group(1), {}).values())

    text = MARK.sub(put, template)
    more = {name for part in parts for name in part.imports}
    line = next(line for line in text.splitlines() if line.startswith(OPENING))
    known = line.removeprefix(OPENING).split(", ")
    names = sorted({*known, *more}, key=lambda name: (name.islower(), name))
    whole = OPENING + ", ".join(names)
    if len(whole) > 120:
        whole = OPENING + "(\n" + "".join(f"    {name},\n" for name in names) + ")"
    return text.replace(line, whole)


def listing() -> list[str]:
    """Return a line for each component."""
    return [f"{name}: {part.about}" for name, part in PARTS.items()]
