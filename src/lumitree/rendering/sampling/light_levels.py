"""Levels of a light field: sums of 2 × 2 × 2 cells, for receivers that are farther away.

Level 0 is the field's own grid. A sum has the light of its cells in each bin of direction and each
channel. Its light starts in a box with the mean and the variance of the places where theirs does.

The level of a receiver depends on its distance and on a random number, so that there is no seam.

Symbols
    L   levels      C   cells of a level        R   bins of direction a side
"""

from __future__ import annotations

import dataclasses
import functools

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_field import LightField
from lumitree.asset.packed_colours import unpack
from lumitree.core.device import parameter
from lumitree.core.octahedral import solid_angles
from lumitree.core.photometry import luminance
from lumitree.octree.build import morton
from lumitree.octree.leaves import grid_boxes_inside

# Depth of the coarsest level.
_COARSEST = 3
# A grid of this many cells a side is fine enough at a distance of 1 from the lamp's box, local
# units, and a grid of half as many at twice the distance. Distances are multiplied by random
# numbers from 1 to 1 + `_BLEND`.
_SIDES, _BLEND = 48.0, 0.5


@dataclasses.dataclass(frozen=True, eq=False)
class Level:
    """A light field in the cells of a grid.

    Attributes:
        cells: [C, 3] coordinates, in Morton order.
        depth: the grid has 2**depth cells a side.
        lower, upper: [C, 3] corners of the boxes in which light starts, local units.
        intensity: float32 [C, R², 3] radiant intensity, in the unit of the field's scale.
    """

    cells: NDArray[np.uint8]
    depth: int
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    intensity: NDArray[np.float32]

    @functools.cached_property
    def flux(self) -> NDArray[np.float64]:
        """Luminous flux [C], in the unit of the field's scale."""
        angles = solid_angles(int(np.sqrt(self.intensity.shape[1])))
        return (luminance(self.intensity) @ angles).astype(np.float64)


def light_levels(field: LightField, half_extents: NDArray[np.float64]) -> list[Level]:
    """The levels of a field, the finest first."""
    lower, upper = grid_boxes_inside(half_extents, field.cells, field.depth)
    intensity = field.dense(unpack(field.intensity).astype(np.float32))
    levels = [Level(field.cells, field.depth, lower, upper, intensity)]
    while levels[-1].depth > _COARSEST:
        levels.append(_summed(levels[-1], half_extents))
    return levels


def _summed(level: Level, half_extents: NDArray[np.float64]) -> Level:
    first = np.flatnonzero(np.diff(morton(level.cells >> 1), prepend=-1))
    cells, depth = level.cells[first] >> 1, level.depth - 1

    def total(values):
        return np.add.reduceat(values, first, axis=0)

    flux = level.flux[:, None]
    middle, variance = (level.lower + level.upper) / 2, (level.upper - level.lower) ** 2 / 12
    mean = total(flux * middle) / total(flux)
    spread = total(flux * (variance + middle**2)) / total(flux) - mean**2
    lower, upper = grid_boxes_inside(half_extents, cells, depth)
    # The box stays within the cell, so that all of its points are in the lamp's box.
    half = np.minimum(np.sqrt(np.maximum(3 * spread, 0)), np.minimum(mean - lower, upper - mean))
    half = np.maximum(half, 5e-7)
    return Level(cells, depth, mean - half, mean + half, total(level.intensity))


class LevelChoice:
    """The level of receivers.

    Args:
        half_extents: of the lamp's box.
        depth: of level 0.
        count: L.
    """

    def __init__(self, half_extents: NDArray[np.float64], depth: int, count: int) -> None:
        self._half = parameter(mi.Vector3f, *half_extents.tolist())
        self._limit = parameter(mi.Float, (1 << depth) / _SIDES)
        self._last = parameter(mi.Float, count - 1.0)

    def sample(self, x: mi.Point3f, sample: mi.Float) -> mi.UInt32:
        """Level of a receiver, for a sample in [0, 1)."""
        outside = dr.maximum(dr.abs(mi.Vector3f(x)) - self._half, 0)
        distance = dr.norm(outside) * dr.fma(_BLEND, sample, 1)
        level = dr.log2(dr.maximum(distance * self._limit, 0.5))
        return mi.UInt32(dr.clip(level, 0, self._last))


def level_shells(
    half_extents: NDArray[np.float64], depth: int, count: int, level: int, width: float, last: int
) -> tuple[int, int]:
    """First and last shell (`receiver_cells`) in which receivers have a level.

    Args:
        depth, count: as of `LevelChoice`.
        width: of a shell.
        last: the innermost shell.
    """
    radius, limit = float(np.linalg.norm(half_extents)), _SIDES / (1 << depth)
    nearest = (limit * 2.0**level / (1 + _BLEND) if level else 0) + half_extents.min()
    farthest = limit * 2.0 ** (level + 1) + radius if level + 1 < count else np.inf
    return tuple(min(int(radius / at / width), last) for at in (farthest, nearest))
