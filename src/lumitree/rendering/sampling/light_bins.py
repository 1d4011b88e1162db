"""Bins of direction of a light field, and the packed numbers in them.

Symbols are as in `light_field`.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import (
    EXPONENT_OF_ONE,
    EXPONENT_SHIFT,
    MANTISSA,
    MANTISSA_SHIFTS,
    LightField,
    by_coarse_bin,
    by_fine_bin,
    dense,
    pack_lit,
    parts_of_ending,
    unpack,
)
from lumitree.core.octahedral import bin_of, octahedral, solid_angles
from lumitree.core.photometry import luminance
from lumitree.octree.build import morton
from lumitree.rendering.sampling.samples import scrambled

# Cells whose bins are computed at once, which bounds the memory.
_CELLS_AT_ONCE = 1 << 10


def ending_by_bin(field: LightField) -> tuple[NDArray[np.uint32], float]:
    """J of a light field in the bins of I, as `parts_of_ending` divides it.

    Returns:
        RGB9_E5 numbers [C', R²] of the cells of `field.inside`, and their scale.
    """
    inside = field.inside
    assert inside is not None
    leaving = np.zeros((len(inside.cells), field.resolution**2), np.float32)
    rows = np.searchsorted(morton(inside.cells), morton(field.cells))
    leaving[rows] = field.dense(field.scale * luminance(unpack(field.intensity)))
    packed = dense(inside.lit, (field.resolution // 2) ** 2, inside.intensity)
    solid_angle = by_coarse_bin(solid_angles(field.resolution)[None])
    # A part is at most about 4 times the mean.
    scale, ending = 8 * inside.scale, np.zeros_like(leaving, np.uint32)
    for start in range(0, len(leaving), _CELLS_AT_ONCE):
        at = slice(start, start + _CELLS_AT_ONCE)
        # Light ends in few of the directions.
        ends, coarse = packed[at] != 0, by_coarse_bin(leaving[at])
        mean = inside.scale * unpack(packed[at][ends])
        angles = np.broadcast_to(solid_angle, coarse.shape)[ends]
        parts = parts_of_ending(coarse[ends], luminance(mean), angles)
        words = np.zeros(coarse.shape, np.uint32)
        words[ends] = pack_lit(parts[..., None] * mean[:, None], scale)
        ending[at] = by_fine_bin(words)
    return ending, scale


def smooth_bin(
    direction: mi.Vector3f, resolution: int, origin: mi.Point3f | None = None
) -> mi.UInt32:
    """A bin at random, so that the mean over bins is linear between their middles.

    Args:
        direction: of any length; the random numbers are made of its bits.
        origin: of a ray whose direction many rays may have: the numbers are of both.
    """
    random = scrambled(mi.Point2f(direction.x, direction.y))
    if origin is not None:
        # Three numbers in [0, 1) from the point, by which the others are turned.
        first = scrambled(mi.Point2f(origin.x, origin.y))
        other = scrambled(mi.Point2f(first.z, origin.z))
        random += other
        random -= dr.floor(random)
    return bin_of(direction, resolution, mi.Vector2f(random.x, random.y) - 0.5)


def bins_around(direction: mi.Vector3f, resolution: int) -> list[tuple[mi.UInt32, mi.Float]]:
    """The four bins whose middles are around a direction, and their weights.

    The weights are the chances with which `smooth_bin` returns the bins.
    """
    place = (octahedral(direction, resolution) + 1) * (resolution / 2) - 0.5
    part = place - dr.floor(place)
    found = []
    for x in (0, 1):
        for y in (0, 1):
            weight = (part.x if x else 1 - part.x) * (part.y if y else 1 - part.y)
            found.append((bin_of(direction, resolution, mi.Vector2f(x, y) - part), weight))
    return found


def unpacked(packed: mi.UInt32) -> mi.Color3f:
    """Colours of RGB9_E5 numbers."""
    # As `asset.light_field.unpack`: a power of two is a number whose mantissa's 23 bits are 0.
    exponent = (packed >> EXPONENT_SHIFT) + (127 - EXPONENT_OF_ONE)
    unit = dr.reinterpret_array(mi.Float, exponent << 23)
    mantissas = (packed >> shift & MANTISSA for shift in MANTISSA_SHIFTS)
    return mi.Color3f(*(mi.Float(each) for each in mantissas)) * unit
