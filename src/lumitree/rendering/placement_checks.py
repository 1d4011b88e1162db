"""Checks of luminaires in a scene: what is in their boxes, and which boxes overlap.

Symbols
    N   boxes       P   pairs of boxes
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.mitsuba_meshes import mesh_triangles
from lumitree.errors import LumitreeWarning

# A little smaller than the box, so that a ceiling or a box that it touches does not count.
_INSIDE = 0.998
# Boxes are in one place if their corners agree to this part of their size.
_SAME = 1e-3


def contains_objects(shapes: Sequence[mi.Shape], boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether one of some shapes is in each box, by more than it may touch.

    Meshes, rectangles and spheres are tested exactly; of other shapes, the axis-aligned box.

    Args:
        boxes: [N, 4, 4] transforms of [-1, 1]³ into the scene.
    """
    found = np.zeros(len(boxes), bool)
    if not len(boxes):
        return found
    centres = boxes[:, :3, 3]
    reach = _INSIDE * np.abs(boxes[:, :3, :3]).sum(axis=2)
    for shape in shapes:
        lower, upper = (np.ravel(each) for each in (shape.bbox().min, shape.bbox().max))
        near = ((centres - reach < upper) & (centres + reach > lower)).all(axis=1) & ~found
        if near.any():
            within = _in_boxes(shape, lower, upper)
            found[near] = [within(box) for box in boxes[near]]
    return found


def _in_boxes(
    shape: mi.Shape, lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> Callable[[NDArray[np.float64]], bool]:
    """A test of a shape with these bounds: whether it is in a box [4, 4] that the bounds meet."""
    if (triangles := _triangles(shape)) is not None:
        return lambda box: _any_in_box(_in_frame(box, triangles))
    if shape.class_name() == "Sphere":
        centre, radius = (lower + upper) / 2, (upper[0] - lower[0]) / 2

        def crosses(box: NDArray[np.float64]) -> bool:
            sides = _INSIDE * np.linalg.norm(box[:3, :3], axis=0)
            offset = np.abs(_in_frame(box, centre)) * sides / _INSIDE
            nearest = np.linalg.norm(np.maximum(offset - sides, 0))
            return bool(nearest < radius < np.linalg.norm(offset + sides))

        return crosses
    return lambda _: True


def _in_frame(box: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points [.., 3] where a box [4, 4] is [-1, 1]³."""
    return (points - box[:3, 3]) @ np.linalg.inv(box[:3, :3]).T


def _triangles(shape: mi.Shape) -> NDArray[np.float64] | None:
    """Triangles [T, 3, 3] of a mesh or a rectangle; None for other shapes."""
    if isinstance(shape, mi.Mesh):
        return mesh_triangles(shape)
    if shape.class_name() == "Rectangle":
        matrix = np.array(mi.traverse(shape)["to_world"].matrix, np.float64).reshape(4, 4)
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) @ matrix[:3, :2].T + matrix[:3, 3]
        return corners[[[0, 1, 2], [0, 2, 3]]]
    return None


def _any_in_box(triangles: NDArray[np.float64]) -> bool:
    """Whether one of some triangles [T, 3, 3] reaches into [-1, 1]³.

    No axis may separate them: one of the box, the triangle's normal, or normal to an edge of each.
    """
    for axis in range(3):
        along = triangles[:, :, axis]
        triangles = triangles[
            (along.min(axis=1, initial=np.inf) < _INSIDE)
            & (along.max(axis=1, initial=-np.inf) > -_INSIDE)
        ]
    edges = np.roll(triangles, -1, axis=1) - triangles
    crossed = np.cross(np.eye(3)[:, None], edges[:, None]).reshape(-1, 9, 3)
    normal = np.cross(edges[:, 0], edges[:, 1])[:, None]
    axes = np.concatenate([normal, crossed], axis=1)
    along = np.einsum("tai,tvi->tav", axes, triangles)
    reach = _INSIDE * np.abs(axes).sum(axis=2)
    apart = (along.min(axis=2) >= reach) | (along.max(axis=2) <= -reach)
    # The product of parallel edges separates nothing.
    apart &= np.abs(axes).max(axis=2) > 1e-12
    return bool((~apart.any(axis=1)).any())


def warn_of_overlaps(
    boxes: NDArray[np.float64],
    names: Sequence[str],
    kinds: Sequence[object],
    fields: Sequence[bool],
) -> None:
    """Warn once of boxes that overlap, and once of lamps that are in one place.

    Args:
        boxes: [N, 4, 4] as for `contains_objects`.
        kinds: what is placed; equal for instances of one lamp.
        fields: which are shown by a radiance field. Others may overlap each other.
    """
    pairs = overlapping(boxes)
    same = np.array([kinds[i] == kinds[j] for i, j in pairs], bool) & _coincide(boxes, pairs)
    wrong = np.array([fields[i] or fields[j] for i, j in pairs], bool) & ~same
    if same.any():
        warnings.warn(
            f"{_listed(pairs[same], boxes, names)} the same lamp in the same place: twice the "
            "light; remove one",
            LumitreeWarning,
            stacklevel=3,
        )
    if wrong.any():
        warnings.warn(
            f"{_listed(pairs[wrong], boxes, names)} lamps whose boxes overlap; what is shown by a "
            "radiance field is not lit by the other: move them apart, or use the geometry of both",
            LumitreeWarning,
            stacklevel=3,
        )


def overlapping(boxes: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices [P, 2] of boxes [N, 4, 4] that overlap by more than they may touch."""
    centres, axes = boxes[:, :3, 3], _INSIDE * boxes[:, :3, :3]
    reach = np.abs(axes).sum(axis=2)
    candidates = [np.zeros((0, 2), np.int64)]
    for i in range(len(boxes) - 1):
        apart = np.abs(centres[i + 1 :] - centres[i]) > reach[i + 1 :] + reach[i]
        near = i + 1 + np.flatnonzero(~apart.any(axis=1))
        candidates.append(np.stack([np.full_like(near, i), near], axis=1))
    pairs = np.concatenate(candidates)
    return pairs[~_separated(centres, axes, pairs)]


def _separated(
    centres: NDArray[np.float64], axes: NDArray[np.float64], pairs: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Whether an axis separates the boxes of each pair: a normal of a face, or of two edges."""
    first, second = axes[pairs[:, 0]], axes[pairs[:, 1]]
    # Unit edges [P, 3, 3], one a row.
    edges = [
        np.swapaxes(each / np.linalg.norm(each, axis=1, keepdims=True), 1, 2)
        for each in (first, second)
    ]
    crossed = np.cross(edges[0][:, :, None], edges[1][:, None]).reshape(-1, 9, 3)
    normals = np.concatenate([*edges, crossed], axis=1)
    distance = centres[pairs[:, 1]] - centres[pairs[:, 0]]
    between = np.abs(np.einsum("pni,pi->pn", normals, distance))
    reach = sum(np.abs(normals @ each).sum(axis=2) for each in (first, second))
    # The product of parallel edges is rounding alone, and separates nothing.
    valid = np.linalg.norm(normals, axis=2) > 1e-6
    return (valid & (between > reach)).any(axis=1)


def _coincide(boxes: NDArray[np.float64], pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
    first, second = boxes[pairs[:, 0], :3], boxes[pairs[:, 1], :3]
    size = np.abs(first[:, :, :3]).max(axis=(1, 2))
    return np.abs(first - second).max(axis=(1, 2)) <= _SAME * size


def _listed(pairs: NDArray[np.int64], boxes: NDArray[np.float64], names: Sequence[str]) -> str:
    """The beginning of a sentence about pairs, of which the first is named."""
    named = [f"{names[i]} at {_point(boxes[i])}" for i in pairs[0]]
    both = " and ".join(named)
    if len(pairs) == 1:
        return f"{both} are"
    more = "1 more pair" if len(pairs) == 2 else f"{len(pairs) - 1:,} more pairs"
    return f"{both}, and {more}, are"


def _point(box: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:.6g}" for value in box[:3, 3]) + ")"
