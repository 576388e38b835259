"""The outline of an arena as shapely sees it: one ring, holes in it, and inner walls as the thinnest of holes.

An inner wall is a polyline. It becomes a hole THIN wide, relative to the arena, so that sight, bodies, placement and
shortest ways know one kind of wall only. Where it touches the ring, a hole or another wall, the two are one.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ecology.errors import EcologyError
from ecology.spec import require
from ecology.state import Floats

if TYPE_CHECKING:
    import shapely

    from ecology.spec import Arena

Points = Sequence[tuple[float, float]]

FARTHEST = 1e9  # length, of a vertex from the origin along an axis
THIN = 1e-7  # width of an inner wall, as a share of the arena's longer side
LEAST = 64  # and at least so many steps between the numbers that stand for its coordinates
CUT = 1e-6  # share of an area, below which a part that is cut off belongs to the walls


class Part(NamedTuple):
    """A part of an arena that is cut off from the rest."""

    area: float
    place: tuple[float, float]  # a point in it


def polygon_of(arena: Arena) -> shapely.Polygon:
    """Return the arena as a shapely polygon, its holes and inner walls cut out; in several polygons if they part it."""
    import shapely  # slow to load, needed once per world

    if not arena.holes and not arena.inner_walls:
        return shapely.Polygon(arena.vertices)
    polygon = shapely.Polygon(arena.vertices)
    thick = _thickness(arena.vertices)
    lines = shapely.MultiLineString([list(map(tuple, wall)) for wall in arena.inner_walls])
    walls = lines.buffer(thick / 2, cap_style="square", join_style="mitre")
    cut = shapely.union_all([*(shapely.Polygon(hole) for hole in arena.holes), walls])
    rest = polygon.difference(cut)
    parts = [part for part in getattr(rest, "geoms", [rest]) if part.area > CUT * polygon.area]
    return parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)


def _thickness(vertices: Points) -> float:
    points = np.array(vertices, float)
    side = float(np.ptp(points, axis=0).max())
    return max(THIN * side, LEAST * float(np.spacing(np.abs(points).max())))


def rings_of(arena: Arena) -> list[Floats]:
    """Return the rings (k, 2) of the arena, the outer one first: corners with the arena on the left of every wall."""
    if not arena.holes and not arena.inner_walls:
        return [_orient(np.array(arena.vertices, dtype=float), left=True)]
    polygon = polygon_of(arena)
    found = []
    for part in getattr(polygon, "geoms", [polygon]):  # several where closed doors part it
        rings = [np.array(ring.coords)[:-1] for ring in (part.exterior, *part.interiors)]
        found += [_orient(ring, left=i == 0) for i, ring in enumerate(rings)]
    return found


def _orient(corners: Floats, left: bool) -> Floats:
    """Return the corners (W, 2) in the order that goes round to the left, or to the right."""
    x, y = (corners - corners[0]).T
    turns_left = bool((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() > 0)
    return corners if turns_left is left else corners[::-1].copy()


def thicken(polygon: Any, width: float, cut: float) -> list[Floats] | None:
    """Return rings (W, 2) whose edges lie `width` outside the arena's `polygon`, or None.

    None where more than `cut` of a wall would be left out, because it is too thin or too pointed.
    """
    grown = polygon.buffer(width, join_style="mitre", mitre_limit=10.0)
    if not grown.boundary.buffer(width + cut).covers(polygon.boundary):
        return None
    return [np.array(ring.coords)[:-1] for ring in (grown.exterior, *grown.interiors)]


def drawn_lines(arena: Arena) -> list[Floats]:
    """Return the lines (k, 2) to draw: the outer ring, the holes, each closed, and the inner walls."""
    rings = [np.array((*ring, ring[0]), float) for ring in (arena.vertices, *arena.holes)]
    return rings + [np.array(wall, float) for wall in arena.inner_walls]


# ---- checks ----------------------------------------------------------------------------------


def check_outline(arena: Arena) -> None:
    """Raise EcologyError unless the vertices, holes and walls of `arena` make one connected room."""
    import shapely  # slow to load, needed once per arena

    _check_points("a closed arena", "vertex", arena.vertices, 3)
    ring = shapely.Polygon(arena.vertices)
    require(
        ring.is_valid and ring.area > 0,
        f"arena: the walls must not cross or overlap ({shapely.is_valid_reason(ring)}); "
        "list the vertices once around, without repeating the first.",
    )
    require(
        arena.vertices[0] != arena.vertices[-1],
        f"arena: the first vertex {arena.vertices[0]!r} is repeated at the end; leave it out.",
    )
    require(
        not arena.torus or (len(arena.vertices) == 4 and ring.equals(ring.envelope)),
        "arena: only a rectangle along the axes can do without walls, got the vertices "
        f"{arena.vertices!r}; give such a rectangle, or walls=True.",
    )
    require(
        not arena.torus or not arena.holes,
        f"arena: a torus has no holes, got {len(arena.holes)}; leave out walls=False, or the holes.",
    )
    require(
        not arena.torus or not arena.doors,
        f"arena: a torus has no doors, got {len(arena.doors)}; leave out walls=False, or the doors.",
    )
    if arena.holes or arena.inner_walls:
        _check_inner(arena, ring)
    _check_doors(arena, ring)


def _check_points(owner: str, what: str, points: Points, least: int) -> None:
    """Raise EcologyError unless `points` are at least `least` pairs of numbers, none repeated at once."""
    require(len(points) >= least, f"arena: {owner} needs at least {least} {_many(what)}, got {len(points)}.")
    for point in points:
        require(len(point) == 2, f"arena: a {what} is (x, y), got {point!r}.")
        for axis, value in zip("xy", point, strict=True):
            require(math.isfinite(value), f"arena: {axis} must be a finite number, got {value!r}.")
        require(
            max(map(abs, point)) <= FARTHEST,
            f"arena: a {what} lies within {FARTHEST:g} of the origin in x and y, beyond which places are no longer "
            f"told apart well; got {point!r}.",
        )
    for i, (one, other) in enumerate(itertools.pairwise(points)):
        require(
            tuple(one) != tuple(other),
            f"arena: the {what} {one!r} at {i} is repeated at {i + 1}; list every {what} once.",
        )


def _many(what: str) -> str:
    return {"vertex": "vertices"}.get(what, f"{what}s")


def _check_inner(arena: Arena, ring: shapely.Polygon) -> None:
    """Raise EcologyError unless holes lie apart within the ring, walls within too, and all of it hangs together."""
    import shapely

    room = ring.buffer(_thickness(arena.vertices))  # rounding is forgiven to what ends on a slanted wall
    holes: list[shapely.Polygon] = []
    for i, hole in enumerate(arena.holes):
        _check_points(f"holes[{i}]", "vertex", hole, 3)
        polygon = shapely.Polygon(hole)
        if not (polygon.is_valid and polygon.area > 0):
            raise EcologyError(
                f"arena: the edges of holes[{i}] must not cross or overlap ({shapely.is_valid_reason(polygon)}); "
                "list its vertices once around, without repeating the first."
            )
        if not room.covers(polygon):
            raise EcologyError(
                f"arena: holes[{i}] reaches beyond the outer walls, at {_outermost(polygon, ring)}; move it inside, or "
                "change the vertices of the arena instead."
            )
        for j, other in enumerate(holes):
            if polygon.intersection(other).area > 0:
                raise EcologyError(
                    f"arena: holes[{i}] overlaps holes[{j}]; move one of them, or join the two into one hole."
                )
        holes.append(polygon)
    for i, wall in enumerate(arena.inner_walls):
        _check_points(f"walls[{i}]", "point", wall, 2)
        line = shapely.LineString(wall)
        if not room.covers(line):
            raise EcologyError(
                f"arena: walls[{i}] reaches beyond the outer walls, at {_outermost(line, ring)}; end it on a wall."
            )
    found = unreachable_parts(polygon_of(arena), 0.0)
    if found:
        raise EcologyError(
            f"arena: holes and walls cut it into {len(found) + 1} parts, and no body can leave its part: "
            f"{_describe_parts(found)} cut off. Leave a gap."
        )


def _check_doors(arena: Arena, ring: shapely.Polygon) -> None:
    """Raise EcologyError unless the doors lie within the outer walls, each with a name of its own."""
    import shapely

    names = [door.name for door in arena.doors]
    twice = sorted({name for name in names if names.count(name) > 1})
    require(not twice, f"arena: every door needs a name of its own, {twice} appear twice.")
    room = ring.buffer(_thickness(arena.vertices))
    for door in arena.doors:
        line = shapely.LineString([door.start, door.end])
        if not room.covers(line):
            raise EcologyError(
                f"arena: the door {door.name!r} reaches beyond the outer walls, at {_outermost(line, ring)}; end it on "
                "a wall."
            )


def _outermost(shape: Any, ring: Any) -> tuple[float, float]:
    """Return the point of `shape` that is farthest outside the ring."""
    import shapely

    points = [shapely.Point(xy) for xy in shapely.get_coordinates(shape.difference(ring))]
    farthest = max(points, key=lambda point: point.distance(ring), default=shape.centroid)
    return round(farthest.x, 6), round(farthest.y, 6)


def unreachable_parts(polygon: Any, radius: float) -> list[Part]:
    """Return the parts of a polygon that a body of `radius` cannot reach from the largest one, the largest first.

    Corners into which the body does not fit are no parts.
    """
    room = polygon.buffer(-radius) if radius else polygon
    parts = sorted(getattr(room, "geoms", [room]), key=lambda part: -part.area)[1:]
    found = [Part(part.area, _middle(part)) for part in parts]
    return [part for part in found if part.area > CUT * polygon.area]


def _middle(part: Any) -> tuple[float, float]:
    point = part.representative_point()
    return round(point.x, 6), round(point.y, 6)


def _describe_parts(parts: Sequence[Part]) -> str:
    """Return the parts in words."""
    words = [f"an area of {part.area:.3g} around ({part.place[0]:g}, {part.place[1]:g})" for part in parts[:3]]
    more = len(parts) - len(words)
    return f"{', '.join(words)}{f' and {more} more' if more else ''} {'is' if len(parts) == 1 else 'are'}"


def split_room(arena: Arena, radius: float) -> str:
    """Return in words what a body of `radius` cannot reach of the arena, "" if it reaches all of it."""
    found = unreachable_parts(polygon_of(arena), radius)
    return f"{_describe_parts(found)} cut off for a body of radius {radius:g}" if found else ""
