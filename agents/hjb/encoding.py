"""What the learner tells a device about its species and settings: how zeta becomes inputs, drive and targets."""

from __future__ import annotations

import numpy as np

from ecology import Group, elementary
from ecology.agents.base import drive_bend, drive_terms
from ecology.agents.hjb.devices.records import Encoding
from ecology.agents.hjb.settings import HJBSettings
from ecology.agents.movements import Movements

DEPRIVED, SATED = -1.0, 0.4  # imagined deviations lie between these, times x*
J_CENTRE, J_SPREAD, J_CEILING = 0.45, 0.55, 2.75  # of J's output, times the drive of total deprivation
WEIGHT_TOP, WEIGHT_FLOOR = 0.42, 0.055  # of the relative loss weight, times the same
CHANGE = 0.1  # change of a deviation that counts as one unit in L_f, times its scale
LENGTH = 0.5  # the same for a position, times half the extent; angles in radians, durations in strides


def count_cells(group: Group, settings: HJBSettings) -> int:
    """Return how many place cells an agent can have: none where it does not sense its position."""
    return settings.place_cells if group.layout.kinds.count("position") >= 2 else 0


def encode(group: Group, settings: HJBSettings, moves: Movements) -> Encoding:
    """Return what all agents of `group` share, as a device needs it."""
    s, layout = settings, group.layout
    kinds = np.array(layout.kinds)
    needs, angles, places = kinds == "deviation", kinds == "angle", np.flatnonzero(kinds == "position")
    mix, felt, exponent = drive_terms(layout)
    mix_from, mix_to = map(np.ascontiguousarray, np.nonzero(mix))  # else kernels are compiled for strides too
    can = needs & layout.regulated & (layout.low < 0)  # needs that can be deprived
    deprived = layout.scale[can] if can.any() else layout.scale[needs]
    worst = float(np.sqrt(np.sum(deprived**2))) ** exponent  # drive of total deprivation
    above, power = drive_bend(layout)
    bent = bool(power != 2 or (above != 1).any())
    if bent or (layout.below != 1).any():
        lacking = (deprived * layout.below[can if can.any() else needs]) ** power
        worst = float(np.sum(lacking)) ** (exponent / power)
    costed = s.option_cost and s.finite_difference
    unit = _units(group, s, worst if costed else None)
    placed, centre = kinds == "position", np.zeros(len(kinds))
    centre[placed] = (layout.low[placed] + layout.high[placed]) / 2
    f4 = np.float32
    where = np.flatnonzero(~needs & (kinds != "felt"))
    spatial = np.append((placed | angles) & placed.any(), np.zeros(len(unit) - len(kinds), bool))
    return Encoding(
        centre=centre.astype(f4),
        inverse=(1 / layout.scale).astype(f4),
        scale=layout.scale.astype(f4),
        low=np.where(angles, -1e30, np.maximum(layout.low, -1e30)).astype(f4),
        high=np.where(angles, 1e30, np.minimum(layout.high, 1e30)).astype(f4),
        unit=unit.astype(f4),
        plain=np.flatnonzero(~angles),
        angle=np.flatnonzero(angles),
        place=places[:2] if count_cells(group, s) else np.zeros(2, np.int64),
        need=needs,
        deprivable=np.flatnonzero(can),
        mix_from=mix_from,
        mix_to=mix_to,
        mix_weight=mix[mix_from, mix_to],
        felt=felt,
        epsilon=f4(layout.epsilon),
        exponent=f4(exponent),
        root=f4(exponent / power),
        power=f4(power),
        above=above,
        bent=bent,
        sharp=f4(s.place_width**-2),
        dt=f4(group.dt),
        centre_j=f4(worst * J_CENTRE),
        spread_j=f4(worst * J_SPREAD),
        ceiling=f4(worst * J_CEILING),
        weight_top=f4(worst * WEIGHT_TOP),
        weight_floor=f4(worst * WEIGHT_FLOOR),
        weight_power=s.relative_weight,
        deprived=f4(DEPRIVED),
        sated=f4(SATED),
        width=s.width,
        movements=len(moves.names),
        outputs=len(unit),
        costed=costed,
        finite=s.finite_difference,
        minimum=s.minimum_in_loss,
        anchored=s.learn_value,
        slow=s.target_network,
        weight_decay=f4(s.weight_decay),
        lazy=s.lazy_heads,
        spatial=spatial,
        where=where,
        nearness=np.select(
            [kinds[where] == "position", kinds[where] == "angle"],
            [1 / s.near, 1 / s.near_angle],
            2 / layout.scale[where],
        ).astype(f4),
        turning=kinds[where] == "angle",
        length=moves.length.astype(f4),
        depth=s.depth,
        beam=s.beam,
        searched=s.searched,
        log_gamma=f4(elementary.logarithm(s.gamma)),
        explored=f4(s.epsilon_final * s.target_explores),
        polyak=f4(s.polyak),
    )


def _units(group: Group, settings: HJBSettings, worst: float | None) -> np.ndarray:
    """Return the units (E,) of f's outputs; `worst` is the drive of total deprivation, None without a drive met."""
    kinds = np.array(group.layout.kinds)
    change = (kinds == "deviation") | (kinds == "felt")
    unit = np.where(kinds == "angle", 1.0, np.where(change, CHANGE, LENGTH) * group.layout.scale)
    unit = np.append(unit, settings.stride if settings.adaptive_steps else group.dt)
    return unit if worst is None else np.append(unit, CHANGE * worst)
