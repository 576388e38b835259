"""Interventions: what a person does to a world between two ticks, said in one line.

    move AGENT X Y [DEGREES]     put an agent elsewhere, and turn it: move prey_3 0.5 1.5
    move RESOURCE[.N] X Y        put a resource elsewhere, its patch N of several: move food.3 0.5 1.5
    refill RESOURCE[.N] [STOCK]  fill a finite resource, or all its patches, to its capacity or to STOCK
    empty RESOURCE[.N]           leave nothing of it
    put SPECIES X Y [DEGREES]    let one more agent live
    remove AGENT                 let an agent die, of cause "rule"
    set AGENT NEED VALUE         set an internal variable, a need or a fatigue; a SPECIES for all its living
    empathy SPECIES WEIGHT       weigh what a species feels of others by WEIGHT; `off` and `on` cut and restore it
    learning SPECIES off         freeze what a species has learned; `on` lets it learn again

`intervene` checks everything before it changes anything, and accounts stay closed: what is put into a stock has grown
there, what is put into a body was received, and what is taken was lost. The world knows no learners: whoever runs it
passes on to them what an `Effect` says.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from ecology import changes
from ecology.env import Ecology, Tick
from ecology.errors import EcologyError, nearest
from ecology.spec import Oscillation, Resource, Species

LONGEST = 200  # characters of an intervention


@dataclass(frozen=True)
class Effect:
    """What an intervention has done."""

    said: str  # a sentence in the past tense
    tick: Tick  # what is perceived after it
    changed: tuple[int, ...] = ()  # slots of agents that were moved or changed
    born: tuple[int, ...] = ()  # slots in which somebody lives now
    died: tuple[int, ...] = ()  # slots in which nobody lives any more
    learning: Mapping[str, bool] = field(default_factory=dict)  # species that are to learn, or not


def intervene(env: Ecology, text: str) -> Effect:
    """Do what `text` says to a world between two ticks.

    Raises EcologyError, the world being unchanged, where it is no intervention or does not fit the world.
    """
    verb, words = split(text)
    return VERBS[verb][0](env, words)


def split(text: str) -> tuple[str, list[str]]:
    """Return the verb of an intervention and the words after it; EcologyError where they cannot be one."""
    words = text.split() if isinstance(text, str) and len(text) <= LONGEST and text.isprintable() else []
    if not words:
        raise EcologyError(f"an intervention is one line, such as {USAGES[0]!r}; got {str(text)[:LONGEST]!r}.")
    verb, *rest = words
    if verb not in VERBS:
        raise EcologyError(f"there is no intervention {verb!r}. {nearest(verb, VERBS)}")
    low, high = VERBS[verb][1:3]
    if not low <= len(rest) <= high:
        usage = "  or  ".join(usage for usage in USAGES if usage.startswith(verb))
        raise EcologyError(f"{verb!r} takes {usage}; got {' '.join(words)!r}.")
    return verb, rest


# ---- what there is to be named ---------------------------------------------------------------


def _slot(env: Ecology, name: str) -> int:
    """Return the slot of an agent that lives."""
    return env.world.model.slot_of(name, env.world.state)


def _is_agent(env: Ecology, name: str) -> bool:
    """Return whether `name` is written as that of an agent of this world."""
    species, _, serial = name.rpartition("_")
    return species in env.groups and serial.isdecimal()


def _patches(env: Ecology, name: str, *, one: bool) -> tuple[Resource, list[int]]:
    """Return the resource that `name` means and the rows of its patches: `one`, or all where none is named."""
    rows = env.world.model.patches
    owner, number = name, ""
    if name not in rows and (match := re.fullmatch(r"(.+)[._](\d+)", name)) and match[1] in rows:
        owner, number = match[1], match[2]
    if owner not in rows:
        known = [*rows, *env.groups]
        raise EcologyError(f"there is no resource {owner!r}. {nearest(owner, known)}")
    resource = next(each for each in env.scenario.resources if each.name == owner)
    if number and int(number) >= resource.count:
        raise EcologyError(
            f"the resource {owner!r} has {resource.count} patches, counted from 0; there is no patch {number}."
        )
    if one and not number and resource.count > 1:
        raise EcologyError(
            f"the resource {owner!r} has {resource.count} patches, counted from 0; name one, as {owner}.0."
        )
    found = list(range(rows[owner].start, rows[owner].stop))
    return resource, [found[int(number)]] if number else found


def _species(env: Ecology, name: str) -> Species:
    if name not in env.groups:
        raise EcologyError(f"there is no species {name!r}. {nearest(name, env.groups)}")
    return env.scenario.species[env.groups[name].index]


def _number(what: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise EcologyError(f"{what} must be a finite number, got {word!r}.")
    return value


def _place(env: Ecology, x: str, y: str) -> tuple[float, float]:
    place = _number("x", x), _number("y", y)
    if not changes.inside(env.scenario, np.array([place]))[0]:
        (left, bottom), (right, top) = env.scenario.arena.extent
        raise EcologyError(
            f"the place ({x}, {y}) lies outside the arena, which extends from ({left:g}, {bottom:g}) to "
            f"({right:g}, {top:g}){', but for its holes' * bool(env.scenario.arena.holes)}."
        )
    return place


def _heading(words: list[str]) -> float | None:
    return math.radians(_number("the heading", words[0])) if words else None


# ---- the interventions -----------------------------------------------------------------------


def _move(env: Ecology, words: list[str]) -> Effect:
    name, x, y, *turn = words
    resources = [resource.name for resource in env.scenario.resources]
    is_patch = name in resources or (re.sub(r"[._]\d+$", "", name) in resources and not _is_agent(env, name))
    if not is_patch and (_is_agent(env, name) or "_" in name):
        slot, place, heading = _slot(env, name), _place(env, x, y), _heading(turn)
        state = env.state_view
        position, headings, bound = state.position.copy(), state.heading.copy(), state.bound_for.copy()
        was, position[slot], bound[slot] = position[slot].copy(), place, -1
        if heading is not None:
            headings[slot] = heading
        tick = env.put(position=position, heading=headings, bound_for=bound)
        return Effect(f"{name} was moved from {_at(was)} to {_at(place)}", tick, changed=(slot,))
    resource, (row, *_) = _patches(env, name, one=True)
    if turn:
        raise EcologyError(f"a resource has no heading; write move {name} {x} {y}.")
    if isinstance(resource.motion, Oscillation):
        raise EcologyError(
            f"the resource {resource.name!r} oscillates between two places of its own; it cannot be moved."
        )
    place, state = _place(env, x, y), env.state_view
    places, bound = state.resource_position.copy(), state.bound_for.copy()
    was, places[row] = places[row].copy(), place
    bound[bound == row] = -1  # an agent on its way there does not know where it went
    tick = env.put(resource_position=places, bound_for=bound)
    return Effect(f"{name} was moved from {_at(was)} to {_at(place)}", tick)


def _refill(env: Ecology, words: list[str]) -> Effect:
    resource, rows = _patches(env, words[0], one=False)
    if not math.isfinite(resource.stock):
        raise EcologyError(f"the resource {resource.name!r} is unlimited; there is nothing to refill.")
    top = resource.most
    amount = top if len(words) == 1 else _number("a stock", words[1])
    if not 0 <= amount <= top:
        raise EcologyError(f"a stock of {resource.name!r} lies between 0 and its capacity, {top:g}; got {words[1]}.")
    return _stock(env, rows, amount, f"{words[0]} was filled to {amount:g}")


def _empty(env: Ecology, words: list[str]) -> Effect:
    resource, rows = _patches(env, words[0], one=False)
    if not math.isfinite(resource.stock):
        raise EcologyError(f"the resource {resource.name!r} is unlimited; it cannot be emptied.")
    return _stock(env, rows, 0.0, f"{words[0]} was emptied")


def _stock(env: Ecology, rows: list[int], amount: float, said: str) -> Effect:
    state = env.state_view
    stock, grown = state.stock.copy(), state.grown.copy()
    grown[rows] += amount - stock[rows]
    stock[rows] = amount
    return Effect(said, env.put(stock=stock, grown=grown))


def _put(env: Ecology, words: list[str]) -> Effect:
    species, place, heading = _species(env, words[0]), _place(env, *words[1:3]), _heading(words[3:])
    tick, slot = env.settle(species.name, place, 0.0 if heading is None else heading)
    return Effect(f"{env.name_of(slot)} was put to {_at(place)}", tick, born=(slot,))


def _remove(env: Ecology, words: list[str]) -> Effect:
    slot = _slot(env, words[0])
    alive = env.state_view.alive.copy()
    alive[slot] = False
    return Effect(f"{words[0]} was removed", env.put(alive=alive), died=(slot,))


def _set(env: Ecology, words: list[str]) -> Effect:
    name, need, word = words
    if name in env.groups:
        rows = env.groups[name].slots
        slots = rows.start + np.flatnonzero(env.state_view.alive[rows])
        species = _species(env, name)
    else:
        slots = np.array([_slot(env, name)])
        species = _species(env, name.rpartition("_")[0])
    names = [each.name for each in species.needs]
    if need not in names:
        raise EcologyError(f"the species {species.name!r} has no need {need!r}. {nearest(need, names)}")
    column, value = names.index(need), _number(f"the need {need!r}", word)
    low, high = species.needs[column].low, species.needs[column].bounds[1]
    if not (low <= value <= high) and not species.needs[column].lethal:
        raise EcologyError(f"the need {need!r} lies between {low:g} and {high:g}, got {word}.")
    if not slots.size:
        raise EcologyError(f"no {name} lives at tick {env.state_view.tick}.")
    state = env.state_view
    internal, received, lost = state.internal.copy(), state.received.copy(), state.lost.copy()
    change = value - internal[slots, column]
    received[slots, column] += np.maximum(change, 0.0)
    lost[slots, column] += np.maximum(-change, 0.0)
    internal[slots, column] = value
    tick = env.put(internal=internal, received=received, lost=lost)
    return Effect(f"{need} of {name} was set to {value:g}", tick, changed=tuple(slots.tolist()))


def _empathy(env: Ecology, words: list[str]) -> Effect:
    species, word = _species(env, words[0]), words[1]
    weight = None if word in ("on", "off") else _number("a weight of empathy", word)
    factor = float(word == "on") if weight is None else 0.0
    if weight is not None and species.empathy is not None and weight != 0.0:
        if species.empathy.weight == 0.0:
            raise EcologyError(
                f"the empathy of {species.name!r} has the weight 0 in the scenario and cannot be reweighed; set "
                "another weight there."
            )
        factor = weight / species.empathy.weight
    tick = env.reweigh(species.name, factor)
    said = f"empathy of {species.name} was " + (f"weighed {weight:g}" if weight is not None else f"switched {word}")
    return Effect(said, tick)


def _learning(env: Ecology, words: list[str]) -> Effect:
    species, word = _species(env, words[0]), words[1]
    if word not in ("on", "off"):
        raise EcologyError(f"learning is switched on or off, got {word!r}.")
    said = f"{species.name} " + ("learn again" if word == "on" else "learn no more")
    return Effect(said, env.put(), learning={species.name: word == "on"})


def _at(place: np.ndarray | tuple[float, float]) -> str:
    return f"({place[0]:.2f}, {place[1]:.2f})"


VERBS: Mapping[str, tuple[Callable[[Ecology, list[str]], Effect], int, int]] = {  # with the least and most words after
    "move": (_move, 3, 4),
    "refill": (_refill, 1, 2),
    "empty": (_empty, 1, 1),
    "put": (_put, 3, 4),
    "remove": (_remove, 1, 1),
    "set": (_set, 3, 3),
    "empathy": (_empathy, 2, 2),
    "learning": (_learning, 2, 2),
}
USAGES = (
    "move AGENT X Y [DEGREES]",
    "move RESOURCE[.N] X Y",
    "refill RESOURCE[.N] [STOCK]",
    "empty RESOURCE[.N]",
    "put SPECIES X Y [DEGREES]",
    "remove AGENT",
    "set AGENT|SPECIES NEED VALUE",
    "empathy SPECIES WEIGHT|off|on",
    "learning SPECIES on|off",
)
