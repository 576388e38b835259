"""Colours that observers share: fixed, and distinguishable by colour-blind readers."""

from __future__ import annotations

import functools
import math
from collections import deque

import numpy as np

from ecology.empathy import felt_species
from ecology.physiology import drive_of
from ecology.resources import consumers
from ecology.scenario import Scenario
from ecology.spec import Species

Colour = tuple[int, int, int]

# Okabe and Ito (2008), without black and in an order that keeps neighbours apart
PALETTE: tuple[Colour, ...] = (
    (230, 159, 0),  # orange
    (86, 180, 233),  # sky blue
    (0, 158, 115),  # bluish green
    (240, 228, 66),  # yellow
    (213, 94, 0),  # vermillion
    (204, 121, 167),  # reddish purple
    (0, 114, 178),  # blue
    (170, 170, 170),  # grey
)
NAMES = ("orange", "light blue", "green", "yellow", "red", "pink", "blue", "grey")  # of the palette
ALONE: Colour = (245, 245, 245)  # a species alone: off the scale that shows the drive
SPECIES: tuple[Colour, ...] = tuple(PALETTE[i] for i in (1, 4, 2, 5, 3, 6, 0, 7))
RESTING, SLEEPING = (105, 110, 120), (95, 85, 165)
BITING, GIVING = (255, 90, 60), (90, 230, 180)
MOVING, TURNING = (215, 220, 230), (150, 156, 168)
SHADES = 256
DARKEST = {"plasma": 0.3}  # share of a scale that is left out: its dark end would not stand out from the floor
RECENT = 50  # samples after which the colour scale of the drive may be lowered


def colour_name(shade: Colour) -> str:
    """Return the name of a colour: the nearest of the palette, white and black."""
    known = {**dict(zip(NAMES, PALETTE, strict=True)), "white": (245, 245, 245)}
    return min(known, key=lambda name: sum((a - b) ** 2 for a, b in zip(known[name], shade, strict=True)))


def need_colour(index: int) -> Colour:
    """Return the colour of a species' need by its place among the needs."""
    return PALETTE[index % len(PALETTE)]


def species_colour(index: int, *, alone: bool = False) -> Colour:
    """Return the colour of a species by its place in the scenario, or of the one species of a world."""
    return ALONE if alone else SPECIES[index % len(SPECIES)]


def resource_colours(scenario: Scenario) -> list[Colour]:
    """Return a colour per resource: that of the first need which its consumption restores, if any.

    Where others eat it than eat an earlier resource of that colour, it gets one that is not in use.
    """
    colours = [PALETTE[i % len(PALETTE)] for i in range(len(scenario.resources))]
    row = {resource.name: i for i, resource in enumerate(scenario.resources)}
    for species in reversed(scenario.species):
        column = {need.name: i for i, need in enumerate(species.needs)}
        for action in species.actions:
            fed = [name for name, rate in action.control.items() if rate > 0]
            if action.kind == "consume" and fed:
                colours[row[str(action.resource)]] = need_colour(column[fed[0]])
    eaters = [{s.name for s in consumers(r, scenario.species)} for r in scenario.resources]
    for i, who in enumerate(eaters):
        same = [other for other in range(i) if colours[other] == colours[i]]
        free = [shade for shade in PALETTE if shade not in colours]
        if same and free and all(who.isdisjoint(eaters[other]) for other in same):
            colours[i] = free[0]
    return colours


def action_colours(scenario: Scenario, species: Species) -> list[Colour]:
    """Return a colour per action: by kind, and by resource for going there (dark) and consuming (bright)."""
    food = dict(zip((r.name for r in scenario.resources), resource_colours(scenario), strict=True))
    plain = {"rest": RESTING, "sleep": SLEEPING, "move": MOVING, "turn": TURNING, "bite": BITING, "give": GIVING}
    colours = []
    for i, action in enumerate(species.actions):
        colour = plain.get(action.kind, PALETTE[i % len(PALETTE)])
        colour = food.get(str(action.resource), colour)
        colours.append(darken(colour, 0.55) if action.kind == "go_to" else colour)
    return colours


def darken(colour: Colour, light: float) -> Colour:
    """Return `colour` at a share `light` of its brightness."""
    r, g, b = (round(light * part) for part in colour)
    return r, g, b


def highest_drive(scenario: Scenario) -> float:
    """Return the drive at the top of the colour scale: every regulated need off by its ordinary size.

    In the sum form of empathy, with what is then felt: of everyone, or of one where it is felt on conditions.
    """
    own = {
        s.name: float(drive_of(s, -np.array([need.scale * need.regulated for need in s.needs])))
        for s in scenario.species
    }
    slots, found = {s.name: s.slots for s in scenario.species}, []
    for s in scenario.species:
        felt, e = 0.0, s.empathy
        if e is not None and e.form == "sum":
            always = not (e.kin or e.sight or math.isfinite(e.within))
            felt = sum(own[name] * (slots[name] if always else 1) for name in felt_species(s))
            felt *= abs(e.weight)
        found.append(own[s.name] + felt)
    return max(found)


def round_up(value: float) -> float:
    """Return the least of 1, 1.5, 2, 3, 5 and 7 times a power of ten that is at least `value`, which is positive."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(m * power for m in (1, 1.5, 2, 3, 5, 7, 10) if m * power >= value * (1 - 1e-9))


class Top:
    """The drive at the top of the colour scale, which follows the drives of the living agents."""

    def __init__(self, scenario: Scenario) -> None:
        """Start with the top of the scale that the needs of a scenario suggest."""
        self._least = highest_drive(scenario) / 50
        self._recent: deque[float] = deque(maxlen=RECENT)
        self.value = 0.0

    def follow(self, drive: np.ndarray) -> float:
        """Take the drives of a sample, NaN of the dead, and return the top: raised at once, lowered after a while."""
        self._recent.append(float(np.nanmax(np.append(drive, 0.0))))
        wanted = round_up(max(self._least, *self._recent))
        if wanted > self.value or (len(self._recent) == RECENT and wanted < 0.5 * self.value):
            self.value = wanted
        return self.value


@functools.cache
def scale(name: str) -> np.ndarray:
    """Return the colour scale `name` as uint8 (SHADES, 3), dark to bright; what does not stand out is left out."""
    from ecology.observers.colour_scales import colormaps  # slow to load

    return (colormaps[name](np.linspace(DARKEST.get(name, 0.1), 1.0, SHADES))[:, :3] * 255).round().astype(np.uint8)


def shade(name: str, value: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return the colours of `value` (...) between `low` and `high` on the scale `name`, uint8 (..., 3)."""
    share = np.clip((np.nan_to_num(value, nan=low) - low) / max(high - low, 1e-9), 0.0, 1.0)
    return scale(name)[(share * (SHADES - 1)).round().astype(int)]


def pack(shade: np.ndarray) -> np.ndarray:
    """Return opaque colours 0xRRGGBBAA, uint32 (...), of uint8 (..., 3)."""
    r, g, b = (shade[..., i].astype(np.uint32) for i in range(3))
    return (r << 24) | (g << 16) | (b << 8) | np.uint32(255)
