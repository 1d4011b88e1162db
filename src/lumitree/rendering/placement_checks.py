"""Checks of luminaires in a scene: what is in their boxes, and which boxes overlap.

Symbols
    N   boxes       P   pairs of boxes
"""

import warnings
from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.errors import LumitreeWarning

# Random segments in each box.
_SEGMENTS = 1 << 14
# Boxes that are tested at once.
_AT_ONCE = 256
# A little smaller than the box, so that a ceiling or a box that it touches does not count.
_INSIDE = 0.998
# Boxes are in one place if their corners agree to this part of their size.
_SAME = 1e-3


def holds_objects(scene: Any, boxes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether a surface of a scene is inside each box, by random segments.

    Args:
        scene: mi.Scene.
        boxes: [N, 4, 4] transforms of [-1, 1]³ into the scene.
    """
    unit = _INSIDE * np.random.default_rng(0).uniform(-1, 1, (2, _SEGMENTS, 3))
    start, end = (on_device(mi.Point3f, points) for points in unit)
    found = np.zeros(len(boxes), bool)
    for first in range(0, len(boxes), _AT_ONCE):
        some = boxes[first : first + _AT_ONCE]
        rows = on_device(mi.Float, some[:, :3])
        index = dr.arange(mi.UInt32, len(some) * _SEGMENTS)
        box, segment = index // _SEGMENTS, index % _SEGMENTS
        values = [dr.gather(mi.Float, rows, 12 * box + i) for i in range(12)]
        matrix = mi.Matrix3f(*(value for i, value in enumerate(values) if i % 4 < 3))
        origin = dr.gather(mi.Point3f, start, segment)
        offset = mi.Vector3f(matrix @ (dr.gather(mi.Point3f, end, segment) - origin))
        length = dr.norm(offset)
        centre = mi.Point3f(*values[3::4])
        ray = mi.Ray3f(matrix @ origin + centre, offset / length, length, mi.Float(0), [])
        hit = np.broadcast_to(np.array(scene.ray_test(ray), bool), len(index))
        found[first : first + len(some)] = hit.reshape(len(some), -1).any(axis=1)
    return found


def contains(box: NDArray[np.float64], point: NDArray[np.float64]) -> bool:
    """Whether a point [3] is inside a box [4, 4]."""
    local = np.linalg.solve(box[:3, :3], point - box[:3, 3])
    return bool((np.abs(local) < 1).all())


def warn_of_overlaps(
    boxes: NDArray[np.float64], names: Sequence[str], kinds: Sequence[object], baked: Sequence[bool]
) -> None:
    """Warn once of boxes that overlap, and once of lamps that are in one place.

    Args:
        boxes: [N, 4, 4] as for `holds_objects`.
        names: of the lamps, for the message.
        kinds: what is placed; equal for instances of one lamp.
        baked: which are baked. Explicit lamps may overlap each other.
    """
    pairs = overlapping(boxes)
    same = np.array([kinds[i] == kinds[j] for i, j in pairs], bool) & _coincide(boxes, pairs)
    wrong = np.array([baked[i] or baked[j] for i, j in pairs], bool) & ~same
    if same.any():
        warnings.warn(
            f"{_listed(pairs[same], boxes, names)} the same lamp in the same place: twice the "
            "light; remove one",
            LumitreeWarning,
            stacklevel=3,
        )
    if wrong.any():
        warnings.warn(
            f"{_listed(pairs[wrong], boxes, names)} lamps whose boxes overlap; in its box a baked "
            "luminaire neither lights nor shades correctly what belongs to another one; move them "
            "apart, or bake them as one luminaire",
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
