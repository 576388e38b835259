"""The square of the follow-up's experiments (CTCS-HRRL 2024): two resources, and who lives there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from ecology import EcologyError, Scenario
from ecology.scenarios import paper, paper_reference

START = (2.0, 2.0)


def square(
    name: str, numbers: str, heading: bool, ticks: int, changes: Sequence[dict[str, Any]] = ({}, {})
) -> Scenario:
    """Return the square with `changes` to the words of its two resources.

    `numbers` are those of the authors' "code", where intake and loss are proportional to the variable, or
    of the paper's "text", where intake is a quantity per unit of time and two needs can be held at once.
    """
    if numbers not in ("code", "text"):
        raise EcologyError(f"numbers are the authors' 'code' or the paper's 'text', got {numbers!r}.")
    if numbers == "code":
        world = paper_reference.build(arena="EASY", heading=heading, start=START)
    else:
        world = paper.build(set_points=(1.0, 2.0), heading=heading)
    agent = replace(world.species[0], position=START)
    foods = tuple(replace(food, **words) for food, words in zip(world.resources, changes, strict=True))
    return Scenario(name=name, arena=paper_reference.SQUARE, resources=foods, species=(agent,), ticks=ticks)
