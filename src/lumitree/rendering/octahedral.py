"""Bins of directions by the octahedral map.

The sphere is projected on an octahedron, whose lower half is folded out into the corners of a
square, which is cut into RESOLUTION² bins.
"""

from typing import Any

import drjit as dr
import mitsuba as mi

RESOLUTION = 16
NUM_BINS = RESOLUTION * RESOLUTION


def octahedral(direction: Any) -> Any:
    """Octahedral coordinates in [-1, 1]² of a direction of any length."""
    n = direction / dr.sum(dr.abs(direction))
    folded = mi.Vector2f(
        dr.copysign(1 - dr.abs(n.y), n.x),
        dr.copysign(1 - dr.abs(n.x), n.y),
    )
    return dr.select(n.z < 0, folded, mi.Vector2f(n.x, n.y))


def bin_of(direction: Any) -> Any:
    """Index of the bin of a direction of any length."""
    uv = octahedral(direction)
    cell = mi.Point2u(dr.clip(mi.Point2i((uv + 1) * (RESOLUTION / 2)), 0, RESOLUTION - 1))
    return cell.y * RESOLUTION + cell.x


def direction_in_bin(bin_index: Any, sample: Any) -> tuple[Any, Any]:
    """Unit direction in a bin, uniform in octahedral coordinates, and its density there."""
    cell = mi.Point2f(bin_index % RESOLUTION, bin_index // RESOLUTION)
    uv = (cell + sample) * (2 / RESOLUTION) - 1
    z = 1 - dr.abs(uv.x) - dr.abs(uv.y)
    fold = dr.maximum(-z, 0)
    v = mi.Vector3f(uv.x - dr.copysign(fold, uv.x), uv.y - dr.copysign(fold, uv.y), z)
    direction = dr.normalize(v)
    return direction, bin_density(direction)


def bin_density(direction: Any) -> Any:
    """Density per steradian of `direction_in_bin`, given the bin.

    Area on the octahedron and solid angle differ by the cube of the distance from the origin.
    """
    return (NUM_BINS / 4) / dr.sum(dr.abs(direction)) ** 3
