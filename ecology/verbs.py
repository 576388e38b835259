"""The language of interventions: its verbs, what they are said of, and what can be known of them before they are done.

`interventions` does them; a scenario's schedule is checked here when the scenario is made.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np

from ecology.errors import EcologyError, nearest
from ecology.spec import Need, Resource, Species, require

if TYPE_CHECKING:
    from ecology.scenario import Scenario

LONGEST = 200  # characters of an intervention
COUNTS = {  # least and most words after each verb
    "move": (3, 4),
    "refill": (1, 2),
    "empty": (1, 1),
    "put": (3, 4),
    "remove": (1, 1),
    "set": (3, 3),
    "shift": (3, 3),
    "empathy": (2, 2),
    "learning": (2, 2),
    "show": (2, 2),
    "change": (2, 2),
}
USAGES = (
    "move AGENT X Y [DEGREES]",
    "move RESOURCE[.N] X Y",
    "refill RESOURCE[.N] [STOCK]",
    "empty RESOURCE[.N]",
    "put SPECIES X Y [DEGREES]",
    "remove AGENT",
    "set AGENT|SPECIES NEED VALUE",
    "shift AGENT|SPECIES NEED SET_POINT",
    "empathy SPECIES WEIGHT|off|on",
    "learning SPECIES on|off",
    "show CUE VALUE|on|off",
    "change PATH NUMBER",
)


class MissingError(EcologyError):
    """What an intervention needs is not there now: the agent lives no more, or no slot is free."""


def split(text: str) -> tuple[str, list[str]]:
    """Return the verb of an intervention and the words after it; EcologyError where they cannot be one."""
    words = text.split() if isinstance(text, str) and len(text) <= LONGEST and text.isprintable() else []
    if not words:
        raise EcologyError(f"an intervention is one line, such as {USAGES[0]!r}; got {str(text)[:LONGEST]!r}.")
    verb, *rest = words
    if verb not in COUNTS:
        raise EcologyError(f"there is no intervention {verb!r}. {nearest(verb, COUNTS)}")
    low, high = COUNTS[verb]
    if not low <= len(rest) <= high:
        usage = "  or  ".join(usage for usage in USAGES if usage.startswith(verb))
        raise EcologyError(f"{verb!r} takes {usage}; got {' '.join(words)!r}.")
    return verb, rest


# ---- what there is to be named ---------------------------------------------------------------


def species_of(scenario: Scenario, name: str) -> Species:
    """Return the species of a name; EcologyError where there is none."""
    by_name = {s.name: s for s in scenario.species}
    if name not in by_name:
        raise EcologyError(f"there is no species {name!r}. {nearest(name, by_name)}")
    return by_name[name]


def is_agent(scenario: Scenario, name: str) -> bool:
    """Return whether `name` is written as that of an agent of this world."""
    species, _, serial = name.rpartition("_")
    return species in {s.name for s in scenario.species} and serial.isdecimal()


def means_resource(scenario: Scenario, name: str) -> bool:
    """Return whether the first word of a move means a resource, or one of its patches."""
    names = [resource.name for resource in scenario.resources]
    if name in names or (re.sub(r"[._]\d+$", "", name) in names and not is_agent(scenario, name)):
        return True
    return not is_agent(scenario, name) and "_" not in name


def patch_of(scenario: Scenario, name: str, *, one: bool) -> tuple[Resource, int | None]:
    """Return the resource that `name` means and the number of its patch: `one`, or None for all where none is named."""
    resources = {resource.name: resource for resource in scenario.resources}
    owner, number = name, ""
    if name not in resources and (match := re.fullmatch(r"(.+)[._](\d+)", name)) and match[1] in resources:
        owner, number = match[1], match[2]
    if owner not in resources:
        known = [*resources, *(s.name for s in scenario.species)]
        raise EcologyError(f"there is no resource {owner!r}. {nearest(owner, known)}")
    resource = resources[owner]
    if number and int(number) >= resource.count:
        raise EcologyError(
            f"the resource {owner!r} has {resource.count} patches, counted from 0; there is no patch {number}."
        )
    if one and not number and resource.count > 1:
        raise EcologyError(
            f"the resource {owner!r} has {resource.count} patches, counted from 0; name one, as {owner}.0."
        )
    return resource, int(number) if number else 0 if one else None


def need_of(species: Species, name: str) -> tuple[Need, int]:
    """Return the need of a species and its column; EcologyError where it has no such need."""
    names = [need.name for need in species.needs]
    if name not in names:
        raise EcologyError(f"the species {species.name!r} has no need {name!r}. {nearest(name, names)}")
    return species.needs[names.index(name)], names.index(name)


def number(what: str, word: str) -> float:
    """Return the number of a word; EcologyError where it is none."""
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise EcologyError(f"{what} must be a finite number, got {word!r}.")
    return value


def place(scenario: Scenario, x: str, y: str) -> tuple[float, float]:
    """Return the place of two words; EcologyError where it lies outside the arena."""
    from ecology.changes import inside  # loads what checks polygons

    found = number("x", x), number("y", y)
    if not inside(scenario, np.array([found]))[0]:
        (left, bottom), (right, top) = scenario.arena.extent
        raise EcologyError(
            f"the place ({x}, {y}) lies outside the arena, which extends from ({left:g}, {bottom:g}) to "
            f"({right:g}, {top:g}){', but for its holes' * bool(scenario.arena.holes)}."
        )
    return found


def stock(resource: Resource, word: str | None) -> float:
    """Return what a resource is filled to: `word`, or its capacity where there is none."""
    require(math.isfinite(resource.stock), f"the resource {resource.name!r} is unlimited; there is nothing to refill.")
    top = resource.most
    amount = top if word is None else number("a stock", word)
    require(0 <= amount <= top, f"a stock of {resource.name!r} lies between 0 and its capacity, {top:g}; got {word}.")
    return amount


def value_of(need: Need, word: str) -> float:
    """Return the value of a need; beyond the bounds of a lethal one its agent dies in the next tick."""
    value, low, high = number(f"the need {need.name!r}", word), need.low, need.bounds[1]
    require(
        low <= value <= high or need.lethal, f"the need {need.name!r} lies between {low:g} and {high:g}, got {word}."
    )
    return value


def set_point_of(need: Need, word: str) -> float:
    """Return the set point that a need is to have."""
    value = number(f"the set point of {need.name!r}", word)
    require(
        need.set_range is not None,
        f"the set point of {need.name!r} does not move; give the need a set_range in the scenario, which says how "
        "far it may: it is a part of the observation space.",
    )
    lowest, highest = need.set_points
    require(
        lowest <= value <= highest,
        f"the set point of {need.name!r} lies in its set_range, {lowest:g} to {highest:g}, got {word}.",
    )
    return value


def switch(what: str, word: str) -> bool:
    """Return whether `word` is on; EcologyError where it is neither on nor off."""
    require(word in ("on", "off"), f"{what} is switched on or off, got {word!r}.")
    return word == "on"


def cue_value_of(scenario: Scenario, name: str, word: str) -> float:
    """Return what is to be shown of a cue."""
    names = [cue.name for cue in scenario.cues]
    if name not in names:
        raise EcologyError(f"there is no cue {name!r}. {nearest(name, names)}")
    value = {"on": 1.0, "off": 0.0}.get(word)
    value = number(f"the cue {name!r}", word) if value is None else value
    require(0 <= value <= 1, f"the cue {name!r} is on, off or a number from 0 to 1, got {word!r}.")
    return value


# ---- before it is done -----------------------------------------------------------------------


def check_command(scenario: Scenario, text: str) -> None:
    """Raise EcologyError where an intervention cannot be done in any state of the world of `scenario`."""
    verb, words = split(text)
    name = words[0]
    if verb == "move" and means_resource(scenario, name):
        patch_of(scenario, name, one=True)
    elif verb in ("refill", "empty"):
        stock(patch_of(scenario, name, one=False)[0], words[1] if len(words) > 1 else None)
    elif verb in ("move", "remove"):
        species_of(scenario, _whose(scenario, name))
    elif verb in ("set", "shift"):
        need, _ = need_of(species_of(scenario, _whose(scenario, name)), words[1])
        (value_of if verb == "set" else set_point_of)(need, words[2])
    elif verb in ("put", "empathy", "learning"):
        species = species_of(scenario, name)
        if verb == "learning":
            switch("learning", words[1])
        if verb == "empathy":
            require(species.empathy is not None, f"the species {name!r} has no empathy.")
            if words[1] not in ("on", "off"):
                number("a weight of empathy", words[1])
    elif verb == "show":
        cue_value_of(scenario, name, words[1])
    elif verb == "change":
        from ecology.paths import with_change  # the scenario's own check asks for this one

        with_change(scenario, name, number(name, words[1]))
    if verb in ("move", "put"):
        place(scenario, *words[1:3])


def _whose(scenario: Scenario, name: str) -> str:
    """Return the species of an agent's name, or the name itself."""
    return name.rpartition("_")[0] if is_agent(scenario, name) else name
