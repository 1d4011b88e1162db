"""Cutting planar polygons into triangles."""

import numpy as np
from numpy.typing import NDArray

from lumitree.luminaires.geometry import Floats

Indices = NDArray[np.int64]
MAX_CORNERS = 2000


def triangulate(points: Floats) -> Indices:
    """Triangles of many polygons with the same number of corners.

    Args:
        points: [P, N, 3] corners in order, N from 3 to `MAX_CORNERS`; roughly planar. Concave
            polygons are cut by their ears; those that cross themselves are cut somehow.

    Returns:
        [P, N - 2, 3] corner numbers in 0 .. N - 1, wound as the polygons are.
    """
    count, corners = points.shape[:2]
    fan = np.stack(
        [np.zeros(corners - 2), np.arange(1, corners - 1), np.arange(2, corners)], axis=1
    ).astype(np.int64)
    triangles = np.broadcast_to(fan, (count, *fan.shape)).copy()
    if corners == 3:
        return triangles
    for index in np.flatnonzero(~_strictly_convex(points)):
        triangles[index] = _cut_ears(_flattened(points[index]))
    return triangles


def _newell(points: Floats) -> Floats:
    """Normals [P, 3] of polygons [P, N, 3], as long as twice their area."""
    centred = points - points.mean(axis=1, keepdims=True)
    return np.cross(centred, np.roll(centred, -1, axis=1)).sum(axis=1)


def _strictly_convex(points: Floats) -> NDArray[np.bool_]:
    """Whether every fan triangle and every corner turns clearly the polygon's way [P]."""
    normal = _newell(points)
    area = np.linalg.norm(normal, axis=-1)
    ahead = np.roll(points, -1, axis=1) - points
    turns = np.cross(np.roll(ahead, 1, axis=1), ahead)
    spokes = points[:, 1:] - points[:, :1]
    fans = np.cross(spokes[:, :-1], spokes[:, 1:])
    crosses = np.concatenate([turns, fans], axis=1)
    signed = (crosses * normal[:, None]).sum(axis=-1)
    # A corner that hardly turns would become a triangle without area.
    return (signed > 1e-6 * (area**2)[:, None]).all(axis=1)


def _flattened(points: Floats) -> Floats:
    """A polygon [N, 3] in its best-fit plane [N, 2], counter-clockwise."""
    normal = _newell(points[None])[0]
    length = np.linalg.norm(normal)
    normal = normal / length if length > 0 else np.array([0.0, 0.0, 1.0])
    side = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    side /= np.linalg.norm(side)
    return (points - points.mean(axis=0)) @ np.stack([side, np.cross(normal, side)], axis=1)


def _cut_ears(points: Floats) -> Indices:
    """Triangles [N - 2, 3] of one counter-clockwise polygon [N, 2]; the best-shaped ear first."""
    left = list(range(len(points)))
    quality = [_shape(points[[left[i - 1], left[i], left[(i + 1) % len(left)]]]) for i in left]
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        at = _best_ear(points, left, quality)
        size = len(left)
        triangles.append((left[at - 1], left[at], left[(at + 1) % size]))
        del left[at], quality[at]
        size -= 1
        for near in ((at - 1) % size, at % size):
            corners = [left[near - 1], left[near], left[(near + 1) % size]]
            quality[near] = _shape(points[corners])
    return np.array([*triangles, left], np.int64)


def _best_ear(points: Floats, left: list[int], quality: list[float]) -> int:
    """Position in `left` of the best-shaped ear; where there is none, of the best corner."""
    order = sorted(range(len(left)), key=quality.__getitem__, reverse=True)
    outline = points[left]
    for at in order:
        if quality[at] <= 0:
            break
        corners = points[[left[at - 1], left[at], left[(at + 1) % len(left)]]]
        if not _any_inside(outline, corners):
            return at
    return order[0]


def _shape(corners: Floats) -> float:
    """Twice the signed area of a triangle [3, 2] over its longest side squared."""
    (ax, ay), (bx, by), (cx, cy) = corners.tolist()
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    sides = ((bx - ax, by - ay), (cx - bx, cy - by), (ax - cx, ay - cy))
    longest = max(x * x + y * y for x, y in sides)
    return area / longest if longest > 0 else 0.0


def _any_inside(points: Floats, corners: Floats) -> bool:
    """Whether a point [N, 2] lies in or on a triangle [3, 2], its corners' own places excepted."""
    edges = np.roll(corners, -1, axis=0) - corners
    towards = points[:, None] - corners
    inside = (edges[:, 0] * towards[..., 1] - edges[:, 1] * towards[..., 0] >= 0).all(axis=1)
    inside &= (towards != 0).any(axis=-1).all(axis=1)
    return bool(inside.any())
