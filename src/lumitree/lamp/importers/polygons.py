"""Cutting planar polygons into triangles."""

from collections import Counter

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

from lumitree.lamp.meshes import Floats

Indices = NDArray[np.int64]
MAX_CORNERS = 2000
# Factor by which an exchange of diagonals has to raise the lower height; with less, long combs
# take a quadratic number of exchanges.
_LEAST_RATIO = 1.5


def triangulate(points: Floats) -> tuple[Indices, Indices]:
    """Triangles of many polygons [P, N, 3] with the same number of corners, at most `MAX_CORNERS`.

    [T, 3] corner numbers in 0 .. N - 1, wound as the polygons are, and [T] the number of each
    triangle's polygon, ascending. The outline of a polygon's triangles is the polygon, edge by
    edge: also a corner on the line between its neighbours is used, since another polygon may end
    there. Polygons are roughly planar; those that cross themselves get triangles that overlap.
    """
    count, corners = points.shape[:2]
    ahead = np.arange(1, corners - 1)
    fan = np.stack([np.zeros_like(ahead), ahead, ahead + 1], axis=1)
    concave = np.zeros(count, bool) if corners == 3 else ~_strictly_convex(points)
    convex = np.flatnonzero(~concave)
    triangles, polygon = [np.tile(fan, (len(convex), 1))], [np.repeat(convex, len(fan))]
    for at in np.flatnonzero(concave):
        triangles.append(_cut(_flattened(points[at])))
        polygon.append(np.full(len(triangles[-1]), at))
    owner = np.concatenate(polygon)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(triangles)[order], owner[order]


def newell(points: Floats) -> Floats:
    """Normals [P, 3] of polygons [P, N, 3], as long as twice their area."""
    centred = points - points.mean(axis=1, keepdims=True)
    return np.cross(centred, np.roll(centred, -1, axis=1)).sum(axis=1)


def _strictly_convex(points: Floats) -> NDArray[np.bool_]:
    """Whether [P] all fan triangles and corners have the polygon's orientation, with a margin."""
    normal = newell(points)
    area = np.linalg.norm(normal, axis=-1)
    ahead = np.roll(points, -1, axis=1) - points
    turns = np.cross(np.roll(ahead, 1, axis=1), ahead)
    spokes = points[:, 1:] - points[:, :1]
    fans = np.cross(spokes[:, :-1], spokes[:, 1:])
    crosses = np.concatenate([turns, fans], axis=1)
    signed = (crosses * normal[:, None]).sum(axis=-1)
    # A corner of almost 180 degrees would become a triangle without area.
    return (signed > 1e-6 * (area**2)[:, None]).all(axis=1)


def _flattened(points: Floats) -> Floats:
    """A polygon [N, 3] in its best-fit plane [N, 2], counter-clockwise."""
    normal = newell(points[None])[0]
    length = np.linalg.norm(normal)
    normal = normal / length if length > 0 else np.array([0.0, 0.0, 1.0])
    side = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    side /= np.linalg.norm(side)
    return (points - points.mean(axis=0)) @ np.stack([side, np.cross(normal, side)], axis=1)


def _cut(points: Floats) -> Indices:
    """Triangles [T, 3] of one counter-clockwise polygon [N, 2]."""
    size = len(points)
    rings = np.array([size], np.uint32)
    triangles = mapbox_earcut.triangulate_float64(points, rings).astype(np.int64).reshape(-1, 3)
    # earcut may reverse the orientation of a polygon that has almost no area.
    steps = (np.roll(triangles, -1, axis=1) - triangles) % size
    if (steps == size - 1).sum() > (steps == 1).sum():
        triangles = triangles[:, ::-1]
    found = [tuple(triangle) for triangle in triangles[(steps != 0).all(axis=1)].tolist()]
    found += _missing_triangles(found, size)
    return np.array(_flipped(points, found), np.int64)


def _missing_triangles(triangles: list[tuple[int, ...]], size: int) -> list[tuple[int, ...]]:
    """Triangles between the polygon's outline and the outline of `triangles`.

    earcut drops corners of 180 degrees. If an edge of a neighbouring polygon ends in such a corner,
    the surface is then not closed. The outlines differ by closed loops, nearly always without area.
    """
    missing = Counter((at, (at + 1) % size) for at in range(size))
    for a, b, c in triangles:
        for start, stop in ((a, b), (b, c), (c, a)):
            if missing[start, stop] > 0:
                missing[start, stop] -= 1
            else:
                missing[stop, start] += 1
    ahead: dict[int, list[int]] = {}
    for (start, stop), times in missing.items():
        ahead.setdefault(start, []).extend([stop] * times)
    found: list[tuple[int, ...]] = []
    for start in ahead:
        path, at = [start], {start: 0}
        while ahead[path[-1]]:
            stop = ahead[path[-1]].pop()
            if stop in at:
                loop = path[at[stop] :]
                del path[at[stop] + 1 :]
                for corner in loop[1:]:
                    del at[corner]
                found += [(loop[0], loop[k], loop[k + 1]) for k in range(1, len(loop) - 1)]
            else:
                at[stop] = len(path)
                path.append(stop)
    return found


def _flipped(points: Floats, triangles: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """The triangles, with diagonals exchanged where this clearly increases the lower height.

    Each exchange increases the lower of two heights, so that the number of exchanges is finite.
    """
    triangles = list(triangles)
    owner = {edge: at for at, triangle in enumerate(triangles) for edge in _edges(triangle)}
    waiting = list(range(len(triangles)))
    while waiting:
        at = waiting.pop()
        for start, stop in _edges(triangles[at]):
            other = owner.get((stop, start))
            # `owner` also has edges of triangles that have since been exchanged.
            if other is None or (stop, start) not in _edges(triangles[other]):
                continue
            (apex,) = {*triangles[at]} - {start, stop}
            (beyond,) = {*triangles[other]} - {start, stop}
            pair = (apex, start, beyond), (beyond, stop, apex)
            before = min(_height(points, triangles[place]) for place in (at, other))
            after = min(_height(points, new) for new in pair)
            if apex != beyond and after > _LEAST_RATIO * max(before, 0.0):
                for place, new in zip((at, other), pair, strict=True):
                    triangles[place] = new
                    owner.update(dict.fromkeys(_edges(new), place))
                waiting += (at, other)
                break
    return triangles


def _edges(triangle: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    a, b, c = triangle
    return (a, b), (b, c), (c, a)


def _height(points: Floats, triangle: tuple[int, ...]) -> float:
    """Height of a triangle over its longest side, in units of that side; below 0 if clockwise."""
    (ax, ay), (bx, by), (cx, cy) = points[list(triangle)].tolist()
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    sides = ((bx - ax, by - ay), (cx - bx, cy - by), (ax - cx, ay - cy))
    longest = max(x * x + y * y for x, y in sides)
    return area / longest if longest > 0 else 0.0
