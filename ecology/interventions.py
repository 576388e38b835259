"""Interventions: what a person does to a world between two ticks, said in one line.

    move AGENT X Y [DEGREES]     put an agent elsewhere, and turn it: move prey_3 0.5 1.5
    move RESOURCE[.N] X Y        put a resource elsewhere, its patch N of several: move food.3 0.5 1.5
    refill RESOURCE[.N] [STOCK]  fill a finite resource, or all its patches, to its capacity or to STOCK
    empty RESOURCE[.N]           leave nothing of it
    put SPECIES X Y [DEGREES]    let one more agent live
    remove AGENT                 let an agent die, of cause "rule"
    set AGENT NEED VALUE         set an internal variable, a need or a fatigue; a SPECIES for all its living
    shift AGENT NEED SET_POINT   move the set point of a need, within its set_range; a SPECIES for all its living
    empathy SPECIES WEIGHT       weigh what a species feels of others by WEIGHT; `off` and `on` cut and restore it
    learning SPECIES off         freeze what a species has learned; `on` lets it learn again
    show CUE VALUE               show a cue, from 0 to 1; `on` is 1, `off` is 0
    change PATH NUMBER           change a number of the scenario: change prey.birth.rate 0.1

`intervene` checks everything before it changes anything, and accounts stay closed: what is put into a stock has grown
there, what is put into a body was received, and what is taken was lost. The world knows no learners: whoever runs it
passes on to them what an `Effect` says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ecology.errors import EcologyError, nearest
from ecology.spec import Oscillation, Resource, Species
from ecology.verbs import (
    MissingError,
    cue_value_of,
    is_agent,
    means_resource,
    need_of,
    number,
    patch_of,
    place,
    set_point_of,
    species_of,
    split,
    stock,
    switch,
    value_of,
)
from ecology.world import Tick

if TYPE_CHECKING:
    from ecology.env import Ecology


@dataclass(frozen=True)
class Effect:
    """What an intervention has done."""

    said: str  # a sentence in the past tense
    tick: Tick  # what is perceived after it
    changed: tuple[int, ...] = ()  # slots of agents that were moved or changed
    moved: tuple[int, ...] = ()  # those of them that were moved
    born: tuple[int, ...] = ()  # slots in which somebody lives now
    died: tuple[int, ...] = ()  # slots in which nobody lives any more
    learning: Mapping[str, bool] = field(default_factory=dict)  # species that are to learn, or not


def intervene(env: Ecology, text: str) -> Effect:
    """Do what `text` says to a world between two ticks.

    Raises EcologyError, the world being unchanged, where it is no intervention or does not fit the world;
    MissingError where it fits, but not now.
    """
    verb, words = split(text)
    return VERBS[verb](env, words)


# ---- what there is to be named ---------------------------------------------------------------


def _slot(env: Ecology, name: str) -> int:
    """Return the slot of an agent that lives."""
    model, state = env.world.model, env.world.state
    if is_agent(env.scenario, name) and name not in model.living(state):
        raise MissingError(f"no agent {name!r} lives at tick {state.tick}. {nearest(name, model.living(state))}")
    return model.slot_of(name, state)


def _slots(env: Ecology, name: str) -> tuple[Species, np.ndarray]:
    """Return the species that is meant and the slots (k,): one agent's, or those of all living of a species."""
    if name not in env.groups:
        return species_of(env.scenario, name.rpartition("_")[0]), np.array([_slot(env, name)])
    rows = env.groups[name].slots
    slots = rows.start + np.flatnonzero(env.state_view.alive[rows])
    if not slots.size:
        raise MissingError(f"no {name} lives at tick {env.state_view.tick}.")
    return species_of(env.scenario, name), slots


def _rows(env: Ecology, resource: Resource, number: int | None) -> list[int]:
    """Return the rows of a patch, or of all patches of a resource."""
    rows = env.world.model.patches[resource.name]
    return list(range(rows.start, rows.stop)) if number is None else [rows.start + number]


def _heading(words: list[str]) -> float | None:
    return math.radians(number("the heading", words[0])) if words else None


# ---- the interventions -----------------------------------------------------------------------


def _move(env: Ecology, words: list[str]) -> Effect:
    name, x, y, *turn = words
    if not means_resource(env.scenario, name):
        slot, where, heading = _slot(env, name), place(env.scenario, x, y), _heading(turn)
        state = env.state_view
        position, headings, bound = state.position.copy(), state.heading.copy(), state.bound_for.copy()
        was, position[slot], bound[slot] = position[slot].copy(), where, -1
        if heading is not None:
            headings[slot] = heading
        tick = env.set_state(position=position, heading=headings, bound_for=bound)
        return Effect(f"{name} was moved from {_at(was)} to {_at(where)}", tick, changed=(slot,), moved=(slot,))
    resource, which = patch_of(env.scenario, name, one=True)
    (row,) = _rows(env, resource, which)
    if turn:
        raise EcologyError(f"a resource has no heading; write move {name} {x} {y}.")
    if isinstance(resource.motion, Oscillation):
        raise EcologyError(
            f"the resource {resource.name!r} oscillates between two places of its own; it cannot be moved."
        )
    where, state = place(env.scenario, x, y), env.state_view
    places, bound = state.resource_position.copy(), state.bound_for.copy()
    was, places[row] = places[row].copy(), where
    bound[bound == row] = -1  # an agent on its way there does not know where it went
    tick = env.set_state(resource_position=places, bound_for=bound)
    return Effect(f"{name} was moved from {_at(was)} to {_at(where)}", tick)


def _refill(env: Ecology, words: list[str]) -> Effect:
    resource, which = patch_of(env.scenario, words[0], one=False)
    amount = stock(resource, words[1] if len(words) > 1 else None)
    return _stock(env, _rows(env, resource, which), amount, f"{words[0]} was filled to {amount:g}")


def _empty(env: Ecology, words: list[str]) -> Effect:
    resource, which = patch_of(env.scenario, words[0], one=False)
    if not math.isfinite(resource.stock):
        raise EcologyError(f"the resource {resource.name!r} is unlimited; it cannot be emptied.")
    return _stock(env, _rows(env, resource, which), 0.0, f"{words[0]} was emptied")


def _stock(env: Ecology, rows: list[int], amount: float, said: str) -> Effect:
    state = env.state_view
    stock, grown = state.stock.copy(), state.grown.copy()
    grown[rows] += amount - stock[rows]
    stock[rows] = amount
    return Effect(said, env.set_state(stock=stock, grown=grown))


def _put(env: Ecology, words: list[str]) -> Effect:
    species, where = species_of(env.scenario, words[0]), place(env.scenario, *words[1:3])
    heading = _heading(words[3:])
    tick, slot = env.settle(species.name, where, 0.0 if heading is None else heading)
    return Effect(f"{env.name_of(slot)} was put to {_at(where)}", tick, born=(slot,))


def _remove(env: Ecology, words: list[str]) -> Effect:
    slot = _slot(env, words[0])
    alive = env.state_view.alive.copy()
    alive[slot] = False
    return Effect(f"{words[0]} was removed", env.set_state(alive=alive), died=(slot,))


def _set(env: Ecology, words: list[str]) -> Effect:
    name, need, word = words
    species, slots = _slots(env, name)
    known, column = need_of(species, need)
    value, state = value_of(known, word), env.state_view
    internal, received, lost = state.internal.copy(), state.received.copy(), state.lost.copy()
    change = value - internal[slots, column]
    received[slots, column] += np.maximum(change, 0.0)
    lost[slots, column] += np.maximum(-change, 0.0)
    internal[slots, column] = value
    tick = env.set_state(internal=internal, received=received, lost=lost)
    return Effect(f"{need} of {name} was set to {value:g}", tick, changed=tuple(slots.tolist()))


def _shift(env: Ecology, words: list[str]) -> Effect:
    name, need, word = words
    species, slots = _slots(env, name)
    known, column = need_of(species, need)
    value = set_point_of(known, word)
    assert env.state_view.set_point is not None
    set_point = env.state_view.set_point.copy()
    set_point[slots, column] = value
    tick = env.set_state(set_point=set_point)
    return Effect(f"the set point of {need} of {name} was shifted to {value:g}", tick, changed=tuple(slots.tolist()))


def _show(env: Ecology, words: list[str]) -> Effect:
    value = cue_value_of(env.scenario, *words)
    cue = np.array(env.state_view.cue)
    cue[env.world.model.cues[words[0]]] = value
    return Effect(f"{words[0]} shows {value:g}", env.set_state(cue=cue))


def _change(env: Ecology, words: list[str]) -> Effect:
    path, value = words[0], number(words[0], words[1])
    return Effect(f"{path} was changed to {value:g}", env.change(path, value))


def _empathy(env: Ecology, words: list[str]) -> Effect:
    species, word = species_of(env.scenario, words[0]), words[1]
    weight = None if word in ("on", "off") else number("a weight of empathy", word)
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
    species, learns = species_of(env.scenario, words[0]), switch("learning", words[1])
    said = f"{species.name} " + ("learn again" if learns else "learn no more")
    return Effect(said, env.set_state(), learning={species.name: learns})


def _at(place: np.ndarray | tuple[float, float]) -> str:
    return f"({place[0]:.2f}, {place[1]:.2f})"


VERBS: Mapping[str, Callable[[Ecology, list[str]], Effect]] = {
    "move": _move,
    "refill": _refill,
    "empty": _empty,
    "put": _put,
    "remove": _remove,
    "set": _set,
    "shift": _shift,
    "empathy": _empathy,
    "learning": _learning,
    "show": _show,
    "change": _change,
}
