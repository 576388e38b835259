"""Evolution of help: groups that live apart, and breed from one pool.

At every chance an agent may give: giving costs c and brings b = 1 to another agent of its group. It gives if its care,
which is inherited, exceeds c. A generation is bred from the agents of all groups in proportion to their energy, so
members of a group do not compete for parents (Taylor 1992). They are related by `relatedness`, r. Where c is drawn from
0 to 1 at every chance, care = r is stable; with one c, more care than c spreads where r > c (Hamilton 1964).
"""

from __future__ import annotations

from ecology import Archipelago, Island, Pool

LIFE = 5.0  # units of time of a generation


def build(
    relatedness: float = 0.5,
    groups: int = 64,
    size: int = 4,
    cost: float = 0.5,
    varied: bool = True,
    mutation: float = 0.03,
    ticks: int = 2_000,
) -> Archipelago:
    """Return the groups, an island each; with `varied` the cost is drawn from 0 to 1 at every chance."""
    settings = {"size": size, "cost": cost, "varied": varied, "mutation": mutation}
    return Archipelago(
        name="kin",
        islands=(Island(scenario="_kin_group.py", settings=settings),) * groups,
        pool=Pool(species="agent", generation=LIFE, fitness="energy", relatedness=relatedness),
        ticks=ticks,
    )
